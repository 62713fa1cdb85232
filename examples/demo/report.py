"""The demo in the terminal and as a report: its table, its findings in words, and the figures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from examples.demo.run import (
    BAND,
    COLUMNS,
    CUTOFF,
    FORGETTING,
    INCREMENTS,
    LINE_ERROR,
    LINES,
    METHODS,
    ORDER,
    PLAUSIBLE_MASS,
    RECORD,
    START_UP,
    WINDOW,
    DemoResult,
    DemoRow,
    seconds,
)
from pmfid.estimators.results import Track
from pmfid.simulation import CART, Scenario, axis_toml, write_csv
from pmfid.status import ADVICE, Status

if TYPE_CHECKING:
    import rich.table
    from matplotlib.figure import Figure

    from pmfid.report.html import Section, Table


def findings(result: DemoResult) -> list[str]:
    """Return sentences that describe the numbers."""
    best, compensated, plain, extended = (result.rows_of(method) for method in METHODS)
    worst, coarse = _worst(plain, "mass"), INCREMENTS[-1]
    travel = float(np.abs(np.diff(result.scenarios[coarse].counts)).mean())
    verdict = "so it is fine here too" if worst <= 1 else "so it is biased here"
    return [
        f"RIV, instrumental variables with a simulated motion: the mean mass is within {_worst(best, 'mass'):.2f} % of "
        f"the truth with every encoder, viscous and Coulomb friction within {_friction(best)}. It needs some seconds "
        "of motion before it takes over from BCRLS.",
        f"BCRLS: the mean mass is within {_worst(compensated, 'mass'):.2f} % of the truth with every encoder, "
        "before and after the step.",
        f"Plain RLS: within {worst:.2f} %, {verdict}. With {INCREMENTS[0]} increments its error is at most "
        f"{plain[0].worst('mass'):.2f} %; with {coarse}, where the cart still moves {travel:.1f} counts per sample "
        f"(mean), {plain[-1].worst('mass'):.2f} %.",
        "Extended RLS is what the paper's compensation starts from, no method by itself: off by up to "
        f"{_worst(extended, 'mass'):.1f} %.",
        f"To follow the step to within {100 * BAND:g} % RIV takes {_span(best)}, BCRLS {_span(compensated)}, plain RLS "
        f"{_span(plain)}.",
        f"Friction, largest error of the viscous and of the Coulomb part: plain RLS {_friction(plain)}, BCRLS "
        f"{_friction(compensated)}.",
    ]


def what_happened(result: DemoResult) -> str:
    """Return one sentence on the result."""
    mass, best, plain = result.truth["mass"], result.rows_of("RIV"), result.rows_of("RLS")
    return (
        f"At {result.step_time:g} s the load of the cart rises from {mass[0]:g} to {mass[-1]:g} kg: RIV finds both "
        f"within {_worst(best, 'mass'):.2g} % with every encoder, and is within {100 * BAND:g} % of the new one "
        f"{_span(best)} after the step; plain RLS is off by {plain[-1].worst('mass'):.2g} % with {INCREMENTS[-1]} "
        "increments per turn."
    )


def overview(result: DemoResult) -> Table:
    """Return a row for each method, with the worst error over all encoders."""
    header = ["method", *(f"{name}, largest error [%]" for name in ("mass", "viscous", "Coulomb"))]
    header += ["follows the step after [s]", "samples out of range"]
    rows = []
    for method in METHODS:
        own = result.rows_of(method)
        errors = [f"{_worst(own, name):.2f}" for name in ("mass", "viscous_friction", "coulomb_friction")]
        rows.append([method, *errors, _span(own).removesuffix(" s"), str(max(row.outside for row in own))])
    return header, rows


def _worst(rows: Sequence[DemoRow], name: str) -> float:
    return max(row.worst(name) for row in rows)


def _friction(rows: Sequence[DemoRow]) -> str:
    return f"{_worst(rows, 'viscous_friction'):.1f} and {_worst(rows, 'coulomb_friction'):.1f} %"


def _span(rows: Sequence[DemoRow]) -> str:
    times = [row.settling_time for row in rows]
    return f"{seconds(min(times))} to {seconds(max(times))} s"


def demo_table(result: DemoResult) -> rich.table.Table:
    """Return the rows as a table for a terminal of 80 columns or more, with the findings below."""
    from rich import box
    from rich.table import Table

    table = Table(
        box=box.SIMPLE_HEAD,
        padding=0,
        show_edge=False,
        title=_summary(result) + "\n",
        caption="\n" + "\n".join(findings(result)),
        title_justify="left",
        caption_justify="left",
        title_style="bold",
        caption_style="",
    )
    for _, short in COLUMNS:
        table.add_column(short, justify="left" if short == "method" else "right", no_wrap=True)
    for row in result.rows:
        table.add_row(*row.cells(), end_section=row.method == list(METHODS)[-1])
    return table


def _summary(result: DemoResult) -> str:
    mass = result.truth["mass"]
    return (
        f"Mass {mass[0]:g} kg, from {result.step_time:g} s on {mass[-1]:g} kg (seed {result.seed}). Error of the "
        f"mean estimate over the last {WINDOW:g} s with the old and with the new load"
    )


def comparison(result: DemoResult, methods: Sequence[str] = tuple(METHODS)) -> Figure:
    """Return the figure of the mass by each of the methods with each encoder."""
    from pmfid.report.figures import comparison_figure

    panels = {method: {f"{n} increments": track for n, track in result.tracks[method].items()} for method in methods}
    return comparison_figure(result.t, panels, "mass", result.truth["mass"])


def edge_comparison(result: DemoResult) -> Figure:
    """Return the figure of the mass by 16 increments with edge times, and by counts alone."""
    from pmfid.report.figures import comparison_figure

    return comparison_figure(result.t, {"Mass while the load changes": result.edges}, "mass", result.truth["mass"])


def write_demo(out: Path, result: DemoResult) -> None:
    """Write report.html, cart.csv (one record) and its AXIS.toml, cart.toml, into the folder `out`.

    A missing folder is made. Raises OSError if the files cannot be written.
    """
    from pmfid.report.html import write_report

    out.mkdir(parents=True, exist_ok=True)
    write_report(out / "report.html", "A mass step seen through coarse encoders", _sections(result))
    write_csv(result.scenarios[RECORD], out / "cart.csv")
    (out / "cart.toml").write_text(axis_toml(result.scenarios[RECORD]), encoding="ascii", newline="\n")


def _sections(result: DemoResult) -> list[Section]:
    from pmfid.report.figures import estimate_figure, signals_figure, status_figure
    from pmfid.report.html import Section, svg

    coarse, motion = INCREMENTS[-1], result.scenarios[RECORD].motion
    track = result.tracks["RIV"][coarse]
    parameters = estimate_figure(result.t, track, result.truth)
    signals = signals_figure(result.t, motion.u, motion.v, input_unit="V")
    table = ([name for name, _ in COLUMNS], [row.cells() for row in result.rows])
    return [
        Section("What happened", what_happened(result), overview(result), svg(comparison(result, ["RIV"])), first=True),
        Section("What one sees", "\n\n".join(findings(result))),
        Section("Errors", _method_text(result), table=table),
        Section("Edge times", _edge_text(result), svg=svg(edge_comparison(result))),
        Section("The mass by each method", svg=svg(comparison(result))),
        Section(
            f"All parameters, RIV with {coarse} increments",
            "The nominal values are the true ones here.",
            svg=svg(parameters),
        ),
        Section("Its status", _status_text(track), svg=svg(status_figure(result.t, track.status))),
        Section("The record in cart.csv", _record_text(result.scenarios[RECORD]), svg=svg(signals)),
    ]


def _method_text(result: DemoResult) -> str:
    return (
        f"{_summary(result)}; the standard deviation is over the same windows. Follows the step: the mass stays "
        f"within {100 * BAND:g} % of the new one. Out of range: outside {PLAUSIBLE_MASS[0]:g} to "
        f"{PLAUSIBLE_MASS[1]:g} kg after the first {START_UP:g} s.\n\n"
        f"All methods: order {ORDER}, cutoff {CUTOFF:g} rad/s, forgetting {FORGETTING:g}, a sample every "
        f"{1000 * result.scenarios[RECORD].dt:g} ms. Input: random binary voltage of 3 V."
    )


def _edge_text(result: DemoResult) -> str:
    return (
        f"A timer captures when the last edge of an encoder of {LINES} increments came. REdge follows the mass by "
        f"these times. Its lines are off by up to {100 * LINE_ERROR:g} % of an increment. RIV takes counts alone."
    )


def _status_text(track: Track) -> str:
    occurred = Status(int(np.bitwise_or.reduce(track.status)))
    return "\n\n".join(f"{str(bit.name).lower().replace('_', ' ')}: {ADVICE[bit]}." for bit in occurred)


def _record_text(record: Scenario) -> str:
    return (
        f"Columns t [s], u [V] and counts, with {RECORD} increments per turn: resolution {record.resolution:g} m "
        f"per count, input gain {CART.input_gain:g} N/V. The load changes half-way, so only an on-line method with "
        "forgetting can be right at both ends. Below: the voltage and the true velocity."
    )
