"""If a record does not show the mass, no method that simulates the whole record may invent one."""

import numpy as np
import pytest

import pmfid
from pmfid.errors import NotIdentifiableError
from pmfid.estimators.output_error import OE, IntervalML
from pmfid.simulation import DriveParameters, Machine, drive_machine

INERTIA, DT = 1.6e-4, 0.01


def chirp(viscous: float, top: float, increments: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Return input, counts and resolution of a small rotary axis under a slow chirp.

    Friction hides its inertia, and the input is logged one sample late.
    """
    t = np.arange(600) * DT
    u = 0.3 * np.sin(2 * np.pi * (0.05 * t + (top - 0.05) * t**2 / 2 / t[-1]))
    step = 2 * np.pi / increments
    run = drive_machine(Machine(DriveParameters(INERTIA, viscous, 0.02, 0.4)), u, DT, step, phase=0.4 * step)
    return np.r_[0.0, u[:-1]], run.counts, step


@pytest.mark.parametrize("cls", [OE, IntervalML])
@pytest.mark.parametrize(("viscous", "top", "increments"), [(0.02, 2.0, 256), (0.03, 1.0, 1024)])
def test_a_mass_at_its_bound_is_no_estimate(cls, viscous, top, increments):
    u, counts, step = chirp(viscous, top, increments)
    method = cls(pmfid.Drive(0.4), pmfid.Encoder(step), DT, 20.0)
    start = np.array([60.0 * INERTIA, viscous, 0.02])  # instrumental variables do not converge here and leave any start
    with pytest.raises(NotIdentifiableError, match="mass"):
        method.make_least_squares_fit(method.best(u, counts, start)) if cls is OE else method.fit_of(
            method.best(u, counts, start)
        )


def test_a_small_mass_that_the_record_carries_is_one():
    u, counts, step = chirp(0.02, 2.0, 4096)
    method = OE(pmfid.Drive(0.4), pmfid.Encoder(step), DT, 20.0)
    true = np.r_[u[1:], 0.0]
    fit = method.make_least_squares_fit(method.best(true, counts, np.array([12.0 * INERTIA, 0.02, 0.02])))
    assert fit["mass"] == pytest.approx(INERTIA, rel=0.05)
