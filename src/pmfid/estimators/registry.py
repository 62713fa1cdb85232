"""Registry of every estimator by name. A new estimator adds one line."""

from __future__ import annotations

from pmfid.estimators.base import Estimator
from pmfid.estimators.iv import IV, RIV
from pmfid.estimators.ls import BCLS, LS
from pmfid.estimators.motion_fit import MotionFit
from pmfid.estimators.recursive import BCRLS, RLS
from pmfid.estimators.srivc import SRIVC
from pmfid.models.drive import Model

#: Off-line methods for a drive.
OFF_LINE = (LS, BCLS, IV, MotionFit)
RECURSIVE = (RLS, BCRLS, RIV)
#: Methods for a linear process alone.
PROCESS_ONLY = (SRIVC,)
ESTIMATORS: dict[str, type[Estimator]] = {cls.method: cls for cls in (*OFF_LINE, *RECURSIVE, *PROCESS_ONLY)}


def methods_for(model: Model) -> list[str]:
    """Return the names of the methods that take this model."""
    return [name for name, cls in ESTIMATORS.items() if not cls.refuses(model.equation)]
