"""The predicted errors of two masses, and what inputs show."""

from __future__ import annotations

import numpy as np

import pmfid
from pmfid.fit.prediction import predict_errors
from pmfid.models.controllers import MotorAndLoad
from pmfid.simulation import quantize
from tests.oracles.two_mass import TwoMasses, simulate_two_masses
from tests.refusals import refused

BELT = MotorAndLoad(2e-4, 4e-4, 0.01, 3e-4, 6e-4, 0.015, 4.55, 0.0014, rotary=True)
DT, STEP = 0.001, 2 * np.pi / 512


def binary(samples: int, seed: int = 1) -> np.ndarray:
    return 0.15 * np.repeat(np.random.default_rng(seed).choice([-1.0, 1.0], samples // 12 + 1), 12)[:samples]


def test_a_fit_of_each_count_is_better_than_predicted() -> None:
    u = binary(1500)
    truth = simulate_two_masses(TwoMasses(*list(vars(BELT).values())[:-1]), u, DT, np.zeros(4))[:-1, 0]
    drive = pmfid.Drive(1.0, axis="rotary", body="two-mass")
    found = pmfid.identify(u, quantize(truth, STEP), model=drive, dt=DT, encoder=pmfid.Encoder(STEP))
    predicted = np.array(list(predict_errors(BELT, u, DT, STEP).values()))
    ratio = found.theta_std / found.theta / predicted
    assert np.all((ratio > 0.05) & (ratio < 1.0)), ratio


def test_slow_motion_does_not_show_the_spring() -> None:
    t = DT * np.arange(4000)
    slow, fast = (predict_errors(BELT, u, DT, STEP)["stiffness"] for u in (0.15 * np.sin(2 * np.pi * t), binary(4000)))
    assert slow > 50 * fast


def test_wrong_arguments_are_refused() -> None:
    refused(("an input", lambda: predict_errors(BELT, [np.nan, 1.0], DT, STEP)))
