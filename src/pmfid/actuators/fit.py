"""Parameters of a servo out of a log of position commands: estimates, standard errors and findings."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pmfid.actuators.problem import ServoProblem
from pmfid.actuators.rivals import choose_likeliest, measure_load_gain
from pmfid.actuators.rounding import find_scatter, measure_cost, measure_independence, measure_persistence, sharpen
from pmfid.actuators.servo import PARTNERS, SIGNED, UNITS, Servo
from pmfid.actuators.standard_errors import standard_errors
from pmfid.actuators.starts import find_start
from pmfid.actuators.tuning import TUNING
from pmfid.actuators.waves import measure_wave
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.findings import Finding, codes, sort_findings, texts
from pmfid.presentation import Parameters, Presentable, Summary, plain_dict, remarks_of
from pmfid.types import Floats

#: Terms that a fit adds if the log shows them -> a small value, as a part of the typical torque, of a period, or for a
#: limit of the largest torque.
TRIALS: Mapping[str, float] = {
    **dict.fromkeys(["kd", "gravity", "offset", "stribeck", "load_friction", "quadratic"], 0.02),
    "loop_delay": 0.1,
    "torque_limit": 0.85,
}


@dataclass(frozen=True, repr=False)
class ServoFit(Presentable):
    """Parameters of a servo with standard errors.

    Attributes
    ----------
    servo : Servo
        The model, with all terms that were found.
    theta, theta_std : ndarray
        Estimates and standard errors (p,) in the units of `units`.
    simulated : ndarray
        Position (n,) [rad] of the model under the logged commands.
    residual : float
        Root mean square of the simulated minus the measured position [rad].
    limited : float
        Part of the time at which the torque is limited.
    added : tuple of str
        Terms that the log shows and the model did not name.
    findings : tuple of Finding
        Observations on the result, the most important first.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid.actuators import Servo, fit_servo
    >>> true = Servo(resolution=0.0015, given={"kp": 8.0})
    >>> t = np.arange(600) * 0.01
    >>> goal = 0.5 * np.sign(np.sin(2.1 * t)) + 0.2 * np.sin(7 * t)
    >>> position = true.simulate(np.array([0.01, 0.06, 0.05, 0.01]), t, goal, start=0.0)
    >>> fit = fit_servo(true, t, goal, np.round(position / 0.0015) * 0.0015)
    >>> fit.servo.unknown[0], abs(float(fit.theta[0]) - 0.01) < 1e-4
    ('inertia', True)
    """

    servo: Servo
    theta: Floats
    theta_std: Floats
    simulated: Floats
    residual: float
    limited: float
    added: tuple[str, ...]
    findings: tuple[Finding, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters (p,). Where torques are multiples of kp only, the names say so."""
        return tuple(
            f"{name}/kp" if self.servo.relative and UNITS[name][0] != UNITS[name][1] else name
            for name in self.servo.unknown
        )

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the parameters (p,)."""
        return self.servo.units

    @property
    def status(self) -> tuple[str, ...]:
        """Words of the status; empty if nothing was found."""
        return tuple(codes(finding for finding in self.findings if finding.severity != "note"))

    @cached_property
    def _parameters(self) -> Parameters:
        return Parameters(self.names, self.units, self.theta, self.theta_std)

    def summary(self) -> Summary:
        """Return the title, the table and the remarks of the result."""
        title = f"servo: deviation of the simulated motion {self.residual:.3g} rad (rms)"
        return self._parameters.summary(title, remarks_of(self.status, texts(self.findings)))

    def columns(self) -> Mapping[str, object]:
        """Return the columns of `to_frame`."""
        return self._parameters.columns

    def to_dict(self) -> dict[str, object]:
        """Return the result as text, numbers, lists and dicts."""
        content = {
            "parameters": self._parameters.content,
            "given": dict(self.servo.given),
            "residual": self.residual,
            "limited": self.limited,
            "added": list(self.added),
            "status": list(self.status),
            "findings": [finding.to_json() for finding in self.findings],
        }
        return plain_dict(content)


def fit_servo(
    servo: Servo, t: Floats, goal: Floats, position: Floats, *, force: Floats | None = None, search: bool = True
) -> ServoFit:
    """Estimate the parameters of a servo from its commands and positions.

    The closed loop is simulated under the commands, and least squares fit the simulated position to the measured one.
    The standard errors come from the scores of blocks of the record (Liang and Zeger 1986), so they hold for a
    correlated residual.

    Parameters
    ----------
    servo : Servo
        What is known.
    t, goal, position : array_like
        Times [s], commands [rad] and measured positions [rad], (n,). The steps of the time may vary.
    force : array_like, optional
        Known torque (n,) [N m] that the motor supplies in addition to the model, such as the gravity and coupling of a
        robot's other joints. The torque determines kp.
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
    columns = {"t": t, "goal": goal, "position": position, **({} if force is None else {"force": force})}
    times, goals, positions, *known = _check(servo, columns)
    servo = replace(servo, known_force=force is not None)
    problem = ServoProblem(servo, times, goals, positions, force=known[0] if known else None)
    z, added = find_start(problem), list[str]()
    head = problem.head()
    if search and head.t.size < TUNING.short_head * problem.t.size:  # most terms show in a part of a long log
        found, z, _, added = _search_terms(head, *head.refine(z))
        problem = replace(problem, servo=found.servo)
        z = problem.place_start(z, head)
    z, cost = problem.refine(z)
    if cost > 0.5 * float(np.square(problem.position - problem.position.mean()).sum()):
        raise NotIdentifiableError(
            "no servo model explains the motion: check that goal and position have the same joint, unit and sign"
        )
    if search:
        problem, z, cost, added = _search_terms(problem, z, cost, added)
        problem, z, cost, added = _drop_terms(problem, z, cost, added)
    problem, z = _sharpen(problem, z)
    std = standard_errors(problem, z)
    while unclear := _list_unclear(problem, z, std, added):
        problem, z = _sharpen(*_refine_narrower(problem, z, unclear[0])[:2])
        std, added = standard_errors(problem, z), [name for name in added if name != unclear[0]]
    return _conclude(problem, z, std, tuple(added))


