"""The same process with white noise: input and output after the whitening filter of the noise.

The filter changes nothing between them: it goes through the process, and a filtered input is held, or a straight line,
where the input was. What is compared of models there, sums of squares and criteria, holds for noise of any colour.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pmfid.transfer.experiment import RecordStretch
from pmfid.transfer.noise import Noise
from pmfid.transfer.propagate import Grid
from pmfid.transfer.solve import ProcessProblem
from pmfid.types import Floats

#: Less than this part of the samples left by the filter, which needs its whole past: it is not used.
KEPT = 0.6


def prewhiten_problem(problem: ProcessProblem, noise: Noise) -> ProcessProblem:
    """The filtered problem, whose offset is smaller by the sum of the filter's weights. The problem itself, if steps
    are uneven or too few samples have a whole past."""
    weights = noise.whitener
    if weights.size == 1 or not all(stretch.grid.uniform for stretch in problem.stretches):
        return problem
    found = [_whiten_stretch(stretch, weights) for stretch in problem.stretches]
    least = 2 * problem.structure.size
    usable = tuple(stretch for stretch in found if stretch is not None and stretch.rows.size > least)
    if sum(s.rows.size for s in usable) < KEPT * sum(s.rows.size for s in problem.stretches):
        return problem
    return replace(problem, stretches=usable)


def _whiten_stretch(stretch: RecordStretch, weights: Floats) -> RecordStretch | None:
    from scipy.signal import lfilter  # slow to import, and only transfer functions need it

    lost = weights.size - 1
    if stretch.grid.size < lost + 2:
        return None
    measured = np.zeros(stretch.grid.size)
    measured[stretch.rows] = 1.0
    whole = lfilter(np.ones(weights.size), [1.0], measured)[stretch.rows] > lost + 0.5
    return replace(
        stretch,
        grid=Grid(stretch.grid.steps, stretch.grid.size - lost),
        inputs=np.asarray(lfilter(weights, [1.0], stretch.inputs, axis=1))[:, lost:],
        y=np.asarray(lfilter(weights, [1.0], stretch.y))[lost:],
        rows=stretch.rows[whole] - lost,
        samples=stretch.samples[whole],
    )
