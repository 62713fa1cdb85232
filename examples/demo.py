"""The demo: fast filters and coarser and coarser encoders, in one table and one picture: `python -m examples.demo`."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from pmfid.encoder import Encoder
from pmfid.estimators.iv import RIV
from pmfid.estimators.recursive import BCRLS, RLS
from pmfid.estimators.redge import REdge
from pmfid.estimators.results import Track
from pmfid.models.drive import Drive
from pmfid.report.figures import COLOURS, MAGENTA, decimation, figure_style, save_png
from pmfid.simulation import (
    CART,
    CART_DT,
    CART_LOADED,
    Scenario,
    Schedule,
    axis_toml,
    capture_edges,
    position_control,
    resolution_of,
    simulate_drive,
    steps,
    write_csv,
)
from pmfid.types import Counts, Floats

INCREMENTS = (4096, 1024, 512, 256, 64, 16)
DRAWN = (4096, 512, 256, 64)
METHODS = ("RLS", "BCRLS", "riv", "edge times")
RECORD = 256  # the written record
COARSEST = INCREMENTS[-1]  # in the picture of the README
DURATION, STEP = 30.0, 15.0  # [s]; the load changes at STEP
WINDOW = 5.0  # [s] before the step and before the end, over which errors are taken
CUTOFF = 150.0  # [rad/s]: filters of 7 ms
FORGETTING = 0.99  # a memory of 1 s
#: Position control: pulses of the reference [m, s], gain [V/m], largest input [V].
STROKE, HOLD, GAIN, LARGEST = 0.2, 1.0, 30.0, 6.0
LINE_ERROR = 0.01  # the lines of the encoder are displaced by up to this part of an increment
FINE, TICK = 20, 1e-6  # steps of the simulation per sample, and the tick of the timer [s], for the instants of edges


STORY = f"""\
A cart under position control; its load changes from {CART.mass:g} to {CART_LOADED.mass:g} kg.
Filters of {1000 / CUTOFF:.0f} ms, a memory of {CART_DT / (1 - FORGETTING):g} s.
RLS goes off as the encoder gets coarser. BCRLS, the method of the paper, does
not down to {RECORD} increments. riv and edge times go beyond."""


@dataclass(frozen=True, eq=False)
class Run:
    """A simulated run of the cart, and what its encoder shows: counts and times since the last edge [s], each (n,)."""

    scenario: Scenario
    edge_counts: Counts
    edge_ages: Floats


def simulate_run(increments: int, seed: int = 0) -> Run:
    """Return a run under position control through an encoder of `increments`; the load changes half-way."""
    schedule, resolution = Schedule(((0.0, CART), (STEP, CART_LOADED))), resolution_of(increments)
    rng = np.random.default_rng(seed)
    phase = resolution * float(rng.random())
    reference = steps(round(DURATION / CART_DT), CART_DT, STROKE, HOLD)
    motion, counts = position_control(
        schedule, reference, CART_DT, kp=GAIN, kd=0.0, u_max=LARGEST, resolution=resolution, phase=phase
    )
    fine = simulate_drive(schedule, np.repeat(motion.u, FINE), CART_DT / FINE, x0=phase)
    errors = LINE_ERROR * resolution * rng.uniform(-1, 1, increments)
    edge_counts, ages = capture_edges(fine, resolution, every=FINE, tick=TICK, line_errors=errors)
    return Run(Scenario("steps", motion, counts, resolution, CART_DT, schedule), edge_counts, ages)


def estimate_mass(method: str, run: Run) -> Track:
    """Return the estimates of one of METHODS over a run."""
    u, own = run.scenario.motion.u, (Drive(CART.input_gain), Encoder(run.scenario.resolution), CART_DT)
    if method == "edge times":
        lines = resolution_of(1) / run.scenario.resolution
        edges = REdge(*own, lines=round(lines), tick=TICK, memory=CART_DT / (1 - FORGETTING))
        return edges.run(u, run.edge_counts, run.edge_ages)
    cls = {"RLS": RLS, "BCRLS": BCRLS, "riv": RIV}[method]
    return cls(*own, CUTOFF, forgetting=FORGETTING).run(u, run.scenario.counts)


def rms_error(mass: Floats) -> float:
    """Return the RMS error of the mass (n,) [%] in the last seconds with the old and with the new load."""
    size, middle = round(WINDOW / CART_DT), round(STEP / CART_DT)
    old, new = mass[middle - size : middle] / CART.mass, mass[-size:] / CART_LOADED.mass
    return 100 * float(np.sqrt(np.mean((np.r_[old, new] - 1) ** 2)))


def error_table(errors: Mapping[tuple[str, int], float]) -> Table:
    """Return the errors by method and increments as a table for a terminal of 80 columns."""
    table = Table(box=None, title="Error of the mass [%]", title_justify="left", title_style="bold")
    table.add_column("increments per turn", justify="right")
    for method in METHODS:
        table.add_column(method, justify="right")
    for n in INCREMENTS:
        table.add_row(str(n), *(write_percent(errors[method, n]) for method in METHODS))
    return table


def write_percent(error: float) -> str:
    return "< 0.01" if error < 0.01 else f"{error:.2f}" if error < 9.95 else f"{error:.0f}"


def draw_masses(path: Path, t: Floats, masses: Mapping[tuple[str, int], Floats]) -> None:
    """Write a panel for each method with the mass (n,) by each drawn encoder."""
    from matplotlib.figure import Figure

    truth = np.where(t < STEP, CART.mass, CART_LOADED.mass)
    with figure_style():
        figure = Figure(figsize=(8.0, 5.2), layout="constrained")
        panels = figure.subplots(2, 2, sharex=True, sharey=True)
        for axes, method in zip(panels.flat, METHODS, strict=True):
            for colour, n in zip(COLOURS, DRAWN, strict=False):
                mass = masses[method, n]
                i = decimation(mass)
                axes.plot(t[i], mass[i], color=colour, label=f"{n} increments")
            axes.plot(t, truth, color=MAGENTA, ls="--", label="truth")
            axes.set_title(method)
        panels[0, 0].set_ylim(0.0, 2.0)
        panels[0, 0].set_xlim(0.0, DURATION)
        figure.supxlabel("time [s]", fontsize=10)
        figure.supylabel("mass [kg]", fontsize=10)
        handles, names = panels[0, 0].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside upper center", ncols=len(names))
        save_png(figure, path)


def draw_first(path: Path, run: Run, track: Track) -> None:
    """Write the picture of the README: the counts of an encoder, and the mass from their edges with its band."""
    from matplotlib.figure import Figure

    t, counts = run.scenario.motion.t, run.edge_counts
    start = round(2 * HOLD / CART_DT)
    with figure_style():
        figure = Figure(figsize=(8.0, 3.2), layout="constrained")
        left, right = figure.subplots(1, 2, width_ratios=(1, 2))
        left.step(t[start : start + 40], counts[start : start + 40] - counts[start], where="post")
        left.set_title("in: a cheap encoder")
        left.set_xlabel("time [s]")
        left.set_ylabel("counts")
        shown = slice(round(2.5 / CART_DT), None)
        mass, band = track["mass"][shown], 1.96 * track.theta_std[shown, 0]
        right.fill_between(t[shown], mass - band, mass + band, color=COLOURS[0], alpha=0.3, lw=0, label="95 % band")
        right.plot(t[shown], mass, color=COLOURS[0], label="estimate")
        truth = np.where(t < STEP, CART.mass, CART_LOADED.mass)
        right.plot(t, truth, color=MAGENTA, ls="--", label="truth")
        right.set_ylim(0.9, 1.6)
        right.set_xlim(0.0, DURATION)
        right.set_title("out: moving mass, while a load is put on")
        right.set_xlabel("time [s]")
        right.set_ylabel("mass [kg]")
        right.legend(loc="lower right")
        save_png(figure, path)


def write_record(folder: Path, run: Run) -> None:
    """Write cart.csv and its AXIS.toml, cart.toml. Raises OSError."""
    write_csv(run.scenario, folder / "cart.csv")
    text = axis_toml(run.scenario).partition("\n")[2]
    note = f"# The cart of the demo: pulses under position control, and a load that changes at {STEP:g} s.\n"
    (folder / "cart.toml").write_text(note + text, encoding="ascii", newline="\n")


def main(arguments: Sequence[str] | None = None) -> None:
    """Follow the load of a cart by four methods with coarser and coarser encoders."""
    parser = argparse.ArgumentParser(prog="python -m examples.demo", description=main.__doc__)
    parser.add_argument("--out", type=Path, default=Path("demo-report"), metavar="DIR", help="folder of the results")
    parser.add_argument("--images", type=Path, metavar="DIR", help="draw the pictures of the README there, too")
    chosen = parser.parse_args(arguments)
    chosen.out.mkdir(parents=True, exist_ok=True)
    runs = {n: simulate_run(n) for n in INCREMENTS}
    tracks = {(method, n): estimate_mass(method, run) for n, run in runs.items() for method in METHODS}
    masses = {key: np.where(track.theta_std[:, 0] > 0, track["mass"], np.nan) for key, track in tracks.items()}
    for folder in filter(None, (chosen.out, chosen.images)):
        folder.mkdir(parents=True, exist_ok=True)
        draw_masses(folder / "demo.png", runs[RECORD].scenario.motion.t, masses)
    if chosen.images is not None:
        draw_first(chosen.images / "first.png", runs[COARSEST], tracks["edge times", COARSEST])
    write_record(chosen.out, runs[RECORD])
    console = Console()
    console.print(error_table({key: rms_error(track["mass"]) for key, track in tracks.items()}))
    print(f"\n{STORY}\n")
    print(f"picture: {chosen.out / 'demo.png'}\nrecord: {chosen.out / 'cart.csv'}\nnext: pmfid identify ", end="")
    print(f"{chosen.out / 'cart.csv'} --config {chosen.out / 'cart.toml'} --out report")


if __name__ == "__main__":
    main()
