"""The command as a new user tries it: bad input of every kind, and the output for good input."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import sysconfig
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import click
import numpy as np
import polars as pl
import pytest
import scipy.io
from click.testing import CliRunner, Result

from pmfid import Drive
from pmfid.cli.main import main
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.registry import ESTIMATORS, methods_for
from pmfid.pipeline.result import format_value
from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, make_scenario, write_csv
from pmfid.simulation.drive import Schedule, quantize, simulate_drive
from tests.command import run_command
from tests.conftest import PROGRESS, long_unless
from tests.patience import PATIENCE

METHODS = ["auto", *methods_for(Drive(1.0))]
#: One method of each family: automatic choice, recursive with instruments, compensated least squares, likelihood.
FAMILIES = ["auto", "riv", "bcls", "fit"]
EVERY_METHOD = long_unless(FAMILIES.__contains__, METHODS)
#: Methods whose files are checked: one with a track and one without.
WRITTEN = ("riv", "fit")
AXIS = Path(__file__).parents[1] / "examples" / "cart.toml"
TRUTH = {
    "mass": CART.mass,
    "viscous_friction": CART.viscous_friction,
    "coulomb_friction": CART.coulomb_friction,
}


@dataclass(frozen=True)
class Cart:
    """One simulated run in three kinds of file; the columns of `frame` are t [s], u [V] and counts."""

    csv: Path
    parquet: Path
    mat: Path
    frame: pl.DataFrame


@pytest.fixture(scope="module")
def cart(tmp_path_factory: pytest.TempPathFactory) -> Cart:
    folder = tmp_path_factory.mktemp("cart")
    csv, parquet, mat = (folder / f"cart.{kind}" for kind in ("csv", "parquet", "mat"))
    write_csv(make_scenario("prbs", seed=1, duration=10.0), csv)
    frame = pl.read_csv(csv)
    frame.write_parquet(parquet)
    scipy.io.savemat(mat, {name: frame[name].to_numpy() for name in frame.columns})
    return Cart(csv, parquet, mat, frame)


def run(record: Path, *options: str, config: Path = AXIS) -> Result:
    return CliRunner().invoke(main, ["identify", str(record), "--config", str(config), *options])


def good(record: Path, *options: str, config: Path = AXIS) -> dict[str, Any]:
    """Return the one JSON object that a run without complaints prints."""
    result = run(record, "--json", *options, config=config)
    assert (result.exit_code, result.stderr) == (0, "")
    assert result.stdout.count("\n") == 1
    printed: dict[str, Any] = json.loads(result.stdout)
    return printed


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder in which `found` writes one folder for each method."""
    return tmp_path_factory.mktemp("found") / "new"


@pytest.fixture(scope="module")
def found(cart: Cart, out: Path) -> Callable[[str], dict[str, Any]]:
    """Return a function that runs each method once; a few methods write files."""

    def run_once(method: str) -> dict[str, Any]:
        return good(cart.csv, "--method", method, *(("--out", str(out / method)) if method in WRITTEN else ()))

    return cache(run_once)


def complaint(result: Result, code: int = 2) -> str:
    """Return the one line on standard error; all other output must be empty."""
    assert isinstance(result.exception, SystemExit)
    assert (result.exit_code, result.stdout) == (code, "")
    assert result.stderr.startswith("pmfid: ")
    assert result.stderr.count("\n") == 1
    return result.stderr


def usage(result: Result) -> str:
    """Return the line of a refused command line, which follows click's two lines on help."""
    assert (result.exit_code, result.stdout) == (2, "")
    assert "Traceback" not in result.stderr
    *_, last = result.stderr.splitlines()
    assert result.stderr.count("Error: ") == 1
    assert last.startswith("Error: ")
    return last


def bad(record: Path, *options: str, config: Path = AXIS) -> str:
    return complaint(run(record, "--json", *options, config=config))


def written(folder: Path, frame: pl.DataFrame) -> Path:
    frame.write_csv(folder / "run.csv")
    return folder / "run.csv"


