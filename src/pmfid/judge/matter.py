"""Does it matter? What is found becomes a status only where it may move a parameter by more than is tolerated.

A finding says that something is wrong; how wrong the numbers may be for it is in their interval. So both are held
against each other here, and nowhere else: what stays within the tolerance, or within the noise, is a note.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from pmfid.estimators.base import Estimator
from pmfid.findings import Finding, sort_findings
from pmfid.types import Floats

#: Relative error of a parameter that is of no matter.
TOLERANCE = 0.01
#: Standard deviations within which 95 % of a normal variable are, to either side; standard errors within which an error
#: is noise.
NORMAL_95, NOISE_LIMIT = 1.96, 3.0
#: What says that the parameters may be further off than their standard deviations.
OF_MODEL = frozenset({"unmodelled", "dead_time", "model_spread", "feedback", "biased", "std_too_small"})
#: What costs nothing where the model explains the record.
OF_LOG = frozenset({"held_input", "saturated"})


@dataclass(frozen=True)
class Matter:
    """How far the parameters may be off. name: of the one that is worst; part: half its interval, in parts of its size;
    beyond: is any of them beyond the tolerance and the noise?"""

    name: str
    part: float
    beyond: bool

    @property
    def says(self) -> str:
        """How much it is, for people."""
        return f"{self.name} may be {100 * self.part:.2g} % off" if np.isfinite(self.part) else ""


def matter_of(estimator: Estimator, theta: Floats, std: Floats, spread: Floats, tolerance: float) -> Matter:
    """Of an estimate theta (p,) with standard deviations std (p,); spread (p,): by how much unmodelled
    effects that the record shows may move it. NaN: not known, and then the effects matter."""
    p = len(estimator.equation.names)
    half, size = NORMAL_95 * np.hypot(std[:p], spread[:p]), sizes(estimator, theta[:p])
    beyond = ~(half <= np.maximum(tolerance * size, NOISE_LIMIT * std[:p]))
    with np.errstate(divide="ignore", invalid="ignore"):
        part = half / size
    worst = int(np.argmax(np.where(np.isnan(part), -1.0, part * np.where(beyond, 1.0, 1e-9))))
    return Matter(estimator.names[worst], float(part[worst]), bool(np.any(beyond)))


def sizes(estimator: Estimator, theta: Floats) -> Floats:
    """(p,) what an error of each parameter theta (p,) is a part of: its own size, and of one that may have either sign,
    as a load, which may be none, the largest size in its unit."""
    own, units = np.abs(theta), np.array(estimator.equation.units)
    largest = np.array([np.max(own[units == unit]) for unit in units])
    return np.where(estimator.equation.positive, own, largest)


def weigh_findings(findings: Iterable[Finding], matter: Matter) -> tuple[Finding, ...]:
    """The same findings, each that is about the model with the size of it, or as a note where that is of no matter."""
    return sort_findings(_weigh_finding(finding, matter) for finding in findings)


def _weigh_finding(finding: Finding, matter: Matter) -> Finding:
    if finding.severity != "doubt" or finding.code not in OF_MODEL | OF_LOG:
        return finding
    if not matter.beyond:
        return replace(finding, severity="note")
    if finding.code in OF_LOG or not matter.says:
        return finding
    return replace(finding, sentence=f"{finding.sentence}; {matter.says}")
