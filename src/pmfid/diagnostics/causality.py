"""Two tests against chance: does the input explain the residual, and does the noise drive the input?

The first regression uses present and past inputs. If present and past inputs explain a part of the residual, an
unmodelled effect exists. The second regression adds future inputs. If only future inputs explain the residual, the
noise returns through the input, as under control (Sims 1972). Both tests whiten the noise first and take the input as
given. Therefore a predictable input, such as a sweep, a sum of sines or a periodic signal, causes no false alarm.

A controller responds to noise of any size, but the jumps of its reference hide a small response. Therefore a robust
linear prediction removes the predictable part and the jumps from the future inputs. The test may use any function of a
given input, and therefore also the remainder of a prediction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pmfid._stage import first_order
from pmfid.diagnostics.free_run import rms
from pmfid.linear.residuals import Noise, fit_noise, whiten_columns
from pmfid.types import Flags, Floats, Places

#: Smallest number of lags of the input. The next constants are the largest number of lags, the samples for each
#: further lag, and the number of future lags.
CAUSALITY_LEAST = 8
CAUSALITY_MOST = 40
SAMPLES_PER_LAG = 15
CAUSALITY_AHEAD = 10
#: Prediction of the input from its past. `OWN_PAST` and `SHORT_PAST` are the numbers of past samples in the final
#: and the first prediction. `CAUSALITY_TRIALS` is the number of subsets for the first prediction. Each prediction
#: holds for `CAUSALITY_BLOCK` samples. `CAUSALITY_JUMP` is the size of a jump in robust standard deviations.
OWN_PAST = 20
SHORT_PAST = 5
CAUSALITY_TRIALS = 60
CAUSALITY_BLOCK = 500
CAUSALITY_JUMP = 4.5
#: Number of passes of a robust fit, and of alternations between the noise fit and the regression.
CAUSALITY_PASSES = 4
#: Relative size of a remainder below which the other columns explain a column up to rounding.
CAUSALITY_APART = 1e-7


@dataclass(frozen=True, eq=False)
class ResidualStretch:
    """One uninterrupted stretch of a record.

    The inputs (c, M) lie on the grid of the stretch, and the first input acts on the plant. The residual (N,) belongs
    to the rows (N,) of the grid.
    """

    inputs: Floats
    residual: Floats
    rows: Places


def chance_of_response(parts: Sequence[ResidualStretch], known: Floats, source: int = -1) -> float:
    """Return the chance that the present and past input `source` explains so much of the residual by noise alone.

    The test ignores all that the known columns (N, k), the sensitivities of the fit, explain.
    """
    past, kept, place = _columns(parts, source)
    return chance_of_columns(_residual(parts)[kept], known[kept], past[kept], place[kept])


def estimate_residual_noise(parts: Sequence[ResidualStretch], known: Floats) -> Noise | None:
    """Return the noise in the residual that the known columns (N, k) and the present and past inputs leave.

    The result is None if the residual contains no noise.
    """
    past, kept, place = _columns(parts, 0)
    columns = _basis(np.hstack([known, past])[kept])
    return _estimate_noise(np.column_stack([_residual(parts)[kept], columns]), place[kept])


def chance_of_feedback(
    parts: Sequence[ResidualStretch], known: Floats, direct: tuple[float, float] = (0.0, 0.0)
) -> float:
    """Return the chance that future inputs explain so much of the residual, beyond present and past inputs, by noise.

    The known columns (N, k) are the sensitivities of the fit. A response of the input within the same sample appears in
    the present input, as does a wrong hold. `direct` is the least and the greatest part of the present input that a
    wrong hold puts into the residual.
    """
    past, kept, place = _columns(parts, 0)
    ahead = np.vstack([_ahead(part) for part in parts])
    kept &= np.all(np.isfinite(ahead), axis=1)
    error, known, past, place = _residual(parts)[kept], known[kept], past[kept], place[kept]
    later = chance_of_columns(error, np.hstack([known, past]), ahead[kept], place)
    now = chance_of_columns(error, np.hstack([known, past[:, 1:]]), past[:, :1], place, direct)
    return min(later, now)


def chance_of_columns(
    error: Floats, known: Floats, tested: Floats, place: Places, allowed: tuple[float, float] = (0.0, 0.0)
) -> float:
    """Return the chance, by an F test, that noise of any colour makes the tested columns (N, b) explain so much of an
    error (N,).

    The known columns (N, a) are given. A coefficient of a single column within `allowed` is no evidence.
    """
    from scipy.special import fdtrc  # slow to import

    if error.size < 2 * (known.shape[1] + tested.shape[1]) + 20 or not rms(error) > 0:
        return 1.0
    columns = np.column_stack([error / rms(error), _basis(known), tested])
    a = columns.shape[1] - tested.shape[1]
    noise = _estimate_noise(columns[:, :a], place)
    if noise is None:
        return 1.0
    columns = whiten_columns(noise, columns, place)[_mark_settled(place, noise.coefficients.size)]
    Q = _basis(columns[:, 1:a])
    whole, T = columns[:, 0], _remove_projection(columns[:, a:], Q)
    e = whole - Q @ (Q.T @ whole)
    if T.shape[1] == 1:
        limits = (allowed[0] / rms(error), allowed[1] / rms(error))
        e = e - T[:, 0] * np.clip(float(T[:, 0] @ e) / float(T[:, 0] @ T[:, 0]), *limits)
    P = _basis(T)
    free = e.size - Q.shape[1] - P.shape[1]
    if P.shape[1] == 0 or free < 10:
        return 1.0
    gain = float(np.sum((P.T @ e) ** 2))
    rest = max(float(e @ e) - gain, 1e-300)
    return float(fdtrc(P.shape[1], free, gain / P.shape[1] / (rest / free)))


def _estimate_noise(columns: Floats, place: Places) -> Noise | None:
    """Return the noise that the other columns leave in the first column, or None if no noise remains.

    The function alternates a regression and a noise fit.
    """
    error, known = columns[:, 0], columns[:, 1:]
    left = error - known @ (known.T @ error)
    if not rms(left) > CAUSALITY_APART:
        return None
    noise = fit_noise(left, place)
    for _ in range(CAUSALITY_PASSES - 1):
        whitened = whiten_columns(noise, columns, place)[settled := _mark_settled(place, noise.coefficients.size)]
        left = error - known @ np.linalg.lstsq(whitened[:, 1:], whitened[:, 0], rcond=CAUSALITY_APART)[0]
        noise = fit_noise(left[settled], place[settled])
    return noise


def _mark_settled(place: Places, order: int) -> Flags:
    """Mark the samples (N,) whose whole past the whitening filter has.

    If too few samples have a whole past, the function marks all samples.
    """
    from scipy.signal import lfilter  # SciPy is slow to import, and only transfer functions need this module.

    line = np.zeros(int(place[-1] - place[0]) + 1)
    line[place - place[0]] = 1.0
    past = lfilter(np.ones(order + 1), [1.0], line)[place - place[0]]
    whole = past > order + 0.5
    return np.asarray(whole if np.sum(whole) > place.size // 2 else np.ones(place.size, bool))


def _columns(parts: Sequence[ResidualStretch], source: int) -> tuple[Floats, Flags, Places]:
    """Return the past inputs (N, l), a mark (N,) for each row with a whole past, and the places (N,) on one line."""
    samples = sum(part.rows.size for part in parts)
    lags = int(np.clip(samples // SAMPLES_PER_LAG, CAUSALITY_LEAST, CAUSALITY_MOST))
    columns, kept, place, start = [], [], [], 0
    for part in parts:
        columns.append(_past(part.inputs[source], lags, samples)[part.rows])
        kept.append(part.rows >= lags)
        place.append(start + part.rows)
        start += part.inputs.shape[1] + CAUSALITY_MOST + lags
    return np.vstack(columns), np.concatenate(kept), np.concatenate(place).astype(np.int64)


def _past(u: Floats, lags: int, samples: int) -> Floats:
    """Return regressors (M, l) from an input u (M,).

    The columns are the present and past input, slow means of the older input, and a constant. Decaying exponentials
    represent the unknown past.
    """
    u = u - np.mean(u)
    lagged = [np.r_[np.full(min(k, u.size), u[0]), u][: u.size] for k in range(lags + 1)]
    slow, time = [], lags / 2
    while time < samples / 4:
        keep = np.exp(-1 / time)
        slow += [first_order(u, keep, 1 - keep)[0], np.exp(-np.arange(u.size) / time)]
        time *= 2
    return np.column_stack([*lagged, *slow, np.ones(u.size)])


def _ahead(part: ResidualStretch) -> Floats:
    """Return the unpredictable part (N, CAUSALITY_AHEAD) of the present and future inputs at each row.

    An input that was not recorded is NaN.
    """
    news = calm(part.inputs[0])
    late = part.rows[:, None] + np.arange(CAUSALITY_AHEAD)
    return np.where(late < news.size, news[np.minimum(late, news.size - 1)], np.nan)


def calm(u: Floats) -> Floats:
    """Return the part (M,) of an input u (M,) that a robust linear prediction from its own past leaves, without jumps.

    If most of u is exactly predictable, the function keeps the whole remainder. The function works block by block,
    because a sweep needs a separate prediction for each frequency.
    """
    past = min(OWN_PAST, u.size // 10)
    if past < 1 or not np.std(u) > 0:
        return u - np.mean(u)
    windows = np.lib.stride_tricks.sliding_window_view((u - np.mean(u)) / np.std(u), past + 1)
    blocks = np.array_split(windows, max(1, round(windows.shape[0] / CAUSALITY_BLOCK)))
    return np.concatenate([np.zeros(past), *[_calm_block(block) for block in blocks]])


def _calm_block(windows: Floats) -> Floats:
    columns, target = np.c_[windows[:, :-1], np.ones(windows.shape[0])], windows[:, -1]
    left = target - columns @ _robust(columns, target)
    limit = CAUSALITY_JUMP * 1.4826 * float(np.median(np.abs(left)))
    return np.asarray(left if limit < CAUSALITY_APART else np.where(np.abs(left) <= limit, left, 0.0))


def _robust(columns: Floats, target: Floats) -> Floats:
    """Return prediction coefficients that even many jumps do not change.

    The function first chooses the best of several small subsets with a short past (least median of squares, Rousseeuw
    1984). Least squares without the jumps then refine the coefficients.
    """
    short = columns[:, -min(SHORT_PAST + 1, columns.shape[1]) :]
    chosen = [_fit_subset(short, target, trial) for trial in range(CAUSALITY_TRIALS)]
    left: Floats = min(chosen, key=lambda errors: float(np.median(np.abs(errors))))
    found: Floats = np.zeros(columns.shape[1])
    for _ in range(CAUSALITY_PASSES):
        size: Floats = np.abs(left)
        kept = size <= max(CAUSALITY_JUMP * 1.4826 * float(np.median(size)), CAUSALITY_APART)
        found = np.asarray(np.linalg.lstsq(columns[kept], target[kept], rcond=1e-9)[0])
        left = np.asarray(target - columns @ found)
    return np.asarray(found)


def _fit_subset(columns: Floats, target: Floats, trial: int) -> Floats:
    """Return the errors (N,) of a prediction from a minimal subset of samples, which the golden ratio spreads."""
    count = columns.shape[1]
    rows = (np.arange(trial * count, (trial + 1) * count) * 0.6180339887498949 % 1.0 * target.size).astype(int)
    return np.asarray(target - columns @ np.linalg.lstsq(columns[rows], target[rows], rcond=1e-9)[0])


def _residual(parts: Sequence[ResidualStretch]) -> Floats:
    return np.concatenate([part.residual for part in parts])


def _remove_projection(columns: Floats, Q: Floats) -> Floats:
    """Return the columns (N, k) without their projection on the orthonormal columns Q.

    Columns that lie in the span of Q are dropped.
    """
    size = np.linalg.norm(columns, axis=0)
    left = columns - Q @ (Q.T @ columns)
    left = left - Q @ (Q.T @ left)
    return np.asarray(left[:, np.linalg.norm(left, axis=0) > CAUSALITY_APART * size])


def _basis(columns: Floats) -> Floats:
    """Return orthonormal columns that span the given columns (N, k), up to rounding."""
    size = np.linalg.norm(columns, axis=0)
    Q, R = np.linalg.qr(columns[:, size > 0] / size[size > 0])
    U, values, _ = np.linalg.svd(R)
    return np.asarray(Q @ U[:, : values.size][:, values > CAUSALITY_APART])
