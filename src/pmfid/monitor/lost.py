"""A few lost samples on-line: what stands in their place, and for how long nothing is learnt from it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pmfid._stage import Inputs

#: An input that changed over lost samples by so many times what it usually does in as many has switched in one of them,
#: nobody knows which.
SWITCHED = 6.0
#: An input that is the same as before in more than this part of the samples, and of whose changes more than that part
#: come alone, is held for several of them; one that rests now and then is not.
HELD, ALONE = 0.5, 0.9
#: A switch matters where not knowing its instant moves the input behind the filters by so much of its size.
DOUBTFUL = 0.01
#: The filters forget a blow in so many of their time constants.
FORGOTTEN = 4.5


@dataclass(frozen=True)
class Guess:
    """Lost samples: input and counts of each, and for how many samples behind them nothing is to be learnt."""

    samples: tuple[tuple[float, int], ...]
    doubt: int


def guess(last: Inputs, rate: float, missing: int, u: float, counts: int) -> Guess | None:
    """So many samples behind `last` and before one of u and counts, which go on from the last: the input on a straight
    line, the counts on the parabola that leaves the last as fast as they came to it. rate: a sample period over the
    time constant of the filters. None where nothing is known of them: an input that is lost itself, or one that is not
    held and leaps."""
    if last.lost or not (last.known and math.isfinite(u)):
        return None
    n, leap = missing + 1, u - last.input
    held = last.same > HELD and last.alone > ALONE
    if not held and abs(leap) > SWITCHED * n * last.usual:
        return None
    bend = (counts - last.counts - last.change * n) / (n * n + n)
    between = (
        (last.input + k / n * leap, last.counts + round(k * (last.change + bend * (k + 1)))) for k in range(1, n)
    )
    return Guess(tuple(between), _doubt(last, rate, missing, leap) if held else 0)


def _doubt(last: Inputs, rate: float, missing: int, leap: float) -> int:
    """A held input may have switched at any of the instants."""
    if abs(leap) * missing * rate / math.sqrt(12) <= DOUBTFUL * math.sqrt(last.power):
        return 0
    return missing + round(FORGOTTEN / rate)
