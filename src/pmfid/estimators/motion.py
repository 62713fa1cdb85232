"""Simulated motions, and their differences from the counts."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from itertools import accumulate
from operator import mul

import numpy as np
from numpy.typing import NDArray

from pmfid._stage import first_order
from pmfid.errors import NotIdentifiableError
from pmfid.estimators.least_squares import parts_of_their_own
from pmfid.estimators.tuning import TUNING
from pmfid.kernel.configuration import Decay, decays, shape_bytes
from pmfid.models.equation import ESTIMATE, LATE, MASS, MOST_LATE, VISCOUS_BACKWARD, VISCOUS_FORWARD, Equation
from pmfid.types import Flags, Floats

#: Sample period, or times (n,) from each sample to the next [s].
Intervals = float | Floats


def sum_travel(velocity: Floats, dt: Intervals) -> Floats:
    """Return the positions (..., n) at the samples from 0 on, for mean velocities (..., n) between samples."""
    travel = np.zeros_like(velocity)
    steps = velocity * dt if isinstance(dt, np.ndarray) else velocity
    np.cumsum(steps[..., :-1], axis=-1, out=travel[..., 1:])
    if not isinstance(dt, np.ndarray):
        travel *= dt
    return travel


def mean_velocity(
    equation: Equation,
    theta: Floats,
    dt: Intervals,
    u: Floats,
    velocity: float = 0.0,
    position: float = 0.0,
    parts: int = TUNING.motion_parts,
    before: Floats | None = None,
    on_top: Floats | None = None,
) -> Floats:
    """Return the mean velocity (n,) in every interval at theta (p,) under the held input u (n,).

    theta includes the shape parameters. `velocity` and `position` are those of the start; the equation defines the
    origin of the position. `parts` is the number of parts per sample for an equation with shapes or a lag. The motion
    is exact for other equations. `before` (m,) has earlier inputs for a dead time or a lag, and None stands for zeros.
    `on_top` (n,) acts at once in addition to the input, in the unit of the input.
    """
    return simulate_motion(equation, theta, dt, u, velocity, position, parts, before, on_top)[0]


def simulate_motion(
    equation: Equation,
    theta: Floats,
    dt: Intervals,
    u: Floats,
    velocity: float = 0.0,
    position: float = 0.0,
    parts: int = TUNING.motion_parts,
    before: Floats | None = None,
    on_top: Floats | None = None,
) -> tuple[Floats, float]:
    """Return `mean_velocity` and the velocity at the end."""
    at = np.array([[velocity, position]])
    found, ends = simulate_motions(equation, np.asarray(theta)[None], dt, u, at, parts, before, on_top)
    return np.asarray(found[0]), float(ends[0])


def simulate_motions(
    equation: Equation,
    thetas: Floats,
    dt: Intervals,
    u: Floats,
    starts: Floats,
    parts: int = TUNING.motion_parts,
    before: Floats | None = None,
    on_top: Floats | None = None,
    split: int = 1,
) -> tuple[Floats, Floats]:
    """Return the mean velocities (m, split n) of m motions under one input, and their final velocities (m,).

    Every interval has `split` equal pieces. `thetas` is (m, p), and `starts` (m, 2) has velocities and positions.
    `parts` is the number of parts per piece. `on_top` is (split n,), or has a row for each motion. Motions with equal
    shape parameters are computed side by side.
    """
    from pmfid import _kernel64

    p, past = len(equation.names), np.zeros(1) if before is None else before
    velocity, ends = np.empty((len(thetas), split * u.size)), np.empty(len(thetas))
    period, steps = (float(np.mean(dt)), dt) if isinstance(dt, np.ndarray) else (dt, None)
    alike: dict[tuple[float, ...], list[int]] = {}
    for index, theta in enumerate(thetas):
        alike.setdefault(tuple(theta[p:].tolist()), []).append(index)
    for further, rows in alike.items():
        known = _equation_at(equation, further) if further else equation
        shapes, pieces = shape_bytes(known.shapes), split
        roles = np.array([known.role_values(theta) for theta in thetas[rows]])
        if steps is not None and (known.lag or np.any(roles[:, LATE] > 0)):
            spans, held, earlier = np.repeat(steps / split, split), np.repeat(u, split), np.repeat(past, split)
            for row, own in zip(rows, roles.tolist(), strict=True):
                force = on_top if on_top is None or on_top.ndim == 1 else on_top[row]
                velocity[row], ends[row] = _simulate_late(known, own, spans, held, starts[row], parts, earlier, force)
            continue
        if shapes or known.lag:
            pieces *= parts
            for viscous in (VISCOUS_FORWARD, VISCOUS_BACKWARD):  # the kernel adds this damping to each part
                less = parts * TUNING.little_damping * roles[:, MASS] / (period / split)
                roles[:, viscous] = np.maximum(roles[:, viscous] - less, 0.0)
        velocity[rows], _, _, ends[rows] = _kernel64.simulate_many(
            roles,
            known.input_gain,
            period / pieces,
            u,
            starts[rows, 0],
            starts[rows, 1],
            shapes,
            past,
            _decays(known, roles, period / pieces),
            on_top if on_top is None or on_top.ndim == 1 else on_top[rows],
            pieces,
            pieces // split,
            steps=steps,
        )
    return velocity, ends


@lru_cache(maxsize=64)
def _equation_at(equation: Equation, further: tuple[float, ...]) -> Equation:
    """Return the equation at these lag and shape parameters. Windows and quotients ask for the same ones many times."""
    return equation.known_at(further)


def _simulate_late(
    known: Equation,
    roles: list[float],
    dt: Floats,
    u: Floats,
    start: Floats,
    parts: int,
    past: Floats,
    force: Floats | None,
) -> tuple[Floats, float]:
    """Run `simulate_motion` for intervals dt (n,) [s] and a delayed input, in pieces with one input each."""
    from pmfid import _kernel64

    shapes = shape_bytes(known.shapes)
    pieces = _cut_pieces(u, past, dt, roles[LATE], float(known.lag), parts if shapes or known.lag else 1)
    roles[LATE], extra = 0.0, None if force is None else force[pieces.interval]
    found = _kernel64.simulate(
        roles,
        known.input_gain,
        1.0,
        pieces.u,
        float(start[0]),
        float(start[1]),
        shapes,
        np.zeros(1),
        None,
        extra,
        pieces.steps,
    )
    return np.add.reduceat(np.asarray(found[0]) * pieces.steps, pieces.firsts) / dt, float(found[3])


@dataclass(frozen=True)
class _Pieces:
    """Pieces (k,) of uneven intervals with one input in each piece. `u` are the inputs, `steps` the lengths [s], and
    `interval` the indices of the pieces' intervals. `firsts` (n,) are the first pieces of the intervals."""

    u: Floats
    steps: Floats
    interval: NDArray[np.intp]
    firsts: NDArray[np.intp]


