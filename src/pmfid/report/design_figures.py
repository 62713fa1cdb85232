"""The figures of a design: input and motion against the limits, information over time, confidence ellipses."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import combinations, cycle

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pmfid.design.problem.problem import Problem
from pmfid.report.figures import COLOURS, GREY, MAGENTA, WIDTH, Style, figure_style
from pmfid.types import Floats

__all__ = ["ellipse_figure", "gathering_figure", "motion_figure"]

#: chi-square of two degrees of freedom at 95 %.
CHI2 = 5.991
LINE_STYLES = ("-", "--", "-.", ":")

#: name -> (input (n,), position (n+1,), velocity (n+1,))
Inputs = Mapping[str, tuple[Floats, Floats, Floats]]


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
        for name, look in _looks(inputs):
            u, x, v = inputs[name]
            panels[0].stairs(u, problem.t, baseline=None, **look)
            panels[1].plot(problem.t, v, **look)
            panels[2].plot(problem.t, x, **look)
        _finish(figure, panels[0], panels[-1])
    return figure


def gathering_figure(curves: Mapping[str, tuple[Floats, Floats]], ylabel: str) -> Figure:
    """Value of the criterion for the samples so far; curves: name -> (t (N,), value (N,))."""
    with figure_style():
        figure = Figure(figsize=(WIDTH, 3.2), layout="constrained")
        axes = figure.add_subplot()
        for name, look in _looks(curves):
            axes.plot(*curves[name], **look)
        axes.set_ylabel(ylabel)
        _finish(figure, axes, axes)
    return figure


def ellipse_figure(names: tuple[str, ...], scale: Floats, fishers: Mapping[str, Floats]) -> Figure | None:
    """95 % confidence ellipse of each pair of parameters in percent of `scale` (p,); None for one parameter.

    fishers: name -> information (p, p) in the units of the parameters.
    """
    pairs = list(combinations(range(len(names)), 2))
    if not pairs:
        return None
    with figure_style():
        figure = Figure(figsize=(WIDTH, 3.6 if len(pairs) > 1 else 4.4), layout="constrained")
        panels = figure.subplots(1, len(pairs), squeeze=False)[0]
        for axes, (i, j) in zip(panels, pairs, strict=True):
            for name, look in _looks(fishers):
                _ellipse(axes, fishers[name] * np.outer(scale, scale) / 1e4, (i, j), look)
            axes.plot(0.0, 0.0, "+", color=GREY)
            axes.set_xlabel(f"{_words(names[i])} [%]")
            axes.set_ylabel(f"{_words(names[j])} [%]")
            axes.locator_params(nbins=5)
        _legend(figure, panels[0])
    return figure


def _ellipse(axes: Axes, fisher: Floats, pair: tuple[int, int], look: Style) -> None:
    if np.linalg.matrix_rank(fisher) < len(fisher):
        return
    covariance = np.linalg.inv(fisher)[np.ix_(pair, pair)]
    angle = np.linspace(0, 2 * np.pi, 200)
    circle = np.sqrt(CHI2) * np.array([np.cos(angle), np.sin(angle)])
    axes.plot(*(np.linalg.cholesky(covariance) @ circle), **look)


def _looks(names: Iterable[str]) -> list[tuple[str, Style]]:
    """Name and style of each curve: the first one, the design, broad, so that it shows below one that covers it."""
    styles = cycle([(colour, style) for style in LINE_STYLES for colour in COLOURS])
    looks = []
    for number, (name, (colour, style)) in enumerate(zip(names, styles, strict=False)):
        words = name.replace("_", " ")
        looks.append((name, {"color": colour, "ls": style, "lw": 1.3 if number else 4.0, "label": words}))
    return looks


def _finish(figure: Figure, first: Axes, last: Axes) -> None:
    last.set_xlabel("time [s]")
    last.margins(x=0.01)
    _legend(figure, first)


def _legend(figure: Figure, axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=5)


def _words(name: str) -> str:
    return name.replace("_", " ").replace("coulomb", "Coulomb")
