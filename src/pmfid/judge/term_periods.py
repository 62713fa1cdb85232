"""At which pitch does a force come again along the travel? A scan of score tests over pitches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pmfid.estimators.adequacy import MISSED, weigh
from pmfid.estimators.lacks import Place
from pmfid.estimators.likelihood import Best
from pmfid.types import Floats

#: Least and most pitches of the travel: with fewer a pitch is told from nothing else, more are not looked for.
FEWEST, MOST = 4.0, 100.0
#: Counts, and samples at the usual speed, that a pitch has at least.
COUNTS, SAMPLES = 8.0, 4.0
#: Pitches are tried half a pitch of the travel apart, so many at a time, and around the best of them again.
APART, AT_A_TIME, CLOSER = 0.5, 40, (0.15, 0.05)
FINER, PEAKS = 4, 2


def pitches(best: Best) -> Floats:
    """(k,) how many pitches of a cogging force the travel may have; none where it is too short for any."""
    difference = replace(best.difference, parts=1)
    travel, v = float(np.ptp(difference.y)), difference.motion(best.q)[1]
    usual = float(np.sqrt(np.mean(v[v != 0] ** 2))) if np.any(v) else 0.0
    shortest = max(COUNTS * difference.resolution, SAMPLES * usual * difference.dt)
    return np.arange(FEWEST, min(MOST, travel / max(shortest, 1e-300)), APART)


def coggings(best: Best) -> list[Place]:
    """The pitches that the counts ask for most, at a model's best fit to them: of one that is left over others seem to
    be there, too."""
    coarse = replace(best, difference=replace(best.difference, parts=1))
    travel, tried = float(np.ptp(best.difference.y)), pitches(best)
    if not tried.size:
        return []
    scores = [_scores(coarse, travel, part) for part in _parts(tried)]
    gain, z = np.concatenate(scores, axis=1)
    gain = np.where(z > MISSED, gain, 0.0)
    found = list[Place]()
    while len(found) < PEAKS and np.max(gain) > 0:
        number = float(tried[int(np.argmax(gain))])
        gain[np.abs(tried - number) < FEWEST / 2] = 0.0
        for apart in CLOSER:
            near = number + apart * np.arange(-FINER, FINER + 1)
            number = float(near[int(np.argmax(_scores(coarse, travel, near)[0]))])
        found.append(Place("cogging", travel / number))
    return found


def _parts(tried: Floats) -> list[Floats]:
    return [tried[first : first + AT_A_TIME] for first in range(0, tried.size, AT_A_TIME)]


def _scores(best: Best, travel: float, numbers: NDArray[np.floating]) -> Floats:
    """(2, k): doubled gain of the log-likelihood of sin and cos together, about, and the larger of their scores in
    standard deviations, for so many pitches of the travel."""
    found = weigh(best, [Place("cogging", travel / number) for number in numbers.tolist()])
    ours = [k for k, lack in enumerate(found.lacks) if lack.name == "cogging"]
    gains, scores = dict.fromkeys(numbers.tolist(), 0.0), dict.fromkeys(numbers.tolist(), 0.0)
    for k in ours:
        number = min(gains, key=lambda one: abs(travel / one - _period(found.lacks[k].changes[0])))
        gains[number] += float(found.gain[k])
        scores[number] = max(scores[number], abs(float(found.z[k])))
    return np.array([list(gains.values()), list(scores.values())])


def _period(change: object) -> float:
    return float(dict(change)["cogging"])  # type: ignore[call-overload]
