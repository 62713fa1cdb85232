"""Lines of one axis, which have a time in place of a number: sorted within the window, then samples on a grid."""

from __future__ import annotations

import math
from bisect import insort

import numpy as np

from pmfid.errors import UsageError
from pmfid.service.delivery import Lines
from pmfid.service.order import ANEW, Piece, Verdict
from pmfid.session.monitored.period import Saved
from pmfid.session.monitored.timeline import COMMENT, Found, Line, Metronome, Sample, Timeline

__all__ = ["Timed"]

#: So many lines in a row behind the window are those of a clock that was set back.
BEHIND = 5
#: Samples that follow one another after lines came with another period, until they are believed again.
PROBATION = 50
#: Lines that wait at most.
MOST = 100_000


def _when(line: Line) -> float:
    return line.time


class Timed:
    """dt: sample period [s]; window: how long lines wait for older ones [s], 0: not at all; timed: they have a time."""

    def __init__(self, dt: float, window: float, timed: bool) -> None:
        self.dt, self.window, self.timed = dt, window, timed
        self._grid = self._new()
        self._held: list[Line] = []
        self._newest, self._behind = -math.inf, 0
        self._doubtful = 0  # samples that are still to follow one another before any is believed

    def _new(self) -> Timeline | Metronome:
        return Timeline(self.dt) if self.timed else Metronome(self.dt)

    def take(self, item: Lines, received: float, turn: int, pieces: list[Piece]) -> Verdict:
        """Appends to `pieces` the samples that are known now."""
        verdict, samples = Verdict(), list[Sample]()
        for given in item.lines:
            for line in self._sorted(given):
                samples += self._samples(line, verdict)
        pieces += _joined(samples, received, turn, verdict)
        return verdict

    def _sorted(self, line: Line) -> list[Line]:
        """The lines whose turn it is: the window behind the newest has passed."""
        if not self.window or math.isnan(line.time):
            return [line]
        if line.time < self._newest - self.window:
            return self._late(line)
        self._behind = 0
        self._newest = max(self._newest, line.time)
        insort(self._held, line, key=_when)
        due = 0
        while due < len(self._held) and (
            self._held[due].time <= self._newest - self.window or len(self._held) - due > MOST
        ):
            due += 1
        found, self._held = self._held[:due], self._held[due:]
        return found

    def _late(self, line: Line) -> list[Line]:
        """The timeline knows what it is; where more of them come, the clock was set back."""
        self._behind += 1
        if self._behind < BEHIND:
            return [line]
        held, self._held = self._held, []
        self._newest, self._behind = line.time, 0
        return [*held, line]

    def _samples(self, line: Line, verdict: Verdict) -> list[Sample]:
        try:
            found = self._grid.take(line)
        except UsageError as error:
            if not self._doubtful:
                verdict.told.append({"event": "period", "problem": str(error)})
            self._grid, self._doubtful = self._new(), PROBATION
            verdict.refused += 1
            return []
        samples = [one for one in found if isinstance(one, Sample)]
        self._skipped(found, verdict)
        return self._believed(samples, verdict) if self._doubtful and samples else samples

    def _believed(self, samples: list[Sample], verdict: Verdict) -> list[Sample]:
        """Lines came with another period: what follows is none of this axis until enough of it fits."""
        verdict.refused += len(samples)
        self._doubtful = max(0, self._doubtful - len(samples))
        if self._doubtful:
            return []
        last = samples[-1]
        verdict.refused -= 1
        return [Sample(last.time, last.u, last.counts, 0, math.inf)]

    def _skipped(self, found: list[Found], verdict: Verdict) -> None:
        for one in found:
            if not isinstance(one, Sample) and one.kind != COMMENT:
                verdict.lines[one.kind] = verdict.lines.get(one.kind, 0) + 1
                verdict.told.append({"event": one.kind, "time": one.time, "problem": one.problem})

    def saved(self) -> Saved:
        """Where it is, for JSON that knows NaN and infinity."""
        return {
            "timed": self.timed,
            "newest": self._newest,
            "behind": self._behind,
            "doubtful": self._doubtful,
            "held": [[line.time, line.u, line.counts, line.problem] for line in self._held],
            "grid": self._grid.saved(),
        }

    def restore(self, saved: Saved) -> None:
        """Goes on from where another one was. Raises KeyError, TypeError or ValueError for what none has saved."""
        self.timed = bool(saved["timed"])
        self._newest, self._behind = float(saved["newest"]), int(saved["behind"])
        self._doubtful = int(saved["doubtful"])
        self._held = [Line(*entry) for entry in saved["held"]]
        self._grid = self._new()
        self._grid.restore(saved["grid"])


def _joined(samples: list[Sample], received: float, turn: int, verdict: Verdict) -> list[Piece]:
    """Samples that follow one another as one piece."""
    pieces, begun = list[Piece](), 0
    for k, sample in enumerate(samples):
        if sample.missing or sample.jump:
            pieces += _piece(samples[begun:k], received, turn)
            begun = k
            verdict.told.append(_interruption(sample))
    return pieces + _piece(samples[begun:], received, turn)


def _interruption(sample: Sample) -> dict[str, object]:
    if sample.missing:
        return {"event": "gap", "time": sample.time, "missing": sample.missing}
    return {"event": "clock", "time": sample.time, "jump": sample.jump if math.isfinite(sample.jump) else None}


def _piece(samples: list[Sample], received: float, turn: int) -> list[Piece]:
    if not samples:
        return []
    lead = samples[0].missing or (ANEW if samples[0].jump else 0)
    u, counts = np.array([s.u for s in samples]), np.array([s.counts for s in samples], np.int64)
    times = np.array([s.time for s in samples])
    return [Piece(lead, False, u, counts, math.nan, 0, received, turn, times)]
