"""A model against a record it was not fitted to: simulated from the input alone, as far as it is to predict.

The start is read from the first samples of the record, and nothing else of its output is used. A free run over minutes
judges how the position of a machine drifts, so it is begun again and again, too, every 1, 2, 5 and 10 s: what is off
within such a horizon is what a controller or a digital twin that is corrected as often would see.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from pmfid.errors import UsageError
from pmfid.estimators.arguments import check_arrays, check_size, hold_last_input
from pmfid.estimators.difference import Difference, rms
from pmfid.estimators.output_error import OE
from pmfid.estimators.starts import choose_start, fit_start, start_samples
from pmfid.types import Floats, Numbers

#: Seconds after which a run is begun again, and how many times longer than the reading of its start they must be; of
#: what is slower or faster the same numbers of tenths, tens or hundreds of seconds.
HORIZONS = (1.0, 2.0, 5.0, 10.0)
WORTH = 4.0
#: Runs of one horizon that are looked at.
MOST_RUNS = 200
#: The square of a number must not leave the format.
BEYOND = 1e120


@dataclass(frozen=True)
class Horizon:
    """Runs over `seconds` each, restarted every time; rmse: root mean square of their errors; standstill: error of a
    model that stays at its start [unit of the output]."""

    seconds: float
    runs: int
    rmse: float
    standstill: float


@dataclass(frozen=True, eq=False)
class FreeRun:
    """Time t [s], measured and simulated output, each (n,). read: length from the first sample [s] that determines
    the start; encoder: root mean square error of the encoder alone, None without an encoder; notes: for people."""

    name: str
    t: Floats
    measured: Floats
    simulated: Floats
    read: float
    encoder: float | None
    horizons: tuple[Horizon, ...]
    notes: tuple[str, ...] = ()

    @property
    def error(self) -> Floats:
        """(n,) measured less simulated."""
        return self.measured - self.simulated

    @property
    def rmse(self) -> float:
        return rms(self.error)

    @property
    def largest(self) -> float:
        return float(np.max(np.abs(self.error)))

    @property
    def mean(self) -> float:
        """Root mean square error of a model that knows the mean of the record, and no more."""
        return rms(self.measured - np.mean(self.measured))

    @property
    def standstill(self) -> float:
        """Root mean square error of a model that stays where it begins."""
        return rms(self.measured - self.measured[0])

    @property
    def fit(self) -> float | None:
        """100 (1 - |y - simulated| / |y - mean y|) [%], None where the output does not move (Ljung 1999, `compare`)."""
        return 100 * (1 - self.rmse / self.mean) if self.mean > 0 else None

    @property
    def relative(self) -> float | None:
        """100 |y - simulated| / |y| [%], the relative error of robot identification; it depends on where zero is."""
        size = rms(self.measured)
        return 100 * self.rmse / size if size > 0 else None


@np.errstate(all="ignore")  # of parameters from a file; what comes of them is looked at
def drive_run(method: OE, theta: Floats, u: Floats, counts: Numbers, name: str) -> FreeRun:
    """The free run of a machine with parameters theta (p,), under u (n,) from where the counts (n,) begin.

    Raises UsageError for a mass that is not positive, and for parameters that nothing can be simulated with.
    """
    u, counts = check_arrays(u, counts)
    check_size(u)
    leading = method.equation.leading
    if not theta[leading] > 0:
        raise UsageError(f"{method.names[leading]} = {theta[leading]:g}: nothing moves with that; identify it again")
    y = method.position(counts)
    if not np.ptp(y) > 0 or not np.any(u):
        what = "axis does not move" if np.any(u) else "input is zero"
        raise UsageError(f"{name}: the {what} throughout, there is nothing to predict; give a record of a motion")
    difference = method.make_difference(theta, hold_last_input(u), y)
    scaled = theta / difference.scale[: theta.size]
    below = [n for n, value, least in zip(method.names, scaled, difference.lower, strict=False) if value < least]
    notes = [f"{', '.join(below)} below zero, simulated as zero"] if below else []
    scaled = np.maximum(scaled, difference.lower[: theta.size])
    run = _run(difference, scaled, method.cutoff)
    read = min(start_samples(method.dt, method.cutoff), u.size)
    horizons = measure_horizons(
        u.size * method.dt,
        read * method.dt,
        lambda seconds: _restart_simulations(difference, scaled, method.cutoff, max(2, round(seconds / method.dt))),
    )
    t = np.arange(u.size, dtype=np.float64) * method.dt
    encoder = method.encoder.resolution / math.sqrt(12)
    return finite(FreeRun(name, t, difference.y, run, read * method.dt, encoder, horizons, tuple(notes)))


def _run(part: Difference, theta: Floats, cutoff: float) -> Floats:
    """(n,) simulated positions at scaled parameters (p,)."""
    read = part.part(0, min(start_samples(part.dt, cutoff), part.y.size))
    return part.motion(fit_start(read, choose_start(read, theta, cutoff)))[0]


def _restart_simulations(
    difference: Difference, theta: Floats, cutoff: float, samples: int
) -> list[tuple[Floats, Floats]]:
    parts = [difference.part(first, first + samples) for first in firsts_of(difference.y.size, samples)]
    return [(part.y, _run(part, theta, cutoff)) for part in parts]


def firsts_of(n: int, samples: int) -> list[int]:
    """First samples of runs over `samples` each within n, one after the other; of very many some, evenly spread."""
    firsts = np.arange(0, n - samples + 1, samples)
    return firsts[:: -(-firsts.size // MOST_RUNS)].tolist() if firsts.size else []


def measure_horizons(
    duration: float, read: float, runs: Callable[[float], Sequence[tuple[Floats, Floats]]]
) -> tuple[Horizon, ...]:
    """Errors of runs that restart after each of HORIZONS. A horizon must fit into the `duration` [s] of the record and
    be longer than the reading of the start, `read` [s]. runs: measured and simulated outputs of runs over a time."""
    found = []
    for seconds in _seconds(duration, WORTH * read):
        parts = runs(seconds)
        if parts:
            error = np.concatenate([measured - simulated for measured, simulated in parts])
            still = np.concatenate([measured - measured[0] for measured, _ in parts])
            found.append(Horizon(seconds, len(parts), rms(error), rms(still)))
    return tuple(found)


def _seconds(duration: float, least: float) -> list[float]:
    usual = least <= HORIZONS[2] and duration >= HORIZONS[1]
    unit = 1.0 if usual else 10.0 ** math.ceil(math.log10(least))
    return [unit * seconds for seconds in HORIZONS if least <= unit * seconds <= duration]


def finite(run: FreeRun) -> FreeRun:
    """The same. Raises UsageError where the simulation has left the range of numbers."""
    if not np.max(np.abs(run.error)) < BEYOND:
        raise UsageError(
            "the simulated output leaves the range of numbers: check the units of the parameters, of the input and of "
            "the resolution against those that they were identified with"
        )
    return run
