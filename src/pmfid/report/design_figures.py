"""The figures of a design: input and motion against the limits, information over time, confidence ellipses."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations, cycle

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pmfid.design.problem import Float, Problem
from pmfid.report.figures import COLOURS, GREY, MAGENTA, WIDTH, figure_style

__all__ = ["ellipse_figure", "gathering_figure", "motion_figure"]

#: chi-square of two degrees of freedom at 95 %.
CHI2 = 5.991
LINE_STYLES = ("-", "--", "-.", ":")

#: name -> (input (n,), position (n+1,), velocity (n+1,))
Inputs = Mapping[str, tuple[Float, Float, Float]]


def motion_figure(problem: Problem, inputs: Inputs) -> Figure:
    """Input, velocity and position over time, with their limits dashed."""
    with figure_style():
        figure = Figure(figsize=(WIDTH, 6.2), layout="constrained")
        panels = figure.subplots(3, 1, sharex=True)
        for axes, label, limit in zip(
            panels,
            ("input [unit of u]", "velocity [m/s]", "position [m]"),
            ("input", "velocity", "position"),
            strict=True,
        ):
            axes.set_ylabel(label)
            for bound in problem.limits.pair(limit) or ():
                axes.axhline(bound, color=MAGENTA, ls="--", lw=1.0)
        if problem.limits.min_speed > 0:
            panels[1].axhline(problem.limits.min_speed, color=MAGENTA, ls=":", lw=1.0)
        for (name, (u, x, v)), (colour, style) in zip(inputs.items(), _styles(), strict=False):
            look = {"color": colour, "ls": style, "lw": 1.8 if style == "-" else 1.2}
            panels[0].stairs(u, problem.t, baseline=None, label=name, **look)
            panels[1].plot(problem.t, v, **look)
            panels[2].plot(problem.t, x, **look)
        _finish(figure, panels[0], panels[-1])
    return figure


def gathering_figure(curves: Mapping[str, tuple[Float, Float]], ylabel: str) -> Figure:
    """Value of the criterion for the samples so far; curves: name -> (t (N,), value (N,))."""
    with figure_style():
        figure = Figure(figsize=(WIDTH, 3.2), layout="constrained")
        axes = figure.add_subplot()
        for (name, (t, value)), (colour, style) in zip(curves.items(), _styles(), strict=False):
            axes.plot(t, value, color=colour, ls=style, label=name)
        axes.set_ylabel(ylabel)
        _finish(figure, axes, axes)
    return figure


def ellipse_figure(
    names: tuple[str, ...], units: tuple[str, ...], nominal: Float, fishers: Mapping[str, Float]
) -> Figure | None:
    """95 % confidence ellipse of each pair of parameters; None for one parameter. fishers: name -> (p, p)."""
    pairs = list(combinations(range(len(names)), 2))
    if not pairs:
        return None
    with figure_style():
        figure = Figure(figsize=(WIDTH, 3.6 if len(pairs) > 1 else 4.4), layout="constrained")
        panels = figure.subplots(1, len(pairs), squeeze=False)[0]
        for axes, (i, j) in zip(panels, pairs, strict=True):
            for (name, fisher), (colour, style) in zip(fishers.items(), _styles(), strict=False):
                _ellipse(axes, nominal[[i, j]], fisher, (i, j), {"color": colour, "ls": style, "label": name})
            axes.plot(*nominal[[i, j]], "+", color=GREY)
            axes.set_xlabel(f"{_words(names[i])} [{units[i]}]")
            axes.set_ylabel(f"{_words(names[j])} [{units[j]}]")
            axes.locator_params(nbins=5)
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=5)
    return figure


def _ellipse(axes: Axes, centre: Float, fisher: Float, pair: tuple[int, int], look: dict[str, str]) -> None:
    if np.linalg.matrix_rank(fisher) < len(fisher):
        return
    covariance = np.linalg.inv(fisher)[np.ix_(pair, pair)]
    angle = np.linspace(0, 2 * np.pi, 200)
    circle = np.sqrt(CHI2) * np.array([np.cos(angle), np.sin(angle)])
    x, y = centre[:, None] + np.linalg.cholesky(covariance) @ circle
    axes.plot(x, y, color=look["color"], ls=look["ls"], label=look["label"])


def _styles() -> cycle[tuple[str, str]]:
    """Colour and line of each curve: the first colour is the design's, solid."""
    return cycle([(colour, style) for style in LINE_STYLES for colour in COLOURS])


def _finish(figure: Figure, first: Axes, last: Axes) -> None:
    last.set_xlabel("time [s]")
    last.margins(x=0.01)
    handles, labels = first.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=5)


def _words(name: str) -> str:
    return name.replace("_", " ").replace("coulomb", "Coulomb")
