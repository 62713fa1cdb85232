"""Foreign names and units in the exported C are refused, or compile without a warning and without effect."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pmfid
from pmfid import Equation, EquationModel, Term
from pmfid.errors import UsageError
from pmfid.export.c_text import C_TYPES, remark
from tests.conftest import long_unless
from tests.firmware.build import GCC, REQUIRED, WARNINGS, command
from tests.refusals import refused

PREFIXES = [
    "axis",
    "main",
    "step",
    "exit",
    "alarm",
    "int",
    "for",
    "selftest",
    "sample",
    "x",
    "status",
    "config",
    "h",
    "t",
]
REFUSED = [
    "int8",
    "uint32",
    "int_least64",
    "size",
    "real",
    "truth",
    "whole",
    "integer",
    "scalar",
    "time",
    "intmax",
    "float",
    "pmf",
    "Ax",
]
NAMES = ["mass", "Mass_2", "max", "init", "step", "main", "printf", "int", "NULL", "EOF", "MIN", "t", "config"]
UNITS = [
    "kg m2",
    "*/ int evil = 1; /*",
    "/* */",
    "µm/s²",
    "größe",
    "N\\",
    "??/",
    "line\nbreak",
    "\x1b[31m",
    "//",
    "*" + "/" * 3,
    "* /",
]
needs_gcc = pytest.mark.skipif(bool(GCC.missing), reason=GCC.missing)


def estimator_of(name: str, unit: str = "kg", second: str = "drag") -> pmfid.RLS:
    terms = (Term("output", 2, name, unit), Term("output", 1, second))
    model = EquationModel(Equation(terms, (Term("input"),)))
    return pmfid.RLS(model, pmfid.Encoder(1e-3), 0.01, 20.0)


def compile_all(folder: Path, prefix: str) -> None:
    files = (f"{prefix}_config.c", "examples/main/main.c", "examples/selftest/selftest.c")
    done = command([GCC.compiler, *REQUIRED, *WARNINGS, "-I.", "-fsyntax-only", *files], folder)
    assert done.returncode == 0, done.stderr[:500]


@needs_gcc
@pytest.mark.parametrize("prefix", long_unless([*PREFIXES][::3].__contains__, PREFIXES))
def test_a_prefix_that_is_taken_compiles(tmp_path: Path, prefix: str) -> None:
    pmfid.export_firmware(estimator_of("mass"), tmp_path, prefix=prefix)
    compile_all(tmp_path, prefix)


@pytest.mark.parametrize("prefix", [*REFUSED, *sorted(name.removesuffix("_t") for name in C_TYPES)])
def test_a_prefix_that_would_not_compile_is_refused(tmp_path: Path, prefix: str) -> None:
    refused(("prefix", lambda: pmfid.export_firmware(estimator_of("mass"), tmp_path / "out", prefix=prefix)))
    assert not (tmp_path / "out").exists()


@needs_gcc
@pytest.mark.parametrize("name", long_unless(NAMES[::3].__contains__, NAMES))
def test_a_name_that_is_taken_compiles(tmp_path: Path, name: str) -> None:
    pmfid.export_firmware(estimator_of(name), tmp_path, prefix="axis")
    compile_all(tmp_path, "axis")


@pytest.mark.parametrize(
    ("name", "second", "message"),
    [
        ("h", "drag", "AXIS_H, which the exported code already uses"),
        ("parameters", "drag", "AXIS_PARAMETERS, which"),
        ("Alarms", "drag", "AXIS_ALARMS, which"),
        ("mass", "Mass", "AXIS_MASS, which"),
        ("größe", "drag", "letters that C does not allow"),
    ],
)
def test_a_name_that_would_not_compile_is_refused(tmp_path: Path, name: str, second: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        pmfid.export_firmware(estimator_of(name, second=second), tmp_path / "out", prefix="axis")
    assert not (tmp_path / "out").exists()


@needs_gcc
@pytest.mark.parametrize("unit", long_unless(UNITS[1:9:2].__contains__, UNITS))
def test_a_unit_stays_within_its_comment(tmp_path: Path, unit: str) -> None:
    """Code in a unit once ran in the example."""
    pmfid.export_firmware(estimator_of("mass", unit), tmp_path, prefix="axis")
    compile_all(tmp_path, "axis")
    line = next(line for line in (tmp_path / "axis.h").read_text("ascii").splitlines() if "AXIS_MASS = 0" in line)
    assert line.strip() == f"AXIS_MASS = 0, /* {remark(unit)} */"
    assert line.count("*/") == 1


def test_a_remark_is_one_line_of_ascii_whatever_comes() -> None:
    rng = np.random.default_rng(1)
    signs = ["*", "/", "\\", "?", "\n", "µ", "a", " ", "\0", "é", "\u2028"]
    for _ in range(2000):
        found = remark("".join(rng.choice(signs, rng.integers(1, 12))))
        assert found.isascii()
        assert found.isprintable()
        assert "\\" not in found
        assert "*/" not in found
        assert "/*" not in found
        assert "?" not in found
