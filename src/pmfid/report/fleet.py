"""The report of a fleet's history."""

from __future__ import annotations

import math
from collections import Counter
from html import escape
from itertools import cycle, groupby
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pmfid.errors import printable
from pmfid.fleet.history import History
from pmfid.fleet.source import SECONDS
from pmfid.fleet.tuning import TUNING as FLEET_TUNING
from pmfid.fleet.verdicts import when, with_error
from pmfid.report.figures import COLOURS, FIGURES_PHONE, FIGURES_POINTS, FIGURES_WIDTH, open_figure
from pmfid.report.html import HTML_LONG, write_page
from pmfid.report.page import Cell, ResultPage, Section, Table
from pmfid.types import Floats

if TYPE_CHECKING:
    import polars as pl
    from matplotlib.figure import Figure

#: Numbers of drawn trends, and of quiet rows for comparison in the map.
FLEET_TRENDS = 6
FLEET_QUIET = 10
#: Least length of a history [days] whose times have only dates as labels.
FLEET_DATES = 2.0
#: Largest number of rows in a table or a map, and of axes that are drawn individually. Files next to the report
#: have all axes and problems.
FLEET_LISTED = 50

#: Colours for the verdicts, and for the quality of a period, with the worst first.
KINDS = {
    "changed": COLOURS[1],
    "drifts": COLOURS[3],
    "differs": COLOURS[0],
    "wanders": COLOURS[5],
    "stopped": COLOURS[2],
}
#: Styles for overlaid lines of parameters.
LINES = (("-", "o"), ("--", "^"), (":", "s"), ("-.", "d"))
MAP = {"change": COLOURS[1], "no estimate": "#333333", "doubt": COLOURS[3], "good": "#cfe8dc", "no data": "#f4f4f4"}
#: Kinds of verdicts with a course over time, and the least height [%] of their panels.
MOVING, LEAST_HEIGHT = ("changed", "drifts"), 2.0


def moving(found: History) -> pl.DataFrame:
    """Return the first axes whose verdict concerns their course over time."""
    import polars as pl

    return found.named.filter(pl.col("kind").is_in(MOVING)).head(FLEET_TRENDS)


def ticks_of(times: Floats) -> list[str]:
    """Return the labels of times [s] at an axis, as dates if the dates distinguish the times."""
    texts = [when(float(time)) for time in times]
    days = (times[-1] - times[0]) / SECONDS["d"] if times.size else 0.0
    if days >= FLEET_DATES or (times.size > 1 and len({text.partition(" ")[0] for text in texts}) == times.size):
        return [text.partition(" ")[0] for text in texts]
    return [text[5:-3].replace(" ", "\n") if " " in text else text for text in texts]


