"""Friction that follows a temperature raises no alarm, and friction that changes on top of it does."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from pmfid import IV
from pmfid.estimators.configuration import like
from pmfid.monitor import Alarm, Monitor, MonitorFleet, Watch
from pmfid.monitor.events import FleetRows
from pmfid.monitor.warmth import find_warmth
from pmfid.simulation import CART
from studies.monitoring.warm_axis import DRY, DT, RATE, RESOLUTION, Columns, make_monitor, record
from tests.command import run_command
from tests.refusals import refused

AXIS = f"""
[record]
dt = {DT}
input = "u"
output = "counts"
output_kind = "counts"
friction_temperature = "temp"

[encoder]
resolution = {RESOLUTION}

[model]
input_gain = {CART.input_gain}

[monitor]
reference = "normal.csv"
"""


@pytest.fixture(scope="module")
def monitor() -> Monitor:
    return make_monitor(1, Watch(tolerance=0.01), minutes=15.0)


def test_the_rate_of_friction_comes_from_the_reference(monitor: Monitor) -> None:
    """The other parameters do not follow the temperature, and the work is no noisier than the encoder explains."""
    made, warmth = monitor.calibration, monitor.calibration.warmth
    assert warmth is not None
    middle = 1 + RATE * (warmth.mean - 30)
    assert warmth.rate == pytest.approx([0.0, 0.0, RATE / middle], abs=5e-4)
    assert made.theta[2] == pytest.approx(DRY.coulomb_friction * middle, rel=0.005)
    assert made.noise.tolist() == [1.0, 1.0, 1.0]


def as_csv(columns: Columns) -> str:
    rows = (f"{u!r},{count},{warm:.4f}" for u, count, warm in zip(*(one.tolist() for one in columns), strict=True))
    return "\n".join(["u,counts,temp", *rows]) + "\n"


def alarms(rows: FleetRows) -> list[tuple[str, bool]]:
    return [(event.parameter, event.change > 0) for *_, event in rows.events if isinstance(event, Alarm)]


def test_a_cycle_of_the_temperature_is_no_change(monitor: Monitor) -> None:
    u, counts, temperature = record(2, 12.0, 0.3)
    assert alarms(monitor.fresh().run(u, counts, temperature)) == []
    assert alarms(monitor.fresh().run(u, counts))[0][0] == "coulomb_friction"


@pytest.mark.parametrize("growth", [0.1, pytest.param(-0.1, marks=pytest.mark.long)])
def test_friction_that_changes_on_top_of_the_cycle_is_named(monitor: Monitor, growth: float) -> None:
    rows = monitor.fresh().run(*record(3, 12.0, 0.3, -5 * growth))
    assert set(alarms(rows)) == {("coulomb_friction", growth > 0)}


def test_samples_pieces_and_fleets_agree(monitor: Monitor) -> None:
    """A temperature may be known now and then only. A state may be saved within a block."""
    u, counts, temperature = (column[:4000] for column in record(4, 0.7, 0.02, -40.0))
    temperature = np.where(np.arange(4000) % 7 == 3, temperature, np.nan)
    whole = monitor.fresh().run(u, counts, temperature)
    single = monitor.fresh()
    for k in range(1234):
        single.step(float(u[k]), int(counts[k]), float(temperature[k]))
    again = monitor.fresh()
    again.set_state(single.get_state())
    rest = again.run(u[1234:], counts[1234:], temperature[1234:])
    fleet = MonitorFleet(monitor, 2)
    both = fleet.run([0, 1], np.tile(u, (2, 1)), np.tile(counts, (2, 1)), np.tile(temperature, (2, 1)))
    for name in ("theta", "std", "innovation", "status", "state"):
        assert np.array_equal(getattr(rest, name)[0], getattr(whole, name)[0, 1234:])
        assert np.array_equal(getattr(both, name)[1], getattr(whole, name)[0])
    assert [repr(event) for axis, _, event in both.events if axis] == [repr(event) for *_, event in whole.events]


def test_the_command_reads_the_temperature(tmp_path: Path) -> None:
    """The command learns the rate from the reference. It names no change, and the first temperature beyond it."""
    (tmp_path / "normal.csv").write_text(as_csv(record(6, 10.0, 0.2)))
    (tmp_path / "axis.toml").write_text(AXIS)
    columns = record(7, 4.0, 0.2)
    columns[2][-5:] = 99.0
    (tmp_path / "run.csv").write_text(as_csv(columns))
    outcome = run_command("monitor", str(tmp_path / "run.csv"), "--config", str(tmp_path / "axis.toml"), "--json")
    events = [json.loads(line) for line in outcome.stdout.splitlines()]
    assert events[-1]["samples"] == 24_000
    assert events[-1]["alarms"] == 0
    (note,) = [event for event in events if event["event"] == "temperature"]
    assert note["problem"].startswith("99 is beyond")


def test_wrong_temperatures_are_refused(monitor: Monitor) -> None:
    u, counts, temperature = (column[:100] for column in record(5, 0.1, 0.1))
    front = like(IV, monitor.estimator, prefilter_zeros=None)
    still = np.full(u.size, 30.0)
    refused(
        ("does not vary", lambda: find_warmth(front, monitor.reference, u, counts, still)),
        ("temperature must have the shape", lambda: monitor.fresh().run(u, counts, temperature[1:])),
    )
