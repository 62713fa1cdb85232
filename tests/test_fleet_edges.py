"""The history of a fleet with the ages of edges."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from pmfid import fleet
from pmfid.fleet.history import History
from pmfid.simulation import CART, CART_DT, Schedule, resolution_of
from tests.edge_axes import AXIS, TURN, cart_edges, heavier

SECONDS, WHEN = 240.0, 130.0
PERIOD = 60.0
#: Hours of the first sample, so that times are those of a lake.
BEGUN = 1.7e9 - 1.7e9 % PERIOD


def rows(name: str, schedule: Schedule, seed: int) -> pl.DataFrame:
    u, counts, ages = cart_edges(schedule, seed, SECONDS)
    age_us = [None if np.isnan(age) else 1e6 * age for age in ages.tolist()]
    time = BEGUN + CART_DT * np.arange(u.size)
    return pl.DataFrame(
        {"machine": name, "t": time, "u": u, "n": counts, "age_us": pl.Series(age_us, dtype=pl.Float64)}
    )


@pytest.fixture(scope="module")
def log() -> pl.DataFrame:
    """Return the rows of four axes: one changes, one misses rows, one has a clock that is uneven."""
    whole = Schedule(((0.0, CART),))
    frames = [rows("same", whole, 1), rows("changed", heavier(WHEN, mass=1.05), 2)]
    missing = np.ones(frames[0].height, bool)
    missing[5000::4000] = False
    frames.append(rows("missing", whole, 3).filter(pl.Series(missing)))
    uneven = 0.2 * CART_DT * (-1.0) ** np.arange(frames[0].height)  # steps of 6 and 14 ms in turn
    frames.append(rows("uneven", whole, 4).with_columns(pl.col("t") + pl.Series(uneven)))
    return pl.concat(frames)


@pytest.fixture(scope="module")
def axis(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("axis") / "axis.toml"
    path.write_text(AXIS.replace('"age"', '"age_us"') % (resolution_of(TURN), ""))
    return path


@pytest.fixture(scope="module")
def found(log: pl.DataFrame, axis: Path) -> History:
    return fleet.estimate(log, axis=axis, by="machine", period="1min", segment=20.0, workers=1)


def test_edges_name_a_small_change_with_its_cause(found: History) -> None:
    (row,) = found.named.iter_rows(named=True)
    assert (row["axis"], row["kind"], row["cause"]) == ("changed", "changed", "mass")
    assert abs(row["size"] - 0.05) < max(4 * row["std"], 1e-4)
    assert row["std"] < 3e-3
    assert abs(row["since"] - BEGUN - WHEN) <= 20.0
