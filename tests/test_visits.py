"""A series of estimates of single visits: steps and drifts in both directions, and what it cannot show."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from pmfid.cli.main import main
from pmfid.fleet.visits import Visits, find_changes
from pmfid.types import Floats

VISITS, PERIOD = 60, 35 * 3600.0
TIME: Floats = 1.7e9 + PERIOD * np.arange(VISITS)


def noisy(level: np.ndarray, seed: int) -> Visits:
    """Return a friction of 2 N times a level, estimated to 2 %."""
    rng = np.random.default_rng(seed)
    return Visits("friction", TIME, 2 * level * (1 + 0.02 * rng.standard_normal(VISITS)))


def steps(*levels: float) -> np.ndarray:
    return np.repeat(levels, VISITS // len(levels))


@pytest.mark.parametrize("levels", [(1.0, 1.1), (1.0, 0.9), (1.0, 1.2, 1.05), (1.0, 0.8, 1.0, 1.3)], ids=str)
def test_steps_are_found_with_size_and_time(levels: tuple[float, ...]) -> None:
    found = find_changes(noisy(steps(*levels), 1), 0.02)
    assert [one.kind for one in found] == ["changed"] * (len(levels) - 1)
    for k, one in enumerate(found):
        true = levels[k + 1] / levels[k] - 1
        assert abs(one.size - true) < 4 * one.std < 0.06
        when = (k + 1) * VISITS // len(levels)
        assert abs(one.until - TIME[when]) <= PERIOD


@pytest.mark.parametrize("growth", [0.2, -0.2])
def test_a_drift_is_found_in_both_directions(growth: float) -> None:
    (found,) = find_changes(noisy(1 + growth * np.arange(VISITS) / VISITS, 2), 0.02)
    assert found.kind == "drifts"
    assert found.total == pytest.approx(growth, abs=0.03)


def judged(path: Path, *arguments: str) -> Result:
    return CliRunner().invoke(main, ["monitor", "--estimates", str(path), *arguments])


def write(path: Path, visits: Visits, head: str = "date,mass,friction") -> Path:
    days = np.datetime64("2026-01-01T00:00") + np.arange(visits.values.size) * np.timedelta64(35, "h")
    path.write_text(
        "\n".join([head, *(f"{day}:00,1.0,{value:.6g}" for day, value in zip(days, visits.values, strict=True))])
    )
    return path


def test_the_command_reads_a_table(tmp_path: Path) -> None:
    path = write(tmp_path / "visits.csv", noisy(steps(1.0, 1.1), 1))
    shown = judged(path, "--column", "friction")
    assert shown.exit_code == 0, shown.output
    first, last = shown.output.splitlines()
    assert first.startswith("friction +")
    assert "between 2026-02-12" in first
    assert last.startswith("60 visits: a step of ")
    reported = [json.loads(line) for line in judged(path, "--column", "friction", "--json").output.splitlines()]
    assert [one["event"] for one in reported] == ["changed", "end"]
