"""The cause that explains the block scores best, with its parameter, size and time."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pmfid.estimators.facts import INPUT_GAIN
from pmfid.monitor.scores import Blocks, Scale
from pmfid.monitor.tuning import TUNING
from pmfid.types import Flags, Floats

#: A dry guide has more friction of every kind.
FRICTION = "friction"


@dataclass(frozen=True)
class Cause:
    """A possible cause of a change.

    `name` is the parameter, INPUT_GAIN or FRICTION. `change` and `std` have the unit of the parameter, but are relative
    for FRICTION. `relative` is the change over the reference value, or over `std` if the reference value is 0. `start`
    is the index of the first block that shows the change. `others` has the causes that are equally likely, or None if
    no estimate existed for a comparison.
    """

    name: str
    change: float
    std: float
    relative: float
    start: int
    others: tuple[str, ...] | None = None

    @property
    def largest(self) -> float:
        """Largest relative size within three standard errors."""
        return abs(self.relative) * (1 + 3 * self.std / abs(self.change)) if self.change else np.inf


@dataclass(frozen=True)
class ChangeEvidence:
    """A recursive estimate theta (p,) from the samples since the suspicion, and the covariance (p, p) of its error."""

    theta: Floats
    covariance: Floats


def explain(
    blocks: Blocks,
    scale: Scale,
    theta: Floats,
    names: Sequence[str],
    input_gain: float,
    latest: int | None = None,
    fixed: Collection[str] = (),
    friction: Floats | None = None,
    evidence: ChangeEvidence | None = None,
) -> Cause:
    """Return the most likely single change, which starts with one of the blocks.

    For a direction v and the sums S, W, Z of the blocks from a start, the ratio

        gain = (v^T W^T Z^-1 S)^2 / (v^T W^T Z^-1 W v)

    is the generalised likelihood ratio of theta0 + size v (Willsky and Jones 1976), except for the noise. theta (p,) is
    the reference. The directions are all parameters except the constant ones in `fixed`. The direction theta itself
    stands for a loss of force, which looks as if all parameters had grown alike. `latest` is the last possible start,
    because the deviation was noticed then. `friction` (p,) is theta with 0 for all other parameters, if all frictions
    may grow alike.

    The blocks use a motion that is simulated with the reference. The simulated motion of the reference reverses at
    other instants than the changed plant, which looks like a part of the change. The simulated motion of the estimate
    reverses at the same time as the plant. Causes that the estimate excludes are therefore left out, and the size
    combines blocks and estimate.
    """
    S, W, Z = (np.cumsum(part[::-1], axis=0)[::-1] for part in (blocks.score, blocks.cross, blocks.square))
    Z = Z + TUNING.cause_ridge * np.diag(np.diagonal(Z[0]))
    free = [i for i, name in enumerate(names) if name not in fixed]
    further = {INPUT_GAIN: theta} | ({} if friction is None else {FRICTION: friction})
    directions, called = np.vstack([np.eye(theta.size)[free], *further.values()]), [*(names[i] for i in free), *further]
    weighted = np.linalg.solve(Z, W @ directions.T)  # the shape is (n, p, directions)
    match = np.einsum("npd,np->nd", weighted, S)
    known = np.maximum(np.einsum("npd,npd->nd", weighted, W @ directions.T), np.finfo(float).tiny)
    gain = match**2 / known
    start = _start(gain[: None if latest is None else latest + 1])
    possible = np.ones(len(called), bool) if evidence is None else _possible(evidence, theta, directions)
    which = int(np.argmax(np.where(possible, gain[start], -np.inf)))
    others = None if evidence is None else tuple(called[k] for k in np.flatnonzero(possible) if k != which)
    size = _combine_sizes(_size(blocks, scale, directions[which], start), evidence, theta, directions[which])
    return _scale_cause(Cause(called[which], 0.0, 0.0, 0.0, start, others), *size, theta, names, input_gain)


def name_cause(evidence: ChangeEvidence, theta: Floats, names: Sequence[str], input_gain: float) -> Cause:
    """Return the most likely single change of an estimate from theta (p,): of a parameter, or of the input gain."""
    directions, called = np.vstack([np.eye(theta.size), theta]), [*names, INPUT_GAIN]
    size, known, _ = _measure_along(evidence, theta, directions)
    which = int(np.argmax(size**2 * known))
    others = tuple(called[k] for k in np.flatnonzero(_possible(evidence, theta, directions)) if k != which)
    cause = Cause(called[which], 0.0, 0.0, 0.0, 0, others)
    return _scale_cause(cause, float(size[which]), float(known[which] ** -0.5), theta, names, input_gain)


def _measure_along(evidence: ChangeEvidence, theta: Floats, directions: Floats) -> tuple[Floats, Floats, float]:
    """Return sizes (k,) and information (k,) of a change in a single direction, for each of the directions (k, p).

    The third result is the squared deviation of the estimate from theta (p,) in standard errors.
    """
    precision = np.linalg.pinv(evidence.covariance, hermitian=True)
    deviation, weighted = evidence.theta - theta, directions @ precision
    known = np.maximum(np.einsum("kp,kp->k", weighted, directions), np.finfo(float).tiny)
    return weighted @ deviation / known, known, float(deviation @ precision @ deviation)


def _possible(evidence: ChangeEvidence, theta: Floats, directions: Floats) -> Flags:
    """Return whether the estimate leaves a change along each of the directions (k, p) possible, (k,)."""
    size, known, total = _measure_along(evidence, theta, directions)
    left = total - size**2 * known
    return np.asarray(left < left.min() + TUNING.cause_excluded)


def _combine_sizes(
    by_blocks: tuple[float, float], evidence: ChangeEvidence | None, theta: Floats, direction: Floats
) -> tuple[float, float]:
    """Return the size along a direction (p,) and its standard deviation, from blocks and estimate.

    A difference beyond their standard errors is an error of the blocks.
    """
    size, std = by_blocks
    doubt = std**2 + (TUNING.cause_moved * size) ** 2
    if evidence is None:
        return size, float(np.sqrt(doubt))
    other, known, _ = (np.ravel(part)[0] for part in _measure_along(evidence, theta, direction[None]))
    doubt += max((other - size) ** 2 - std**2 - 1 / known, 0.0)
    total = known + 1 / doubt
    return float((known * other + size / doubt) / total), float(total**-0.5)


def new_gain(evidence: ChangeEvidence, theta: Floats, input_gain: float) -> tuple[float, float, float]:
    """Return the new input gain, its standard deviation and the previous gain.

    A changed gain must explain the whole move of theta (p,).
    """
    size, known, _ = (np.ravel(part)[0] for part in _measure_along(evidence, theta, theta[None]))
    cause = _scale_cause(Cause(INPUT_GAIN, 0.0, 0.0, 0.0, 0), float(size), float(known**-0.5), theta, (), input_gain)
    return input_gain + cause.change, cause.std, input_gain


def _scale_cause(
    cause: Cause, size: float, std: float, theta: Floats, names: Sequence[str], input_gain: float
) -> Cause:
    """Return the cause with its size converted to a change of the parameter."""
    if cause.name == FRICTION:
        return replace(cause, change=size, std=std, relative=size)
    if cause.name != INPUT_GAIN:
        reference = abs(float(theta[list(names).index(cause.name)])) or max(std, np.finfo(float).tiny)
        return replace(cause, change=size, std=std, relative=size / reference)
    factor = 1 / max(1 + size, 0.01)
    relative = factor - 1
    return replace(cause, change=relative * input_gain, std=std * factor**2 * abs(input_gain), relative=relative)


def _start(gain: Floats) -> int:
    """Return the start whose best cause explains most.

    Among equal starts the last counts, because no block before it shows the change.
    """
    late = gain[::-1]
    return len(gain) - 1 - int(np.argmax(late.max(axis=1) >= (1 - 1e-9) * late.max()))


def _size(blocks: Blocks, scale: Scale, direction: Floats, start: int) -> tuple[float, float]:
    """Return the change along a direction (p,), and its standard deviation.

    Blocks in which the change occurs and the filters settle show only a part of the change. Blocks with a part of the
    change are left out if enough information remains. The uncertainty of the start is the change of the size by one
    more block, or one fewer.
    """
    by_block = scale.standardise(blocks)[1][:, direction != 0].mean(axis=1)  # of the moved parameters
    information = np.cumsum(by_block[::-1])[::-1]
    possible = range(start, min(start + TUNING.cause_transition + 1, len(information)))
    found = [_fit(blocks[k:], scale, direction) for k in possible if k == start or information[k] > 0]
    chosen = sum(information[k] > TUNING.least_information for k in possible[1 : len(found)])
    size, std = found[chosen]
    others = [abs(other - size) for other, _ in found[max(0, chosen - 1) :]] if len(found) > 1 else [std]
    return size, float(np.hypot(std, min(max(others), abs(size))))


def _fit(blocks: Blocks, scale: Scale, direction: Floats) -> tuple[float, float]:
    """Return the change along a direction (p,) that all blocks show, and its standard deviation.

    The standard deviation is the larger of two values. The first comes from the noise of normal work. The second comes
    from the unexplained part of the blocks, with its correlation.
    """
    W, Z = blocks.cross.sum(axis=0), blocks.square.sum(axis=0)
    weight = np.linalg.solve(
        Z + TUNING.cause_ridge * np.diag(np.diagonal(Z)) + np.finfo(float).tiny * np.eye(len(Z)), W @ direction
    )
    match, known = blocks.score @ weight, blocks.cross @ direction @ weight
    total = max(float(known.sum()), np.finfo(float).tiny)
    size = float(match.sum()) / total
    # the noise concerns only parameters that the direction moves
    noise = float(np.mean((scale.sigma**2 / scale.energy)[direction != 0]))
    rest = match - size * known
    n = len(rest)
    spread = float(
        rest @ rest
        + 2
        * sum(
            (1 - k / (TUNING.cause_lags + 1)) * (rest[k:] @ rest[:-k]) for k in range(1, min(n, TUNING.cause_lags + 1))
        )
    )
    spread = max(spread, 0.0) * n / max(1, n - 1)
    return size, float(np.sqrt(max(noise / total, spread / total**2)))
