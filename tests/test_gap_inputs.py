"""Unseen inputs: the values that replace them under a controller, and at a switch of the input."""

from __future__ import annotations

import numpy as np
import pytest

from pmfid._stage import Inputs
from pmfid.estimators.iv import RIV
from pmfid.monitor.monitor import guess
from pmfid.status import Status
from pmfid.types import Counts, Flags, Floats
from tests.test_gaps import CUTOFF, DT, SETTINGS, TRUTH, kept, run

RATE = CUTOFF * DT


# --- on-line ----------------------------------------------------------------------------------------------------------


def online(there: Flags, u: Floats, counts: Counts) -> tuple[Floats, np.ndarray]:
    """Return theta (m, 3) and status (m,) at the present samples."""
    riv, found, last = RIV(**SETTINGS), [], -1
    inputs = Inputs()
    for k in np.flatnonzero(there).tolist():
        between = guess(inputs, RATE, k - last - 1, float(u[k]), int(counts[k])) if k - last > 1 else None
        if between and between.doubt:
            riv.doubt(between.doubt)
        for moment in (*(between.samples if between else ()), (float(u[k]), int(counts[k]))):
            estimate = riv.step(*moment)
            inputs.step(*moment)
        found.append((estimate.theta / TRUTH, estimate.status))
        last = k
    return np.array([theta for theta, _ in found]), np.array([status for _, status in found])


@pytest.mark.parametrize(("part", "used"), [(0.1, 0.7), (0.3, 0.4)])
def test_on_line_a_hidden_switch_costs_some_samples_and_no_spike(part: float, used: float) -> None:
    """Filters that restart lost half of the samples at 10 %, and all but a tenth at 30 %."""
    u, counts = run(4000)
    theta, status = online(kept(4000, part), u, counts)
    settled, own = (status & int(Status.SETTLING)) == 0, (status & int(Status.FALLBACK | Status.STARTING)) == 0
    assert np.mean(settled) > used
    assert np.mean(own) > used
    late = np.arange(own.size) > round(1 / DT)
    assert np.all((theta[own & late] > 0.7) & (theta[own & late] < 1.5))
    np.testing.assert_allclose(theta[-1], 1.0, atol=0.05)
