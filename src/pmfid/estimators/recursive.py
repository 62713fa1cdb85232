"""Recursive least squares, plain and with compensation of the encoder's bias."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from numbers import Integral, Real
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid._stage import first_order, products
from pmfid.elementary import cos_sin, exp, geometric, power
from pmfid.errors import UsageError
from pmfid.estimators.base import Estimator, memory_of
from pmfid.estimators.configuration import check_arrays, configuration_of, construct_estimator, resume_estimator
from pmfid.estimators.least_squares import level_of
from pmfid.estimators.results import Track
from pmfid.estimators.sample_steps import check_steps
from pmfid.filters.columns import ColumnBuilder
from pmfid.filters.network import LATE_POSITION, SPLIT_FORWARD, VELOCITY, Network, Taps
from pmfid.kernel.saved import load_state, save_state
from pmfid.kernel.structures import constants_of
from pmfid.types import Floats

if TYPE_CHECKING:
    from pmfid._estimate import Estimate
    from pmfid._kernel64 import Kernel

#: Samples of a response in memory at once.
RECURSIVE_PART = 2**17
#: Least encoder error in the leading column.
RECURSIVE_LEAST = 1e-18
#: Number of frequencies for the gain of an encoder's error, and their decades below the sampling frequency.
RECURSIVE_FREQUENCIES = 4096
RECURSIVE_DECADES = 9
#: Factor by which the recursion forgets information from larger earlier motions faster.
RECURSIVE_HASTE = 8
#: Information above this multiple of the last memory's information counts as that of larger motions.
RECURSIVE_OUTGROWN = 3


def noise_covariance(estimator: Estimator) -> NDArray[np.float64]:
    """Return the noise covariance (p + 1, p + 1) of the regressors and the target.

    The covariance is sigma^2 sum g g^T with the impulse responses g of the noisy columns. The target is noisy only if
    the equation has known output terms. The standard deviation sigma of the position is resolution / sqrt(12), the
    value for white quantisation. Quantisation is white above about one count of motion per sample.
    """
    network, columns = estimator._columns
    return np.asarray(
        estimator.encoder.rounding_variance * impulse_products(estimator, network, columns[: len(estimator.names) + 1])
    )


def impulse_products(estimator: Estimator, network: Network, columns: list[Taps]) -> NDArray[np.float64]:
    """Return the sum (c, c) over time of all products of the columns' responses to one wrong position."""
    parts = impulse_responses(estimator, network, columns)
    return np.asarray(sum((products(g) for g in parts), start=np.zeros(2 * (len(columns),))))


def impulse_responses(estimator: Estimator, network: Network, columns: list[Taps]) -> Iterator[NDArray[np.float64]]:
    """Yield parts (c, n) of the columns' responses to one wrong position. A low cutoff makes millions of samples."""
    samples, memories = 4 * estimator.settle_samples, [0.0 for _ in network.stages]
    for first in range(0, samples, RECURSIVE_PART):
        nodes = [np.zeros(min(RECURSIVE_PART, samples - first)) for _ in range(network.first)]
        if first == 0:
            nodes[VELOCITY][:2] = np.array([1.0, -1.0]) / estimator.dt  # mean velocities that one wrong position causes
            nodes[SPLIT_FORWARD][1:3] = nodes[VELOCITY][:2]
            nodes[LATE_POSITION][1:3] = 0.5
        for k, (source, a, b0, b1) in enumerate(network.stages):
            if source == len(nodes):  # an encoder's error does not reach the simulated motion
                nodes.append(np.zeros_like(nodes[0]))
                continue
            response, memories[k] = first_order(nodes[source], a, b0, b1, memories[k])
            nodes.append(response)
        yield np.array([sum(weight * nodes[node] for node, weight in taps) for taps in columns])


def compute_encoder_floor(estimator: Estimator) -> float:
    """Return the inverse square of the encoder's error in the regressor of the highest derivative. The bound is the
    error of half a count at every sample at the worst frequency. A regressor with a larger root mean square shows a
    motion.
    """
    builder = ColumnBuilder(estimator.equation, estimator.spec)
    column = builder.coefficient(estimator.equation.unknown[estimator.equation.leading], "measured")
    real, imaginary = frequency_response(estimator, builder.network, column)
    gain = math.sqrt(np.max(real * real + imaginary * imaginary))
    error = max(estimator.encoder.resolution / 2 * gain, RECURSIVE_LEAST)  # float32 holds the inverse square
    return 1 / (error * error)


