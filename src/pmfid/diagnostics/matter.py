"""Flags of an estimate, and the rule that decides whether a finding matters."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from pmfid.estimators.base import Estimator
from pmfid.estimators.known import CONTRADICTED
from pmfid.findings import Finding, sort_findings
from pmfid.fit.compare import NORMAL_95
from pmfid.types import Floats

#: The meaning and the remedy of each flag.
FLAGS = {
    "model_spread": (
        "This record cannot exclude Stribeck friction or a dead time that moves a parameter by more than its standard "
        "error and the tolerance. For a transfer function, the record does not show the hold of the input."
    ),
    "two_mass": (
        "a second mass on a spring explains the record better, and the inertia of the rigid axis is not that of both: "
        'set body = "two-mass" in [model]'
    ),
    "biased": "this method has an error beyond its standard error on this record; the note gives a better value",
    "std_too_small": "the standard error does not contain the error of the method itself; the note gives its size",
    "prior_contradicted": (
        "prior information and record are at least three standard deviations apart: correct the prior, or the "
        "record's columns and units"
    ),
    "uncertain": "the error of a parameter may exceed half its value: excite the axis more, or use a simpler model",
    "implausible": "a parameter is negative, which is impossible in a machine: check sign and scale of input "
    "and encoder",
    "unstable": ("a pole is in the right half-plane: set unstable = true if a controller holds the process"),
    "reversed": "the output has the opposite sign of the input: reverse one of them",
    "exchanged": "the columns of input and output are exchanged: exchange input and output in [record]",
    "velocity": 'the output is a velocity, read as a position: set output_kind = "velocity", or integrate it',
    "wrapped": "the counter restarts at the end of its range: give [encoder] bits or range",
    "stuck": "the output stays constant while the axis moves on: check the counter and its reading",
    "clipped": (
        "the output stays at a limit while the axis moves on: record a motion within the range of the counter or sensor"
    ),
    "saturated": "the input stays at its largest or smallest value: if the drive gave more, log a larger range",
    "held_output": "the output changes more slowly than the rows are logged: keep only the rows with a new value",
    "held_input": "the input changes only every few rows: log it at the drive's rate, unless the drive holds it",
    "unsigned": "the input has no sign, but the axis reverses: log the force or current with its sign",
    "command": "the input is a command, and the drive may give other torque: log the measured torque or current",
    "refused": "pmfid identify gives no estimate for this record; the finding gives the reason",
    "little_motion": "the axis moves too little or too evenly: record reversals and varying speed",
    "rate_low": "the velocity changes too much from row to row: record at a shorter sample period",
    "odd_period": "no machine moves like this at this sample period: give dt in s",
    "rate_high": "nearly all rows repeat the last count: keep every n-th row, with the mean input up to the next one",
    "uneven_clock": "the clock drifts, and the record does not show which clock is right: log the times of the samples",
}

#: Flags of a model whose parameters may be wrong by more than their standard deviations.
OF_MODEL = frozenset({"unmodelled", "two_mass", "dead_time", "model_spread", "feedback", "biased", "std_too_small"})
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
    half, size = NORMAL_95 * np.hypot(std[:p], spread[:p]), sizes(estimator, theta[:p])
    beyond = ~(half <= np.maximum(tolerance * size, CONTRADICTED * std[:p]))
    with np.errstate(divide="ignore", invalid="ignore"):
        part = half / size
    worst = int(np.argmax(np.where(np.isnan(part), -1.0, part * np.where(beyond, 1.0, 1e-9))))
    return Matter(estimator.names[worst], float(part[worst]), bool(np.any(beyond)))


def sizes(estimator: Estimator, theta: Floats) -> Floats:
    """Return the size (p,) to which the error of each parameter in theta (p,) is relative.

    A positive parameter is compared with its own size. A parameter of either sign, such as a load, may be zero. A
    parameter of either sign is therefore compared with the largest parameter of its unit. A parameter beyond those of
    the equation is compared with its own size.
    """
    own, units = np.abs(theta), np.array(estimator.equation.units)
    p = units.size
    largest = np.array([np.max(own[:p][units == unit]) for unit in units])
    return np.asarray(np.maximum(np.append(np.where(estimator.equation.positive, own[:p], largest), own[p:]), 1e-150))


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
