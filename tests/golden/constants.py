"""Constants of the kernel, and what depends on their bits: exports, saved states and simulated inputs.

`python -m tests.golden.constants` prints a digest of each, which must not depend on the processor.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from pmfid.encoder import Encoder
from pmfid.estimators.iv import RIV
from pmfid.estimators.recursive import BCRLS, RLS, RecursiveEstimator
from pmfid.estimators.redge import REdge
from pmfid.export.edges import make_up_edges
from pmfid.export.firmware import export_firmware
from pmfid.export.samples import made_up_record
from pmfid.kernel.saved import configuration
from pmfid.kernel.structures import Structured
from pmfid.models.drive import Drive
from pmfid.models.transfer_function import TransferFunction
from pmfid.monitor import Monitor, Watch
from pmfid.monitor.calibration import Calibration, NormalWork
from pmfid.monitor.chance import Chance
from pmfid.monitor.scores import Scale
from pmfid.simulation import CART, CART_DT, SCENARIOS, make_scenario

PLACE = Path(__file__).with_name("constants.csv")
HEADER = ("estimator", "field", "values")
ENCODER = Encoder(0.0015)
GAIN = CART.input_gain
EVERYTHING = Drive(GAIN, stribeck=0.13, quadratic=True, friction_period=0.11)


def estimators() -> dict[str, RecursiveEstimator]:
    """Return estimators whose configurations use every way to a constant."""
    drive, tight, plain = Drive(GAIN), {"forgetting": 0.993}, (ENCODER, CART_DT, 17.0)
    late = Drive(GAIN, dead_time=0.0137, lag=0.0071)
    spring = Drive(GAIN, spring=True)
    return {
        "rls": RLS(drive, *plain, **tight),
        "rls paper": RLS(drive, *plain, order=5, discretization="paper", **tight),
        "rls with a spring": RLS(spring, *plain, **tight),
        "rls of a process": RLS(TransferFunction(5, 0), *plain),
        "bcrls": BCRLS(drive, *plain, order=3, **tight),
        "bcrls with steps": BCRLS(drive, *plain, steps="given", **tight),
        "bcrls of a process": BCRLS(TransferFunction(4, 1), *plain, **tight),
        "bcrls of a process, paper": BCRLS(TransferFunction(3, 0), *plain, discretization="paper"),
        "riv": RIV(EVERYTHING, *plain, **tight),
        "riv late": RIV(late, *plain, order=4, **tight),
        "riv float32": RIV(Drive(GAIN, dead_time=0.7 * CART_DT), *plain, precision="float32", **tight),
    }


def constants(config: Structured, prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield the real fields of a configuration by name, with their values up to the last that is not 0."""
    for name in config.dtype.names or ():
        field = config[name]
        if field.dtype.names:
            yield from constants(field, f"{prefix}{name}.")
        elif field.dtype.kind == "f" and np.any(field):
            values = np.trim_zeros(np.ravel(field), "b")
            digits = 9 if field.dtype.itemsize == 4 else 17
            yield prefix + name, " ".join(f"{value:.{digits}g}" for value in values.tolist())


def rows() -> Iterator[tuple[str, str, str]]:
    for name, estimator in estimators().items():
        kernel = estimator.kernel
        yield from ((name, *row) for row in constants(configuration(kernel, estimator.precision)))


def edge_estimator() -> REdge:
    return REdge(Drive(GAIN), ENCODER, CART_DT, lines=16, tick=1e-6, memory=3.0)


def watch_change() -> bytes:
    """Return the state of a monitor with a given calibration, after a change and its alarm."""
    run = make_scenario("moves-mass-step", seed=2, duration=40.0)
    theta = np.array([CART.mass, CART.viscous_friction, CART.coulomb_friction])
    inverse = np.array([[0.077, 0.003, -0.001], [0.003, 3.44, -0.69], [-0.001, -0.69, 0.25]])
    scale = Scale(inverse, np.array([0.077, 3.44, 0.25]), np.array([0.001, 0.009, 0.003]))
    work = NormalWork(0.0, np.zeros(3), scale, np.full(3, np.inf), np.zeros(3))
    chance = Chance(0.3, (1, 32), np.full((2, 3), 0.5), np.full((2, 3), 0.05), np.full((2, 1, 3), 1e6))
    calibration = Calibration(theta, scale, work, chance, np.ones(3))
    riv = RIV(Drive(GAIN), Encoder(run.resolution), CART_DT, 50.0, forgetting=0.99)
    monitor = Monitor(riv, calibration, Watch())
    rows = monitor.run(run.motion.u, run.counts)
    kinds = {type(event).__name__ for _, _, event in rows.events}
    assert {"Alarm", "Settled"} <= kinds, kinds
    return monitor.get_state()


def artefacts() -> Iterator[tuple[str, bytes]]:
    """Yield everything whose bytes must be the same on every processor, by name."""
    yield "constants", json.dumps(list(rows())).encode()
    for name, estimator in estimators().items():
        run = estimator.start()
        u, counts = made_up_record(estimator)
        run.run(u, counts, np.full(u.size, CART_DT) if estimator.steps else None)
        yield f"state of {name}", run.get_state()
    edges = edge_estimator()
    edges.run(*make_up_edges(edges))
    yield "state of redge", edges.get_state()
    yield "state of a monitor", watch_change()
    for name, source in (("riv", estimators()["riv"]), ("redge", edge_estimator())):
        with TemporaryDirectory() as folder:
            files = export_firmware(source, folder)  # type: ignore[arg-type]
            yield f"export of {name}", b"".join(file.name.encode() + file.read_bytes() for file in files)
    for name in SCENARIOS:
        run_of = make_scenario(name, seed=3, duration=4.0)
        yield f"scenario {name}", run_of.motion.u.tobytes() + run_of.counts.tobytes()


def main() -> None:
    for name, content in artefacts():
        print(f"{name}: {sha256(content).hexdigest()[:16]}")


if __name__ == "__main__":
    main()
