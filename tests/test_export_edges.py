"""The exported recursion over edges has the bits of Python, and takes the counter and the states of a drive."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import pmfid
from pmfid.cli.main import main
from pmfid.export.firmware import ParameterAlarm
from pmfid.kernel.structures import edge_structures
from tests.firmware.build import CLANG, GCC, HERE, M4F, M7, WARNINGS, Target, command, compiled, run
from tests.firmware.footprint import cost
from tests.firmware.replay import PREFIX, difference, exported_edges
from tests.test_export import make, needs, selftest
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
        pytest.param("float32", GCC, "-O3", 16, marks=needs(GCC)),
        pytest.param("float64", GCC, "-O1", 64, marks=needs(GCC)),
        pytest.param("float32", CLANG, "-O2", 64, marks=needs(CLANG)),
        pytest.param("float32", M4F, "-O2", 16, marks=needs(M4F)),
        pytest.param("float32", M4F, "-O3", 64, marks=[needs(M4F), pytest.mark.long]),
        pytest.param("float64", M7, "-O3", 16, marks=[needs(M7), pytest.mark.long]),
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


@needs(GCC)
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_an_export_with_an_offset_has_the_bits_of_python(precision: str, tmp_path: Path) -> None:
    (u, counts, ages), step = hostile(16)
    model = pmfid.Drive(2.0, offset=True)
    estimator = pmfid.REdge(model, pmfid.Encoder(step), DT, lines=16, tick=1e-6, memory=8.0, precision=precision)
    folder = exported_edges(estimator, tmp_path, (u + 0.3, counts, ages))
    assert difference(folder, GCC, "-O2", *WARNINGS) is None
    assert estimator.run(u + 0.3, counts, ages).theta.shape == (u.size, 4)


@needs(GCC)
@pytest.mark.parametrize("lines", [None, 16])
def test_a_counter_of_few_bits_may_wrap(lines: int | None, tmp_path: Path) -> None:
    """The travel of the motion exceeds the range of the counter."""
    u, counts, ages, step = swing(16)
    assert np.ptp(counts) > 2**6
    narrow = pmfid.REdge(pmfid.Drive(2.0), pmfid.Encoder(step, bits=6), DT, lines=lines, tick=1e-6)
    wide = estimator_of(step, lines)
    assert np.array_equal(narrow.run(u, counts % 2**6, ages).theta, wide.run(u, counts, ages).theta)
    assert difference(exported_edges(narrow, tmp_path, (u, counts % 2**6, ages)), GCC, "-O1") is None


@needs(GCC)
def test_states_move_between_python_and_firmware(tmp_path: Path) -> None:
    u, counts, ages, step = swing(16)
    estimator = estimator_of(step)
    pmfid.export_firmware(estimator, tmp_path, record=(u, counts, ages))
    assert selftest(tmp_path, GCC, *WARNINGS).stdout == "800 samples, the same bits\n"
    whole = estimator.run(u, counts, ages).theta
    estimator.reset()
    estimator.run(u[:1200], counts[:1200], ages[:1200])
    samples = np.zeros(800, np.dtype([("age", float), ("u", float), ("count", np.uint32)], align=True))
    samples["age"], samples["u"], samples["count"] = ages[1200:], u[1200:], counts[1200:].astype(np.uint32)
    (tmp_path / "in.bin").write_bytes(samples.tobytes())
    (tmp_path / "state.bin").write_bytes(estimator.get_state())
    program = compiled(tmp_path, PREFIX, GCC, HERE / "moved.c", "-O1", *WARNINGS)
    assert run(program, GCC, "in.bin", "state.bin", "theta.bin", "saved.bin").returncode == 0
    assert np.array_equal(np.fromfile(tmp_path / "theta.bin").reshape(-1, 3), whole[1200:])
    estimator.set_state((tmp_path / "saved.bin").read_bytes())
    assert np.array_equal(estimator.theta, whole[-1])


def test_states_that_no_sample_could_have_made_are_refused() -> None:
    u, counts, ages, step = swing(16, samples=300)
    estimator = estimator_of(step)
    estimator.run(u, counts, ages)
    state = np.frombuffer(estimator.kernel.raw_state(), edge_structures(16, "float64")["pmf_state_t"])[0]
    for path, value in ((("edge", "line_number"), 16), (("edge", "place"), np.nan), (("edge", "start", "marks"), 18)):
        crafted = state.copy()
        part = crafted
        for name in path[:-1]:
            part = part[name]
        part[path[-1]] = value
        with pytest.raises(ValueError, match="not a state"):
            estimator.kernel.set_raw_state(crafted.tobytes())
    assert estimator.kernel.raw_state() == state.tobytes()


@needs(M4F)
@pytest.mark.long
def test_a_drive_with_edges_is_no_larger_than_riv(tmp_path: Path) -> None:
    """In float32 on a Cortex-M4F, with 16 lines: flash, state, stack and instructions, against `riv` with its guard."""
    u, counts, ages, step = swing(16, off=0.01)
    pmfid.export_firmware(estimator_of(step, precision="float32"), tmp_path / "edges", record=(u, counts, ages))
    pmfid.export_firmware(make(pmfid.RIV), tmp_path / "riv")
    edges, riv = (cost(tmp_path / name, PREFIX) for name in ("edges", "riv"))
    assert edges.flash < riv.flash
    assert edges.stack < 1.2 * riv.stack
    assert edges.mean < riv.mean
    assert edges.most < 1.5 * riv.most
    assert "RAM 1432 bytes" in (tmp_path / "edges/axis.h").read_text()


@needs(GCC)
def test_an_alarm_follows_the_estimate_of_the_edges(tmp_path: Path) -> None:
    before, after = swing(64, seed=1), swing(64, seed=2, drive=pmfid.simulation.DriveParameters(1.44, 12.8, 0.8, 2.0))
    u = np.r_[before[0], after[0]]
    counts = np.r_[before[1], after[1] - after[1][0] + before[1][-1]]
    estimator = estimator_of(before[3], 64, memory=2.0, precision="float32")
    exported_edges(estimator, tmp_path, (u, counts, np.r_[before[2], after[2]]))
    pmfid.export_firmware(estimator, tmp_path, prefix=PREFIX, alarms=[ParameterAlarm("mass", 1.07, 0.1)])
    program = compiled(tmp_path, PREFIX, GCC, HERE / "watch.c", "-O1", *WARNINGS)
    assert run(program, GCC, "in.bin", "out.bin").returncode == 0
    alarms = np.fromfile(tmp_path / "out.bin", [("alarm", "<i4"), ("up", "<f4"), ("down", "<f4")])["alarm"]
    assert not np.any(alarms[: u.size // 2])
    assert np.all(alarms[-300:] == 1)


@pytest.mark.parametrize("target", [pytest.param(t, marks=needs(t), id=t.name) for t in (GCC, CXX)])
def test_every_file_compiles_without_a_warning(target: Target, tmp_path: Path) -> None:
    pmfid.export_firmware(estimator_of(0.0058, precision="float32"), tmp_path)
    files = [*(path.name for path in tmp_path.glob("*.c")), "examples/main/main.c", "examples/selftest/selftest.c"]
    words = [target.compiler, *(target.options or ("-std=c99",)), *WARNINGS, "-O2", "-ffp-contract=off", "-I."]
    done = command([*words, "-c", *files], tmp_path)
    assert (done.returncode, done.stderr) == (0, "")


AXIS = """
[record]
input = "u"
output = "n"
output_kind = "counts"
time = "t"
[encoder]
resolution = 0.0058
edge_age = "age"
lines = 16
tick = 1e-6
[model]
kind = "drive"
input_gain = 2.0
"""


@needs(GCC)
def test_the_command_exports_edges_where_the_record_has_them(tmp_path: Path) -> None:
    u, counts, ages, _ = swing(16)
    rows = (
        f"{DT * k:.2f},{a!r},{n},{'' if np.isnan(age) else repr(age)}\n"
        for k, (a, n, age) in enumerate(zip(u.tolist(), counts.tolist(), ages.tolist(), strict=True))
    )
    (tmp_path / "record.csv").write_text("t,u,n,age\n" + "".join(rows))
    (tmp_path / "axis.toml").write_text(AXIS)
    arguments = ["export", str(tmp_path / "axis.toml"), "--precision", "float32", "--out"]
    done = CliRunner().invoke(main, [*arguments, str(tmp_path / "a"), "--record", str(tmp_path / "record.csv")])
    assert (done.exit_code, done.stderr) == (0, "")
    assert done.stdout.startswith("redge, float32, every 0.01 s")
    assert "the same bits" in selftest(tmp_path / "a", GCC).stdout
    done = CliRunner().invoke(main, [*arguments, str(tmp_path / "b"), "--dt", "0.01"])
    assert (done.exit_code, done.stderr) == (0, "")
    assert "the same bits" in selftest(tmp_path / "b", GCC).stdout
    done = CliRunner().invoke(main, [*arguments, str(tmp_path / "c"), "--dt", "0.01", "--steps"])
    assert (done.exit_code, 'set method = "riv"' in done.stderr) == (2, True)
    done = CliRunner().invoke(
        main, [*arguments, str(tmp_path / "d"), "--dt", "0.01", "--method", "riv", "--set", "estimator.cutoff=30"]
    )
    assert done.stderr == ""
    assert done.stdout.startswith("riv, "), "counts alone, as asked"
