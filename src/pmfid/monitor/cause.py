"""What changed, by how much and since when: the one cause that explains the block scores best."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pmfid.estimators.facts import INPUT_GAIN
from pmfid.monitor.scores import Blocks, Scale
from pmfid.types import Floats

#: A guide that runs dry has more friction of every kind.
FRICTION = "friction"
#: Keeps the instruments of a few blocks apart.
RIDGE = 1e-6
#: Blocks that a change may be spread over: the one it falls into, and the one whose filters remember that.
TRANSITION = 2
#: Information, in average blocks, that is left for the size where they are left out.
LEAST_INFORMATION = 2.0
#: Two sizes contradict each other from so many standard deviations of their difference on.
CONTRADICTED = 2.0
#: Neighbours that a block's deviation goes with.
LAGS = 2


@dataclass(frozen=True)
class Cause:
    """name: of the parameter, INPUT_GAIN or FRICTION; change, std: [its unit], of FRICTION relative; relative: change
    over the reference value, over std where that is 0; start: index of the first block that shows it; share: of all
    that a change of all parameters together would explain."""

    name: str
    change: float
    std: float
    relative: float
    start: int
    share: float


def explain(
    blocks: Blocks,
    scale: Scale,
    theta: Floats,
    names: Sequence[str],
    input_gain: float,
    latest: int | None = None,
    fixed: Collection[str] = (),
    friction: Floats | None = None,
) -> Cause:
    """The single change at one of the blocks' starts that takes most from the error of the equation.

    For a direction v and the blocks from a start on, with sums S, W, Z,

        gain = (v^T W^T Z^-1 S)^2 / (v^T W^T Z^-1 W v)

    is the generalised likelihood ratio of theta0 + size v (Willsky and Jones 1976), but for the noise. theta: (p,)
    reference; directions: each parameter but those that are known to stay, fixed, and theta itself for a loss of
    force, which looks as if all parameters had grown alike; latest: the last start that is possible, as the deviation
    was noticed then; friction: (p,) theta without what is none, where all of it may grow alike.
    """
    S, W, Z = (np.cumsum(part[::-1], axis=0)[::-1] for part in (blocks.score, blocks.cross, blocks.square))
    Z = Z + RIDGE * np.diag(np.diagonal(Z[0]))
    free = [i for i, name in enumerate(names) if name not in fixed]
    further = {INPUT_GAIN: theta} | ({} if friction is None else {FRICTION: friction})
    directions, called = np.vstack([np.eye(theta.size)[free], *further.values()]), [*(names[i] for i in free), *further]
    weighted = np.linalg.solve(Z, W @ directions.T)  # (n, p, directions)
    match = np.einsum("npd,np->nd", weighted, S)
    known = np.maximum(np.einsum("npd,npd->nd", weighted, W @ directions.T), np.finfo(float).tiny)
    gain = match**2 / known
    start = _start(gain[: None if latest is None else latest + 1])
    total = max(float(S[start] @ np.linalg.solve(Z[start], S[start])), np.finfo(float).tiny)
    which = int(np.argmax(gain[start]))
    size, std = _size(blocks, scale, directions[which], start)
    name, share = called[which], float(gain[start, which]) / total
    return _told(Cause(name, 0.0, 0.0, 0.0, start, share), size, std, theta, names, input_gain)


def sized(
    cause: Cause,
    estimate: Floats,
    covariance: Floats,
    theta: Floats,
    names: Sequence[str],
    input_gain: float,
    friction: Floats | None = None,
) -> Cause:
    """The same cause, its size compared with the one that an estimate (p,) with covariance (p, p), of the time since
    the change, gives it if nothing else has changed; theta: (p,) reference. As it is where the estimate knows no size.

    The blocks are those of a motion simulated with the reference: reversals come at other instants in the changed
    plant, which they take for a part of the change, while the estimate's own motion has them where they are. But the
    estimate remembers some of the time before, more of it the larger the motion was. So it counts where the two
    contradict each other, and half of their difference is in the error bar.
    """
    if cause.name in names:
        direction = np.eye(theta.size)[list(names).index(cause.name)]
    else:
        direction = theta if friction is None or cause.name == INPUT_GAIN else friction
    try:
        weight = np.linalg.solve(covariance, direction)
    except np.linalg.LinAlgError:
        return cause
    known = float(direction @ weight)
    size = float((estimate - theta) @ weight) / known if known > 0 else 0.0
    if not known * size**2 > 1:
        return cause
    other = _told(cause, size, known**-0.5, theta, names, input_gain)
    apart = abs(other.change - cause.change)
    chosen = other if apart > CONTRADICTED * np.hypot(other.std, cause.std) else cause
    return replace(chosen, std=float(np.hypot(chosen.std, apart / 2)))


def _told(cause: Cause, size: float, std: float, theta: Floats, names: Sequence[str], input_gain: float) -> Cause:
    """The cause with its size along its direction in terms of what has changed."""
    if cause.name == FRICTION:
        return replace(cause, change=size, std=std, relative=size)
    if cause.name != INPUT_GAIN:
        reference = abs(float(theta[list(names).index(cause.name)])) or max(std, np.finfo(float).tiny)
        return replace(cause, change=size, std=std, relative=size / reference)
    factor = 1 / max(1 + size, 0.01)
    relative = factor - 1
    return replace(cause, change=relative * input_gain, std=std * factor**2 * abs(input_gain), relative=relative)


def _start(gain: Floats) -> int:
    """The start whose best cause explains most; of equal ones the last: what no block could show did not begin yet."""
    late = gain[::-1]
    return len(gain) - 1 - int(np.argmax(late.max(axis=1) >= (1 - 1e-9) * late.max()))


def _size(blocks: Blocks, scale: Scale, direction: Floats, start: int) -> tuple[float, float]:
    """The change along a direction (p,), and its standard deviation.

    Blocks in which the change comes, and its filters settle, show less than all of it: they are left out where enough
    remains. By how much the next ones would move the size, or the last one did, is what the moment of the change
    leaves open.
    """
    told = scale.standardise(blocks)[1][:, direction != 0].mean(axis=1)  # of the parameters that it moves
    information = np.cumsum(told[::-1])[::-1]
    possible = range(start, min(start + TRANSITION + 1, len(information)))
    found = [_fit(blocks[k:], scale, direction) for k in possible if k == start or information[k] > 0]
    chosen = sum(information[k] > LEAST_INFORMATION for k in possible[1 : len(found)])
    size, std = found[chosen]
    others = [abs(other - size) for other, _ in found[max(0, chosen - 1) :]] if len(found) > 1 else [std]
    return size, float(np.hypot(std, min(max(others), abs(size))))


def _fit(blocks: Blocks, scale: Scale, direction: Floats) -> tuple[float, float]:
    """The change along a direction (p,) that all blocks show, and its standard deviation: the larger one of what the
    noise of normal work makes it, and of what the blocks leave unexplained, with its correlation."""
    W, Z = blocks.cross.sum(axis=0), blocks.square.sum(axis=0)
    weight = np.linalg.solve(Z + RIDGE * np.diag(np.diagonal(Z)) + np.finfo(float).tiny * np.eye(len(Z)), W @ direction)
    told, known = blocks.score @ weight, blocks.cross @ direction @ weight
    total = max(float(known.sum()), np.finfo(float).tiny)
    size = float(told.sum()) / total
    # of the parameters that the direction moves
    noise = float(np.mean((scale.sigma**2 / scale.energy)[direction != 0]))
    rest = told - size * known
    n = len(rest)
    spread = float(
        rest @ rest + 2 * sum((1 - k / (LAGS + 1)) * (rest[k:] @ rest[:-k]) for k in range(1, min(n, LAGS + 1)))
    )
    spread = max(spread, 0.0) * n / max(1, n - 1)
    return size, float(np.sqrt(max(noise / total, spread / total**2)))
