"""What if the encoder were another one: `pmfid encoder`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pmfid.config.axis import load_axis
from pmfid.pipeline.encoders import EncoderChoice, compare_encoders
from pmfid.records.joining import join_records
from pmfid.records.record import read_record
from pmfid.simulation import CART, prbs, simulate_drive
from tests.refusals import refused

AXIS = """
[record]
input = "u"
output = "position"
time = "t"

[encoder]
resolution = 1e-7

[model]
kind = "drive"
input_gain = 2.0
"""


@pytest.fixture(scope="module")
def fine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a cart's record at 1 ms, run.csv, with its axis.toml."""
    folder = tmp_path_factory.mktemp("fine")
    u = prbs(4000, clock=50, amplitude=4.0, rng=np.random.default_rng(5))
    x = 1e-7 * np.round(1e7 * simulate_drive(CART, u, 1e-3).x)
    table = np.c_[1e-3 * np.arange(u.size), u, x]
    np.savetxt(folder / "run.csv", table, "%.7f", ",", header="t,u,position", comments="")
    (folder / "axis.toml").write_text(AXIS)
    return folder


def test_records_that_are_joined_have_no_ages(fine: Path) -> None:
    record = read_record(fine / "run.csv", load_axis(fine / "axis.toml"))
    record = replace(record, ages=np.full(record.u.shape, 1e-4))
    joined = join_records([record, record], place_matters=False)
    assert joined.ages is None
    assert "the ages of edges are not used, because there are several records" in joined.notes


def choice(counts: list[float], edges: list[float], turn: float | None = None) -> EncoderChoice:
    steps = np.array([1e-1, 1e-2, 1e-3])
    return EncoderChoice("run", "mass", 0.01, 1e-3, turn, "m", steps, np.array(counts), np.array(edges))


@pytest.mark.parametrize(
    ("counts", "edges", "answer"),
    [
        ([0.1, 0.02, 0.005], [0.005, 0.001, 1e-4], "counts need steps of 0.001 m, and edge times need steps of 0.1 m"),
        (
            [0.005, 0.02, 0.03],
            [np.nan, 0.001, 1e-4],
            "counts need finer steps than these, and edge times need steps of 0.01 m",
        ),
    ],
)
def test_an_encoder_suffices_if_all_finer_ones_do(counts: list[float], edges: list[float], answer: str) -> None:
    assert choice(counts, edges).answer == f"to determine mass to 1 %, {answer}"


def test_increments_name_the_encoders_of_a_rotary_axis() -> None:
    found = choice([0.1, np.nan, 0.005], [0.005, 0.001, 1e-4], turn=6.4)
    assert found.answer == (
        "to determine mass to 1 %, counts need 6400 increments a turn, and edge times need 64 increments a turn"
    )
    assert found.summary().rows[1] == ("640", "unknown", "0.1")
    assert found.plot().axes[0].get_xlabel() == "increments per turn"


def test_wrong_use(fine: Path) -> None:
    axis = load_axis(fine / "axis.toml")
    record = read_record(fine / "run.csv", axis)
    short = replace(record, u=record.u[:1500], counts=record.counts[:1500])
    refused(
        ("above 0 and below 100 %", lambda: compare_encoders(short, axis, wanted=0.0)),
        ("error of the lines below 50 %", lambda: compare_encoders(short, axis, line_error=0.5)),
        ("did you mean", lambda: compare_encoders(short, axis, parameter="masss")),
    )
