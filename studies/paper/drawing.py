"""The content of a figure of the paper: curves over time in panels, as a picture and as a CSV."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import chain, cycle
from pathlib import Path
from typing import TYPE_CHECKING

from pmfid.report.tuning import TUNING
from pmfid.types import Floats

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Drawing:
    """Curves over time.

    `name` names the files, and `t` (n,) holds the times [s]. `truth` is the label and the nominal values (n,). `panels`
    maps title and label to values (n,), nan if missing. `axis` labels the values with their unit, and `limits` bounds
    them. `columns` is the number of columns of panels, and `marks` are times of vertical lines [s].
    """

    name: str
    t: Floats
    truth: tuple[str, Floats]
    panels: Mapping[str, Mapping[str, Floats]]
    axis: str
    limits: tuple[float, float]
    columns: int = 1
    marks: tuple[float, ...] = ()


def write_drawing(drawing: Drawing, out: Path) -> list[Path]:
    """Write name.png and name.csv into the folder `out`; return their paths. Raises OSError."""
    from pmfid.report.figures import save_png

    picture, data = out / f"{drawing.name}.png", out / f"{drawing.name}.csv"
    save_png(draw(drawing), picture)
    label, truth = drawing.truth
    curves = {f"{title}: {name}": y for title, panel in drawing.panels.items() for name, y in panel.items()}
    write_columns({"t [s]": drawing.t, label: truth, **curves}, data)
    return [picture, data]


@dataclass(frozen=True, eq=False)
class Motions:
    """Inputs with their motions: `name` names the files, t (n,) [s]; u [V] and x [m] map labels to values (n,)."""

    name: str
    t: Floats
    u: Mapping[str, Floats]
    x: Mapping[str, Floats]


def write_motions(motions: Motions, out: Path) -> list[Path]:
    """Write name.png and name.csv into the folder `out`; return their paths. Raises OSError."""
    from pmfid.report.figures import save_png

    picture, data = out / f"{motions.name}.png", out / f"{motions.name}.csv"
    save_png(draw_motions(motions), picture)
    inputs = {f"input [V], {label}": y for label, y in motions.u.items()}
    places = {f"position [m], {label}": y for label, y in motions.x.items()}
    write_columns({"t [s]": motions.t, **inputs, **places}, data)
    return [picture, data]


def draw_motions(motions: Motions) -> Figure:
    """Draw the inputs above the positions; the first curve is solid, the others are dashed."""
    from matplotlib.figure import Figure

    from pmfid.report.figures import COLOURS, figure_style

    with figure_style():
        figure = Figure(figsize=(TUNING.figures_width, 5.0), layout="constrained")
        above, below = figure.subplots(2, 1, sharex=True)
        for colour, style, label in zip(
            cycle(COLOURS), chain(["-"], cycle(["--", "-.", ":"])), motions.u, strict=False
        ):
            above.plot(motions.t, motions.u[label], color=colour, ls=style, label=label, drawstyle="steps-post")
            below.plot(motions.t, motions.x[label], color=colour, ls=style)
        above.set_ylabel("input [V]")
        below.set_ylabel("position [m]")
        below.set_xlabel("time [s]")
        below.set_xlim(motions.t[0], motions.t[-1])
        figure.legend(loc="outside upper center", ncols=len(motions.u))
    return figure


def write_columns(columns: Mapping[str, Floats], path: Path) -> None:
    """Write columns (n,) as CSV with nine digits, empty if a value is missing. Raises OSError."""
    with open(path, "w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        for row in zip(*(column.tolist() for column in columns.values()), strict=True):
            writer.writerow("" if value != value else f"{value:.9g}" for value in row)


def draw(drawing: Drawing) -> Figure:
    """Draw the curves in blue, red and green in their order, and the nominal value in magenta, as in the paper."""
    from matplotlib.figure import Figure

    from pmfid.report.figures import COLOURS, GREY, MAGENTA, decimation, figure_style

    rows = -(-len(drawing.panels) // drawing.columns)
    label, truth = drawing.truth
    with figure_style():
        figure = Figure(
            figsize=(TUNING.figures_width, 0.9 + (2.4 if drawing.columns == 1 else 1.9) * rows), layout="constrained"
        )
        grid = figure.subplots(rows, drawing.columns, sharex=True, sharey=True, squeeze=False)
        for (title, curves), axes in zip(drawing.panels.items(), grid.flat, strict=False):
            for colour, (name, y) in zip(cycle(COLOURS), curves.items(), strict=False):
                i = decimation(y)
                axes.plot(drawing.t[i], y[i], color=colour, label=name)
            axes.plot(drawing.t, truth, color=MAGENTA, ls="--", label=label)
            for mark in drawing.marks:
                axes.axvline(mark, color=GREY, lw=0.8, ls=":")
            axes.set_title(title)
        for place in range(len(drawing.panels), grid.size):
            grid.flat[place].remove()
            grid.flat[place - drawing.columns].tick_params(labelbottom=True)
        grid[0, 0].set_ylim(drawing.limits)
        grid[0, 0].set_xlim(drawing.t[0], drawing.t[-1])
        figure.supxlabel("time [s]", fontsize=10)
        figure.supylabel(drawing.axis, fontsize=10)
        handles, names = grid[0, 0].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside upper center", ncols=len(names))
    return figure
