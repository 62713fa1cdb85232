"""Recursive least squares, plain and with compensation of the encoder's bias."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from numbers import Real
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid._stage import first_order
from pmfid.errors import UsageError
from pmfid.estimators.base import Estimator, memory_of
from pmfid.estimators.configuration import configuration_of, construct_estimator
from pmfid.estimators.least_squares import level_of
from pmfid.estimators.results import Track, Tracks
from pmfid.estimators.runner import Runner
from pmfid.estimators.tuning import TUNING
from pmfid.filters.columns import ColumnBuilder
from pmfid.filters.network import LATE_POSITION, SPLIT_FORWARD, VELOCITY, Network, Taps
from pmfid.kernel.saved import MOST_WEIGHT
from pmfid.kernel.structures import constants_of

if TYPE_CHECKING:
    from pmfid._estimate import Estimate
    from pmfid._kernel64 import Kernel


def noise_covariance(estimator: Estimator, noise_std: float | None) -> NDArray[np.float64]:
    """(p + 1, p + 1) covariance of the noise of regressors and target: sigma^2 sum g g^T, g the impulse responses of
    the noisy columns. The target has noise only in an equation with known terms of the output.

    noise_std: standard deviation of the position [unit of y]; None: resolution / sqrt(12), as of a quantiser whose
    error is white, which holds from about one count of motion per sample on.
    """
    sigma = estimator.encoder.resolution / np.sqrt(12.0) if noise_std is None else noise_std
    network, columns = estimator._columns
    return np.asarray(sigma**2 * impulse_products(estimator, network, columns[: len(estimator.names) + 1]))


def impulse_products(estimator: Estimator, network: Network, columns: list[Taps]) -> NDArray[np.float64]:
    """(c, c): sum over time of the products of the columns' responses to one wrong position."""
    parts = impulse_responses(estimator, network, columns)
    return np.asarray(sum((g @ g.T for g in parts), start=np.zeros(2 * (len(columns),))))


def impulse_responses(estimator: Estimator, network: Network, columns: list[Taps]) -> Iterator[NDArray[np.float64]]:
    """(c, n) one after the other: the columns' responses to one wrong position, of a low cutoff millions of samples."""
    samples, memories = 4 * estimator.settle_samples, [0.0 for _ in network.stages]
    for first in range(0, samples, TUNING.recursive_part):
        nodes = [np.zeros(min(TUNING.recursive_part, samples - first)) for _ in range(network.first)]
        if first == 0:
            nodes[VELOCITY][:2] = np.array([1.0, -1.0]) / estimator.dt  # the mean velocities of one wrong position
            nodes[SPLIT_FORWARD][1:3] = nodes[VELOCITY][:2]
            nodes[LATE_POSITION][1:3] = 0.5
        for k, (source, a, b0, b1) in enumerate(network.stages):
            if source == len(nodes):  # of the simulated motion, which an encoder's error does not reach
                nodes.append(np.zeros_like(nodes[0]))
                continue
            response, memories[k] = first_order(nodes[source], a, b0, b1, memories[k])
            nodes.append(response)
        yield np.array([sum(weight * nodes[node] for node, weight in taps) for taps in columns])


def compute_encoder_floor(estimator: Estimator) -> float:
    """The inverse square of what the encoder shows of the regressor of the highest derivative.

    An error of half a step at every sample, at the frequency that matters most, makes no larger root mean square than
    this: what is beyond is a motion.
    """
    builder = ColumnBuilder(estimator.equation, estimator.spec)
    column = builder.coefficient(estimator.equation.unknown[estimator.equation.leading], "measured")
    gain = np.max(np.abs(frequency_response(estimator, builder.network, column)))
    return float(max(estimator.encoder.resolution / 2 * gain, TUNING.recursive_least) ** -2)  # float32 holds that, too


def frequency_response(estimator: Estimator, network: Network, column: Taps) -> NDArray[np.complex128]:
    """(recursive_frequencies,) of a column to a wrong position, up to half the sampling frequency."""
    late = np.exp(-1j * np.geomspace(np.pi * 10.0**-TUNING.recursive_decades, np.pi, TUNING.recursive_frequencies))
    nodes = [np.zeros(TUNING.recursive_frequencies, complex) for _ in range(network.first)]
    nodes[VELOCITY] = (1 - late) / estimator.dt
    nodes[SPLIT_FORWARD] = late * nodes[VELOCITY]
    nodes[LATE_POSITION] = (late + late**2) / 2
    for source, a, b0, b1 in network.stages:
        nodes.append((b0 + b1 * late) / (1 - a * late) * nodes[source])
    return np.asarray(sum(weight * nodes[node] for node, weight in column), complex)