#: Real and imaginary part (n,) of a complex signal. NumPy fuses the parts of a complex product on some processors.
Complex = tuple[Floats, Floats]


def _multiply(a: Complex, b: Complex) -> Complex:
    return a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]


def _scale(a: Complex, factor: float | Floats) -> Complex:
    return factor * a[0], factor * a[1]


def _add(a: Complex, b: Complex) -> Complex:
    return a[0] + b[0], a[1] + b[1]


@lru_cache
def _delay() -> Complex:
    """Return the response of a delay by one sample at the frequencies of `frequency_response`."""
    turns = geometric(0.5 * power(10.0, -RECURSIVE_DECADES), 0.5, RECURSIVE_FREQUENCIES)
    cosine, sine = cos_sin(turns)
    return cosine, -sine


def frequency_response(estimator: Estimator, network: Network, column: Taps) -> Complex:
    """Return the response (RECURSIVE_FREQUENCIES,) of a column to position errors up to half the sampling frequency."""
    late, none = _delay(), (np.zeros(RECURSIVE_FREQUENCIES), np.zeros(RECURSIVE_FREQUENCIES))
    nodes = [none for _ in range(network.first)]
    nodes[VELOCITY] = _scale((1 - late[0], -late[1]), 1 / estimator.dt)
    nodes[SPLIT_FORWARD] = _multiply(late, nodes[VELOCITY])
    nodes[LATE_POSITION] = _scale(_add(late, _multiply(late, late)), 0.5)
    for source, a, b0, b1 in network.stages:
        above, below = (b0 + b1 * late[0], b1 * late[1]), (1 - a * late[0], a * late[1])  # the conjugate of 1 - a late
        response = _multiply(_multiply(above, below), nodes[source])
        nodes.append(_scale(response, 1 / (below[0] * below[0] + below[1] * below[1])))
    total = none
    for node, weight in column:
        total = _add(total, _scale(nodes[node], weight))
    return total


#: Most samples between two solutions for theta.
LOOK = constants_of(None)["PMF_LOOK"]