def _search_terms(
    problem: ServoProblem, z: Floats, cost: float, added: Sequence[str] = ()
) -> tuple[ServoProblem, Floats, float, list[str]]:
    """Return the fit with all terms that the log shows, and their names after those of `added`."""
    names = list(added)
    while len(names) < TUNING.most_added:
        better = _add_term(problem, z, cost)
        if better is None:
            break
        problem, z, cost, name = better
        names.append(name)
        if name == "torque_limit" and _measure_doubt(problem, z) > TUNING.doubted:
            # The start without a limit was far off.
            fresh, less = problem.refine(find_start(problem))
            z, cost = (fresh, less) if less < cost else (z, cost)
    return problem, z, cost, names


def _measure_doubt(problem: ServoProblem, z: Floats) -> float:
    """Return the scatter over the least scatter of any model, if it persists between samples, and 0 if not."""
    deviation = problem.residual(z) / problem.servo.resolution
    return measure_persistence(deviation, find_scatter(deviation)) / TUNING.least_scatter


def _sharpen(problem: ServoProblem, z: Floats) -> tuple[ServoProblem, Floats]:
    """Return the likeliest estimate, and the problem with a loop on counts if these make the log much likelier."""
    z, counted = choose_likeliest(problem, sharpen(problem, z)), replace(problem, counted=True)
    if problem.is_contradicted(z):
        return problem, z
    places = [z + offset * (np.arange(z.size) == z.size - TUNING.nuisance) for offset in TUNING.places]
    found = sharpen(counted, min(places, key=lambda place: measure_cost(counted, place)))
    likelier = measure_cost(counted, found) < measure_cost(problem, z) - TUNING.counted_gain
    return (counted, found) if likelier else (problem, z)


