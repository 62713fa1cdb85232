"""A user's first contact: help, names, the demo's files, keys without effect, and progress."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import pmfid
from examples.demo import main as demo
from pmfid.cli import terminal as progress_module
from pmfid.cli.main import main
from pmfid.cli.terminal import progress
from pmfid.config.axis import Axis, load_axis
from pmfid.errors import UnknownParameterError, UsageError
from pmfid.estimators import METHODS
from pmfid.pipeline.identify import identify
from pmfid.records.record import Record, read_experiment
from tests.command import run_command
from tests.conftest import cart_run
from tests.patience import PATIENCE

CART = """
[record]
input = "u"
output = "counts"
output_kind = "counts"
dt = 0.01
[encoder]
resolution = 22.75e-6
[model]
input_gain = 2.0
[estimator]
cutoff = 20.0
"""
PROCESS = """
[record]
input = "u"
output = "counts"
output_kind = "counts"
dt = 0.01
[model]
kind = "transfer_function"
n = 1
m = 0
[estimator]
cutoff = 1.0
"""


def loaded(folder: Path, text: str, old: str = "", new: str = "") -> Axis:
    assert old in text
    path = folder / "axis.toml"
    path.write_text(text.replace(old, new, 1) if old else text)
    return load_axis(path)


# --- names ------------------------------------------------------------------------------------------------------------


def test_a_wrong_name_lists_the_right_ones() -> None:
    run = cart_run(1, samples=600)
    arguments = (pmfid.Drive(2.0), run.encoder, 0.01, 20.0)
    fit = pmfid.LS(*arguments).fit(run.u, run.counts)
    estimator = pmfid.RLS(*arguments)
    track = estimator.run(run.u, run.counts)
    tracks = pmfid.Fleet(estimator, 1).run(run.u, run.counts[None, :])
    for result in (fit, track, tracks, estimator.estimate, pmfid.RLS(*arguments, precision="float32").estimate):
        with pytest.raises(KeyError) as caught:
            result["Mass"]
        assert isinstance(caught.value, UnknownParameterError)
        assert str(caught.value) == (
            "there is no parameter 'Mass'; use one of mass, viscous_friction, coulomb_friction; did you mean 'mass'?"
        )


# --- help -------------------------------------------------------------------------------------------------------------


def test_every_command_says_what_it_does_in_one_line() -> None:
    text = CliRunner().invoke(main, ["--help"], terminal_width=80).output
    lines = [line for line in text.partition("Commands:\n")[2].splitlines() if line]
    assert len(re.findall(r"^  \w", "\n".join(lines), re.M)) == sum(
        not command.hidden for command in main.commands.values()
    )
    assert "..." not in text.partition("Commands:\n")[2]


def test_the_help_of_method_names_them_all() -> None:
    text = CliRunner().invoke(main, ["identify", "--help"], terminal_width=200).output
    described = re.search(r"auto: from the record.*?srivc, rls, bcrls\.", text, re.DOTALL)
    assert described
    assert all(re.search(rf"\b{method}\b", described[0]) for method in METHODS)


# --- the demo ---------------------------------------------------------------------------------------------------------


def test_what_the_demo_writes_can_be_identified_as_it_stands(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    demo(["--out", str(tmp_path)])
    command = capsys.readouterr().out.partition("next: ")[2].split()[:-2]
    assert command[:2] == ["pmfid", "identify"]
    result = run_command(*command[1:])
    assert "mass" in result.output


# --- keys without an effect, and one rule for the gain ----------------------------------------------------------------


OF_A_PROCESS, OF_A_DRIVE = (
    ('hold = "foh"', "gap = 0.1", 'reference = "r"'),
    ("standstill_time = 0.1", "max_speed = 2.0"),
)


def test_a_key_of_another_kind_of_plant_is_refused(tmp_path: Path) -> None:
    for line in OF_A_PROCESS:
        with pytest.raises(UsageError) as caught:
            loaded(tmp_path, CART, "dt = 0.01", f"dt = 0.01\n{line}")
        assert f"[record] {line.partition(' ')[0]} = " in str(caught.value)
        assert 'is not used with kind = "drive"; drop it' in str(caught.value)
        loaded(tmp_path, PROCESS, "dt = 0.01", f"dt = 0.01\n{line}")
    for line in OF_A_DRIVE:
        with pytest.raises(UsageError) as caught:
            loaded(tmp_path, PROCESS, "[model]", f"[encoder]\nresolution = 1e-3\n{line}\n[model]")
        assert 'is not used with kind = "transfer_function"' in str(caught.value)
        loaded(tmp_path, CART, "resolution = 22.75e-6", f"resolution = 22.75e-6\n{line}")


@pytest.mark.parametrize("gain", [-0.12, 0.12, 0.0, 1e40, float("nan"), float("inf")])
def test_python_and_toml_take_the_same_gains(tmp_path: Path, gain: float) -> None:
    def taken(make: object) -> bool:
        try:
            make()  # type: ignore[operator]
        except UsageError:
            return False
        return True

    in_python = taken(lambda: pmfid.Drive(gain))
    in_toml = taken(lambda: loaded(tmp_path, CART, "input_gain = 2.0", f"input_gain = {gain!r}"))
    assert in_python == in_toml == (abs(gain) == 0.12)


def test_a_negative_gain_turns_the_sign_of_the_input(tmp_path: Path) -> None:
    axis = loaded(tmp_path, CART, "input_gain = 2.0", "input_gain = -2.0")
    run = cart_run(1, samples=1000)
    record = Record(-run.u, run.counts, 0.01, run.encoder.resolution, (), "run")
    assert identify(record, axis).theta[0] == pytest.approx(1.07, rel=0.02)


def test_a_wrapping_counter_of_a_transfer_function_is_unwrapped(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("u,counts\n" + "".join(f"0,{count}\n" for count in (250, 253, "", 3, *range(6, 14))))
    text = PROCESS.replace("[model]", "[encoder]\nresolution = 1.0\nbits = 8\n[model]")
    y = read_experiment(path, loaded(tmp_path, text)).y
    np.testing.assert_array_equal(y, [250.5, 253.5, np.nan, 259.5, *np.arange(262.5, 270)])


# --- progress ---------------------------------------------------------------------------------------------------------


def test_progress_without_a_terminal_is_sparse_and_short_work_is_silent(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with progress("short"):
        pass
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(progress_module, "EVERY", 0.05)
    with progress("runs") as tell:
        tell(0.25)
        first = next_line(capsys)
        tell(1.0)
        last = next_line(capsys)
        while "25%" in last:  # a line that was on its way
            last = next_line(capsys)
    assert re.fullmatch(r"pmfid: runs: 25% after \d+ s\n", first)
    assert re.fullmatch(r"pmfid: runs: running for \d+ s\n", last)


def next_line(capsys: pytest.CaptureFixture[str]) -> str:
    """Wait for a progress line, and return the first of those that came."""
    end = time.monotonic() + PATIENCE
    while not (lines := capsys.readouterr().err.splitlines(keepends=True)):
        assert time.monotonic() < end
        time.sleep(0.01)
    assert len(lines) == 1, "one line in each interval"
    return lines[0]


def run_on_terminal(work: str, react: Callable[[Any], object]) -> tuple[int, str]:
    """Run Python lines in place of the command's group; return the exit code and the text on the terminal.

    `react` is called with the process once its progress is shown.
    """
    lines = (
        # a job in the background ignores interrupts
        "import signal\nsignal.signal(signal.SIGINT, signal.default_int_handler)\n"
        f"import pmfid.cli.main as m\ndef command():\n {work}\nm.main = command\nimport pmfid.cli.entry as e\ne.main()"
    )
    ours, theirs = os.openpty()
    process = subprocess.Popen([sys.executable, "-c", lines], stderr=theirs, stdout=theirs, stdin=subprocess.DEVNULL)
    os.close(theirs)
    text, shown = b"", False
    with suppress(OSError):  # raised at the end of the process
        while part := os.read(ours, 1000):
            text += part
            if not shown and re.search(rb"running for \d+ s", text):
                shown = True
                react(process)
    os.close(ours)
    return process.wait(), text.decode()


SHOWN = "from pmfid.cli.terminal import progress\n with progress('search'): "


def test_a_terminal_shows_long_work_and_its_line_is_gone_at_the_end(tmp_path: Path) -> None:
    seen = tmp_path / "seen"
    work = f"import time, os\n  while not os.path.exists({str(seen)!r}): time.sleep(0.01)\n print('result')"
    code, text = run_on_terminal(SHOWN + "\n  " + work, lambda process: seen.touch())
    assert code == 0
    assert re.search(r"pmfid: search: running for \d+ s", text)
    assert text.endswith("\r\x1b[Kresult\r\n")


@pytest.mark.parametrize(
    "work", ["import time; time.sleep(600)", "import hashlib; hashlib.pbkdf2_hmac('md5', b'', b'', 10**9)"]
)
def test_an_interrupt_ends_the_command_even_inside_a_call_that_does_not_return(work: str) -> None:
    code, text = run_on_terminal(SHOWN + work, lambda process: process.send_signal(signal.SIGINT))
    assert code == 130
    assert text.endswith("\r\x1b[Kpmfid: interrupted\r\n")


def test_small_matrices_get_one_thread_before_numpy_is_there():
    """`pmfid terms` took 18 s with two threads and 4 s with one."""
    code = "import os, sys; from pmfid.cli.main import main; main.callback(); print('numpy' in sys.modules, "
    code += "os.environ['OPENBLAS_NUM_THREADS'], os.environ['OMP_NUM_THREADS'])"
    clean = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    done = subprocess.run([sys.executable, "-c", code], env=clean, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "1", "1"]
    kept = subprocess.run(
        [sys.executable, "-c", code], env=clean | {"OMP_NUM_THREADS": "3"}, capture_output=True, text=True, check=True
    )
    assert kept.stdout.split()[-1] == "3"
