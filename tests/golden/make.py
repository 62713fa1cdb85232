"""Write the golden outputs: `python -m tests.golden.make`."""

from __future__ import annotations

import csv
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from pmfid.elementary import exp
from pmfid.encoder import Encoder
from pmfid.errors import PmfidError
from pmfid.estimators.base import Estimator
from pmfid.estimators.motion_fit import MotionFit
from pmfid.estimators.registry import ESTIMATORS, OFF_LINE, RECURSIVE, methods_for
from pmfid.estimators.srivc import SRIVC
from pmfid.models.drive import Drive
from pmfid.models.transfer_function import TransferFunction
from pmfid.simulation import CART, CART_DT, SCENARIOS, make_scenario
from pmfid.types import Counts, Floats
from tests.golden import constants

PLACE = Path(__file__).with_name("outputs.csv")
HEADER = ("record", "method", "precision", "status", "theta", "theta_std")
PRECISIONS = ("float64", "float32")
#: Increments per turn and length [s] of the records of a drive.
INCREMENTS, DURATION = (1024, 128), 12.0
CUTOFF, FORGETTING = 25.0, 0.99
#: Poles and zeros of the processes, their noise, number of samples, and resolution of the output.
PROCESSES, NOISE, SAMPLES, RESOLUTION = ((1, 0), (2, 0), (2, 1), (3, 1)), (0.0, 0.05), 600, 1e-3
#: The fit is judged by the referee (studies/referee), and has no golden outputs. Nor has `srivc`, whose posterior of
#: counts is that of the fit.
#: Number of digits that are kept. The kernel has the same bits on every target. In off-line methods a library chooses
#: the order of a sum.
DIGITS, DIGITS_OFF_LINE = 17, 7

Row = tuple[str, str, str, str, str, str]


def rows(wanted: Callable[[str], bool] = lambda record: True) -> Iterator[Row]:
    """Yield the golden rows of all records, or of the wanted records."""
    for name in SCENARIOS:
        for increments in INCREMENTS:
            if not wanted(f"{name} {increments}"):
                continue
            run = make_scenario(name, seed=11, increments=increments, duration=DURATION)
            for method, precision in _pairs([cls.method for cls in (*OFF_LINE, *RECURSIVE) if cls is not MotionFit]):
                estimator = _drive(method, precision, run.resolution)
                yield (f"{name} {increments}", method, precision, *outcome(estimator, run.motion.u, run.counts))
    for orders in PROCESSES:
        for noise in NOISE:
            if not wanted(f"process {orders[0]} {orders[1]} {noise}"):
                continue
            u, counts = process(orders, noise)
            for method, precision in _pairs(
                [one for one in methods_for(TransferFunction(*orders)) if one != SRIVC.method]
            ):
                estimator = _process(method, precision, orders)
                yield (f"process {orders[0]} {orders[1]} {noise}", method, precision, *outcome(estimator, u, counts))


def _pairs(methods: list[str]) -> Iterator[tuple[str, str]]:
    yield from ((method, precision) for method in methods for precision in PRECISIONS)


def _drive(method: str, precision: str, resolution: float) -> Estimator:
    cls = ESTIMATORS[method]
    memory = {"forgetting": FORGETTING} if cls in RECURSIVE else {}
    return cls(Drive(CART.input_gain), Encoder(resolution), CART_DT, CUTOFF, precision=precision, **memory)  # type: ignore[arg-type]


def _process(method: str, precision: str, orders: tuple[int, int]) -> Estimator:
    return ESTIMATORS[method](TransferFunction(*orders), Encoder(RESOLUTION), CART_DT, CUTOFF, precision=precision)


def process(orders: tuple[int, int], noise: float) -> tuple[Floats, Counts]:
    """Return input and counts (n,) of a sampled process with these numbers of poles and zeros, with white noise."""
    rng = np.random.default_rng([*orders, 5])
    u = np.repeat(rng.choice([-1.0, 1.0], SAMPLES // 10), 10)
    poles = [exp(-CART_DT * pole) for pole in (4.0, 9.0, 15.0)[: orders[0]]]
    gain = np.prod(1 - np.array(poles))
    zeros = [1.0, -0.9][: orders[1] + 1]
    y = lfilter(np.r_[0.0, gain * np.array(zeros) / np.sum(zeros)], np.poly(poles), u)
    return u, np.rint((y + noise * rng.standard_normal(SAMPLES)) / RESOLUTION).astype(np.int64)


def outcome(estimator: Estimator, u: Floats, counts: Counts) -> tuple[str, str, str]:
    """Return status, theta and its standard deviation as text, or the kind of the error."""
    digits = DIGITS if hasattr(estimator, "run") else DIGITS_OFF_LINE
    try:
        if hasattr(estimator, "run"):
            track = estimator.run(u, counts)
            return str(track.status[-1]), _text(track.theta[-1], digits), _text(track.theta_std[-1], digits)
        fit = estimator.fit(u, counts)  # type: ignore[attr-defined]
    except PmfidError as error:
        return type(error).__name__, "", ""
    return str(int(fit.status)), _text(fit.theta, digits), _text(fit.theta_std, digits)


def _text(values: Floats, digits: int) -> str:
    return " ".join(f"{value:.{digits}g}" for value in values)


def main() -> None:
    for module in (constants, sys.modules[__name__]):
        with module.PLACE.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(module.HEADER)
            writer.writerows(module.rows())


if __name__ == "__main__":
    main()
