"""A few lost samples on-line: imputed values, and for how long they are not used for learning."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pmfid._stage import Inputs

#: Change of the input over lost samples, relative to its usual change over as many samples, from which it has switched
#: in one of them. Which one is unknown.
SWITCHED = 6.0
#: An input that is the same as before in more than this part of the samples, and of whose changes more than that part
#: come alone, is held for several of them; one that rests now and then is not.
HELD, ALONE = 0.5, 0.9
#: Relative error of the filtered input, by the unknown instant of a switch, from which the switch matters.
DOUBTFUL = 0.01
#: Most missing samples that are guessed, and the same in time constants of the filters; the larger one holds.
FEW, SHORT = 8, 0.25
#: Time in which the filters forget an impulse, in their time constants.
FORGOTTEN = 4.5


@dataclass(frozen=True)
class GuessedSamples:
    """Lost samples: input and counts of each; doubt: number of following samples that are not used for learning."""

    samples: tuple[tuple[float, int], ...]
    doubt: int


def longest(rate: float) -> int:
    """Most lost samples that are guessed; after a longer gap the filters settle again. rate: a sample period over the
    time constant of the filters."""
    return max(FEW, round(SHORT / rate))


def guess(last: Inputs, rate: float, missing: int, u: float, counts: int) -> GuessedSamples | None:
    """Values for the `missing` samples between `last` and the sample u, counts; counts continue those of `last`.

    The input lies on a straight line. The counts lie on a parabola that starts with the last known speed; a long gap
    takes this speed over as many samples as are missing. rate: as in `longest`. None if the values are unknown: an
    input is lost, or an input that is not held leaps.
    """
    if last.lost or not (last.known and math.isfinite(u)):
        return None
    n, leap = missing + 1, u - last.input
    held = last.same > HELD and last.alone > ALONE
    if not held and abs(leap) > SWITCHED * n * last.usual:
        return None
    back = min(n if n > FEW + 1 else 1, last.fresh - 1)
    speed = (last.counts - last.before(back)) / back if back else 0.0
    bend = (counts - last.counts - speed * n) / (n * (n + back))
    moved = (round(k * (speed + bend * (k + back))) for k in range(1, n))
    between = tuple((last.input + k / n * leap, last.counts + way) for k, way in enumerate(moved, 1))
    return GuessedSamples(between, _doubt(last, rate, missing, leap) if held else 0)


def _doubt(last: Inputs, rate: float, missing: int, leap: float) -> int:
    """Number of samples to doubt, because a held input may have switched at any instant of the gap."""
    if abs(leap) * missing * rate / math.sqrt(12) <= DOUBTFUL * math.sqrt(last.power):
        return 0
    return missing + round(FORGOTTEN / rate)
