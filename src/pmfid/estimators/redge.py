"""Mass and friction from the instants of the encoder's edges, on-line."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar, cast

import numpy as np
from numpy.typing import ArrayLike

from pmfid.encoder import Encoder
from pmfid.errors import UsageError, check_choice
from pmfid.estimators import PRECISIONS
from pmfid.estimators.configuration import (
    check_arrays,
    check_edges,
    check_positive,
    configuration_of,
    resume_estimator,
)
from pmfid.estimators.results import Track
from pmfid.kernel.saved import load_edge_state, save_edge_state
from pmfid.models.drive import Drive
from pmfid.models.equation import ESTIMATE, Equation

if TYPE_CHECKING:
    from pmfid._estimate import Estimate
    from pmfid._kernel64 import EdgeKernel

#: On-line each line has 8 sums; this many lines are 4 MB.
MOST_LINES = 65536


@dataclass(frozen=True)
class REdge:
    """Recursive prediction errors at the instants of the encoder's edges, on-line.

    Parameters
    ----------
    model : Drive
        A drive with mass, viscous and Coulomb friction, and a known input gain. It may have an offset.
    encoder : Encoder
        Encoder with its resolution and the width of its counter.
    dt : float
        Sample period [s].
    lines : int, optional
        Counts after which the lines repeat, as in one revolution. With None each count has a line of its own, as on a
        linear scale.
    tick : float
        Period of the timer that takes the instants [s].
    memory : float, optional
        Time constant of forgetting [s] of motion. With None nothing is forgotten.
    precision : {"float64", "float32"}
        Number format of the recursion.

    Raises
    ------
    UsageError
        A value is outside these bounds, or the model has further terms.

    Notes
    -----
    No initial guess is needed: the first parameters come from the divided differences of the edges. A change of the
    machine is noticed by the innovations, and the recursion restarts. Until the first estimate, and after a loss of the
    motion, the status has `Status.STARTING`. Large or correlated innovations set `Status.UNMODELLED`, also for a time
    after a change. Instants that are late by more than 0.1 ms set `Status.DEAD_TIME`.

    With an offset F, Coulomb friction C may differ between the directions: C + F forward, and C - F backward.

    A sample with several edges gives the age of the last one. All instants may come late by a common time.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid import Drive, Encoder, REdge
    >>> from pmfid.simulation import CART, capture_edges, prbs, simulate_drive
    >>> u = prbs(2000, clock=10, amplitude=4.0, rng=np.random.default_rng(1))
    >>> motion = simulate_drive(CART, np.repeat(u, 10), 1e-3)
    >>> counts, ages = capture_edges(motion, 0.0058, every=10, tick=1e-6)
    >>> estimator = REdge(Drive(CART.input_gain), Encoder(0.0058), 0.01, lines=16, tick=1e-6)
    >>> estimator.run(u, counts, ages).theta[-1].round(3)
    array([ 1.07, 12.8 ,  0.8 ])
    """

    model: Drive
    encoder: Encoder
    dt: float
    lines: int | None = field(default=None, kw_only=True)
    tick: float = field(default=0.0, kw_only=True)
    memory: float | None = field(default=None, kw_only=True)
    precision: str = field(default="float64", kw_only=True)
    kernel: EdgeKernel = field(init=False, repr=False, compare=False)
    method: ClassVar[str] = "redge"

    def __post_init__(self) -> None:
        check_positive("dt", self.dt, "it is the sample period in s")
        self._check_model()
        check_edges(self.lines, self.tick, self.dt, MOST_LINES)
        if self.memory is not None:
            check_positive(
                "memory", self.memory, "it is the time constant of forgetting in s, or None for no forgetting"
            )
        check_choice("precision", self.precision, PRECISIONS)
        object.__setattr__(self, "kernel", self._new_kernel())

    def _check_model(self) -> None:
        if not is_plain(self.model):
            raise UsageError(
                "REdge accepts only a Drive with a known input_gain, whose parameters are mass, viscous and Coulomb "
                "friction, and offset; for further terms use EdgeFit off-line"
            )

    def _new_kernel(self) -> EdgeKernel:
        from pmfid import _kernel32, _kernel64

        module = _kernel32 if self.precision == "float32" else _kernel64
        gain = float(self.model.input_gain)
        memory = 0.0 if self.memory is None else self.memory
        settings = (self.dt, self.encoder.resolution, gain, self.tick, memory, int(self.lines or 0))
        return cast("EdgeKernel", module.EdgeKernel(self.names, *settings, 2 ** (self.encoder.bits - 1)))

    def __reduce__(self) -> tuple[object, ...]:
        return resume_estimator, (type(self), configuration_of(self), self.get_state())

    @property
    def rate(self) -> float:
        """Part of the information that is forgotten in a sample of motion, 0 without forgetting."""
        return 0.0 if self.memory is None else self.dt / self.memory

    @property
    def equation(self) -> Equation:
        """The equation of the model."""
        return self.model.equation

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return self.model.equation.names

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the parameters."""
        return self.model.equation.units

    @property
    def estimate(self) -> Estimate:
        """The estimate after the last sample."""
        return self.kernel.estimate()

    @property
    def theta(self) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        """Parameters (p,) after the last sample."""
        return self.estimate.theta

    @property
    def theta_std(self) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        """Standard deviations (p,) after the last sample, infinite without an estimate."""
        return self.estimate.theta_std

    @property
    def status(self) -> int:
        """`Status` bits after the last sample."""
        return self.estimate.status

    def step(self, u: float, counts: int, age: float | None = None) -> Estimate:
        """Take a sample and return the estimate.

        Parameters
        ----------
        u : float
            Input from now on.
        counts : int
            Present counts.
        age : float, optional
            Time from the last edge to now [s]; None or NaN without an edge since the last sample.
        """
        return self.kernel.step(u, counts, np.nan if age is None else age)

    def run(self, u: ArrayLike, counts: ArrayLike, ages: ArrayLike) -> Track:
        """Take n samples, and return the estimate after each.

        Parameters
        ----------
        u, counts, ages : array_like (n,)
            The arguments of `step`.

        Raises
        ------
        UsageError
            The arrays do not fit each other.
        """
        known, whole = check_arrays(u, counts)
        given = np.ascontiguousarray(ages, np.float64)
        if given.shape != whole.shape:
            raise UsageError(f"ages must have the shape of counts, {whole.shape}, got {given.shape}")
        theta, variance, innovation, running, status = self.kernel.run(known, whole, given)
        return Track(self.names, self.units, theta, variance, np.zeros_like(theta), innovation, running, status)

    def reset(self) -> None:
        """Return to the state before the first sample."""
        self.kernel.reset()

    def expect(self, theta: ArrayLike) -> None:
        """Begin again at the next edges, from parameters theta (p,) that may be off by a factor of three.

        Raises UsageError for parameters that are not finite. All but the offset must be positive.
        """
        given = np.ascontiguousarray(theta, np.float64)
        if given.shape != (len(self.names),) or not np.all(np.isfinite(given)) or not np.all(given[:3] > 0):
            raise UsageError(
                f"theta must contain finite values of {list(self.names)}, all positive except an offset, got {theta!r}"
            )
        self.kernel.expect(given)

    def get_state(self) -> bytes:
        """Return the state, as firmware with the same configuration saves it."""
        return save_edge_state(self.kernel, self.precision)

    def set_state(self, state: bytes) -> None:
        """Take the bytes of `get_state`, or of such firmware. Raises UsageError for anything else."""
        load_edge_state(self.kernel, self.precision, state)


def is_plain(model: object) -> bool:
    """Return whether a model is a drive with the terms of the recursion over edges and a known input gain."""
    if not isinstance(model, Drive) or model.input_gain == ESTIMATE:
        return False
    return model == Drive(model.input_gain, offset=model.offset, axis=model.axis)
