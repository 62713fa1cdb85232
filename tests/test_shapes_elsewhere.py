"""Models with forces of a given form in designs and checks of estimators."""

from __future__ import annotations

import pytest

import pmfid
from pmfid.design.problem import check_parameters
from pmfid.testing import check_estimator


class Posed:
    """A minimal problem with only the part that is examined first."""

    drive = pmfid.Drive(2.0, stribeck=0.02)


def test_a_design_says_that_it_cannot() -> None:
    with pytest.raises(pmfid.UsageError, match="a design for stribeck_friction is not supported yet; leave that out"):
        check_parameters(Posed())  # type: ignore[arg-type]


def test_a_made_up_record_is_not_made_for_it() -> None:
    with pytest.raises(pmfid.UsageError, match=r"give check_estimator a record"):
        check_estimator(pmfid.RIV(Posed.drive, pmfid.Encoder(1e-4), 1e-3, 30.0))
