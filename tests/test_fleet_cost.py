"""What a fleet costs, on paper: sums of measured constants, limits that are limits, and the command."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from pmfid.cli.main import main
from pmfid.errors import UsageError
from pmfid.fleet.cost import HEADER, USED, WAYS, Load, Machine, advice, bill, constants, most_axes, row
from studies import cost, million
from studies.fleet_stream import Run, page
from studies.sharded_runs import Cost, Kill, Spent

ROOT = Path(__file__).parents[1]
MACHINE = Machine(16, 64e9)
SERVICE = """Every axis has 100 samples a second, sent in blocks of 40, 50 axes in a message.

| axes | 1e6 samples/s | cores of service, broker, machines | memory [MB] |
| --- | --- | --- | --- |
| 1000 | 0.100 | 0.15, 0.02, 0.09 | 250 to 260 |
| 3000 | 0.300 | 0.30, 0.02, 0.11 | 350 to 351 |
"""
HISTORY = """
|  | samples per processor second |
|---|---|
| others | 9 M |

| samples | samples per processor second | MiB |
|---|---|---|
| 45 M | 2.67 M | 926 |
| 360 M | 2.50 M | 800 |
"""

#: Axes, and how far behind their stream is at the end [s].
RATES = ((1000, 20.0), (700, 3.0), (490, 1.0))
ENGINES = """
| engine | start [s] | per processor second | MiB, all processes |
|---|---|---|---|
| local | 0.1 | 1.06 M | 712 |
| spark | 75.6 | 0.25 M | 1400 |
"""


def test_every_constant_has_a_study_and_words() -> None:
    for name, one in constants().items():
        assert one.value > 0, name
        assert one.page in (cost.HERE, *cost.PAGES), name
        assert len(one.what.split()) >= 3, name


@pytest.mark.parametrize("way", WAYS)
def test_twice_the_axes_cost_twice_as_much(way: str) -> None:
    one, two = (bill(way, Load(axes, 100.0), MACHINE) for axes in (10_000, 20_000))
    assert (two.cores, two.network, two.storage) == pytest.approx((2 * one.cores, 2 * one.network, 2 * one.storage))
    assert two.memory >= one.memory
    assert len(row(one)) == len(HEADER)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("rate", [0.1, 10.0, 1000.0])
def test_the_most_that_one_machine_carries_is_the_most(way: str, rate: float) -> None:
    most = most_axes(way, Load(1, rate), MACHINE)
    at, beyond = (bill(way, Load(axes, rate), MACHINE) for axes in (most, most + 1))
    assert at.machines == 1
    assert at.cores <= USED * MACHINE.cores
    assert at.memory <= USED * MACHINE.memory
    assert beyond.machines == 2


def test_a_service_has_a_core_for_each_process() -> None:
    found = bill("serve", Load(60_000, 100.0, 0.5), MACHINE)
    assert found.processes > 1
    assert found.cores / found.processes <= USED
    assert found.cores == pytest.approx(120_000 * constants()["serve_block"].value)


def test_shorter_calls_cost_more() -> None:
    cores = [bill("process", Load(1000, 100.0, block), MACHINE).cores for block in (0.01, 0.1, 1.0, 10.0)]
    assert cores == sorted(cores, reverse=True)
    assert cores[-1] == pytest.approx(1e5 * constants()["sample"].value, rel=0.1)


def test_a_fleet_that_fits_nothing_is_told_so() -> None:
    tiny = Machine(1, 1e9)
    assert most_axes("spark stream", Load(1, 10.0), tiny) == 0
    assert "nothing larger is needed" in advice(Load(10, 10.0), MACHINE)[-1]
    assert "one process is enough for the estimates; to watch them takes" in advice(Load(500_000, 10.0), MACHINE)[-1]
    assert "more than one machine" in advice(Load(10**9, 10.0), MACHINE)[-1]


@pytest.mark.parametrize(
    "words",
    [
        ["--axes", "0", "--rate", "1"],
        ["--axes", "9" * 400, "--rate", "1"],
        ["--axes", "1.5", "--rate", "1"],
        ["--axes", "1", "--rate", "nan"],
        ["--axes", "1", "--rate", "-1"],
        ["--axes", "1", "--rate", "inf"],
        ["--axes", "1", "--rate", "1", "--block", "0"],
        ["--axes", "1", "--rate", "1", "--cores", "0"],
        ["--axes", "1", "--rate", "1", "--cores", "9" * 400],
        ["--axes", "1", "--rate", "1", "--memory", "nan"],
        ["--axes", "1", "--rate", "1", "--memory", "0.5"],
        ["--rate", "1"],
    ],
)
def test_wrong_numbers_are_one_sentence(words: list[str]) -> None:
    shown = CliRunner().invoke(main, ["fleet", "cost", *words])
    assert shown.exit_code == 2
    assert "Traceback" not in shown.output
    assert len(shown.stderr.strip().splitlines()[-1]) < 500


@pytest.mark.parametrize(("axes", "rate"), [("1", "1e-9"), ("1000000000000", "1e9"), ("1", "1e9"), ("7", "3.3")])
def test_the_command_prints_and_counts(axes: str, rate: str) -> None:
    words = ["fleet", "cost", "--axes", axes, "--rate", rate]
    told = json.loads(CliRunner().invoke(main, [*words, "--json"]).stdout)
    assert [one["way"] for one in told["ways"]] == list(WAYS)
    assert all(np.isfinite(one["cores"]) and one["machines"] >= 1 for one in told["ways"])
    shown = CliRunner().invoke(main, words)
    assert shown.exit_code == 0, shown.output
    assert all(line in shown.stdout for line in told["advice"])
    assert axes != "7" or "…" not in shown.stdout


def test_one_service_has_no_more_axes_than_its_machine() -> None:
    """A slow axis costs hardly a core, but it costs memory."""
    one, several = (line for line in advice(Load(1, 1e-6), MACHINE)[1].split("several"))
    assert int(one.split(" up to ")[1].split()[0]) == int(several.split(" up to ")[1].split()[0])


def test_another_way_is_refused() -> None:
    with pytest.raises(UsageError, match="way must be one of"):
        bill("ray", Load(1, 1.0))


# --- the studies ------------------------------------------------------------------------------------------------------


def test_constants_are_read_from_their_pages() -> None:
    found = {name: one[0] for name, one in cost.service(SERVICE).items()}
    assert found == pytest.approx(
        {"serve_block": 40 * 1.5e-6, "serve_samples": 40, "serve_memory": 5e4, "serve_base": 2e8}
    )
    found = {name: one[0] for name, one in cost.history(HISTORY).items()}
    assert found == pytest.approx({"history_sample": 4e-7, "history_memory": 800 * 2**20})
    found = {name: one[0] for name, one in cost.engines(ENGINES).items()}
    assert found == pytest.approx({"spark_history_sample": 4e-6, "spark_base": 1400 * 2**20})
    runs = [Run(axes, 60.0, round(6000 * axes), behind, 2.0, 9.0, 0.5, 2**30, 2**20) for axes, behind in RATES]
    found = {name: one[0] for name, one in cost.streamed(page(runs, 4, 5.0, 1.0)).items()}
    assert found == pytest.approx({"stream_sample": 0.5 / 70_000})


def test_more_processors_take_no_axes_up_sooner() -> None:
    """On two threads, a restore takes as long as its processor time (`studies.million`)."""
    few, many = (bill("process", Load(10**6, 10.0), Machine(cores, 64e9)).restart for cores in (4, 64))
    assert few == many == pytest.approx(10**6 * constants()["restore_axis"].value)


def test_a_stream_keeps_the_states_of_a_service() -> None:
    stream, serve = (bill(way, Load(1000, 100.0), MACHINE).storage for way in ("spark stream", "serve"))
    assert stream == serve


def test_the_pages_have_what_was_measured() -> None:
    times = [Spent(0.1 * k, 0.2 * k) for k in range(1, 7)]
    small = Cost(1000, 1544, 60.0, 62.0, 61.0, *times, disk=3_000_000)
    large = replace(small, axes=100_000, again=Spent(50.0, 1.0))
    text = "\n".join([*million.sizes([small, large]), *million.kill_lines(5, [Kill(0.5, True, True, False, 0)])])
    assert "| 100000 | 0.1 | 0.2 | 0.3 | 50 | 0.5 | 0.6 |" in text
    assert "| grows with the power | 0.00 | 0.00 | 0.00 | 1.05 |" in text
    assert "1 times SIGKILL 0.50 s behind" in text
    assert "in 1 of 1 the states are bit by bit" in text
    assert "| cores |" in "\n".join(cost.checked(large))
