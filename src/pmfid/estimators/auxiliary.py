"""The columns and the kernel of the methods with an auxiliary model."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, TypeVar

import numpy as np

from pmfid._stage import first_order
from pmfid.estimators.base import Estimator, shapes_of
from pmfid.estimators.configuration import like
from pmfid.estimators.recursive import BCRLS, impulse_products
from pmfid.estimators.tuning import TUNING
from pmfid.filters.columns import HELD, SPLIT, ColumnBuilder
from pmfid.filters.network import ACCELERATION, AUXILIARY, VELOCITY, Network, Taps
from pmfid.kernel.configuration import new_kernel
from pmfid.kernel.structures import constants_of
from pmfid.models.equation import ESTIMATE, LATE, ROLES, Equation

if TYPE_CHECKING:
    from pmfid._kernel64 import Kernel

T = TypeVar("T")

#: Samples from one update of the copy to the next in the kernel.
FOLLOWED = constants_of(None)["PMF_FOLLOWED"]
#: Signal of a term, the output as its velocity -> its place in the auxiliary model's block of signals.
BLOCK = {**HELD, **SPLIT, "output": VELOCITY}


@dataclass(frozen=True)
class Direct(BCRLS):
    """`BCRLS` next to an auxiliary model, no method by itself. The auxiliary model gives the dead time at which the
    equation of `BCRLS` is linearised."""

    method: ClassVar[str] = ""

    @classmethod
    def refuses(cls, equation: Equation) -> str:
        return super().refuses(equation.at_once)


def auxiliary_columns(estimator: Estimator) -> tuple[Network, list[Taps], int, int]:
    """What `_make_columns` makes, once for each estimator: an iteration asks for it at every turn."""
    return _cache_result(estimator, _make_columns)


def _cache_result(estimator: Estimator, make: Callable[[Estimator], T]) -> T:
    """make(estimator), from the second time on what it gave the first time; an estimator's configuration is frozen."""
    kept = estimator.__dict__
    if make.__name__ not in kept:
        kept[make.__name__] = make(estimator)
    found: T = kept[make.__name__]
    return found


def _make_columns(estimator: Estimator) -> tuple[Network, list[Taps], int, int]:
    """Columns: those of the direct BCRLS, then regressors, target and instruments with the auxiliary model, then the
    filtered velocity measured and modelled and the modelled acceleration. Returns network, columns, first
    instrumental and first check column."""
    direct = direct_estimator(estimator)
    builder = ColumnBuilder(direct.equation, direct.spec)
    columns = [*builder.regressors(), builder.target(), *builder.instruments()]
    first = len(columns)
    builder = ColumnBuilder(estimator.equation, estimator.spec, builder.network)
    columns += [*builder.regressors("modelled"), builder.target("modelled"), *builder.regressors("simulated")]
    check = len(columns)
    columns += [builder.velocity(0, simulated=False), builder.velocity(0, simulated=True), builder.model_acceleration()]
    return builder.network, columns, first, check


def direct_estimator(estimator: Estimator) -> BCRLS:
    """The method that needs no auxiliary model: to start from, and to fall back on."""
    scheme = getattr(estimator, "forgetting_scheme", "exponential")
    symmetric = estimator.model.symmetric
    return like(Direct, estimator, model=symmetric, forgetting_scheme=scheme, forgetting=1.0, forgetting_of=None)


def make_auxiliary_kernel(
    estimator: Estimator, forgetting: float, initial: Sequence[float] | None, adapt: bool
) -> tuple[Kernel, int]:
    """A kernel with auxiliary model, and its first instrumental column.

    initial: parameters of the model to start from (p,), or None: start from the direct estimate.
    adapt: the model follows the estimate; False: it keeps the initial parameters.
    """
    network, columns, first, check = auxiliary_columns(estimator)
    p = len(estimator.names)
    direct = _cache_result(estimator, direct_estimator)
    causes = _causes(estimator.equation, network) if adapt else []
    values = estimator.equation.role_values(initial)
    auxiliary = {
        "enabled": 1,
        "adapt": int(adapt),
        "has_initial": int(initial is not None),
        "check_column": check,
        "target_column": first + p,
        "mass_column": first + p + 1 + estimator.equation.leading,
        "trial_samples": 2 * estimator.settle_samples,
        "dt": estimator.dt,
        "input_gain": estimator.equation.input_gain,
        "position_gain": _position_gain(estimator),
        "smoothing": min(1.0, FOLLOWED * estimator.cutoff * estimator.dt / TUNING.copy_time_constants),
        "memory": math.exp(-estimator.cutoff * estimator.dt / TUNING.check_time_constants),
        "mismatch_limit": TUNING.mismatch_limit,
        "noise_power": _cache_result(estimator, _noise_power),
        "lag_memory": math.exp(-estimator.cutoff * estimator.dt / TUNING.lag_time_constants),
        "lag_samples": max(1.0, TUNING.alike_time_constants / (estimator.cutoff * estimator.dt)),
        "direct_index": _indices(_alike(direct.equation, estimator.equation)),
        "index": _indices(estimator.equation.roles),
        "initial": values,
        "jump_gain": 1 - math.exp(-2 / estimator.order * estimator.cutoff * estimator.dt),
        "sensitivities": len(causes),
        "cause": causes,
        "role": [estimator.equation.roles.index(i) for i in range(len(causes))],
        "shapes": shapes_of(estimator.equation, network),
        "steps": int(estimator.steps is not None),
    }
    kernel = new_kernel(
        estimator.precision,
        network.stages,
        columns,
        encoder=estimator.encoder_config,
        direct=direct.recursion_config(len(direct.names), True, forgetting),
        settle_samples=2 * estimator.settle_samples,  # half-way the model is set to the measured velocity
        instrument=_with_check(estimator, estimator.recursion_config(p, True, forgetting, first))
        | {"growing": _growing(estimator) if adapt else 0},
        auxiliary=auxiliary,
        late=_late(estimator, float(values[LATE]), forgetting),
        rates=network.rates if estimator.steps is not None else ((), ()),
    )
    return kernel, first


