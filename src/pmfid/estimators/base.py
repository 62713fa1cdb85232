"""Base class of all estimators."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from pmfid.encoder import Encoder
from pmfid.errors import UsageError, check_choice, whole_number
from pmfid.estimators import PRECISIONS, Discretization, Precision
from pmfid.estimators.configuration import (
    check_positive,
    configuration_of,
    construct_estimator,
    explain_inherited,
    freeze,
)
from pmfid.estimators.plants import PlantDefaults, plant_of
from pmfid.estimators.sample_steps import SampleSteps, StepsOption, read_steps
from pmfid.filters.chain import HOLD_FILTERS
from pmfid.filters.columns import ColumnBuilder, FilterSpec
from pmfid.filters.network import TURN, Network, Taps, scale_taps
from pmfid.kernel.configuration import kernel_of, late_values, make_config, shape_values, too_many
from pmfid.kernel.structures import constants_of
from pmfid.models.drive import Model
from pmfid.models.equation import DEAD_TIME, ESTIMATE, LAG, MOST_LATE, Equation
from pmfid.models.shapes import LARGEST, SMALLEST
from pmfid.types import Flags, Floats

if TYPE_CHECKING:
    from pmfid._kernel64 import Kernel

MAX_SETTLE_SAMPLES = 10**8
#: Number of first updates in which a solution corrects the rounding of the last one. Later the innovations alone
#: move theta. float64 without forgetting never changes over.
RESIDUAL_UPDATES = 256
#: Largest forgetting factor in float32, whose sums stop growing at 2^24 samples.
FLOAT32_FORGETTING = 0.999999

#: Number of time constants after which the filters' start has decayed to less than 1 %, for each order.
SETTLE_TIME_CONSTANTS = {2: 7.0, 3: 9.0, 4: 11.0, 5: 12.5, 6: 14.0}


@dataclass(frozen=True)
class Estimator:
    """A method of estimation with a model and an encoder. The object holds only the configuration, checked at
    construction.

    model: `Drive`, `TransferFunction`, or an `EquationModel`.
    encoder: `Encoder`.
    dt: sample period [s].
    cutoff: pole of the Poisson chain [rad/s], 0 < cutoff <= 2/dt. Its inverse is the time constant of the filters.
    order: number of stages, >= 2 for a drive. The default 2 means n for a transfer function of a higher order n.
    discretization: "matched" or "paper".
    prefilter_zeros: one negative zero [rad/s] per noisy column, or None for the method's default.
    precision: "float64" or "float32".
    steps: time [s] between each sample of the record and the preceding one (n,), if the clock is uneven. On-line,
    "given" means that each sample brings its step. `dt` is then the mean step.

    Raises UsageError with a remedy for an invalid value.
    """

    model: Model
    encoder: Encoder
    dt: float
    cutoff: float
    order: int = field(default=2, kw_only=True)
    discretization: Discretization = field(default="matched", kw_only=True)
    prefilter_zeros: Sequence[float] | None = field(default=None, kw_only=True)
    precision: Precision = field(default="float64", kw_only=True)
    steps: StepsOption = field(default=None, kw_only=True)

    method: ClassVar[str] = ""
    #: The kernel has columns of instruments in addition to the regressors.
    instrumental: ClassVar[bool] = False
    #: The standard errors include the direction that coarse counts show late.
    misreads: ClassVar[bool] = False
    #: The method simulates the motion, from which it takes friction that depends on the speed.
    knows_shapes: ClassVar[bool] = False
    knows_elastic: ClassVar[bool] = False

    def __init_subclass__(cls, **further: object) -> None:
        super().__init_subclass__(**further)
        explain_inherited(cls)

    def __post_init__(self) -> None:
        object.__setattr__(self, "steps", read_steps(self.steps))
        freeze(self)
        self._check_kinds()
        if self.order == 2:
            object.__setattr__(self, "order", max(2, self.equation.order))
        if refused := self.refuses(self.equation):
            raise UsageError(refused)
        check_positive("dt", self.dt, "it is the sample period in s")
        if not SMALLEST <= self.dt <= LARGEST:
            raise UsageError(f"dt is {self.dt:g} s, which is no plausible sample period; give the sample period in s")
        check_positive("cutoff", self.cutoff, "it is the pole of the filters in rad/s")
        if self.cutoff * self.dt > 2:
            raise UsageError(
                f"cutoff * dt must be at most 2, got {self.cutoff * self.dt:g}: the filters are too fast "
                f"for samples every {self.dt:g} s; use a cutoff of at most {2 / self.dt:g} rad/s"
            )
        self._check_steps()
        self._check_late()
        if self.settle_samples > MAX_SETTLE_SAMPLES:
            raise UsageError(
                f"cutoff = {self.cutoff:g} rad/s is too low for dt = {self.dt:g} s: the filters would settle "
                f"after {self.settle_samples:.2g} samples; use a higher cutoff, of the order of the poles of "
                "the plant"
            )
        if self.order < self.equation.order:
            raise UsageError(f"order must be at least {self.equation.order}, got {self.order}")
        check_choice(f"discretization of {self.method}", self.discretization, sorted(HOLD_FILTERS))
        check_choice("precision", self.precision, PRECISIONS)
        self._check_zeros()

    def __reduce__(self) -> tuple[object, ...]:
        return construct_estimator, (type(self), configuration_of(self))

    @classmethod
    def refuses(cls, equation: Equation) -> str:
        """Return the reason, with a remedy, why the method cannot estimate this equation; empty if it can."""
        if equation.elastic and not cls.knows_elastic:
            return equation.refuse_second_mass(cls.method)
        if late := " and ".join(name for name in (DEAD_TIME, LAG) if getattr(equation, name) == ESTIMATE):
            return f"{cls.method} does not estimate {late}; use fit off-line, or give the time in s"
        if refused := too_many([table for table, _ in equation.known_at([1.0] * len(equation.further)).shapes]):
            return refused
        of_speed = ", ".join(str(term.name) for term in equation.shaped if term.shape and term.shape.of_speed)
        if of_speed and not cls.knows_shapes:
            return (
                f"{cls.method} uses the counts only, and the counts do not show {of_speed} the speed closely "
                "enough; use iv, riv or fit, or remove this friction from the model"
            )
        if not equation.only_simulated:
            return ""
        return f"{cls.method} does not simulate the process, and {equation.only_simulated} needs that; use srivc"

    def _check_steps(self) -> None:
        """Raise UsageError if the step varies and the method, plant or discretisation does not allow it."""
        if self.steps is None:
            return
        why = ""
        if not self.plant.rests:
            why = "a transfer function uses the times of an Experiment"
        elif self.discretization != "matched":
            why = f"{self.method or 'this method'} with this discretization accepts only evenly spaced samples"
        elif self.equation.dead_time or self.equation.lag:
            why = "an input that acts late needs evenly spaced samples"
        if why:
            raise UsageError(
                f"steps are not possible here, because {why}; resample the record to a fixed period, or leave steps out"
            )

    def steps_before(self, samples: int) -> Floats | None:
        """Return the time [s] between each sample of a record and the preceding one (n,); None if the clock is even.
        Raises UsageError if the steps are unknown, or if their number is not `samples`."""
        if self.steps is None:
            return None
        if not isinstance(self.steps, SampleSteps) or self.steps.before.size != samples:
            known = self.steps.before.size if isinstance(self.steps, SampleSteps) else 0
            raise UsageError(
                f"the record has {samples} samples and steps has {known}: give one step for each sample, (n,)"
            )
        return self.steps.before

    def weigh_rows(self, zeta: Floats, used: Flags) -> Floats:
        """Return the instruments (m, p) of the rows in use (n,), weighted by the time that each row represents."""
        if not isinstance(self.steps, SampleSteps):
            return zeta
        return np.asarray(zeta * self.steps.weights(self.dt)[used, None])

    @property
    def intervals(self) -> float | Floats:
        """Sample period [s], or the time between each sample of the record and the next one (n,) [s]."""
        return self.steps.after if isinstance(self.steps, SampleSteps) else self.dt

    def _check_late(self) -> None:
        if self.equation.dead_time not in (0, ESTIMATE) and not self.equation.dead_time <= MOST_LATE * self.dt:
            raise UsageError(
                f"dead_time is {self.equation.dead_time:g} s, more than {MOST_LATE} samples: shift the input "
                "column by whole samples, and give only the rest as dead_time"
            )
        if self.equation.lag not in (0, ESTIMATE) and not self.equation.lag <= MOST_LATE * self.dt:
            raise UsageError(
                f"lag is {self.equation.lag:g} s, more than {MOST_LATE} samples: such a lag belongs to the "
                "plant, not to its drive; check the unit, or estimate the lag as a pole of a transfer "
                "function"
            )

    def _check_kinds(self) -> None:
        if not isinstance(getattr(self.model, "equation", None), Equation):
            raise UsageError(f"model must be a Drive, a TransferFunction or an EquationModel, got {self.model!r}")
        if getattr(self.model, "input_gain", None) == ESTIMATE:
            raise UsageError(
                'an estimator needs a number as input_gain: use pmfid.identify with given = {"mass": 1.25}, '
                "or write Drive(input_gain=1.0, ...) and combine its estimates with pmfid.Known(estimator, "
                'given={"mass": 1.25}, find_gain=True)'
            )
        if not isinstance(self.encoder, Encoder):
            raise UsageError(f"encoder must be an Encoder, got {self.encoder!r}; write Encoder(resolution)")
        order = whole_number("order", self.order, 0, "it is the number of filter stages")
        object.__setattr__(self, "order", order)

    def _check_zeros(self) -> None:
        zeros, needed = self.zeros, self._zeros_needed
        if zeros and not self.plant.extended and not self.instrumental:
            raise UsageError(f"{self.method} does not use prefilter_zeros for a linear process; bcls and bcrls do")
        if zeros and needed > len(zeros) and self.prefilter_zeros is None:
            raise UsageError(
                f"{self.method} with {needed} noisy columns needs {needed} prefilter_zeros; give them, or use iv or riv"
            )
        wrong = zeros and (len(zeros) != needed or len(set(zeros)) < needed)
        if wrong or any(not (math.isfinite(z) and z < 0) for z in zeros):
            raise UsageError(f"prefilter_zeros must be {needed} different negative numbers in rad/s, got {list(zeros)}")

    @property
    def _zeros_needed(self) -> int:
        """Number of zeros: one for each noisy column."""
        return len(self.equation.noisy)

    @property
    def equation(self) -> Equation:
        return self.model.equation

    @property
    def plant(self) -> PlantDefaults:
        """Properties of the kind of plant that the equation describes."""
        return plant_of(self.equation)

    @property
    def memory(self) -> float:
        """Memory of the estimate [s]."""
        return math.inf

    @property
    def zeros(self) -> tuple[float, ...]:
        """Zeros of the pre-filter polynomial f(s) [rad/s]; () if the method has no pre-filter."""
        if self.prefilter_zeros is not None:
            return tuple(float(z) for z in self.prefilter_zeros)
        if not self.instrumental:
            return ()
        return self.plant.default_zeros(self.cutoff, self.memory, self._zeros_needed)

    @property
    def names(self) -> tuple[str, ...]:
        """Parameter names in the order of theta."""
        further = tuple(name for name, _ in self.equation.further)
        return self.equation.names + tuple(f"prefilter_{j + 1}" for j in range(self._extra)) + further

    @property
    def units(self) -> tuple[str, ...]:
        further = tuple(unit for _, unit in self.equation.further)
        return self.equation.units + tuple(f"s^{j + 1}" for j in range(self._extra)) + further

    @property
    def _extra(self) -> int:
        """Number of unknown coefficients of f(s), which the extended model without compensation contains (paper eq. 19,
        21).
        """
        return 0 if self.instrumental else len(self.zeros)

    @property
    def spec(self) -> FilterSpec:
        return FilterSpec(self.cutoff, self.order, self.dt, self.discretization, self.zeros, self.steps is not None)

    @cached_property
    def _columns(self) -> tuple[Network, list[Taps]]:
        builder = ColumnBuilder(self.equation, self.spec)
        columns = builder.regressors()
        if self._extra:
            columns += [scale_taps(builder.prefilter_input(j + 1), -1.0) for j in range(self._extra)]
            columns.append(builder.prefilter_input(0))
        else:
            columns.append(builder.target())
        if self.instrumental:
            columns += builder.instruments()
        return builder.network, columns

    @cached_property
    def _misread_columns(self) -> tuple[Network, list[int], list[Taps]]:
        """Network, parameters and columns of the errors from misread counts, which follow the other columns. They are
        empty if the method or the equation has none."""
        network, _ = self._columns
        if not self.misreads or not self.plant.rests or self._extra:
            return network, [], []
        return network, *ColumnBuilder(self.equation, self.spec, network).misread()

    def make_kernel(self, forgetting: float = 1.0) -> Kernel:
        """Return a new kernel in its initial state."""
        columns = self._columns[1]
        network, misread, errors = self._misread_columns
        direct = self.recursion_config(len(self.names), self.instrumental, forgetting)
        direct |= {"n_misread": len(misread), "misread_index": misread}
        direct["misread_column"] = len(columns) if errors else 0
        try:
            config = make_config(
                self.precision,
                network.stages,
                [*columns, *errors],
                encoder=self.encoder_config | {"turns": int(self._has_turns(network)), "misread": int(bool(errors))},
                direct=direct,
                settle_samples=self.settle_samples,
                first_samples=self.first_samples,
                late=self.late_config(),
                shapes=shapes_of(self.equation, network),
                rates=network.rates if self.steps is not None else ((), ()),
            )
            return kernel_of(self.precision, config)
        except ValueError as error:  # the kernel has no room for this configuration
            raise UsageError(str(error)) from None

    def _has_turns(self, network: Network) -> bool:
        return self.steps is not None and any(stage[0] == TURN for stage in network.stages)

    @property
    def encoder_config(self) -> dict[str, float]:
        """Return the encoder's part of the kernel configuration."""
        config = self.encoder.kernel_config(self.dt) | {"process": int(not self.plant.rests), "from_first": 0}
        if self.steps is not None:
            still = min(constants_of(None)["PMF_TICKS"] * config["standstill_samples"], 2**28)
            # The guard is off, because the largest change in one sample is no bound for a sample with another step.
            return config | {"rate": 1 / self.dt, "standstill_samples": still}
        return config | {"guard": int(self.encoder.guard and self.plant.rests)}

    def late_config(self) -> dict[str, object] | None:
        """Return the kernel configuration of a late input; None if the input acts at once, or an unknown time later."""
        late, lag = (0.0 if time == ESTIMATE else float(time) for time in (self.equation.dead_time, self.equation.lag))
        return late_values(self.dt, late, lag, self.precision) if late or lag else None

    @property
    def first_samples(self) -> int:
        """Number of samples that do not count at the start. The filters settle within these samples. With an unknown
        start, only one sample is left out, because the start passes through the kernel in one sample."""
        return 1 if any(term.signal == "start" for term in self.equation.unknown) else self.settle_samples

    @property
    def settle_samples(self) -> int:
        constants = SETTLE_TIME_CONSTANTS.get(self.order, 2.0 + 2.0 * self.order)
        return math.ceil(constants / max(self.cutoff * self.dt, 1 / MAX_SETTLE_SAMPLES)) + 3

    def recursion_config(
        self, parameters: int, instrumental: bool, forgetting: float, first_column: int = 0
    ) -> dict[str, object]:
        """Return the kernel configuration of a recursion."""
        exact = forgetting == 1 and self.precision == "float64"
        return {
            "n_parameters": parameters,
            "instrumental": int(instrumental),
            "first_column": first_column,
            "every": 1,
            "min_updates": math.ceil(1 / (self.cutoff * self.dt)) + 2 * parameters,
            "residual_updates": 2**32 - 1 if exact else RESIDUAL_UPDATES,
            "forgetting": longest_forgetting(forgetting, self.precision),
            "regularization": self.plant.regularization,
            "pivot": self.plant.pivot,
            "block": 2 * self.settle_samples,
            "correlated": 2 * self.order / (self.cutoff * self.dt),
            "compensated": 0,
            "noise": np.zeros((0, 0)),
            "target_noise": (),
            "target_power": 0.0,
            "constant": constants_of(None)["PMF_NO_PARAMETER"],
            "lowest": constants_of(None)["PMF_NO_PARAMETER"],
            "lift": 0.0,
            "half_memory": 0,
            "leading": 0,
            "haste": 1.0,
            "leak": 1.0,
            "shown": 0.0,
            "outgrown": 0.0,
            "growing": 0,
            "unexplained": 0.0,
            "check_samples": 0.0,
            "n_misread": 0,
            "misread_column": 0,
            "misread_index": (),
        }


