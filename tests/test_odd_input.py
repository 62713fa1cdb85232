"""Numbers of odd sizes and kinds, and files that have changed."""

from __future__ import annotations

import numpy as np
import pytest

import pmfid
from tests.conftest import cart_run
from tests.refusals import refused


def rls() -> pmfid.RLS:
    return pmfid.RLS(pmfid.Drive(2.0), pmfid.Encoder(1e-4), 0.01, 30.0, forgetting=0.99)


@pytest.mark.parametrize("turns", [2**63, 2**64, -(2**70)])
def test_a_count_of_any_size_is_taken_modulo_the_counter(turns: int) -> None:
    run = cart_run(1, samples=300)
    near, far = rls(), rls()
    for u, count in zip(run.u, run.counts.tolist(), strict=True):
        near.step(u, count)
        far.step(u, count + turns)
    assert near.get_state()[100:] == far.get_state()[100:]
    assert np.array_equal(near.estimate.theta, far.estimate.theta)


@pytest.mark.parametrize("counts", [[0, 1e30], [0, 2**70], [0.0, -9.3e18]])
def test_counts_beyond_64_bits_are_refused_in_one_sentence(counts: list[float]) -> None:
    refused(
        (r"beyond the range of 64 bits: give them modulo 2\^bits", lambda: rls().run(np.zeros(2), counts)),
        ("beyond the range of 64 bits", lambda: pmfid.Fleet(rls(), 1).run(np.zeros(2), [counts])),
    )
