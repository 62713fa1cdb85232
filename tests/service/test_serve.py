"""`pmfid serve` from its command line: the events of `pmfid monitor`, reloads, restarts, refusals."""

from __future__ import annotations

import json
import os
import re
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pmfid.pipeline.monitored import setup
from pmfid.service.plant import load_plant
from pmfid.service.run import Service
from pmfid.service.sinks.plain import NoticeLog
from pmfid.simulation import CART, CART_DT, Schedule
from studies.monitoring.axis import INCREMENTS, changing
from tests.command import run_command
from tests.patience import PATIENCE
from tests.service.feed import standard_input

Events = list[dict[str, Any]]


@pytest.fixture(scope="module")
def folder(plant_place: Path) -> Path:
    """Write axis.toml, and run.csv in which the mass grows by a third; other.toml is slightly more patient."""
    heavier = Schedule(((0.0, CART), (8.0, replace(CART, mass=1.33 * CART.mass))))
    u, counts = changing(heavier, 5, INCREMENTS, 16.0)
    rows = (f"{k * CART_DT:.2f},{a!r},{b}" for k, (a, b) in enumerate(zip(u.tolist(), counts.tolist(), strict=True)))
    (plant_place / "run.csv").write_text("\n".join(["t,u,counts", *rows]) + "\n")
    text = (plant_place / "axis.toml").read_text()
    (plant_place / "other.toml").write_text(text.replace("mtbf_hours = 1.0", "mtbf_hours = 2.0"))
    return plant_place


def called(*arguments: str, code: int = 0, stdin: bytes | None = None) -> str:
    result = run_command(*arguments, code=code, stdin=stdin)
    return result.stdout if code == 0 else result.output


def events(text: str, *kinds: str) -> Events:
    found = [json.loads(line) for line in text.splitlines()]
    return [event for event in found if event["event"] in kinds]


FOUND = ("alarm", "state", "settled")


def served(plant: Path, *options: str, code: int = 0) -> str:
    """Return the output of a service to whose input run.csv is piped, until its end."""
    run = (plant.parent / "run.csv").read_bytes()
    return called("serve", str(plant), *options, "--until-end", code=code, stdin=run)


def test_one_axis_is_reported_as_by_the_monitor(folder: Path) -> None:
    axis = folder / "axis.toml"
    expected = events(called("monitor", str(folder / "run.csv"), "--config", str(axis), "--json"), *FOUND)
    served_ = events(served(axis, "--no-page", "--json"), *FOUND)
    assert [event.pop("axis") for event in served_] == ["axis"] * len(expected)
    assert len({event.pop("number") for event in served_}) == len(expected)
    for one, other in zip(served_, expected, strict=True):
        times = {"time": 0, "changed_at": 0, "wall": 0}
        assert {**one, **times} == {**other, **times}
        assert one["time"] == pytest.approx(other["time"], abs=1e-6)


PLANT = """
[service]
name = "hall"
window = 0.0
[page]
enabled = false
[axes.x1]
config = "axis.toml"
[sources.a]
kind = "stdin"
axis = "x1"
"""


