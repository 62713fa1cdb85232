"""Error bars of a motion that sticks and breaks away, so that the sum of squares is rough."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from pmfid.cli.main import main
from tests.conftest import long_unless

MOTOR = Path(__file__).parents[2] / "shared" / "data" / "real" / "odrive"
needs_motor = pytest.mark.skipif(not MOTOR.exists(), reason="the motor's records are not on this machine")
#: Inertia from the settling time that the records' authors state [V s^2/turn].
INERTIA = 1.6e-4
INCREMENTS, LATE, TICK = 8192, 0.004, 1 / 8000
AXIS = """
record = { input = "u", output = "counts", output_kind = "counts", time = "t" }
encoder = { resolution = 1.220703125e-4 }
model = { input_gain = 1.0, offset = true }
estimator = { method = "METHOD", cutoff = CUTOFF }
"""


def motor_log(name: str, dt: float) -> np.ndarray:
    """Return t, u, counts (n, 3) of one record, with even steps and with the dead time of the log in the input."""
    lines = (MOTOR / f"{name}.csv").read_text().splitlines()
    rows = np.array([[float(x) for x in line.strip(";").split(",")[:3]] for line in lines if line[:1].isdigit()])
    rows = rows[: 1 + int(np.argmax(rows[:, 0]))]
    t = rows[:, 0] * TICK
    even = np.arange(t[0], t[-1], dt)
    before = np.maximum(np.searchsorted(t, even - LATE, side="right") - 1, 0)
    return np.column_stack([even - t[0], rows[before, 1], np.round(np.interp(even, t, rows[:, 2]) * INCREMENTS)])


@needs_motor
@pytest.mark.parametrize(
    ("name", "dt", "cutoff", "method"),
    long_unless(
        lambda name, dt, cutoff, method: method == "auto" or name == "chirp1",
        [
            (*log, method)
            for log in [("chirp1", 6e-3, 10), ("chirp2", 6e-3, 10), ("chirp2", 5e-3, 5)]
            for method in ("iv", "auto")
        ],
    ),
)
def test_a_chirp_that_cannot_carry_the_inertia_gives_none(
    name: str, dt: float, cutoff: float, method: str, tmp_path: Path
) -> None:
    """The inertia was once 1.1e-5 with an error bar of 4.8e-9; the true inertia is 1.6e-4."""
    np.savetxt(tmp_path / "log.csv", motor_log(name, dt), delimiter=",", header="t,u,counts", comments="")
    (tmp_path / "axis.toml").write_text(AXIS.replace("METHOD", method).replace("CUTOFF", str(cutoff)))
    command = ["identify", str(tmp_path / "log.csv"), "--config", str(tmp_path / "axis.toml"), "--json"]
    result = CliRunner().invoke(main, command)
    if result.exit_code == 0:
        printed = json.loads(result.stdout)
        mass = printed["parameters"]["mass"]
        assert abs(mass["value"] - INERTIA) < 3 * mass["std"] or "rate_low" in printed["status"]
    else:
        assert result.exit_code == 3
        reasons = (
            "cannot identify",
            "excitation is too poor",
            "excitation is poor",
            "make a new record at a sample period",
        )
        assert any(reason in result.stderr for reason in reasons)
