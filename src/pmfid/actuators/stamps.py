"""The error of the stamps of a log.

A log that polls a bus takes a reading some time before or after its stamp. The position is then wrong by this time
multiplied by the speed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pmfid.fit.likelihood import Gaussian, climb, noise_of
from pmfid.fit.problem import ObservedStretch
from pmfid.types import Floats


def noise_with_stamps(
    stretches: Sequence[ObservedStretch],
    errors: Sequence[Floats],
    speeds: Sequence[Floats],
    rate: float,
    kinds: Sequence[str],
    period: float,
) -> tuple[Gaussian, float]:
    """Return the noise of maximum likelihood with the standard deviation [s] of the error of the stamps.

    `errors` (k,) and `speeds` (k,) are residuals [counts] and velocities [counts/s] of each stretch. The error is one
    parameter, and is there if it gains more than the cost of one by Schwarz (1978). `period` is that of the log [s].
    """
    bare = noise_of(stretches, errors, rate, kinds)

    def value(octaves: float) -> float:
        jittered = _with_stamps(stretches, speeds, period * 2.0**-octaves)
        return replace(bare, stretches=jittered).evidence(errors)[0]

    plain = bare.evidence(errors)[0]
    if value(10.0) > plain:  # where the least error has no gain, no other one needs a search
        best = period * 2.0 ** -climb(value, 4.0, (0.0, 10.0))
        noise = noise_of(_with_stamps(stretches, speeds, best), errors, rate, kinds)
        if noise.evidence(errors)[0] - plain > (0.5 + noise.wanders - bare.wanders) * math.log(sum(map(len, errors))):
            return noise, best
    return bare, 0.0


def _with_stamps(
    stretches: Sequence[ObservedStretch], speeds: Sequence[Floats], error: float
) -> tuple[ObservedStretch, ...]:
    """Return the stretches with the variance of an error [s] of each stamp."""
    pairs = zip(stretches, speeds, strict=True)
    return tuple(replace(one, variance=one.variance + np.square(error * v)) for one, v in pairs)
