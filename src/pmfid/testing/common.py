"""Checks of all estimators, off-line and on-line."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import FrozenInstanceError, replace
from functools import partial

import numpy as np

from pmfid.encoder import Encoder
from pmfid.errors import UsageError
from pmfid.estimators.base import Estimator
from pmfid.estimators.configuration import change_arguments, configuration_of
from pmfid.models.drive import Drive, EquationModel
from pmfid.models.equation import COULOMB_BACKWARD, COULOMB_FORWARD, VISCOUS_BACKWARD, VISCOUS_FORWARD, Term
from pmfid.models.transfer_function import TransferFunction
from pmfid.testing.case import COPIES, Case, call, last, require, require_refusal, result_of
from pmfid.types import Floats

#: Greatest relative error of the parameters on a fine record.
COMMON_NEAR = 0.1
#: Greatest relative difference after a change of units or signs, caused by the rounding to counts.
COMMON_SAME = 1e-3
COMMON_MIRRORED = 5e-3
#: Factor between two units of position.
COMMON_THOUSAND = 1000.0
#: Factor of the sample period in a second configuration, chosen so that every cutoff stays valid.
OTHER_DT = 0.5


def configuration_is_a_value(case: Case) -> None:
    """Check that a configuration is frozen, and equals (with its hash) only one with the same arguments."""
    estimator, same = case.configured, replace(case.configured)
    require_refusal(FrozenInstanceError, "a new value of dt", lambda: setattr(estimator, "dt", 1.0))
    require(estimator == same, "two of the same configuration are not equal")
    require(hash(estimator) == hash(same), "two of the same configuration have two hashes")
    require(estimator != replace(estimator, dt=OTHER_DT * estimator.dt), "another dt makes no difference to ==")
    for name, again in COPIES.items():
        other = again(estimator)
        require(type(other) is type(estimator) and other == estimator, f"{name} gives another configuration")


def wrong_arguments_are_refused(case: Case) -> None:
    """Check that the constructor refuses impossible configurations with a UsageError."""
    wrong: dict[str, tuple[object, ...]] = {
        "dt": (0.0, float("nan")),
        "cutoff": (-1.0, 2.1 / case.estimator.dt),
        "order": (0, 2.5),
        "discretization": ("none",),
        "precision": ("float16",),
        "model": (None,),
        "encoder": (1e-5,),
    }
    taken = configuration_of(case.estimator)
    for name, values in wrong.items():
        for value in values if name in taken else ():
            require_refusal(UsageError, f"{name} = {value!r}", partial(change_arguments, case.estimator, {name: value}))


def wrong_arrays_are_refused(case: Case) -> None:
    """Check that arrays of different lengths and fractional counts are refused with a UsageError."""
    u, counts = case.fine.u, case.fine.counts
    require_refusal(UsageError, "a count less than inputs", lambda: result_of(case.configured, u, counts[:-1]))
    require_refusal(UsageError, "counts of 0.5", lambda: result_of(case.configured, u, counts + 0.5))


def names_are_of_the_parameters(case: Case) -> None:
    """Check that each parameter has a unit and a name of its own, and that names index a result."""
    names, result = case.configured.names, case.result
    require(len(set(names)) == len(names), f"names are twice in {names}")
    require(len(names) == len(case.configured.units) == case.theta.size, "there are not as many names as parameters")
    require(tuple(result.names) == tuple(names), f"the result has the names {result.names}, the estimator {names}")
    for name, value in zip(names, case.theta, strict=True):
        require(bool(np.atleast_1d(result[name])[-1] == value), f"result[{name!r}] is not that parameter")
    require_refusal(KeyError, "a parameter that is not there", lambda: result["no such parameter"])


def inputs_stay_untouched(case: Case) -> None:
    """Check that u and counts are only read. Lists and a repeated call give the same bits."""
    u, counts = (part.copy() for part in case.short)
    again = call(case.configured, u, counts)
    require(bool(np.all(u == case.short[0]) and np.all(counts == case.short[1])), "the arrays have changed")
    theta = last(case.short_result.theta)
    require(np.array_equal(last(again.theta), theta), "the same record gives other numbers the second time")
    listed = call(case.configured, u.tolist(), counts.tolist())
    require(np.array_equal(last(listed.theta), theta), "lists give other numbers than arrays")


def finds_the_truth(case: Case) -> None:
    """Check that the estimator finds the true parameters on a fine record of its own model."""
    if case.fine.theta is None:
        return
    known = case.fine.theta != 0
    truth, theta = case.fine.theta[known], case.theta[: known.size][known]
    error = np.abs(theta / truth - 1)
    require(bool(np.all(error < COMMON_NEAR)), f"of {truth} it finds {theta}")


def more_data_make_shorter_error_bars(case: Case) -> None:
    """Check that the whole coarse record gives smaller standard errors than its first third, without forgetting. A bias
    in standard errors does not shrink."""
    u, counts = case.coarse.u, case.coarse.counts
    few, long = u.size // 3, last(case.coarse_result.theta_std)
    short = last(result_of(case.endless, u[:few], counts[:few]).theta_std)
    require(bool(np.all(np.isfinite(long)) and np.all(long > 0)), f"the error bars are {long}")
    shrinks = np.mean(np.log(long / short)) < 0
    require(bool(shrinks or case.configured.misreads), f"{few} samples give {short}, {u.size} give {long}")


def mirrors(case: Case) -> None:
    """Check that the reversed signs of input and counts exchange the directions and reverse the loads."""
    result = result_of(case.configured, -case.fine.u, -case.fine.counts)
    _require_near(last(result.theta), _mirror_theta(case.configured, case.theta), case.theta, COMMON_MIRRORED)


def scales_with_the_units(case: Case) -> None:
    """Check that the parameters scale with the units if position and force are given in thousandths of their units."""
    configured, factors = case.configured, _factors(case.configured)
    changes: dict[str, object] = {
        "encoder": _scale_encoder(configured.encoder),
        "model": _scale_forces(configured.model),
    }
    result = result_of(change_arguments(configured, changes), case.fine.u, case.fine.counts)
    _require_near(last(result.theta), case.theta * factors, case.theta * factors, COMMON_SAME)


def _require_near(found: Floats, expected: Floats, scale: Floats, part: float) -> None:
    size = np.maximum(np.abs(expected), part * np.max(np.abs(scale)))
    require(bool(np.all(np.abs(found - expected) < part * size)), f"it is {found}, not {expected}")


def _mirror_theta(estimator: Estimator, theta: Floats) -> Floats:
    turned, roles = theta.copy(), estimator.equation.roles
    for one, other in ((VISCOUS_FORWARD, VISCOUS_BACKWARD), (COULOMB_FORWARD, COULOMB_BACKWARD)):
        here, there = roles[one], roles[other]
        if here is not None and there is not None:
            turned[here], turned[there] = theta[there], theta[here]
    return turned * _each(estimator, lambda term: -1.0 if term.facts.keeps_sign else 1.0)


def _factors(estimator: Estimator) -> Floats:
    """Return the factors by which parameters grow when position and force are given in thousandths of their units."""
    return _each(estimator, lambda term: 1.0 if term.facts.measured or term.signal == "input" else COMMON_THOUSAND)


def _each(estimator: Estimator, factor: Callable[[Term], float]) -> Floats:
    """Return the value of each parameter's term, and 1 for pre-filter coefficients and a dead time."""
    factors = [factor(term) for term in estimator.equation.unknown]
    return np.array(factors + [1.0] * (len(estimator.names) - len(factors)))


def _scale_encoder(encoder: Encoder) -> Encoder:
    speed = None if encoder.max_speed is None else COMMON_THOUSAND * encoder.max_speed
    return replace(encoder, resolution=COMMON_THOUSAND * encoder.resolution, max_speed=speed)


def _scale_forces(model: object) -> object:
    if isinstance(model, TransferFunction):  # the estimated gains contain the scale
        return model
    if isinstance(model, Drive):
        return replace(model, input_gain=COMMON_THOUSAND * model.equation.input_gain)
    if isinstance(model, EquationModel):
        known = tuple(
            replace(term, coefficient=COMMON_THOUSAND * term.coefficient) if term.signal == "input" else term
            for term in model.equation.known
        )
        return EquationModel(replace(model.equation, known=known))
    raise UsageError(f"scales_with_the_units knows no {type(model).__name__}")
