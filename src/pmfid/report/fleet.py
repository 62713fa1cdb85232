"""The report on a fleet: who needs attention, why, and what could not be used."""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

from pmfid.fleet.history import History
from pmfid.fleet.said import when
from pmfid.fleet.survey import DAY
from pmfid.fleet.verdicts import LEAST_AXES
from pmfid.report.files import write_json
from pmfid.report.fleet_figures import QUIET, ROWS, map_figure, moving, spread_figure, trend_figure
from pmfid.report.html import Cell, Section, Table, svg, write_report

if TYPE_CHECKING:
    import polars as pl

#: Most axes and problems in the tables; the files of the same folder have all.
SHOWN, PROBLEMS, OTHERS = 60, 40, 20


def write_fleet(out: Path, found: History, name: str) -> None:
    """Writes fleet.html and fleet.json into the folder `out`."""
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / "fleet.json", found.to_json())
    sections = [_attention(found), _unknown(found), _trends(found), _wandering(found), _spread(found), _map(found)]
    sections += [_list_unused(found), _how(found)]
    write_report(out / "fleet.html", f"{name}: {found.title}", [one for one in sections if one is not None])


def _attention(found: History) -> Section:
    named = found.named
    kinds = Counter(named["kind"].to_list())
    causes = Counter(named.filter(named["kind"] == "changed")["why"].str.extract(r"^(.*?) [+-]").to_list())
    what = ", ".join(f"{many} {cause}" for cause, many in causes.most_common() if cause)
    words = {"changed": f"changed ({what})", "drifts": "drift{s}", "differs": "differ{s} from the others"}
    text = ", ".join(f"{many} {words[kind].format(s='s' * (many == 1))}" for kind, many in kinds.most_common())
    if not named.height:
        known = found.unknown.height < found.axes.height
        text = "No axis changed, drifts or differs from the others beyond chance and tolerance."
        text = text if known else "Nothing is known of any axis: no record moves enough, or is long and whole enough."
    elif text:
        text += ". The largest come first."
    text += _besides(found)
    rows: list[list[Cell]] = [
        [place, row["axis"], row["why"], row["kind"], _strength(row["score"]), row["type"]]
        for place, row in enumerate(named.head(SHOWN).iter_rows(named=True), 1)
    ]
    typed = any(row[-1] for row in rows)
    header = ("", "axis", "why", "verdict", "evidence", *(["type"] if typed else []))
    more = f"\n\nThe first {SHOWN} of {named.height}; all are in axes.parquet." if named.height > SHOWN else ""
    table = (header, [row if typed else row[:-1] for row in rows]) if rows else None
    return Section("Who needs attention", text + more, table)


def _besides(found: History) -> str:
    """What the table of those that need attention does not hold."""
    unknown, wander = found.unknown.height, _kind(found, "wanders").height
    files = found.problems.filter((found.problems["code"] == "unreadable") & (found.problems["file"] != ""))
    text = f"\n\n{_many(unknown, 'axis has', 'axes have')} no estimate, listed below." if unknown else ""
    text += f"\n\n{_many(files['file'].n_unique(), 'file', 'files')} could not be read." if files.height else ""
    for part, reason in (
        found.problems.filter(found.problems["code"] == "several_sorts").select("file", "text").iter_rows()
    ):
        text += f"\n\n{part[:1].upper() + part[1:]}: {reason}."
    return text + (f"\n\n{_many(wander, 'axis wanders', 'axes wander')}, which needs no action." if wander else "")


def _many(number: int, one: str, more: str) -> str:
    return f"{number} {one if number == 1 else more}"


def _kind(found: History, kind: str) -> pl.DataFrame:
    return found.axes.filter(found.axes["kind"] == kind)


def _unknown(found: History) -> Section | None:
    """The axes without an estimate, with the findings of their records."""
    import polars as pl

    if not found.unknown.height:
        return None
    findings = dict(found.periods.group_by("axis").agg(pl.col("findings").str.join(" ")).iter_rows())
    rows: list[list[Cell]] = [[axis, _words(findings.get(axis, ""))] for axis in found.unknown["axis"].head(OTHERS)]
    text = (
        "Of these it is not known whether anything is the matter: they stand still, their counts or their input do not "
        "reach the log, or their records are too short or damaged."
    )
    return Section("No estimate", text + _first(OTHERS, found.unknown.height), (("axis", "findings"), rows))


def _words(codes: str) -> str:
    return ", ".join(code.replace("_", " ") for code, _ in Counter(codes.split()).most_common())


def _first(shown: int, all_of_them: int) -> str:
    return f" The first {shown} of {all_of_them}; all are in axes.parquet." if all_of_them > shown else ""


