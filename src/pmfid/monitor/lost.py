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
#: So many missing samples are guessed, and in so many of the filters' time constants: over more nothing is known.
FEW, SHORT = 8, 0.25
#: The filters forget a blow in so many of their time constants.
FORGOTTEN = 4.5


@dataclass(frozen=True)
class Guess:
    """Lost samples: input and counts of each, and for how many samples behind them nothing is to be learnt."""

    samples: tuple[tuple[float, int], ...]
    doubt: int


def longest(rate: float) -> int:
    """So many lost samples are guessed; over more the filters had better settle anew. rate: a sample period over the
    time constant of the filters."""
    return max(FEW, round(SHORT / rate))


def guess(last: Inputs, rate: float, missing: int, u: float, counts: int) -> Guess | None:
    """So many samples behind `last` and before one of u and counts, which go on from the last: the input on a straight
    line, the counts on the parabola that leaves the last as fast as they came to it, as the last tell, and of a long
    gap as many as are missing. rate: as in `longest`. None where nothing is known of them: an input that is lost
    itself, or one that is not held and leaps."""
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
    return Guess(between, _doubt(last, rate, missing, leap) if held else 0)


def _doubt(last: Inputs, rate: float, missing: int, leap: float) -> int:
    """A held input may have switched at any of the instants."""
    if abs(leap) * missing * rate / math.sqrt(12) <= DOUBTFUL * math.sqrt(last.power):
        return 0
    return missing + round(FORGOTTEN / rate)
