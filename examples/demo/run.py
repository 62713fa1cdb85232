"""The demo: a cart whose mass changes during the run, with four encoders and three estimators."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pmfid.encoder import Encoder
from pmfid.errors import UsageError
from pmfid.estimators.iv import RIV
from pmfid.estimators.plants import default_zeros
from pmfid.estimators.recursive import BCRLS, RLS, RecursiveEstimator
from pmfid.estimators.redge import REdge
from pmfid.estimators.results import Track
from pmfid.models.drive import Drive
from pmfid.simulation import CART, Scenario, capture_edges, make_scenario, resolution_of, simulate_drive
from pmfid.types import Flags, Floats

INCREMENTS = (4096, 1024, 512, 256)
RECORD = 4096  # the written record, which examples/cart.toml reads
CUTOFF = 50.0  # [rad/s]: a filter time constant of two samples
ORDER = 2
FORGETTING = 0.99
LINES, LINE_ERROR = 16, 0.01  # the encoder with edge times; its lines are off by up to this part of an increment
FINE = 20  # steps of the simulation per sample, for the instants of edges
TICK = 1e-6  # [s], of the timer
WINDOW = 5.0  # [s], over which errors are averaged
BAND = 0.05  # of the new mass; an estimate follows the step when it stays within this band
PLAUSIBLE_MASS = (0.8, 1.7)  # [kg]
START_UP = 1.0  # [s]
SHORTEST, LONGEST = 4 * WINDOW, 3600.0  # [s]

#: Name -> estimator and its pre-filter zeros; "extended RLS" is the biased estimate that BCRLS compensates.
METHODS: Mapping[str, tuple[type[RecursiveEstimator], tuple[float, ...] | None]] = {
    "RIV": (RIV, None),
    "BCRLS": (BCRLS, None),
    "RLS": (RLS, None),
    "extended RLS": (RLS, default_zeros(CUTOFF)),
}
#: Columns of the report, and of the terminal, where the whole table has 80 columns.
COLUMNS = (
    ("increments per turn", "inc."),
    ("method", "method"),
    ("mass, old load [%]", "mass\nold\n%"),
    ("mass, new load [%]", "mass\nnew\n%"),
    ("viscous, old load [%]", "visc.\nold\n%"),
    ("viscous, new load [%]", "visc.\nnew\n%"),
    ("Coulomb, old load [%]", "Coul.\nold\n%"),
    ("Coulomb, new load [%]", "Coul.\nnew\n%"),
    ("std of mass, old load [g]", "std\nold\ng"),
    ("std of mass, new load [g]", "std\nnew\ng"),
    ("follows the step after [s]", "after\nstep\ns"),
    ("samples out of range", "out"),
)


@dataclass(frozen=True)
class DemoRow:
    """The result of one method with one encoder.

    `errors_old` and `errors_new` are the errors of the mean estimate by parameter name [%]: over the last 5 s before
    the mass changes, and over the last 5 s of the run. `std_old` and `std_new` are the standard deviations of the mass
    over the same windows [kg]. `settling_time` lasts from the step until the mass stays within 5 % of the new one [s];
    inf means never. `outside` counts the samples with a mass outside 0.8 to 1.7 kg after the first second.
    """

    increments: int
    method: str
    errors_old: Mapping[str, float]
    errors_new: Mapping[str, float]
    std_old: float
    std_new: float
    settling_time: float
    outside: int

    def worst(self, name: str) -> float:
        """Return the larger absolute error of a parameter over both windows [%]."""
        return max(abs(self.errors_old[name]), abs(self.errors_new[name]))

    def cells(self) -> tuple[str, ...]:
        """Return the row as text, in the order of COLUMNS."""
        digits = {"mass": 2, "viscous_friction": 1, "coulomb_friction": 1}
        both = (self.errors_old, self.errors_new)
        errors = [f"{errors[name]:+.{n}f}" for name, n in digits.items() for errors in both]
        spread = [f"{1000 * std:.1f}" for std in (self.std_old, self.std_new)]
        settling, outside = seconds(self.settling_time), str(self.outside)
        return (str(self.increments), self.method, *errors, *spread, settling, outside)


@dataclass(frozen=True, eq=False)
class DemoResult:
    """Records by increments per turn, tracks by method and increments, and a row for each combination.

    `edges` holds the tracks of an encoder of 16 increments, with and without edge times, and a track of 4096 counts.
    `t` holds the times of the samples (n,) [s]. `truth` holds the true parameters by name, each (n,). The mass changes
    at `step_time` [s].
    """

    seed: int
    t: Floats
    truth: Mapping[str, Floats]
    step_time: float
    scenarios: Mapping[int, Scenario]
    tracks: Mapping[str, Mapping[int, Track]]
    edges: Mapping[str, Track]
    rows: tuple[DemoRow, ...]

    def rows_of(self, method: str) -> list[DemoRow]:
        """Return the rows of one method, from the finest encoder to the coarsest."""
        return [row for row in self.rows if row.method == method]


def run_demo(seed: int = 0, duration: float = 30.0) -> DemoResult:
    """Simulate the cart for `duration` [s] (20 to 3600) and run each method on each encoder.

    The input is a random binary voltage of 3 V, sampled every 10 ms; the mass steps from 1.07 to 1.44 kg half-way. The
    seed (>= 0) draws the input and the encoder's start phase. Raises UsageError for values out of range.
    """
    if not SHORTEST <= duration <= LONGEST:
        raise UsageError(
            f"duration must be {SHORTEST:g} to {LONGEST:g} s, got {duration}; the errors are averaged over "
            f"{WINDOW:g} s before the step half-way and at the end"
        )
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise UsageError(f"seed must be a whole number >= 0, got {seed}; the same number gives the same run")
    scenarios = {n: make_scenario("mass-step", seed=seed, increments=n, duration=duration) for n in INCREMENTS}
    tracks = {method: {n: _track(method, scenarios[n]) for n in INCREMENTS} for method in METHODS}
    record = scenarios[RECORD]
    t, truth = record.motion.t, _truth(record)
    rows = tuple(_row(n, method, t, truth, tracks[method][n]) for n in INCREMENTS for method in METHODS)
    edges = _edge_tracks(record, seed, tracks["RIV"][RECORD])
    return DemoResult(seed, t, truth, record.schedule.changes[1][0], scenarios, tracks, edges, rows)


def _edge_tracks(scenario: Scenario, seed: int, fine: Track) -> dict[str, Track]:
    """Return the estimates from an encoder of few lines in the same motion, by counts and by edge times, and `fine`."""
    u, dt, step = scenario.motion.u, scenario.dt, resolution_of(LINES)
    motion = simulate_drive(scenario.schedule, np.repeat(u, FINE), dt / FINE)
    errors = LINE_ERROR * step * np.random.default_rng(seed).uniform(-1, 1, LINES)
    counts, ages = capture_edges(motion, step, every=FINE, tick=TICK, line_errors=errors)
    drive, encoder, memory = Drive(CART.input_gain), Encoder(step), dt / (1 - FORGETTING)
    coarse = RIV(drive, encoder, dt, CUTOFF, order=ORDER, forgetting=FORGETTING)
    edges = REdge(drive, encoder, dt, lines=LINES, tick=TICK, memory=memory)
    return {
        f"{LINES} increments, counts alone": coarse.run(u, counts),
        f"{RECORD} increments, counts alone": fine,
        f"{LINES} increments with edge times": edges.run(u, counts, ages),
    }


def _track(method: str, scenario: Scenario) -> Track:
    make, zeros = METHODS[method]
    estimator = make(
        Drive(CART.input_gain),
        Encoder(scenario.resolution),
        scenario.dt,
        CUTOFF,
        order=ORDER,
        prefilter_zeros=zeros,
        forgetting=FORGETTING,
    )
    return estimator.run(scenario.motion.u, scenario.counts)


def _truth(scenario: Scenario) -> dict[str, Floats]:
    names = ("mass", "viscous_friction", "coulomb_friction")
    return dict(zip(names, scenario.schedule.sample(scenario.motion.t, scenario.dt)[:3], strict=True))


def _row(n: int, method: str, t: Floats, truth: Mapping[str, Floats], track: Track) -> DemoRow:
    mass, dt = track["mass"], float(t[1] - t[0])
    step = int(np.flatnonzero(np.diff(truth["mass"]))[0]) + 1
    old, new = slice(step - round(WINDOW / dt), step), slice(t.size - round(WINDOW / dt), t.size)
    return DemoRow(
        increments=n,
        method=method,
        errors_old=_errors(track, truth, old),
        errors_new=_errors(track, truth, new),
        std_old=float(mass[old].std()),
        std_new=float(mass[new].std()),
        settling_time=settling_time(mass[step:], truth["mass"][-1], dt),
        outside=int(np.sum(~_within(mass[t >= START_UP], *PLAUSIBLE_MASS))),
    )


def _errors(track: Track, truth: Mapping[str, Floats], window: slice) -> dict[str, float]:
    return {name: float(100 * (track[name][window] / true[window] - 1).mean()) for name, true in truth.items()}


def _within(values: Floats, low: float, high: float) -> Flags:
    return (values >= low) & (values <= high)


def settling_time(values: Floats, target: float, dt: float, band: float = BAND) -> float:
    """Return the time [s] from the first of `values` (n,) until they stay within the band about the target; inf
    means never.
    """
    outside = np.flatnonzero(~_within(values / target, 1 - band, 1 + band))
    if outside.size == 0:
        return 0.0
    settled = int(outside[-1]) + 1
    return math.inf if settled == values.size else settled * dt


def seconds(time: float) -> str:
    """Return a time [s] as text; inf means never."""
    return f"{time:.2f}" if math.isfinite(time) else "never"
