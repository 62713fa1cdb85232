"""Random axes with a second mass, on a spring or across a gap, judged by the truth."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from multiprocessing import get_context
from typing import NamedTuple

import numpy as np

import pmfid
from pmfid.fit.compare import NORMAL_95
from pmfid.fit.likelihood import Gaussian
from pmfid.fit.shooting import settle_starts
from pmfid.fit.solve import inverse, normal_of
from pmfid.types import Floats
from studies.referee.cases import Case, make_cases
from studies.referee.judge import fit_plain
from studies.sections import write_page
from tests.oracles.two_mass import TwoMasses

KINDS = ("spring", "rigid", "gear", "tight", "disc")
EXPLANATION = """\
An independent integrator simulates machines with a resonance of 5 to 120 Hz, and gears whose contact swings by 0.3 to
1.5 rad a sample. `spring` and `gear` fit two masses. `rigid` fits one mass to springs. `tight` asks for play where
there is none. `disc` is one mass of the referee with an encoder that is eccentric by 0.05 to 1 % of a turn. Records
that cover less than a fifth of a turn are left out, because they show the disc as a scale.

Right is a fit of a spring with both masses and the stiffness within 0.5 % and the damping within 5 %, each where its
standard deviation by Cramér and Rao is below a tenth of that; a rigid fit within 0.5 % or with the second mass named; a
gap within a count or 10 %, or below a count where there is none; a disc whose sine and cosine are within three
standard errors.

Silent is an empty status with an error beyond three standard errors and 0.5 %, or with a rigid fit or a gap that is not
right. The intervals of a disc are those of its mass."""
#: Largest right error of masses and stiffness, of the damping, and of the gap [counts] and relative; the part of an
#: error that the standard deviation by Cramér and Rao allows; and the largest right error in standard errors.
RIGHT, RIGHT_DAMPING, GAP, ALLOWED, BARS = 0.005, 0.05, (1.0, 0.1), 0.1, 3.0
#: Places of both masses, stiffness and damping in a fit, and their largest right errors.
JUDGED, LARGEST = [0, 3, 6, 7], np.array([RIGHT, RIGHT, RIGHT, RIGHT_DAMPING])
#: Words for an eccentric disc, and the part of a turn below which a record shows it as a scale.
ONCE, SHORT = "an error of the encoder once a turn", 0.2


class Record(NamedTuple):
    """A record with its truth (p,), in the order of the fit of two masses, and facts for the reader."""

    u: Floats
    counts: Floats
    step: float
    resolution: float
    truth: Floats
    facts: str


class Verdict(NamedTuple):
    """What a fit gives: right values, parameters held and given, silence, CPU time [s] and a line of text."""

    right: bool
    held: int
    given: int
    silent: bool
    seconds: float
    text: str


def draw(rng: np.random.Generator, low: float, high: float) -> float:
    """Return a random number that is even on a logarithmic scale."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def simulate(
    pair: TwoMasses, step: float, count: int, force_at: Callable[[int, float], float]
) -> tuple[Floats, Floats]:
    """Return the input and the positions (count,) of the motor. `force_at` is the input by the number of a sample
    and by the position."""
    rate = np.sqrt(pair.stiffness * (1 / pair.mass + 1 / pair.load))
    state, substeps = np.zeros(4), max(4, int(np.ceil(rate * step / 0.06)))
    u, y = np.zeros(count), np.zeros(count)
    for k in range(count):
        y[k] = state[0]
        u[k] = force_at(k, state[0])
        for _ in range(substeps):
            state = pair.advance(state, u[k], step / substeps)
    return u, y


@dataclass
class Control:
    """Position control from counts, with a filtered speed: gains, limit, resolution and the zero within a count."""

    reference: Floats
    step: float
    kp: float
    kd: float
    limit: float
    resolution: float
    zero: float
    last: float = 0.0
    speed: float = 0.0

    def __call__(self, k: int, y: float) -> float:
        seen = float(np.floor(y / self.resolution + self.zero) * self.resolution)
        self.speed, self.last = self.speed + 0.4 * ((seen - self.last) / self.step - self.speed), seen
        return float(np.clip(self.kp * (self.reference[k] - seen) - self.kd * self.speed, -self.limit, self.limit))