def _cut_pieces(u: Floats, past: Floats, dt: Floats, late: float, lag: float, parts: int) -> _Pieces:
    """Return the pieces of intervals dt (n,) [s] under delayed inputs u (n,), each piece in equal parts. For a lag [s],
    each part has the mean of the lagging input."""
    ends = np.append(0.0, np.cumsum(dt))
    switches = np.append(-float(np.mean(dt)) * np.arange(past.size, 0, -1), ends[:-1]) + late
    values = np.append(past, u)
    edges = np.unique(np.append(ends, switches[(switches < ends[-1]) & ((switches > 0) | (lag > 0))]))
    edges = np.interp(np.arange(parts * (edges.size - 1) + 1), parts * np.arange(edges.size), edges)
    steps, middle = np.diff(edges), (edges[1:] + edges[:-1]) / 2
    acting = values[np.maximum(np.searchsorted(switches, middle, side="right") - 1, 0)]
    if lag > 0:
        acting = _lag_input(acting, steps, lag)
    kept = middle > 0
    interval = np.searchsorted(ends, middle[kept], side="right") - 1
    return _Pieces(acting[kept], steps[kept], interval, np.searchsorted(interval, np.arange(u.size)))


def _lag_input(u: Floats, steps: Floats, lag: float) -> Floats:
    """Return the means (k,) over steps (k,) [s] of the inputs u (k,) after a first-order lag [s]."""
    left, mean = np.exp(-steps / lag), -np.expm1(-steps / lag) * lag / steps
    now, found = float(u[0]), np.empty(u.size)
    for k, (target, rest, part) in enumerate(zip(u.tolist(), left.tolist(), mean.tolist(), strict=True)):
        found[k] = target + part * (now - target)
        now = target + rest * (now - target)
    return found


