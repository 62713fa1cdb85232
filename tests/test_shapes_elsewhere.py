"""Models with forces of a given form in designs and checks of estimators."""

from __future__ import annotations

import pmfid
from pmfid.design.problem import check_parameters
from pmfid.testing import check_estimator
from tests.refusals import refused


class Posed:
    """A minimal problem with only the part that is examined first."""

    drive = pmfid.Drive(2.0, stribeck=0.02)


def test_a_design_and_a_made_up_record_say_that_they_cannot() -> None:
    estimator = pmfid.RIV(Posed.drive, pmfid.Encoder(1e-4), 1e-3, 30.0)
    refused(
        ("a design for stribeck_friction is not supported yet; leave that out", lambda: check_parameters(Posed())),
        ("give check_estimator a record", lambda: check_estimator(estimator)),
    )
