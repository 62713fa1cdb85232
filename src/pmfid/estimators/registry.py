"""Every estimator under its name; a new one adds a line here."""

from __future__ import annotations

from pmfid.estimators.base import Estimator
from pmfid.estimators.batch import BCLS, LS
from pmfid.estimators.bcrls import BCRLS
from pmfid.estimators.iv import IV, RIV
from pmfid.estimators.rls import RLS

ESTIMATORS: dict[str, type[Estimator]] = {cls.method: cls for cls in (LS, BCLS, IV, RLS, BCRLS, RIV)}
