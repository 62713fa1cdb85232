"""The exported recursion over edges has the bits of Python, and takes the counter and the states of a drive."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pmfid
from pmfid.export.firmware import ParameterAlarm
from tests.firmware.build import CLANG, GCC, HERE, M4F, M7, WARNINGS, Target, command, compiled, run
from tests.firmware.replay import PREFIX, difference, exported_edges
from tests.test_export import selftest
from tests.test_redge import DT, estimator_of, swing

CXX = Target("g++", "g++", ("-x", "c++", "-std=c++17"))
Columns = tuple[np.ndarray, np.ndarray, np.ndarray]


def hostile(turn: int = 16, samples: int = 1600) -> tuple[Columns, float]:
    """Return input, counts and ages with bad numbers, a lost and a doubled count, a jump and a rest, and the step."""
    u, counts, ages, step = swing(turn, samples=samples, off=0.02)
    u[300], u[301], u[900], u[901] = np.nan, np.inf, 1e30, -1e30
    ages[400:410] = (-1.0, np.inf, -np.inf, 1e30, np.nan, DT, 0.0, -0.0, 2 * DT, 1e-40)
    counts[500:] += 1
    counts[700:] -= 1
    counts[1100:] += 3_000_000
    counts[1300:1350] = counts[1300]
    return (u, counts, ages), step


@pytest.mark.parametrize(
    ("precision", "target", "optimize", "turn"),
    [
        pytest.param("float32", GCC, "-O3", 16, marks=GCC.needed),
        pytest.param("float64", GCC, "-O0", 64, marks=GCC.needed),
        pytest.param("float32", CLANG, "-O2", 64, marks=CLANG.needed),
        pytest.param("float32", M4F, "-O2", 16, marks=M4F.needed),
        pytest.param("float32", M4F, "-O3", 64, marks=[M4F.needed, pytest.mark.long]),
        pytest.param("float64", M7, "-O3", 16, marks=[M7.needed, pytest.mark.long]),
    ],
)
def test_exported_code_computes_the_bits_of_python(
    precision: str, target: Target, optimize: str, turn: int, tmp_path: Path
) -> None:
    record, step = hostile(turn)
    estimator = estimator_of(step, turn, precision=precision, memory=8.0)
    assert difference(exported_edges(estimator, tmp_path, record), target, optimize, *WARNINGS) is None
    track = estimator.run(*record)
    assert np.sum(track.status[:300] == 0) > 100, "the recursion has run"
    assert track.status[-1] & pmfid.Status.STARTING == 0, "and has found the motion again"


@GCC.needed
def test_states_move_between_python_and_firmware(tmp_path: Path) -> None:
    u, counts, ages, step = swing(16)
    estimator = estimator_of(step)
    pmfid.export_firmware(estimator, tmp_path, record=(u, counts, ages))
    assert selftest(tmp_path, GCC, *WARNINGS, optimize="-O0").stdout == "800 samples, the same bits\n"
    whole = estimator.run(u, counts, ages).theta
    estimator.reset()
    estimator.run(u[:1200], counts[:1200], ages[:1200])
    samples = np.zeros(800, np.dtype([("age", float), ("u", float), ("count", np.uint32)], align=True))
    samples["age"], samples["u"], samples["count"] = ages[1200:], u[1200:], counts[1200:].astype(np.uint32)
    (tmp_path / "in.bin").write_bytes(samples.tobytes())
    (tmp_path / "state.bin").write_bytes(estimator.get_state())
    program = compiled(tmp_path, PREFIX, GCC, HERE / "moved.c", "-O0", *WARNINGS)
    assert run(program, GCC, "in.bin", "state.bin", "theta.bin", "saved.bin").returncode == 0
    assert np.array_equal(np.fromfile(tmp_path / "theta.bin").reshape(-1, 3), whole[1200:])
    estimator.set_state((tmp_path / "saved.bin").read_bytes())
    assert np.array_equal(estimator.theta, whole[-1])


@GCC.needed
def test_an_alarm_follows_the_estimate_of_the_edges(tmp_path: Path) -> None:
    before, after = swing(64, seed=1), swing(64, seed=2, drive=pmfid.simulation.DriveParameters(1.44, 12.8, 0.8, 2.0))
    u = np.r_[before[0], after[0]]
    counts = np.r_[before[1], after[1] - after[1][0] + before[1][-1]]
    estimator = estimator_of(before[3], 64, memory=2.0, precision="float32")
    exported_edges(estimator, tmp_path, (u, counts, np.r_[before[2], after[2]]))
    pmfid.export_firmware(estimator, tmp_path, prefix=PREFIX, alarms=[ParameterAlarm("mass", 1.07, 0.1)])
    program = compiled(tmp_path, PREFIX, GCC, HERE / "watch.c", "-O0", *WARNINGS)
    assert run(program, GCC, "in.bin", "out.bin").returncode == 0
    alarms = np.fromfile(tmp_path / "out.bin", [("alarm", "<i4"), ("up", "<f4"), ("down", "<f4")])["alarm"]
    assert not np.any(alarms[: u.size // 2])
    assert np.all(alarms[-300:] == 1)


@pytest.mark.parametrize("target", [pytest.param(t, marks=t.needed, id=t.name) for t in (GCC, CXX)])
def test_every_file_compiles_without_a_warning(target: Target, tmp_path: Path) -> None:
    pmfid.export_firmware(estimator_of(0.0058, precision="float32"), tmp_path)
    files = [*(path.name for path in tmp_path.glob("*.c")), "examples/main/main.c", "examples/selftest/selftest.c"]
    words = [target.compiler, *(target.options or ("-std=c99",)), *WARNINGS, "-O2", "-ffp-contract=off", "-I."]
    done = command([*words, "-c", *files], tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
