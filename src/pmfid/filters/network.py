"""A network of first-order stages under construction; the kernel runs it."""

from __future__ import annotations

from dataclasses import dataclass, field

#: The kernel's signals are its first nodes (csrc/pmf.h): a block from the counts, the same from the auxiliary model.
INPUT, VELOCITY, DIRECTION, MOVING, FORWARD, BACKWARD, FORWARD_VELOCITY, BACKWARD_VELOCITY = range(8)
AUXILIARY = 8
SPLIT_FORWARD, SPLIT_BACKWARD = 16, 17
LATE_INPUT, LATE_VELOCITY = 18, 19
ACCELERATION = 20
LATE_POSITION = 21
POSITION, SPLIT_POSITION, MODEL_POSITION = 22, 23, 24
ONE, START = AUXILIARY, AUXILIARY + 1  # of a linear process, which has no auxiliary model
SIGNALS = 25

Taps = list[tuple[int, float]]


@dataclass
class Network:
    """Stages node = b0 w + z^-1 (b1 w + a node) of a source w, in the order in which they run."""

    stages: list[tuple[int, float, float, float]] = field(default_factory=list)
    #: node of the first stage
    first: int = SIGNALS

    def stage(self, source: int, a: float, b0: float, b1: float) -> int:
        """Appends a stage, or finds the one that does the same; returns its node."""
        entry = (source, a, b0, b1)
        if entry not in self.stages:
            self.stages.append(entry)
        return self.first + self.stages.index(entry)

    def delay(self, source: int) -> int:
        """One sample later."""
        return self.stage(source, 0.0, 0.0, 1.0)


def scaled(taps: Taps, factor: float) -> Taps:
    """The same sum times a factor."""
    return [(node, factor * weight) for node, weight in taps]
