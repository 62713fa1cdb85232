"""A counter or an angle that wraps, seen in the counts alone."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Wrap", "wrap_of"]

#: Once the wrap is undone: largest change, as a part of the range; largest roughness, as a part of the former one.
ROOM, SMOOTHER = 0.25, 0.1
#: Jumps of one size differ by at most this part of it.
ALIKE = 0.05
#: Largest relative distance of a range from whole turns.
WHOLE_TURNS = 0.005
#: Largest width of a counter; least range of the counts, for over fewer any motion may look like a jump.
MOST_BITS, LEAST = 32, 8


@dataclass(frozen=True)
class Wrap:
    """span: range over which counts wrap; times: number of wraps; row: of the first wrap, counted from 1."""

    span: int
    times: int
    row: int

    @property
    def bits(self) -> int | None:
        """The width of a counter of that range, None if the range is no power of two."""
        return self.span.bit_length() - 1 if self.span.bit_count() == 1 else None

    def describe_mistake(self, column: str, kind: str, resolution: float, unit: str) -> tuple[str, str]:
        """The mistake and its remedy, for an output column of that output_kind; unit: of the resolution."""
        size = self.span if kind == "counts" else self.span * resolution
        what = f"the output column {column!r} wraps at {size:.4g}, the first time at row {self.row}"
        if kind == "counts" and self.bits is not None:
            return what, f"give [encoder] bits = {self.bits}"
        travel = self.span * resolution
        turns = round(travel / (2 * math.pi))
        whole = turns > 0 and abs(travel / (2 * math.pi * turns) - 1) < WHOLE_TURNS
        return (
            what,
            f'give [encoder] range = "{turns} rev"' if whole else f'give [encoder] range = "{travel:.9g} {unit}"',
        )


def wrap_of(counts: NDArray[np.int64]) -> Wrap | None:
    """The wrap of counts (n,): the largest changes are all nearly the range of the counts, and once undone they leave a
    smooth motion; None without a wrap."""
    change, extent = np.diff(counts), int(np.ptp(counts))
    jumps = np.abs(change) > extent / 2
    usual = int(np.max(np.abs(change[~jumps]), initial=0))
    if extent < LEAST or not np.any(jumps) or usual == 0:  # without motion between the jumps, these are the motion
        return None
    for span in _spans(change, jumps, usual, extent):
        undone = (change + span // 2) % span - span // 2
        if not _smooth(change, undone, jumps, usual, span):
            continue
        found = Wrap(span, int(np.sum(undone != change)), int(np.argmax(undone != change)) + 2)
        # one shift of a counter's zero has any size
        return found if found.bits is not None or found.times > 1 else None
    return None


def _smooth(
    change: NDArray[np.int64], undone: NDArray[np.int64], jumps: NDArray[np.bool_], usual: int, span: int
) -> bool:
    """Do the undone changes give a motion in which the former jumps are like the other changes?"""
    rough, smooth = (float(np.sum(np.diff(series.astype(np.float64)) ** 2)) for series in (change, undone))
    alike = np.max(np.abs(undone[jumps])) <= 2 * usual + 2
    return bool(alike and np.max(np.abs(undone)) <= ROOM * span and smooth <= SMOOTHER * rough)


def _spans(change: NDArray[np.int64], jumps: NDArray[np.bool_], usual: int, extent: int) -> list[int]:
    """Ranges to try: the range of a counter, and the size of the jumps, for another period such as a turn."""
    counter = 2 ** math.ceil(math.log2(extent + 1))
    sizes = np.abs(change[jumps])
    spans = [counter] if counter <= 2**MOST_BITS else []
    typical = round(float(np.median(sizes)) + float(np.median(np.abs(change[~jumps]))))
    return [*spans, max(typical, extent + 1)] if np.ptp(sizes) <= ALIKE * extent + 2 * usual else spans
