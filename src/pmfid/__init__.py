"""Identification of a drive's physical parameters from its input and a coarse encoder, while the drive runs."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

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
_PUBLIC = {
    "BCLS": "pmfid.estimators.ls",
    "BCRLS": "pmfid.estimators.recursive",
    "Drive": "pmfid.models.drive",
    "EdgeFit": "pmfid.estimators.edges",
    "Encoder": "pmfid.encoder",
    "Equation": "pmfid.models.equation",
    "EquationModel": "pmfid.models.drive",
    "Term": "pmfid.models.equation",
    "Along": "pmfid.models.shapes",
    "Square": "pmfid.models.shapes",
    "Stribeck": "pmfid.models.shapes",
    "Wave": "pmfid.models.shapes",
    "Estimate": "pmfid._estimate",
    "Fit": "pmfid.estimators.results",
    "Finding": "pmfid.findings",
    "Fleet": "pmfid.estimators.fleet",
    "IV": "pmfid.estimators.iv",
    "REdge": "pmfid.estimators.redge",
    "RIV": "pmfid.estimators.iv",
    "Known": "pmfid.estimators.known",
    "LS": "pmfid.estimators.ls",
    "MotionFit": "pmfid.estimators.motion_fit",
    "NotIdentifiableError": "pmfid.errors",
    "PmfidError": "pmfid.errors",
    "RLS": "pmfid.estimators.recursive",
    "SRIVC": "pmfid.estimators.srivc",
    "Experiment": "pmfid.linear.experiment",
    "Process": "pmfid.linear.process",
    "Status": "pmfid.status",
    "TransferFunction": "pmfid.models.transfer_function",
    "Track": "pmfid.estimators.results",
    "Tracks": "pmfid.estimators.results",
    "Result": "pmfid.pipeline.result",
    "UsageError": "pmfid.errors",
    "check": "pmfid.pipeline.arrays",
    "friction_curve": "pmfid.pipeline.friction",
    "export_firmware": "pmfid.export.firmware",
    "identify": "pmfid.pipeline.arrays",
    "quantize": "pmfid.encoder",
    "sample_edges": "pmfid.edge_times",
    "search_terms": "pmfid.pipeline.arrays",
    "TermSearch": "pmfid.pipeline.terms",
    "validate": "pmfid.pipeline.arrays",
    "Validation": "pmfid.pipeline.validation",
}

__version__ = "0.1.0"
__all__ = sorted(_PUBLIC)


if not TYPE_CHECKING:  # a type checker would accept every misspelt name

    def __getattr__(name: str) -> object:
        if name == "fleet":
            return import_module("pmfid.fleet")
        if name not in _PUBLIC:
            from pmfid.errors import did_you_mean

            raise AttributeError(f"module 'pmfid' has no attribute {name!r}{did_you_mean(name, _PUBLIC)}")
        value = getattr(import_module(_PUBLIC[name]), name)
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return list(__all__)
