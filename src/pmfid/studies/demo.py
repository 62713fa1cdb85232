"""The demo: a cart whose mass changes under way, seen through four encoders by three estimators."""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pmfid.encoder import Encoder
from pmfid.errors import UsageError
from pmfid.estimators.base import default_zeros
from pmfid.estimators.bcrls import BCRLS
from pmfid.estimators.recursive import RecursiveEstimator, Track
from pmfid.estimators.rls import RLS
from pmfid.models.drive import Drive
from pmfid.simulation import CART, Scenario, make_scenario, write_csv
from pmfid.status import ADVICE, Status

if TYPE_CHECKING:
    import rich.table
    from matplotlib.figure import Figure

    from pmfid.report.html import Section

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

INCREMENTS = (4096, 1024, 512, 256)
RECORD = 1024  # the one that is written
CUTOFF = 50.0  # rad/s: a filter time constant of two samples
ORDER = 2
FORGETTING = 0.99
WINDOW = 5.0  # s, over which errors are averaged
BAND = 0.05  # of the new mass; the estimate has followed the step once it stays within
PLAUSIBLE_MASS = (0.8, 1.7)  # kg
START_UP = 1.0  # s
SHORTEST, LONGEST = 4 * WINDOW, 3600.0  # s

#: Name -> estimator and its pre-filter zeros; "extended RLS" is the biased estimate that the paper compensates.
METHODS: Mapping[str, tuple[type[RecursiveEstimator], tuple[float, ...] | None]] = {
    "RLS": (RLS, None),
    "extended RLS": (RLS, default_zeros(CUTOFF)),
    "BCRLS": (BCRLS, None),
}
PARAMETERS_TEXT = (
    "Nominal is the truth here. The start-up lies outside the panels; the band is two standard deviations of the estimate "
    "to either side."
)
HEADER = (
    ("encoder", "[1/turn]"),
    ("method", ""),
    ("mass before", "[%]"),
    ("mass after", "[%]"),
    ("viscous before", "[%]"),
    ("viscous after", "[%]"),
    ("Coulomb before", "[%]"),
    ("Coulomb after", "[%]"),
    ("std before", "[g]"),
    ("std after", "[g]"),
    ("follows after", "[s]"),
    ("out of range", "[-]"),
)


@dataclass(frozen=True)
class DemoRow:
    """What one method made of one encoder.

    errors_before, errors_after: error of the mean estimate by parameter name [%], over the last 5 s before the step
    of the mass and the last 5 s of the run; mass_std_before, mass_std_after: standard deviation over the same [kg];
    settling_time: from the step until the mass stays within 5 % of the new one [s], inf: never;
    outside: samples with the mass outside 0.8 to 1.7 kg after the first second.
    """

    increments: int
    method: str
    errors_before: Mapping[str, float]
    errors_after: Mapping[str, float]
    mass_std_before: float
    mass_std_after: float
    settling_time: float
    outside: int

    @property
    def worst_mass_error(self) -> float:
        """The larger error of the mass of both windows, without sign [%]."""
        return max(abs(self.errors_before["mass"]), abs(self.errors_after["mass"]))

    def cells(self) -> tuple[str, ...]:
        """The row as text, in the columns of HEADER."""
        before, after = self.errors_before, self.errors_after
        errors = [f"{errors['mass']:+.2f}" for errors in (before, after)]
        for name in ("viscous_friction", "coulomb_friction"):
            errors += [f"{errors_of[name]:+.1f}" for errors_of in (before, after)]
        spread = [f"{1000 * std:.1f}" for std in (self.mass_std_before, self.mass_std_after)]
        return (
            str(self.increments),
            self.method,
            *errors,
            *spread,
            _seconds(self.settling_time),
            str(self.outside),
        )


@dataclass(frozen=True, eq=False)
class DemoResult:
    """Records by increments per turn, tracks by method and increments, and a row for each combination."""

    seed: int
    scenarios: Mapping[int, Scenario]
    tracks: Mapping[str, Mapping[int, Track]]
    rows: tuple[DemoRow, ...]

    @property
    def t(self) -> Floats:
        """Time of the samples (n,) [s]."""
        return self.scenarios[INCREMENTS[0]].motion.t

    @property
    def step_time(self) -> float:
        """When the mass changes [s]."""
        return self.scenarios[INCREMENTS[0]].schedule.changes[1][0]

    @property
    def truth(self) -> dict[str, Floats]:
        """The true parameters over time, each (n,)."""
        return _truth(self.scenarios[INCREMENTS[0]])

    def rows_of(self, method: str) -> list[DemoRow]:
        """The rows of one method, from the finest encoder to the coarsest."""
        return [row for row in self.rows if row.method == method]