def shapes_of(equation: Equation, network: Network) -> dict[str, object]:
    """Return the shapes of an equation with their nodes in its network."""
    nodes, measured = (
        [network.slots.get((by_counts, *term.place), 0) for term in equation.shaped] for by_counts in (False, True)
    )
    return shape_values(equation.shapes, nodes, measured)


def longest_forgetting(forgetting: float, precision: str) -> float:
    """Return the forgetting factor of a kernel. A float32 sum of more samples would not take a further one."""
    return min(forgetting, FLOAT32_FORGETTING) if precision == "float32" else forgetting


def memory_of(forgetting: float, dt: float) -> float:
    """Return the memory dt / (1 - forgetting) [s], infinite without forgetting."""
    return dt / (1 - forgetting) if forgetting < 1 else math.inf


@dataclass(frozen=True)
class Simulating(Estimator):
    """An `Estimator` that simulates the motion from the input alone, so that the equation must be one that can be
    simulated.

    A pre-filter adds no unknowns to such an estimator.
    """

    knows_shapes: ClassVar[bool] = True

    @classmethod
    def refuses(cls, equation: Equation) -> str:
        refused = super().refuses(equation.at_once)
        if refused or equation.elastic or not equation.without_simulation:
            return refused
        return (
            f"{cls.method} needs a simulated motion, and this equation does not allow one: "
            f"{equation.without_simulation}; use ls, bcls, rls or bcrls"
        )

    @property
    def _extra(self) -> int:
        return 0
