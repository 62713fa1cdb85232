"""The conclusion from a result for people: what the plant is, how sure that is, and what to do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pmfid.diagnostics.matter import OF_LOG, sizes
from pmfid.findings import MOVE, Finding
from pmfid.fit.compare import NORMAL_95
from pmfid.pipeline.result import ProcessResult, Result, format_value


@dataclass(frozen=True)
class Conclusion:
    """A sentence on the plant, an instruction for the user, and the word of the status that the instruction is for.

    `word` is empty without a status.
    """

    sentence: str
    action: str
    word: str = ""


def conclude(result: Result) -> Conclusion:
    """Return the conclusion from a result."""
    doubts = [finding for finding in result.findings if finding.severity != "note"]
    grade = "Wrong" if any(one.severity == "wrong" for one in doubts) else "Doubtful" if doubts else "Good"
    says = _describe_process(result) if isinstance(result, ProcessResult) else _describe_machine(result)
    if doubts:
        first = _most_useful(doubts)
        return Conclusion(f"{grade}: {says}.", f"Do this first: {_advise(first)}.", first.code)
    left = next((finding.remedy for finding in result.findings if finding.code == "to_do"), "")
    if left:
        return Conclusion(f"Incomplete: {says}.", f"Do this first: {left}.")
    wide = next((finding.remedy for finding in result.findings if finding.code == "model_spread"), MOVE)
    action = f"pmfid validate tests the model on another record. If an interval is too wide, {wide}."
    return Conclusion(f"{grade}: {says}.", action)


def _most_useful(doubts: list[Finding]) -> Finding:
    """Return the finding whose remedy comes first. A finding on the model is more useful than one on the log."""
    worst = [finding for finding in doubts if finding.severity == doubts[0].severity]
    return min(worst, key=lambda finding: (finding.code in OF_LOG, not finding.remedy))


def _advise(finding: Finding) -> str:
    return (finding.remedy or f"read the output of pmfid explain {finding.code}").rstrip(".")


def _describe_process(result: ProcessResult) -> str:
    poles = len(result.process.poles)
    known = f"explains the output with a {result.fit_text}" if result.fit is not None else "is unstable"
    return f"a transfer function with {poles} pole{'s' * (poles != 1)} {known}"


def _describe_machine(result: Result) -> str:
    """Return the mass, how sure it is, and the least sure parameter."""
    leading = result.estimator.equation.leading
    spread = 0.0 if result.model_spread is None else np.nan_to_num(result.model_spread)  # unknown: errors alone
    half, size = NORMAL_95 * np.hypot(result.theta_std, spread), sizes(result.estimator, result.theta)
    with np.errstate(divide="ignore", invalid="ignore"):
        part = half / size
    name, unit = result.names[leading], result.units[leading]
    value = format_value(float(result.theta[leading]), float(half[leading]) / 2)
    says = f"{name} {value} {unit} {_format_part(float(part[leading]))}"
    others = [index for index in range(result.theta.size) if index != leading]
    if not others:
        return f"{says} (95 % interval)"
    worst = max(others, key=lambda index: np.inf if np.isnan(part[index]) else part[index])
    rest = f"the least certain other parameter is {result.names[worst]} {_format_part(float(part[worst]))}"
    return f"{says}; {rest} (95 % intervals)"


def _format_part(part: float) -> str:
    if np.isnan(part):
        return "± an unknown part"
    return f"± {100 * part:.2g} %" if part < 1 else "± over 100 %"