#: What becomes of old samples -> its number in the kernel.
FORGETTING_SCHEMES = {
    name: constants_of(None)[f"PMF_{name.upper().replace('-', '_')}"]
    for name in ("exponential", "directional", "constant-trace", "window")
}
#: The same of `forgetting_of`, which is a scheme of its own there.
SEPARATE = constants_of(None)["PMF_SEPARATE"]
#: Samples from one look of the kernel at the size of the motion to the next.
LOOK = constants_of(None)["PMF_LOOK"]


@dataclass(frozen=True)
class RecursiveEstimator(Estimator):
    """An `Estimator` that runs sample by sample.

    forgetting: weight of the past per sample, 0 < forgetting <= 1; the memory is dt / (1 - forgetting). With 1 float64
    forgets nothing; a sum of float32 would take in no more after some millions of samples, so there what was gathered
    counts by half whenever it is 2^19 samples.
    forgetting_scheme: one of four; none winds up without excitation,
    "exponential": every sample is forgotten alike; a small part of the largest information is never forgotten, and
    theta is held where that is all there is (Levenberg-Marquardt, Ljung and Soderstrom 1983);
    "directional": only in the directions that the samples excite (Cao and Schwartz 2000); least squares only. Nothing
    is lost at rest or at constant speed, however long, but to the noise of a coarse encoder, which excites, too. The
    memory of an excited direction is longer, by about the number of parameters;
    "constant-trace": as much as keeps the mean of P, each entry relative to its value after the first memory, and at
    most twice as fast as `forgetting` (Goodwin and Sin 1984, section 3.3);
    "window": the samples of the last memory alike, older ones not at all, in blocks of an eighth.
    forgetting_of: factors of single parameters, by name, that change more slowly than the others or never (1):
    {"b0": 1.0}. With the exponential scheme only; a parameter that is known to stay sharpens the others. In float32
    the memory of each is at most 2^19 samples in which the others are excited.
    The configuration is frozen; equality and hash are of it alone. What changes with the samples is a `Runner`:
    `start()` makes as many as are needed. For a single one there is `runner`, the object's own: `step`, `run`, `reset`
    and the like are short for its. A copy, by `copy`, `pickle` or a process pool, has a runner of its own that goes on
    from the same state; `dataclasses.replace` starts without samples.
    """

    forgetting: float = field(default=1.0, kw_only=True)
    forgetting_scheme: str = field(default="exponential", kw_only=True)
    forgetting_of: Mapping[str, float] | None = field(default=None, kw_only=True)
    runner: Runner[Self] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.forgetting, Real) or not 0 < self.forgetting <= 1:
            raise UsageError(
                f"forgetting must be in (0, 1], got {self.forgetting!r}; for a memory of T seconds use 1 - dt/T"
            )
        self._check_scheme()
        self._check_room()
        object.__setattr__(self, "runner", self.start())
        if type(self).step is RecursiveEstimator.step:  # bound here so that a call costs no look-up in Python
            object.__setattr__(self, "step", self.runner.kernel.step)

    def _check_scheme(self) -> None:
        scheme = self.forgetting_scheme
        if scheme not in FORGETTING_SCHEMES:
            raise UsageError(f"forgetting_scheme must be one of {sorted(FORGETTING_SCHEMES)}, got {scheme!r}")
        if refused := self.scheme_refused():
            raise UsageError(refused)
        for name, factor in (self.forgetting_of or {}).items():
            if name not in self.names or not self.forgetting <= factor <= 1:
                raise UsageError(
                    f"forgetting_of takes factors from forgetting = {self.forgetting} to 1 of {list(self.names)}, got "
                    f"{factor} of {name!r}"
                )
        if self.forgetting_of and scheme != "exponential":
            raise UsageError(f"forgetting_of is for the exponential scheme, not for {scheme}")

    def scheme_refused(self) -> str:
        """Why the method cannot forget in the way that is asked for, with a remedy; empty if it can."""
        if self.forgetting_scheme != "directional":
            return ""
        return (
            f"directional forgetting is for rls, not for {self.method}, whose instruments point elsewhere; "
            "use constant-trace or window"
        )

    def _check_room(self) -> None:
        most, model = self.kernel_class.max_parameters, self.model
        if len(self.names) > most:
            raise UsageError(
                f"{self.method} estimates at most {most} parameters, this {model.kind} has {len(self.names)}: "
                f"{', '.join(self.names)}; use fewer {self.plant.fewer}"
            )

    @property
    def _slowest(self) -> float:
        """Forgetting of a parameter that float32 can do: sums of such parameters are full at different samples, and no
        longer fit each other then. At rest all hold still, so that it costs nothing there."""
        return 1 - 1 / MOST_WEIGHT if self.precision == "float32" else 1.0

    @property
    def encoder_config(self) -> dict[str, float]:
        """Positions of a process with a constant count from the first one, as off-line: far from zero the filters would
        remember for long that they began there, and numbers of 32 bits do not hold its derivatives."""
        return super().encoder_config | {"from_first": int(level_of(self.equation) is not None)}

    @property
    def memory(self) -> float:
        return memory_of(self.forgetting, self.dt)

    def recursion_config(
        self, parameters: int, instrumental: bool, forgetting: float, first_column: int = 0
    ) -> dict[str, object]:
        config = super().recursion_config(parameters, instrumental, forgetting, first_column)
        level = level_of(self.equation)
        if level is not None and level.lowest is not None:  # the constant is read for the output itself
            config["constant"], config["lowest"] = level.constant, level.lowest
            config["lift"] = level.ratio * self.encoder.resolution
        scheme = self.forgetting_scheme if forgetting < 1 else "exponential"
        config["scheme"] = FORGETTING_SCHEMES[scheme]
        if forgetting < 1 and self.plant.rests:
            config["half_memory"] = math.ceil(0.5 / (1 - forgetting) / LOOK)
            config["haste"], config["leak"] = forgetting**TUNING.recursive_haste, math.exp(-TUNING.recursive_haste / 2)
            config["leading"], config["shown"] = self.equation.leading, compute_encoder_floor(self)
            directions = parameters if scheme == "directional" else 1
            config["forgetting"] = forgetting**directions  # one direction at a time: only so all have the same memory
            config["outgrown"] = TUNING.recursive_outgrown * LOOK
        if self.forgetting_of and forgetting < 1:  # as with directional forgetting: innovations only
            config["residual_updates"] = 0
            config["scheme"] = SEPARATE
            config["keep"] = [
                math.sqrt(min(self.forgetting_of.get(name, forgetting), self._slowest)) for name in self.names
            ]
        if scheme == "directional":  # the accumulated right-hand side does not follow the forgetting: innovations only
            config["residual_updates"] = 0
        if scheme == "constant-trace":  # bounds P by itself, but for a direction that others outgrow by far
            config["regularization"] = TUNING.trace_regularization
        if scheme == "window":
            config["residual_updates"] = 2**32 - 1
            config["window_block"] = math.ceil(1 / (1 - forgetting) / TUNING.window_blocks)
        return config

    def start(self, state: bytes | None = None) -> Runner[Self]:
        """An independent estimation, from the beginning or from a saved state.

        Raises UsageError for a state that is not of this configuration.
        """
        runner = Runner(self, self._allocate_kernel())
        if state is not None:
            runner.set_state(state)
        return runner

    def _allocate_kernel(self) -> Kernel:
        try:
            return self.make_kernel(self.forgetting)
        except ValueError as error:  # more than it holds
            raise UsageError(str(error)) from None

    def __reduce__(self) -> tuple[object, ...]:
        return _resume_estimator, (type(self), configuration_of(self), self.get_state())

    def step(self, u: float, counts: int, dt: float | None = None) -> Estimate:
        """One sample in, one estimate out: `Runner.step` of `runner`."""
        return self.runner.step(u, counts, dt)

    def run(self, u: ArrayLike, counts: ArrayLike, steps: ArrayLike | None = None) -> Track:
        """Many samples at once, from the present state: `Runner.run` of `runner`."""
        return self.runner.run(u, counts, steps)

    def run_many(self, u: ArrayLike, counts: ArrayLike, *, every: int | None = None) -> Tracks:
        """Many axes at once, each from the present state, which does not change: `Runner.run_many` of `runner`."""
        return self.runner.run_many(u, counts, every=every)

    @property
    def estimate(self) -> Estimate:
        """The present `Estimate`."""
        return self.runner.estimate

    def open_memory(self, keep: float, parameter: str | None = None) -> None:
        """After a change of the plant: `Runner.open_memory` of `runner`."""
        self.runner.open_memory(keep, parameter)

    def rebase(self, counts: int) -> None:
        """The counter was set to another value: `Runner.rebase` of `runner`."""
        self.runner.rebase(counts)

    def gap(self, counts: int) -> None:
        """Samples were lost: `Runner.gap` of `runner`. Raises UsageError for a linear process."""
        self.check_gaps()
        self.runner.gap(counts)

    def check_gaps(self) -> None:
        """Raises UsageError for a linear process, whose output says how it goes on only where nothing is missing."""
        if not self.plant.rests:
            raise UsageError(f"{self.method} of a linear process takes no gaps: reset it, or use srivc off-line")

    def doubt(self, samples: int) -> None:
        """The next samples are guesses: `Runner.doubt` of `runner`."""
        self.runner.doubt(samples)

    def reset(self) -> None:
        """Forgets all samples."""
        self.runner.reset()

    def get_state(self) -> bytes:
        """The whole state, to go on from in Python or in firmware: `Runner.get_state` of `runner`."""
        return self.runner.get_state()

    def set_state(self, state: bytes) -> None:
        """Continues from a saved state: `Runner.set_state` of `runner`."""
        self.runner.set_state(state)


