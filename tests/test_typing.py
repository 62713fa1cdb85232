"""Types of the public interface, which mypy checks strictly in a user's script."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from pmfid.config.axis import EstimatorConfig
from pmfid.config.keys import EstimatorKeys

REPOSITORY = Path(__file__).parents[1]
START = """\
from pathlib import Path

import numpy as np
import polars as pl

import pmfid
from pmfid import Drive, Encoder, TransferFunction

u, y = np.zeros(9), np.zeros(9, np.int64)
frame = pl.DataFrame({"u": u, "y": y})
axis = {
    "record": {"input": "u", "output": "y", "output_kind": "counts", "dt": 1e-3},
    "encoder": {"resolution": "0.01 deg"},
    "model": {"input_gain": 2.0, "friction": "directional"},
}
drive, encoder = Drive(2.0, friction="directional"), Encoder("4096 counts/rev")
"""
#: The shape of an array, which NumPy leaves open.
SHAPE = "tuple[Any, ...]"
#: Expressions of a user's script, all right.
RIGHT = """\
pmfid.identify(frame, axis=axis, method="iv", cutoff=20.0)
pmfid.identify({"u": u, "y": [1.0, 2.0]}, axis=Path("AXIS.toml"))
pmfid.identify(["one.csv", "two.csv"], axis="AXIS.toml")
pmfid.identify(u, y, model=drive, dt=1e-3, encoder=encoder, cutoff=20.0, forgetting=0.99)
pmfid.identify([(u, y), (u, y)], model=drive, dt=1e-3, encoder=encoder)
pmfid.identify(u, y, model=TransferFunction(1, 0), dt=1e-3, cutoff=2.0)["a0"]
pmfid.identify(frame, axis=axis).theta
pmfid.identify(frame, axis=axis).status
pmfid.identify(frame, axis=axis).findings[0].text
pmfid.check(frame, axis=axis)
pmfid.check(u, y, model=drive, dt=1e-3, encoder=encoder)
pmfid.validate(pmfid.identify(frame, axis=axis), u, y).status
pmfid.search_terms(u, y, model=drive, dt=1e-3, encoder=encoder).added
pmfid.IV(drive, encoder, 1e-3, 20.0, discretization="paper").fit(u, y)
pmfid.RIV(drive, encoder, 1e-3, 20.0, precision="float32").run(u, y)
pmfid.RIV(drive, encoder, 1e-3, 20.0).step(0.0, 1).theta
pmfid.RIV(drive, encoder, 1e-3, 20.0, steps="given")
pmfid.IV(drive, encoder, 1e-3, 20.0, steps=np.full(9, 1e-3)).fit(u, y)
pmfid.fleet.estimate("logs", axis=axis, by="machine")
pmfid.fleet.estimate(frame.lazy(), axis=axis, by="machine").axes
encoder.resolution
"""
#: Expressions with one mistake each.
WRONG = """\
Drive(2.0, friction="direktional")
Drive(2.0, axis="rotatory")
pmfid.identify(frame, axis=axis, method="ivv")
pmfid.identify(frame, axis=axis, cutof=20.0)
pmfid.identify(frame, axis=axis, cutoff="20")
pmfid.identify(frame)
pmfid.identify(7, axis=axis)
pmfid.identify(u, y, model=drive, dt=1e-3, encoder=encoder, forgetting="0.99")
pmfid.check(frame, axes=axis)
pmfid.IV(drive, encoder, 1e-3, 20.0, discretization="exakt")
pmfid.RLS(drive, encoder, 1e-3, 20.0, forgetting="0.99")
pmfid.RIV(drive, encoder, 1e-3, 20.0, steps="givn")
pmfid.RLS(drive, encoder, 1e-3, 20.0, precision="float16")
pmfid.export_firmware(pmfid.RLS(drive, encoder, 1e-3, 20.0), "axis", prefx="axis")
pmfid.fleet.estimate(7, axis=axis, by="machine")
pmfid.fleet.estimate("logs", axis=axis, by="machine", workers="two")
pmfid.fleet.estimat
pmfid.identifi
Encoder(b"0.01 deg")
"""


@pytest.fixture(scope="module")
def complaints(tmp_path_factory: pytest.TempPathFactory) -> dict[int, str]:
    """Return what mypy says on each line of the script."""
    script = tmp_path_factory.mktemp("user") / "script.py"
    revealed = "".join(f"reveal_type({line})\n" for line in RIGHT.splitlines())
    script.write_text(START + revealed + WRONG)
    # The settings and the cache are those of `make check`, which has just read all of pmfid.
    command = [sys.executable, "-m", "mypy", "--no-pretty", str(script)]
    run = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    said: dict[int, str] = {}
    for line in run.stdout.splitlines():
        if found := re.match(r".*script\.py:(\d+): (.*)", line):
            said[int(found[1])] = f"{said.get(int(found[1]), '')}{found[2]}\n"
    return said


def lines_of(text: str, first: int) -> list[tuple[int, str]]:
    return list(enumerate(text.splitlines(), first))


def test_no_public_result_is_an_object(complaints: dict[int, str]) -> None:
    first = START.count("\n") + 1
    assert [complaints[number] for number in range(1, first) if number in complaints] == []
    for number, line in lines_of(RIGHT, first):
        assert 'note: Revealed type is "' in complaints[number], line
        assert "error" not in complaints[number], line
        answer = complaints[number].split('Revealed type is "')[1].replace(SHAPE, "")
        assert not re.search(r"\bAny\b|builtins\.object", answer), (line, answer)


def test_documented_code_passes_mypy(tmp_path: Path) -> None:
    """`result.interval_95[0]` was an error, because the intervals could be None."""
    for page in (REPOSITORY / "README.md", *(REPOSITORY / "docs").rglob("*.md")):
        blocks = re.findall(r"^```python\n(.*?)^```", page.read_text("utf-8"), re.DOTALL | re.MULTILINE)
        (tmp_path / f"{'_'.join(page.relative_to(REPOSITORY).with_suffix('').parts)}.py").write_text("\n".join(blocks))
    scripts = [str(script) for script in tmp_path.glob("*.py")]
    command = [sys.executable, "-m", "mypy", "--no-pretty", "--strict", *scripts]
    run = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout


def test_keywords_are_the_keys_of_the_section() -> None:
    assert set(EstimatorKeys.__annotations__) == set(EstimatorConfig.model_fields)
