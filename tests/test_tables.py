"""Files that contain more than their form suggests, or other content."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest

import pmfid
from pmfid.encoder import Encoder
from pmfid.errors import printable
from pmfid.io.reading import read_table
from pmfid.io.tables import column
from tests.command import counted_axis, run_command
from tests.refusals import refused

CART = counted_axis(0.01, 22.75e-6, 2.0) + "[estimator]\ncutoff = 20.0\n"

pytestmark = pytest.mark.usefixtures("without_judgement")


def test_a_parquet_column_is_read_when_it_is_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "run.parquet"
    pl.DataFrame({"u": [1.0, 2.0], "text": ["a", "b"], "y": [3, 4]}).write_parquet(path)
    table = read_table(path)
    assert list(table) == ["u", "text", "y"]
    assert len(table) == 3
    np.testing.assert_array_equal(column(table, "output", "y"), [3.0, 4.0])
    refused(("available are u, text, y", lambda: column(table, "output", "z")))


def test_names_do_not_steer_the_terminal(tmp_path: Path) -> None:
    record, axis = tmp_path / "run.csv", tmp_path / "axis.toml"
    record.write_text("t,\x1b[31mu,counts\n0,1,2\n")
    axis.write_text(CART)
    result = run_command("identify", str(record), "--config", str(axis), code=2)
    assert "\x1b" not in result.stderr
    assert "\\x1b[31mu" in result.stderr
    assert printable("a\x07\u202eb\n\udce9") == "a\\x07\\u202eb\n\\udce9"


def test_markup_in_a_unit_is_printed_as_it_stands(tmp_path: Path) -> None:
    lines = CART.replace(
        "input_gain = 2.0",
        'kind = "equation"\nunknown = [{ signal = "output", derivative = 2, name = "m", '
        'unit = "[bold]$\\\\frac$[/x]" }, '
        '{ signal = "output", derivative = 1, name = "d" }, { signal = "direction", name = "c" }]\n'
        'known = [{ signal = "input", coefficient = 2.0 }]',
    )
    run_command("simulate", "prbs", "--out", str(tmp_path / "run.csv"), "--duration", "10")
    (tmp_path / "axis.toml").write_text(lines)
    arguments = [str(tmp_path / "run.csv"), "--config", str(tmp_path / "axis.toml"), "--out", str(tmp_path / "out")]
    result = run_command("identify", *arguments, "--method", "rls")
    assert "[bold]$\\frac$[/x]" in result.stdout


@pytest.mark.parametrize("options", [{"standstill_time": 1e308}, {"max_speed": 1e308}])
def test_times_and_speeds_at_the_end_of_the_numbers_are_what_they_say(options: dict[str, float]) -> None:
    run = np.zeros(50), np.arange(50)
    config = Encoder(1e-3, **options).kernel_config(1e-3)
    assert config["standstill_samples" if "standstill_time" in options else "max_change"] >= 2**31 - 1
    assert pmfid.RLS(pmfid.Drive(1.0), Encoder(1e-3, **options), 1e-3, 20.0).run(*run).theta.shape == (50, 3)
