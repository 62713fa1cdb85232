"""One log of a servo as a problem of least squares: coordinates, residuals and their derivatives."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pmfid.actuators.servo import SIGNED, Servo
from pmfid.actuators.tuning import TUNING
from pmfid.types import Floats


@dataclass(frozen=True)
class ServoProblem:
    """The residuals of a servo on a log. `t`, `goal` and `position` (n,) are in s and rad, `force` (n,) in N m.

    Coordinates z (p + 2,) are the logarithms of positive parameters, signed parameters over their scale, the start
    position over the encoder's step, and the start velocity over `speed`. A loop that is `counted` sees the position in
    steps of the encoder, which start at zero. The loop ticks `phase` periods after a sample.
    """

    servo: Servo
    t: Floats
    goal: Floats
    position: Floats
    counted: bool = False
    phase: float = 0.0
    force: Floats | None = None

    @cached_property
    def positive(self) -> np.ndarray:
        """Whether each parameter is positive (p,)."""
        return np.array([name not in SIGNED for name in self.servo.unknown])

    @cached_property
    def scale(self) -> Floats:
        """Unit of each coordinate of a signed parameter (p,)."""
        return np.array([self.torque() if name == "offset" else 1.0 for name in self.servo.unknown])

    @cached_property
    def _longest(self) -> Floats:
        """Longest step of each coordinate (p + 2,) in a refinement."""
        return np.append(np.where(self.positive, TUNING.longest_step, np.inf), np.full(TUNING.nuisance, np.inf))

    def torque(self, gain: float | None = None) -> float:
        """Typical torque [N m] at a gain [N m/rad]; None is the given one, or 1."""
        gain = self.servo.given.get("kp", 1.0) if gain is None else gain
        return gain * max(self.lag, self.servo.resolution)

    @cached_property
    def lag(self) -> float:
        """Typical distance of the position from the goal [rad]."""
        return float(np.std(self.goal - self.position))

    @cached_property
    def speed(self) -> float:
        """Typical speed [rad/s]."""
        return max(
            float(np.std(np.diff(self.position) / np.diff(self.t))), self.servo.resolution / float(np.ptp(self.t))
        )

    def theta(self, z: Floats) -> Floats:
        """Parameters (p,) at coordinates (p + 2,)."""
        own = z[: -TUNING.nuisance]
        return np.where(self.positive, np.exp(np.clip(own, -60.0, 60.0)), own * self.scale)

    def list_values(self, z: Floats) -> dict[str, float]:
        """Unknown parameters by name at coordinates (p + 2,)."""
        return dict(zip(self.servo.unknown, self.theta(z).tolist(), strict=True))

    def coordinates(self, theta: Floats, start: float = 0.0, velocity: float = 0.0) -> Floats:
        """Coordinates (p + 2,) of parameters (p,)."""
        own = np.where(self.positive, np.log(np.maximum(theta, 1e-26)), theta / self.scale)
        return np.append(own, [start / self.servo.resolution, velocity / self.speed])

    def simulate(self, z: Floats) -> Floats:
        """Simulated position (n,) [rad]."""
        start, velocity = self._begin(z)
        if not self.phase:
            return self.servo.simulate(
                self.theta(z), self.t, self.goal, start, velocity, quantised=self.counted, force=self.force
            )
        from scipy.interpolate import CubicSpline  # slow to import

        servo, theta = self._start_earlier(self.theta(z))
        ticks, goal = self._ticks
        force = None if self.force is None else np.interp(ticks, self.t, self.force)
        moved = servo.simulate(theta, ticks, goal, start, velocity, quantised=self.counted, force=force)
        return np.asarray(CubicSpline(ticks, moved)(self.t))

    def run(self, z: Floats) -> tuple[Floats, Floats, float]:
        """Return position (n,) [rad], torque (n,) [N m], and the part of the time at which the torque is limited."""
        return self.servo.run(self.theta(z), self.t, self.goal, *self._begin(z), force=self.force)

    def _begin(self, z: Floats) -> tuple[float, float]:
        """Return the start position [rad] and velocity [rad/s]."""
        return float(self.position[0]) + float(z[-2]) * self.servo.resolution, float(z[-1]) * self.speed

    @cached_property
    def _ticks(self) -> tuple[Floats, Floats]:
        """Times (m,) [s] of the loop's ticks, and the goal (m,) [rad] at each."""
        period = self.servo.loop_period
        ticks = np.arange(self.t[0] + (self.phase - 1) * period, self.t[-1] + period, period)
        rows = np.searchsorted(self.t, ticks + 1e-9 * period, side="right") - 1
        return ticks, np.ascontiguousarray(self.goal[np.maximum(rows, 0)])

    def _start_earlier(self, theta: Floats) -> tuple[Servo, Floats]:
        """Return the servo and its parameters (p,) without the time in which a goal waits for the first tick."""
        wait, servo, theta = self.phase * self.servo.loop_period, self.servo, theta.copy()
        if "delay" in servo.given:
            return replace(servo, given={**servo.given, "delay": max(servo.given["delay"] - wait, 0.0)}), theta
        index = servo.unknown.index("delay")
        theta[index] = max(theta[index] - wait, 0.0)
        return servo, theta

    def residual(self, z: Floats) -> Floats:
        """Simulated minus measured position (n,) [rad]. The residual is finite for all coordinates."""
        return _bound(self.simulate(z) - self.position)

    def is_contradicted(self, z: Floats) -> bool:
        """Whether the squared residual at coordinates (p + 2,) is more than rounding explains."""
        return float(np.mean(self.residual(z) ** 2)) > (TUNING.contradicted * self.servo.resolution) ** 2 / 12

    def linearise(self, z: Floats) -> tuple[Floats, Floats]:
        """Residual (n,) [rad] and its derivatives (n, p + 2) by the coordinates.

        They are those of a loop that ticks at the samples and is not counted, because counts have no derivatives.
        """
        start, velocity = self._begin(z)
        theta = self.theta(z)
        moved, slopes = self.servo.differentiate(theta, self.t, self.goal, start, velocity, self.force)
        units = np.append(np.where(self.positive, theta, self.scale), [self.servo.resolution, self.speed])
        return _bound(moved - self.position), np.clip(np.nan_to_num(slopes, posinf=0.0, neginf=0.0) * units, -1e9, 1e9)

    def refine(self, z: Floats, *, rough: bool = False) -> tuple[Floats, float]:
        """Coordinates of a local minimum of the squared residual from `z` on, and this minimum [rad2].

        The steps are those of Levenberg and Marquardt. A rough refinement takes a few steps.
        """
        (residual, slope), damping = self.linearise(z), TUNING.damping
        for _ in range(TUNING.first_evaluations if rough else TUNING.evaluations):
            step = np.clip(_solve_damped(slope, residual, damping), -self._longest, self._longest)
            moved = self.linearise(z + step)
            gain = 1 - float(moved[0] @ moved[0]) / max(float(residual @ residual), 1e-300)
            if gain > 0:
                z, (residual, slope), damping = z + step, moved, damping / 10
                if gain < TUNING.least_gain:
                    break
            elif damping > TUNING.most_damping:
                break
            else:
                damping *= 10
        return z, float(residual @ residual)

    def head(self) -> ServoProblem:
        """The part of the log on which starts are compared, from shortly before the first motion on."""
        moving = np.flatnonzero(np.abs(self.goal - self.goal[0]) > 3 * self.servo.resolution)
        first = float(self.t[moving[0]]) - 0.2 if moving.size else float(self.t[0])
        use = (self.t >= first) & (self.t <= first + TUNING.start_time)
        t, goal, position = (np.ascontiguousarray(part[use]) for part in (self.t, self.goal, self.position))
        force = None if self.force is None else np.ascontiguousarray(self.force[use])
        return ServoProblem(self.servo, t, goal, position, force=force)

    def place_start(self, z: Floats, head: ServoProblem) -> Floats:
        """Coordinates (p + 2,) of this log, from those of its first part."""
        start = z[-TUNING.nuisance :] if head.t[0] == self.t[0] else np.zeros(TUNING.nuisance)
        return np.append(z[: -TUNING.nuisance], start)


def _bound(residual: Floats) -> Floats:
    """Return the residual (n,) [rad] with finite values."""
    found = np.clip(residual, -1e6, 1e6)
    return found if np.isfinite(found.sum()) else np.nan_to_num(found, nan=1e6)


def _solve_damped(slope: Floats, residual: Floats, damping: float) -> Floats:
    """Return the damped step (q,) of a least squares problem with derivatives (n, q)."""
    size = np.maximum(np.linalg.norm(slope, axis=0), 1e-300)
    scaled = slope / size
    return np.asarray(np.linalg.solve(scaled.T @ scaled + damping * np.eye(size.size), -scaled.T @ residual) / size)
