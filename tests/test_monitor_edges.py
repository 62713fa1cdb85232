"""The monitor of edges: changes, their causes, saved states, and the command."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from pmfid import Drive, Encoder, REdge
from pmfid.cli.main import main
from pmfid.monitor import Alarm, EdgeMonitor, Settled, Watch
from pmfid.monitor.events import Event, StateChange
from pmfid.simulation import CART, Schedule, resolution_of
from tests.command import run_command
from tests.edge_axes import AXIS, TURN, Motion, cart_edges, heavier, write_record
from tests.refusals import refused
from tests.test_redge import DT, TRUTH

WHEN, SECONDS = 12.0, 24.0


def changed_run(name: str, factor: float, seed: int = 3, rest: int = 0) -> Motion:
    """Return input, counts and ages of the cart, whose parameter `name` changes at WHEN, and `rest` samples of rest."""
    return cart_edges(heavier(WHEN, **{name: factor}), seed, SECONDS, rest)


def make_monitor(memory: float | None = 10.0, precision: str = "float64", **options: object) -> EdgeMonitor:
    encoder = Encoder(resolution_of(TURN))
    estimator = REdge(Drive(2.0), encoder, DT, lines=TURN, tick=1e-6, memory=memory, precision=precision)
    return EdgeMonitor(estimator, TRUTH, Watch(**options))


def watch(monitor: EdgeMonitor, record: tuple[np.ndarray, ...]) -> list[Event]:
    return [event for row in zip(*(part.tolist() for part in record), strict=True) for event in monitor.step(*row)[1]]


@pytest.mark.parametrize(
    ("name", "factor", "precision"),
    [
        ("mass", 1.1, "float64"),
        pytest.param("mass", 0.7, "float32", marks=pytest.mark.long),
        pytest.param("viscous_friction", 1.1, "float64", marks=pytest.mark.long),
        ("coulomb_friction", 1.3, "float32"),
        ("input_gain", 0.9, "float64"),
    ],
)
def test_a_change_has_an_alarm_with_its_cause_and_size(name: str, factor: float, precision: str) -> None:
    monitor = make_monitor(precision=precision)
    events = watch(monitor, changed_run(name, factor))
    (alarm,) = (event for event in events if isinstance(event, Alarm))
    assert (alarm.parameter, alarm.others) == (name, ())
    assert WHEN < alarm.changed_at < alarm.time < WHEN + 2.5
    size = (factor - 1) * getattr(CART, name)
    assert abs(alarm.change - size) < 3 * alarm.std
    assert alarm.std < 0.5 * abs(size)
    settled = next(event for event in events if isinstance(event, Settled))
    assert np.array_equal(settled.before, TRUTH)
    expected = (
        TRUTH / factor
        if name == "input_gain"
        else [getattr(CART, n) * (factor if n == name else 1) for n in monitor.names]
    )
    np.testing.assert_allclose(settled.theta, expected, rtol=5e-3)
    assert monitor.state == "watching"


@pytest.mark.parametrize("factor", [1.0, 1.1])
def test_a_gap_is_no_suspicion_and_hides_no_change(factor: float) -> None:
    record, missing = changed_run("mass", factor), slice(1180, 1220)
    monitor = make_monitor()
    watch(monitor, tuple(part[: missing.start] for part in record))
    events = monitor.skip(missing.stop - missing.start)
    events += watch(monitor, tuple(part[missing.stop :] for part in record))
    alarms = [event for event in events if isinstance(event, Alarm)]
    assert [alarm.parameter for alarm in alarms] == (["mass"] if factor > 1 else [])
    assert all(abs(alarm.relative - 0.1) < 3 * alarm.relative * alarm.std / alarm.change for alarm in alarms)
    suspected = any(isinstance(event, StateChange) and event.state == "suspicious" for event in events)
    assert (suspected, monitor.state) == (factor > 1, "watching")


@pytest.mark.long
def test_a_slow_change_is_one_alarm_with_a_rate() -> None:
    """Each sound estimate has a part of the change, so that only the reference shows it. A step is another alarm."""
    slow = [(20.0 + 1.5 * k, replace(CART, mass=(1 + 0.002 * k) * CART.mass)) for k in range(101)]
    step = 200.0, replace(CART, mass=1.5 * CART.mass)
    events = watch(make_monitor(), cart_edges(Schedule(((0.0, CART), *slow, step)), 5, 230.0))
    alarms = [event for event in events if isinstance(event, Alarm)]
    assert [(one.parameter, one.time > 200.0) for one in alarms] == [("mass", False), ("mass", True)]
    rates = [event.rate for event in events if isinstance(event, Settled) and event.rate is not None]
    assert np.median(rates) == pytest.approx(0.2 * 3600 / 150, rel=0.3)


def test_a_monitor_goes_on_from_its_saved_state() -> None:
    record = changed_run("mass", 1.1)
    for cut in (200, 1230, 1300):
        whole, resumed = make_monitor(), make_monitor()
        watch(whole, tuple(part[:cut] for part in record))
        resumed.set_state(whole.get_state())
        rest = tuple(part[cut:] for part in record)
        assert repr(watch(resumed, rest)) == repr(watch(whole, rest))
        assert resumed.get_state() == whole.get_state()


def test_other_states_and_arguments_are_refused() -> None:
    monitor = make_monitor()
    state = monitor.get_state()
    refused(
        ("not a state of this monitor", lambda: make_monitor(tolerance=0.1).set_state(state)),
        ("not a state of this monitor", lambda: monitor.set_state(state + state)),
        ("damaged", lambda: monitor.set_state(state[:-1] + bytes([state[-1] ^ 1]))),
        ("not a state of this monitor", lambda: monitor.set_state(b"")),
        ("must forget", lambda: make_monitor(memory=None)),
        ("normal must contain values", lambda: EdgeMonitor(monitor.estimator, np.array([1.0, 0.0, 1.0]))),
    )
    assert monitor.get_state() == state


def test_the_command_watches_the_edges_of_a_record(tmp_path: Path) -> None:
    write_record(tmp_path / "run.csv", changed_run("mass", 1.1))
    write_record(tmp_path / "normal.csv", changed_run("mass", 1.0, seed=4))
    for key in (
        'reference = "normal.csv"',
        "nominal = { mass = 1.07, viscous_friction = 12.8, coulomb_friction = 0.8 }",
    ):
        (tmp_path / "axis.toml").write_text(AXIS % (resolution_of(TURN), key))
        arguments = ["monitor", str(tmp_path / "run.csv"), "--config", str(tmp_path / "axis.toml")]
        done = run_command(*arguments, "--json", "--report", str(tmp_path / "page.html"))
        events = [json.loads(line) for line in done.stdout.splitlines()]
        (alarm,) = (event for event in events if event["event"] == "alarm")
        assert (alarm["parameter"], alarm["direction"]) == ("mass", "up")
        assert (events[0]["method"], events[0]["nominal"]["mass"]) == ("redge", pytest.approx(1.07, rel=1e-3))
    assert "standard errors" in (tmp_path / "page.html").read_text()
    assert "ALARM  since " in CliRunner().invoke(main, arguments).stdout
    (tmp_path / "axis.toml").write_text(AXIS % (resolution_of(TURN), ""))
    assert "[monitor] reference is missing" in CliRunner().invoke(main, arguments).stderr
