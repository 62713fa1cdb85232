"""Fleets: many axes at once, as the machines of a plant or the runs of a simulation study."""

from __future__ import annotations

from typing import cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.errors import UsageError, whole_number
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.results import Tracks
from pmfid.estimators.runner import Runner
from pmfid.kernel.structures import whole_words


def runner_of(estimator: RecursiveEstimator | Runner[RecursiveEstimator]) -> Runner[RecursiveEstimator]:
    """Return the runner from which all axes start. Raises UsageError for an estimator that is not recursive."""
    if not isinstance(estimator, RecursiveEstimator | Runner):
        what = getattr(estimator, "method", type(estimator).__name__)
        raise UsageError(f"a fleet runs sample by sample, and {what} does not; use rls, bcrls or riv")
    return cast("Runner[RecursiveEstimator]", estimator if isinstance(estimator, Runner) else estimator.runner)


class Fleet:
    """Many axes with the configuration of one recursive estimator. Each axis has its own state.

    The estimates of every axis equal those of the estimator alone, bit by bit. Vector instructions and threads compute
    many axes at once. A copy (`copy`, `pickle`, a process pool) continues with the same bits.

    Parameters
    ----------
    estimator : recursive estimator or Runner
        All axes start from the present state of the estimator, which does not change.
    axes : int
        Number of axes, >= 1.
    workers : int, optional
        Number of threads, >= 1. The default is the number of processors.

    Raises
    ------
    UsageError
        A number is outside these bounds, the estimator is not recursive, or the memory cannot hold them.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid import BCRLS, Drive, Encoder, Fleet, quantize
    >>> from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, prbs, simulate_drive
    >>> u = np.array([prbs(1500, clock=10, amplitude=4.0, rng=np.random.default_rng(seed)) for seed in (1, 2)])
    >>> counts = np.array([quantize(simulate_drive(CART, one, CART_DT).x, CART_RESOLUTION) for one in u])
    >>> fleet = Fleet(BCRLS(Drive(CART.input_gain), Encoder(CART_RESOLUTION), CART_DT, 20.0), axes=2)
    >>> fleet.run(u, counts)["mass"][:, -1].round(2)
    array([1.07, 1.07])
    """

    def __init__(
        self, estimator: RecursiveEstimator | Runner[RecursiveEstimator], axes: int, *, workers: int | None = None
    ) -> None:
        first = runner_of(estimator)
        self._source = first  # the configuration remains available if this runner continues
        self._many = first.side_by_side(axes, workers)
        self.axes, self.workers = self._many.axes, self._many.workers
        self._first = self._many.kernel.states[:1].copy()

    def __reduce__(self) -> tuple[object, ...]:
        return _resume_fleet, (self.estimator, self._first, self.axes, self.workers, self.get_state())

    @property
    def estimator(self) -> RecursiveEstimator:
        """New estimator with the configuration of the fleet."""
        return self._source.estimator

    def __repr__(self) -> str:
        return f"Fleet({self.estimator!r}, {self.axes}, workers={self.workers})"

    def run(self, u: ArrayLike, counts: ArrayLike, *, every: int | None = None) -> Tracks:
        """Process the next n samples of every axis, from its present state, and return the estimates.

        `u` and `counts` are (axes, n); a `u` (n,) holds for all axes. Arrays of float32, float64, int32 or int64 are
        read in place, in any memory order. `every` is the number of samples from one kept estimate to the next. The
        last estimate is always kept, and None keeps only the last one. Raises UsageError if the arrays do not match,
        the counts are no integers, or the memory does not hold the kept estimates.
        """
        return self._many.run(u, counts, every)

    def axis(self, index: int) -> RecursiveEstimator:
        """Return a new estimator of the same configuration in the state of one axis."""
        single, place = self.estimator, self._place(index)
        self._many.kernel.load(single.runner.kernel, place)
        return single

    def gap(self, index: int, counts: int) -> None:
        """Report a gap in the samples of one axis; `counts` are those of its next sample.

        Raises TypeError if the counts are no integer. Raises UsageError if the axis does not exist, and for linear
        processes.
        """
        self.estimator.check_gaps()
        self._many.kernel.gap(self._place(index), counts)

    def _place(self, index: int) -> int:
        index = whole_number("index", index, None, "it is the number of an axis")
        if not -self.axes <= index < self.axes:
            raise UsageError(f"the axis must be from 0 to {self.axes - 1}; got {index}")
        return index % self.axes

    def reset(self) -> None:
        """Reset every axis to the state in which the fleet was made."""
        self._many.kernel.reset()

    def get_state(self) -> bytes:
        """Return the states of all axes, with a version and checksums.

        `set_state` of a fleet with the same configuration and number of axes continues from these states.
        """
        from pmfid.kernel.saved import save_fleet

        return save_fleet(self._many.kernel, self._source.precision)

    def set_state(self, state: bytes) -> None:
        """Continue from saved states.

        Raises UsageError, without any change of the fleet, if the states are damaged or impossible, or have another
        configuration or number of axes.
        """
        from pmfid.kernel.saved import load_fleet

        load_fleet(self._many.kernel, self._source.precision, state)


def _resume_fleet(
    estimator: RecursiveEstimator, first: NDArray[np.uint8], axes: int, workers: int, state: bytes
) -> Fleet:
    runner = estimator.start()
    single = runner.kernel.many(1, whole_words(runner.precision))
    single.set_states(first)
    single.load(runner.kernel, 0)
    fleet = Fleet(runner, axes, workers=workers)
    fleet.set_state(state)
    return fleet
