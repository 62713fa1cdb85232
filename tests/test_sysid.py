"""Logs of WPILib SysId: gains of simulated mechanisms, and refusals."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from pmfid.cli.main import main
from pmfid.types import Floats

STEP, PARTS, COUNTS = 0.02, 40, 4096
GAINS = {"kS": 0.25, "kV": 2.4, "kA": 0.35}


def simulate(t: Floats, volts: Floats, kG: float = 0.0, arm: bool = False) -> tuple[Floats, Floats]:
    """Return positions and velocities (n,) [unit, unit/s] of a mechanism with `GAINS`. Friction is implicit, and the
    viscous part of a step is exact."""
    x, v, rows = 0.0, 0.0, []
    for volt, step in zip(volts.tolist(), np.diff(t, append=t[-1] + STEP).tolist(), strict=True):
        rows.append((x, v))
        h = step / PARTS
        decay = math.exp(-GAINS["kV"] / GAINS["kA"] * h)
        share = (1 - decay) / GAINS["kV"]
        for _ in range(PARTS):
            moved = decay * v + share * (volt - kG * (math.cos(x) if arm else 1.0))
            moved = math.copysign(max(abs(moved) - share * GAINS["kS"], 0.0), moved)
            x, v = x + 0.5 * h * (v + moved), moved
    found = np.array(rows)
    return found[:, 0], found[:, 1]


def make_log(test: str = "Simple", kG: float = 0.0, turn: float = 0.5, top: float = 4.0) -> dict[str, object]:
    """Return a log in the format of SysId with uneven times, in rotations."""
    rng = np.random.default_rng(1)
    content: dict[str, object] = {"sysid": True, "test": test, "units": "Meters", "unitsPerRotation": turn}
    for name in ("slow-forward", "slow-backward", "fast-forward", "fast-backward"):
        t = np.cumsum(rng.uniform(0.95, 1.05, 200 if "slow" in name else 75) * STEP)
        sign = 1 if "forward" in name else -1
        volts = sign * (top / t[-1] * t if "slow" in name else np.full(t.size, 7.0))
        position, velocity = simulate(t, volts, kG, "Arm" in test)
        position = np.round(position / turn * COUNTS) / COUNTS
        content[name] = np.column_stack([t + 30.0, volts, position, velocity / turn]).tolist()
    return content


def call(tmp_path: Path, content: object, *words: str) -> Result:
    (tmp_path / "log.json").write_text(json.dumps(content), "utf-8")
    return CliRunner().invoke(main, ["actuators", str(tmp_path / "log.json"), *words])


@pytest.mark.parametrize(
    ("test", "load", "turn"), [("Simple", 0.0, 0.5), ("Elevator", 0.6, 0.5), ("Arm", 0.6, 2 * math.pi)]
)
def test_four_runs_give_the_gains(tmp_path: Path, test: str, load: float, turn: float) -> None:
    result = call(tmp_path, make_log(test, load, turn), "--json", "--out", str(tmp_path / "out"))
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)["mechanisms"]["mechanism"]
    assert found["status"] == []
    for name, truth in {**GAINS, **({"kG": load} if load else {})}.items():
        value, std = found["parameters"][name]["value"], found["parameters"][name]["std"]
        assert value == pytest.approx(truth, rel=0.01), name
        assert abs(value - truth) < 4 * std + 5e-4 * truth, name
        assert std < 0.02 * truth, name
    assert json.loads((tmp_path / "out" / "wpilib.json").read_text("utf-8"))["mechanism"]["kV"] == pytest.approx(
        2.4, 0.01
    )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"fast-backward": []}, "no run 'fast-backward': record all four tests"),
        ({"fast-backward": [[1.0, 2.0]]}, "run 'fast-backward' are not time, voltage"),
        ({"fast-backward": [[1.0, 2.0, 0.0, 0.0]]}, "has 1 times, but 10 are needed"),
        ({"units": "furlongs"}, "unknown units 'furlongs'"),
        ({"unitsPerRotation": 0}, "unitsPerRotation must be a positive number"),
        ({"test": "Drivetrain (Angular)"}, "record its linear test"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, change: dict[str, object], words: str) -> None:
    rows = [[0.1 * k, 1.0, 0.1 * k, 1.0] for k in range(20)]
    content = {"sysid": True, "units": "Meters", **dict.fromkeys(("slow-forward", "slow-backward"), rows)}
    content |= dict.fromkeys(("fast-forward", "fast-backward"), rows) | change
    result = call(tmp_path, content)
    assert result.exit_code == 2
    assert words in " ".join(result.stderr.split())
