"""What comes in: blocks of numbered samples, lines with a time, and what could not be used."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from pmfid.session.monitored.timeline import Line
from pmfid.types import Counts, Floats

__all__ = ["Block", "Delivery", "Item", "Lines", "Unusable"]

#: JSON of a source by which it goes on after a restart, as the place in a file.
Mark = dict[str, int | float | str]


@dataclass(frozen=True)
class Block:
    """Samples of one axis that follow one another, numbered by the sender.

    axis: its name; epoch: what the sender raises when its numbers begin anew, as after a restart of the drive; first:
    number of the first sample, 0 or more; time: of the first sample by the sender's clock [s], NaN where it has none;
    dt: the sender's sample period [s]; u: (n,) input in the unit of the model, NaN where a sample is lost; counts:
    (n,).
    """

    axis: str
    epoch: int
    first: int
    time: float
    dt: float
    u: Floats
    counts: Counts

    @property
    def end(self) -> int:
        """Number of the sample behind the last."""
        return self.first + self.counts.size


@dataclass(frozen=True)
class Lines:
    """Samples of one axis that have a time in place of a number, as a logger writes them."""

    axis: str
    lines: Sequence[Line]


@dataclass(frozen=True)
class Unusable:
    """Something that came and is no sample. reason: a short fixed word, as "crc", for counters; problem: a sentence;
    axis: its name where that is known, else ""."""

    reason: str
    problem: str
    axis: str = ""


Item = Block | Lines | Unusable


@dataclass(frozen=True)
class Delivery:
    """What a source hands over at once.

    source: its name in PLANT.toml; items: in the order in which they came; done: called, from any thread and at most
    once, when all of it is in a checkpoint that a restart would find, or at once where no checkpoints are kept; a
    source that can acknowledge does it then; mark: where the source stands behind this delivery, kept in that
    checkpoint; received: `time.monotonic()` when it came.
    """

    source: str
    items: Sequence[Item]
    done: Callable[[], None] | None = None
    mark: Mark | None = field(default=None)
    received: float = 0.0
