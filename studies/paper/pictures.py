"""Pictures of the page on the paper, in the paper's colours: blue, red, green, and magenta for the nominal value."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import cycle
from pathlib import Path

import numpy as np

from pmfid.report.figures import COLOURS, MAGENTA, decimation, figure_style, save_png
from pmfid.types import Floats

WIDTH = 8.0  # inches
STYLES = ("-", "--", "-.", ":")


def draw_masses(
    path: Path, t: Floats, truth: Floats, panels: Mapping[str, Mapping[str, Floats]], limits: tuple[float, float]
) -> None:
    """Write a panel for each title with the mass (n,) over time by label, and the nominal value (n,)."""
    from matplotlib.figure import Figure

    with figure_style():
        figure = Figure(figsize=(WIDTH, 0.9 + 1.7 * len(panels)), layout="constrained")
        places = figure.subplots(len(panels), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
        for axes, (title, curves) in zip(places, panels.items(), strict=True):
            for colour, (label, mass) in zip(cycle(COLOURS), curves.items(), strict=False):
                i = decimation(mass)
                axes.plot(t[i], mass[i], color=colour, label=label)
            axes.plot(t, truth, color=MAGENTA, ls="--", label="nominal")
            axes.set_title(title)
            axes.set_ylabel("mass [kg]")
        places[0].set_ylim(limits)
        places[0].set_xlim(float(t[0]), float(2 * t[-1] - t[-2]))
        places[-1].set_xlabel("time [s]")
        handles, names = places[0].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside upper center", ncols=len(names))
        save_png(figure, path)


def draw_inputs(path: Path, t: Floats, panels: Mapping[str, Mapping[str, Floats]]) -> None:
    """Write a panel for each quantity with curves by label: (n,) at the n instants, or (n-1,) held between them."""
    from matplotlib.figure import Figure

    with figure_style():
        figure = Figure(figsize=(WIDTH, 0.8 + 1.9 * len(panels)), layout="constrained")
        places = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
        for axes, (quantity, curves) in zip(places, panels.items(), strict=True):
            for colour, style, (label, values) in zip(cycle(COLOURS), cycle(STYLES), curves.items(), strict=False):
                held = len(values) < len(t)
                values = np.append(values, values[-1]) if held else values
                axes.plot(t, values, color=colour, ls=style, label=label, drawstyle="steps-post" if held else None)
            axes.set_ylabel(quantity)
        places[-1].set_xlabel("time [s]")
        places[-1].set_xlim(float(t[0]), float(t[-1]))
        handles, names = places[0].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside upper center", ncols=len(names))
        save_png(figure, path)