def make_spring(seed: int, index: int) -> Record:
    """Return a machine of 5 to 120 Hz with an input of random torque, a chirp, or position control."""
    rng = np.random.default_rng([seed, index])
    inertia, ratio, hertz, damping = draw(rng, 1e-5, 10), draw(rng, 0.1, 10), draw(rng, 5, 120), draw(rng, 0.005, 0.2)
    step = draw(rng, 5e-4, min(5e-3, 0.42 / hertz))
    resolution, rate = 2 * np.pi / int(draw(rng, 512, 65536)), 2 * np.pi * hertz
    motor, friction = inertia / (1 + ratio), rng.uniform(0.02, 0.3, 2)
    load = inertia - motor
    friction *= min(1.0, 0.5 / np.sum(friction))
    acceleration, drag, share = draw(rng, 100, 3000), inertia / draw(rng, 0.1, 1), rng.uniform(0.2, 0.8)
    torque, reduced = inertia * acceleration, motor * load / inertia
    masses = (motor, drag * share, friction[0] * torque), (load, drag * (1 - share), friction[1] * torque)
    pair = TwoMasses(*masses[0], *masses[1], reduced * rate**2, 2 * damping * rate * reduced)
    count = int(min(10000, max(2000, rng.uniform(4, 10) / step)))
    kind, zero = ("random", "chirp", "position")[index % 3], rng.uniform()
    if kind == "random":
        hold = max(1, int(rng.uniform(0.3, 2) / hertz / step))
        u = rng.uniform(-1, 1, count // hold + 1).repeat(hold)[:count] * torque
    elif kind == "chirp":
        t, low, high = np.arange(count) * step, 0.3, min(1.5 * hertz, 0.25 / step)
        growth = (high / low) ** (t / t[-1])
        u = torque * np.sin(2 * np.pi * low * t[-1] / np.log(high / low) * (growth - 1))
    else:
        band = min(0.12 * rate / np.sqrt(1 + ratio), 0.1 / step, 60.0)
        move, rest = max(int(4 / band / step), 4), max(int(rng.uniform(0.5, 2) / band / step), 1)
        stroke = min(acceleration * (move * step) ** 2 / 6, 30.0)
        goals = np.r_[0, rng.uniform(-1, 1, count // (move + rest) + 2) * stroke]
        profile = np.r_[0.5 - 0.5 * np.cos(np.pi * np.arange(1, move + 1) / move), np.ones(rest)]
        reference = np.concatenate([a + (b - a) * profile for a, b in pairwise(goals.tolist())])[:count]
        gains = inertia * band**2, 1.2 * inertia * band
        u, y = simulate(pair, step, count, Control(reference, step, *gains, torque, resolution, zero))
    if kind != "position":
        u, y = simulate(pair, step, count, lambda k, _: float(u[k]))
    facts = f"{kind} {count} x {1e3 * step:.2g} ms, {hertz:.0f} Hz, ratio {ratio:.2g}"
    return make_record(pair, u, np.floor(y / resolution + zero), step, resolution, facts)


def make_gear(seed: int, index: int, gap: bool = True) -> Record:
    """Return a gear whose contact swings by 0.3 to 1.5 rad a sample, with random torque."""
    rng = np.random.default_rng([seed, index])
    inertia, ratio, turn, damping = draw(rng, 1e-4, 10), draw(rng, 0.2, 4), draw(rng, 0.3, 1.5), draw(rng, 0.03, 0.3)
    step, resolution, width = draw(rng, 5e-4, 4e-3), 2 * np.pi / int(draw(rng, 1000, 65536)), draw(rng, 2, 50)
    motor, friction, hold = inertia / (1 + ratio), rng.uniform(0.02, 0.25, 2), int(rng.integers(5, 25))
    load, count = inertia - motor, int(rng.uniform(2000, 5000))
    torque = inertia * draw(rng, 3, 30) * width * resolution / (hold * step) ** 2
    drag, share, reduced = inertia / draw(rng, 0.05, 0.5), rng.uniform(0.2, 0.8), motor * load / inertia
    masses = (motor, drag * share, friction[0] * torque), (load, drag * (1 - share), friction[1] * torque)
    spring = reduced * (turn / step) ** 2, 2 * damping * turn / step * reduced
    pair = TwoMasses(*masses[0], *masses[1], *spring, gap * width * resolution)
    u = rng.uniform(-1, 1, count // hold + 1).repeat(hold)[:count] * torque
    _, y = simulate(pair, step, count, lambda k, _: float(u[k]))
    facts = f"{count} x {1e3 * step:.2g} ms, {turn:.2g} rad a sample, gap of {gap * width:.2g} counts"
    return make_record(pair, u, np.floor(y / resolution + rng.uniform()), step, resolution, facts)


def make_record(pair: TwoMasses, u: Floats, counts: Floats, step: float, resolution: float, facts: str) -> Record:
    """Return the record with its truth."""
    truth = [pair.mass, pair.viscous, pair.coulomb, pair.load, pair.load_viscous, pair.load_coulomb]
    truth += [pair.stiffness, pair.damping, *([pair.gap] if pair.gap else [])]
    return Record(u, counts, step, resolution, np.array(truth), facts)


def bound_errors(record: Record, drive: pmfid.Drive) -> Floats:
    """Return the relative standard deviations (p,) by Cramér and Rao, with rounding as white noise."""
    method = pmfid.MotionFit(drive, pmfid.Encoder(record.resolution), record.step, 20.0)
    problem = method.problem(record.u, record.counts.astype(np.int64))
    q, noise = problem.start(record.truth), Gaussian(problem.stretches)
    starts = settle_starts(problem, noise, q, problem.first_starts())
    size = record.truth.copy()
    size[problem.machine.logs] = 1.0
    return np.asarray(np.sqrt(np.diag(inverse(normal_of(noise(problem.linearise(q, starts))[1], starts).A))) / size)


def count_turns(case: Case) -> float:
    """Return the part of a turn that a record covers."""
    return float(np.nanmax(case.counts) - np.nanmin(case.counts)) / case.facts["increments"]


def judge_disc(seed: int, index: int) -> Verdict:
    """Fit one axis whose encoder has an eccentric disc."""
    cases = (make_cases(seed + 1000 * number, "eccentric encoder", [index])[0] for number in range(100))
    case = next(case for case in cases if count_turns(case) > SHORT)
    increments, phase = case.facts["increments"], case.facts["phase"]
    amplitude = case.facts["eccentricity"] / increments
    facts = (
        f"{case.motion}, {increments:g} increments, {count_turns(case):.2g} turns, {100 * amplitude:.2g} % of a turn"
    )
    start = time.process_time()
    try:
        result = fit_plain(case)
    except pmfid.PmfidError as refusal:
        return Verdict(False, 0, 0, False, time.process_time() - start, f"{facts}; refused: {refusal}"[:150])
    seconds, (low, high) = time.process_time() - start, result.interval_95[0]
    truth, mass = amplitude * np.array([np.cos(phase), np.sin(phase)]), case.truth["mass"]
    named = [one for one in result.forces if one.chosen and one.candidates[0].words == ONCE]
    held, off = int(low <= mass <= high), result.theta[0] - mass
    silent = not result.status and bool(abs(off) > max(BARS * (high - low) / 2 / NORMAL_95, RIGHT * mass))
    text = f"{facts}; {' '.join(result.status)}; mass {100 * off / mass:.2g} %"
    if not named:
        return Verdict(False, held, 1, silent, seconds, f"{text}; no disc")
    sizes, stds = (values / (case.resolution * increments) for values in (named[0].sizes, named[0].stds))
    bars = (sizes - truth) / stds
    text = f"{text}; disc {100 * np.linalg.norm(sizes - truth) / amplitude:.2g} %, {bars[0]:.1f} {bars[1]:.1f} bars"
    return Verdict(bool(np.all(np.abs(bars) < BARS)), held, 1, silent, seconds, text)


def judge(kind: str, seed: int, index: int) -> Verdict:
    """Fit one machine. An error of a fit is a refusal, and not right."""
    if kind == "disc":
        return judge_disc(seed, index)
    record = make_spring(seed, index) if kind in ("spring", "rigid") else make_gear(seed, index, kind == "gear")
    body = {} if kind == "rigid" else {"body": "two-mass", "play": kind in ("gear", "tight")}
    drive, encoder = pmfid.Drive(1.0, axis="rotary", **body), pmfid.Encoder(record.resolution)  # type: ignore[arg-type]
    start = time.process_time()
    try:
        fit = pmfid.identify(record.u, record.counts, model=drive, dt=record.step, encoder=encoder)
    except pmfid.PmfidError as refusal:
        named = kind == "rigid" and "two masses" in str(refusal)
        return Verdict(named, 0, 0, False, time.process_time() - start, f"{record.facts}; refused: {refusal}"[:150])
    seconds, truth = time.process_time() - start, record.truth
    status, words = " ".join(fit.status), f"{record.facts}; {' '.join(fit.status)}"
    if kind == "rigid":
        off = fit.theta[0] / (truth[0] + truth[3]) - 1
        right = abs(off) < RIGHT or "two_mass" in {one.code for one in fit.findings}
        return Verdict(right, 0, 0, not right and not status, seconds, f"{words}; inertia {100 * off:.2g} %")
    assert fit.interval_95 is not None
    theta, half = fit.theta, np.diff(fit.interval_95)[:, 0] / 2
    if kind == "tight":
        right = bool(theta[8] < record.resolution)
        gap = theta[8] / record.resolution
        return Verdict(right, 0, 0, not right and not status, seconds, f"{words}; gap {gap:.2g}")
    error, size = np.abs(theta - truth), np.abs(truth)
    if kind == "gear":
        right = bool(error[8] < max(GAP[0] * record.resolution, GAP[1] * truth[8]))
    else:
        judged = bound_errors(record, drive)[JUDGED] < ALLOWED * LARGEST
        right = bool(np.all((error / size)[JUDGED][judged] < LARGEST[judged]))
        words += f"; {np.count_nonzero(judged)} of 4 judged"
    silent = not status and bool(np.any((error > BARS * half / NORMAL_95) & (error > RIGHT * size)))
    percent = " ".join(f"{value:.2g}" for value in 100 * (error / size)[[0, 3, 6, -1]])
    held = int(np.count_nonzero(error <= half))
    return Verdict(right, held, truth.size, silent, seconds, f"{words}; errors {percent} %")


def page(machines: int = 60, seed: int = 1, jobs: int = 2, kinds: str = " ".join(KINDS)) -> str:
    """Return the whole page, and print a line for each machine."""
    warnings.simplefilter("ignore")
    lines = ["| kind | right | silent | intervals hold | CPU: median [s] | mean [s] | most [s] |", "|---" * 7 + "|"]
    for kind in kinds.split():
        verdicts = list[Verdict]()
        with get_context("spawn").Pool(jobs) as pool:
            for verdict in pool.imap(partial(judge, kind, seed), range(machines)):
                verdicts.append(verdict)
                words = "" if verdict.right else " WRONG" + " SILENT" * verdict.silent
                print(f"{kind} {len(verdicts) - 1}: {verdict.text}; {verdict.seconds:.1f} s{words}", flush=True)
        right, held, given, silent, seconds, _ = zip(*verdicts, strict=True)
        times = f"{np.median(seconds):.1f} | {np.mean(seconds):.1f} | {max(seconds):.1f}"
        cells = f"{sum(right)} of {machines} | {sum(silent)} | {sum(held)} of {sum(given)} | {times}"
        lines.append(f"| {kind} | {cells} |")
    return "\n".join(["# Elastic axes", "", EXPLANATION, "", *lines, ""])


if __name__ == "__main__":
    write_page(page, __doc__)
