"""Files that contain more than their form suggests, or other content."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import polars as pl
import pytest
import scipy.io
import scipy.sparse

import pmfid
from pmfid.config.axis import load_axis
from pmfid.encoder import Encoder
from pmfid.errors import printable
from pmfid.io.csv_text import parse_csv
from pmfid.io.reading import read_table
from pmfid.io.tables import column
from pmfid.records.record import read_experiment
from tests.command import run_command
from tests.refusals import refused
from tests.test_front import CART, PROCESS


def test_a_parquet_column_is_read_when_it_is_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "run.parquet"
    pl.DataFrame({"u": [1.0, 2.0], "text": ["a", "b"], "y": [3, 4]}).write_parquet(path)
    table = read_table(path)
    assert list(table) == ["u", "text", "y"]
    assert len(table) == 3
    np.testing.assert_array_equal(column(table, "output", "y"), [3.0, 4.0])
    refused(("available are u, text, y", lambda: column(table, "output", "z")))


def test_a_sparse_matrix_is_no_column(tmp_path: Path) -> None:
    path = tmp_path / "run.mat"
    scipy.io.savemat(path, {"u": scipy.sparse.eye(12).tocsc(), "y": np.arange(12.0)})
    objects = "not a real numeric array but object; save it as a vector"
    refused((objects, lambda: column(read_table(path), "input", "u")))


def test_names_that_differ_by_blanks_alone_are_two_columns_of_one_name(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("t,u,counts, u\n0,1,2,3\n1,2,3,4\n")
    table = read_table(path)
    refused(("'u': two columns have this name", lambda: column(table, "input", "u")))
    np.testing.assert_array_equal(column(table, "output", "counts"), [2.0, 3.0])


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


def test_counts_beyond_the_integers_are_refused_for_a_transfer_function(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("u,counts\n" + "".join(f"0,{count}\n" for count in (1, 2, "1e30", *range(10))))
    (tmp_path / "axis.toml").write_text(PROCESS.replace("[model]", "[encoder]\nresolution = 1.0\nbits = 8\n[model]"))
    beyond = r"counts must be integers below 2\*\*53, got 1e\+30 in row 3"
    refused((beyond, lambda: read_experiment(path, load_axis(tmp_path / "axis.toml"))))


def test_a_number_of_thousands_of_digits_is_no_toml(tmp_path: Path) -> None:
    (tmp_path / "axis.toml").write_text(CART.replace("2.0", "9" * 5000))
    refused(("not valid TOML", lambda: load_axis(tmp_path / "axis.toml")))


@pytest.mark.parametrize("options", [{"standstill_time": 1e308}, {"max_speed": 1e308}])
def test_times_and_speeds_at_the_end_of_the_numbers_are_what_they_say(options: dict[str, float]) -> None:
    run = np.zeros(50), np.arange(50)
    config = Encoder(1e-3, **options).kernel_config(1e-3)
    assert config["standstill_samples" if "standstill_time" in options else "max_change"] >= 2**31 - 1
    assert pmfid.RLS(pmfid.Drive(1.0), Encoder(1e-3, **options), 1e-3, 20.0).run(*run).theta.shape == (50, 3)


def test_a_period_that_nothing_has_and_a_mask_are_refused() -> None:
    masked, made = np.ma.masked_greater(np.arange(50.0), 40), partial(pmfid.LS, pmfid.Drive(1.0), Encoder(1e-3))
    refused(
        ("no plausible sample period", lambda: made(1e-320, 20.0)),
        ("u has masked elements", lambda: made(0.01, 20.0).fit(masked, np.arange(50))),
    )


@pytest.mark.parametrize(
    ("end", "cut"),
    [("0.30,7.25\n", False), ("0.30,7.25", False), ("0.30,7.2", True), ("0.30", True), ("0.30,12\n", False)],
)
def test_a_text_that_ends_within_its_last_line_is_said(end: str, cut: bool) -> None:
    table = parse_csv(b"t,u\n0.10,1.25\n0.20,2.50\n" + end.encode())
    assert any("ends early" in note for note in table.notes) == cut
