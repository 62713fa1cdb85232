"""The command `pmfid terms`: its output, its files, and its messages for bad input."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from pmfid.cli.main import main
from tests.test_terms import CUTOFF, DT, GAIN, STEP, made, searched


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    record = made(samples=1000, asymmetry=0.15)
    table, axis = tmp_path / "run.csv", tmp_path / "axis.toml"
    rows = [f"{DT * i:.9g},{u:.12g},{c}" for i, (u, c) in enumerate(zip(record.u, record.counts, strict=True))]
    table.write_text("\n".join(["t,u,counts", *rows]))
    axis.write_text(
        '[record]\ninput = "u"\noutput = "counts"\noutput_kind = "counts"\ntime = "t"\n'
        f"[encoder]\nresolution = {STEP}\n[model]\ninput_gain = {GAIN}\n[estimator]\ncutoff = {CUTOFF}\n"
    )
    return table, axis


def test_the_command_says_what_python_says(files: tuple[Path, Path], tmp_path: Path) -> None:
    table, axis = files
    directional, out = searched(made(samples=1000, asymmetry=0.15)), tmp_path / "out"
    result = CliRunner().invoke(
        main, ["terms", str(table), "--config", str(axis), "--no-scan", "--json", "--out", str(out)]
    )
    assert result.exit_code == 0
    assert all(line.startswith("pmfid: terms: ") for line in result.stderr.splitlines())
    printed = json.loads(result.stdout)
    assert printed["model"] == list(directional.lines)
    wanted = directional.to_json()["models"]
    assert isinstance(wanted, list)
    assert printed["models"][1]["parameters"]["mass"] == pytest.approx(wanted[1]["parameters"]["mass"])
    assert json.loads((out / "terms.json").read_text()) == printed
    html = (out / "terms.html").read_text()
    assert "Friction over velocity" in html
    assert "<svg" in html
    assert "<pre>[model]" in html


@pytest.mark.parametrize(
    ("further", "code", "said"),
    [
        (["--turn", "-1"], 2, "length above 0"),
        (["--pitch", "nan"], 2, "length above 0"),
        (["--held-out", "missing.csv"], 2, "missing.csv"),
        (["--cutoff", "1e9"], 2, "too high"),
        (["--cutoff", "1"], 3, "record at least"),
    ],
)
def test_bad_input_is_one_line_and_an_exit_code(
    files: tuple[Path, Path], further: list[str], code: int, said: str
) -> None:
    table, axis = files
    result = CliRunner().invoke(main, ["terms", str(table), "--config", str(axis), *further])
    assert result.exit_code == code
    assert said in result.stderr
    assert result.stderr.count("\n") == 1
