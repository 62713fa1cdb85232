"""Figures of a fleet: distance from the others over change, and the map of findings."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from pmfid.errors import printable
from pmfid.fleet.history import History
from pmfid.fleet.said import when
from pmfid.fleet.survey import DAY
from pmfid.report.figures import COLOURS, GREY, WIDTH, figure_style
from pmfid.types import Floats

if TYPE_CHECKING:
    import polars as pl

#: Colours of the verdicts, and of the quality of a period, worst first.
KINDS = {"changed": COLOURS[1], "drifts": COLOURS[3], "differs": COLOURS[0], "wanders": COLOURS[5]}
#: The same without colours, and the lines of parameters that lie on one another.
MARKERS = {"changed": "o", "drifts": "^", "differs": "s", "wanders": "d"}
LINES = (("-", "o"), ("--", "^"), (":", "s"), ("-.", "d"))
MAP = {"change": COLOURS[1], "no estimate": "#333333", "doubt": COLOURS[3], "good": "#cfe8dc", "no data": "#f4f4f4"}
#: Names that are written into a panel, and of a change of so much [%]; rows of the map, and periods of it.
NAMES, SHOWN, ROWS, COLUMNS = 6, 2.0, 50, 400
#: Axes whose trend is drawn; letters of a name; rows of the map in which nothing is the matter, to compare with.
TRENDS, LONGEST, QUIET = 6, 24, 10
#: Kinds of verdicts with a course over time, and the least height of a panel of it [%].
MOVING, LEAST_HEIGHT = ("changed", "drifts"), 2.0
#: Days of a history from which its times are labelled by the date alone.
DATES = 2.0


def spread_figure(found: History) -> Figure:
    """A panel for each parameter: relative distance from the median of the type, and relative change, of each axis."""
    with figure_style():
        figure = Figure(figsize=(WIDTH, 3.4), layout="constrained")
        panels = figure.subplots(1, len(found.names), squeeze=False)[0]
        for panel, name in zip(panels, found.names, strict=True):
            _panel(panel, found, name)
        panels[0].set_ylabel("change within the history in %")
        there = [(kind, KINDS[kind], MARKERS[kind]) for kind in KINDS if kind in found.axes["kind"]]
        handles = [
            Line2D([], [], color=colour, marker=marker, ls="", label=kind)
            for kind, colour, marker in [*there, ("nothing to say", GREY, ".")]
        ]
        figure.legend(handles=handles, loc="outside lower center", ncols=5)
    return figure


def _panel(panel: Axes, found: History, name: str) -> None:
    axes = found.axes
    x, y = (100 * axes[f"{name}{end}"].to_numpy() for end in ("_deviation", "_change"))
    x, y = np.nan_to_num(x, nan=0.0), np.nan_to_num(y, nan=0.0)
    kinds = axes["kind"].to_numpy()
    quiet = ~np.isin(kinds, list(KINDS))
    panel.plot(x[quiet], y[quiet], ".", color=GREY, ms=3, alpha=0.5)
    for kind, colour in KINDS.items():
        which = kinds == kind
        panel.plot(x[which], y[which], MARKERS[kind], color=colour, ms=4)
    most = np.where(kinds == "differs", np.abs(x), np.abs(y))
    notable = [int(k) for k in np.argsort(-most, kind="stable") if not quiet[k] and most[k] > SHOWN]
    for k in _choose_labels(x, y, notable):
        panel.annotate(label_of(axes["axis"][k]), (x[k], y[k]), (4, 3), textcoords="offset points", fontsize=7)
    panel.margins(x=0.15)
    _set_least_height(panel)
    panel.set_title(name.replace("_", " "))
    panel.set_xlabel("from the median in %")


def _choose_labels(x: Floats, y: Floats, places: Sequence[int]) -> list[int]:
    """The first NAMES places whose names do not overlap."""
    width, height = max(float(np.ptp(x)), 1e-9), max(float(np.ptp(y)), 1e-9)
    found: list[int] = []
    for k in places:
        if all(abs(x[k] - x[j]) > 0.4 * width or abs(y[k] - y[j]) > 0.06 * height for j in found):
            found.append(k)
    return found[:NAMES]


def _set_least_height(panel: Axes) -> None:
    """Extends the range of a panel to LEAST_HEIGHT, so that scatter does not fill the panel."""
    low, high = panel.get_ylim()
    missing = max(0.0, LEAST_HEIGHT - (high - low)) / 2
    panel.set_ylim(low - missing, high + missing)
    panel.ticklabel_format(axis="y", useOffset=False)


def moving(found: History) -> pl.DataFrame:
    """The first axes whose course over time is their matter."""
    import polars as pl

    return found.named.filter(pl.col("kind").is_in(MOVING)).head(TRENDS)


def ticks_of(times: Floats) -> list[str]:
    """Times [s] as they are written at an axis: by the date alone where that tells them apart."""
    texts = [when(float(time)) for time in times]
    days = (times[-1] - times[0]) / DAY if times.size else 0.0
    if days >= DATES or (times.size > 1 and len({text.partition(" ")[0] for text in texts}) == times.size):
        return [text.partition(" ")[0] for text in texts]
    return [text[5:-3].replace(" ", "\n") if " " in text else text for text in texts]


def trend_figure(found: History) -> Figure:
    """A panel for each of the first axes that move: every parameter by period, relative to its first value, with 95 %
    intervals."""
    import polars as pl

    named = moving(found)["axis"].to_list()
    with figure_style():
        rows = -(-len(named) // 3)
        figure = Figure(figsize=(WIDTH, 1.0 + 1.9 * rows), layout="constrained")
        panels = figure.subplots(rows, 3, squeeze=False).ravel()
        for panel, axis in zip(panels, named, strict=False):
            own = found.periods.filter((pl.col("axis") == axis) & (pl.col("quality") != "none"))
            for colour, (line, marker), name in zip(COLOURS, cycle(LINES), found.names, strict=False):
                middle, theta, std = (own[key].to_numpy() for key in ("period", name, f"{name}_std"))
                if theta.size and theta[0]:
                    scale = 100 / theta[0]
                    half = 1.96 * abs(scale) * std
                    panel.errorbar(middle, scale * theta, half, color=colour, ls=line, marker=marker, lw=1, ms=3)
            panel.set_title(label_of(axis))
            _set_least_height(panel)
            ticks = np.unique(own["period"].to_numpy()[[0, -1]]) if own.height else np.empty(0)
            panel.set_xticks(ticks, ticks_of(ticks))
        for panel in panels[len(named) :]:
            panel.set_axis_off()
        panels[0].set_ylabel("in % of the first")
        handles = [
            Line2D([], [], color=colour, ls=line, marker=marker, ms=3, label=name.replace("_", " "))
            for colour, (line, marker), name in zip(COLOURS, cycle(LINES), found.names, strict=False)
        ]
        figure.legend(handles=handles, loc="outside lower center", ncols=4)
    return figure


def label_of(axis: str) -> str:
    """A name as it can be drawn: short, without control characters, and no formula."""
    text = printable(axis).replace("\n", " ").replace("$", r"\$")
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 1]}…"


def map_figure(found: History) -> Figure:
    """Axes by periods: where a change came, where there is no estimate, where it is in doubt."""
    order = _order(found)
    place = {axis: row for row, axis in enumerate(order)}
    times = np.array(sorted(set(found.periods["period"].drop_nans().drop_nulls().to_list())) or [0.0])
    shown = found.periods.filter(found.periods["axis"].is_in(order))
    edges = times[:: -(-times.size // COLUMNS)]
    grid = np.full((len(order), edges.size), len(MAP) - 1)
    levels = {name: level for level, name in enumerate(MAP)}
    for axis, period, quality, findings in shown.select("axis", "period", "quality", "findings").iter_rows():
        column = max(0, int(np.searchsorted(edges, period, "right")) - 1) if period == period else 0
        level = levels["change" if "changed" in findings.split() else "no estimate" if quality == "none" else quality]
        grid[place[axis], column] = min(level, grid[place[axis], column])
    with figure_style():
        figure = Figure(figsize=(WIDTH, 1.2 + 0.14 * max(8, len(order))), layout="constrained")
        axes = figure.subplots()
        norm = BoundaryNorm(np.arange(len(MAP) + 1) - 0.5, len(MAP))
        axes.imshow(grid, cmap=ListedColormap(list(MAP.values())), norm=norm, aspect="auto", interpolation="nearest")
        _labels(axes, found, order, edges)
        figure.legend(
            handles=[Patch(color=colour, label=name) for name, colour in MAP.items()],
            loc="outside lower center",
            ncols=5,
        )
    return figure


def _order(found: History) -> list[str]:
    """The axes that are named or unknown, in their order, then those with most periods that are not good."""
    periods = found.periods.filter(found.periods["quality"] != "good")["axis"].value_counts()
    doubts = dict(periods.iter_rows())
    rows = enumerate(found.axes.select("axis", "kind").iter_rows())
    ranked = sorted((kind == "", -doubts.get(axis, 0) if kind == "" else 0, k, axis) for k, (axis, kind) in rows)
    notable = sum(not quiet or doubts < 0 for quiet, doubts, *_ in ranked)
    return [axis for *_, axis in ranked][: min(ROWS, notable + QUIET)]


def _labels(axes: Axes, found: History, order: list[str], edges: np.ndarray) -> None:
    axes.set_yticks(range(len(order)), [label_of(axis) for axis in order], fontsize=7)
    columns = np.arange(0, edges.size, -(-edges.size // 6))
    axes.set_xticks(list(columns), ticks_of(edges[columns]))
    kinds = dict(found.axes.select("axis", "kind").iter_rows())
    for label, axis in zip(axes.get_yticklabels(), order, strict=True):
        label.set_color(KINDS.get(kinds[axis], "black"))
        label.set_fontweight("bold" if kinds[axis] in KINDS else "normal")
    axes.grid(visible=False)