def _late(estimator: Estimator, start: float, forgetting: float) -> dict[str, object] | None:
    """How late the input acts; where that is estimated, the motion within the counts tells it, too, if it depends on
    nothing but body and input."""
    config, equation = estimator.late_config(start), estimator.equation
    if config is None or equation.dead_time != ESTIMATE:
        return config
    within = not equation.shaped and not equation.place_matters
    counts = 1 / estimator.encoder.resolution
    return config | {"found": 1, "within": int(within), "counts": counts, "growth": 1 / forgetting}


def _with_check(estimator: Estimator, recursion: Mapping[str, object]) -> dict[str, object]:
    """A recursion and what its innovations are compared with; that of whole records has no parameters."""
    check, p = _cache_result(estimator, _check_of_model), recursion["n_parameters"]
    noise = np.asarray(check["noise"])[:p, :p]
    return {**recursion, **check, "noise": noise}


def _check_of_model(estimator: Estimator) -> dict[str, object]:
    """Which innovations the encoder's step explains, as if its error were white, and over what memory they count."""
    network, columns, first, _ = auxiliary_columns(estimator)
    products = impulse_products(estimator, network, columns[first : first + len(estimator.names)])
    return {
        "noise": estimator.encoder.resolution**2 / 12 * products,
        "unexplained": TUNING.auxiliary_unexplained,
        "check_samples": float(math.ceil(TUNING.model_check_time_constants / (estimator.cutoff * estimator.dt))),
    }


def _growing(estimator: Estimator) -> int:
    """The power of their number by which samples count. The direct estimate, from which the model starts, takes
    friction of a shape for another one: the copy has far to go, and what was gathered on the way must go sooner."""
    return TUNING.growing_with_shapes if estimator.equation.shaped else 1


def _position_gain(estimator: Estimator) -> float:
    """By how much the model's position is set to the counts in every sample: a force of the place asks for it as soon
    as the filters show it, and is all but blind to a step of the encoder; a spring, which is not, as slowly as the copy
    moves."""
    waits = 1.0 if any(term.shape and not term.shape.of_speed for term in estimator.equation.shaped) else None
    return min(1.0, estimator.cutoff * estimator.dt / (waits or TUNING.copy_time_constants))


def _alike(direct: Equation, equation: Equation) -> list[int | None]:
    """The parameter of the direct equation for each role; the direct equation knows only some of the shapes."""
    places = {term.place: i for i, term in enumerate(direct.unknown)}
    return [*direct.roles[: len(ROLES)], *(places.get(term.place) for term in equation.shaped)]


def _causes(equation: Equation, network: Network) -> list[int]:
    """The auxiliary model's signal that each parameter multiplies; none with a spring or another force of the
    place, which would bring a deviation of the velocity back: the kernel does not follow that, and the stops count as
    known."""
    if equation.place_matters:
        return []
    return [
        network.slots.get((False, *t.place)) or (ACCELERATION if t.derivative == 2 else AUXILIARY + BLOCK[t.signal])
        for t in equation.unknown
        if t.signal != "input"  # the dead time comes last
    ]


def _indices(roles: Sequence[int | None]) -> list[int]:
    none = constants_of(None)["PMF_NO_PARAMETER"]
    known = [none if index is None else index for index in roles]
    return known + [none] * (constants_of(None)["PMF_ROLES"] - len(known))


def _noise_power(estimator: Estimator) -> float:
    """What quantisation alone may leave in the comparison: the variance of one count, filtered, over its memory."""
    pole = (2 / estimator.dt - estimator.cutoff) / (2 / estimator.dt + estimator.cutoff)
    impulse = np.zeros(4 * estimator.settle_samples)
    impulse[0], impulse[1] = 1 / estimator.dt, -1 / estimator.dt
    for _ in range(estimator.order):
        gain = estimator.cutoff / (2 / estimator.dt + estimator.cutoff)
        impulse, _ = first_order(impulse, pole, gain, gain)
    samples = TUNING.check_time_constants / (estimator.cutoff * estimator.dt)
    return float(estimator.encoder.resolution**2 * np.sum(impulse**2) * samples)