def axis(folder: Path, old: str, new: str) -> Path:
    """Write examples/cart.toml with one text replaced."""
    text = AXIS.read_text()
    assert text.count(old) == 1
    (folder / "axis.toml").write_text(text.replace(old, new))
    return folder / "axis.toml"


# --- records that cannot be used ------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["csv", "parquet", "mat"])
def test_empty_and_truncated_files(tmp_path: Path, cart: Cart, kind: str) -> None:
    record = tmp_path / f"run.{kind}"
    record.write_bytes(b"")
    assert "the file is empty; export the record again" in bad(record)
    whole: bytes = getattr(cart, kind).read_bytes()
    record.write_bytes(whole[: whole.rindex(b",") if kind == "csv" else len(whole) // 2])
    if kind == "csv":  # CSV has no end mark, so that only its last row can be incomplete
        assert good(record)["samples"] == 999
    else:
        assert "truncated or corrupt" in bad(record)


# --- options that cannot be used --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--set", "encoder.resolution=0"), "[encoder] resolution = 0 (given as an option)"),
        (("--set", "encoder.resolution=0.01 parsec"), "'parsec' is not a known unit; use one of m, cm, mm"),
        (("--set", "estimator.cutoff=201"), "201 rad/s is too high for dt = 0.01 s"),
        (("--set", "estimator.cutoff=fast"), "[estimator] cutoff = 'fast' (given as an option)"),
        (("--set", "cutoff=1"), "is not SECTION.KEY=VALUE"),
    ],
)
def test_option_out_of_range(cart: Cart, options: tuple[str, ...], said: str) -> None:
    assert said in bad(cart.csv, *options)


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        (["identify"], "Missing argument 'RECORD...'"),
        (["identify", "a.csv", "--config", "b.toml", "--method", "lms"], "'lms' is not one of 'auto', 'fit', 'ls', "),
        (["identify", "a.csv", "--config", "b.toml", "--jsn"], "'--json'"),
        (["idenify"], "'identify'"),
    ],
)
def test_wrong_command_line(arguments: list[str], what: str) -> None:
    assert what in usage(CliRunner().invoke(main, arguments))


