"""The page of a validation."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from pmfid.diagnostics.free_run import FreeRun
from pmfid.pipeline.validation import Validation
from pmfid.report.figures import COLOURS, followed_figure, open_figure, plain_ticks
from pmfid.report.page import ResultPage, Section

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Largest number of records that have their own figure.
MOST_FIGURES = 12

Rows = tuple[list[str], list[list[str]]]


def validation_page(found: Validation) -> ResultPage:
    """Return the page of a validation."""
    rows = [[name, f"{x:.6g}", unit] for name, x, unit in zip(found.names, found.theta, found.units, strict=True)]
    sections = [
        Section(f"Parameters by {found.method}", table=(["parameter", "value", "unit"], rows)),
        Section("Free run", _text(found), run_rows(found)),
    ]
    if any(run.horizons for run in found.runs):
        text = (
            "The simulation restarts at the given interval. Each start is fitted to the first samples after the "
            "restart."
        )
        sections.append(Section("Restarted", text, horizon_rows(found), lambda: horizon_figure(found)))
    sections += [
        Section(f"Measured and simulated: {run.name}", figure=partial(run_figure, run, found.unit))
        for run in found.runs[:MOST_FIGURES]
    ]
    status = [f"status: {', '.join(found.status)}"] if found.status else []
    remarks = [*status, *(f"note: {note}" for note in found.notes)]
    return ResultPage("validation", f"{found.runs[0].name}: predicted", found.to_dict(), sections, remarks=remarks)


def _text(found: Validation) -> str:
    read = ", ".join(dict.fromkeys(f"{run.read:.3g} s" for run in found.runs))
    text = (
        f"Simulated from the input alone. The start is fitted to the first {read}; the rest of the output is not used. "
        "Errors are root mean squares; fit is 100 (1 - |y - simulated| / |y - mean y|); relative is |y - simulated| "
        "over |y|, and depends on the zero of y; encoder: error of rounding to the encoder's step; mean, standstill: "
        "error of a model that stays at the mean of the record, or at its first value."
    )
    return "\n\n".join([text, *(f"Note: {note}." for note in found.notes)])


def _with_unit(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name


def run_rows(found: Validation) -> Rows:
    """Return the header and a row of text for each record."""
    header = ["record", *(_with_unit(name, found.unit) for name in ("error", "largest"))]
    header += ["fit [%]", "relative [%]", *(_with_unit(n, found.unit) for n in ("encoder", "mean", "standstill"))]
    return header, [
        [
            run.name,
            *(_number(value) for value in (run.rmse, run.largest)),
            *("–" if value is None else f"{value:.2f}" for value in (run.fit, run.relative)),
            *(_number(value) for value in (run.encoder, run.mean, run.standstill)),
        ]
        for run in found.runs
    ]


def horizon_rows(found: Validation) -> Rows:
    """Return the header and a row of text for each record and horizon."""
    header = ["record", "every [s]", "runs", _with_unit("error", found.unit), _with_unit("standstill", found.unit)]
    return header, [
        [run.name, f"{part.seconds:g}", str(part.runs), _number(part.rmse), _number(part.standstill)]
        for run in found.runs
        for part in run.horizons
    ]


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.4g}"


def run_figure(run: FreeRun, unit: str) -> Figure:
    """Draw the measured and the simulated output over time, with their difference below."""
    return followed_figure(run.t, run.measured, run.simulated, unit, run.read)


def horizon_figure(found: Validation) -> Figure:
    """Draw the errors over the interval between restarts. The last point is the error without a restart."""
    with open_figure(3.6) as (figure, (axes,)):
        for number, run in enumerate(found.runs):
            colour, duration = COLOURS[number % len(COLOURS)], float(run.t[-1] - run.t[0])
            seconds = [*(part.seconds for part in run.horizons), duration]
            axes.plot(seconds, [*(p.rmse for p in run.horizons), run.rmse], "o-", color=colour, label=run.name)
            still = [*(part.standstill for part in run.horizons), run.standstill]
            axes.plot(seconds, still, ":", color=colour, lw=1)
            if run.encoder is not None:
                axes.axhline(run.encoder, color=colour, ls="--", lw=1)
        axes.set_xscale("log")
        axes.set_yscale("log")
        for axis in (axes.xaxis, axes.yaxis):
            plain_ticks(axis)
        axes.set_xticks(sorted({part.seconds for run in found.runs for part in run.horizons}))
        axes.set_xlabel("restarted every [s]; last point: never (dotted: standstill; dashed: encoder alone)")
        axes.set_ylabel(_with_unit("root mean square error", found.unit))
        axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=4, borderaxespad=0.2)
    return figure
