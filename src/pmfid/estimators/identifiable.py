"""Can columns identify every parameter? Which one they cannot, and why."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmfid.errors import NotIdentifiableError
from pmfid.estimators.plants import START_PIVOT
from pmfid.estimators.results import Columns
from pmfid.status import Status

#: A target closer than this to one regressor alone, relative to its size, identifies nothing else.
TARGET_APART = 1e-6
TINY = 1e-300
#: The square of a number must not leave the format.
BEYOND = 1e120


def check_identifiable(
    columns: Columns, names: tuple[str, ...], least_part: float = START_PIVOT, simulated: bool = False
) -> None:
    """Raises NotIdentifiableError where a column is zero or a combination of the others, naming the parameter.
    simulated: the equation holds while a simulated motion moves, and says nothing while that rests."""
    if columns.z.size <= 2 * len(names) and columns.status & Status.COUNT_JUMP:
        raise NotIdentifiableError(
            "the counts jump all the time: check the wiring and the counter's bits, or correct max_speed"
        )
    if columns.z.size <= 2 * len(names):
        raise NotIdentifiableError(
            f"only {columns.z.size} samples are left after the filters have settled, too few for {len(names)} "
            "parameters; record longer, or use a higher cutoff"
        )
    if not max(np.max(np.abs(part)) for part in (columns.phi, columns.z, columns.zeta)) < BEYOND:
        raise NotIdentifiableError(
            "the motion, or the one simulated, leaves the range of numbers: check the scales of input and output, and "
            "the signs in [model]"
        )
    if not np.any(columns.phi[:, 0]):
        raise NotIdentifiableError("the axis does not move in this record: nothing can be identified; record a motion")
    if not np.any(columns.z) and simulated:
        raise NotIdentifiableError(
            "the simulated motion rests throughout, held by friction or a load above what the input can move: check "
            "input_gain and the model"
        )
    if not np.any(columns.z):
        raise NotIdentifiableError(
            "after the filters have settled the input is zero while the axis moves: record the input that drives it, "
            "from before the motion on"
        )
    _check_target(columns, names)
    for kind, matrix in (("regressor", columns.phi), ("instrument", columns.zeta)):
        _check_rank(kind, matrix, names, least_part)


def _check_target(columns: Columns, names: tuple[str, ...]) -> None:
    """An input that is explained by friction alone says nothing of the mass: encoder noise would decide."""
    for name, column in zip(names, columns.phi.T, strict=True):
        norm = float(np.linalg.norm(column))
        apart = np.linalg.norm(columns.z - column * (columns.z @ column) / max(norm**2, TINY))
        if norm > 0 and apart < TARGET_APART * np.linalg.norm(columns.z):
            raise NotIdentifiableError(
                f"the input is proportional to the regressor of {name} throughout: too little excitation; record "
                "reversals, and an input that changes while the axis moves"
            )


def _check_rank(kind: str, matrix: NDArray[np.float64], names: tuple[str, ...], least_part: float) -> None:
    scale = np.linalg.norm(matrix, axis=0)
    for name, norm in zip(names, scale, strict=True):
        if norm == 0:
            raise NotIdentifiableError(f"the {kind} of {name} is zero throughout: the record says nothing about it")
    inverse = np.linalg.pinv(np.linalg.qr(matrix / scale, mode="r"))  # its rows are as long as those for the matrix
    own = 1 / np.sum(inverse**2, axis=1)  # what of a column is not a combination of the others
    worst = int(np.argmin(own))
    if own[worst] < least_part:
        raise NotIdentifiableError(
            f"the {kind} of {names[worst]} follows from the others to {np.sqrt(own[worst]):.1g} of its size: too "
            "little excitation; record reversals, and speeds and accelerations that vary"
        )
