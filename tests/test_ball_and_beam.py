"""The measured ball and beam (DaISY, KU Leuven): the position from the beam's angle, with two integrators."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pmfid import SRIVC, Encoder, Experiment, TransferFunction
from pmfid.estimators.srivc import make_structure
from pmfid.linear.responses import channels

PLACE = Path("shared", "data", "real", "daisy", "ball-and-beam.csv")
RECORD = next((parent / PLACE for parent in Path(__file__).parents if (parent / PLACE).exists()), None)
DT, AHEAD, WINDOW = 0.1, 50, 20


@pytest.mark.skipif(RECORD is None, reason="the record of the ball and beam is not on this machine")
def test_two_integrators_predict_better_than_the_last_slope():
    """The model is fitted to the first half and predicts 50 samples of the second half with known input.

    Each prediction starts from a free fit to the preceding 20 samples. The model's root mean square error must be less
    than the error of straight lines through the last 2 to 20 samples.
    """
    u, y = np.loadtxt(str(RECORD), delimiter=",", skiprows=1).T
    half, model = u.size // 2, TransferFunction(2, 0, integrators=2)
    fit = SRIVC(model, Encoder(1.0), DT, 2.0).fit_experiments([Experiment(u[:half], y[:half], dt=DT)])
    structure, ours, lines = make_structure(model, DT, 1.0), [], {length: [] for length in (2, 5, 10, 20)}
    for k in range(half + WINDOW, u.size - AHEAD):
        part = slice(k - WINDOW + 1, k + AHEAD + 1)
        stretch = Experiment(u[part], y[part], dt=DT).stretches()[0]
        states = channels(structure, fit.theta, stretch, twice=False).single
        forced, free = fit.theta[0] * states[0, 0], states[:2, -1]
        start = np.linalg.lstsq(free[:, :WINDOW].T, (y[part] - forced)[:WINDOW], rcond=None)[0]
        ours.append(y[k + AHEAD] - (forced + start @ free)[-1])
        for length, errors in lines.items():
            line = np.polyfit(np.arange(1 - length, 1), y[k - length + 1 : k + 1], 1)
            errors.append(y[k + AHEAD] - np.polyval(line, AHEAD))
    best = min(np.sqrt(np.mean(np.square(errors))) for errors in lines.values())
    assert np.sqrt(np.mean(np.square(ours))) < 0.9 * best
