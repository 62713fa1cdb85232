"""The encoder of the simulated cart: displaced lines, jitter, missed edges, wrap-around."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pmfid.simulation import CART, CART_CONTROL, Faults, position_control, quantize, stop_and_go
from pmfid.simulation._plant import read_encoder
from tests.refusals import refused


def counts_of(x: np.ndarray, lines: np.ndarray | None = None, missed: float = 0.0, seed: int = 0) -> np.ndarray:
    """Return the counts at x [counts]."""
    places = np.zeros(1) if lines is None else lines
    return read_encoder(np.asarray(x, float), 1.0, 0.0, places, np.zeros(0), missed, seed)


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=50), st.floats(1e-3, 10.0), st.floats(0.0, 1.0))
@settings(max_examples=200)
def test_without_faults_it_is_the_floor(x: list[float], resolution: float, phase: float) -> None:
    places = np.zeros(3)
    read = read_encoder(np.array(x), resolution, phase, places, np.zeros(0), 0.0, 5)
    np.testing.assert_array_equal(read, quantize(x, resolution, phase))


@given(st.lists(st.floats(-0.49, 0.49), min_size=1, max_size=7), st.lists(st.floats(-40.0, 40.0), max_size=50))
@settings(max_examples=200)
def test_lines_lie_where_the_table_says_turn_after_turn(errors: list[float], x: list[float]) -> None:
    edges = np.array([k + errors[k % len(errors)] for k in range(-60, 60)])
    expected = np.searchsorted(edges, x, side="right") - 61
    np.testing.assert_array_equal(counts_of(np.array(x), np.array(errors)), expected)


def test_jitter_moves_the_edges_by_its_standard_deviation() -> None:
    x = np.full(40_000, 0.25)
    counts = quantize(x, 1.0, faults=Faults(jitter=0.5, seed=3))
    below = np.mean(counts < 0)  # probability that a normal variable is below -0.5 standard deviations
    assert below == pytest.approx(0.3085, abs=0.01)
    assert quantize(x, 1.0, faults=Faults(jitter=0.01)).tolist() == [0] * x.size


def test_missed_edges_add_up_with_the_sign_of_the_motion() -> None:
    n, p = 200_000, 0.02
    there = counts_of(np.arange(n), missed=p)
    lost = n - 1 - int(there[-1])
    assert lost == pytest.approx(p * n, abs=5 * np.sqrt(p * n))
    gaps = np.diff(np.flatnonzero(np.diff(there) == 0))
    assert gaps.mean() == pytest.approx(1 / p, rel=0.1)
    assert gaps.std() == pytest.approx(1 / p, rel=0.1)  # geometric distribution: the deviation is about the mean
    back = counts_of(-np.arange(n), missed=p)
    assert back[-1] == -there[-1]


def test_missed_edges_do_not_depend_on_the_sampling() -> None:
    fine = counts_of(np.arange(0.0, 5000.0, 0.25), missed=0.05, seed=9)
    coarse = counts_of(np.arange(0.0, 5000.0, 25.0), missed=0.05, seed=9)
    np.testing.assert_array_equal(fine[::100], coarse)


def test_the_controller_sees_the_faults_and_counts_on_past_the_wrap() -> None:
    reference = stop_and_go(600, 0.01, 0.2, 0.8, 0.5)
    lattice = {"resolution": 1.82e-4, "phase": 1e-5}
    faults = Faults(missed=0.01, jitter=0.1, line_error=0.3, lines=512, seed=4)
    whole, counts = position_control(CART, reference, 0.01, **CART_CONTROL, **lattice, faults=faults)
    again, narrow = position_control(CART, reference, 0.01, **CART_CONTROL, **lattice, faults=faults, bits=8)
    np.testing.assert_array_equal(whole.x, again.x)
    np.testing.assert_array_equal(narrow, counts % 256)
    assert counts.max() > 512
    np.testing.assert_array_equal(counts, quantize(whole.x, **lattice, faults=faults))
    good, _ = position_control(CART, reference, 0.01, **CART_CONTROL, **lattice)
    # missed edges make the cart go further than commanded
    assert whole.x[125] > good.x[125] + 5 * lattice["resolution"]


def test_bad_faults_name_the_remedy() -> None:
    refused(
        (r"missed must be in \[0, 1\), got 1.0; give the part", lambda: Faults(missed=1.0)),
        (r"jitter must be in \[0, inf\), got -0.1; give a standard deviation", lambda: Faults(jitter=-0.1)),
        ("jitter .* got nan", lambda: Faults(jitter=float("nan"))),
        (r"line_error must be in \[0, 0.5\), got 0.5; give less", lambda: Faults(line_error=0.5)),
        ("lines .* got 0; give the counts per turn", lambda: Faults(lines=0)),
        ("seed .* got -1; give any whole number", lambda: Faults(seed=-1)),
        (r"x must have shape \(n,\)", lambda: quantize([[1.0]], 1.0, faults=Faults(missed=0.1))),
        kind=ValueError,
    )
