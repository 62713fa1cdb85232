"""The rate of false alarms of the detectors, compared to the requested rate."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from typing import Any

import numpy as np

from pmfid.monitor.calibration import Calibration, block_keep
from pmfid.monitor.detectors import Detector, make_detectors
from pmfid.monitor.scores import block_samples, scores
from pmfid.simulation.scenarios import CART_DT
from pmfid.types import Floats
from studies.monitoring.axis import INCREMENTS, calibration, make_riv, normal_work

RUN_HOURS, RUNS_PER_TASK = 0.5, 25
ASKED = (1.0, 24.0)
#: Delay of a detector's restart after an alarm [s].
HOLD = 15.0


def work(task: int, increments: int = INCREMENTS) -> dict[str, Any]:
    """Count the alarms of every detector for every requested time in RUNS_PER_TASK runs, at tolerance 0. The result
    includes the hours, and the correlation of blocks one and two apart."""
    riv, found = make_riv(increments), calibration(increments)
    seeds = [1000 + RUNS_PER_TASK * task + k for k in range(RUNS_PER_TASK)]
    blocks = [scores(riv, found.theta, *normal_work(seed, increments, RUN_HOURS)) for seed in seeds]
    x, w = map(np.stack, zip(*(found.scale.standardise(part) for part in blocks), strict=True))
    hold, alarms = round(HOLD / (block_samples(riv) * CART_DT)), {}
    for asked, (name, detector) in product(ASKED, _detectors(riv, found).items()):
        alarms[name, asked] = count_alarms(detector, x, w, found.tails[name].threshold(asked), hold)
    block_hours = block_samples(riv) * CART_DT / 3600
    return {"alarms": alarms, "hours": x.shape[0] * x.shape[1] * block_hours, "correlation": _correlation(x)}


def _detectors(riv: Any, found: Calibration) -> Mapping[str, Detector]:
    return make_detectors(block_keep(riv), found.chi_square)


def count_alarms(detector: Detector, x: Floats, w: Floats, threshold: float, hold: int) -> int:
    """Count alarms over x, w (runs, n, p); after each alarm the detector restarts `hold` blocks later."""
    runs, n, p = x.shape
    fresh = detector.start((runs, p))
    state, waiting, alarms, tolerance = fresh, np.zeros(runs, int), 0, np.zeros(p)
    for k in range(n):
        state, statistic = detector.update(state, x[:, k], w[:, k], tolerance)
        fired = (statistic > threshold) & (waiting == 0)
        alarms += int(fired.sum())
        waiting = np.where(fired, hold, np.maximum(waiting - 1, 0))
        state = np.where((waiting > 0)[:, None, None], fresh, state)
    return alarms


def _correlation(x: Floats) -> Floats:
    """Return the correlation (2, p) of blocks one and two apart."""
    power = np.mean(x**2, axis=(0, 1))
    return np.array([np.mean(x[:, lag:] * x[:, :-lag], axis=(0, 1)) / power for lag in (1, 2)])


def poisson_interval(alarms: int, hours: float) -> tuple[float, float]:
    """Return the 95 % interval of the mean time between alarms [h] (Garwood 1936)."""
    from scipy.stats import chi2

    low = 2 * hours / float(chi2.ppf(0.975, 2 * alarms + 2))
    return low, 2 * hours / float(chi2.ppf(0.025, 2 * alarms)) if alarms else float("inf")


def write(results: list[dict[str, Any]]) -> tuple[list[list[str]], float]:
    """Return the rows of the table, and the simulated hours."""
    hours, rows = float(sum(result["hours"] for result in results)), []
    for name, asked in results[0]["alarms"]:
        alarms = sum(result["alarms"][name, asked] for result in results)
        low, high = poisson_interval(alarms, hours)
        found = hours / alarms if alarms else float("inf")
        verdict = "yes" if asked / 2 <= found <= 2 * asked else "no"
        rows.append([name, f"{asked:g}", str(alarms), f"{found:.3g}", f"{low:.3g} to {high:.3g}", verdict])
    return rows, hours