def trend_figure(found: History) -> Figure:
    """Draw a panel for each of the first moving axes, with every parameter by period and 95 % intervals.

    The values are relative to the first value of the parameter.
    """
    import polars as pl
    from matplotlib.lines import Line2D

    named = moving(found)["axis"].to_list()
    rows = -(-len(named) // 3)
    with open_figure(1.0 + 1.9 * rows, rows, 3) as (figure, panels):
        for panel, axis in zip(panels, named, strict=False):
            own = found.periods.filter((pl.col("axis") == axis) & (pl.col("quality") != "none"))
            for colour, (line, marker), name in zip(COLOURS, cycle(LINES), found.names, strict=False):
                middle, theta, std = (own[key].to_numpy() for key in ("period", name, f"{name}_std"))
                if theta.size and theta[0]:
                    scale = 100 / theta[0]
                    half = 1.96 * abs(scale) * std
                    panel.errorbar(middle, scale * theta, half, color=colour, ls=line, marker=marker, lw=1, ms=3)
            panel.set_title(label_of(axis))
            low, high = panel.get_ylim()
            missing = max(0.0, LEAST_HEIGHT - (high - low)) / 2  # mere scatter does not fill the panel
            panel.set_ylim(low - missing, high + missing)
            panel.ticklabel_format(axis="y", useOffset=False)
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
    """Return a short name for a figure, without control characters."""
    text = printable(axis).replace("\n", " ")
    return text if len(text) <= HTML_LONG else f"{text[: HTML_LONG - 1]}…"


def map_figure(found: History) -> str:
    """Draw a map of axes by periods, with changes, doubtful periods, and periods without an estimate.

    The result has two <svg> elements for HTML, the second one for a phone.
    """
    order = _order(found)
    place = {axis: row for row, axis in enumerate(order)}
    times = np.array(sorted(set(found.periods["period"].drop_nans().drop_nulls().to_list())) or [0.0])
    shown = found.periods.filter(found.periods["axis"].is_in(order))
    edges = times[:: -(-times.size // FIGURES_POINTS)]
    grid = np.full((len(order), edges.size), len(MAP) - 1)
    for axis, period, quality, findings in shown.select("axis", "period", "quality", "findings").iter_rows():
        column = max(0, int(np.searchsorted(edges, period, "right")) - 1) if period == period else 0
        level = "change" if "changed" in findings.split() else "no estimate" if quality == "none" else quality
        grid[place[axis], column] = min([*MAP].index(level), grid[place[axis], column])
    kinds = dict(found.axes.select("axis", "kind").iter_rows())
    names = [(escape(label_of(axis)), KINDS.get(kinds[axis], "black")) for axis in order]
    columns = np.arange(0, edges.size, -(-edges.size // 6))
    ticks = dict(zip(columns.tolist(), ticks_of(edges[columns]), strict=True))
    return "\n".join(_draw_map(grid.tolist(), names, ticks, 72 * width) for width in (FIGURES_WIDTH, FIGURES_PHONE))


def _draw_map(grid: list[list[int]], names: list[tuple[str, str]], ticks: dict[int, str], width: float) -> str:
    """Return rows of levels as an <svg> of `width` points, with names and their colours, and texts below columns."""
    left, high, below = 8 + 5 * max(len(name) for name, _ in names), 12, 12 * len(grid)
    wide, part, drawn = (width - left) / len(grid[0]), width / len(MAP), list[str]()
    box, text = '<rect x="{:.1f}" y="{}" width="{:.1f}" height="11" fill="{}"/>', '<text x="{:.1f}" y="{}">{}</text>'
    for y, ((name, colour), levels) in enumerate(zip(names, grid, strict=True)):
        style = f'text-anchor="end" fill="{colour}" font-weight="{"normal" if colour == "black" else "bold"}"'
        drawn.append(f'<text x="{left - 4}" y="{high * y + 9}" {style}>{name}</text>')
        x = 0
        for level, run in groupby(levels):
            span = len(list(run))
            drawn.append(box.format(left + wide * x, high * y, wide * span, [*MAP.values()][level]))
            x += span
    for x, stamp in ticks.items():
        drawn += [text.format(left + wide * x, below + high * k, line) for k, line in enumerate(stamp.split("\n"), 1)]
    for k, (name, colour) in enumerate(MAP.items()):
        drawn.append(box.format(part * k, below + 3 * high, high - 4, colour))
        drawn.append(text.format(part * k + high - 1, below + 3 * high + 9, name))
    size = f'viewBox="0 0 {width:g} {below + 4 * high}" font-size="8" font-family="sans-serif"'
    return f"<svg {size}>{''.join(drawn)}</svg>"


def _order(found: History) -> list[str]:
    """Return the named and the unknown axes in their order, then the axes with most periods that are not good."""
    periods = found.periods.filter(found.periods["quality"] != "good")["axis"].value_counts()
    doubts = dict(periods.iter_rows())
    rows = enumerate(found.axes.select("axis", "kind").iter_rows())
    ranked = sorted((kind == "", -doubts.get(axis, 0) if kind == "" else 0, k, axis) for k, (axis, kind) in rows)
    notable = sum(not quiet or doubts < 0 for quiet, doubts, *_ in ranked)
    return [axis for *_, axis in ranked][: min(FLEET_LISTED, notable + FLEET_QUIET)]


def write_fleet(out: Path, found: History, name: str) -> None:
    """Write fleet.html and fleet.json into the folder `out`."""
    sections = [_attention(found), _unknown(found), _trends(found), _wandering(found), _map(found)]
    sections += [_list_unused(found), _how(found)]
    shown = [section for section in sections if section is not None]
    write_page(out, ResultPage("fleet", f"{name}: {found.title}", found.to_json(), shown))


def _attention(found: History) -> Section:
    named = found.named
    kinds = Counter(named["kind"].to_list())
    causes = Counter(named.filter(named["kind"] == "changed")["why"].str.extract(r"^(.*?) [+-]").to_list())
    what = ", ".join(f"{many} {cause}" for cause, many in causes.most_common() if cause)
    words = {
        "changed": f"changed ({what})",
        "drifts": "drift{s}",
        "differs": "differ{s} from the others",
        "stopped": "stopped delivering motion",
    }
    text = ", ".join(f"{many} {words[kind].format(s='s' * (many == 1))}" for kind, many in kinds.most_common())
    if not named.height:
        text = "No axis changed, drifts, stopped, or differs from the others beyond chance and tolerance."
        if found.unknown.height == found.axes.height:
            text = "No axis has an estimate, because no record has enough motion, or is long and whole enough."
    elif text:
        text += ". The largest come first."
    text += _besides(found)
    rows: list[list[Cell]] = [
        [place, row["axis"], row["why"], row["kind"], _strength(row["score"]), row["type"]]
        for place, row in enumerate(named.head(FLEET_LISTED).iter_rows(named=True), 1)
    ]
    typed = any(row[-1] for row in rows)
    header = ("", "axis", "why", "verdict", "evidence", *(["type"] if typed else []))
    table = (header, [row if typed else row[:-1] for row in rows]) if rows else None
    return Section("Who needs attention", text + _first(FLEET_LISTED, named.height), table)


def _besides(found: History) -> str:
    """Return sentences on everything that the table of axes with need of attention leaves out."""
    unknown, wander = found.unknown.height, int((found.axes["kind"] == "wanders").sum())
    files = found.problems.filter((found.problems["code"] == "unreadable") & (found.problems["file"] != ""))
    text = f"\n\n{_many(unknown, 'axis has', 'axes have')} no estimate, listed below." if unknown else ""
    text += f"\n\n{_many(files['file'].n_unique(), 'file', 'files')} could not be read." if files.height else ""
    known = found.axes.filter(found.axes["segments"] > 0).select(f"{name}_deviation" for name in found.names)
    if alone := sum(all(math.isnan(value) for value in row) for row in known.iter_rows()):
        text += (
            f"\n\n{_many(alone, 'axis is', 'axes are')} of a type with fewer than {FLEET_TUNING.verdicts_sure}, too "
            "few to show what is usual, and compared only with their own past."
        )
    several = found.problems.filter(found.problems["code"] == "several_sorts").select("file", "text")
    for part, reason in several.iter_rows():
        text += f"\n\n{part[:1].upper() + part[1:]}: {reason}."
    return text + (f"\n\n{_many(wander, 'axis wanders', 'axes wander')}, which needs no action." if wander else "")


def _many(number: int, one: str, more: str) -> str:
    return f"{number} {one if number == 1 else more}"


def _unknown(found: History) -> Section | None:
    """Return the section on axes without an estimate, with the findings of their records."""
    import polars as pl

    if not found.unknown.height:
        return None
    findings = dict(found.periods.group_by("axis").agg(pl.col("findings").str.join(" ")).iter_rows())
    axes = found.unknown["axis"].head(FLEET_LISTED)
    rows: list[list[Cell]] = [[axis, _words(findings.get(axis, ""))] for axis in axes]
    text = (
        "The state of these axes is not known. They stand still, their counts or input do not reach the log, or their "
        "records are too short or damaged."
    )
    return Section("No estimate", text + _first(FLEET_LISTED, found.unknown.height), (("axis", "findings"), rows))


def _words(codes: str) -> str:
    return ", ".join(code.replace("_", " ") for code, _ in Counter(codes.split()).most_common())


def _first(shown: int, all_of_them: int, file: str = "axes") -> str:
    return f" The first {shown} of {all_of_them}; all are in {file}.parquet." if all_of_them > shown else ""


def _wandering(found: History) -> Section | None:
    wander = found.axes.filter(found.axes["kind"] == "wanders")
    if not wander.height:
        return None
    text = (
        "The parameters of these axes move up and down about a mean, as friction does with temperature and "
        "lubrication. A step or a line explains this motion no better than a random walk, so these axes do not count "
        "as changed or drifting. The size is the root mean square about the mean; the largest sizes come first."
    )
    rows: list[list[Cell]] = [[row["axis"], row["why"]] for row in wander.head(FLEET_LISTED).iter_rows(named=True)]
    return Section("Axes that wander", text + _first(FLEET_LISTED, wander.height), (("axis", "what"), rows))


def _strength(score: float) -> str:
    """Format the strength of a finding, in multiples of the strength that chance explains."""
    return f"{score:.1f} ×" if score < 10 else f"{score:.0f} ×" if score < 100 else "over 100 ×"


def _trends(found: History) -> Section | None:
    named = moving(found)
    if not named.height:
        return None
    text = (
        "The estimates of the first axes that change or drift, with bars of 1.96 standard deviations and the first "
        "period as 100 %. The table gives the slope of a straight line through all periods, relative to its begin, "
        "with one standard deviation. The slopes of all axes, per day, are in axes.parquet."
    )
    first, last = found.periods["first"].min(), found.periods["last"].max()
    days = min(1.0, (float(last or 0.0) - float(first or 0.0)) / SECONDS["d"])  # type: ignore[arg-type]
    unit = "%/day" if days == 1 else f"% within {when(SECONDS['d'] * days)}"
    header = ("axis", *(f"{name.replace('_', ' ')} [{unit}]" for name in found.names))
    rows: list[list[Cell]] = [
        [row["axis"], *(_slope(days * row[f"{name}_slope"], days * row[f"{name}_slope_std"]) for name in found.names)]
        for row in named.iter_rows(named=True)
    ]
    return Section("Trend of the axes that move", text, (header, rows), figure=lambda: trend_figure(found))


def _slope(slope: float, std: float) -> str:
    return with_error(slope, std).replace(" %", "") if math.isfinite(slope) else ""


def _map(found: History) -> Section | None:
    if not found.periods.height:
        return None
    text = (
        "Each row is an axis and each column a period. Axes that need attention are at the top, with names in the "
        "colour of the verdict."
    )
    if found.axes.height > FLEET_QUIET:
        text += f" The other axes with the most doubtful periods follow, up to {FLEET_LISTED} rows in all."
    return Section("Map of findings", text, figure=lambda: map_figure(found))


def _list_unused(found: History) -> Section | None:
    rows: list[list[Cell]] = [
        [row["axis"] or row["file"], row["code"], row["times"], when(start) if start < math.inf else "", row["text"]]
        for row in found.problems.head(FLEET_LISTED).iter_rows(named=True)
        for start in [row["from"]]
    ]
    if not rows:
        return None
    text = "Data that were changed or left out. All other data are in the results."
    text += _first(FLEET_LISTED, found.problems.height, "problems")
    return Section("Unusable data", text, (("axis, file or type", "finding", "times", "from", "what"), rows))


def _how(found: History) -> Section:
    middle: Table = (
        ("parameter", "median", "5 %", "95 %", "unit"),
        [[name, *_quantiles(found.axes, name), unit] for name, unit in zip(found.names, found.units, strict=True)],
    )
    text = (
        f"{found.samples} samples in estimates of {found.segment:.3g} s each, put together by period ({found.period}). "
        "An axis needs attention if its change, drift or distance exceeds the tolerance by more than chance allows. "
        "Chance takes the number of axes, parameters and times into account. In a healthy fleet, less than one axis "
        "needs attention on average. Error bars contain the scatter of the estimates of one axis, and no unmodelled "
        "effects."
    )
    return Section("The fleet and the method", text, middle)


def _quantiles(axes: pl.DataFrame, name: str) -> list[str | float]:
    known = axes[name].drop_nans().drop_nulls()
    return ["" if not known.len() else float(known.quantile(part) or 0.0) for part in (0.5, 0.05, 0.95)]
