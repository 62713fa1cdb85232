"""The examples of an export with edges find the mass of a cart, on boards that play back levels of an encoder."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pmfid
from pmfid.simulation import CART, capture_edges, prbs, resolution_of, simulate_drive
from tests.firmware.build import GCC, HERE, M4F, REQUIRED, Target, command, run

TURN, DT, FINE, SAMPLES = 16, 0.01, 20, 1500
PLATFORMS = HERE / "platforms"
#: Bits of channels A and B at a count.
LEVELS = (0, 2, 3, 1)
WARNINGS = ("-Wall", "-Wextra", "-Werror")
GXX = Target("g++", "g++")
M4FXX = Target(M4F.name, "arm-none-eabi-g++", M4F.options, M4F.board)


def list_moments() -> str:
    """Return the events of a cart as C: the levels at each edge, and the input at each sample."""
    u = prbs(SAMPLES, clock=10, amplitude=4.0, rng=np.random.default_rng(4)).astype(np.float32)
    step, t = resolution_of(TURN), DT / FINE * np.arange(SAMPLES * FINE)
    motion = simulate_drive(CART, np.repeat(u.astype(float), FINE), DT / FINE)
    counts, ages = capture_edges(motion, step, 0.3 * step, tick=1e-6)
    change = np.diff(counts, prepend=counts[0])
    assert np.max(np.abs(change)) == 1, "each edge is known"
    edges = np.flatnonzero(change)
    rows = [(round(1e6 * (t[k] - ages[k])), 0, LEVELS[counts[k] % 4], 0.0) for k in edges]
    rows += [(round(1e6 * DT * k), 1, 0, float(u[k])) for k in range(SAMPLES)]
    lines = "".join(
        f"    {{{time}U, {sample}U, {levels}U, {float(value).hex()}f}},\n"
        for time, sample, levels, value in sorted(rows)
    )
    kind = "typedef struct {\n    uint32_t time;\n    uint8_t sample, levels;\n    float u;\n} moment_t;\n"
    return f"{kind}static const moment_t moments[] = {{\n{lines}}};\n"


@pytest.fixture(scope="module")
def export(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Export the recursion; the examples apply the input of the events."""
    folder = tmp_path_factory.mktemp("examples")
    estimator = pmfid.REdge(
        pmfid.Drive(CART.input_gain), pmfid.Encoder(resolution_of(TURN)), DT, lines=TURN, tick=1e-6, precision="float32"
    )
    pmfid.export_firmware(estimator, folder / "axis")
    (folder / "events.h").write_text(list_moments())
    for name, program in (("sketch/sketch.ino", "sketch.cpp"), ("zephyr/src/main.c", "zephyr.c")):
        text = (folder / "axis/examples" / name).read_text()
        assert "return PMF_R(0.0);" in text
        first = "#include <Arduino.h>\n" if program == "sketch.cpp" else ""
        (folder / program).write_text(first + text.replace("return PMF_R(0.0);", "return board_input;"))
    return folder


def build(folder: Path, program: str, target: Target, *options: str) -> Path:
    """Compile the kernel as C, then the program, and link both, without the library of C++."""
    out = folder / f"{program}-{target.name}"
    kernel = target.compiler.replace("g++", "gcc")
    sources = sorted(str(path) for path in (folder / "axis").glob("*.c"))
    done = command([kernel, *REQUIRED, *target.options, "-O1", "-c", *sources], folder)
    assert done.returncode == 0, done.stderr
    board = []
    if target.board:
        done = command([kernel, *target.options, "-O1", "-c", str(HERE / "startup.c"), "-o", "startup.obj"], folder)
        board = ["startup.obj", "--specs=rdimon.specs", f"-T{HERE / 'mps2.ld'}"]
    objects = [*sorted(path.name for path in folder.glob("pmf_*.o")), "axis_config.o"]
    words = [target.compiler, *options, *target.options, *WARNINGS, "-O1", "-I.", "-Iaxis", f"-I{PLATFORMS}"]
    done = command([*words, "-c", program, "-o", "program.obj"], folder)
    assert done.returncode == 0, done.stderr
    done = command(
        [kernel, *target.options, "program.obj", *objects, *board, "-Wl,--gc-sections", "-o", out.name], folder
    )
    assert done.returncode == 0, done.stderr
    return out


@pytest.mark.parametrize("target", [pytest.param(t, marks=t.needed, id=t.name) for t in (GXX, M4FXX)])
def test_the_sketch_for_arduino_finds_the_mass(target: Target, export: Path) -> None:
    done = run(build(export, "sketch.cpp", target, "-std=gnu++17", "-fno-exceptions"), target)
    masses = [float(line) for line in done.stdout.splitlines()]
    assert len(masses) > SAMPLES / 2
    assert masses[-1] == pytest.approx(CART.mass, rel=1e-3)


@pytest.mark.parametrize("target", [pytest.param(t, marks=t.needed, id=t.name) for t in (GCC, M4F)])
def test_the_application_of_zephyr_finds_the_mass(target: Target, export: Path) -> None:
    done = run(build(export, "zephyr.c", target, "-std=gnu17"), target)
    words = done.stdout.split()
    assert (words[0], words[2]) == ("mass:", "kg")
    assert float(words[1]) == pytest.approx(CART.mass, rel=1e-3)
