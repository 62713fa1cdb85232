"""The samples that one estimate of a history is made of."""

from __future__ import annotations

from dataclasses import dataclass

from pmfid.types import Counts, Floats


@dataclass(frozen=True)
class Stretch:
    """Samples (n,) of one segment, without a gap. samples: of the record, with the rests that are left out; lost: part
    of them that was filled in; repeats: how often each is among the n; looked_at: is it one for a second look?"""

    axis: str
    start: float
    end: float
    samples: int
    dt: float
    resolution: float
    u: Floats
    counts: Counts
    lost: float
    repeats: float
    looked_at: bool = False