def test_the_configuration_is_by_default_the_one_that_init_writes(
    tmp_path: Path, cart: Cart, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    missing = CliRunner().invoke(main, ["identify", str(cart.csv)])
    assert "AXIS.toml: cannot read the configuration" in missing.stderr
    assert "pmfid init LOG writes it" in missing.stderr
    run_command("init", str(cart.csv))
    run_command("identify", str(cart.csv))


# --- places that cannot be written ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["report.html", "track.parquet"])
def test_out_where_one_file_cannot_be_written(tmp_path: Path, cart: Cart, name: str) -> None:
    (tmp_path / name).mkdir()
    text = bad(cart.csv, "--method", "rls", "--out", str(tmp_path))
    assert str(tmp_path / name) in text
    assert "directory" in text.lower()
    assert "None" not in text


# --- records that cannot identify the parameters --------------------------------------------------------------------


def moved(u: np.ndarray, step: float = CART_RESOLUTION) -> pl.DataFrame:
    """Simulate the cart under the input u [V], (n,), with an encoder of `step` m."""
    motion = simulate_drive(Schedule(((0.0, CART),)), u, CART_DT)
    counts = quantize(motion.x, step, phase=1e-6)
    return pl.DataFrame({"t": motion.t, "u": u, "counts": counts})


@pytest.mark.parametrize("method", FAMILIES)
@pytest.mark.parametrize("u", [pl.col.u, pl.lit(1.0), pl.lit(0.0)], ids=["prbs", "constant", "zero"])
def test_axis_that_does_not_move(tmp_path: Path, cart: Cart, method: str, u: pl.Expr) -> None:
    record = written(tmp_path, cart.frame.with_columns(u.alias("u"), counts=7))
    text = complaint(run(record, "--json", "--method", method), code=3)
    assert "the axis does not move" in text
    assert "record a motion" in text


def constant_from(start: int, step: float) -> pl.DataFrame:
    return moved(np.where(np.arange(3000) < start, 0.0, 3.0), step)


#: Records of which no method may make a good result.
MISLEADING: dict[str, Callable[[pl.DataFrame], pl.DataFrame]] = {
    "unrelated": lambda frame: frame.with_columns(u=3.0),
    "wrong sign": lambda frame: frame.with_columns(-pl.col.u),
    "long ago": lambda frame: moved(np.where(np.arange(3000) < 1500, 3.0, -3.0)),
}


@pytest.mark.parametrize(
    ("kind", "method"),
    long_unless(
        lambda kind, method: method == "bcls" or (kind, method) == ("long ago", "fit"),
        [(kind, method) for kind in MISLEADING for method in METHODS],
    ),
)
def test_what_misleads_is_never_silently_wrong(tmp_path: Path, cart: Cart, kind: str, method: str) -> None:
    never_silently_wrong(run(written(tmp_path, MISLEADING[kind](cart.frame)), "--json", "--method", method))


#: Steps of an encoder [m] and samples until the input starts.
STEPS = [("91e-6", 0), ("91e-6", 100), ("364e-6", 100), ("728e-6", 0), ("1.5e-3", 0), ("1.5e-3", 100)]


@pytest.mark.parametrize(
    ("method", "step", "start"),
    long_unless(
        lambda method, *step: STEPS.index(step) in ((0, 2, 5) if method == "auto" else (METHODS.index(method) % 6,)),
        [(method, *step) for method in METHODS for step in STEPS],
    ),
)
def test_constant_input_with_a_coarse_encoder_is_never_silently_wrong(
    tmp_path: Path, method: str, step: str, start: int
) -> None:
    """The input starts at once, or after a second."""
    record = written(tmp_path, constant_from(start, float(step)))
    never_silently_wrong(run(record, "--json", "--method", method, "--set", f"encoder.resolution={step}"))


def never_silently_wrong(result: Result) -> None:
    """Check for exit code 3 with one line, or an estimate that is right within 10 %, or a flagged estimate."""
    if result.exit_code:
        complaint(result, code=3)
        return
    printed = json.loads(result.stdout)
    if not printed["status"]:
        assert values(printed) == pytest.approx(TRUTH, rel=0.1)


# --- what good input gives ------------------------------------------------------------------------------------------


def values(printed: dict[str, Any]) -> dict[str, float]:
    return {name: entry["value"] for name, entry in printed["parameters"].items()}


@pytest.mark.parametrize("method", EVERY_METHOD)
def test_every_method_finds_the_cart(found: Callable[[str], dict[str, Any]], method: str) -> None:
    theta = values(found(method))
    assert theta["mass"] == pytest.approx(CART.mass, rel=0.02)
    assert theta["viscous_friction"] == pytest.approx(CART.viscous_friction, rel=0.02)
    assert theta["coulomb_friction"] == pytest.approx(CART.coulomb_friction, rel=0.05)


def test_the_json_object_has_its_keys_and_types(cart: Cart) -> None:
    printed = good(cart.csv)
    assert (printed["model"], printed["method"], printed["samples"]) == ("drive", "riv", 1000)
    assert printed["dt"] == pytest.approx(CART_DT, rel=1e-12)
    units = {name: entry["unit"] for name, entry in printed["parameters"].items()}
    assert units == {"mass": "kg", "viscous_friction": "N s/m", "coulomb_friction": "N"}
    assert all(0 < entry["std"] < 0.1 * entry["value"] for entry in printed["parameters"].values())
    assert 0 < printed["fit"]["relative_error"] < 0.01
    assert set(printed["status"]) <= {"std_too_small", "biased"}


@pytest.mark.parametrize("method", long_unless("riv".__eq__, METHODS))
def test_a_counter_that_wraps_gives_the_same_numbers(
    tmp_path: Path, cart: Cart, found: Callable[[str], dict[str, Any]], method: str
) -> None:
    frame = cart.frame.with_columns(pl.col.counts % 2**12)
    config = axis(tmp_path, "# bits = 16", "bits = 12")
    wrapped = good(written(tmp_path, frame), "--method", method, config=config)
    assert any(note.startswith("counter wrapped ") for note in wrapped["notes"])
    assert wrapped["parameters"] == found(method)["parameters"]


@pytest.mark.parametrize("method", WRITTEN)
def test_out_writes_the_report_the_numbers_and_the_track(
    out: Path, found: Callable[[str], dict[str, Any]], method: str
) -> None:
    printed, out = found(method), out / method
    track = issubclass(ESTIMATORS[printed["method"]], RecursiveEstimator)
    expected = {"report.html", "result.json"} | ({"track.parquet"} if track else set())
    assert {path.name for path in out.iterdir()} == expected
    assert json.loads((out / "result.json").read_text()) == printed
    html = (out / "report.html").read_text()
    assert f"<h1>cart.csv: {printed['method']}</h1>" in html
    assert html.count("<figure") >= 2
    if track:
        last = pl.read_parquet(out / "track.parquet").row(-1, named=True)
        assert {name: last[name] for name in TRUTH} == values(printed)
        assert last["t"] == pytest.approx(9.99)


def test_the_table_shows_what_the_json_says(tmp_path: Path, cart: Cart) -> None:
    result = run(cart.csv, "--out", str(tmp_path))
    assert (result.exit_code, result.stderr) == (0, "")
    for name, entry in good(cart.csv)["parameters"].items():
        row = next(line for line in result.stdout.splitlines() if f"│ {name}" in line)
        assert format_value(entry["value"], entry["std"]) in row
        assert entry["unit"] in row
    assert f"report: {tmp_path / 'report.html'}" in result.stdout


# --- the command itself ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", sorted(main.commands))
def test_help_names_every_option(name: str) -> None:
    result = CliRunner().invoke(main, [name, "--help"])
    assert (result.exit_code, result.stderr) == (0, "")
    for parameter in main.commands[name].params:
        if isinstance(parameter, click.Option):
            assert parameter.help
            assert parameter.opts[0] in result.stdout
    assert "Exit code 0" in result.stdout or name != "identify"


def test_every_command_says_what_it_does_in_one_line() -> None:
    text = CliRunner().invoke(main, ["--help"], terminal_width=80).output
    lines = [line for line in text.partition("Commands:\n")[2].splitlines() if line]
    assert len(re.findall(r"^  \w", "\n".join(lines), re.M)) == sum(
        not command.hidden for command in main.commands.values()
    )
    assert "..." not in text.partition("Commands:\n")[2]


def spawned(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = Path(sysconfig.get_path("scripts")) / "pmfid"
    return subprocess.run([command, *arguments], capture_output=True, text=True, timeout=PATIENCE, check=False)


def test_the_installed_command_prints_json_alone(cart: Cart) -> None:
    done = spawned("identify", str(cart.csv), "--config", str(AXIS), "--json")
    assert (done.returncode, PROGRESS.sub("", done.stderr)) == (0, "")
    assert json.loads(done.stdout) == good(cart.csv)


@pytest.mark.skipif(sys.platform == "win32", reason="pipes end otherwise on Windows")
def test_a_reader_that_goes_away_is_no_error(cart: Cart) -> None:
    read_end, write_end = os.pipe()
    os.close(read_end)
    command = [sys.executable, "-c", "from pmfid.cli.main import main; main()"]
    arguments = ["identify", str(cart.csv), "--config", str(AXIS), "--json"]
    try:
        done = subprocess.run(
            [*command, *arguments], stdout=write_end, stderr=subprocess.PIPE, text=True, timeout=PATIENCE, check=False
        )
    finally:
        os.close(write_end)
    assert PROGRESS.sub("", done.stderr) == ""
