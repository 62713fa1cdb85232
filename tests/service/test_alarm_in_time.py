"""The served plant of the examples: the time from the samples of a heavier load to the alarm on the page."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from examples.plant_machines import LOADED, cart
from pmfid.simulation import make_scenario
from pmfid.simulation.scenarios import write_csv
from studies.service.processes import free_port, service
from tests.command import run_command
from tests.service.broker import Broker, needs_broker, stopped_brokers  # noqa: F401 a fixture
from tests.service.chromium import chromium, tab, until

EXAMPLES = Path(__file__).parents[2] / "examples"
SECONDS, STEP = 60.0, 40.0
#: Seconds from the sample at which `pmfid monitor` finds the load until the page shows the alarm.
ALLOWED = 3.0


def plant_of(folder: Path, broker: Broker) -> Path:
    """Write examples/plant.toml with its own ports, state and token."""
    (folder / "plant_axis.toml").write_text((EXAMPLES / "plant_axis.toml").read_text())
    write_csv(make_scenario("moves", seed=0, duration=600.0), folder / "plant_normal.csv")
    text = (EXAMPLES / "plant.toml").read_text()
    page = text[text.index("[page]") : text.index("[fleets")]
    text = text.replace(page, "").replace("port = 1883", f"port = {broker.port}").replace("../plant-state", "state")
    plant = folder / "plant.toml"
    plant.write_text(f'{text}\n[page]\nport = {free_port()}\ntoken = "env:PMFID_TOKEN"\n')
    return plant


@contextmanager
def machines(broker: Broker) -> Iterator[float]:
    """Run the twelve carts; yield the time of their first sample, in s since 1970."""
    words = [EXAMPLES / "plant_machines.py", "--port", broker.port, "--seconds", SECONDS, "--step", STEP]
    with subprocess.Popen([sys.executable, "-u", *map(str, words)], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert "12 carts" in process.stdout.readline()
        try:
            yield time.time()
        finally:
            process.terminate()


def found_by_the_monitor(folder: Path) -> float:
    """Return the time of the alarm on the samples of the cart that gets the load [s]."""
    run = cart(LOADED, SECONDS, STEP)
    write_csv(run, folder / "today.csv")
    words = ["monitor", str(folder / "today.csv"), "--config", str(folder / "plant_axis.toml"), "--json"]
    result = run_command(*words)
    found = [json.loads(line) for line in result.stdout.splitlines()]
    (alarm,) = [event for event in found if event["event"] == "alarm"]
    return float(alarm["time"])


def alarm_of(log: Path) -> tuple[float, float]:
    """Return the time of the log's only alarm, by the samples and by the clock of the service."""
    found = [json.loads(line) for line in log.read_text().splitlines()]
    (alarm,) = [event for event in found if event["event"] == "alarm"]
    assert alarm["axis"] == f"cart-{LOADED:02d}"
    return float(alarm["time"]), float(alarm["wall"])


@pytest.mark.long
@needs_broker
@pytest.mark.usefixtures("stopped_brokers")
def test_the_alarm_of_the_examples_is_on_the_page_in_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "broker").mkdir()
    broker = Broker(tmp_path / "broker").start()
    plant = plant_of(tmp_path, broker)
    expected = found_by_the_monitor(tmp_path)
    with chromium() as browser, service(plant, tmp_path / "log.jsonl") as served, tab(browser) as page:
        page.goto(f"http://127.0.0.1:{served.port}/#token={served.token}")
        with machines(broker) as begin:
            page.wait_for_selector(".rows .row[data-kind]")
            shown = "document.querySelector('.tile[data-kind=alarm] .count').textContent === '1'"
            assert until(page, shown, SECONDS + 10)
            seen = time.time() - begin
            assert until(page, "document.querySelector('.rows .axis-name').textContent === 'cart-07'")
    found, wall = alarm_of(tmp_path / "log.jsonl")
    assert found == pytest.approx(expected, abs=1e-6), "as the monitor finds it"
    with capsys.disabled():
        print(
            f"\nload at {STEP:g} s, found by pmfid monitor and by the service at the sample of {expected:.2f} s, "
            f"reported {wall - begin - expected:.2f} s and on the page {seen - expected:.2f} s after that sample was "
            f"taken"
        )
    assert seen - expected < ALLOWED