def test_a_restart_goes_on_where_the_last_one_ended(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant = folder / "plant.toml"
    plant.write_text(PLANT)
    head, *rows = (folder / "run.csv").read_text().splitlines(keepends=True)
    options = ("serve", str(plant), "--state", str(tmp_path / "state"), "--until-end", "--json")
    parts = ["".join([head, *part]).encode() for part in (rows[:900], rows[900:])]
    first = called(*options, stdin=parts[0])
    with monkeypatch.context() as patched:
        patched.setattr(setup, "calibrate", None)  # the thresholds are those of the first start
        second = called(*options, stdin=parts[1])
    whole = events(served(plant, "--json"), *FOUND)
    assert [alarm["event"] for alarm in whole].count("alarm") == 1
    found = events(first, *FOUND) + events(second, *FOUND)
    assert [{**one, "wall": 0} for one in found] == [{**one, "wall": 0} for one in whole]
    (reported,) = events(second, "checkpoint")
    assert (reported["restored"], reported["fresh"]) == (1, 0)
    plant.write_text(PLANT.replace("axis.toml", "other.toml"))
    (reported,) = events(served(plant, *options[2:]), "checkpoint")
    assert (reported["restored"], reported["fresh"], reported["changed"]) == (0, 1, ["x1"])


def test_a_configuration_that_fails_costs_its_own_axes_only(folder: Path) -> None:
    plant = folder / "plant.toml"
    (folder / "lonely.toml").write_text((folder / "axis.toml").read_text().replace("normal.csv", "nowhere.csv"))
    plant.write_text(PLANT + '[axes.x2]\nconfig = "lonely.toml"\n')
    reported = served(plant, "--json")
    assert events(reported, "serving")[0]["axes"] == 1
    assert len(events(reported, "alarm")) == 1
    (problem,) = [event["problem"] for event in events(reported, "configuration") if "problem" in event]
    assert "nowhere.csv" in problem
    plant.write_text(PLANT.replace("axis.toml", "lonely.toml") + '[axes.x2]\nconfig = "none.toml"\n')
    assert "no axis can be watched" in served(plant, code=2)
    plant.write_text(PLANT.replace("axis.toml", "lonely.toml"))
    (line,) = served(plant, code=2).splitlines()
    assert line.startswith("pmfid: ")
    assert "nowhere.csv" in line


REFUSED: dict[str, tuple[Callable[[str], str], str]] = {
    "an unknown section": (lambda text: text + "[axis.x3]\n", r"\[axis\] is an unknown section"),
    "an unknown key": (lambda text: text.replace("window", "windows"), r"\[service\] windows is an unknown key"),
    "an unknown kind": (
        lambda text: text.replace('"stdin"', '"stdinn"'),
        r"\[sources.a\] kind = 'stdinn' is none of .*'stdin'",
    ),
    "an AXIS.toml with a fault": (lambda text: '[record]\ninput = "u"\n[model]\nkind = "drive"\n', "output is missing"),
    "axes without names": (
        lambda text: '[axes]\nconfig = "axis.toml"\n',
        r"outside a named section; write \[axes.NAME\]",
    ),
    "axes in double brackets": (lambda text: '[[axes]]\nconfig = "axis.toml"\n', r"\[axes.NAME\] .* single brackets"),
    "no kind": (lambda text: text.replace('kind = "stdin"', ""), r"\[sources.a\] has no kind; give one of .*mqtt"),
    "an URL of a broker": (
        lambda text: text + '[sources.b]\nkind = "mqtt"\nhost = "mqtt://hall"\ntopics = ["a"]\n',
        r"\[sources.b\] host = 'mqtt://hall': .*without mqtt://",
    ),
    "a port in the address": (
        lambda text: text + '[sinks.b]\nkind = "mqtt"\nhost = "10.0.0.1:1883"\n',
        r"\[sinks.b\] host = '10.0.0.1:1883': .*give the port in the key port",
    ),
    "a topic that is no list": (
        lambda text: text + '[sources.b]\nkind = "mqtt"\ntopics = "a"\n',
        "topics = 'a': it should be a list in brackets",
    ),
    "no axis": (
        lambda text: text.replace("[axes.x1]", "[fleets]").replace('config = "axis.toml"', ""),
        "the plant has no axis",
    ),
    "a name that is a path": (lambda text: text.replace("axes.x1", 'axes."../x"'), "is not a name"),
    "a script for a name": (lambda text: text.replace("axes.x1", 'axes."<script>"'), "is not a name"),
    "a key of an axis": (lambda text: text.replace("config", "file"), r"\[axes.x1\] file is an unknown key"),
    "a pattern of any format": (
        lambda text: text + '[fleets.f]\nconfig = "axis.toml"\nnames = "{0:c}{0}"\ncount = 60\n',
        r"\[fleets.f\] names = '\{0:c\}\{0\}' must be a pattern",
    ),
    "a pattern that looks inside": (
        lambda text: text + '[fleets.f]\nconfig = "axis.toml"\nnames = "{0.__class__}{}"\ncount = 3\n',
        "must be a pattern",
    ),
    "pattern without a number": (
        lambda text: text + '[fleets.f]\nconfig = "axis.toml"\nnames = "cell"\ncount = 3\n',
        r"\[fleets.f\] names = 'cell' must be a pattern",
    ),
    "an axis twice": (
        lambda text: text + '[fleets.f]\nconfig = "axis.toml"\nnames = "x{}"\ncount = 3\n',
        r"\[fleets.f\] uses the name 'x1' of another axis",
    ),
    "an axis that is not there": (
        lambda text: text.replace('axis = "x1"', 'axis = "x9"'),
        "the plant has no axis 'x9'",
    ),
    "a text for a number": (lambda text: text.replace("0.0", '"0"', 1), r"\[service\] window = '0'"),
    "no TOML": (lambda text: text + "x =", "not valid TOML"),
}


@pytest.mark.parametrize(("change", "said"), REFUSED.values(), ids=REFUSED)
def test_a_plant_is_refused_in_a_sentence(folder: Path, change: Callable[[str], str], said: str) -> None:
    plant = folder / "refused.toml"
    plant.write_text(change(PLANT))
    output = served(plant, "--json", code=2)
    assert re.search(said, output), output
    assert "Traceback" not in output


# --- signals ----------------------------------------------------------------------------------------------------------


@dataclass
class Acting:
    """A service that receives actions from another thread while it runs, and then ends by SIGTERM."""

    service: Service
    text: StringIO

    def run(self, *steps: Callable[[], None]) -> Events:
        """Return the notices of a service whose log is JSON."""
        self.act(*steps)
        return events(self.text.getvalue(), "alarm", "state", "settled", "reload", "ended", "gap", "unusable")

    def act(self, *steps: Callable[[], None]) -> None:
        errors: list[BaseException] = []

        def act() -> None:
            try:
                for step in steps:
                    step()
            except BaseException as error:
                errors.append(error)
            os.kill(os.getpid(), signal.SIGTERM)

        thread = threading.Thread(target=act)
        thread.start()
        self.service.run()
        thread.join()
        assert not errors, errors

    def until(self, *kinds: str, times: int = 1) -> None:
        end = time.monotonic() + PATIENCE
        while len(events(self.text.getvalue(), *kinds)) < times:
            assert time.monotonic() < end, self.text.getvalue()
            time.sleep(0.01)

    def samples(self, number: int) -> None:
        end = time.monotonic() + PATIENCE
        group = (("group", "axis.toml"),)
        while self.service.counters.values().get(("pmfid_samples_total", group), 0) < number:
            assert time.monotonic() < end, self.text.getvalue()
            time.sleep(0.01)


@pytest.fixture
def acting(folder: Path) -> Acting:
    text = StringIO()
    return Acting(Service(lambda: load_plant(folder / "plant.toml"), NoticeLog(text)), text)


def test_a_reload_changes_axes_without_touching_the_others(folder: Path, acting: Acting) -> None:
    plant = folder / "plant.toml"
    rows = (folder / "run.csv").read_text().splitlines(keepends=True)[1:]
    plant.write_text(PLANT + '[axes.x2]\nconfig = "axis.toml"\n')

    def write(part: list[str], samples: int) -> Callable[[], None]:
        def step() -> None:
            send("".join(part))
            acting.samples(samples)

        return step

    def reload() -> None:
        text = PLANT.replace("window = 0.0", "window = 0.1") + '[axes.x3]\nconfig = "other.toml"\n'
        plant.write_text(text)
        os.kill(os.getpid(), signal.SIGHUP)
        acting.until("reload")
        plant.write_text("nothing [")
        os.kill(os.getpid(), signal.SIGHUP)
        acting.until("reload", times=2)

    with standard_input() as send:
        found = acting.run(write(["t,u,counts\n", *rows[:900]], 900), reload, write(rows[900:], 1600))
    reported = [event for event in found if event["event"] == "reload"]
    assert (reported[0]["added"], reported[0]["changed"], reported[0]["removed"]) == (1, 0, 1)
    assert reported[0]["problem"].startswith("changes of [service] are not applied"), (
        "those that differ are named, and no others"
    )
    assert "continues with its previous" in reported[1]["problem"]
    words = ("monitor", str(folder / "run.csv"), "--config", str(folder / "axis.toml"), "--json")
    both = events(called(*words), *FOUND), [event for event in found if event["event"] in FOUND]
    expected, acted = ([(e["event"], round(e["time"], 9)) for e in one] for one in both)
    assert acted == expected
    assert found[-1]["event"] == "ended"


# --- encoders that wrap -----------------------------------------------------------------------------------------------


def wrapped(folder: Path, place: Path, bits: int, start: int) -> Events:
    """Return the notices for run.csv if its counter has `bits` bits and begins at `start`."""
    text = (folder / "axis.toml").read_text().replace("[model]", f"bits = {bits}\n\n[model]")
    (place / "axis.toml").write_text(text)
    (place / "normal.csv").write_text((folder / "normal.csv").read_text())
    table = np.loadtxt(folder / "run.csv", delimiter=",", skiprows=1)
    counts = (table[:, 2].astype(np.int64) + start + 2 ** (bits - 1)) % 2**bits - 2 ** (bits - 1)
    assert (np.ptp(counts) > 2 ** (bits - 1)) == (start > 0)
    rows = (f"{t!r},{u!r},{c}" for t, u, c in zip(table[:, 0].tolist(), table[:, 1].tolist(), counts, strict=True))
    stdin = "\n".join(["t,u,counts", *rows]) + "\n"
    options = ("--no-page", "--until-end", "--json")
    found = events(called("serve", str(place / "axis.toml"), *options, stdin=stdin.encode()), *FOUND)
    return [{**event, "wall": 0} for event in found]


@pytest.fixture(scope="module")
def unwrapped(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Events:
    return wrapped(folder, tmp_path_factory.mktemp("unwrapped"), 32, 0)


@pytest.mark.parametrize("bits", [16, 24, 32])
def test_a_counter_that_wraps_changes_nothing(folder: Path, tmp_path: Path, unwrapped: Events, bits: int) -> None:
    assert wrapped(folder, tmp_path, bits, 2 ** (bits - 1) - 200) == unwrapped
    assert [event["event"] for event in unwrapped].count("alarm") == 1