@dataclass(frozen=True)
class RecursiveEstimator(Estimator):
    """An `Estimator` that runs sample by sample.

    forgetting: weight of the past per sample, 0 < forgetting <= 1. The memory is dt / (1 - forgetting). The value 1
    forgets nothing in float64. A float32 sum would ignore new samples after some millions of samples. In float32, the
    gathered information is halved whenever it amounts to 2^19 samples. With a finite memory of 32
    samples or more, theta, its covariance and the status are renewed every fourth sample, from all samples before it.
    Otherwise they are renewed at every sample.

    A small part of the largest information is never forgotten, and theta is held once only this part is left
    (Levenberg-Marquardt, Ljung and Soderstrom 1983). Nothing therefore winds up without excitation.

    The configuration is frozen and alone decides equality and hash. The `kernel` holds the state that samples change.
    A copy by `copy`, `pickle` or a process pool continues from the same state with the same bits, and shares nothing
    with the original. `start()` and `dataclasses.replace` return estimators without samples.
    """

    forgetting: float = field(default=1.0, kw_only=True)
    kernel: Kernel = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.forgetting, Real) or not 0 < self.forgetting <= 1:
            raise UsageError(
                f"forgetting must be in (0, 1], got {self.forgetting!r}; for a memory of T seconds use 1 - dt/T"
            )
        self._check_room()
        object.__setattr__(self, "kernel", self._allocate_kernel())
        self.kernel.names = self.names
        if type(self).step is RecursiveEstimator.step:  # an instance attribute saves a look-up in Python at each call
            object.__setattr__(self, "step", self.kernel.step)

    def _check_room(self) -> None:
        most, model = constants_of(None)["PMF_MAX_PARAMETERS"], self.model
        if len(self.names) > most:
            raise UsageError(
                f"{self.method} estimates at most {most} parameters, but this {model.kind} has "
                f"{len(self.names)}: {', '.join(self.names)}; use fewer {self.plant.fewer}"
            )

    @property
    def encoder_config(self) -> dict[str, float]:
        """Return the encoder's configuration for the kernel.

        Positions of a process with a constant count from the first position, as in off-line methods. Far from zero the
        filters would remember their start for long, and 32-bit numbers do not hold the derivatives.
        """
        return super().encoder_config | {"from_first": int(level_of(self.equation) is not None)}

    @property
    def delay(self) -> int:
        """Lag of estimates and status [samples], during which `Encoder.guard` waits for further counts."""
        return constants_of(None)["PMF_AHEAD"] if self.encoder_config["guard"] else 0

    @property
    def memory(self) -> float:
        return memory_of(self.forgetting, self.dt)

    def recursion_config(
        self, parameters: int, instrumental: bool, forgetting: float, first_column: int = 0
    ) -> dict[str, object]:
        config = super().recursion_config(parameters, instrumental, forgetting, first_column)
        level = level_of(self.equation)
        if level is not None and level.lowest is not None:  # the kernel's constant refers to the output itself
            config["constant"], config["lowest"] = level.constant, level.lowest
            config["lift"] = level.ratio * self.encoder.resolution
        if self.misreads and self._misread_columns[2]:
            config["noise"] = noise_covariance(self)[:-1, :-1].tolist()
        if self.plant.rests:
            config["leading"] = self.equation.leading
        # even outdated information must last from one solution to the next
        every = LOOK if 0 < LOOK * RECURSIVE_HASTE * (1 - forgetting) <= 1 else 1
        config["every"] = every
        if forgetting < 1 and self.plant.rests:
            config["half_memory"] = math.ceil(0.5 / (1 - forgetting) / every)
            config["haste"], config["leak"] = (
                power(forgetting, RECURSIVE_HASTE),
                exp(-RECURSIVE_HASTE / 2),
            )
            config["shown"] = compute_encoder_floor(self)
            config["outgrown"] = RECURSIVE_OUTGROWN * every
        return config

    def start(self, state: bytes | None = None) -> Self:
        """Return an independent estimator with the same configuration, without samples or from a saved state. Raises
        UsageError for a state of another configuration."""
        started = construct_estimator(type(self), configuration_of(self))
        if state is not None:
            started.set_state(state)
        return started

    def _allocate_kernel(self) -> Kernel:
        try:
            return self.make_kernel(self.forgetting)
        except ValueError as error:  # the system exceeds the kernel's size
            raise UsageError(str(error)) from None

    def __reduce__(self) -> tuple[object, ...]:
        return resume_estimator, (type(self), configuration_of(self), self.get_state())

    def step(self, u: float, counts: int, dt: float | None = None) -> Estimate:
        """Process one sample and return the estimate.

        `u` is the input from now on, and `counts` is the present count. `dt` is the time since the last sample [s] for
        an estimator with `steps`; None takes the sample period. The estimate has theta (p,), theta_cov (p, p),
        theta_std (p,), innovation, innovation_variance and status. The status flags a non-finite value, which never
        enters the estimate. Raises TypeError for a count that is no integer.
        """
        return self.kernel.step(u, counts, dt)

    def run(self, u: ArrayLike, counts: ArrayLike, steps: ArrayLike | None = None) -> Track:
        """Process samples u and counts (n,) from the present state, with the same bits as `step` in a loop.

        `steps` (n,) are the times between consecutive samples [s], for an estimator with `steps`. Raises UsageError if
        the arrays differ in length, if the counts are no integers, or if `steps` does not suit the estimator.
        """
        u, counts = check_arrays(u, counts)
        return Track(self.names, self.units, *self.kernel.run(u, counts, self._steps_of(steps, u.size)))

    def _steps_of(self, steps: ArrayLike | None, samples: int) -> Floats | None:
        asked = self.steps is not None
        checked = None if steps is None else check_steps(steps)
        if asked != (checked is not None) or (checked is not None and checked.size != samples):
            raise UsageError(
                'steps (n,) belong to an estimator that is made with steps="given": give one step for each '
                "sample, or leave steps out for any other estimator"
            )
        return checked

    @property
    def estimate(self) -> Estimate:
        """The present `Estimate`."""
        return self.kernel.estimate()

    def open_memory(self, keep: float, parameter: str | None = None) -> None:
        """Reduce the weight of the gathered information to the part `keep` in (0, 1], after a change of the plant.

        `parameter` is the name of the changed parameter. The information on the other parameters, given its value,
        stays. None reduces all information. The estimate stays and its variance grows (covariance reset in information
        form, Goodwin and Sin 1984). Filters and auxiliary model continue. Raises UsageError for an invalid `keep` or an
        unknown parameter.
        """
        if not isinstance(keep, Real) or not 0 < keep <= 1:
            raise UsageError(f"keep must be in (0, 1], got {keep!r}; with 0.001 new samples dominate at once")
        if parameter is not None and parameter not in self.names:
            raise UsageError(f"parameter must be one of {list(self.names)} or None, got {parameter!r}")
        self.kernel.open(keep, -1 if parameter is None else self.names.index(parameter))

    def rebase(self, counts: int) -> None:
        """Follow a counter that was set to another value, as in a homing.

        `counts` is the new counter's value for the last sample. The estimate stays. Without `rebase`, the estimator
        flags the jump and loses one sample of motion (`Encoder.guard`).
        """
        self.kernel.rebase(counts)

    def gap(self, counts: int) -> None:
        """Restart filters and auxiliary model after lost samples, from the next sample with these counts.

        The information stays. For a gap of few samples, a linear interpolation of input and counts is better. If the
        input may have leapt in the gap, call `doubt` first. Raises TypeError for counts that are no integer, and
        UsageError for a linear process.
        """
        self.check_gaps()
        self.kernel.gap(counts)

    def check_gaps(self) -> None:
        """Raise UsageError for a linear process, because its output continues predictably only without gaps."""
        if not self.plant.rests:
            raise UsageError(
                f"{self.method} of a linear process does not accept gaps: reset the estimator after a gap, or "
                "use srivc off-line"
            )

    def doubt(self, samples: int) -> None:
        """Mark the next `samples` samples as guesses, from which nothing is learnt.

        `doubt` suits a gap in which the input switched. In slow motion the estimator skips some further samples, at
        most the settling time of the filters, with the status `SETTLING`. Filters and auxiliary model continue. Raises
        UsageError for a negative or fractional number.
        """
        if isinstance(samples, bool) or not isinstance(samples, Integral) or not samples >= 0:
            raise UsageError(f"samples must be a whole number of at least 0, got {samples!r}")
        self.kernel.doubt(min(int(samples), 2**31))

    def reset(self) -> None:
        """Forget all samples."""
        self.kernel.reset()

    def get_state(self) -> bytes:
        """Return the whole state as bytes, with a version and checksums. `set_state` of an estimator with the same
        configuration continues from this state, and so does exported firmware."""
        return save_state(self.kernel, self.precision)

    def set_state(self, state: bytes) -> None:
        """Continue from a saved state.

        Raises UsageError, without a change of the estimator, for a damaged state and for a state of another
        configuration. Numbers that no sample could have made are refused even with a correct checksum.
        """
        load_state(self.kernel, self.precision, state)


