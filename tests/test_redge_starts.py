"""Starts of the recursion over edges: from few edges, from given parameters, and after a change."""

import numpy as np
import pytest

from pmfid import Drive, Encoder, REdge, Status
from studies import edge_step
from studies.edge_faults import SMALL, TICK
from studies.edge_starts import start
from studies.edges import make_record
from studies.machines import truth
from tests.test_redge import TRUTH, estimator_of, swing


def test_long_gaps_between_edges_start_the_estimate() -> None:
    """The gaps between edges are longer than 20 samples, and the input rises in few of them."""
    resolution, record = make_record(SMALL, "prbs", 16, off=0.03, late=0.0, seed=0)
    track = REdge(Drive(SMALL.drive.input_gain), Encoder(resolution), SMALL.dt, lines=16, tick=TICK).run(*record)
    assert SMALL.dt * np.argmax(track.status & Status.STARTING == 0) < 3.0
    np.testing.assert_allclose(track.theta[-1], truth(SMALL), rtol=1e-4)
    assert track.status[-1] == 0


@pytest.mark.parametrize("seed", [3, 18])
def test_given_parameters_that_are_far_off_do_no_harm(seed: int) -> None:
    right, _ = start(4096, guessed=True, seed=seed)
    assert right


def test_a_large_change_of_the_mass_is_followed_at_once() -> None:
    error, _, time = edge_step.judge(edge_step.follow("prbs", 9).edges)
    assert abs(error) < 0.001
    assert time < 2.0


def test_no_standard_error_is_below_the_error_of_a_crystal() -> None:
    u, counts, ages, step = swing(64)
    std = estimator_of(step, 64).run(u, counts, ages).theta_std[-1]
    assert np.all(std >= [2e-5, 1e-5, 1e-5] * TRUTH)
    assert np.all(std < 3e-5 * TRUTH)