def _check(servo: Servo, columns: Mapping[str, Floats]) -> list[Floats]:
    """Return the columns of a log as floats. Raises for columns that no fit can use."""
    found = {name: np.ascontiguousarray(values, dtype=float) for name, values in columns.items()}
    arrays = list(found.values())
    if any(values.ndim != 1 or values.size != arrays[0].size for values in arrays):
        raise UsageError(f"{', '.join(found)} must be one-dimensional and equally long: use the columns of one table")
    if arrays[0].size < TUNING.samples_each * (len(servo.unknown) + TUNING.nuisance):
        raise UsageError(f"{arrays[0].size} samples are too few for {len(servo.unknown)} parameters: use a longer log")
    for name, values in found.items():
        if not np.isfinite(values).all():
            raise UsageError(f"{name} is not finite in row {int(np.argmin(np.isfinite(values)))}: leave such rows out")
    if not (np.diff(arrays[0]) > 0).all():
        raise UsageError(f"t does not rise after row {int(np.argmin(np.diff(arrays[0]) > 0))}: sort the rows by time")
    if np.ptp(arrays[1]) < 3 * servo.resolution or np.ptp(arrays[2]) < 3 * servo.resolution:
        raise NotIdentifiableError("the servo hardly moves: send goals that move it by many encoder steps")
    if "force" in found and not found["force"].any():
        raise UsageError("the known force is zero: leave it out, or check its column")
    return arrays


# --- terms ------------------------------------------------------------------------------------------------------------


def _widen(problem: ServoProblem, z: Floats, name: str) -> tuple[ServoProblem, Floats]:
    """Return the problem with a further term, and coordinates with a small value of this term."""
    servo = replace(problem.servo, terms=(*problem.servo.terms, name))
    wider = replace(problem, servo=servo)
    now = problem.list_values(z)
    torque, small = problem.torque(now.get("kp")), TRIALS[name]
    fresh = {
        "loop_delay": small * problem.servo.loop_period * 10,
        "kd": small * torque / problem.speed,
        "load_friction": small,
        "quadratic": small * torque / problem.speed**2,
        "stribeck_speed": 0.2 * problem.speed,
        "gravity_angle": 0.0,
    }
    if name == "torque_limit":
        torques = problem.run(z)[1]
        fresh[name] = small * float(np.abs(torques).max())
    theta = np.array([now[word] if word in now else fresh.get(word, small * torque) for word in servo.unknown])
    return wider, np.append(wider.coordinates(theta)[: -TUNING.nuisance], z[-TUNING.nuisance :])


def _rank_terms(problem: ServoProblem, z: Floats, names: Sequence[str]) -> dict[str, float]:
    """Return the part of the squared residual that each term explains to first order, the largest first."""
    residual, base = problem.linearise(z)
    rest = residual - base @ np.linalg.lstsq(base, residual, rcond=None)[0]

    def explain(name: str) -> float:
        wider, start = _widen(problem, z, name)
        columns = [wider.residual(start) - residual]
        if name == "gravity" and "gravity_angle" in wider.servo.unknown:  # two angles a quarter of a turn apart
            turned = start.copy()
            turned[wider.servo.unknown.index("gravity_angle")] = np.pi / 2
            columns.append(wider.residual(turned) - residual)
        new = np.stack(columns, axis=1)
        new -= base @ np.linalg.lstsq(base, new, rcond=None)[0]
        explained = new @ np.linalg.lstsq(new, rest, rcond=None)[0]
        return float(explained @ explained) / float(residual @ residual)

    return dict(sorted(((name, explain(name)) for name in names), key=lambda pair: -pair[1]))