@dataclass(frozen=True)
class RLS(RecursiveEstimator):
    """Recursive least squares with exponential forgetting (paper eq. 33, first four lines).

    Parameters
    ----------
    model, encoder, dt, cutoff, forgetting
        See `RIV`.
    prefilter_zeros : sequence of float, optional
        Zeros of the pre-filter [rad/s]. With these zeros, the result is the biased estimate of the extended model
        (paper eq. 19 to 21). The coefficients of f(s) are further parameters. The paper's compensation starts from this
        estimate.

    Notes
    -----
    A coarse output makes the estimate biased. The standard errors contain the bias from the known step of the encoder,
    and the largest plausible bias from a direction that counts show late. So do the standard errors of `BCRLS` for the
    direction. For other noise of the output, use `BCRLS` or `RIV`.

    Examples
    --------
    >>> from pmfid import RLS, Drive, Encoder
    >>> rls = RLS(Drive(1.0), Encoder(1e-5), 0.001, 50.0, forgetting=0.999)
    >>> estimate = rls.step(0.5, 0)
    >>> estimate.status_names
    ('starting', 'settling')
    """

    method: ClassVar[str] = "rls"
    misreads: ClassVar[bool] = True


@dataclass(frozen=True)
class BCRLS(RecursiveEstimator):
    """Bias-compensated recursive least squares (paper eq. 33 to 36).

    Parameters
    ----------
    model, encoder, dt, cutoff, forgetting
        See `RIV`.

    Notes
    -----
    The method needs no noise variance. The noise may be coloured, as long as it is not correlated with the input. In
    exact arithmetic the estimate equals the paper's recursion with the affine right-hand side of a known input gain.

    The implementation computes an equivalent instrumental variable estimate. Soderstrom, Zheng and Stoica (1999) showed
    the equivalence for discrete time. The facts H^T theta = h determine the coefficients of f(s). The unknown
    correlation cancels the normal equations of the noisy columns, and the noise-free columns remain as instruments.
    The equivalent computation is cheaper and stays smooth if H^T P G becomes singular.

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
    misreads: ClassVar[bool] = True
