"""Study the effect of missing samples on a drive's estimates, and estimates from several records, as a page:
`python -m studies.gaps --out results/gaps.md`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from pmfid._stage import Inputs
from pmfid.encoder import Encoder
from pmfid.errors import NotIdentifiableError
from pmfid.estimators.bridges import gaps_in
from pmfid.estimators.iv import IV, RIV
from pmfid.models.drive import Drive
from pmfid.monitor.monitor import guess, longest
from pmfid.records.filling import doubt, fill_by_motion
from pmfid.records.gaps import fill_gaps, gaps_of, is_held
from pmfid.records.tuning import TUNING
from pmfid.simulation import prbs, quantize, simulate_drive
from pmfid.status import Status
from pmfid.types import Counts, Flags, Floats
from studies.gap_information import bound, sensitivities
from studies.machines import AXES, machine_record, truth
from studies.paper.truth import CartRecord, table
from studies.sections import write_page
from studies.several_records import compared_page

#: Kind of loss -> fraction of missing samples, and length of each gap [samples].
LOSSES: Mapping[str, tuple[float, int]] = MappingProxyType(
    {"1 %": (0.01, 1), "10 %": (0.1, 1), "30 %": (0.3, 1), "10 % in bursts of 50": (0.1, 50)}
)
#: Allowed error, relative to the clean record's error over the root of the remaining fraction of samples.
GOAL = 1.5
#: Allowed interval of every sample of `riv` after a second, relative to the truth.
TRACK = (0.7, 1.5)


@dataclass(frozen=True)
class Bench:
    """An axis of `studies.machines`, its motion, sample period dt [s], samples, and pole of the filters [rad/s]."""

    axis: str
    motion: str
    dt: float
    samples: int
    cutoff: float


BENCHES = (
    Bench("cart", "prbs", 1 / 250, 7500, 20.0),
    Bench("cart", "prbs", 1 / 4000, 40_000, 20.0),
    Bench("stage", "prbs", 1 / 250, 7500, 20.0),
    Bench("gantry", "prbs", 1 / 4000, 40_000, 40.0),
    Bench("rotary", "multisine", AXES["rotary"].dt, AXES["rotary"].samples, 30.0),
    Bench("heavy", "stop-and-go", AXES["heavy"].dt, AXES["heavy"].samples, 25.0),
    Bench("spindle", "stop-and-go", AXES["spindle"].dt, AXES["spindle"].samples, 60.0),
    Bench("gantry", "multisine", AXES["gantry"].dt, AXES["gantry"].samples, 40.0),
)
#: Benches on which the filling was developed; the other benches were held back.
SEEN = tuple(bench for bench in BENCHES if bench.axis in ("cart", "rotary", "heavy"))
#: Number of seeds for the bounds, and the deviation of an unknown input in root mean squares.
BOUNDED, ANY = 2, 10.0


@dataclass(frozen=True)
class Tracked:
    """theta (n, 3) of `riv` over the truth after 1 s, and the flags (n,) of starts and fallbacks."""

    theta: Floats
    flagged: Flags


@dataclass(frozen=True)
class Found:
    """Error and error bar (3,), relative to the truth, and `riv` on the filled record and as in the monitor."""

    error: Floats
    bar: Floats
    filled: Tracked
    online: Tracked


def record_of(bench: Bench, seed: int) -> CartRecord:
    """Simulate one run; a pseudo-random input is held for 0.1 s."""
    axis = AXES[bench.axis]
    if bench.motion != "prbs":
        return machine_record(axis, "nothing", bench.motion, 4096, seed)
    rng = np.random.default_rng([seed, 7])
    u = prbs(bench.samples, clock=round(0.1 / bench.dt), amplitude=axis.volt, rng=rng)
    place = simulate_drive(axis.drive, u, bench.dt).x
    return CartRecord(u, quantize(place, axis.resolution, axis.resolution * rng.random()), axis.resolution)


def left(samples: int, part: float, burst: int, seed: int) -> Flags:
    """Return the remaining samples (n,)."""
    rng, there = np.random.default_rng([seed, 8]), np.ones(samples, bool)
    if burst == 1:
        there = rng.random(samples) >= part
    else:
        for first in rng.integers(50, samples - 2 * burst, round(part * samples / burst)):
            there[first : first + burst] = False
    there[[*range(10), samples - 1]] = True
    return there


def lost(bench: Bench, seed: int, loss: str) -> tuple[IV, CartRecord, Flags]:
    """Return the method, a run, and the remaining samples."""
    run = record_of(bench, seed)
    method = IV(Drive(AXES[bench.axis].drive.input_gain), Encoder(run.resolution), bench.dt, bench.cutoff)
    return method, run, left(run.u.size, *LOSSES[loss], seed) if loss else np.ones(run.u.size, bool)


def estimated(bench: Bench, seed: int, loss: str) -> Found:
    """Estimate by `iv` and `riv` from one run with missing samples; `loss` "" means none."""
    (method, run, there), more, true = lost(bench, seed, loss), np.zeros(3), truth(AXES[bench.axis])
    u, counts = run.u, run.counts
    if loss:
        u, counts, there = fill_gaps(run.u[there], run.counts[there], np.flatnonzero(there))
        u, counts = fill_by_motion(method, u, counts, there) or (u, counts)
        more = doubt(method, u, counts, there)
    fit = method.fit(u, counts)
    tracks = [
        Tracked(theta[second:] / true, (status[second:] & int(Status.FALLBACK | Status.STARTING)) != 0)
        for second in [round(1 / bench.dt)]
        for theta, status in (_filled(method, u, counts), _online(method, run, there))
    ]
    return Found(fit.theta / true - 1, np.hypot(fit.theta_std / true, more), *tracks)


def _filled(method: IV, u: Floats, counts: Counts) -> tuple[Floats, NDArray[np.uint32]]:
    """Return theta (n, 3) and status (n,) of `riv` on a filled record; the motion restarts after an unfilled gap."""
    riv = RIV(method.model, method.encoder, method.dt, method.cutoff)
    edges, tracks = [0, *(edge for gap in gaps_in(u) for edge in gap), u.size], []
    for k in range(0, len(edges) - 1, 2):
        if k:
            riv.gap(int(counts[edges[k]]))
        part = slice(edges[k], edges[k + 1])
        tracks.append(riv.run(u[part], counts[part]))
    return np.concatenate([one.theta for one in tracks]), np.concatenate([one.status for one in tracks])


def _online(method: IV, run: CartRecord, there: Flags) -> tuple[Floats, NDArray[np.uint32]]:
    """Return theta (n, 3) and status (n,) of `riv`, sample by sample, as in the monitor."""
    riv = RIV(method.model, method.encoder, method.dt, method.cutoff)
    last_one, rate = Inputs(), riv.cutoff * riv.dt
    theta, status = np.empty((run.u.size, 3)), np.empty(run.u.size, np.uint32)
    last, places = -1, np.flatnonzero(there).tolist()
    for k, u, counts in zip(places, run.u[there].tolist(), run.counts[there].tolist(), strict=True):
        missing, own = k - last - 1, counts + last_one.zero
        found = guess(last_one, rate, missing, u, own) if 0 < missing <= longest(rate) else None
        if found and found.doubt:
            riv.doubt(found.doubt)
        between = [(at, moved - last_one.zero) for at, moved in found.samples] if found else []
        unknown = [(math.nan, 0)] * (0 if found else min(missing, riv.settle_samples))
        for at, moved in (*between, *unknown, (u, counts)):
            estimate = riv.step(at, last_one.step(at, moved))
        theta[last + 1 : k + 1], status[last + 1 : k + 1] = estimate.theta, estimate.status
        last = k
    return theta, status


def information_left(bench: Bench, seed: int, loss: str) -> Floats:
    """Return the growth (3,) of the Cramer-Rao bounds.

    A held input is known in a filled gap, because its instants can be reported. Another input is known as far as nearby
    samples determine it. In a long gap or an omitted gap, the input is unknown.
    """
    method, run, there = lost(bench, seed, loss)
    line, _, there = fill_gaps(run.u[there], run.counts[there], np.flatnonzero(there))
    held, gap, unknown = is_held(run.u, there), gaps_of(there), np.zeros(there.size)
    short = ~there & np.isfinite(line)
    if not held and np.any(short):
        unknown[short] = np.sqrt(np.mean((line - run.u)[short] ** 2))
    for before, after in zip(gap.before, gap.after, strict=True):
        if np.isnan(line[before + 1]) or (not held and after - before - 1 > TUNING.gaps_always):
            unknown[before + 1 : after] = ANY * np.std(run.u)
    true = truth(AXES[bench.axis])
    effects, whole = sensitivities(method, true, run.u), np.ones(there.size, bool)
    return bound(method, true, effects, there, unknown) / bound(method, true, effects, whole, np.zeros(there.size))


def losses_page(benches: tuple[Bench, ...], seeds: int) -> Iterator[str]:
    rows, worst, over, runs_of = [], 0.0, [], {loss: list[Found]() for loss in ("", *LOSSES)}
    for bench in benches:
        clean = [estimated(bench, seed, "") for seed in range(seeds)]
        # with few seeds the clean record's error may be small by chance, so that it counts at least as its error bar
        base = np.maximum(_rms([found.error for found in clean]), _rms([found.bar for found in clean]))
        runs_of[""] += clean
        rows.append(_row(bench, "", clean, "", ""))
        for loss in LOSSES:
            try:
                runs = [estimated(bench, seed, loss) for seed in range(seeds)]
            except NotIdentifiableError as refused:
                rows.append([_named(bench), loss, str(refused), *[""] * 5])
                continue
            known = np.exp(np.mean([np.log(information_left(bench, k, loss)) for k in range(BOUNDED)], axis=0))
            ratio = _rms([found.error for found in runs]) / (base * known)
            over += [f"{_named(bench)}, {loss}: {_cell(ratio)}"] * bool(np.max(ratio) > GOAL)
            worst = max(worst, float(np.max(ratio)))
            runs_of[loss] += runs
            rows.append(_row(bench, loss, runs, _cell(known), _cell(ratio)))
    yield from table(
        [
            "axis",
            "missing",
            "error [%]",
            "bound over clean",
            "error over both",
            "error over bar",
            "riv, filled",
            "riv, on-line",
        ],
        rows,
    )
    yield f"Check, all errors of `iv` at most {GOAL:g} times those of the clean record times what is lost of the"
    yield f"information: {'met' if worst <= GOAL else '**not met**'}; {worst:.2f}. {'; '.join(over)}"
    yield ""
    yield from table(["missing", "within one bar [%]", "within 1.96 bars [%]", "of"], _covered(runs_of))


def _row(bench: Bench, loss: str, runs: list[Found], known: str, ratio: str) -> list[str]:
    error = _cell(100 * _rms([found.error for found in runs]))
    return [_named(bench), loss or "nothing", error, known, ratio, _cell(_pulls(runs)), *_tracks(runs)]


def _covered(runs_of: Mapping[str, list[Found]]) -> list[list[str]]:
    rows = []
    for loss, runs in runs_of.items():
        pulls = np.abs([found.error / found.bar for found in runs])
        shares = (f"{100 * np.mean(pulls < bars):.0f}" for bars in (1.0, 1.96))
        rows.append([loss or "nothing", *shares, str(pulls.size)])
    return rows


def _rms(values: list[Floats]) -> Floats:
    return np.asarray(np.sqrt(np.mean(np.square(values), axis=0)))


def _pulls(runs: list[Found]) -> Floats:
    return _rms([found.error / found.bar for found in runs])


def _tracks(runs: list[Found]) -> list[str]:
    """Return the least and the largest estimate, and the numbers of samples outside: all, and those without a flag."""
    cells = []
    for tracks in ([found.filled for found in runs], [found.online for found in runs]):
        theta = np.concatenate([one.theta for one in tracks])
        own = ~np.concatenate([one.flagged for one in tracks])
        outside = np.any((theta < TRACK[0]) | (theta > TRACK[1]), axis=1)
        said = f"{theta.min():.2f} to {theta.max():.2f}"
        mine = 100 * np.mean(outside[own]) if np.any(own) else 0.0
        shares = f"{100 * np.mean(outside):.2g} %, of its own {mine:.2g} %"
        cells.append(f"**{said}** ({shares})" if np.any(outside) else said)
    return cells


def _cell(values: Floats) -> str:
    return ", ".join(f"{value:.2g}" for value in values)


def _named(bench: Bench) -> str:
    held = "" if bench in SEEN else " (held back)"
    return f"{bench.axis}, {bench.motion}, {1 / bench.dt:.0f} Hz{held}"


def page(seeds: int = 4) -> str:
    """The whole page."""
    lines = [
        "# Missing samples and several records",
        "",
        f"Made by `python -m studies.gaps --out results/gaps.md --seeds {seeds}`.\n",
        f"{seeds} runs of each axis, encoders of 4096 increments, `iv`. Errors are root mean squares of mass, "
        'viscous and Coulomb friction, in percent of the truth. "Bound over clean" is by how much less the counts and '
        "inputs that are left can tell (Cramer-Rao, `studies/gap_information.py`): a lost input that a controller made "
        'of a coarse encoder is known to nobody, and costs far more than its count. "Error over both" is the error '
        "over that of the same runs with no sample missing, or their error bar where that is more, times that bound. "
        "`riv`: least and largest of all parameters over the truth, of all runs from 1 s, on the record as it is "
        "filled off-line, and sample by sample as the monitor runs it; where some are outside "
        f"{TRACK[0]:g} to {TRACK[1]:g}, how many, and of the samples in which it neither starts nor falls back.",
        "",
        *losses_page(BENCHES, seeds),
        "## Three records of a minute against one of three",
        "",
        *compared_page(seeds),
    ]
    return "\n".join(lines).rstrip() + "\n"


if __name__ == "__main__":
    write_page(page, __doc__)