def _resume_estimator(
    cls: type[RecursiveEstimator], configuration: Mapping[str, object], state: bytes
) -> RecursiveEstimator:
    estimator = construct_estimator(cls, configuration)
    estimator.set_state(state)
    return estimator


@dataclass(frozen=True)
class RLS(RecursiveEstimator):
    """Recursive least squares with exponential forgetting (paper eq. 33, first four lines).

    Parameters
    ----------
    model, encoder, dt, cutoff, forgetting
        As of `RIV`.
    prefilter_zeros : sequence of float, optional
        The estimate is then the biased one of the extended model (paper eq. 19 to 21), with the coefficients of f(s) as
        further parameters. The paper's compensation starts from that estimate.

    Notes
    -----
    The estimate is biased where the output is noisy or coarse, and its standard errors do not contain this bias. Those
    of `BCRLS` do not contain the bias from the direction of coarse counts. `identify` reports both as a model spread
    and as findings.

    Examples
    --------
    >>> from pmfid import RLS, Drive, Encoder
    >>> rls = RLS(Drive(1.0), Encoder(1e-5), 0.001, 50.0, forgetting=0.999)
    >>> estimate = rls.step(0.5, 0)
    >>> estimate.status_names
    ('starting', 'settling', 'standstill')
    """

    method: ClassVar[str] = "rls"

    def scheme_refused(self) -> str:
        return ""


