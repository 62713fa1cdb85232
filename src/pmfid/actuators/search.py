"""The search for the model of a servo: starts, terms and noise, on the fit of machines (`pmfid.fit`)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from pmfid._body import BASE, LOOP
from pmfid.actuators.body import ServoBody, body_of, excite, excite_ticks
from pmfid.actuators.bounded import BoundedQuadratic
from pmfid.actuators.checks import find_stops
from pmfid.actuators.logs import JointLog
from pmfid.actuators.servo import Servo
from pmfid.actuators.stamps import noise_with_stamps
from pmfid.actuators.terms import COMMON, LOOP_FRICTION, PAIRS, table_of
from pmfid.actuators.tuning import TUNING
from pmfid.fit.compare import ODDS, Quadratic
from pmfid.fit.likelihood import Gaussian
from pmfid.fit.machine import COULOMB, DELAY, MASS, VISCOUS, BodyForce, simulate
from pmfid.fit.problem import FAR, FitProblem, ObservedStretch, ResidualBlock
from pmfid.fit.search import SETTLED, FitSearch, errors_of
from pmfid.fit.solve import Likelihood
from pmfid.fit.terms import Sizes
from pmfid.types import Flags, Floats


@dataclass(frozen=True, eq=False)
class ServoTask:
    """Logs of one servo, and what is known of it. Each name in `per_log` is a parameter of each log. Goals may have the
    stamps of `early` rows later. A torque that is `limited` has an unknown limit in addition to what is known."""

    servo: Servo
    logs: Sequence[JointLog]
    per_log: tuple[str, ...]
    early: int
    limited: bool = False

    @property
    def lag(self) -> float:
        """Typical distance of the position from the goal [rad]."""
        apart = [log.goal - log.position for log in self.logs]
        return max(float(np.std(np.concatenate(apart))), self.servo.resolution)

    @property
    def period(self) -> float:
        return float(np.median(np.concatenate([np.diff(log.t) for log in self.logs])))

    @property
    def every(self) -> int:
        """Number of rows from which the starts take one, because two ticks are enough for them."""
        return max(int(2 * TUNING.tick / self.period), 1)

    @property
    def lead(self) -> float:
        """Longest time by which goals act before their stamps [s]. A row of a log that polls has its goal at its start
        and its stamp at its end. Known torques go with the readings."""
        known = "delay" not in self.servo.unknown or any(log.force is not None for log in self.logs)
        return 0.0 if known else self.early * self.every * self.period

    @property
    def load(self) -> float:
        """Inertia of the pendulum that the logs state [kg m2], or 0."""
        return min(float(log.stated.get("pendulum", 0.0)) for log in self.logs)

    @property
    def model(self) -> Servo:
        """What is known, with an unknown limit of the torque, with the delay of the loop, and with the friction by the
        back-EMF if the torque of a log is off in between."""
        switched = any(log.on is not None for log in self.logs)
        more = ["loop_delay", *(["back_emf"] if switched else []), *(["torque_limit"] if self.limited else [])]
        return replace(self.servo, terms=[*self.servo.terms, *(name for name in more if not self.servo.has(name))])

    @property
    def priors(self) -> dict[str, tuple[float, float]]:
        """Mean and standard deviation of what the logs hardly show."""
        half = 0.5 * self.servo.loop_period
        return {"loop_delay": (half, half), "velocity_filter": (half, TUNING.lag)}

    def body(self) -> ServoBody:
        """Return the body, in which the delay of the loop is uncertain unless it is given."""
        body = body_of(self.model, dict.fromkeys(self.per_log, len(self.logs)), self.priors, self.load)
        return replace(body, precision=np.array([float(name in self.priors) for name in body.names]))

    def problem(self, tick: float = TUNING.tick) -> ServoProblem:
        """Return the logs as a problem, with a start state after each gap."""
        body = self.body()
        quick = self.period < TUNING.tick  # more parts take time there, and a goal waits for the next tick of the loop
        wait = self.lead, 0.5 * self.servo.loop_period if quick else 1e-6 * self.period
        stretches = tuple(one for k, log in enumerate(self.logs) for one in _stretches(log, body.names, k, tick, wait))
        least = TUNING.least_armature * self.load if "inertia" in body.names else 0.0
        lightest = math.log(least) if least else -np.inf
        return ServoProblem(body, stretches, self.servo.resolution, mass=(lightest, np.inf))


#: Additions to a motion, and the motion with them.
Remembered = tuple[list[Floats | float], list[tuple[ResidualBlock, Floats]]]


@dataclass(frozen=True, eq=False)
class ServoProblem(FitProblem):
    """A problem that remembers its last motions, because each fit begins where the one before it ended."""

    last: dict[bytes, Remembered] = field(init=False, default_factory=dict)

    def linearise_motion(self, q: Floats, starts: Floats) -> list[tuple[ResidualBlock, Floats]]:
        point, apart = q.tobytes() + starts.tobytes(), [one.apart for one in self.stretches]
        if point not in self.last:
            self.last[point] = apart, super().linearise_motion(q, starts)
        before, found = self.last[point] = self.last.pop(point)  # the latest
        for old in list(self.last)[: -TUNING.remembered]:
            del self.last[old]
        errors = [(now - then) / self.resolution for now, then in zip(apart, before, strict=True)]
        pairs = zip(found, errors, strict=True)
        return [(ResidualBlock(block.e + more, block.J.copy(), block.K.copy()), v) for (block, v), more in pairs]


def _stretches(
    log: JointLog, names: Sequence[str], number: int, tick: float, wait: tuple[float, float]
) -> list[ObservedStretch]:
    suffixes = [name.partition(".")[2] for name in names]
    acts = np.array([suffix in ("", str(number + 1)) for suffix in suffixes], float) if any(suffixes) else None
    gaps = np.diff(log.t) > max(TUNING.gap, 5 * float(np.median(np.diff(log.t))))
    stopped, found = find_stops(log), []
    breaks = np.flatnonzero(gaps | np.diff(stopped)) + 1
    for first, last in zip([0, *breaks], [*breaks, log.t.size], strict=True):
        if last - first < 10 or stopped[first]:
            continue
        part, flags = log.cut(slice(first, last)), np.ones(last - first, bool)
        drive = excite(part.t, part.goal, tick, part.force, part.on, *wait)
        found.append(
            ObservedStretch(drive, part.position, np.full(last - first, 1 / 12), flags, ~flags, first, None, acts)
        )
    return found


def head_of(problem: FitProblem) -> FitProblem:
    """Return the first part of the motion of the liveliest stretches, in the order of the logs."""
    lively, heads = np.argsort([-float(np.sum(np.abs(np.diff(one.y)))) for one in problem.stretches]), []
    times = [min(float(one.times[-1]), TUNING.head) for one in problem.stretches]
    before = np.cumsum([0.0, *(times[k] for k in lively[:-1])])
    for k in sorted(lively[before < (TUNING.most_heads - 0.5) * TUNING.head].tolist()):
        one = problem.stretches[k]
        moving = np.flatnonzero(np.abs(one.y - one.y[0]) > 3 * problem.resolution)
        first = max(0.0, float(one.times[moving[0]]) - 0.5) if moving.size else 0.0
        whole = one.times[-1] <= TUNING.head
        heads.append(one if whole else one.cut(first, first + TUNING.head))
    return replace(problem, stretches=tuple(heads))


class ServoSearch(FitSearch):
    """The search of a servo, from parameters q (p,) of the problem on."""

    wandering: ClassVar[Sequence[str]] = ("position",)
    waves: Sequence[str] = ()
    ticked = False

    def __init__(self, task: ServoTask, problem: FitProblem, q: Floats, starts: Floats, search: bool) -> None:
        self.task = task
        self.sizes = _sizes_of(task, problem, q, starts)
        gain, lead = self.sizes.force / task.lag, problem.machine.lead
        load = problem.mass[0] - math.log(TUNING.least_armature)
        largest = max(math.exp(max(load, q[lead]) + TUNING.far), gain / TUNING.frequencies[0] ** 2)
        self.plain = replace(problem, mass=(max(problem.mass[0], q[lead] - TUNING.far), math.log(largest)))
        self.columns = problem.stretches[0].drive.columns.shape[0]
        self.table = table_of(task.model, gain, self.sizes) if search else []
        if task.servo.known_force:
            self.table = [one for one in self.table if one.name != "gravity"]
        self.lag = 0.5 * task.servo.loop_period  # of the velocity in the loop [s]
        self.lags: Sequence[float] = TUNING.lags  # that the logs do not exclude [s]
        self.tried: Mapping[float, ServoSearch] = {}  # the last fits at lags [s]
        self.kept = tuple(i for i, one in enumerate(self.table) if one.name == LOOP_FRICTION)
        self.take(problem, q, starts, [])
        self.choose(self.kept)

    def take(self, problem: FitProblem, q: Floats, starts: Floats, chosen: Sequence[int]) -> None:
        """Go to parameters and start states of a problem."""
        self.plain = replace(problem, mass=self.plain.mass, candidates=())
        self.chosen = list(chosen)
        self.problem = self._chosen_problem()
        self.q, self.starts, self.noise = q, starts, Gaussian(problem.stretches)
        self.stamps = 0.0  # standard deviation of their error [s]

    def set_lag(self, lag: float, half: bool = False) -> None:
        """Give the velocity in the loop a lag [s], and let the motion stay nearly the same: slow motion shows the
        inertia without the friction of the loop times its lag. `half` of the viscous friction may move to the loop."""
        i, before, self.lag = self.kept[0], self.lag, lag
        row, place = self.table[i], self.problem.places[self.chosen.index(i)]
        self.table = [*self.table[:i], replace(row, force=BodyForce("loop_filtered", lag)), *self.table[i + 1 :]]
        self.problem = self._chosen_problem()
        names, self.q, gain = self.plain.machine.names, self.q.copy(), self.q[place] * row.sd
        if half and "viscous" in names:
            self.q[names.index("viscous")] = share = 0.5 * (self.q[names.index("viscous")] + gain)
            self.q[place] = share / row.sd
        if "inertia" in names:
            inertia = names.index("inertia")
            change = (self.q[place] * row.sd * lag - gain * before) / math.exp(max(self.q[inertia], -300.0))
            self.q[inertia] += math.log1p(float(np.clip(change, -0.5, 1.0)))

    @property
    def body(self) -> Floats:
        """Parameters (w,) of the body of the first log."""
        return self.problem._body(self.q, self.plain.stretches[0].acts)[0]

    @property
    def frequency(self) -> float:
        """Natural frequency of the servo [rad/s], at least 1."""
        return math.sqrt(max(float(self.body[-self.plain.machine.loops] / self.body[MASS]), 1.0))

    def reaches_bound(self, q: Floats) -> bool:
        """Return whether the inertia is at its upper bound, where no motion follows."""
        return bool(self.plain.mass[1] - q[self.plain.machine.lead] < SETTLED)

    @property
    def is_early(self) -> bool:
        """Whether goals act as long before their stamps as the task permits."""
        return bool(self.body[DELAY] < SETTLED * self.task.lead)

    def is_lost(self, q: Floats) -> bool:
        """Return whether the inertia is at its lower bound, where the log shows none of it."""
        return bool(q[self.plain.machine.lead] - self.plain.mass[0] < SETTLED)

    @property
    def explains(self) -> bool:
        """The loop of a servo counts, so that no smooth motion explains every count."""
        return False

    def estimate_noise(self, kinds: Sequence[str]) -> Gaussian:
        """Return the noise of the residuals, with the error of the stamps."""
        if self.ticked:
            self.apply_ticks()
        motion, step = self.problem.linearise_motion(self.q, self.starts), self.problem.resolution
        pairs = zip(self.plain.stretches, motion, strict=True)
        stretches = tuple(one.resting((v == 0) | find_rests(one, 1 / self.frequency)) for one, (_, v) in pairs)
        errors, speeds = [block.e for block, _ in motion], [np.clip(v / step, -FAR, FAR) for _, v in motion]
        noise, self.stamps = noise_with_stamps(stretches, errors, speeds, self.rate, kinds, self.task.period)
        return noise

    def check_followed(self, noise: Gaussian) -> None:
        """A position under control may follow the goal with any disturbance."""

    def _odds(self) -> Floats:
        return super()._odds() - ODDS * np.array([one.name in COMMON for one in self.table])

    def local(self, likelihood: Likelihood) -> Quadratic:
        local = super().local(likelihood)
        pairs = tuple(tuple(i for i, one in enumerate(self.table) if one.name in names) for names in PAIRS)
        return BoundedQuadratic(local.A, local.g, local.plain, local.odds, local.lowest, pairs, self.kept)

    def apply_ticks(self) -> None:
        """Add to the motion what the ticks and counts of the loop change, at the present parameters.

        A derivative gain turns the step of a count into a pulse of torque, which rubs in proportion to the load.
        """
        problem, period, stretches = self.problem, self.task.servo.loop_period, list[ObservedStretch]()
        for one, state, scale in zip(problem.stretches, self.starts, problem.scales(), strict=True):
            body, forces, _ = problem._body(self.q, one.acts)
            at = problem._start_body(one, state, scale, body)
            at[2 - LOOP] = 0.5 * period  # of a loop in ticks
            smooth = simulate(one.drive, forces, at, problem.parts)[0]
            drive, at[DELAY] = excite_ticks(one, float(at[DELAY]), period), 0.0
            apart = simulate(drive, forces, at, problem.parts, count=problem.resolution)[0] - smooth
            stretches.append(replace(one, apart=np.nan_to_num(apart, posinf=0.0, neginf=0.0)))
        self.plain = replace(self.plain, stretches=tuple(stretches))
        self.problem = replace(problem, stretches=tuple(stretches))
        if isinstance(problem, ServoProblem) and isinstance(self.problem, ServoProblem):
            self.problem.last.update(problem.last)

    def value(self) -> float:
        """Return the log evidence of the present model in its own noise, with the cost of its parameters."""
        cost = 0.5 * self.q.size * math.log(self.plain.rows) - self.task.limited * ODDS
        return self.estimate_noise(self.wandering).evidence(errors_of(self))[0] - cost


def find_rests(one: ObservedStretch, longest: float) -> Flags:
    """Return the rows (k,) at which a count stays for longer than a time [s]. They share one error of rounding, and the
    likelihood must not prefer simulated motions that creep there."""
    first = np.flatnonzero(np.diff(one.y, prepend=np.nan))
    times = np.diff(one.times[first], append=one.times[-1])
    return np.repeat(times > longest, np.diff(first, append=one.y.size))


def _sizes_of(task: ServoTask, problem: FitProblem, q: Floats, starts: Floats) -> Sizes:
    body, _, _ = problem._body(q, problem.stretches[0].acts)
    speeds = np.abs(np.concatenate([v for _, v in problem.motion(q, starts)]))
    speed = float(np.quantile(speeds[np.isfinite(speeds)], 0.98)) or problem.resolution / task.period
    force = float(body[-problem.machine.loops]) * task.lag
    y = np.concatenate([one.y for one in problem.stretches])
    coulomb, viscous = max(float(body[COULOMB]), 0.05 * force), max(float(body[VISCOUS]), 0.05 * force / speed)
    travel, time = float(np.ptp(y)) / 2, sum(float(one.times[-1]) for one in problem.stretches)
    return Sizes(force, force, speed, coulomb, viscous, travel, task.period, time, True, 2 * math.pi, 0.0)


def limited_part(problem: FitProblem, q: Floats, starts: Floats) -> float:
    """Return the part of the time at which the controller's torque is at its limit, which may fall with the speed."""
    parts = []
    for stretch, (y, v) in zip(problem.stretches, problem.motion(q, starts), strict=True):
        body, forces, _ = problem._body(q, stretch.acts)
        gain, limit = body[-problem.machine.loops], body[1 - problem.machine.loops]
        late = np.searchsorted(stretch.times, stretch.times - body[DELAY], side="right") - 1
        goal = stretch.drive.u[np.minimum(stretch.drive.row[np.maximum(late, 0)], stretch.drive.u.size - 1)]
        torque = gain * (goal - y)
        for force, size in zip(forces, body[BASE:], strict=False):
            torque = torque - size * v * (force.kind == "loop_filtered")
            limit = limit - size * (force.kind == "slope") * np.maximum(force.q * v * np.sign(goal - y), 0.0)
        parts.append(np.abs(torque) >= limit)
    return float(np.mean(np.concatenate(parts)))
