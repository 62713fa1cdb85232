"""Rows with an old output, as from a bus that is polled faster than it is refreshed."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pmfid.pipeline.arrays import identify
from pmfid.records.repeats import find_stale_rows, miss_stale_rows
from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, prbs, quantize, simulate_drive
from pmfid.types import Flags, Floats
from tests.conftest import TRUTH

SAMPLES = 3000


def polled(seed: int = 4) -> tuple[dict[str, Floats], Flags, Floats]:
    """Return the cart's columns, the 10 % of rows that repeat the previous output, and the original outputs."""
    rng = np.random.default_rng(seed)
    u = prbs(SAMPLES, clock=8, amplitude=4.0, rng=rng)
    y = quantize(simulate_drive(CART, u, CART_DT).x, CART_RESOLUTION).astype(float)
    old = rng.random(SAMPLES) < 0.1
    old[0] = False
    shown = y[np.maximum.accumulate(np.where(old, 0, np.arange(SAMPLES)))]
    return {"time": np.arange(SAMPLES) * CART_DT, "input": u, "output": shown}, old, y


def test_old_rows_are_found_and_true_ones_stay() -> None:
    columns, _, y = polled()
    found = find_stale_rows(columns["time"], columns["output"])
    off = np.abs(columns["output"] - y)
    assert np.sum(found & (off == 0)) < 0.01 * SAMPLES
    assert np.sum(~found & (off > 1)) <= 2
    left, count = miss_stale_rows(columns, 1.0)
    assert count == np.sum(found) == np.sum(np.isnan(left)) > 250


def test_identify_is_right_and_says_so_once(tmp_path: Path) -> None:
    columns, *_ = polled()
    axis = tmp_path / "axis.toml"
    axis.write_text(
        '[record]\ninput = "input"\noutput = "output"\noutput_kind = "counts"\ntime = "time"\n'
        f"[encoder]\nresolution = {CART_RESOLUTION!r}\n[model]\ninput_gain = {CART.input_gain}\n"
    )
    result = identify(columns, axis=axis)
    np.testing.assert_allclose(result.theta, TRUTH, rtol=2e-3)
    said = [finding.sentence for finding in result.findings if "repeat" in finding.sentence]
    assert len(said) == 1
    assert "of the rows repeat the output of the row before" in said[0]
