"""Edge times against counts: errors and coverage of `EdgeFit` off-line and `REdge` on-line, and errors of `interval`.

The bound is that of Cramer and Rao for the edges, with known variances of lines and instants. `interval` takes the same
counts without edges.

`python -m studies.edges --seeds 5 [--held-back] [--on-line] [--machine NAME] [--faults 3]`. With `--on-line`, `REdge`
runs alone. A table of all cells follows. Its gain says how many times smaller the standard deviation of the mass is
than from counts. The efficiency is the bound over the root mean square error. The last line says how many of the errors
of `REdge` without a status exceed 2, 3 and 5 standard errors.

`python -m studies.edges --monitor --seeds 12 --hours 1` compares monitors on the same motions of the cart:
`EdgeMonitor` with edges of a coarse encoder, and `Monitor` with `riv` and counts of a fine one.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
from itertools import product

import numpy as np

from pmfid import Drive, EdgeFit, Encoder, MotionFit, REdge
from pmfid.errors import NotIdentifiableError
from pmfid.fit.edges import FINEST as FINEST_EDGE
from pmfid.fit.edges import fit_edges
from pmfid.fit.likelihood import Gaussian
from pmfid.fit.machine import machine_of
from pmfid.fit.problem import FitProblem
from pmfid.monitor import Alarm, EdgeMonitor, Monitor, Watch
from pmfid.monitor.events import Event
from pmfid.simulation import CART, Machine, capture_edges, resolution_of, simulate_drive
from pmfid.simulation.drive import Schedule
from pmfid.simulation.scenarios import CART_DT
from pmfid.status import Status
from pmfid.types import Counts, Floats
from studies.edge_faults import FINE, HELD_BACK, INCREMENTS, MACHINES, TICK, move_axis
from studies.machines import Axis, truth
from studies.monitoring.axis import calibration, changing, make_riv, normal_work
from studies.monitoring.changes import AFTER, BEFORE, CHANGES, changed

MOTIONS = ("prbs", "stop-and-go")
COARSE = 64  # most increments of the cells that the table of all cells compares to counts
#: Largest distance of a line from its place, in steps, and mean lateness of an instant [s].
FAULTS = ((0.0, 0.0), (0.01, 0.0), (0.03, 0.0), (0.1, 0.0), (0.01, 1e-5), (0.01, 5e-5))
#: Encoders of the monitors with edges and with counts, and memory of the former [s].
WATCHED, FINEST, MEMORY = (64, 16), 4096, 10.0
#: Rows of the errors of one run: off-line, on-line, both in standard deviations, `interval`, and the bound.
OFF_LINE, ON_LINE, OFF_LINE_STD, ON_LINE_STD, INTERVAL, BOUND = range(6)


def bound_errors(method: EdgeFit, truth: Floats, record: tuple[Floats, Counts, Floats], off: float) -> Floats:
    """Return the smallest standard deviations (3,) that an estimate without bias can have."""
    stretches, margins = method.with_edges(*record, np.ones(record[0].size, bool))
    _, search = fit_edges(FitProblem(machine_of(method.equation), stretches, method.encoder.resolution), None, margins)
    ((_, v),) = search.problem.motion(search.q, search.starts)
    (stretch,) = search.plain.stretches
    variance = np.where(stretch.counted, stretch.variance, TICK**2 / 12 * (v / method.encoder.resolution) ** 2)
    noise = Gaussian((replace(stretch, variance=np.maximum(variance, FINEST_EDGE**2)),), spread=off / np.sqrt(3))
    (block,) = noise(search.problem.linearise(search.q, search.starts))[1]
    sensitivity = np.column_stack([block.J, block.K])
    cov = np.linalg.inv(sensitivity.T @ sensitivity)[: truth.size, : truth.size]
    return np.asarray(np.sqrt(np.diagonal(cov)) * [truth[0], 1.0, 1.0])  # the mass is a logarithm


def make_record(
    axis: Axis, motion: str, increments: int, off: float, late: float, seed: int
) -> tuple[float, tuple[Floats, Counts, Floats]]:
    """Return the travel per count, and input, counts and ages of one run."""
    rng = np.random.default_rng([seed, 33])
    resolution = axis.resolution * 4096 / increments
    u = move_axis(axis, Machine(axis.drive), motion, resolution, rng)
    motion_of = simulate_drive(axis.drive, np.repeat(u, FINE), axis.dt / FINE)
    errors = off * resolution * rng.uniform(-1, 1, increments)
    phase = rng.random() * resolution
    counts, ages = capture_edges(motion_of, resolution, phase, every=FINE, tick=TICK, line_errors=errors)
    return resolution, (u, counts, np.clip(ages - late * rng.exponential(size=ages.size), 0.0, axis.dt))


def run_once(
    axis: Axis, motion: str, increments: int, off: float, late: float, seed: int, alone: bool
) -> tuple[Floats, int]:
    """Return errors (6, 3), and the status of `REdge` at the end.

    Errors and bound are relative to the parameters, and NaN if a method refuses the record or `REdge` runs `alone`.
    """
    found, exact, model = np.full((6, 3), np.nan), truth(axis), Drive(axis.drive.input_gain)
    resolution, record = make_record(axis, motion, increments, off, late, seed)
    cutoff, encoder = 0.2 / axis.dt, Encoder(resolution)
    on_line = REdge(model, encoder, axis.dt, lines=increments, tick=TICK)
    error = on_line.run(*record).theta[-1] - exact
    if not on_line.status & Status.STARTING:
        found[[ON_LINE, ON_LINE_STD]] = error / exact, error / on_line.theta_std
    if alone:
        return found, on_line.status
    method = EdgeFit(model, encoder, axis.dt, cutoff, lines=increments, tick=TICK)
    with suppress(NotIdentifiableError):
        fit = method.fit(*record)
        error = fit.theta - exact
        found[[OFF_LINE, OFF_LINE_STD]] = error / exact, error / fit.theta_std
    with suppress(NotIdentifiableError):
        found[INTERVAL] = MotionFit(model, encoder, axis.dt, cutoff).fit(*record[:2]).theta / exact - 1
    if not late:
        with suppress(NotIdentifiableError):
            found[BOUND] = bound_errors(method, exact, record, off) / exact
    return found, on_line.status


def measure(machines: Mapping[str, Axis], faults: int, seeds: range, alone: bool) -> None:
    """Print a row for each machine, motion, encoder and fault: root mean square errors over the seeds."""
    head = "off-line [%] | within 2 sd [%] | on-line [%] | within 2 sd [%] | status | bound [%] | interval [%]"
    print(f"| machine | motion | increments | lines off [%] | late [us] | {head} |")
    print("|---" * 12 + "|")
    silent: list[Floats] = []
    cells: dict[tuple[float, float], list[tuple[int, Floats]]] = {}
    for name, axis in machines.items():
        for motion, increments, (off, late) in product(MOTIONS, INCREMENTS, FAULTS[:faults]):
            runs = [run_once(axis, motion, increments, off, late, seed, alone) for seed in seeds]
            found = np.array([one for one, _ in runs])
            cells.setdefault((off, late), []).append((increments, found))
            silent += [one[ON_LINE_STD] for one, status in runs if not status]
            within = 100 * np.mean(np.abs(found[:, [OFF_LINE_STD, ON_LINE_STD]]) < 2, axis=(0, 2))
            off_line, on_line, bound, interval = (
                _format_errors(found[:, row]) for row in (OFF_LINE, ON_LINE, BOUND, INTERVAL)
            )
            cell = [name, motion, increments, f"{100 * off:g}", f"{1e6 * late:g}"]
            cell += [off_line, f"{within[0]:.0f}", on_line, f"{within[1]:.0f}"]
            cell += [sum(status != 0 for _, status in runs), bound, interval]
            print(f"| {' | '.join(map(str, cell))} |", flush=True)
    summarize(cells)
    beyond = ", ".join(f"{100 * np.mean(np.abs(silent) > most):.2g} % beyond {most} sd" for most in (2, 3, 5))
    print(f"on-line without a status: {beyond}")


def summarize(cells: Mapping[tuple[float, float], list[tuple[int, Floats]]]) -> None:
    """Print gain over counts, bias and efficiency of the mass for each fault and method, from errors (seeds, 6, 3)."""
    print("| lines off [%] | late [us] | method | gain, least | median | bias, most [%] | efficiency, mean | least |")
    print("|---" * 8 + "|")
    for (off, late), found in cells.items():
        for method, row in (("off-line", OFF_LINE), ("on-line", ON_LINE)):
            mass = [(increments, one[:, (row, INTERVAL, BOUND), 0]) for increments, one in found]
            mass = [(increments, one[np.all(np.isfinite(one[:, :2]), axis=1)]) for increments, one in mass]
            coarse = [one for increments, one in mass if increments <= COARSE and len(one) > 1]
            gain = [float(np.std(one[:, 1]) / np.std(one[:, 0])) for one in coarse] or [np.nan]
            bias = max([abs(np.mean(one[:, 0])) for one in coarse], default=np.nan)
            known = [one[np.isfinite(one[:, 2])] for _, one in mass]
            share = [np.sqrt(np.mean(one[:, 2] ** 2) / np.mean(one[:, 0] ** 2)) for one in known if len(one) > 1]
            values = [np.min(gain), np.median(gain), 100 * bias]
            values += [np.exp(np.mean(np.log(share))), np.min(share)] if share else [np.nan, np.nan]
            print(
                f"| {100 * off:g} | {1e6 * late:g} | {method} | {' | '.join(f'{x:.2g}' for x in values)} |", flush=True
            )


def watch_edges(u: Floats, schedule: Schedule, increments: int, fault: tuple[float, float], seed: int) -> list[Alarm]:
    """Return the alarms of `EdgeMonitor` on the cart. `fault` is an entry of FAULTS."""
    rng, resolution = np.random.default_rng([seed, 34]), resolution_of(increments)
    motion, phase = simulate_drive(schedule, np.repeat(u, FINE), CART_DT / FINE), rng.random() * resolution
    errors = fault[0] * resolution * rng.uniform(-1, 1, increments)
    counts, ages = capture_edges(motion, resolution, phase, every=FINE, tick=TICK, line_errors=errors)
    ages = np.clip(ages - fault[1] * rng.exponential(size=ages.size), 0.0, CART_DT)
    estimator = REdge(Drive(CART.input_gain), Encoder(resolution), CART_DT, lines=increments, tick=TICK, memory=MEMORY)
    watched = EdgeMonitor(estimator, np.array([CART.mass, CART.viscous_friction, CART.coulomb_friction]))
    events: list[Event] = []
    for sample in zip(u.tolist(), counts.tolist(), ages.tolist(), strict=True):
        events += watched.step(*sample)[1]
    return [event for event in events if isinstance(event, Alarm)]


def watch_counts(u: Floats, counts: Counts) -> list[Alarm]:
    """Return the alarms of `Monitor` on the cart with the finest encoder."""
    found = calibration(FINEST)
    watched = Monitor(make_riv(FINEST, found.theta), found, Watch())
    return [event for _, _, event in watched.run(u, counts).events if isinstance(event, Alarm)]


def draw_change(name: str, factor: float, seed: int) -> tuple[float, Schedule, Floats, Counts]:
    """Return the time of a change [s], its schedule, and the input and the finest counts of the cart, each (n,)."""
    when = BEFORE + 3.0 * float(np.random.default_rng([seed, 35]).random())
    schedule = Schedule(((0.0, CART), (when, changed(name, factor))))
    return when, schedule, *changing(schedule, seed, FINEST, when + AFTER)


def compare_monitors(seeds: range, hours: float) -> None:
    """Print delays and causes of both monitors for each change, and false alarms in `hours` of normal work."""
    print("| change | encoder | lines off [%] | late [us] | delay, median [s] | mean | most | right cause | early |")
    print("|---" * 9 + "|")
    for change, (name, factor) in CHANGES.items():
        found: dict[str, list[tuple[float, bool, int]]] = {}
        for seed in seeds:
            when, schedule, u, counts = draw_change(name, factor, seed)
            for key, alarms in watch_all(u, counts, schedule, seed, product(WATCHED, FAULTS)).items():
                after = [alarm for alarm in alarms if alarm.time >= when]
                right = bool(after) and after[0].parameter == name and not after[0].others
                delay = after[0].time - when if after else np.inf
                found.setdefault(key, []).append((delay, right, len(alarms) - len(after)))
        for key, rows in found.items():
            delays, rights, early = np.array(rows).T
            times = " | ".join(f"{value:.2f}" for value in (np.median(delays), np.mean(delays), np.max(delays)))
            print(f"| {change} | {key} | {times} | {rights.sum():.0f} of {len(rows)} | {early.sum():.0f} |", flush=True)
    count_false_alarms(hours)


def watch_all(
    u: Floats, counts: Counts, schedule: Schedule, seed: int, cases: Iterable[tuple[int, tuple[float, float]]]
) -> dict[str, list[Alarm]]:
    """Return the alarms of both monitors by encoder, lines and lateness."""
    alarms = {
        f"{increments}, edges | {100 * off:g} | {1e6 * late:g}": watch_edges(u, schedule, increments, (off, late), seed)
        for increments, (off, late) in cases
    }
    return alarms | {f"{FINEST}, counts | 0 | -": watch_counts(u, counts)}


def count_false_alarms(hours: float) -> None:
    """Print the false alarms of both monitors in runs of half an hour of normal work."""
    totals: dict[str, int] = {}
    for seed in range(round(2 * hours)):
        u, counts = normal_work(5000 + seed, FINEST, 0.5)
        cases = product(WATCHED[:1], FAULTS[1:])
        for key, found in watch_all(u, counts, Schedule(((0.0, CART),)), seed, cases).items():
            totals[key] = totals.get(key, 0) + len(found)
    for key, number in totals.items():
        print(f"normal work, {hours:g} h: | {key} | {number} false alarms", flush=True)


def _format_errors(errors: Floats) -> str:
    """Return the root mean squares of relative errors (seeds, 3) in percent."""
    if np.all(np.isnan(errors)):
        return "-"
    return " ".join(f"{value:.2g}" for value in 100 * np.sqrt(np.nanmean(errors**2, axis=0)))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--held-back", action="store_true")
    parser.add_argument("--machine", choices=(*MACHINES, *HELD_BACK), help="this machine alone")
    parser.add_argument("--faults", type=int, default=len(FAULTS), help="the first ones of FAULTS")
    parser.add_argument("--on-line", action="store_true", help="REdge alone")
    parser.add_argument("--monitor", action="store_true", help="compare monitors")
    parser.add_argument("--hours", type=float, default=1.0, help="of normal work, with --monitor")
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.seeds)
    if options.monitor:
        compare_monitors(seeds, options.hours)
    else:
        machines = HELD_BACK if options.held_back else MACHINES
        if options.machine:
            machines = {options.machine: {**MACHINES, **HELD_BACK}[options.machine]}
        measure(machines, options.faults, seeds, options.on_line)
