"""A network of first-order stages under construction; the kernel runs it."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field

from pmfid.kernel.configuration import Kind, Rate
from pmfid.kernel.structures import constants_of

_KERNEL = constants_of(None)


def _nodes(*names: str) -> list[int]:
    return [_KERNEL[f"PMF_{name}"] for name in names]


#: The kernel's signals are its first nodes: a block from the counts, the same from the auxiliary model.
INPUT, VELOCITY, DIRECTION, MOVING = _nodes("INPUT", "VELOCITY", "DIRECTION", "MOVING")
FORWARD, BACKWARD = _nodes("FORWARD", "BACKWARD")
FORWARD_VELOCITY, BACKWARD_VELOCITY = _nodes("FORWARD_VELOCITY", "BACKWARD_VELOCITY")
(AUXILIARY,) = _nodes("AUXILIARY")
SPLIT_FORWARD, SPLIT_BACKWARD = _nodes("SPLIT_FORWARD", "SPLIT_BACKWARD")
LATE_INPUT, LATE_POSITION = _nodes("LATE_INPUT", "LATE_POSITION")
(ACCELERATION,) = _nodes("ACCELERATION")
POSITION, SPLIT_POSITION, MODEL_POSITION = _nodes("POSITION", "SPLIT_POSITION", "MODEL_POSITION")
(TURN,) = _nodes("TURN")  # of direct methods where the step varies
ONE, START = _nodes("ONE", "START")  # of a linear process, which has no auxiliary model
(SIGNALS,) = _nodes("SIGNALS")

Taps = list[tuple[int, float]]
#: How a stage follows a step that varies: its kind, and its pole times half the sample period.
Pace = tuple[Kind, float]


@dataclass
class Network:
    """Stages node = b0 w + z^-1 (b1 w + a node) of a source w, in the order in which they run."""

    stages: list[tuple[int, float, float, float]] = field(default_factory=list)
    #: node of the first stage
    first: int = SIGNALS
    slots: dict[Hashable, int] = field(default_factory=dict)
    #: of stages that follow a step that varies, by their nodes
    paces: dict[int, Pace] = field(default_factory=dict)

    def stage(self, source: int, a: float, b0: float, b1: float, pace: Pace | None = None) -> int:
        """Appends a stage, or finds the one that does the same; returns its node."""
        entry = (source, a, b0, b1)
        if entry not in self.stages:
            self.stages.append(entry)
        node = self.first + self.stages.index(entry)
        if pace is not None:
            self.paces[node] = pace
        return node

    @property
    def rates(self) -> tuple[list[int], list[Rate]]:
        """The number of each stage's rate, from 1 on, 0: none; and the rates: late, kind, half. The velocity of the
        counts belongs to the last interval, as does all that comes from it until it is delayed."""
        late = [int(signal != VELOCITY) for signal in range(self.first)]
        numbers, rates = list[int](), list[Rate]()
        for node, (source, _, b0, b1) in enumerate(self.stages, self.first):
            late.append(1 if source == node or (b0, b1) == (0.0, 1.0) else late[source])
            pace = self.paces.get(node)
            rate = None if pace is None else (late[node], *pace)
            if rate is not None and rate not in rates:
                rates.append(rate)
            numbers.append(0 if rate is None else 1 + rates.index(rate))
        return numbers, rates

    def slot(self, key: Hashable) -> int:
        """A node that the auxiliary model writes to, the same one for the same key: a stage that leaves there what it
        finds."""
        if key not in self.slots:
            self.slots[key] = self.first + len(self.stages)
            self.stages.append((self.slots[key], 0.0, 1.0, 0.0))
        return self.slots[key]

    def delay(self, source: int) -> int:
        """One sample later."""
        return self.stage(source, 0.0, 0.0, 1.0)


def scale_taps(taps: Taps, factor: float) -> Taps:
    """The same sum times a factor."""
    return [(node, factor * weight) for node, weight in taps]
