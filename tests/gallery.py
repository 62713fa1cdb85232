"""One of each object that a user gets, from small records."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

import pmfid
from pmfid.design import Limits, Problem, appraise, evaluate
from pmfid.monitor.calibration import calibrate
from pmfid.monitor.events import Watch
from pmfid.monitor.monitor import Monitor
from pmfid.presentation import Presentable
from pmfid.simulation import CART, CART_DT
from tests.conftest import TRUTH, cart_run, unjudged

CUTOFF = 100 / 3
RUN = cart_run(3, samples=1200)
DRIVE = pmfid.Drive(CART.input_gain)
NOMINAL = {"mass": CART.mass, "viscous_friction": CART.viscous_friction, "coulomb_friction": CART.coulomb_friction}
LIMITS = Limits(input=3.0, position=(0.0, 0.4), min_speed=0.01)
PROBLEM = Problem(DRIVE, NOMINAL, ("mass", "viscous_friction"), 2.0, 40, LIMITS, resolution=91e-6)


def _result(**settings: object) -> pmfid.Result:
    settings = {"cutoff": CUTOFF, **settings}
    with unjudged():
        return pmfid.identify(RUN.u, RUN.counts, model=DRIVE, dt=CART_DT, encoder=RUN.encoder, **settings)  # type: ignore[arg-type]


def _experiment(seed: int) -> pmfid.Experiment:
    """Return an experiment of y' = (u - y) / 0.3 s with noise; every tenth output is missing, at odd instants."""
    rng = np.random.default_rng(seed)
    u, y, dt = np.repeat(rng.choice([-1.0, 1.0], 40), 10), np.zeros(400), 0.02
    for k in range(399):
        y[k + 1] = u[k] + (y[k] - u[k]) * np.exp(-dt / 0.3)
    y += 0.01 * rng.standard_normal(400)
    y[::10] = np.nan
    return pmfid.Experiment(u, y, dt=dt, name=f"bench {seed}")


def _monitor() -> Monitor:
    riv = pmfid.RIV(
        DRIVE,
        RUN.encoder,
        CART_DT,
        CUTOFF,
        forgetting=0.99,
        initial=dict(zip(("mass", "viscous_friction", "coulomb_friction"), TRUTH.tolist(), strict=True)),
    )
    monitor = Monitor(riv, calibrate(riv, TRUTH, RUN.u, None), Watch(mtbf_hours=1.0))
    for u, count in zip(RUN.u[:600].tolist(), RUN.counts[:600].tolist(), strict=True):
        monitor.step(u, count)
    return monitor


@cache
def _jump(estimator: pmfid.BCRLS) -> pmfid.Estimate:
    """Return the estimate of the first count that repeats the end of a run after the run."""
    u, counts = RUN.u, RUN.counts
    for k in range(estimator.delay):
        estimator.step(float(u[k]), int(counts[k]))
    return estimator.step(float(u[estimator.delay]), int(counts[estimator.delay]))


@cache
def gallery() -> dict[str, Presentable | pmfid.Estimate]:
    """Return one of each object by its description."""
    bcrls = pmfid.BCRLS(DRIVE, RUN.encoder, CART_DT, CUTOFF, forgetting=0.995)
    fit = pmfid.LS(DRIVE, RUN.encoder, CART_DT, CUTOFF).fit(RUN.u, RUN.counts)
    offline, online = _result(method="iv"), _result(method="riv", forgetting=0.99)
    experiments = [_experiment(1), _experiment(2)]
    process = pmfid.identify(experiments, model=pmfid.TransferFunction(1, 0), cutoff=5.0)
    fleet = pmfid.Fleet(bcrls, 3, workers=1)
    longer = np.round(1.02 * RUN.counts).astype(np.int64)  # an axis that the same force moves slightly less
    track = bcrls.run(RUN.u, RUN.counts)
    design = evaluate(PROBLEM, 3.0 * np.sign(np.sin(np.arange(40) / 4)), "A")
    return {
        "drive": offline,
        "drive, on-line": online,
        "drive, mass given": _result(method="iv", given={"mass": CART.mass}),
        "process": process,
        "fit": fit,
        "track": track,
        "tracks": fleet.run(RUN.u, np.array([RUN.counts, longer, RUN.counts]), every=20),
        "estimate": _jump(bcrls),
        "posterior": pmfid.Known(bcrls, prior={"mass": (1.1, 0.05)}).combine(fit),
        "curve": pmfid.friction_curve(RUN.u, RUN.counts, model=DRIVE, encoder=RUN.encoder, dt=CART_DT),
        "validation": pmfid.validate(offline, RUN.u, RUN.counts),
        "validation of two": replace(pmfid.validate(process, experiments), method="srivc"),
        "experiment": experiments[0],
        "transfer function": process.process,  # type: ignore[attr-defined]
        "monitor": _monitor(),
        "design": design,
        "appraisal": appraise(design),
    }
