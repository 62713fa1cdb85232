"""Columns and kernel of the methods with an auxiliary model."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, TypeVar

import numpy as np

from pmfid._stage import first_order, products
from pmfid.elementary import exp
from pmfid.estimators.base import Estimator, shapes_of
from pmfid.estimators.configuration import like
from pmfid.estimators.recursive import BCRLS, impulse_products
from pmfid.filters.columns import HELD, SPLIT, ColumnBuilder
from pmfid.filters.network import ACCELERATION, AUXILIARY, VELOCITY, Network, Taps
from pmfid.kernel.configuration import kernel_of, make_config
from pmfid.kernel.structures import Structured, constants_of
from pmfid.models.equation import ROLES, Equation

if TYPE_CHECKING:
    from pmfid._kernel64 import Kernel

#: Time constant of the estimate's slow copy, which drives the model, in filter time constants. The instruments must
#: not follow the noise of the samples that they are multiplied with.
COPY_TIME_CONSTANTS = 17.0
#: The model is not trusted if the mean square error of its velocity exceeds this part of the mean square velocity.
MISMATCH_LIMIT = 0.2
#: Value for equations with shapes. With 3 the first samples still mattered after 4000 samples; with 7 the error
#: bars were longer.
GROWING_WITH_SHAPES = 5
#: Memory of the comparison between the model's and the measured velocity, in filter time constants.
CHECK_TIME_CONSTANTS = 30.0
#: Memory of the comparison that reveals a model ahead of the plant, in filter time constants. The second value is
#: the span of samples for one comparison, in the same unit.
LAG_TIME_CONSTANTS = 1000.0
ALIKE_TIME_CONSTANTS = 2.0
#: The equation is called wrong on-line if the mean square innovation exceeds this multiple of a white encoder
#: error. The second value is the length of the two compared stretches, in filter time constants.
AUXILIARY_UNEXPLAINED = 2.5
MODEL_CHECK_TIME_CONSTANTS = 50.0

T = TypeVar("T")

#: Number of samples between two updates of the auxiliary model's parameters in the kernel.
FOLLOWED = constants_of(None)["PMF_FOLLOWED"]
#: Index of each signal in the auxiliary model's block of signals. The velocity stands for the output.
BLOCK = {**HELD, **SPLIT, "output": VELOCITY}


@dataclass(frozen=True)
class Direct(BCRLS):
    """`BCRLS` as the direct estimator next to an auxiliary model, not a method by itself.

    The auxiliary model gives the dead time at which the equation of `BCRLS` is linearised.
    """

    method: ClassVar[str] = ""
    misreads: ClassVar[bool] = False

    @classmethod
    def refuses(cls, equation: Equation) -> str:
        return super().refuses(equation.at_once)


def auxiliary_columns(estimator: Estimator) -> tuple[Network, list[Taps], int, int]:
    """Return the result of `_make_columns` from a cache, because an iteration needs it at every step."""
    return _cache_result(estimator, _make_columns)


def _cache_result(estimator: Estimator, make: Callable[[Estimator], T]) -> T:
    """Return make(estimator), computed once for each estimator. The cache is safe because an estimator's
    configuration is frozen.
    """
    kept = estimator.__dict__
    if make.__name__ not in kept:
        kept[make.__name__] = make(estimator)
    found: T = kept[make.__name__]
    return found


def _make_columns(estimator: Estimator) -> tuple[Network, list[Taps], int, int]:
    """Return the network, its columns, the first instrumental column and the first check column.

    The first columns are those of the direct BCRLS. Then follow regressors, target and instruments with the auxiliary
    model. The check columns are the filtered velocity, measured and modelled, and the modelled acceleration.
    """
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
    """Return the estimator without an auxiliary model, which gives the start values and the fallback."""
    return like(Direct, estimator, model=estimator.model.symmetric, forgetting=1.0)


def make_auxiliary_kernel(
    estimator: Estimator, forgetting: float, initial: Sequence[float] | None, adapt: bool
) -> tuple[Kernel, int]:
    """Return a kernel with an auxiliary model, and its first instrumental column.

    `initial` (p,) are start values of the model's parameters. If `initial` is None, the model starts from the direct
    estimate. If `adapt` is True, the model follows the estimate, else it keeps the initial parameters.
    """
    known, key = _cache_result(estimator, _make_cache), (forgetting, initial is not None, adapt)
    if key not in known:
        known[key] = _make_config(estimator, *key)
    # A copy of a structure would leave the bytes between its fields undefined, and saved states contain them.
    config = np.frombuffer(bytearray(known[key].tobytes()), known[key].dtype).reshape(())
    values = estimator.equation.role_values(initial)
    config["auxiliary"]["initial"][: len(values)] = values
    return kernel_of(estimator.precision, config), auxiliary_columns(estimator)[2]


def _make_cache(estimator: Estimator) -> dict[tuple[float, bool, bool], Structured]:
    return {}


def _make_config(estimator: Estimator, forgetting: float, has_initial: bool, adapt: bool) -> Structured:
    """Return a kernel's configuration without the initial parameters. The iterations and segments of one estimator
    differ only in these.
    """
    network, columns, first, check = auxiliary_columns(estimator)
    p = len(estimator.names)
    direct = _cache_result(estimator, direct_estimator)
    causes = _causes(estimator.equation, network) if adapt else []
    auxiliary = {
        "enabled": 1,
        "adapt": int(adapt),
        "has_initial": int(has_initial),
        "check_column": check,
        "target_column": first + p,
        "mass_column": first + p + 1 + estimator.equation.leading,
        "trial_samples": 2 * estimator.settle_samples,
        "dt": estimator.dt,
        "input_gain": estimator.equation.input_gain,
        "position_gain": _position_gain(estimator),
        "smoothing": min(1.0, FOLLOWED * estimator.cutoff * estimator.dt / COPY_TIME_CONSTANTS),
        "memory": exp(-estimator.cutoff * estimator.dt / CHECK_TIME_CONSTANTS),
        "mismatch_limit": MISMATCH_LIMIT,
        "noise_power": _cache_result(estimator, _noise_power),
        "lag_memory": exp(-estimator.cutoff * estimator.dt / LAG_TIME_CONSTANTS),
        "lag_samples": max(1.0, ALIKE_TIME_CONSTANTS / (estimator.cutoff * estimator.dt)),
        "direct_index": _indices(_alike(direct.equation, estimator.equation)),
        "index": _indices(estimator.equation.roles),
        "initial": (),
        "jump_gain": 1 - exp(-2 / estimator.order * estimator.cutoff * estimator.dt),
        "sensitivities": len(causes),
        "cause": causes,
        "role": [estimator.equation.roles.index(i) for i in range(len(causes))],
        "shapes": shapes_of(estimator.equation, network),
        "steps": int(estimator.steps is not None),
    }
    return make_config(
        estimator.precision,
        network.stages,
        columns,
        encoder=estimator.encoder_config,
        direct=direct.recursion_config(len(direct.names), True, forgetting),
        # after half of these samples, the model is set to the measured velocity
        settle_samples=2 * estimator.settle_samples,
        instrument=_with_check(estimator, estimator.recursion_config(p, True, forgetting, first))
        | {"growing": _growing(estimator) if adapt else 0},
        auxiliary=auxiliary,
        late=estimator.late_config(),
        rates=network.rates if estimator.steps is not None else ((), ()),
    )


def _with_check(estimator: Estimator, recursion: Mapping[str, object]) -> dict[str, object]:
    """Return a recursion's configuration with the check of its innovations. The recursion of a whole record has no
    parameters.
    """
    check, p = _cache_result(estimator, _check_of_model), recursion["n_parameters"]
    noise = np.asarray(check["noise"])[:p, :p]
    return {**recursion, **check, "noise": noise}


def _check_of_model(estimator: Estimator) -> dict[str, object]:
    """Return the configuration of the check: the noise of the encoder's step, as if it were white, and the memory
    of the check.
    """
    network, columns, first, _ = auxiliary_columns(estimator)
    responses = impulse_products(estimator, network, columns[first : first + len(estimator.names)])
    return {
        "noise": estimator.encoder.rounding_variance * responses,
        "unexplained": AUXILIARY_UNEXPLAINED,
        "check_samples": float(math.ceil(MODEL_CHECK_TIME_CONSTANTS / (estimator.cutoff * estimator.dt))),
    }


def _growing(estimator: Estimator) -> int:
    """Return the exponent by which samples count more as their number grows.

    The model starts from the direct estimate, which mistakes friction of a shape for another friction. The model
    therefore needs a long way, and early samples must be forgotten faster.
    """
    return GROWING_WITH_SHAPES if estimator.equation.shaped else 1


def _position_gain(estimator: Estimator) -> float:
    """Return the gain by which every sample corrects the model's position towards the counts.

    A force of the place needs the correction as fast as the filters show it, and is almost insensitive to an encoder
    step. A spring is sensitive to a step, so that its correction is as slow as the adaptation of the model.
    """
    waits = 1.0 if any(term.shape and not term.shape.of_speed for term in estimator.equation.shaped) else None
    return min(1.0, estimator.cutoff * estimator.dt / (waits or COPY_TIME_CONSTANTS))


def _alike(direct: Equation, equation: Equation) -> list[int | None]:
    """Return the index of the direct equation's parameter for each role. The direct equation contains only some of
    the shapes.
    """
    places = {term.place: i for i, term in enumerate(direct.unknown)}
    return [*direct.roles[: len(ROLES)], *(places.get(term.place) for term in equation.shaped)]


def _causes(equation: Equation, network: Network) -> list[int]:
    """Return the auxiliary model's signal for each parameter.

    The list is empty with a spring or another force of the place. Such a force would reduce a deviation of the
    velocity, which the kernel does not compute, so that the stops count as known.
    """
    if equation.place_matters:
        return []
    return [
        network.slots.get((False, *t.place)) or (ACCELERATION if t.derivative == 2 else AUXILIARY + BLOCK[t.signal])
        for t in equation.unknown
    ]


def _indices(roles: Sequence[int | None]) -> list[int]:
    none = constants_of(None)["PMF_NO_PARAMETER"]
    known = [none if index is None else index for index in roles]
    return known + [none] * (constants_of(None)["PMF_ROLES"] - len(known))


def _noise_power(estimator: Estimator) -> float:
    """Return the mismatch that quantisation alone may cause: the variance of one filtered count over the memory of
    the check.
    """
    pole = (2 / estimator.dt - estimator.cutoff) / (2 / estimator.dt + estimator.cutoff)
    impulse = np.zeros(4 * estimator.settle_samples)
    impulse[0], impulse[1] = 1 / estimator.dt, -1 / estimator.dt
    for _ in range(estimator.order):
        gain = estimator.cutoff / (2 / estimator.dt + estimator.cutoff)
        impulse, _ = first_order(impulse, pole, gain, gain)
    samples = CHECK_TIME_CONSTANTS / (estimator.cutoff * estimator.dt)
    return float(12 * estimator.encoder.rounding_variance * products(impulse[None])[0, 0] * samples)
