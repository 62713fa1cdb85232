"""Common parts of studies: a record of the cart, its estimator, and a table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmfid.encoder import Encoder
from pmfid.estimators.base import Estimator
from pmfid.estimators.configuration import construct_estimator
from pmfid.estimators.registry import ESTIMATORS
from pmfid.models.drive import Drive
from pmfid.simulation import CART, CART_DT
from pmfid.types import Floats

#: Filter time constant in samples, unless a table says otherwise.
TIME_CONSTANT = 3


@dataclass(frozen=True, eq=False)
class CartRecord:
    """Input u [V] and counts, each (n,); resolution [m per count]."""

    u: Floats
    counts: NDArray[np.int64]
    resolution: float


def make_estimator(
    method: str,
    record: CartRecord,
    time_constant: float = TIME_CONSTANT,
    input_gain: float = CART.input_gain,
    **options: object,
) -> Estimator:
    """Return the method on the cart's model; `time_constant` of the filters is in samples."""
    cutoff = 1 / (time_constant * CART_DT)
    own = {"model": Drive(input_gain), "encoder": Encoder(record.resolution), "dt": CART_DT, "cutoff": cutoff}
    return construct_estimator(ESTIMATORS[method], own | options)


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return a Markdown table, and the empty line after it."""
    lines = ["| " + " | ".join(cells) + " |" for cells in (header, *rows)]
    return [lines[0], "|" + "---|" * len(header), *lines[1:], ""]
