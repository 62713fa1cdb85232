"""Models with forces of a given form in designs, checks of estimators, and force balances."""

from __future__ import annotations

import numpy as np
import pytest

import pmfid
from pmfid.design.problem import check_parameters
from pmfid.diagnostics.balance import make_balance
from pmfid.testing import check_estimator
from tests.test_shapes import made, model, truth


class Posed:
    """A minimal problem with only the part that is examined first."""

    drive = pmfid.Drive(2.0, stribeck=0.02)


def test_a_design_says_that_it_cannot() -> None:
    with pytest.raises(pmfid.UsageError, match="a design for stribeck_friction is not supported yet; leave that out"):
        check_parameters(Posed())  # type: ignore[arg-type]


def test_a_made_up_record_is_not_made_for_it() -> None:
    with pytest.raises(pmfid.UsageError, match=r"give check_estimator a record"):
        check_estimator(pmfid.RIV(Posed.drive, pmfid.Encoder(1e-4), 1e-3, 30.0))


@pytest.mark.parametrize("speed", ["given", "estimate"])
def test_the_force_balance_knows_its_friction(speed: str) -> None:
    """The Stribeck speed may also be an estimate, which follows the other parameters."""
    run, machine, case = made("cart", 4, stribeck=0.5)
    own = model(machine, stribeck=machine.stribeck_speed if speed == "given" else speed)
    estimator = pmfid.MotionFit(own, pmfid.Encoder(case.resolution), case.dt, case.cutoff)
    theta = truth(machine, estimator.names)
    balance = make_balance(estimator, run.u, run.counts, theta)
    assert balance is not None
    at = machine.stribeck_speed * np.array([-5.0, -0.5, 0.5, 5.0])
    drive = machine.drive
    size = drive.coulomb_friction + machine.stribeck * np.exp(-((at / machine.stribeck_speed) ** 2))
    wanted = np.sign(at) * size + drive.viscous_friction * at
    np.testing.assert_allclose(balance.model_friction(at), wanted, rtol=2e-3)
