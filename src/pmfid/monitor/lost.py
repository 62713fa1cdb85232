"""A few lost samples on-line: what stands in their place, and for how long nothing is learnt from it."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

from pmfid.estimators.recursive import RecursiveEstimator

#: The part by which a sample counts in what an input usually does, and a change in how changes come.
LATELY, SELDOM = 0.01, 0.05
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


@dataclass
class Lately:
    """What input and counts did up to the last sample, for estimators with the filters of this one."""

    estimator: RecursiveEstimator
    _input: float = field(default=math.nan, init=False)
    _samples: int = field(default=0, init=False)
    _change: float = field(default=0.0, init=False)
    _same: float = field(default=0.0, init=False)
    _alone: float = field(default=1.0, init=False)
    _changed: bool = field(default=False, init=False)
    _power: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        self._recent: deque[int] = deque(maxlen=self.longest + 2)  # counts, the last of all at the end

    @property
    def longest(self) -> int:
        """So many lost samples are guessed; over more the filters had better settle anew."""
        return max(FEW, round(SHORT / (self.estimator.cutoff * self.estimator.dt)))

    def note(self, u: float, counts: int) -> None:
        """A sample; u is NaN where it was lost."""
        lost = not math.isfinite(u)
        if lost:
            self._recent.clear()
        self._recent.append(counts)
        if not lost:
            self._learn(u)
            self._input = u
        self._samples += 1

    def _learn(self, u: float) -> None:
        share = max(LATELY, 1 / (self._samples + 1))
        self._power += share * (u * u - self._power)
        if math.isfinite(self._input):
            self._change += share * (abs(u - self._input) - self._change)
            changed = u != self._input
            self._same += share * (float(not changed) - self._same)
            if changed:
                self._alone += SELDOM * (float(not self._changed) - self._alone)
            self._changed = changed

    @property
    def _held(self) -> bool:
        return self._same > HELD and self._alone > ALONE

    def guess(self, missing: int, u: float, counts: int) -> Guess | None:
        """So many samples before one of u and counts, which go on from the last: the input on a straight line, the
        counts on the parabola that leaves the last as fast as they came to it, as the last tell, and of a long
        gap as many as are missing. None where nothing is known of them: an
        input that is lost itself, or one that is not held and leaps."""
        if not (self._samples and math.isfinite(u) and math.isfinite(self._input)):
            return None
        n, leap = missing + 1, u - self._input
        if not self._held and abs(leap) > SWITCHED * n * self._change:
            return None
        start, back = self._recent[-1], min(n if n > FEW + 1 else 1, len(self._recent) - 1)
        speed = (start - self._recent[-1 - back]) / back if back else 0.0
        bend = (counts - start - speed * n) / (n * (n + back))
        between = ((self._input + k / n * leap, start + round(k * (speed + bend * (k + back)))) for k in range(1, n))
        return Guess(tuple(between), self._doubt(missing, leap) if self._held else 0)

    def _doubt(self, missing: int, leap: float) -> int:
        """A held input may have switched at any of the instants."""
        rate = self.estimator.cutoff * self.estimator.dt
        if abs(leap) * missing * rate / math.sqrt(12) <= DOUBTFUL * math.sqrt(self._power):
            return 0
        return missing + round(FORGOTTEN / rate)