def _decays(equation: Equation, roles: Floats, dt: float) -> list[list[Decay]] | None:
    """Return the kernel's decay factors of the lag for each motion, in steps of dt [s], or None without a lag."""
    if not equation.lag:
        return None
    late = np.maximum(roles[:, LATE] / dt, 0.0)
    return [decays(part, float(equation.lag) / dt) for part in (late - np.floor(late)).tolist()]


def parts_for(equation: Equation, theta: Floats, dt: Intervals, u: Floats, allowed: float) -> int:
    """Return the number of parts per sample for a root mean square position error of `allowed` [unit of y]. The error
    of the scheme falls with the square of the number of parts."""
    parts = 1
    if equation.shaped or equation.lag:
        coarse = mean_velocity(equation, theta, dt, u, parts=parts)
        while parts < TUNING.most_parts:
            fine = mean_velocity(equation, theta, dt, u, parts=2 * parts)
            if not np.std(sum_travel(coarse - fine, dt)) > allowed:
                break
            parts, coarse = 2 * parts, fine
    return parts


#: Function from parameters, start velocity and force on top to position from 0 and velocity, as `Difference.motion`.
Motion = Callable[[Floats, float, Floats | None], tuple[Floats, Floats]]


@dataclass
class Restart:
    """The part of a record after a gap.

    The position y (n,) of its counts has the variance `white`. The counts show the speed `shown` with the standard
    deviation `known` [unit of y per s]. The next search begins at the last speed and its effect (n,) on the position
    about the mean.
    """

    part: slice
    y: Floats
    white: float
    shown: float
    known: float
    motion: Motion
    speed: float = field(init=False)
    effect: Floats = field(default_factory=lambda: np.zeros(0), init=False)

    def __post_init__(self) -> None:
        self.speed = self.shown

    def best(self, parameters: Floats, force: Floats | None) -> tuple[Floats, Floats]:
        """Return position and velocity (n,) for the start that least squares finds."""
        prior = self.white / self.known**2
        if self.effect.size == 0:
            self.effect = self._effect_at(self.shown, parameters, force)
        fresh, found = True, self._from(self.speed, parameters, force)
        step = self._step(found.apart, prior)
        for _ in range(TUNING.motion_turns):
            if abs(step) < TUNING.motion_small * self.known:
                return found.position + step * self.effect, found.velocity
            tried = self._from(self.speed + step, parameters, force)
            if self._sum_squares(tried, self.speed + step, prior) < self._sum_squares(found, self.speed, prior):
                self.speed, found, fresh = self.speed + step, tried, True
                step = self._step(found.apart, prior)
            # after a stop, the position depends on the speed in another way than at the place of the stored effect
            elif fresh:
                self.effect, fresh = self._effect_at(self.speed, parameters, force), False
                step = self._step(found.apart, prior)
            else:
                step *= TUNING.motion_shorter
        return found.position, found.velocity

    def _from(self, speed: float, parameters: Floats, force: Floats | None) -> _Moved:
        position, velocity = self.motion(parameters, speed, force)
        level = float(np.mean(self.y - position))
        return _Moved(position + level, velocity, self.y - position - level)

    def _effect_at(self, speed: float, parameters: Floats, force: Floats | None) -> Floats:
        sides = (
            self.motion(parameters, speed + side * TUNING.velocity_step * self.known, force)[0] for side in (1.0, -1.0)
        )
        effect = np.subtract(*sides) / (2 * TUNING.velocity_step * self.known)
        return np.asarray(effect - np.mean(effect))

    def _step(self, apart: Floats, prior: float) -> float:
        power = float(self.effect @ self.effect) + prior
        return (float(apart @ self.effect) + prior * (self.shown - self.speed)) / power

    def _sum_squares(self, moved: _Moved, speed: float, prior: float) -> float:
        return float(moved.apart @ moved.apart) + prior * (self.shown - speed) ** 2


