"""Identification of a drive's physical parameters from its input and a coarse encoder, while the drive runs."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from pmfid.lazy_imports import make_getattr, read_names

if TYPE_CHECKING:
    from pmfid import fleet as fleet
    from pmfid._estimate import Estimate as Estimate
    from pmfid.edge_times import sample_edges as sample_edges
    from pmfid.encoder import Encoder as Encoder
    from pmfid.encoder import quantize as quantize
    from pmfid.errors import NotIdentifiableError as NotIdentifiableError
    from pmfid.errors import PmfidError as PmfidError
    from pmfid.errors import UsageError as UsageError
    from pmfid.estimators.edges import EdgeFit as EdgeFit
    from pmfid.estimators.fleet import Fleet as Fleet
    from pmfid.estimators.iv import IV as IV
    from pmfid.estimators.iv import RIV as RIV
    from pmfid.estimators.known import Known as Known
    from pmfid.estimators.ls import BCLS as BCLS
    from pmfid.estimators.ls import LS as LS
    from pmfid.estimators.motion_fit import MotionFit as MotionFit
    from pmfid.estimators.recursive import BCRLS as BCRLS
    from pmfid.estimators.recursive import RLS as RLS
    from pmfid.estimators.redge import REdge as REdge
    from pmfid.estimators.results import Fit as Fit
    from pmfid.estimators.results import Track as Track
    from pmfid.estimators.results import Tracks as Tracks
    from pmfid.estimators.srivc import SRIVC as SRIVC
    from pmfid.export.firmware import export_firmware as export_firmware
    from pmfid.findings import Finding as Finding
    from pmfid.linear.experiment import Experiment as Experiment
    from pmfid.linear.process import Process as Process
    from pmfid.models.drive import Drive as Drive
    from pmfid.models.drive import EquationModel as EquationModel
    from pmfid.models.equation import Equation as Equation
    from pmfid.models.equation import Term as Term
    from pmfid.models.shapes import Along as Along
    from pmfid.models.shapes import Square as Square
    from pmfid.models.shapes import Stribeck as Stribeck
    from pmfid.models.shapes import Wave as Wave
    from pmfid.models.transfer_function import TransferFunction as TransferFunction
    from pmfid.pipeline.arrays import check as check
    from pmfid.pipeline.arrays import identify as identify
    from pmfid.pipeline.arrays import search_terms as search_terms
    from pmfid.pipeline.arrays import validate as validate
    from pmfid.pipeline.friction import friction_curve as friction_curve
    from pmfid.pipeline.result import Result as Result
    from pmfid.pipeline.terms import TermSearch as TermSearch
    from pmfid.pipeline.validation import Validation as Validation
    from pmfid.status import Status as Status

#: The module that defines each public name. A module is imported when a name is first used, so that `pmfid --help`
#: starts quickly.
_PUBLIC = read_names(__file__)
_load = make_getattr(__name__, _PUBLIC)

__version__ = "0.1.0"
__all__ = sorted(_PUBLIC)


if not TYPE_CHECKING:  # a type checker would accept every misspelt name

    def __getattr__(name: str) -> object:
        return import_module("pmfid.fleet") if name == "fleet" else _load(name)


def __dir__() -> list[str]:
    return list(__all__)
