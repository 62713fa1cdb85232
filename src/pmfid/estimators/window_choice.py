"""How long the windows are to be: what predicts parts of the record best that were not fitted to."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from pmfid.errors import NotIdentifiableError
from pmfid.estimators.difference import ENCODER_ALONE, WORST_FIT, Difference, rms
from pmfid.estimators.starts import choose_start, fit_start, start_samples
from pmfid.estimators.windows import ROUGHLY, Windows, descend
from pmfid.types import Floats

#: Parts of the record, each predicted from the others by a free run.
FOLDS = 3
#: Pieces in which a part is run as well, each with its own start: one long run is a matter of chance, many short ones
#: say little on drift. WORTH: length of a piece over the span that its start is read from.
PIECES, WORTH = (1, 2, 4, 8), 4
#: The shortest window, in time constants of the filters and in samples: shorter ones say little but where they start.
SHORTEST, FEWEST = 20.0, 40
#: A longer window is taken where it predicts as well but for this part: it knows more.
AS_WELL = 0.05


@dataclass(frozen=True)
class WindowChoice:
    """samples: of a window; seconds; errors: for each length that was tried [s], infinite for the whole record, the
    error of free runs over parts that were not fitted to, in one piece and in several [unit of the resolution]: the
    geometric mean of the root mean squares."""

    samples: int
    seconds: float
    errors: dict[float, float]

    @property
    def says(self) -> str:
        """For people."""
        chosen = "one window over the whole record" if math.isinf(self.seconds) else f"windows of {self.seconds:.3g} s"
        if len(self.errors) < 2:
            return f"{chosen}: it is too short to choose their length on it"
        best = {length: error for length, error in self.errors.items() if length != self.seconds}
        other = min(best, key=lambda length: best[length])
        named = "one window" if math.isinf(other) else f"windows of {other:.3g} s"
        others = f"by {best[other]:.3g} with {named}" if best[other] < math.inf else "other windows give no estimate"
        return (
            f"{chosen}, chosen on this record: free runs over each third of it with what the others give, also "
            f"restarted within it, are off by {self.errors[self.seconds]:.3g}, {others}"
        )


def choose_window(difference: Difference, theta: Floats, cutoff: float) -> WindowChoice:
    """The length for a difference without a high-pass, from scaled parameters (p,); cutoff [rad/s] of the filters."""
    n, dt = difference.y.size, difference.dt
    shortest = max(FEWEST, math.ceil(SHORTEST / (cutoff * dt)))
    lengths = [n, *_halves(n * (FOLDS - 1) // FOLDS // 2, shortest)]
    errors = {_seconds(k, n, dt): predicted_elsewhere(difference, theta, cutoff, k) for k in lengths}
    best = min(errors.values())
    samples = next((length for length in lengths if errors[_seconds(length, n, dt)] <= (1 + AS_WELL) * best), n)
    return WindowChoice(samples, _seconds(samples, n, dt), errors)


def _seconds(length: int, n: int, dt: float) -> float:
    return math.inf if length >= n else length * dt


def _halves(length: int, shortest: int) -> Iterator[int]:
    while length >= shortest:
        yield length
        length //= 2


def predicted_elsewhere(difference: Difference, theta: Floats, cutoff: float, length: int) -> float:
    """Error of free runs over parts of the record [unit of the resolution], geometric mean: each part and each length
    of the runs counts alike, also where one of them is hard to predict. Infinite where there is no estimate, or half
    the motion is left."""
    n, logs = difference.y.size, []
    edges = np.linspace(0, n, FOLDS + 1).round().astype(int).tolist()
    for first, last in pairwise(edges):
        rest = [(a, b) for a, b in ((0, first), (last, n)) if b - a >= FEWEST]
        try:
            windows = Windows.cover_stretches(difference, rest, length)
            q = descend(windows, windows.start_windows(theta, cutoff), ROUGHLY)
        except (NotIdentifiableError, np.linalg.LinAlgError):
            return math.inf
        if not rms(windows(q)) < max(WORST_FIT * windows.size_of_motion, windows.explained):
            return math.inf
        part, found = difference.part(first, last), q[: theta.size]
        logs += [_log_error(part, found, cutoff, pieces) for pieces in _pieces(part, cutoff)]
    return math.exp(float(np.mean(logs))) * difference.resolution


def _pieces(part: Difference, cutoff: float) -> list[int]:
    least = WORTH * start_samples(part.dt, cutoff)
    return [count for count in PIECES if count == 1 or part.y.size // count >= least]


def _log_error(part: Difference, theta: Floats, cutoff: float, pieces: int) -> float:
    """Logarithm of the root mean square error [counts] of runs over the pieces of a part."""
    edges = np.linspace(0, part.y.size, pieces + 1).round().astype(int).tolist()
    runs = [free_run(part.part(first, last), theta, cutoff) for first, last in pairwise(edges)]
    left = rms(np.concatenate(runs))
    return math.log(max(left, ENCODER_ALONE)) if left < math.inf else math.inf


def free_run(part: Difference, theta: Floats, cutoff: float) -> Floats:
    """(n,) what is left of a difference at scaled parameters (p,) [counts], with a start from its first samples."""
    read = part.part(0, min(start_samples(part.dt, cutoff), part.y.size))
    return part(fit_start(read, choose_start(read, theta, cutoff)))
