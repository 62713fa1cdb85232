"""Flags of an estimate, and the rule that decides whether a finding matters."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from pmfid.diagnostics.tuning import TUNING
from pmfid.estimators.base import Estimator
from pmfid.findings import Finding, sort_findings
from pmfid.types import Floats

#: The meaning and the remedy of each flag.
FLAGS = {
    "model_spread": (
        "Stribeck friction or a dead time would not show in this record, and would move a parameter beyond its "
        "standard error and the tolerance. Of a transfer function, the record does not show the hold of its input."
    ),
    "unseen": (
        "effects that this motion cannot show, such as a dead zone under an input of one size, widen the intervals: "
        "record an input of several sizes"
    ),
    "biased": "the method has an error of its own here, beyond its standard error; the note has the better number",
    "std_too_small": "the standard error leaves out the method's own error; the note says how large that is",
    "not_followed": "the simulated motion does not follow the record: the model, a sign or a column is wrong",
    "prior_contradicted": (
        "what is known beforehand and the record are three standard deviations apart, or more: one of them is wrong"
    ),
    "uncertain": "a parameter is not known to half its value: excite it more, or use a simpler model",
    "implausible": "a parameter is negative that never is in a machine: check sign and scale of input and encoder",
    "coarse_motion": "the axis moves less than a count per sample, and this method needs more: use iv",
    "unstable": (
        "a pole is in the right half-plane, and no controller is known to hold it: set unstable = true if one does"
    ),
    "ambiguous_term": "two terms explain the record alike: record a motion that tells them apart",
    "unresolved": "no term that was searched explains all that the record shows",
    "reversed": "the output has the opposite sign of the input: turn one of them",
    "exchanged": "the columns of input and output are exchanged: name each by what it is",
    "gravity": "gravity turns the load of a rotary axis, and the model has none: set gravity = true in [model]",
    "velocity": "the output is a velocity and is read as a position: say so by output_kind, or integrate it",
    "wrapped": "the counter restarts at the end of its range, and nothing has undone that: give bits, or range",
    "stuck": "the output stands still while the axis goes on: the counter, or what reads it, was stuck",
    "clipped": "the output ends while the axis goes on: the range of the counter or the sensor ends there",
    "saturated": "the input stays at its largest or smallest value: right where the drive gave no more, else cut off",
    "held_output": "the output is read more slowly than the record: keep only the rows with a new value",
    "held_input": "the input changes only every few rows: log it at the rate of the drive, unless that holds it",
    "unsigned": "the input has no sign, but the axis reverses under load: log the force or current with its sign",
    "command": "the input is a command: a set point is no force, and a drive may give another torque than asked for",
    "refused": "pmfid identify gives no estimate of this record, for this reason",
    "little_motion": "the axis moves too little, or too evenly, to tell anything: record reversals and varying speed",
    "rate_low": "the velocity changes by too much from row to row: record at a shorter sample period",
    "rate_high": "nearly all rows are without a count: keep every few of them, with the mean of the input",
    "uneven_clock": "the steps differ, and the record was resampled for this method: log at a fixed rate",
    "drift": "input and output are of two clocks: log both by one",
}

#: Flags of a model whose parameters may be wrong by more than their standard deviations.
OF_MODEL = frozenset({"unmodelled", "dead_time", "model_spread", "feedback", "biased", "std_too_small"})
#: Flags of the log, which matter only if the model does not explain the record.
OF_LOG = frozenset({"held_input", "saturated"})


def is_small_doubt(finding: Finding) -> bool:
    """Return whether a finding is a doubt about the model that is too small for the status and for the terminal."""
    return finding.severity == "note" and finding.code in OF_MODEL


@dataclass(frozen=True)
class Matter:
    """The size of the possible error of the parameters.

    `name` is the worst parameter, and `part` is half of its interval relative to its size. `beyond` says whether the
    error of any parameter exceeds both the tolerance and the noise.
    """

    name: str
    part: float
    beyond: bool

    @property
    def says(self) -> str:
        """The size of the possible error as a sentence."""
        if not np.isfinite(self.part):
            return ""
        return f"{self.name} may be {f'{100 * self.part:.2g} %' if self.part < 1 else 'over 100 %'} off"


def matter_of(estimator: Estimator, theta: Floats, std: Floats, spread: Floats, tolerance: float) -> Matter:
    """Return how much an estimate theta (p,) with standard deviations std (p,) may be wrong.

    `spread` (p,) is the shift that the visible unmodelled effects may cause. A NaN in `spread` stands for an unknown
    shift, which always matters.
    """
    p = len(estimator.equation.names)
    half, size = TUNING.normal_95 * np.hypot(std[:p], spread[:p]), sizes(estimator, theta[:p])
    beyond = ~(half <= np.maximum(tolerance * size, TUNING.noise_limit * std[:p]))
    with np.errstate(divide="ignore", invalid="ignore"):
        part = half / size
    worst = int(np.argmax(np.where(np.isnan(part), -1.0, part * np.where(beyond, 1.0, 1e-9))))
    return Matter(estimator.names[worst], float(part[worst]), bool(np.any(beyond)))


def sizes(estimator: Estimator, theta: Floats) -> Floats:
    """Return the size (p,) to which the error of each parameter in theta (p,) is relative.

    A positive parameter is compared with its own size. A parameter of either sign, such as a load, may be zero. A
    parameter of either sign is therefore compared with the largest parameter of its unit.
    """
    own, units = np.abs(theta), np.array(estimator.equation.units)
    largest = np.array([np.max(own[units == unit]) for unit in units])
    return np.where(estimator.equation.positive, own, largest)


def weigh_findings(findings: Iterable[Finding], matter: Matter) -> tuple[Finding, ...]:
    """Return the findings, with the size of the possible error in each finding on the model.

    A finding on the model becomes a note if the error does not matter.
    """
    return sort_findings(_weigh_finding(finding, matter) for finding in findings)


def _weigh_finding(finding: Finding, matter: Matter) -> Finding:
    if finding.severity != "doubt" or finding.code not in OF_MODEL | OF_LOG:
        return finding
    if not matter.beyond:
        return replace(finding, severity="note")
    if finding.code in OF_LOG or not matter.says:
        return finding
    return replace(finding, sentence=f"{finding.sentence}; {matter.says}")
