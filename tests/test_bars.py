"""Error bars of off-line methods against repeated experiments: they are neither far too long nor far too short."""

import numpy as np
import pytest

import pmfid
from studies.machines import AXES, machine_record, truth

SEEDS = 8


def errors_and_bars(cls, name: str, motion: str, increments: int) -> tuple[np.ndarray, np.ndarray]:
    """Return errors and error bars (SEEDS, 3) of the right model."""
    axis, errors, bars = AXES[name], [], []
    for seed in range(SEEDS):
        record = machine_record(axis, "nothing", motion, increments, seed)
        drive, encoder = pmfid.Drive(axis.drive.input_gain), pmfid.Encoder(record.resolution)
        fit = cls(drive, encoder, axis.dt, 1 / (3 * axis.dt)).fit(record.u, record.counts)
        errors.append(fit.theta - truth(axis))
        bars.append(fit.theta_std)
    return np.array(errors), np.array(bars)


@pytest.mark.parametrize(
    ("cls", "name", "motion", "increments", "longest"),
    [
        # bars were once 9 to 11 times too long
        pytest.param(pmfid.MotionFit, "cart", "stop-and-go", 4096, 2.2, marks=pytest.mark.long),
        pytest.param(pmfid.MotionFit, "rotary", "stop-and-go", 4096, 2.2, marks=pytest.mark.long),
        (pmfid.IV, "heavy", "prbs", 128, 3.0),
        (pmfid.IV, "cart", "prbs", 1024, 3.0),
        (pmfid.IV, "cart", "stop-and-go", 512, 3.0),
        (pmfid.IV, "heavy", "multisine", 4096, 9.0),
    ],
    ids=str,
)
def test_bars_are_those_of_repeated_experiments(cls, name, motion, increments, longest):
    """The bars of instruments count no cancellation beyond the memory of the filters. They are too long if the
    encoder's error cancels from move to move, and half as long as the errors if the same error repeats in every move.
    """
    errors, bars = errors_and_bars(cls, name, motion, increments)
    ratio = np.sqrt(np.mean(bars**2, axis=0) / np.mean(errors**2, axis=0))
    assert np.all(ratio < longest), ratio  # eight experiments show the deviation only to a quarter of its value
    assert np.all(ratio > 0.4), ratio
