"""The section of a report on the checks of the model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pmfid.diagnostics.balance import (
    Balance,
    Binned,
    average_in_bins,
    correlation_sentence,
    correlations,
    encoder_response,
    friction_sentence,
    make_balance,
    residual_sentence,
    simulation_sentence,
)
from pmfid.diagnostics.tuning import TUNING as DIAGNOSTIC_TUNING
from pmfid.errors import PmfidError
from pmfid.pipeline.result import DriveResult
from pmfid.report.figures import COLOURS, GREY, MAGENTA, decimation, open_figure
from pmfid.report.html import Section, svg
from pmfid.report.tuning import TUNING
from pmfid.types import Floats


def followed_figure(
    t: Floats, signals: tuple[Floats, Floats], output: str, error: Floats, left: str, shaded: float = 0.0
) -> Figure:
    """Draw the measured and the simulated output (n,) over time t (n,) [s], with an error (n,) below.

    `output` and `left` are the labels of output and error. `shaded` is the time [s] of the first samples, to which the
    start of the simulation was fitted.
    """
    with open_figure(4.4, 2, sharex=True, height_ratios=(3, 2)) as (figure, (upper, lower)):
        for signal, label, style in zip(signals, ("measured", "simulated"), ("-", "--"), strict=True):
            i = decimation(signal)
            upper.plot(t[i], signal[i], style, lw=0.9, label=label)
        upper.set_ylabel(output)
        upper.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=2, borderaxespad=0.2)
        i = decimation(error)
        lower.plot(t[i], error[i], color=COLOURS[2])
        if shaded:
            lower.axvspan(t[0], t[0] + shaded, color=GREY, alpha=0.3, lw=0)
        lower.set_ylabel(left)
        lower.set_xlabel("time [s]" + (" (the fit of the start uses the shaded part)" if shaded else ""))
        lower.margins(x=0)
    return figure


def simulation_figure(balance: Balance) -> Figure:
    """Draw the measured and the simulated filtered velocity, and the difference of the positions, over time."""
    followed = balance.measured, balance.simulated
    own = balance.estimator.equation.motion
    left = f"position, measured\nless simulated [{own.travel}]"
    return followed_figure(balance.t, followed, f"filtered velocity [{own.speed}]", balance.drift, left)


def residual_figure(balance: Balance) -> Figure:
    """Draw the residual over velocity and position, as samples and as means with two standard errors."""
    own = balance.estimator.equation.motion
    with open_figure(3.4, 1, 2, sharey=True) as (figure, panels):
        views = (
            (balance.velocity, balance.residual, balance.by_velocity, f"filtered velocity [{own.speed}]"),
            (balance.position, balance.beside_velocity, balance.by_position, f"filtered position [{own.travel}]"),
        )
        for axes, (x, force, found, label) in zip(panels, views, strict=True):
            _dots(axes, x, force)
            _means(axes, found, found.mean)
            axes.set_xlabel(label)
        panels[0].set_ylabel(f"residual [{own.force}]")
        panels[1].set_ylabel(f"less its mean at the velocity [{own.force}]")
        _limits(panels[0], balance.residual)
        panels[0].legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=2, borderaxespad=0.2)
    return figure


def friction_figure(balance: Balance) -> Figure:
    """Draw the measured friction force over velocity, with the line of the model."""
    own = balance.estimator.equation.motion
    with open_figure(3.8) as (figure, (axes,)):
        if balance.friction is not None:
            left = balance.friction.left
            _dots(axes, balance.friction.velocity, balance.friction.force)
            _means(axes, left, left.mean + balance.model_friction(left.x))
            _limits(axes, balance.friction.force)
        end = np.max(np.abs(balance.velocity)) * 1.02
        line = np.array([-end, -1e-9 * end, 1e-9 * end, end])
        axes.plot(line, balance.model_friction(line), color=MAGENTA, ls="--", label="model")
        axes.set_xlabel(f"filtered velocity [{own.speed}]")
        axes.set_ylabel(f"filtered friction [{own.force}]")
        axes.legend(loc="upper left")
    return figure


def correlation_figure(balance: Balance) -> Figure:
    """Draw the correlation of the residual with itself and with the input force, and bounds of three standard
    deviations.
    """
    found, dt = correlations(balance), balance.estimator.dt
    lags = np.arange(found.own.size) * dt
    with open_figure(3.2, 1, 2) as (figure, (own, cross)):
        own.plot(lags, found.own, label="residual")
        own.plot(lags, found.encoder, "--", color=GREY, label="encoder's error alone, filtered")
        own.set_ylabel("autocorrelation [-]")
        own.legend(loc="upper right")
        cross.plot(np.r_[-lags[:0:-1], lags], found.cross)
        cross.set_ylabel("correlation with the input [-]")
        cross.set_ylim(*(np.array([-1.15, 1.15]) * max(np.max(np.abs(found.cross)), 3 * found.cross_error)))
        for axes, error in ((own, found.own_error), (cross, found.cross_error)):
            axes.axhspan(-3 * error, 3 * error, color=COLOURS[3], alpha=0.25, lw=0)
            axes.margins(x=0)
            axes.locator_params(axis="x", nbins=6)
        own.set_xlabel("lag [s]")
        cross.set_xlabel("delay after the input [s]")
    return figure


def _dots(axes: Axes, x: Floats, y: Floats) -> None:
    every = -(-x.size // TUNING.max_dots)
    axes.plot(x[::every], y[::every], ".", color=COLOURS[4], alpha=0.7, ms=3.5, mew=0, label="samples")


def _means(axes: Axes, found: Binned, mean: Floats) -> None:
    label = "means ±2 standard errors"
    axes.errorbar(found.x, mean, 2 * found.error, fmt="o", color=COLOURS[1], ms=4, capsize=2, label=label)


def _limits(axes: Axes, y: Floats) -> None:
    """Set limits of an axis that a few outliers do not widen."""
    low, high = (float(limit) for limit in np.quantile(y, (0.002, 0.998)))
    margin = 0.1 * (high - low) or 1e-6
    axes.set_ylim(low - margin, high + margin)


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
    """Return sections on the fit of the model at the result's theta, for a recursive method at the last theta.

    With a forgetting factor below 1, only the last three memories of the record are judged. If the parameters are
    impossible for a drive, or if nothing can be simulated, one section gives the reason.
    """
    try:
        theta = result.theta[: len(result.estimator.names)]  # without an estimated input gain
        balance = make_balance(result.estimator, result.record.u, result.record.counts, theta, result.record.inputs)
    except PmfidError as error:
        return [Section("Model checks", f"This check is not possible: {error}.")]
    if balance is None:
        return [
            Section("Model checks", "This check is not possible, because these parameters allow no simulated motion.")
        ]
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
        "\n\nThe input follows the residual in this record, and the encoder is coarse, so the encoder's own error also "
        "varies with velocity and position. Record an open-loop motion before you change the model."
    )


def _window(result: DriveResult, balance: Balance) -> str:
    if getattr(result.estimator, "forgetting", 1.0) == 1.0:
        return ""
    start, end = balance.t[0], balance.t[-1]
    return (
        f"\n\nAll model checks use the last estimate and the samples from {start:.4g} s to {end:.4g} s. This time is "
        f"{DIAGNOSTIC_TUNING.drives_memories:g} times the memory of the estimator, dt / (1 - forgetting)."
    )