def _add_term(problem: ServoProblem, z: Floats, cost: float) -> tuple[ServoProblem, Floats, float, str] | None:
    """Return the fit with the term that explains most of the residual, or None if no term is significant."""
    servo = problem.servo
    partners = set(PARTNERS.values())
    open_terms = [
        name for name in TRIALS if name not in servo.unknown and name not in servo.given and name not in partners
    ]
    # Without a limit of the torque, kd and viscous friction differ by the loop's delay alone.
    if servo.relative and "kd" in open_terms and not servo.has("torque_limit"):
        open_terms.remove("kd")
    if not open_terms:
        return None
    ranked = _rank_terms(problem, z, open_terms)
    tried = list(ranked)[: TUNING.tried]
    if not problem.is_contradicted(z):
        tried = [name for name in tried[:1] if ranked[name] > TUNING.first_order * TUNING.explains]
    if not tried:
        return None
    found = [(*_refine_wider(problem, z, name), name) for name in tried]
    wider, start, _, name = min(found, key=lambda one: one[2])
    best, less = wider.refine(start)
    return (wider, best, less, name) if _is_worth(problem, z, less, cost) else None


def _refine_wider(problem: ServoProblem, z: Floats, name: str) -> tuple[ServoProblem, Floats, float]:
    wider, start = _widen(problem, z, name)
    return (wider, *wider.refine(start, rough=True))


def _is_worth(problem: ServoProblem, z: Floats, less: float, cost: float) -> bool:
    """Return whether a squared residual of `less` in place of `cost`, which is that of `z`, is worth a term."""
    residual = problem.residual(z)
    chance = min(TUNING.beyond**2 / (residual.size * measure_independence(residual)), TUNING.plain)
    return 1.0 - less / cost > max(TUNING.explains, chance)


def _drop_terms(
    problem: ServoProblem, z: Floats, cost: float, added: list[str]
) -> tuple[ServoProblem, Floats, float, list[str]]:
    """Return the fit without the terms that are not worth their place after later ones came."""
    for name in added[:-1]:
        narrow, found, more = _refine_narrower(problem, z, name, rough=True)
        if not _is_worth(narrow, found, cost, more):
            z, cost = narrow.refine(found)
            problem, added = narrow, [word for word in added if word != name]
    return problem, z, cost, added


def _refine_narrower(
    problem: ServoProblem, z: Floats, name: str, *, rough: bool = False
) -> tuple[ServoProblem, Floats, float]:
    """Return the problem without a term, the coordinates of its minimum, and the minimum [rad2]."""
    servo = replace(problem.servo, terms=tuple(word for word in problem.servo.terms if word != name))
    narrow = replace(problem, servo=servo)
    now = problem.list_values(z)
    start = narrow.coordinates(np.array([now[word] for word in servo.unknown]))
    return (narrow, *narrow.refine(np.append(start[: -TUNING.nuisance], z[-TUNING.nuisance :]), rough=rough))


def _list_unclear(problem: ServoProblem, z: Floats, std: Floats, added: Sequence[str]) -> list[str]:
    """Return the added terms that standard errors (p,) do not distinguish from zero, the least clear first."""
    errors = dict(zip(problem.servo.unknown, std.tolist(), strict=True))
    values = problem.list_values(z)
    clear = {name: abs(values[name]) / max(errors[name], 1e-300) for name in added}
    return sorted((name for name in added if not clear[name] > TUNING.clear), key=clear.__getitem__)


# --- findings ---


def _conclude(problem: ServoProblem, z: Floats, std: Floats, added: tuple[str, ...]) -> ServoFit:
    servo, residual, theta = problem.servo, problem.residual(z), problem.theta(z)
    limited = problem.run(z)[2]
    rms = float(np.sqrt(np.mean(residual**2)))
    doubt, advice = _measure_doubt(problem, z), advise_log(problem.t, problem.goal)
    findings = _find(servo, theta, std, rms, doubt, limited, added, advice)
    if not any(finding.code == "unmodelled" for finding in findings):
        findings += _find_hidden(problem, z, std)
    return ServoFit(servo, theta, std, residual + problem.position, rms, limited, added, tuple(sort_findings(findings)))


