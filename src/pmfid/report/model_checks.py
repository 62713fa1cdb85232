"""Does the model fit the record? Simulation from the input alone, and what the force balance leaves, in the report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from matplotlib.figure import Figure

from pmfid.errors import PmfidError
from pmfid.judge.balance import Balance, average_in_bins, encoder_response
from pmfid.judge.correlations import make_balance
from pmfid.judge.drive import MEMORIES
from pmfid.judge.sentences import (
    correlation_sentence,
    friction_sentence,
    residual_sentence,
    simulation_sentence,
)
from pmfid.report.check_figures import correlation_figure, friction_figure, residual_figure, simulation_figure
from pmfid.report.html import Section, svg
from pmfid.session.result import DriveResult

__all__ = [
    "average_in_bins",
    "correlation_figure",
    "encoder_response",
    "friction_figure",
    "model_checks",
    "residual_figure",
    "simulation_figure",
]


def model_checks(result: DriveResult) -> list[Section]:
    """Sections on the fit of the model at the result's theta; of a recursive method the last one.

    With a forgetting factor below 1 only the last three memories of the record are judged. Where the parameters are
    none of a drive (a mass that is not positive), or nothing can be simulated, one section says so.
    """
    try:
        theta = result.theta[: len(result.estimator.names)]  # without a gain of the input that was found
        balance = make_balance(result.estimator, result.record.u, result.record.counts, theta)
    except PmfidError as error:
        return [Section("Model checks", f"Not possible here: {error}.")]
    if balance is None:
        return [Section("Model checks", "Not possible here: no motion can be simulated with these parameters.")]
    checks: tuple[tuple[str, Callable[[Balance], str], Callable[[Balance], Figure]], ...] = (
        ("Simulated from the input alone", simulation_sentence, simulation_figure),
        ("Residual over velocity and position", residual_sentence, residual_figure),
        ("Friction over velocity", friction_sentence, friction_figure),
        ("Correlation of the residual", correlation_sentence, correlation_figure),
    )
    sections = [
        Section(f"Model check: {heading}", say(balance), svg=svg(draw(balance))) for heading, say, draw in checks
    ]
    remarks = (_window(result, balance), _feedback(result, balance), "", "")
    return [replace(part, text=part.text + remark) for part, remark in zip(sections, remarks, strict=True)]


def _feedback(result: DriveResult, balance: Balance) -> str:
    if "feedback" not in result.status or not balance.noisy:
        return ""
    return (
        "\n\nThe input follows the residual in this record, and the encoder is coarse: then the encoder's own error "
        "differs with velocity and position, too. Look at a record in open loop before the model is changed."
    )


def _window(result: DriveResult, balance: Balance) -> str:
    if getattr(result.estimator, "forgetting", 1.0) == 1.0:
        return ""
    start, end = balance.t[0], balance.t[-1]
    return (
        f"\n\nAll model checks are from {start:.4g} s to {end:.4g} s, {MEMORIES:g} memories of the estimate, with its "
        "last value."
    )