@dataclass(frozen=True, eq=False)
class _Moved:
    """Position and velocity (n,) from a start, and the difference from the counts (n,)."""

    position: Floats
    velocity: Floats
    apart: Floats


#: Square root of the information [1/counts] of a sample if the encoder's error is white.
WHITE = math.sqrt(12.0)


@dataclass(frozen=True)
class Difference:
    """Position of the counts minus simulated position [counts], as a function of q = (theta, x0, v0) / scale.

    The roles of `equation` say what the simulation takes from theta. `u` and `y` are (n,), `dt` is in [s], and `scale`
    is (q,). `pole` is that of the high-pass on the difference [rad/s]; 0 means no high-pass. `parts` is the number of
    parts per sample in the simulation of shapes. `zero` is the position of a slack spring; None takes the first count.
    `past` (m,) has earlier inputs, or None for unknown ones.

    `breaks` has, for each gap in the record, its first sample and the first sample after it. The motion is unknown in a
    gap and restarts after it. `uneven` (n,) are the times from each sample to the next [s]; None takes dt.
    """

    equation: Equation
    dt: float
    u: Floats
    y: Floats
    resolution: float
    scale: Floats
    pole: float
    parts: int = 1
    zero: float | None = None
    past: Floats | None = None
    breaks: tuple[tuple[int, int], ...] = ()
    uneven: Floats | None = None

    @property
    def intervals(self) -> Intervals:
        """dt, or the times (n,) from each sample to the next [s]."""
        return self.dt if self.uneven is None else self.uneven

    def __call__(self, q: Floats) -> Floats:
        return np.asarray(self.differences(q[None])[0])

    def differences(self, qs: Floats) -> Floats:
        """Return the differences (m, n) at the rows of `qs` (m, q), computed side by side."""
        return np.array([self.observe(self.y - x) for x in self.motions(qs)[0]])

    def observe(self, signal: Floats) -> Floats:
        """Return the filtered position (n,) in counts, as it enters the difference."""
        return self.filter_signal(signal) / self.resolution

    def motion(self, q: Floats, force: Floats | None = None) -> tuple[Floats, Floats]:
        """Return the simulated position at the samples (n,) and the mean velocity between samples.

        `force` is (n,), or (k n,) for k equal parts of every sample. The force acts on top of the input's force [unit
        of the equation]. The velocity is (n,), or as fine as the force.
        """
        position, velocity = self.motions(q[None], None if force is None else force[None])
        return position[0], velocity[0]

    def motions(self, qs: Floats, forces: Floats | None = None) -> tuple[Floats, Floats]:
        """Simulate one motion for each row of `qs` (m, q), each with its own force (m, n) or (m, k n). Return the
        positions (m, n), and the velocities (m, n) or (m, k n)."""
        if self.breaks:
            rows = zip(qs, [None] * len(qs) if forces is None else forces, strict=True)
            found = [self._simulate_parts(*row) for row in rows]
            return np.array([x for x, _ in found]), np.array([v for _, v in found])
        values = qs * self.scale
        starts = values[:, :-3:-1] - np.array([0.0, self.slack])  # the first count is the origin of a spring's length
        split, on_top = 1, None
        if forces is not None:
            split, on_top = forces.shape[1] // self.u.size, forces / self.equation.input_gain
        parts = max(1, -(-self.parts // split))
        dt, thetas = self.intervals, values[:, :-2]
        velocity, _ = simulate_motions(self.equation, thetas, dt, self.u, starts, parts, self.before, on_top, split)
        fine = np.repeat(dt / split, split) if isinstance(dt, np.ndarray) else dt / split
        return values[:, -2:-1] + sum_travel(velocity, fine)[:, ::split], velocity

    def _simulate_parts(self, q: Floats, force: Floats | None) -> tuple[Floats, Floats]:
        """Simulate a record with gaps, as `motion` does. In a gap the position follows the counts, and the velocity is
        zero.
        """
        split = 1 if force is None else force.size // self.u.size
        position, velocity = self.y.copy(), np.zeros(split * self.u.size)
        first, others = self._parts
        own = slice(split * first.start, split * first.stop)
        position[first], velocity[own] = self._piece(first).motion(q, None if force is None else force[own])
        for restart in others:
            own = slice(split * restart.part.start, split * restart.part.stop)
            found = restart.best(q[:-2], None if force is None else force[own])
            position[restart.part], velocity[own] = found
        return position, velocity

    @cached_property
    def _parts(self) -> tuple[slice, list[Restart]]:
        """The first part of the record between its gaps, and the other parts."""
        edges = [0, *(edge for gap in self.breaks for edge in gap), self.y.size]
        parts = [slice(a, b) for a, b in zip(edges[0::2], edges[1::2], strict=True) if b > a]
        return parts[0], [self._restart(part) for part in parts[1:]]

    def _restart(self, part: slice) -> Restart:
        piece = self._piece(part)

        def motion(parameters: Floats, speed: float, force: Floats | None) -> tuple[Floats, Floats]:
            return piece.motion(np.r_[parameters, np.array([piece.y[0], speed]) / piece.scale[-2:]], force)

        known = piece.start_velocity_std * float(piece.scale[-1])
        return Restart(part, piece.y, self.resolution**2 / 12, piece.shown_speed, known, motion)

    def _piece(self, part: slice) -> Difference:
        """Return the difference on a part between gaps. The inputs before a gap count as unknown after the gap."""
        past = self.before if part.start == 0 else self.u[part][:1]
        uneven = None if self.uneven is None else self.uneven[part]
        return replace(self, u=self.u[part], y=self.y[part], zero=self.slack, past=past, breaks=(), uneven=uneven)

    @property
    def shown_speed(self) -> float:
        """Return the start velocity that the counts show [unit of y per s]."""
        return first_speed(self.y, self.intervals, float(self.scale[-1] / self.scale[-2]), self.resolution)

    @property
    def before(self) -> Floats:
        """Inputs (m,) before the first sample, for a dead time. Unknown inputs are zero if the axis rests until they
        act. If the axis moves at the start, unknown inputs equal the first input."""
        if self.past is not None:
            return self.past
        return np.array([0.0 if np.all(self.y[:2] == self.y[0]) else float(self.u[0])])

    def fine_at(self, theta: Floats) -> Difference:
        """Return the difference with as many parts per sample as the counts need at theta (p,), at least the present
        number.
        """
        asked = parts_for(self.equation, theta, self.intervals, self.u, TUNING.parts_error * self.resolution)
        return replace(self, parts=max(self.parts, asked))

    def replace_equation(self, equation: Equation, scale: Floats) -> Difference:
        """Return a copy for another equation, with the scales (p,) of its parameters."""
        return replace(self, equation=equation, scale=np.r_[scale, self.scale[self.parameters :]])

    @property
    def parameters(self) -> int:
        """The number of parameters, including those that enter the equation nonlinearly."""
        return self.scale.size - 2

    @property
    def slack(self) -> float:
        """Position at which a spring is slack."""
        return float(self.y[0]) if self.zero is None else self.zero

    def part(self, first: int, last: int) -> Difference:
        """Return the difference on samples first to last - 1, with its own start."""
        past = np.r_[self.before, self.u[:first]][
            -(TUNING.motion_lagging if self.equation.lag else 1) * MOST_LATE - 2 :
        ]
        uneven = None if self.uneven is None else self.uneven[first:last]
        return replace(self, u=self.u[first:last], y=self.y[first:last], zero=self.slack, past=past, uneven=uneven)

    def read_velocity(self, q: Floats) -> Floats:
        """Return the simulated mean velocity (n,) after each sample of the record at q (q,)."""
        return self.motion(q)[1]

    def measure_misfit(self, q: Floats) -> float:
        """Return the part of the motion, 0 to about 1, that neither the model at q (q,) nor the encoder explains."""
        motion = self.filter_signal(self.y - np.mean(self.y))
        excess = max(float(np.mean(self(q) ** 2)) - self.explained**2, 0.0)
        return float(np.sqrt(excess)) * self.resolution / max(rms(motion), TUNING.tiny)

    def filter_signal(self, signal: Floats) -> Floats:
        """Return the high-passed signal, from rest. The high-pass turns white noise on top of a random walk into white
        noise.
        """
        if self.pole == 0:
            return signal
        return first_order(signal, math.exp(-self.pole * self.dt), 1.0, -1.0)[0]

    def sum_by_sample(self, values: Floats) -> Floats:
        """Return the sums of the difference's values (n, ...) at each sample of the record."""
        return values

    @property
    def side_by_side(self) -> int:
        """The number of differences that take about the time of one. Differences with various shapes run one by one."""
        return 1 if self.breaks or self.equation.further else TUNING.trials_together

    @property
    def size_of_motion(self) -> float:
        """Root mean square [counts] of the position about its mean, after the high-pass."""
        return rms(self.filter_signal(self.y - np.mean(self.y)) / self.resolution)

    def jacobian(self, q: Floats, width: float = TUNING.quotient_step, first: int = 0) -> Floats:
        """Return the derivatives by q[first:] in columns, as central differences that respect the lower bounds."""
        trials, apart = self.spread_trials(q, width, first)
        return divide_sides(self.differences(trials), apart)

    def spread_trials(self, q: Floats, width: float, first: int = 0) -> tuple[Floats, Floats]:
        """Return places (2 k, q) on both sides of q (q,) along each of the last k directions, and their distances (k,)
        from each other."""
        steps = width * np.eye(q.size)[first:]
        low = np.maximum(q - steps, self.lower)
        return np.concatenate([q + steps, low]), np.sum(q + steps - low, axis=1)

    def forward_jacobian(self, q: Floats, e: Floats, widths: Floats | float = TUNING.quotient_step) -> Floats:
        """Return the derivatives by q (q,) in columns, as forward differences from the difference e (n,) at q.

        Forward differences need half the simulations of `jacobian`. The difference shifts the end of an iteration by a
        ten-thousandth of a standard error.
        """
        return np.asarray((self.differences(q + widths * np.eye(q.size)) - e).T / widths)

    def own_sensitivity(self, q: Floats, root: Floats | None = None, width: float = TUNING.quotient_step) -> Floats:
        """Return the effect (n, p) of each parameter on the difference that the start cannot reproduce."""
        jacobian, p = self.jacobian(q, width), self.parameters
        return self.remove_nuisance(jacobian[:, :p], jacobian[:, p:], root)

    def remove_nuisance(self, columns: Floats, nuisance: Floats, root: Floats | None = None) -> Floats:
        """Return the part of the effects (n, k) [counts] that the start position and velocity cannot reproduce.

        `nuisance` (n, 2) are the effects of the start. `root` (n,) are square roots of the samples' information; None
        assumes a white encoder error. The start velocity counts as known to a few counts per filter time constant. From
        rest a small velocity moves nothing, and the fit must not invent a velocity.
        """
        weight = np.full((columns.shape[0], 1), WHITE) if root is None else root[:, None]
        prior = np.array([[0.0, 1 / self.start_velocity_std]])
        weighted, targets = np.r_[weight * nuisance, prior], np.r_[weight * columns, np.zeros((1, columns.shape[1]))]
        return np.asarray(columns - nuisance @ np.linalg.lstsq(weighted, targets)[0])

    @property
    def finer(self) -> Difference:
        """Return the difference with twice as many parts per sample."""
        return replace(self, parts=2 * self.parts)

    @property
    def rows(self) -> int:
        """The number of values of the difference."""
        return self.y.size

    @property
    def restarts(self) -> bool:
        """Whether the motion has more than one start."""
        return bool(self.breaks)

    @property
    def start_velocity_std(self) -> float:
        """Standard deviation of the start velocity in the unit of q, some counts per filter time constant."""
        return TUNING.start_counts * self.resolution / float(self.scale[-2])

    @property
    def recovery(self) -> int:
        """Samples until the high-pass has forgotten a step; 1 without a high-pass."""
        return math.ceil(1 / (self.pole * self.dt)) if self.pole > 0 else 1

    @property
    def explained(self) -> float:
        """Root mean square [counts] that the encoder and the simulation explain."""
        return TUNING.encoder_alone + TUNING.simulation_error * float(np.ptp(self.y)) / self.resolution

    @property
    def lower(self) -> Floats:
        """Lower bounds of q. Mass and shape parameters stay above zero, and frictions at or above zero."""
        lower = np.full(self.scale.size, -np.inf)
        lower[: len(self.equation.names)][np.array(self.equation.positive)] = 0.0
        lower[self.equation.leading] = TUNING.least_mass
        lower[len(self.equation.names) : -2] = TUNING.least_shape
        if self.equation.lag == ESTIMATE:
            lower[len(self.equation.names)] = 0.0
        return lower


def divide_sides(found: Floats, apart: Floats) -> Floats:
    """Return the central differences (n, k) of values `found` (2 k, n) at `spread_trials`, which are `apart` (k,)."""
    above, below = np.split(found, 2)
    return np.asarray(((above - below) / apart[:, None]).T)


def first_speed(y: Floats | NDArray[np.int64], dt: Intervals, cutoff: float, resolution: float) -> float:
    """Return the start velocity [unit of y per s] of a position y (n,).

    The velocity is the mean over a filter time constant 1 / cutoff [s]. A motion below 1.5 times the resolution gives
    zero, because a small velocity within stiction changes nothing.
    """
    period = float(np.mean(dt))
    near = min(y.size - 1, math.ceil(1 / (cutoff * period)))
    rise, time = float(y[near] - y[0]), float(np.sum(dt[:near])) if isinstance(dt, np.ndarray) else near * dt
    return rise / time if abs(rise) > 1.5 * resolution else 0.0


def rms(signal: Floats) -> float:
    """Return the root mean square of a signal (n,)."""
    return float(np.sqrt(np.mean(signal**2)))


def least(difference: Difference, q: Floats, tolerances: Sequence[float] | None = None) -> Floats:
    """Return the least squares from q (q,). Raises NotIdentifiableError if the iteration does not converge.

    The iteration tries the relative tolerances of the sum of squares one after the other. None takes a tolerance of
    settled_step^2 / n, by which a step of settled_step standard errors lowers the sum.
    """
    settled = TUNING.settled_step**2 / difference.y.size
    for tolerance in tolerances or (settled, max(settled, TUNING.rough_tolerance)):
        q, ended = _descend(difference, q, tolerance)
        if ended or rms(difference(q)) <= difference.explained:
            return q
    raise NotIdentifiableError(
        f"the iteration did not converge within {TUNING.max_evaluations} simulations, because the "
        "simulated position does not follow the record closely; use iv, or in Python give `initial`"
    )


def _descend(difference: Difference, q: Floats, tolerance: float) -> tuple[Floats, bool]:
    """Return q (q,) after damped Gauss-Newton steps, and whether they converged (Levenberg 1944, Marquardt 1963). The
    steps have converged if the sum of squares falls by less than `tolerance` times itself. They have also converged if
    no step lowers it, or if a step that does not lower it should have lowered it by less."""
    with np.errstate(over="ignore", invalid="ignore"):  # a step that is too long is undone
        error, damping = difference(q), TUNING.first_damping
        jacobian = difference.forward_jacobian(q, error)
        if not (np.all(np.isfinite(error)) and np.all(np.isfinite(jacobian))):
            raise NotIdentifiableError(
                "the simulated position exceeds the range of numbers, because it does not follow the record; "
                "use iv, or in Python give `initial`"
            )
        tried, together = 0, 1
        while tried < TUNING.max_evaluations:
            cost, several = float(error @ error), min(together, TUNING.max_evaluations - tried)
            dampings = list(accumulate(several * [10.0], mul, initial=damping))[:-1]
            trials = _damped_steps(difference, q, error, jacobian, dampings)
            for trial, found, damping in zip(trials, try_steps(difference, q, trials), dampings, strict=True):
                gain, tried = cost - float(found @ found), tried + 1
                if gain > 0:
                    step, q, error, damping, together = trial - q, trial, found, damping / 10, 1
                    if gain <= tolerance * cost:
                        return q, True
                    widths = _widths_near(difference, error, step)
                    jacobian = difference.forward_jacobian(q, error, widths)
                    break
                promised = cost - rms(error + jacobian @ (trial - q)) ** 2 * error.size
                if damping > TUNING.max_damping or gain == 0 or promised <= tolerance * cost:
                    return q, True
            else:
                damping, together = 10 * damping, difference.side_by_side
    return q, False


def _widths_near(difference: Difference, error: Floats, step: Floats) -> Floats | float:
    """Return the widths of the difference quotients after a step (q,) to the error (n,).

    If the motion nearly explains the counts, the quotients are as long as the step, because longer quotients miss the
    minimum. If the motion is far from the counts, the quotients stay long, because stops that come and go would distort
    short quotients. If forces depend on the position, the quotients stay longer, to average over the motion's kinks.
    """
    if rms(error) > TUNING.output_error_hopeless * difference.explained:
        return TUNING.quotient_step
    least = TUNING.likelihood_quotient if difference.equation.place_matters else TUNING.least_quotient
    return np.asarray(np.clip(np.abs(step), least, TUNING.quotient_step))


def _damped_steps(
    difference: Difference, q: Floats, error: Floats, jacobian: Floats, dampings: Sequence[float]
) -> Floats:
    """Return the results (k, q) of Gauss-Newton steps with each of k dampings."""
    size = np.maximum(np.linalg.norm(jacobian, axis=0), TUNING.tiny)
    scaled = jacobian / size
    hessian, slope, above = scaled.T @ scaled, scaled.T @ error, q > difference.lower
    steps = [bounded_step(hessian + damping * np.eye(q.size), slope, above) / size for damping in dampings]
    return np.asarray(np.maximum(q - np.array(steps), difference.lower))


def try_steps(difference: Difference, q: Floats, trials: Floats) -> Floats:
    """Return the differences (k, n) at trials (k, q), infinite after an excessive step of a weak parameter."""
    near = np.max(np.abs(trials - q), axis=1) <= TUNING.longest_step
    found = np.full((len(trials), difference.rows), np.inf)
    if np.any(near):
        found[near] = difference.differences(trials[near])
    return found


def bounded_step(hessian: Floats, gradient: Floats, above: Flags) -> Floats:
    """Return the Newton step (q,) to subtract. A parameter that is not `above` its bound only moves away."""
    free = above | (gradient < 0)
    step, own, slope = np.zeros(gradient.size), hessian[np.ix_(free, free)], gradient[free]
    if slope.size > TUNING.dense_columns:
        from scipy.sparse import csc_array  # the import is slow, and only windows need it
        from scipy.sparse.linalg import splu

        with suppress(RuntimeError):  # raised for a singular matrix
            step[free] = splu(csc_array(own)).solve(slope)
            return step
    step[free] = np.linalg.lstsq(own, slope)[0]
    return step


def invert_information(sensitivity: Floats, names: tuple[str, ...]) -> Floats:
    """Return the inverse (p, p) of S^T S for sensitivities S (n, p). Raises NotIdentifiableError with the parameter's
    name if a column is zero or depends on the others."""
    with np.errstate(over="ignore"):  # a motion may run away after a wide step and then be infinitely sensitive
        parts, inverse = parts_of_their_own(sensitivity)
        size = np.linalg.norm(sensitivity, axis=0)
        sizes = np.outer(size, size)
    worst = int(np.argmin(parts))
    if not parts[worst] > TUNING.motion_apart:
        raise NotIdentifiableError(
            f"{names[worst]} has too little effect of its own on the position, because the excitation is "
            "poor; record reversals, and varying speeds and accelerations"
        )
    return np.asarray(inverse @ inverse.T / sizes)