MORE_TERMS = "add a term to the model, or move one joint at a time"


def advise_log(t: Floats, goal: Floats) -> str:
    """Return the advice for a log with times t (n,) and goals (n,) whose motion the model does not follow.

    Stamps that jitter hide the inertia of a smooth motion in the delay. Even times are no stamps of readings.
    """
    steps, changes = np.diff(t), np.abs(np.diff(goal))
    even = np.ptp(steps) < TUNING.stamped * np.mean(steps)
    smooth = np.max(changes, initial=0.0) < TUNING.goal_step * np.ptp(goal)
    stamp, command = "stamp each sample when the position is read", "command steps as well"
    advice = [text for text, missing in ((stamp, even), (command, smooth)) if missing]
    return ", and ".join(advice) or MORE_TERMS


def _find(
    servo: Servo,
    theta: Floats,
    std: Floats,
    rms: float,
    doubt: float,
    limited: float,
    added: tuple[str, ...],
    advice: str,
) -> list[Finding]:
    findings, deviation = [], rms / servo.resolution
    if doubt > TUNING.doubted:
        more = doubt * TUNING.least_scatter
        sentence = f"in addition to rounding, the simulated motion deviates by {more:.2g} encoder steps for a while"
        findings.append(Finding("unmodelled", sentence, MORE_TERMS))
    elif deviation > TUNING.noisy / math.sqrt(12):
        sentence = f"the simulated motion deviates by {deviation:.1f} encoder steps (rms), more than rounding explains"
        findings.append(Finding("unmodelled", sentence, advice))
    unclear, zero = _open_parameters(servo, theta, std)
    if unclear:
        sentence = f"the log says too little on {', '.join(unclear)}"
        findings.append(
            Finding("poor_excitation", sentence, "send goals with steps and fast sines over the whole range")
        )
    if zero:
        findings.append(Finding("zero", f"the log does not distinguish {', '.join(zero)} from zero", severity="note"))
    if added:
        findings.append(
            Finding(
                "added", f"the log shows {', '.join(added)}; the fit estimates these terms as well", severity="note"
            )
        )
    if servo.relative:
        remedy = "give kp, a known inertia, or gravity = m g l"
        findings.append(Finding("relative", "torques are multiples of kp", remedy, "note"))
    if limited > TUNING.limited and servo.has("torque_limit"):
        sentence = f"the torque is limited during {100 * limited:.0f} % of the log"
        findings.append(Finding("saturated", sentence, "command smaller or slower steps"))
    return findings


def _find_hidden(problem: ServoProblem, z: Floats, std: Floats) -> list[Finding]:
    """Return findings on frictions and torques that rounding hides, but that move estimates."""
    moved, findings = measure_wave(problem, z, std), []
    if moved > TUNING.wave_moves:
        sentence = f"a torque that turns with the position is likely, and moves an estimate by {moved:.0f} std"
        findings.append(
            Finding("unmodelled", sentence, "check the known torque and its angle, or give kp in its place")
        )
    elif measure_load_gain(problem, z) > TUNING.rival_gain:
        sentence = "a friction in proportion to the load makes the log much likelier"
        findings.append(Finding("unmodelled", sentence, "name the term load_friction"))
    return findings


def _open_parameters(servo: Servo, theta: Floats, std: Floats) -> tuple[list[str], list[str]]:
    """Return the parameters that the log leaves open, and those among the optional ones that may be zero."""
    unclear: list[str] = []
    zero: list[str] = []
    for name, value, error in zip(servo.unknown, theta, std, strict=True):
        if name in SIGNED or name in ("delay", "loop_delay") or error < TUNING.open_from * abs(value):
            continue
        may_vanish = name in ("viscous", "coulomb", *TRIALS) and value <= 2 * error < math.inf
        (zero if may_vanish else unclear).append(name)
    return unclear, zero
