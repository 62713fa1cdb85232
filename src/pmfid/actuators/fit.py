"""Parameters of a servo out of logs of position commands: estimates, standard errors and findings."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pmfid.actuators.checks import find_stops
from pmfid.actuators.lags import LagFit, profile_lags
from pmfid.actuators.logs import JointLog
from pmfid.actuators.search import ServoSearch, ServoTask, limited_part
from pmfid.actuators.servo import SIGNED, UNITS, Servo
from pmfid.actuators.starts import FOLLOW, find_search
from pmfid.actuators.tuning import TUNING
from pmfid.actuators.values import read_parameters
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.findings import Finding, Judged, sort_findings, texts
from pmfid.fit.fit import Fitted, conclude
from pmfid.presentation import PresentableParameters, Summary, plain_dict, remarks_of
from pmfid.types import Floats

#: What to record instead, by the parameter that a log does not determine.
ADVICE: Mapping[str, str] = {
    "inertia": "command steps and fast sines, and stamp each sample when the position is read",
    "viscous": "command sweeps at several speeds over the whole range",
    "coulomb": "command slow reversals",
    "delay": "command steps",
    "kd": "record the servo at two gains, or give kd by the firmware",
    "velocity_filter": "give velocity_filter by the firmware",
    "loop_delay": "give loop_delay by the firmware",
    "gravity": "let the joint turn through a large angle about the horizontal",
    "gravity_angle": "let the joint turn through a large angle about the horizontal",
    "load_friction": "move a load up and down",
    "load_stribeck": "move a load up and down slowly",
    "motor_friction": "move a load up and down",
    "motor_stribeck": "move a load up and down slowly",
    "torque_limit": "command large steps",
    "ki": "command steps and wait after each of them",
}
STAMP = "stamp each sample when the position is read"
PER_LOG = "give --per-log kp if the gain differed, or fit each log alone"
MORE_TERMS = "add a term to the model, or move one joint at a time"


@dataclass(frozen=True, repr=False)
class ServoFit(PresentableParameters, Judged):
    """Parameters of a servo with standard errors.

    Attributes
    ----------
    servo : Servo
        What was known before the fit.
    raw_names : tuple of str
        Parameters (p,), with all terms that were found. A parameter of one log has the number of the log after a point.
    theta, theta_std : ndarray
        Estimates and standard errors (p,) in the units of `units`.
    simulated : tuple of ndarray
        Position [rad] of the model under the commands of each log, as far as the fit used it.
    residual : float
        Root mean square of the simulated minus the measured position [rad].
    limited : float
        Part of the time at which the torque is limited.
    added : tuple of str
        Terms that the logs show and the model did not name.
    findings : tuple of Finding
        Observations on the result, the most important first.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid.actuators import Servo, fit_servo, simulate_servo
    >>> true = Servo(resolution=0.0015, given={"kp": 8.0, "kd": 0.0})
    >>> t = np.arange(600) * 0.01
    >>> goal = 0.5 * np.sign(np.sin(2.1 * t)) + 0.2 * np.sin(7 * t)
    >>> position = simulate_servo(true, np.array([0.01, 0.06, 0.05, 0.01]), t, goal, start=0.0)
    >>> fit = fit_servo(true, t, goal, np.round(position / 0.0015) * 0.0015)
    >>> fit.names[0], abs(float(fit.theta[0]) - 0.01) < 2e-4
    ('inertia', True)
    """

    servo: Servo
    raw_names: tuple[str, ...]
    theta: Floats
    theta_std: Floats
    simulated: tuple[Floats, ...]
    residual: float
    limited: float
    added: tuple[str, ...]
    findings: tuple[Finding, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters (p,). Where torques are multiples of kp only, the names say so."""
        return tuple(
            f"{name}/kp" if self.servo.relative and _unit(name, False) != _unit(name, True) else name
            for name in self.raw_names
        )

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the parameters (p,)."""
        return tuple(_unit(name, self.servo.relative) for name in self.raw_names)

    @property
    def open(self) -> tuple[str, ...]:
        """Raw names of the parameters that the logs do not determine."""
        return tuple(
            name
            for name, value, std in zip(self.raw_names, self.theta.tolist(), self.theta_std.tolist(), strict=True)
            if name not in SIGNED and not std < TUNING.open * abs(value)
        )

    @property
    def values(self) -> dict[str, float]:
        """The parameters that the logs determine, by raw name, and the given ones."""
        found = dict(zip(self.raw_names, self.theta.tolist(), strict=True))
        return {**self.servo.given, **{name: value for name, value in found.items() if name not in self.open}}

    def summary(self) -> Summary:
        """Return the title, the table and the remarks of the result."""
        title = f"servo: deviation of the simulated motion {self.residual:.3g} rad (rms)"
        return self._parameters.summary(title, remarks_of(self.status, texts(self.findings)))

    def to_dict(self) -> dict[str, object]:
        """Return the result as text, numbers, lists and dicts."""
        content = {
            "parameters": self._parameters.content,
            "not_determined": list(self.open),
            "given": dict(self.servo.given),
            "residual": self.residual,
            "limited": self.limited,
            "added": list(self.added),
            "status": list(self.status),
            "findings": [finding.to_json() for finding in self.findings],
        }
        return plain_dict(content)


#: Units of terms that no user can name, and their units over that of `kp`.
FOUND_UNITS: Mapping[str, tuple[str, str]] = {
    "viscous_difference": ("N m s/rad", "s"),
    "cogging": ("N m", "rad"),
    "friction_period": ("N m", "rad"),
}


def _unit(name: str, relative: bool) -> str:
    return ({**UNITS, **FOUND_UNITS}[name.partition(".")[0]])[relative]


def fit_servo(
    servo: Servo,
    t: Floats,
    goal: Floats,
    position: Floats,
    *,
    force: Floats | None = None,
    on: Floats | None = None,
    search: bool = True,
) -> ServoFit:
    """Estimate the parameters of a servo from its commands and positions.

    The closed loop is simulated under the commands by the fit of machines (`pmfid.fit`). The standard errors come from
    the scores of blocks of the log (Huber 1967), and from the spread over the models that the log does not exclude.

    Parameters
    ----------
    servo : Servo
        What is known.
    t, goal, position : array_like
        Times [s], commands [rad] and measured positions [rad], (n,). The steps of the time may vary.
    force : array_like, optional
        Known torque (n,) [N m] that the motor supplies in addition to the model, such as the gravity and coupling of a
        robot's other joints. The torque determines kp.
    on : array_like, optional
        0 (n,) where the torque is off, so that the joint moves freely.
    search : bool
        Whether terms that the log shows are added to the model.

    Returns
    -------
    ServoFit
        Estimates, standard errors and findings.

    Raises
    ------
    UsageError
        If the arrays differ in length, are not finite, or if the time does not rise.
    NotIdentifiableError
        If the servo does not move, or if no simulated motion follows the measured one.

    Examples
    --------
    See `ServoFit`.
    """
    columns = {"t": t, "goal": goal, "position": position, "force": force, "on": on}
    arrays = {name: np.ascontiguousarray(one, dtype=float) for name, one in columns.items() if one is not None}
    return fit_logs(servo, [JointLog("joint", resolution=servo.resolution, **arrays)], search=search)  # type: ignore[arg-type]


def fit_logs(servo: Servo, logs: Sequence[JointLog], per_log: Sequence[str] = (), *, search: bool = True) -> ServoFit:
    """Estimate the parameters of a servo from several logs at once.

    All parameters are shared but those in `per_log`, which each log has its own of. Raises as `fit_servo` does.
    """
    for log in logs:
        _check(servo, log)
    unknown = [name for name in per_log if name not in servo.unknown or name == "inertia"]
    if unknown:
        raise UsageError(
            f"{unknown[0]} cannot differ by log: name one of "
            f"{', '.join(name for name in servo.unknown if name != 'inertia')}, and do not give its value"
        )
    servo = replace(servo, known_force=any(log.force is not None for log in logs))
    used = [_cut_long(log) for log in logs]
    task = ServoTask(servo, used, tuple(per_log) if len(logs) > 1 else (), early=1)
    with np.errstate(all="ignore"):  # motions far from the log may overflow
        found = find_search(task, search)
        if found.is_early:  # a bus that lags its rows by more than one
            found = find_search(replace(task, early=4), search)
        lags = profile_lags(found) if found.kept else []
        found = max(lags, key=lambda at: at.value).search if lags else found
        try:
            fit = _conclude(found, conclude(found, found.noise), lags)
        except NotIdentifiableError as error:  # in words of a machine with an input
            raise NotIdentifiableError(FOLLOW) from error
    if all(one is log for one, log in zip(used, logs, strict=True)):
        return fit
    sentence = f"the fit uses the first {TUNING.longest:.0f} s of each log"
    return replace(fit, findings=(*fit.findings, Finding("cut", sentence, severity="note")))


def _cut_long(log: JointLog) -> JointLog:
    """Return the first part of a long log, because more would only take more time."""
    last = int(np.searchsorted(log.t, log.t[0] + TUNING.longest, side="right"))
    return log if last == log.t.size else log.cut(slice(last))


def _check(servo: Servo, log: JointLog) -> None:
    """Raise for columns that no fit can use."""
    columns = {"t": log.t, "goal": log.goal, "position": log.position, "force": log.force, "on": log.on}
    found = {name: values for name, values in columns.items() if values is not None}
    if any(values.ndim != 1 or values.size != log.t.size for values in found.values()):
        raise UsageError(f"{', '.join(found)} must be one-dimensional and equally long: use the columns of one table")
    if log.t.size < TUNING.samples_each * (len(servo.unknown) + 2):
        raise UsageError(f"{log.t.size} samples are too few for {len(servo.unknown)} parameters: use a longer log")
    for name, values in found.items():
        if not np.isfinite(values).all():
            raise UsageError(f"{name} is not finite in row {int(np.argmin(np.isfinite(values)))}: leave such rows out")
    if not (np.diff(log.t) > 0).all():
        raise UsageError(f"t does not rise after row {int(np.argmin(np.diff(log.t) > 0))}: sort the rows by time")
    if np.ptp(log.position) < 3 * servo.resolution or (log.on is None and np.ptp(log.goal) < 3 * servo.resolution):
        raise NotIdentifiableError("the servo hardly moves: send goals that move it by many encoder steps")
    if log.force is not None and not log.force.any():
        raise UsageError("the known force is zero: leave it out, or check its column")


# --- values -----------------------------------------------------------------------------------------------------------


def _conclude(search: ServoSearch, fitted: Fitted, lags: Sequence[LagFit]) -> ServoFit:
    names, theta, std = read_parameters(search, fitted, lags)
    rms = search.plain.resolution * float(np.sqrt(np.mean(np.concatenate(fitted.residuals) ** 2)))
    servo = search.task.servo
    added = tuple(dict.fromkeys(name for name in names if name.partition(".")[0] not in servo.unknown))
    limited = limited_part(fitted.problem, fitted.solution.q, fitted.solution.starts)
    fit = ServoFit(servo, names, theta, std, _simulate(search, fitted), rms, limited, added, ())
    return replace(fit, findings=tuple(sort_findings(_find(fit, search, fitted))))


def _simulate(search: ServoSearch, fitted: Fitted) -> tuple[Floats, ...]:
    """Return the simulated position [rad] of each log. Rows in no stretch have the measured one."""
    moved = iter(fitted.problem.motion(fitted.solution.q, fitted.solution.starts))
    found: list[Floats] = [log.position.copy() for log in search.task.logs]
    number = -1
    for stretch, (y, _) in zip(fitted.problem.stretches, moved, strict=True):
        number += stretch.first == 0 or number < 0
        found[min(number, len(found) - 1)][stretch.first : stretch.first + y.size] = y
    return tuple(found)


# --- findings ---------------------------------------------------------------------------------------------------------


def advise_log(t: Floats, goal: Floats) -> str:
    """Return the advice for a log with times t (n,) and goals (n,) whose motion the model does not follow.

    Stamps that jitter hide the inertia of a smooth motion in the delay. Even times are no stamps of readings.
    """
    steps, changes = np.diff(t), np.abs(np.diff(goal))
    even = np.ptp(steps) < 1e-3 * np.mean(steps)
    smooth = np.max(changes, initial=0.0) < 0.1 * np.ptp(goal)
    advice = [text for text, missing in ((STAMP, even), ("command steps as well", smooth)) if missing]
    return ", and ".join(advice) or MORE_TERMS


def _find(fit: ServoFit, search: ServoSearch, fitted: Fitted) -> list[Finding]:
    findings, servo = [], fit.servo
    words = _doubt_motion(fit.residual / search.plain.resolution, search.noise.position[0])
    if words:
        log = search.task.logs[0]
        sentence = f"the simulated motion {words}; the standard errors include it"
        shared = len(search.task.logs) > 1 and not search.task.per_log and "kp" in servo.unknown
        advice = PER_LOG if shared else advise_log(log.t, log.goal)
        findings.append(Finding("unmodelled", sentence, advice))
    findings += _find_stamps(fit, search.stamps)
    stopped = sum(int(np.sum(find_stops(log))) for log in search.task.logs)
    if stopped:
        findings.append(Finding("stops", f"{stopped} rows at a stop of the joint are left out", severity="note"))
    unclear = [name for name in fit.open if name not in fit.added]
    if unclear:
        sentence = f"not determined by this log: {', '.join(unclear)}"
        hard = {"inertia", "kp"} & {*unclear}
        kind = () if hard else ("note",)
        findings.append(Finding("poor_excitation" if hard else "not_determined", sentence, _advise(unclear), *kind))
    if fit.added:
        shown = ", ".join(fit.added[:4]) + (f" and {len(fit.added) - 4} more" if len(fit.added) > 4 else "")
        sentence = f"the log shows {shown}; the fit estimates these terms as well"
        findings.append(Finding("added", sentence, severity="note"))
    if fitted.rival:
        wide = fitted.half / TUNING.normal > 2 * np.sqrt(np.diag(fitted.covariance))
        if np.any(wide):
            sentence = f"the log does not exclude {fitted.rival}, and the standard errors include it"
            findings.append(
                Finding("model_spread", sentence, "name the term, or give its value if you know it", "note")
            )
    if servo.relative:
        remedy = "give kp, the inertia, or gravity (m g l), as in --given kp=8"
        findings.append(Finding("relative", "torques are multiples of kp", remedy, "note"))
    if fit.limited > TUNING.limited:
        sentence = f"the torque is limited during {100 * fit.limited:.0f} % of the log"
        findings.append(Finding("saturated", sentence, "command smaller or slower steps"))
    return findings


def _find_stamps(fit: ServoFit, error: float) -> Iterator[Finding]:
    """Yield what a log that polls its bus shows: goals that act before their stamps, and an `error` of stamps [s]."""
    if error > 0:
        sentence = f"the readings differ from their stamps by {1e3 * error:.1f} ms (rms)"
        yield Finding("stamps", sentence, STAMP, "note")
    delays = [name.partition(".")[0] == "delay" for name in fit.raw_names]
    early = -fit.theta[delays & (fit.theta < -TUNING.normal * fit.theta_std)]
    if early.size:
        sentence = f"the goals act {1e3 * max(early):.1f} ms before their stamps"
        yield Finding("early_goals", sentence, "stamp a goal when it is sent", "note")


def _doubt_motion(deviation: float, wander: float) -> str:
    """Return what no rounding explains of a deviation and its wandering part [counts], or nothing.

    A wander of the maximum likelihood may be larger than what exceeds the rounding.
    """
    wander = min(wander, math.sqrt(max(deviation**2 - 1 / 12, 0.0)))
    if deviation > TUNING.noisy / math.sqrt(12):
        return f"deviates by {deviation:.1f} encoder steps (rms), more than rounding explains"
    if wander > TUNING.wander / math.sqrt(12):
        return f"leaves an error of {wander:.2f} encoder steps (rms) that wanders, as no rounding does"
    return ""


def _advise(names: Sequence[str]) -> str:
    advice = dict.fromkeys(ADVICE.get(name.partition(".")[0], "send goals with steps and fast sines") for name in names)
    return "; ".join(list(advice)[:2])
