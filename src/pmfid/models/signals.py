"""The signals that the terms of an equation are derivatives of, and what is true of each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

#: `output`: the measured position; `input`: what drives the plant; `direction`: sign of the velocity, at a
#: reversal inside a sample as the signed moving fraction; `moving`: 1 while the plant moves (a constant load);
#: `forward`, `backward`: 1 while it moves forward, -1 while it moves backward; `forward_output`, `backward_output`:
#: the position as far as it changes in that direction; `friction`: a shape of the speed or the position, against the
#: motion; `place`: a shape of the position, a force wherever the plant moves. Of a linear process, where rest means
#: nothing: `process_output`, from count zero; `process_input`, held; `constant`: 1; `start`: an impulse at the first
#: sample.
Signal = Literal[
    "output",
    "input",
    "direction",
    "moving",
    "forward",
    "backward",
    "forward_output",
    "backward_output",
    "friction",
    "place",
    "process_output",
    "process_input",
    "constant",
    "start",
]


@dataclass(frozen=True)
class SignalFacts:
    """What is true of a signal.

    reads: for people. derivatives: the lowest and the highest; those without hold for a sampling interval.
    measured: it is made of the measured output, and has its unit.
    of_motion: it holds what the direction of motion is, or whether there is one. one_way: it counts in one direction.
    keeps_sign: where input and output turn theirs. of_process: it is one of a linear process. shaped: its
    term has a shape.
    """

    reads: str
    derivatives: tuple[int, int] = (0, 0)
    measured: bool = False
    of_motion: bool = False
    one_way: bool = False
    keeps_sign: bool = False
    of_process: bool = False
    shaped: bool = False


SIGNALS: dict[Signal, SignalFacts] = {
    "output": SignalFacts("x", (0, 2), measured=True),
    "input": SignalFacts("u", (0, 1)),
    "direction": SignalFacts("sign(x')", of_motion=True),
    "moving": SignalFacts("(while it moves)", of_motion=True, keeps_sign=True),
    "forward": SignalFacts("(moving forward)", of_motion=True, one_way=True),
    "backward": SignalFacts("(moving backward)", of_motion=True, one_way=True),
    "forward_output": SignalFacts("(x forward)", (1, 1), measured=True, one_way=True),
    "backward_output": SignalFacts("(x backward)", (1, 1), measured=True, one_way=True),
    "friction": SignalFacts("sign(x')", of_motion=True, shaped=True),
    "place": SignalFacts("(while it moves)", of_motion=True, shaped=True),
    "process_output": SignalFacts("y", (0, 6), measured=True, of_process=True),
    "process_input": SignalFacts("u", (0, 6), of_process=True),
    "constant": SignalFacts("", keeps_sign=True, of_process=True),
    "start": SignalFacts("(impulse at the first sample)", (0, 5), keeps_sign=True, of_process=True),
}
PROCESS_SIGNALS = tuple(signal for signal, facts in SIGNALS.items() if facts.of_process)