@dataclass(frozen=True)
class BCRLS(RecursiveEstimator):
    """Bias-compensated recursive least squares (paper eq. 33 to 36).

    Parameters
    ----------
    model, encoder, dt, cutoff, forgetting
        As of `RIV`.

    Notes
    -----
    The method needs no noise variance. The noise may be coloured, as long as it is not correlated with the input. In
    exact arithmetic the estimate equals the paper's recursion with the affine right-hand side of a known input gain. It
    is computed as the instrumental variable estimate that it is (Soderstrom, Zheng and Stoica 1999 showed that for the
    discrete-time method): the facts H^T theta = h determine the coefficients of f(s), the unknown correlation cancels
    the normal equations of the noisy columns, and the noise-free columns are left as instruments. That costs less, and
    stays quiet where H^T P G passes through singularity.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid import BCRLS, Drive, Encoder, quantize
    >>> from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, prbs, simulate_drive
    >>> u = prbs(1500, clock=10, amplitude=4.0, rng=np.random.default_rng(1))
    >>> counts = quantize(simulate_drive(CART, u, CART_DT).x, CART_RESOLUTION)
    >>> bcrls = BCRLS(Drive(CART.input_gain), Encoder(CART_RESOLUTION), CART_DT, 20.0)
    >>> for force, count in zip(u, counts):
    ...     estimate = bcrls.step(force, count)
    >>> round(estimate["mass"], 2), estimate.status_names
    (1.07, ())
    """

    method: ClassVar[str] = "bcrls"
    instrumental: ClassVar[bool] = True
