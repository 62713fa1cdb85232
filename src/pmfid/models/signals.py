"""Signals of an equation, and the facts about each signal. Each term of an equation is a derivative of a signal."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

#: Signals of a machine:
#: `output`: the measured position.
#: `input`: the input that drives the plant.
#: `direction`: the sign of the velocity. If the motion reverses inside a sample, the value is the signed moving
#: fraction.
#: `moving`: 1 while the plant moves, for a constant load.
#: `forward`, `backward`: 1 while the plant moves forward, and -1 while it moves backward.
#: `forward_output`, `backward_output`: the part of the position that changes in that direction.
#: `friction`: a shape of the speed or the position, which acts against the motion.
#: `place`: a shape of the position, a force that acts while the plant moves.
#: Signals of a linear process, for which rest has no meaning:
#: `process_output`: the output, which counts from count zero.
#: `process_input`: the held input.
#: `constant`: 1.
#: `start`: an impulse at the first sample.
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
    """Facts about a signal.

    `reads` names the signal for people. `derivatives` are the lowest and the highest derivative. A signal without
    derivatives is constant during a sampling interval. `measured` means that the signal comes from the measured output
    and has the unit of the output. `one_way` means that the signal counts in one direction only. `keeps_sign` means
    that the signal keeps its sign if input and output change theirs. `of_process` marks a signal of a linear process.
    `shaped` means that the term of the signal has a shape.
    """

    reads: str
    derivatives: tuple[int, int] = (0, 0)
    measured: bool = False
    one_way: bool = False
    keeps_sign: bool = False
    of_process: bool = False
    shaped: bool = False


SIGNALS: dict[Signal, SignalFacts] = {
    "output": SignalFacts("x", (0, 2), measured=True),
    "input": SignalFacts("u"),
    "direction": SignalFacts("sign(x')"),
    "moving": SignalFacts("(while it moves)", keeps_sign=True),
    "forward": SignalFacts("(moving forward)", one_way=True),
    "backward": SignalFacts("(moving backward)", one_way=True),
    "forward_output": SignalFacts("(x forward)", (1, 1), measured=True, one_way=True),
    "backward_output": SignalFacts("(x backward)", (1, 1), measured=True, one_way=True),
    "friction": SignalFacts("sign(x')", shaped=True),
    "place": SignalFacts("(while it moves)", shaped=True),
    "process_output": SignalFacts("y", (0, 6), measured=True, of_process=True),
    "process_input": SignalFacts("u", (0, 6), of_process=True),
    "constant": SignalFacts("", keeps_sign=True, of_process=True),
    "start": SignalFacts("(impulse at the first sample)", (0, 5), keeps_sign=True, of_process=True),
}
PROCESS_SIGNALS = tuple(signal for signal, facts in SIGNALS.items() if facts.of_process)
