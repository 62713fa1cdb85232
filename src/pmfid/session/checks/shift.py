"""By how many samples the input must be shifted to explain the motion, and whether the shift changes along the record.

After filtering, a shifted input is the shifted column, so that the sums of all shifts and pieces are computed once.
Friction that is neither viscous nor Coulomb friction would look like a shift: its usual forms have columns, too.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from pmfid.session.checks.view import View, with_friction
from pmfid.types import Floats

__all__ = ["Drift", "drift_of"]

#: Largest shift that is tried, to either side [samples]; pieces of the record.
MOST, PIECES = 30, 16
#: Least length of a piece, in multiples of the largest shift.
LEAST = 2
#: Largest drift over the whole record that is tried, to either side, and the step between drifts [samples].
FURTHEST, STEP = 30.0, 0.5


@dataclass(frozen=True)
class Drift:
    """samples: shift of the input against the output over `rows` of the record, later if positive; sure: the same in
    standard deviations; less: unexplained power with the drift over unexplained power without."""

    samples: float
    rows: int
    sure: float
    less: float

    @property
    def rate(self) -> float:
        """Drift per row [samples]."""
        return self.samples / self.rows


@dataclass(frozen=True, eq=False)
class _Sums:
    """Sums over each of PIECES pieces: gram (k, p, p) of the columns; cross (k, s, p) of the columns with the input at
    each shift; power (k, s) of the input."""

    gram: Floats
    cross: Floats
    power: Floats

    def drop_piece(self, piece: int) -> _Sums:
        keep = np.arange(len(self.gram)) != piece
        return _Sums(self.gram * keep[:, None, None], self.cross * keep[:, None, None], self.power * keep[:, None])

    def measure_rest(self, shifts: Floats) -> Floats:
        """(m,): part of the input's power that stays unexplained if piece k is shifted by shifts (m, k)."""
        low = np.clip(np.floor(shifts).astype(int) + MOST, 0, 2 * MOST - 1)
        part = np.clip(shifts + MOST - low, 0.0, 1.0)
        rows = np.arange(len(self.gram))
        cross = (1 - part)[..., None] * self.cross[rows, low] + part[..., None] * self.cross[rows, low + 1]
        power = (1 - part) * self.power[rows, low] + part * self.power[rows, low + 1]
        total, together = power.sum(axis=1), cross.sum(axis=1)
        theta = np.linalg.pinv(self.gram.sum(axis=0), rcond=1e-10, hermitian=True) @ together.T
        return np.asarray((total - np.sum(theta.T * together, axis=1)) / np.maximum(total, 1e-300))


def drift_of(view: View) -> Drift | None:
    """The drift between input and output that explains the record best; None if the record is too short."""
    n = view.z.size - 2 * MOST
    if n < PIECES * LEAST * MOST:
        return None
    sums = _sums(view, n)
    whole, best, least = _best(sums)
    others = np.array([_best(sums.drop_piece(piece))[0] for piece in range(PIECES)])
    spread = np.sqrt((PIECES - 1) / PIECES * np.sum((others - others.mean()) ** 2) + STEP**2 / 12)
    return Drift(whole, n, abs(whole) / float(spread), best / max(least, 1e-300))


def _best(sums: _Sums) -> tuple[float, float, float]:
    """The best drift [samples], the unexplained part with it, and the least unexplained part without drift."""
    drifts = np.arange(-FURTHEST, FURTHEST + STEP, STEP)
    middles = np.arange(-MOST / 2, MOST / 2 + 1)
    places = (np.arange(PIECES) + 0.5) / PIECES - 0.5
    shifts = middles[:, None, None] + drifts[None, :, None] * places
    left = sums.measure_rest(shifts.reshape(-1, PIECES)).reshape(middles.size, drifts.size)
    _, column = np.unravel_index(int(np.argmin(left)), left.shape)
    return float(drifts[column]), float(left.min()), float(left[:, drifts.size // 2].min())


def _sums(view: View, n: int) -> _Sums:
    B = with_friction(view)[MOST : MOST + n]
    size = np.linalg.norm(B, axis=0)
    B = B[:, size > 0] / size[size > 0]
    shifted = np.lib.stride_tricks.sliding_window_view(view.z, n)[::-1]  # row s: later by s - MOST samples
    edges = np.linspace(0, n, PIECES + 1).astype(int)
    pairs = list(pairwise(edges))
    gram = np.array([B[a:b].T @ B[a:b] for a, b in pairs])
    cross = np.array([shifted[:, a:b] @ B[a:b] for a, b in pairs])
    power = np.array([np.sum(shifted[:, a:b] ** 2, axis=1) for a, b in pairs])
    return _Sums(gram, cross, power)
