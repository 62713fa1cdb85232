"""A record as a list of observations, and its linearisation around parameters and start states."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pmfid.fit.machine import AT_POSITION, LAGGING, MASS, RUBS, BodyForce, BodyModel, Excitation, simulate
from pmfid.fit.terms import ExtraForce
from pmfid.fit.tuning import PLAY_TUNING
from pmfid.types import Flags, Floats

#: Parts of an interval in which forces are held at the value of their middle. The error of a motion falls with the
#: square of the number: 0.002 counts for a force of the size of friction and one count a sample.
PARTS = 2
#: Bounds of the constant of a free force in units of its first value. Beyond them another candidate of the table is
#: nearer, or the force is one of the others: a Stribeck speed near the highest speed makes a line of friction.
CONSTANT = (0.3, 1.7)
#: Largest residual [counts], which keeps sums of squares finite after an overflow.
FAR = 1e8


@dataclass(frozen=True, eq=False)
class ObservedStretch:
    """A part of a record without a gap, which has a start state of its own.

    `drive` is the input. `y` (k,) are the observed positions [unit] at `drive.row`, each in the middle of its count.
    `variance` (k,) are the variances of their errors [counts^2], and `counted` (k,) is True for a count, whose error
    is that of rounding, and False for the instant of an edge. `rest` (k,) is True while the simulated axis rests.
    `first` is the index of the first sample in the record. `line` (k,) is the number of the encoder's line of each
    edge, or -1; a stretch without it has counts only. `acts` (p,) is 0 for parameters of the machine that belong to
    another log, and 1 for all others. The start position is relative to `origin` [unit], or to the first observation.
    `speed` is the start velocity [unit/s] if it is known. `apart` (k,) is added to each motion [unit].
    """

    drive: Excitation
    y: Floats
    variance: Floats
    counted: Flags
    rest: Flags
    first: int = 0
    line: NDArray[np.intp] | None = None
    acts: Floats | None = None
    origin: float | None = None
    speed: float | None = None
    apart: Floats | float = 0.0

    @property
    def base(self) -> float:
        """The position [unit] to which that of the start is relative."""
        return float(self.y[0]) if self.origin is None else self.origin

    @cached_property
    def times(self) -> Floats:
        """Times (k,) of the observations from the start of the stretch [s]."""
        return np.append(0.0, np.cumsum(self.drive.step))[self.drive.row]

    @cached_property
    def steps(self) -> Floats:
        """Times (k,) from each observation to the next [s]; the last one is the mean."""
        change = np.diff(self.times)
        return np.append(change, np.mean(change) if change.size else 1.0)

    @cached_property
    def signed_steps(self) -> Floats:
        """The steps (k,), negative while the axis rests."""
        return np.where(self.rest, -self.steps, self.steps)

    @cached_property
    def middles(self) -> Floats:
        """The measured positions (n,) in the middle of each interval of the input, between the observations [unit]."""
        ends = np.cumsum(self.drive.step)
        return np.asarray(np.interp(ends - self.drive.step / 2, self.times, self.y))

    def with_columns(self, columns: Floats) -> ObservedStretch:
        """Return the stretch with further columns (c, n)."""
        columns = np.ascontiguousarray(np.vstack([self.drive.columns, columns]))
        return replace(self, drive=replace(self.drive, columns=columns))

    def resting(self, rest: Flags) -> ObservedStretch:
        """Return the stretch with the rests (k,) of a motion. The counts of one rest share one error of rounding, so
        that each has the variance of all together."""
        change = np.flatnonzero(np.diff(np.r_[False, rest, False].astype(np.int8)))
        variance = np.where(self.counted, 1 / 12, self.variance)
        for first, last in change.reshape(-1, 2).tolist():
            variance[first:last] *= last - first
        return replace(self, rest=rest, variance=variance)

    def keep(self, chosen: Flags) -> ObservedStretch:
        """Return the stretch with some of its observations (k,)."""
        drive = replace(self.drive, row=np.ascontiguousarray(self.drive.row[chosen]))
        return self._choose(drive, chosen, self.first)

    def _choose(self, drive: Excitation, chosen: Flags | slice, first: int) -> ObservedStretch:
        line = None if self.line is None else self.line[chosen]
        y, variance, counted, rest = self.y[chosen], self.variance[chosen], self.counted[chosen], self.rest[chosen]
        return ObservedStretch(drive, y, variance, counted, rest, first, line, self.acts)

    def cut(self, first: float, last: float) -> ObservedStretch:
        """Return the observations between two times [s], with the input from the first of them on."""
        ends = np.append(0.0, np.cumsum(self.drive.step))
        begin = int(np.clip(np.searchsorted(ends, first, side="right") - 1, 0, self.drive.step.size - 1))
        return self.part(begin, int(np.clip(np.searchsorted(ends, last), begin + 1, self.drive.step.size)))

    def part(self, begin: int, end: int) -> ObservedStretch:
        """Return the observations from the start of interval `begin` to that of interval `end`."""
        row = self.drive.row
        chosen, part = slice(*np.searchsorted(row, [begin, end + 1]).tolist()), slice(begin, end)
        drive = Excitation(
            np.ascontiguousarray(self.drive.step[part]),
            np.ascontiguousarray(self.drive.u[part]),
            np.ascontiguousarray(row[chosen] - np.int32(begin)),
            np.ascontiguousarray(self.drive.columns[:, part]),
            self.drive.tick,
            None if self.drive.on is None else np.ascontiguousarray(self.drive.on[part]),
        )
        return self._choose(drive, chosen, self.first + begin)


@dataclass(frozen=True, eq=False)
class ResidualBlock:
    """Residuals e (k,) of a stretch [counts], their derivatives J (k, p) by the parameters and K (k, s) by the start
    state, which is a position [counts] and a velocity [counts per mean step], and for an elastic body those of the
    second mass relative to the first."""

    e: Floats
    J: Floats
    K: Floats

    def weigh(self, e: Floats, weight: Floats) -> ResidualBlock:
        """Return the block with residuals e (k,) and its derivatives times a weight (k,), in the memory of this one."""
        self.J[...] *= weight[:, None]
        self.K[...] *= weight[:, None]
        return ResidualBlock(e, self.J, self.K)


@dataclass(frozen=True, eq=False)
class FitProblem:
    """A machine with further forces, and the stretches of a record.

    The parameters q are those of the machine, the mass as a logarithm, and then the size of each candidate in standard
    deviations of its prior. `mass` has the bounds of the logarithm of each mass, and `rate` those of the resonance of
    two masses [1/s], whose damping ratio is 1 at most. `parts` is the number of parts of an interval.
    """

    machine: BodyModel
    stretches: tuple[ObservedStretch, ...]
    resolution: float
    candidates: tuple[ExtraForce, ...] = ()
    mass: tuple[float, float] = (-np.inf, np.inf)
    parts: int = PARTS
    rate: tuple[float, float] = (0.0, np.inf)

    @property
    def size(self) -> int:
        """Number of parameters."""
        return len(self.machine.names) + sum(1 + one.free for one in self.candidates)

    @property
    def places(self) -> list[int]:
        """Index of the size of each candidate among the parameters. A free constant follows its size."""
        lengths = [1 + candidate.free for candidate in self.candidates]
        return [len(self.machine.names) + sum(lengths[:i]) for i in range(len(lengths))]

    @property
    def integrates(self) -> bool:
        """Whether a force or a lag makes the motion of a part of an interval inexact."""
        lags = bool(np.any(self.machine.lift[LAGGING] != 0)) and not self.machine.elastic
        return (
            lags
            or bool(self.machine.forces)
            or any(one.force is not None or one.base == LAGGING for one in self.candidates)
        )

    def keep(self, rows: Sequence[Flags]) -> FitProblem:
        """Return the problem with some of the observations (k,) of each stretch."""
        pairs = zip(self.stretches, rows, strict=True)
        return replace(self, stretches=tuple(replace(one.keep(kept), origin=one.base) for one, kept in pairs))

    def cut(self, parts: int) -> FitProblem:
        """Return the problem with stretches of at most 1/`parts` of the time, or itself if it is too short for them."""
        times = [float(np.sum(one.drive.step)) for one in self.stretches]
        pieces = []
        for stretch, time in zip(self.stretches, times, strict=True):
            ends = np.linspace(0.0, time, math.ceil(parts * time / sum(times) - 1e-9) + 1)
            cuts = [stretch.cut(*pair) for pair in pairwise(ends.tolist())] if ends.size > 2 else [stretch]
            pieces += [piece for piece in cuts if piece.y.size > 2]
        return replace(self, stretches=tuple(pieces) or self.stretches)

    def place_candidates(self) -> Iterator[tuple[int, ExtraForce]]:
        """Yield the index of the size of each candidate, and the candidate."""
        return zip(self.places, self.candidates, strict=True)

    @property
    def rows(self) -> int:
        """Number of observations."""
        return sum(one.y.size for one in self.stretches)

    def with_candidates(self, candidates: Sequence[ExtraForce]) -> FitProblem:
        return replace(self, candidates=tuple(candidates))

    def hold_position(self) -> FitProblem:
        """Return the problem with all forces of the position at the measured positions. An error of the motion does not
        change such a force, so that the search ends near the optimum from far away."""
        candidates = [one.force for one in self.candidates if one.force is not None and not (one.free or one.tied)]
        forces = [force for force in (*self.machine.forces, *candidates) if force.kind in (*AT_POSITION, *RUBS)]
        return self if self.machine.elastic or not forces else self.hold(forces)

    def hold(self, forces: Sequence[BodyForce]) -> FitProblem:
        """Return the problem with some forces of the position at the measured positions, as columns of the record."""
        first = self.stretches[0].drive.columns.shape[0]
        held = {id(force): force.hold(first + k) for k, force in enumerate(forces)}
        stretches = [
            one.with_columns(np.array([force.evaluate(one.middles) for force in forces])) for one in self.stretches
        ]
        return replace(
            self,
            machine=replace(self.machine, forces=tuple(held.get(id(force), force) for force in self.machine.forces)),
            candidates=tuple(replace(one, force=held.get(id(one.force), one.force)) for one in self.candidates),
            stretches=tuple(stretches),
        )

    def clip_to_bounds(self, q: Floats) -> Floats:
        """Return q (p,) within the bounds of the parameters."""
        low, high = list(self.machine.lowest), [np.inf] * len(self.machine.names)
        for one in self.candidates:
            low += [one.lowest, CONSTANT[0]] if one.free else [one.lowest]
            high += [np.inf, CONSTANT[1]] if one.free else [np.inf]
        q = np.clip(q, low, high)
        q[self.machine.lead] = np.clip(q[self.machine.lead], *self.mass)
        return self._clip_pair(q) if self.machine.elastic else q

    def _clip_pair(self, q: Floats) -> Floats:
        """Return q (p,) within the bounds of the second mass, the resonance, its damping and the gap."""
        load, stiffness, damping, *play = self.machine.further
        q[load] = np.clip(q[load], *self.mass)
        reduced = -np.logaddexp(-q[self.machine.lead], -q[load])
        with np.errstate(divide="ignore"):
            q[stiffness] = np.clip(q[stiffness], *(2 * np.log(self.rate) + reduced))
        q[damping] = np.clip(q[damping], 0.0, 2 * np.exp((q[stiffness] + reduced) / 2))
        q[play] = np.maximum(q[play], PLAY_TUNING.narrowest * self.resolution)
        return q

    def theta(self, q: Floats) -> Floats:
        """Return the machine's parameters in their units."""
        theta = q[: len(self.machine.names)].copy()
        theta[self.machine.logs] = np.exp(np.clip(theta[self.machine.logs], -300, 300))
        return theta

    def start(self, theta: Floats) -> Floats:
        """Return q at theta, with candidates of size 0 and their constants at their first values."""
        q = np.zeros(self.size)
        q[: theta.size] = theta
        q[self.machine.logs] = np.log(theta[self.machine.logs])
        for k, candidate in self.place_candidates():
            if candidate.free:
                q[k + 1] = 1.0
        return q

    def first_starts(self) -> Floats:
        """Return start states (m, s) from the first counts of each stretch."""
        further = [0.0] * (len(self.machine.starts) - 2)
        return np.array([[0.0, _first_speed(one, self.resolution), *further] for one in self.stretches])

    def scales(self) -> Iterator[float]:
        """Yield the unit of the start velocity [1/s] of each stretch."""
        return (1.0 / float(np.mean(one.steps)) for one in self.stretches)

    def linearise(self, q: Floats, starts: Floats) -> list[ResidualBlock]:
        """Return a block for each stretch at q (p,) and the start states (m, s)."""
        return [block for block, _ in self.linearise_motion(q, starts)]

    def linearise_motion(self, q: Floats, starts: Floats) -> list[tuple[ResidualBlock, Floats]]:
        """Return the blocks, each with the velocities (k,) [unit/s]."""
        same = self._body(q)
        blocks = [
            self._block(stretch, state, scale, *(same if stretch.acts is None else self._body(q, stretch.acts)))
            for stretch, state, scale in zip(self.stretches, starts, self.scales(), strict=True)
        ]
        if any(one.reads for one in self.candidates):
            pairs = zip(blocks, self.stretches, strict=True)
            return [(self._read(block, v, one, q), v) for (block, v), one in pairs]
        return blocks

    def residuals(self, q: Floats, starts: Floats) -> list[Floats]:
        """Return the residuals (k,) of each stretch [counts], in less time than with their derivatives."""
        if any(one.reads for one in self.candidates):
            return [block.e for block in self.linearise(q, starts)]
        motion = zip(self.motion(q, starts), self.stretches, strict=True)
        return [self._errors_of(y, stretch) for (y, _), stretch in motion]

    def _errors_of(self, y: Floats, stretch: ObservedStretch) -> Floats:
        """Return finite residuals (k,) of positions y (k,) [counts]."""
        return np.clip(np.nan_to_num((y + stretch.apart - stretch.y) / self.resolution, nan=FAR), -FAR, FAR)

    def _read(self, block: ResidualBlock, v: Floats, stretch: ObservedStretch, q: Floats) -> ResidualBlock:
        """Return a block with the errors of the encoder, which depend on the position, and the lateness of edges."""
        y = block.e * self.resolution + stretch.y
        e, slope, J, at = block.e.copy(), np.ones(y.size), block.J.copy(), 0
        for k, candidate in self.place_candidates():
            if candidate.reading is not None:
                (period, phase), at = candidate.reading, k + 1 if candidate.free else at
                period *= q[at] if candidate.free or candidate.tied else 1.0
                angle, size = 2 * np.pi / period * y + phase, q[k] * candidate.sd
                J[:, k] = np.sin(angle) * candidate.sd / self.resolution
                e += q[k] * J[:, k]
                turning = size * 2 * np.pi / period * np.cos(angle)
                slope += turning
                if candidate.free or candidate.tied:
                    J[:, at] += -turning * y / q[at] / self.resolution
            elif candidate.late:
                J[:, k] = np.where(stretch.counted, 0.0, -v * candidate.sd / self.resolution)
                e += q[k] * J[:, k]
        of_motion = np.ones(J.shape[1], bool)
        for k, candidate in self.place_candidates():
            of_motion[k : k + 1 + candidate.free] = not candidate.reads
        J[:, of_motion] *= slope[:, None]
        return ResidualBlock(e, J, block.K * slope[:, None])

    def motion(self, q: Floats, starts: Floats) -> list[tuple[Floats, Floats]]:
        """Return the positions and velocities (k,) at the observations of each stretch [unit, unit/s]."""
        found, same = [], self._body(q)
        for stretch, state, scale in zip(self.stretches, starts, self.scales(), strict=True):
            body, forces, _ = same if stretch.acts is None else self._body(q, stretch.acts)
            at = self._start_body(stretch, state, scale, body)
            m = self.machine
            motion = simulate(stretch.drive, forces, at, self.parts, elastic=m.elastic, load=m.load)
            found.append(motion[:2])
        return found

    def _body(self, q: Floats, acts: Floats | None = None) -> tuple[Floats, list[BodyForce], Floats]:
        """Return the body's parameters (w,), its forces, and the derivatives (w, p) of the parameters by q."""
        m = self.machine
        own, count = len(m.names), len(m.forces)
        base, shapes = m.base, m.lift.shape[0] - m.base - count - m.loops
        theta = self.theta(q) if acts is None else self.theta(q) * acts
        slopes = m.lift_at(theta) if acts is None else m.lift_at(theta) * acts
        extra = [force for one in self.candidates for force in one.forces]
        w = (
            m.lift.shape[0]
            + len(extra)
            + sum((one.free or one.tied) and one.by_constant is None and not one.reads for one in self.candidates)
        )
        # rows: base, forces of the machine, further forces, constants of the machine, further constants, controller
        place = [*range(base + count), *range(base + count + len(extra), base + count + len(extra) + shapes)]
        place += range(w - m.loops, w)
        body, lift = np.zeros(w), np.zeros((w, self.size))
        body[place], lift[np.ix_(place, range(own))] = m.body(theta), slopes
        lift[:, m.logs] *= theta[m.logs]
        row, constant = base + count, base + count + len(extra) + shapes
        for k, candidate in self.place_candidates():
            if candidate.reads:
                continue
            target = row if candidate.force is not None else candidate.base
            body[target] += q[k] * candidate.sd
            lift[target, k] += candidate.sd
            row += len(candidate.forces)
            if candidate.free and candidate.by_constant is not None:
                further = candidate.sd * candidate.constant
                body[row - 1], lift[row - 1, k + 1] = q[k] * (q[k + 1] - 1) * further, q[k] * further
                lift[row - 1, k] = (q[k + 1] - 1) * further
            elif candidate.free:
                body[constant], lift[constant, k + 1] = q[k + 1] * candidate.constant, candidate.constant
                constant += 1
            elif candidate.tied:
                body[constant], lift[constant] = body[constant - 1], lift[constant - 1]
                constant += 1
        return body, [*m.forces, *extra], lift

    def _start_body(self, stretch: ObservedStretch, state: Floats, scale: float, body: Floats) -> Floats:
        at = body.copy()
        at[list(self.machine.starts)] = state * self.resolution * np.resize([1.0, scale], state.size)
        at[self.machine.starts[0]] += stretch.base
        if stretch.speed is not None:
            at[self.machine.starts[1]] = stretch.speed
        return at

    def _block(
        self,
        stretch: ObservedStretch,
        state: Floats,
        scale: float,
        body: Floats,
        forces: Sequence[BodyForce],
        lift: Floats,
    ) -> tuple[ResidualBlock, Floats]:
        """Return the block of a stretch and its velocities (k,)."""
        at = self._start_body(stretch, state, scale, body)
        if not (np.all(np.isfinite(at)) and at[MASS] > 0):
            rows = stretch.y.size
            far = ResidualBlock(np.full(rows, FAR), np.zeros((rows, lift.shape[1])), np.zeros((rows, state.size)))
            return far, np.zeros(rows)
        m = self.machine
        by_start = np.zeros((at.size, state.size))
        by_start[list(m.starts), range(state.size)] = np.resize([1.0, scale], state.size)
        by_start[m.starts[1]] *= stretch.speed is None
        lift = np.hstack([lift / self.resolution, by_start])
        y, v, S = simulate(stretch.drive, forces, at, self.parts, lift, m.elastic, m.load)
        if not (np.isfinite(S.sum()) and np.isfinite(v.sum())):
            S, v = np.nan_to_num(S), np.nan_to_num(v)
        return ResidualBlock(self._errors_of(y, stretch), S[:, : self.size], S[:, self.size :]), v


def _first_speed(stretch: ObservedStretch, resolution: float) -> float:
    """Return the first speed in counts per mean step, over the observations that it takes for three counts, or 0 if
    that is more than ten."""
    change = (stretch.y[1:11] - stretch.y[0]) / resolution
    enough = np.flatnonzero(np.abs(change) >= 3)
    last = int(enough[0]) + 1 if enough.size else min(10, change.size)
    if not change.size or not np.any(change != 0):
        return 0.0
    step = float(np.mean(stretch.steps))
    return float(change[last - 1] * step / (stretch.times[last] - stretch.times[0]))
