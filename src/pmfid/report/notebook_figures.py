"""Figures of what is seen in Python alone: single estimates, fleets, experiments."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from pmfid.estimators.track import Tracks
from pmfid.report.figures import (
    COLOURS,
    GREY,
    WIDTH,
    _finish_time,
    _label,
    _line,
    _panels,
    _words,
    decimation,
    figure_style,
)
from pmfid.status import Status
from pmfid.transfer.experiment import Experiment

SAMPLES = "sample [-]"
#: Axes of a fleet that are drawn one by one.
MOST_AXES = 50


def with_samples(figure: Figure) -> Figure:
    """A figure over numbers of samples, where nobody said how far apart they are."""
    for axes in figure.axes:
        if axes.get_xlabel() == "time [s]":
            axes.set_xlabel(SAMPLES)
    return figure


def bars_figure(names: Sequence[str], units: Sequence[str], theta: Sequence[float], std: Sequence[float]) -> Figure:
    """Each parameter on an axis of its own, with two standard deviations where they are known."""
    with figure_style():
        figure = Figure(figsize=(WIDTH, 0.3 + 0.85 * len(names)), layout="constrained")
        panels = figure.subplots(len(names), 1, squeeze=False)[:, 0]
        for axes, name, unit, value, bar in zip(panels, names, units, theta, std, strict=True):
            known = np.isfinite(bar)
            axes.errorbar(value, 0, xerr=2 * bar if known else None, fmt="o", color=COLOURS[0], capsize=4)
            axes.set_yticks([0], [_label(name, unit) if unit else _words(name)])
            axes.ticklabel_format(axis="x", useOffset=False)
            axes.locator_params(axis="x", nbins=6)
            axes.set_ylim(-1, 1)
            half = 3 * bar if known and bar > 0 else 0.1 * abs(value) or 1.0
            axes.set_xlim(value - half, value + half)
        figure.supxlabel("value, with two standard deviations", fontsize=10)
    return figure


def fleet_figure(t: ArrayLike, tracks: Tracks, label: str) -> Figure:
    """The estimates of the first axes over t (m,), and the median of all."""
    time, single = np.asarray(t, float), np.size(t) == 1
    theta = np.where(tracks.flagged(Status.STARTING)[..., None], np.nan, tracks.theta)
    with figure_style():
        figure, panels = _panels(len(tracks.names), 1.9)
        for i, (axes, name, unit) in enumerate(zip(panels, tracks.names, tracks.units, strict=True)):
            for one in theta[:MOST_AXES, :, i]:
                _line(axes, time, one, color=GREY, lw=0.6, alpha=0.6, marker="." if single else None)
            middle, marker = np.median(theta[..., i], axis=0), "o" if single else None
            _line(axes, time, middle, color=COLOURS[0], label="median of all axes", marker=marker)
            axes.set_ylabel(_label(name, unit))
        _finish_time(panels[-1], time)
        panels[-1].set_xlabel(label)
        panels[0].legend(loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0.2)
    return figure


def experiment_figure(experiment: Experiment) -> Figure:
    """Input, output and reference over time."""
    signals = {"u": experiment.u, "y": experiment.y, "reference": experiment.reference}
    there = {name: values for name, values in signals.items() if values is not None}
    with figure_style():
        figure, panels = _panels(len(there), 1.7)
        for axes, (name, values) in zip(panels, there.items(), strict=True):
            shown = decimation(values)
            axes.plot(experiment.times[shown], values[shown], lw=0.8)
            axes.set_ylabel(name)
        _finish_time(panels[-1], experiment.times)
    return figure
