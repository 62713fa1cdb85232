"""Pictures of status words of the log: a good log next to one that raises the word."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from studies.check_logs import Logged, faulty, logged

GOOD, BAD = "tab:blue", "tab:red"


@dataclass(frozen=True)
class Picture:
    """The log of a word: a fault of `studies.check_logs`, its seed, and the times to draw [s]."""

    fault: str
    seed: int = 5
    begin: float = 0.0
    end: float = 4.0


PICTURES: Mapping[str, Picture] = MappingProxyType(
    {
        "reversed": Picture("reversed sign", 3, 4.0, 8.0),
        "exchanged": Picture("exchanged columns"),
        "velocity": Picture("velocity as position"),
        "stuck": Picture("stuck counter"),
        "clipped": Picture("clipped counter"),
        "saturated": Picture("saturated input"),
        "held_output": Picture("output held", 7, 4.0, 6.0),
        "held_input": Picture("input held", begin=0.5, end=2.5),
        "unsigned": Picture("unsigned input", begin=0.5),
        "command": Picture("set point as input", begin=0.5),
        "little_motion": Picture("too little motion"),
        "rate_low": Picture("sample rate too low"),
        "rate_high": Picture("sample rate too high"),
    }
)


def make_logs(picture: Picture) -> tuple[Logged, Logged]:
    """Return the log of a run without the fault, and with the fault."""
    bad = faulty(picture.fault, picture.seed)
    return logged(bad.run, bad.run.u, bad.run.counts), bad


def draw_log(word: str) -> Figure:
    """Draw input and output of a good log and of a log that raises the word, at the same times."""
    picture = PICTURES[word]
    logs = make_logs(picture)
    duration = next(iter(logs[1].columns.values())).size * logs[1].run.dt
    figure = Figure(figsize=(8, 3.6), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True)
    for column, (log, title, color) in enumerate(zip(logs, ("a good log", word), (GOOD, BAD), strict=True)):
        axes[0, column].set_title(title)
        axes[1, column].set_xlabel("time [s]")
        for axis, signal in zip(axes[:, column], log.columns.values(), strict=True):
            _draw_signal(axis, signal, duration, picture, color)
        axes[0, column].set_ylabel(f"input {log.configuration.record.input!r}")
        axes[1, column].set_ylabel(str(log.configuration.record.output_kind))
    return figure


def _draw_signal(axis: Axes, signal: NDArray[np.float64], duration: float, picture: Picture, color: str) -> None:
    time = np.arange(signal.size) * duration / signal.size
    shown = (picture.begin <= time) & (time <= picture.end)
    axis.step(time[shown], signal[shown], where="post", color=color, lw=1, marker="." if shown.sum() < 60 else "")
