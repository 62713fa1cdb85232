"""Recursions from counts alone: standard errors contain the late direction and the encoder's noise."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest

from pmfid import Drive, Encoder, Status
from studies.honest_recursions import FORGETTING, METHODS, MOTIONS, TIME_CONSTANT, bench, record, verdict

#: Machines that the study does not have.
NUMBERS = (103, 104)


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("method", METHODS)
def test_hardly_any_sample_is_silently_wrong(method: str, motion: str) -> None:
    runs = [verdict(method, motion, increments, number) for increments in (4096, 256) for number in NUMBERS]
    assert np.mean([run.silent for run in runs]) < 0.005


@pytest.mark.parametrize("motion", ["prbs", "trapezoids"])
@pytest.mark.parametrize("method", ["rls", "bcrls"])
def test_right_estimates_are_not_doubted(method: str, motion: str) -> None:
    runs = [verdict(method, motion, 1024, number) for number in NUMBERS]
    assert np.mean([run.doubted for run in runs]) < 0.05


def test_least_squares_of_noise_are_flagged() -> None:
    """Until the first switch of a coarse random input, the acceleration is noise and the innovations vanish."""
    from pmfid import RLS

    one = bench(6)
    run = record(one, "prbs", 64, 6)
    rls = RLS(Drive(one.drive.input_gain), Encoder(run.resolution), one.dt, 1 / (3 * one.dt), forgetting=0.998)
    track = rls.run(run.u[:137], run.counts[:137])
    assert track["mass"][-1] < 0.1 * one.drive.mass
    assert track.has_status(Status.POOR_EXCITATION)[-1]


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("method", ["rls", "bcrls"])
def test_a_mass_within_three_standard_errors_of_zero_is_flagged(
    method: str, precision: Literal["float64", "float32"]
) -> None:
    """Control through a coarse encoder hides the mass, and its standard error then contains zero."""
    machine = bench(103)
    run = record(machine, "trapezoids", 64, 103)
    encoder, drive = Encoder(run.resolution), Drive(machine.drive.input_gain)
    pole = 1 / (TIME_CONSTANT * machine.dt)
    recursion = METHODS[method](drive, encoder, machine.dt, pole, forgetting=FORGETTING, precision=precision)
    track = recursion.run(run.u, run.counts)
    unknown = np.isfinite(track.theta_std[:, 0]) & (track["mass"] < 2.99 * track.theta_std[:, 0])
    assert np.mean(unknown) > 0.5
    assert np.mean(unknown & (track.status == 0)) < 0.001
