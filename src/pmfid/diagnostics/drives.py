"""Flags of an estimate of a drive."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.diagnostics.tuning import TUNING
from pmfid.errors import NotIdentifiableError
from pmfid.estimators.adequacy import Adequacy, examine, force_moves
from pmfid.estimators.base import Estimator, Simulating
from pmfid.estimators.configuration import hold_last_input, like
from pmfid.estimators.cutoff import choose_prefilter_zeros
from pmfid.estimators.iv import IV, RIV
from pmfid.estimators.likelihood import climb, cost
from pmfid.estimators.ls import BCLS, LS
from pmfid.estimators.motion import Difference, least, rms
from pmfid.estimators.output_error import OE, Following
from pmfid.estimators.recursive import RLS
from pmfid.estimators.tuning import TUNING as ESTIMATOR_TUNING
from pmfid.findings import Finding, codes, sort_findings
from pmfid.models.equation import DEAD_TIME, ESTIMATE, LAG, LATE, OFFSET, Equation
from pmfid.status import Status
from pmfid.types import Counts, Floats

#: Result of the examination of a model: its adequacy, the error if no motion of the model follows, or None before the
#: examination.
Examined = Adequacy | NotIdentifiableError | None


def counts_per_sample(counts: Counts) -> float:
    """Return the mean change per sample between the first and the last change of the counts, or 0 without motion."""
    change = np.abs(np.diff(counts))
    moving = np.flatnonzero(change)
    if moving.size == 0:
        return 0.0
    return float(change[moving[0] : moving[-1] + 1].mean())


def count_jump(counts: Counts) -> str:
    """Describe one change of the counts (n,) that is far larger than all others, or return an empty text.

    The cause is a counter that wraps or a lost position.
    """
    change = np.abs(np.diff(counts))
    worst = int(np.argmax(change))
    usual = float(np.quantile(_motion(counts, change), 0.99))
    if not change[worst] > TUNING.drives_jump * (usual + 1):
        return ""
    return f"the counts jump by {change[worst]} at row {worst + 2}, elsewhere by at most {usual:.3g}"


#: Remedy for a jump of the counts.
JUMP_REMEDY = "give [encoder] bits if the counter wraps, or max_speed if counts were lost"


def _motion(counts: Counts, change: Counts) -> Counts:
    """Return the sizes (n - 1,) of the changes of the counts (n,) without wrong readings.

    A wrong reading returns at once to the old position. A few wrong readings among a hundred samples would distort the
    usual change.
    """
    if change.size < 2:
        return change
    across = np.abs(counts[2:] - counts[:-2])
    return np.asarray(np.r_[np.minimum(np.minimum(change[:-1], change[1:]), across), change[-1:]])


#: Difference between two doubled log-likelihoods below which they are alike.
ALIKE = ESTIMATOR_TUNING.adequacy_missed**2
#: Options of a model that delay the input.
OPTIONS = (DEAD_TIME, LAG)


@dataclass(frozen=True)
class Lateness:
    """A delay of the input that explains the counts better than the model does.

    `times` [s] have the names of the model's options. `gain` is the gain of the doubled log-likelihood. `follows` says
    whether the motion with the delay explains the counts.
    """

    times: Mapping[str, float]
    gain: float
    follows: bool


def lateness(found: Adequacy) -> list[Lateness]:
    """Return the delays under which the motion explains the counts clearly better than the model, best first.

    A second delay follows only if it is equally likely or has fewer unknowns.
    """
    ways: list[Lateness] = []
    for equation in _others(found.difference.equation):
        way = _fit_equation(found, equation)
        if way is not None and way.gain > ALIKE:
            ways.append(way)
        elif found.difference.equation.at_once == found.difference.equation:
            return []  # to first order, a dead time and a lag are alike
    clear = sorted(ways, key=lambda way: -way.gain)
    simple = [way for way in clear if len(way.times) == 1]
    if simple and clear[0].gain - simple[0].gain < ALIKE:
        return simple
    return clear


def _others(equation: Equation) -> Iterator[Equation]:
    dead = equation.replace_lag(0.0).replace_dead_time(ESTIMATE)
    lag = equation.replace_dead_time(0.0).replace_lag(ESTIMATE)
    there = (bool(equation.dead_time), bool(equation.lag))
    if there != (True, False) or equation.dead_time != ESTIMATE:
        yield dead
    if there != (False, True) or equation.lag != ESTIMATE:
        yield lag
    if any(there):
        yield dead.replace_lag(ESTIMATE)


def _fit_equation(found: Adequacy, equation: Equation) -> Lateness | None:
    """Fit another equation, starting from the model's fit.

    The result is None if the equation has no fit or its fit has no delay.
    """
    difference, start = _prepare_fit(found, equation)
    try:
        q = least(difference, start)
    except NotIdentifiableError:
        return None
    cost_there = None
    if found.noise is not None and rms(difference(q)) <= difference.explained:
        cost_there, q, _ = climb(difference, q, None)  # a local maximum suffices if it is better than the model
    values = dict(zip(_names(equation), q * difference.scale, strict=False))
    times = {name: float(values[name]) for name in OPTIONS if name in values}
    late = all(time > 0 for time in times.values())
    size = rms(difference(q))
    gain, follows = _gain(found, size, cost_there), size <= difference.explained
    return Lateness(times, gain, follows) if late else None


def _names(equation: Equation) -> tuple[str, ...]:
    """Return the names of all entries of theta."""
    return (*equation.names, *dict(equation.further))


def _prepare_fit(found: Adequacy, equation: Equation) -> tuple[Difference, Floats]:
    """Return the difference of another equation and its start values q (q,).

    The start values are the parameters of the model, except for the delay of the input.
    """
    own, q = found.difference, found.q
    values, sizes = (dict(zip(_names(own.equation), numbers, strict=False)) for numbers in (q * own.scale, own.scale))
    asked = [name for name in _names(equation) if name in OPTIONS]
    for name in asked:
        values[name], sizes[name] = _late_by(found) / len(asked), own.dt
    scale, theta = (np.array([numbers[name] for name in _names(equation)]) for numbers in (sizes, values))
    difference = own.replace_equation(equation, scale).fine_at(theta)
    return difference, np.r_[theta / scale, q[own.parameters :]]


def _late_by(found: Adequacy) -> float:
    """Return the mean delay [s] of the input as a start value."""
    own = found.difference
    theta = found.q * own.scale
    known = own.equation.known_at(theta[len(own.equation.names) : -2])
    return float(known.role_values(theta)[LATE] + float(known.lag)) or found.dead_time or own.dt / 2


def _gain(found: Adequacy, size: float, cost_there: float | None) -> float:
    """Return how much another fit increases the doubled log-likelihood.

    `size` is the root mean square difference of the other fit. `cost_there` is the negative log-likelihood of the other
    fit, if both fits are within the counts.
    """
    error = found.difference(found.q)
    if found.noise is None or cost_there is None:
        return 2 * error.size * math.log(rms(error) / size)
    return 2 * (cost(error, found.noise)[0] - cost_there)


#: Words for the delays in messages.
CALLED = {DEAD_TIME: "dead time", LAG: "first-order lag"}


def late(found: Adequacy) -> Iterator[Finding]:
    """Yield findings on a model that is not adequate if the counts ask for a delayed input or another kind of delay."""
    equation, dt = found.difference.equation, found.difference.dt
    ways = _ways(found)
    if ways:
        sentence = f"a {_describe_delay(ways[0], dt)} explains the counts better"
        remedy = f"set {_cure(ways[0], equation)} in [model]"
        yield Finding("dead_time", sentence, remedy, detail=_compare_ways(ways, dt))


def _ways(found: Adequacy) -> list[Lateness]:
    """Return the possible delays of the input.

    If the scores do not name a delay and the model has none, the delay must explain more than any force that the scores
    name.
    """
    equation = found.difference.equation
    if found.dead_time is not None:
        return lateness(found) or [Lateness({DEAD_TIME: found.dead_time}, 0.0, False)]
    if equation.at_once != equation:
        return lateness(found)
    most, least = (
        max((float(found.gain[k]) for k in found.missed), default=0.0),
        TUNING.drives_least * found.difference.dt,
    )
    large = [way for way in lateness(found) if way.gain > most and sum(way.times.values()) > least]
    return [way for way in large if found.follows or way.follows]


def _compare_ways(ways: list[Lateness], dt: float) -> str:
    if len(ways) == 1:
        return ""
    alike = "explains them nearly as well" if ways[0].gain - ways[1].gain < ALIKE else "explains them less"
    return f"A {_describe_delay(ways[1], dt)} {alike}."


def _describe_delay(way: Lateness, dt: float) -> str:
    """Describe the delay in samples of dt [s]."""
    return " and a ".join(f"{CALLED[name]} of about {time / dt:.2g} samples" for name, time in way.times.items())


def _cure(way: Lateness, equation: Equation) -> str:
    """Return the keys for [model] that add the delay and remove the present one."""
    given = {DEAD_TIME: equation.dead_time, LAG: equation.lag}
    dropped = [f"{name} = 0" for name, value in given.items() if value and name not in way.times]
    return " and ".join([f'{name} = "{ESTIMATE}"' for name in way.times] + dropped)


#: Message for a model that the counts contradict.
UNMODELLED = "an unmodelled effect"
#: Message for a least-squares result that no other method confirms.
NOISE_SEEN = "the result of least squares may be the encoder's noise, because no other method confirms it"
NOISE_REMEDY = "move the axis more, or use a finer encoder"


def _describe_misfit(found: Adequacy) -> Finding:
    """Return the finding on a model that the counts contradict, with the best single force and a remedy."""
    said = found.described
    sentence = f"{UNMODELLED}: {said[0]}" if said else f"{UNMODELLED}, which no single force explains"
    others = f" Another possible cause is {' or '.join(said[1:])}." if said[1:] else ""
    detail = (
        f"The cause may also be a similar force, or a parameter that changes.{others} The standard errors do not "
        "cover this effect."
    )
    return Finding("unmodelled", sentence, found.cure or "search for the missing term with pmfid terms", detail=detail)


def judge(
    estimator: Estimator,
    u: NDArray[np.float64],
    counts: NDArray[np.int64],
    theta: NDArray[np.float64],
    std: NDArray[np.float64],
    adequacy: Examined = None,
) -> tuple[Finding, ...]:
    """Return the findings on an estimate theta (p,) with standard deviations std (p,) from u (n,) and counts (n,).

    - implausible: a mass or friction is negative.
    - uncertain: a parameter is not known to half of its value.
    - biased: the method's own error exceeds its standard error and 2 %.
    - std_too_small: the method's own error exceeds its standard error.
    - unmodelled: the counts show an unmodelled effect.
    - dead_time: the unmodelled effect may be a delayed input.
    - not_followed: the simulation does not follow the counts.
    - model_spread: an effect that the counts would not show moves a parameter beyond its standard error.
    - unseen: the intervals include effects that the motion cannot show at all; a note.
    - feedback: the residual returns through the input.
    - count_jump: no motion explains one change of the counts.
    - coarse_motion: the method takes the encoder's error for white noise, and the counts per sample are too few.

    With forgetting, the function judges the last three memories. `adequacy` is the adequacy of the model on the whole
    record, if known.
    """
    residual = [*_model(estimator, u, counts, theta, std, adequacy), *_feedback(estimator, u, counts, theta)]
    # Methods weigh the error of a wrong model differently. Therefore only large differences between methods count if
    # the model is wrong.
    limit = 10 * TUNING.drives_biased if "unmodelled" in codes(residual) else 2 * TUNING.drives_biased
    return sort_findings(
        [
            *_jump(estimator, counts),
            *_sizes(estimator, theta, std),
            *_bias(estimator, u, counts, theta, std, limit),
            *_coarse(estimator, counts),
            *residual,
        ]
    )


def _sizes(estimator: Estimator, theta: NDArray[np.float64], std: NDArray[np.float64]) -> Iterator[Finding]:
    for name, value, deviation in zip(estimator.names, theta, std, strict=True):
        if name not in _positive(estimator):
            continue
        if value + 3 * deviation < 0:
            yield Finding(
                "implausible",
                f"{name} is negative",
                "check sign and scale of the input and the encoder",
                "wrong",
            )
        elif deviation > 0.5 * abs(value):
            yield Finding(
                "uncertain",
                f"the error of {name} may exceed half its value",
                "excite the axis more, or lower the cutoff",
            )


def _bias(
    estimator: Estimator,
    u: NDArray[np.float64],
    counts: NDArray[np.int64],
    theta: NDArray[np.float64],
    std: NDArray[np.float64],
    limit: float,
) -> Iterator[Finding]:
    """Compare the estimate with instrumental variables, which know the direction of motion between the counts."""
    plain = isinstance(estimator, LS | RLS)  # least squares have the bias of a noisy output
    if isinstance(estimator, Simulating) or (plain and estimator.zeros):
        return
    try:
        better = reference(estimator, u, counts)
    except NotIdentifiableError as error:
        if plain:
            yield Finding("uncertain", NOISE_SEEN, NOISE_REMEDY, detail=f"Instrumental variables: {error}.")
        return
    unknown = [name for name, (value, bar) in better.items() if name in _positive(estimator) and bar > 0.5 * abs(value)]
    if unknown and plain:
        yield Finding("uncertain", NOISE_SEEN, NOISE_REMEDY, detail=f"Nothing determines {', '.join(unknown)} here.")
    for name, value, deviation in zip(estimator.names, theta, std, strict=True):
        if name not in better or name in unknown:
            continue
        known, bar = better[name]
        own = abs(value - known)
        if own > np.hypot(deviation, bar) and own > limit * abs(known):
            yield Finding("biased", f"{name} = {value:.4g} is biased by the method: iv gives {known:.4g}", "use iv")
        elif own > max(deviation, bar) and limit <= 2 * TUNING.drives_biased:
            percent = 100 * own / abs(known)
            yield Finding(
                "std_too_small", f"the std of {name} leaves out the method's own error, about {percent:.2g} %", "use iv"
            )


def reference(estimator: Estimator, u: ArrayLike, counts: ArrayLike) -> dict[str, tuple[float, float]]:
    """Return the value and the standard deviation of each parameter by instrumental variables with the same memory.

    If instrumental variables do not converge, the values come from bias-compensated least squares.
    """
    forgetting = getattr(estimator, "forgetting", 1.0)
    if estimator.equation.without_simulation:
        zeros = choose_prefilter_zeros(estimator, u, counts)
        fit = like(BCLS, estimator, prefilter_zeros=zeros).fit(u, counts)
        return _table(fit.names, fit.theta, fit.theta_std) if isinstance(estimator, LS | RLS) else {}
    if forgetting < 1:
        # Instrumental variables do not support every forgetting scheme.
        scheme = {"forgetting_scheme": "exponential", "forgetting_of": None}
        track = like(RIV, estimator, prefilter_zeros=None, forgetting=forgetting, **scheme).run(u, counts)
        if track.status[-1] & (Status.FALLBACK | Status.STARTING | Status.POOR_EXCITATION):
            return {}
        return _table(track.names, track.theta[-1], track.theta_std[-1])
    try:
        fit = like(IV, estimator, prefilter_zeros=None).fit(u, counts)
    except NotIdentifiableError:
        zeros = choose_prefilter_zeros(estimator, u, counts)
        fit = like(BCLS, estimator, model=estimator.model.simple, prefilter_zeros=zeros).fit(u, counts)
    return _table(fit.names, fit.theta, fit.theta_std)


def _table(
    names: tuple[str, ...], theta: NDArray[np.float64], std: NDArray[np.float64]
) -> dict[str, tuple[float, float]]:
    return {name: (float(value), float(bar)) for name, value, bar in zip(names, theta, std, strict=True)}


def _positive(estimator: Estimator) -> set[str]:
    """Return the names of the parameters that are never negative in a machine."""
    equation = estimator.equation
    return {name for name, positive in zip(equation.names, equation.positive, strict=True) if positive}


def _coarse(estimator: Estimator, counts: NDArray[np.int64]) -> Iterator[Finding]:
    per_sample = counts_per_sample(counts)
    if "known-step" in estimator.method and per_sample < TUNING.drives_coarse:
        yield Finding(
            "coarse_motion",
            f"the axis moves {per_sample:.2g} counts per sample, so the encoder's error is not white noise",
            "use iv",
        )


def _jump(estimator: Estimator, counts: NDArray[np.int64]) -> Iterator[Finding]:
    """Yield a finding on a jump of the counts, unless a limit of the speed rejects jumps."""
    sentence = count_jump(counts) if estimator.encoder.max_speed is None else ""
    if sentence:
        yield Finding("count_jump", sentence, JUMP_REMEDY, "wrong")


def recent(estimator: Estimator, samples: int) -> slice:
    """Return the samples that determine an estimate: the last three memories of a record."""
    return slice(
        -round(min(samples, TUNING.drives_memories / max(1e-9, 1 - getattr(estimator, "forgetting", 1.0)))), None
    )


def examine_estimate(
    estimator: Estimator,
    u: NDArray[np.float64],
    counts: NDArray[np.int64],
    theta: NDArray[np.float64],
    known: Examined = None,
) -> Adequacy | None:
    """Return the adequacy of the model near an estimate theta (p,) from u (n,) and counts (n,).

    The function uses the samples that determine the estimate. The result is None if the equation cannot be simulated or
    nothing moves. `known` is the result of an earlier examination of the same model.

    Raises NotIdentifiableError if no motion of the model can be fitted.
    """
    if isinstance(known, NotIdentifiableError):
        raise known
    if known is not None:
        return known
    if estimator.equation.without_simulation:
        return None
    part = recent(estimator, u.size)
    u, counts = u[part], counts[part]
    if u.size < TUNING.drives_fewest or not np.any(np.diff(like(OE, estimator, prefilter_zeros=None).position(counts))):
        return None
    if not np.any(like(LS, estimator, model=estimator.model.simple, prefilter_zeros=None).columns(u, counts).used):
        return None
    theta = theta[: len(estimator.equation.names)]
    at = np.where(estimator.equation.positive, np.maximum(theta, 0.0), theta)
    complete = at[estimator.equation.leading] > 0 and not estimator.equation.further
    return examine(estimator, u, counts, at if complete else None)


def _model(
    estimator: Estimator,
    u: NDArray[np.float64],
    counts: NDArray[np.int64],
    theta: NDArray[np.float64],
    std: NDArray[np.float64],
    adequacy: Examined,
) -> Iterator[Finding]:
    """Yield findings on counts that the simulated motion does not explain, and on effects that the counts may hide."""
    try:
        found = examine_estimate(estimator, u, counts, theta, adequacy)
    except NotIdentifiableError as error:
        yield Finding("unmodelled", f"{UNMODELLED}, as no motion of the model follows the counts", detail=f"{error}.")
        return
    if found is None:
        return
    if found.left > ESTIMATOR_TUNING.worst_fit:
        yield Finding(
            "not_followed",
            f"no motion of the model follows the measured motion; {found.left:.0%} of the motion stays unexplained",
            "check input_gain, sign and scale of input and output, and [encoder] bits"
            + ("; for a vertical axis set offset = true" if estimator.equation.roles[OFFSET] is None else ""),
            "wrong",
        )
    if not found.adequate:
        yield _describe_misfit(found)
        if found.left <= ESTIMATOR_TUNING.worst_fit:  # a delay means nothing if no motion follows
            yield from late(found)
        return
    part, own = recent(estimator, u.size), slice(0, len(estimator.equation.names))
    yield from _find_hidden_effects(estimator, found, (u[part], counts[part]), theta[own], std[own])


def _find_hidden_effects(
    estimator: Estimator,
    found: Adequacy,
    record: tuple[NDArray[np.float64], NDArray[np.int64]],
    theta: NDArray[np.float64],
    std: NDArray[np.float64],
) -> Iterator[Finding]:
    """Yield findings on an estimate that contradicts an adequate model, and on effects that the record may hide."""
    at = np.where(estimator.equation.positive, np.maximum(theta, 0.0), theta)
    own_spread = found.spread()[: theta.size]  # shape parameters are known here and have no spread
    if isinstance(estimator, Following):
        spread = own_spread
    else:
        twin = like(IV, estimator, prefilter_zeros=None)
        spread = found.spread(force_moves(found, twin, twin.columns_at(at, *record)))
    best = found.q[: theta.size] * found.difference.scale[: theta.size]
    apart = np.abs(theta - best) / np.maximum(np.sqrt(std**2 + own_spread**2), ESTIMATOR_TUNING.tiny)
    worst = int(np.argmax(apart))
    if isinstance(estimator, Simulating) and apart[worst] > ESTIMATOR_TUNING.adequacy_contradicted:
        yield Finding(
            "biased",
            f"{estimator.names[worst]} = {theta[worst]:.4g} is biased by the method: the simulated motion that fits "
            f"the counts needs {best[worst]:.4g}",
            'set method = "interval" or "output-error"',
            detail="A controller with a coarse encoder feeds the encoder's error back into the input.",
        )
    if np.any(spread > std):
        yield Finding(
            "model_spread",
            "friction or a dead time outside the model may shift an estimate by more than its standard error",
            "use a finer encoder or a richer motion",
        )
    if np.any(found.unseen[: std.size] > std):
        part = float(np.max(found.unseen[: std.size] / np.maximum(np.abs(theta), ESTIMATOR_TUNING.tiny)))
        yield Finding(
            "unseen",
            f"the intervals include {100 * part:.2g} % for effects that this motion cannot show, such as a dead zone",
            "record an input of several sizes, to narrow the intervals",
            "note",
        )


def _feedback(
    estimator: Estimator, u: NDArray[np.float64], counts: NDArray[np.int64], theta: NDArray[np.float64]
) -> Iterator[Finding]:
    """Yield a finding if the input follows the residual of the equation at theta, with the simulated direction."""
    equation = estimator.equation
    theta = theta[: len(equation.names)].copy()
    if equation.without_simulation or not theta[equation.leading] > 0:
        return
    theta = np.where(equation.positive, np.maximum(theta, 0.0), theta)
    columns = like(IV, estimator, prefilter_zeros=None).columns_at(theta, u, counts)
    error = columns.z - columns.phi @ theta
    if error.size == 0:
        return
    if not np.max(np.abs(error)) < ESTIMATOR_TUNING.batch_beyond:
        yield Finding(
            "unmodelled",
            "the motion simulated with this estimate exceeds the range of floating-point numbers",
            "do not use this estimate",
        )
        return
    given = hold_last_input(u)
    change, last = np.diff(given, prepend=given[0])[columns.used], recent(estimator, error.size)
    if correlation_score(error[last], change[last]) > TUNING.significant:
        yield Finding(
            "feedback",
            "the input follows what the model leaves unexplained, as under position control",
            "record an open-loop motion, which is free of this bias",
            detail="The controller feeds the encoder's error or unmodelled friction back. The bias may exceed the "
            "standard errors.",
        )


def correlation_score(error: NDArray[np.float64], change: NDArray[np.float64], lags: int = 5) -> float:
    """Return the largest correlation of an error (n,) with later changes of the input (n,), in standard deviations.

    The changes of the input follow the error by up to `lags` samples. The standard deviation holds for independent
    coloured series (Bartlett 1935).
    """
    n = error.size
    error, change = error - error.mean(), change - change.mean()
    if n <= 4 * lags or not np.any(error) or not np.any(change):
        return 0.0
    power = np.sqrt(np.sum(error**2) * np.sum(change**2))
    cross = [np.sum(error[: n - lag] * change[lag:]) / power for lag in range(lags + 1)]
    size = 2 ** int(np.ceil(np.log2(2 * n)))
    own = [np.fft.irfft(np.abs(np.fft.rfft(series, size)) ** 2, size)[: n // 4] for series in (error, change)]
    rho = [series / series[0] for series in own]
    variance = (1 + 2 * np.sum(rho[0][1:] * rho[1][1:])) / n
    return float(np.max(np.abs(cross)) / np.sqrt(max(variance, 0.2 / n)))