def _wandering(found: History) -> Section | None:
    wander = _kind(found, "wanders")
    if not wander.height:
        return None
    text = (
        "Their parameters move up and down about a mean, as friction does with temperature and lubrication. A step or "
        "a line explains that no better than a random walk does, so they are not named as changed or drifting. The "
        "size is the root mean square about the mean; the largest come first."
    )
    rows: list[list[Cell]] = [[row["axis"], row["why"]] for row in wander.head(OTHERS).iter_rows(named=True)]
    return Section("Axes that wander", text + _first(OTHERS, wander.height), (("axis", "what"), rows))


def _strength(score: float) -> str:
    """In multiples of what chance would name."""
    return f"{score:.1f} ×" if score < 10 else f"{score:.0f} ×" if score < 100 else "over 100 ×"


def _trends(found: History) -> Section | None:
    named = moving(found)
    if not named.height:
        return None
    text = (
        "What the periods of the first axes that change or drift say, with bars of 1.96 standard deviations, the first "
        "as 100 %; in the table the straight line through all: its slope with one standard deviation. Those of all "
        "axes, per day, are in axes.parquet."
    )
    first, last = found.periods["first"].min(), found.periods["last"].max()
    days = min(1.0, (float(last or 0.0) - float(first or 0.0)) / DAY)  # type: ignore[arg-type]
    unit = "%/day" if days == 1 else f"% within {when(DAY * days)}"
    header = ("axis", *(f"{name.replace('_', ' ')} [{unit}]" for name in found.names))
    rows: list[list[Cell]] = [
        [row["axis"], *(_slope(days * row[f"{name}_slope"], days * row[f"{name}_slope_std"]) for name in found.names)]
        for row in named.iter_rows(named=True)
    ]
    return Section("Trend of those that move", text, (header, rows), svg=svg(trend_figure(found)))


def _slope(slope: float, std: float) -> str:
    """A slope in %, with the digits that its standard error leaves: two at most after the point."""
    digits = min(2, max(0, 1 - math.floor(math.log10(max(100 * std, 1e-9))))) if math.isfinite(std) else 2
    return f"{100 * slope:+.{digits}f} ± {max(100 * std, 0.01):.2g}" if math.isfinite(slope) else ""


def _spread(found: History) -> Section | None:
    if not found.axes.height or found.unknown.height == found.axes.height:
        return None
    text = (
        "Each point is an axis: across, how far its parameter lies from the median of its type; upward, how much "
        "it has changed within the history. Named axes are coloured and have their names."
    )
    known = found.axes.filter(found.axes["segments"] > 0).select(f"{name}_deviation" for name in found.names)
    alone = sum(all(math.isnan(value) for value in row) for row in known.iter_rows())
    if alone:
        text += (
            f" {alone} axes are of a type with fewer than {LEAST_AXES}: too few to tell what is usual, so they are "
            "drawn at 0 across and are judged by their own past alone."
        )
    return Section("From the others, and from their own past", text, svg=svg(spread_figure(found)), first=False)


def _map(found: History) -> Section | None:
    if not found.periods.height:
        return None
    text = (
        "A row for each axis, those that need attention at the top, with names in the colour of the verdict; a column "
        "for each period."
    )
    if found.axes.height > QUIET:
        text += f" Of the others the first {QUIET}, by how many periods are in doubt; {ROWS} rows at most."
    return Section("Map of findings", text, svg=svg(map_figure(found)))


def _list_unused(found: History) -> Section | None:
    rows: list[list[Cell]] = [
        [row["axis"] or row["file"], row["code"], row["times"], _from(row["from"]), row["text"]]
        for row in found.problems.head(PROBLEMS).iter_rows(named=True)
    ]
    if not rows:
        return None
    text = "What could not be used as it is, or was left out. Everything else was done."
    if found.problems.height > PROBLEMS:
        text += f" The first {PROBLEMS} of {found.problems.height}; all are in problems.parquet."
    return Section("What could not be used", text, (("axis, file or type", "finding", "times", "from", "what"), rows))


def _from(time: float) -> str:
    return when(time) if math.isfinite(time) else ""


def _how(found: History) -> Section:
    middle: Table = (
        ("parameter", "median", "5 %", "95 %", "unit"),
        [[name, *_quantiles(found.axes, name), unit] for name, unit in zip(found.names, found.units, strict=True)],
    )
    text = (
        f"{found.samples} samples in estimates of {found.segment:.3g} s each, put together by period ({found.period}). "
        "An axis is named if its change, drift or distance exceeds the tolerance by more than chance can, given the "
        "number of axes, parameters and times. In a healthy fleet less than one axis is named on average. "
        "Error bars hold the scatter of the estimates of one axis; they do not hold unmodelled effects."
    )
    return Section("The fleet, and how this was made", text, middle)


def _quantiles(axes: pl.DataFrame, name: str) -> list[str | float]:
    known = axes[name].drop_nans().drop_nulls()
    return ["" if not known.len() else float(known.quantile(part) or 0.0) for part in (0.5, 0.05, 0.95)]