def run_demo(seed: int = 0, duration: float = 30.0) -> DemoResult:
    """Simulate the cart for `duration` [s] (20 to 3600) and run each method on each encoder.

    Random binary voltage of 3 V, mass 1.07 to 1.44 kg half-way, sampled every 10 ms; the seed (>= 0) draws the input
    and the place of the start on the encoder's lattice. Raises UsageError for values out of range.
    """
    if not SHORTEST <= duration <= LONGEST:
        raise UsageError(
            f"duration must be {SHORTEST:g} to {LONGEST:g} s, got {duration}; the errors are averaged over {WINDOW:g} s "
            "before the step half-way and at the end"
        )
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise UsageError(
            f"seed must be a whole number >= 0, got {seed}; any will do, the same gives the same run"
        )
    scenarios = {
        increments: make_scenario("mass-step", seed=seed, increments=increments, duration=duration)
        for increments in INCREMENTS
    }
    tracks = {
        method: {increments: _track(method, scenario) for increments, scenario in scenarios.items()}
        for method in METHODS
    }
    rows = tuple(_row(n, method, scenarios[n], tracks[method][n]) for n in INCREMENTS for method in METHODS)
    return DemoResult(seed, scenarios, tracks, rows)


def _track(method: str, scenario: Scenario) -> Track:
    estimator, zeros = METHODS[method]
    encoder = Encoder(scenario.resolution)
    settings = {"order": ORDER, "prefilter_zeros": zeros, "forgetting": FORGETTING}
    model = Drive(CART.input_gain)
    return estimator(model, encoder, scenario.dt, CUTOFF, **settings).run(scenario.motion.u, scenario.counts)


def _truth(scenario: Scenario) -> dict[str, Floats]:
    names = ("mass", "viscous_friction", "coulomb_friction")
    return dict(zip(names, scenario.schedule.at(scenario.motion.t, scenario.dt)[:3], strict=True))


def _row(increments: int, method: str, scenario: Scenario, track: Track) -> DemoRow:
    t, truth, mass = scenario.motion.t, _truth(scenario), track["mass"]
    step = int(np.flatnonzero(np.diff(truth["mass"]))[0]) + 1
    size = round(WINDOW / scenario.dt)
    before, after = slice(step - size, step), slice(t.size - size, t.size)
    return DemoRow(
        increments,
        method,
        _errors(track, truth, before),
        _errors(track, truth, after),
        float(mass[before].std()),
        float(mass[after].std()),
        settling_time(mass[step:], truth["mass"][-1], scenario.dt),
        int(np.sum(~_within(mass[t >= START_UP], *PLAUSIBLE_MASS))),
    )


def _errors(track: Track, truth: Mapping[str, Floats], window: slice) -> dict[str, float]:
    return {
        name: float(100 * (track[name][window] / true[window] - 1).mean()) for name, true in truth.items()
    }


def _within(values: Floats, low: float, high: float) -> Flags:
    return (values >= low) & (values <= high)


def settling_time(values: Floats, target: float, dt: float) -> float:
    """Time from the first of `values` (n,) until they stay within 5 % of the target [s]; inf where they do not."""
    outside = np.flatnonzero(~_within(values / target, 1 - BAND, 1 + BAND))
    if outside.size == 0:
        return 0.0
    settled = int(outside[-1]) + 1
    return math.inf if settled == values.size else settled * dt


def findings(result: DemoResult) -> list[str]:
    """What the numbers say, in sentences made from them."""
    plain, extended, compensated = (result.rows_of(method) for method in METHODS)
    worst = [max(row.worst_mass_error for row in rows) for rows in (plain, extended, compensated)]
    coarse = INCREMENTS[-1]
    travel = float(np.abs(np.diff(result.scenarios[coarse].counts)).mean())
    verdict = "good enough for most uses here" if worst[0] <= 1 else "biased here"
    friction = [f"{name} {_worst_friction(result.rows_of(name))}" for name in ("RLS", "BCRLS")]
    return [
        f"BCRLS: the mean mass is within {worst[2]:.2f} % of the truth with every encoder, before and after the step.",
        f"Plain RLS: within {worst[0]:.2f} %, {verdict}. Its error grows with the encoder's step: "
        f"at most {plain[0].worst_mass_error:.2f} % with {INCREMENTS[0]} increments, {plain[-1].worst_mass_error:.2f} % "
        f"with {coarse}, where the cart still moves {travel:.1f} counts per sample (mean).",
        f"Extended RLS is what the paper's compensation starts from, not a method to use: off by up to {worst[1]:.1f} %.",
        f"The step of the mass is followed to {100 * BAND:g} % within {_span(compensated)} s by BCRLS, {_span(plain)} s "
        f"by plain RLS.",
        f"Friction (largest error, viscous and Coulomb): {'; '.join(friction)}.",
    ]


def _worst_friction(rows: Sequence[DemoRow]) -> str:
    worst = [
        max(abs(errors[name]) for row in rows for errors in (row.errors_before, row.errors_after))
        for name in ("viscous_friction", "coulomb_friction")
    ]
    return f"{worst[0]:.1f} and {worst[1]:.1f} %"


def _span(rows: Sequence[DemoRow]) -> str:
    times = [row.settling_time for row in rows]
    return f"{_seconds(min(times))} to {_seconds(max(times))}"


