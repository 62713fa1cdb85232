"""Builder of a network of first-order stages, which the kernel runs."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field

from pmfid.kernel.configuration import Kind, Rate
from pmfid.kernel.structures import constants_of

_KERNEL = constants_of(None)


def _nodes(*names: str) -> list[int]:
    return [_KERNEL[f"PMF_{name}"] for name in names]


#: The first nodes of a network are the kernel's signals: a block from the counts, then the same block from the
#: auxiliary model.
INPUT, VELOCITY, DIRECTION, MOVING = _nodes("INPUT", "VELOCITY", "DIRECTION", "MOVING")
FORWARD, BACKWARD = _nodes("FORWARD", "BACKWARD")
FORWARD_VELOCITY, BACKWARD_VELOCITY = _nodes("FORWARD_VELOCITY", "BACKWARD_VELOCITY")
(AUXILIARY,) = _nodes("AUXILIARY")
SPLIT_FORWARD, SPLIT_BACKWARD = _nodes("SPLIT_FORWARD", "SPLIT_BACKWARD")
LATE_INPUT, LATE_POSITION = _nodes("LATE_INPUT", "LATE_POSITION")
(ACCELERATION,) = _nodes("ACCELERATION")
POSITION, SPLIT_POSITION, MODEL_POSITION = _nodes("POSITION", "SPLIT_POSITION", "MODEL_POSITION")
(TURN,) = _nodes("TURN")  # node of direct methods if the step varies
MISREAD_INPUT, MISREAD_DIRECTION, MISREAD_MOVING = _nodes("MISREAD_INPUT", "MISREAD_DIRECTION", "MISREAD_MOVING")
ONE, START = _nodes("ONE", "START")  # nodes of a linear process, which has no auxiliary model
(SIGNALS,) = _nodes("SIGNALS")

Taps = list[tuple[int, float]]
#: Rule by which a stage follows a step that varies: the kind of the stage, and its pole times half the sample period.
Pace = tuple[Kind, float]


@dataclass
class Network:
    """Network of stages: node = b0 w + z^-1 (b1 w + a node), with the source w. The stages run in the order of the
    list.
    """

    stages: list[tuple[int, float, float, float]] = field(default_factory=list)
    #: node of the first stage
    first: int = SIGNALS
    slots: dict[Hashable, int] = field(default_factory=dict)
    #: rules of the stages that follow a step that varies, by node
    paces: dict[int, Pace] = field(default_factory=dict)

    def stage(self, source: int, a: float, b0: float, b1: float, pace: Pace | None = None) -> int:
        """Return the node of a stage. The stage is appended unless the network already contains an equal one."""
        entry = (source, a, b0, b1)
        if entry not in self.stages:
            self.stages.append(entry)
        node = self.first + self.stages.index(entry)
        if pace is not None:
            self.paces[node] = pace
        return node

    @property
    def rates(self) -> tuple[list[int], list[Rate]]:
        """Return the rate's number of each stage, from 1 on or 0 for no rate, and the rates (late, kind, half).

        The velocity of the counts belongs to the last interval. So does every signal that comes from this velocity,
        until a stage delays it.
        """
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
        """Return the node to which the auxiliary model writes the signal `key`. The stage of the node leaves the
        written value unchanged.

        Each key has one node.
        """
        if key not in self.slots:
            self.slots[key] = self.first + len(self.stages)
            self.stages.append((self.slots[key], 0.0, 1.0, 0.0))
        return self.slots[key]

    def delay(self, source: int) -> int:
        """Return the node of `source` delayed by one sample."""
        return self.stage(source, 0.0, 0.0, 1.0)


def scale_taps(taps: Taps, factor: float) -> Taps:
    """Return the taps with all weights multiplied by a factor."""
    return [(node, factor * weight) for node, weight in taps]
