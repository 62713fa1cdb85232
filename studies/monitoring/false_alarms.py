"""The rate of false alarms."""

from __future__ import annotations

import numpy as np

from pmfid.monitor.detector import start_detection, statistics
from pmfid.types import Floats

#: Requested mean times between false alarms [h].
ASKED = (1.0, 24.0)
#: Delay of the detector's restart after an alarm [s].
HOLD = 15.0


def count_alarms(x: Floats, w: Floats, threshold: float, hold: int) -> int:
    """Count alarms over x, w (runs, n, p); after each alarm the detector restarts `hold` blocks later."""
    runs, n, p = x.shape
    state, waiting, alarms, tolerance = start_detection((runs, p)), np.zeros(runs, int), 0, np.zeros(p)
    for k in range(n):
        statistic = statistics(x[:, k : k + 1], w[:, k : k + 1], tolerance, state)[:, 0]
        fired = (statistic > threshold) & (waiting == 0)
        alarms += int(fired.sum())
        waiting = np.where(fired, hold, np.maximum(waiting - 1, 0))
        state[waiting > 0] = 0.0
    return alarms


def poisson_interval(alarms: int, hours: float) -> tuple[float, float]:
    """Return the 95 % interval of the mean time between alarms [h] (Garwood 1936)."""
    from scipy.stats import chi2

    low = 2 * hours / float(chi2.ppf(0.975, 2 * alarms + 2))
    return low, 2 * hours / float(chi2.ppf(0.025, 2 * alarms)) if alarms else float("inf")