def _seconds(time: float) -> str:
    return f"{time:.2f}" if math.isfinite(time) else "never"


def demo_table(result: DemoResult) -> rich.table.Table:
    """The rows as a table for the terminal, 80 columns wide, with what they say below."""
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, padding=0, title=_summary(result), caption="\n".join(findings(result)))
    table.title_justify = table.caption_justify = "left"
    for name, unit in HEADER:
        text = "\n".join([*name.split(" ", 1), *[""] * (1 - name.count(" ")), unit.replace("[", r"\[")])
        table.add_column(text, justify="left" if name == "method" else "right", no_wrap=True)
    for row in result.rows:
        table.add_row(*row.cells(), end_section=row.method == list(METHODS)[-1])
    return table


def _summary(result: DemoResult) -> str:
    mass = result.truth["mass"]
    return (
        f"Mass step {mass[0]:g} to {mass[-1]:g} kg at {result.step_time:g} s, seed {result.seed}: error of the mean "
        f"estimate over the last {WINDOW:g} s before the step and of the run"
    )


def comparison(result: DemoResult) -> Figure:
    """The mass by each method with each encoder."""
    from pmfid.report.figures import comparison_figure

    panels = {
        method: {f"{increments} increments": track for increments, track in tracks.items()}
        for method, tracks in result.tracks.items()
    }
    return comparison_figure(result.t, panels, "mass", result.truth["mass"])


def write_demo(out: Path, result: DemoResult) -> None:
    """Write report.html and cart.csv (one record) into the folder `out`, made if missing.

    Raises UsageError where they cannot be written.
    """
    from pmfid.report.html import write_report

    _make_folder(out)
    write_report(
        out / "report.html", "pmfid demo: a mass step seen through coarse encoders", _sections(result)
    )
    try:
        write_csv(result.scenarios[RECORD], out / "cart.csv")
    except OSError as error:
        raise UsageError(
            f"cannot write {out / 'cart.csv'}: {error.strerror}; choose another folder"
        ) from None


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"cannot make the folder {folder}: {error.strerror}; choose another one") from None


def _sections(result: DemoResult) -> list[Section]:
    from pmfid.report.figures import estimate_figure, signals_figure, status_figure, svg_text
    from pmfid.report.html import Section

    coarse, record = INCREMENTS[-1], result.scenarios[RECORD]
    track, motion = result.tracks["BCRLS"][coarse], record.motion
    parameters = estimate_figure(result.t, track, result.truth)
    status = status_figure(result.t, track.status)
    signals = signals_figure(result.t, motion.u, motion.v, input_unit="V")
    header = [f"{name} {unit}".strip() for name, unit in HEADER]
    table = (header, [row.cells() for row in result.rows])
    return [
        Section("What one sees", "\n\n".join(findings(result))),
        Section("Errors", _method_text(result), table=table),
        Section("The mass by each method", svg=svg_text(comparison(result))),
        Section(f"All parameters, BCRLS with {coarse} increments", PARAMETERS_TEXT, svg=svg_text(parameters)),
        Section(f"Status, BCRLS with {coarse} increments", _status_text(track), svg=svg_text(status)),
        Section("The record in cart.csv", _record_text(record), svg=svg_text(signals)),
    ]


def _method_text(result: DemoResult) -> str:
    return (
        f"{_summary(result)}. Order {ORDER}, cutoff {CUTOFF:g} rad/s, forgetting {FORGETTING:g}, a sample every "
        f"{1000 * result.scenarios[RECORD].dt:g} ms; input: random binary voltage of 3 V.\n\n"
        f"std: of the estimated mass in the same windows; follows after: from the step until the mass stays within "
        f"{100 * BAND:g} % of the new one; out of range: samples with the mass outside {PLAUSIBLE_MASS[0]:g} to "
        f"{PLAUSIBLE_MASS[1]:g} kg after the first {START_UP:g} s."
    )


def _status_text(track: Track) -> str:
    occurred = Status(int(np.bitwise_or.reduce(track.status)))
    return "\n\n".join(f"{str(bit.name).lower().replace('_', ' ')}: {ADVICE[bit]}." for bit in occurred)


def _record_text(record: Scenario) -> str:
    return (
        f"Columns t [s], u [V] and counts of the encoder with {RECORD} increments per turn: one count is "
        f"{record.resolution:g} m, input gain {CART.input_gain:g} N/V. The mass changes half-way, so only an on-line method "
        "with forgetting can be right at both ends. The figure shows the voltage and the true velocity of the cart."
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table; with --images FOLDER draw the picture of the README there."""
    import rich

    parser = argparse.ArgumentParser(prog="python -m pmfid.studies.demo", description=main.__doc__)
    parser.add_argument("--images", type=Path, metavar="FOLDER")
    folder = parser.parse_args(arguments).images
    result = run_demo()
    rich.print(demo_table(result))
    if folder is not None:
        from pmfid.report.figures import save_png

        _make_folder(folder)
        save_png(comparison(result), folder / "demo.png")


if __name__ == "__main__":
    main()
