"""Runs of the cart in the paper's setting, and the estimates of each method."""

from __future__ import annotations

import numpy as np

from pmfid.estimators.plants import default_zeros
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.results import Track
from pmfid.simulation import CART, CART_DT, CART_LOADED, Schedule, position_control, resolution_of
from pmfid.simulation.signals import steps
from pmfid.status import Status
from pmfid.types import Floats
from studies.paper.truth import CartRecord, make_estimator

#: Encoders of the paper's figures 3 and 4, and a coarser one.
INCREMENTS = (4096, 1024, 512, 256)
#: The paper only says "small filter time constants" [rad/s]: here 17, 10 and 7 ms at a sample period of 10 ms.
CUTOFFS = (60.0, 100.0, 150.0)
CUTOFF = 150.0
FORGETTING = 0.99
#: Position control with narrow peaks of the input, as the paper describes it: pulses of the reference [m, s], a
#: proportional gain [V/m] and the largest input [V]. The paper gives none of these numbers.
STROKE, HOLD, GAIN, LARGEST = 0.2, 1.0, 30.0, 6.0
#: RLS of the extended model, from which BCRLS starts (paper eq. 19 to 21).
EXTENDED = "extended rls"
HEAVY = Schedule(((0.0, CART_LOADED),))


def step_at(time: float) -> Schedule:
    """Return the cart whose mass steps from 1.07 to 1.44 kg at a time [s]."""
    return Schedule(((0.0, CART), (time, CART_LOADED)))


def controlled(increments: int, seed: int, duration: float, schedule: Schedule | None = None) -> CartRecord:
    """Return a record of the cart under P control, which sees the encoder; the seed draws the start phase."""
    resolution, samples = resolution_of(increments), round(duration / CART_DT)
    phase = resolution * float(np.random.default_rng(seed).random())
    motion, counts = position_control(
        CART if schedule is None else schedule,
        steps(samples, CART_DT, STROKE, HOLD),
        CART_DT,
        kp=GAIN,
        kd=0.0,
        u_max=LARGEST,
        resolution=resolution,
        phase=phase,
    )
    return CartRecord(motion.u, counts, resolution)


def track(
    method: str, record: CartRecord, cutoff: float = CUTOFF, forgetting: float = FORGETTING, own: bool = False
) -> Track:
    """Return the estimates of a method with the paper's discretisation, or with `own` the matched one."""
    time_constant, options = 1 / (cutoff * CART_DT), dict[str, object](forgetting=forgetting)
    if not own:
        options["discretization"] = "paper"
    if method == EXTENDED:
        options["prefilter_zeros"] = default_zeros(cutoff)
    name = "rls" if method == EXTENDED else method
    estimator = make_estimator(name, record, time_constant, CART.input_gain, **options)
    if not isinstance(estimator, RecursiveEstimator):
        raise TypeError(f"{method} is not recursive")
    return estimator.run(record.u, record.counts)


def known_mass(estimates: Track) -> Floats:
    """Return the mass (n,) over time, nan before the first estimate."""
    return np.where(estimates.has_status(Status.STARTING), np.nan, estimates["mass"])


def mass_errors(method: str, records: list[CartRecord], cutoff: float, own: bool = False) -> tuple[float, float]:
    """Return mean and scatter of the error of the mass [%] over the second half of all records."""
    errors = [known_mass(track(method, record, cutoff, own=own))[record.u.size // 2 :] for record in records]
    percent = 100 * (np.concatenate(errors) / CART.mass - 1)
    return float(np.nanmean(percent)), float(np.nanstd(percent))
