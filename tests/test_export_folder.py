"""An exported folder: layouts of build systems, foreign names, and no call of a library."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import pmfid
from pmfid import Equation, EquationModel, Term
from pmfid.errors import UsageError
from pmfid.export.c_text import C_TYPES
from pmfid.export.firmware import ParameterAlarm
from tests.conftest import long_unless
from tests.firmware.build import CLANG, GCC, M4F, REQUIRED, WARNINGS, Target, calls, command, objects
from tests.refusals import refused
from tests.test_export import make

#: What a sketch sees of Arduino.
ARDUINO = """
#pragma once
#include <cstdint>
#include <cstdio>
struct Port {
    void begin(long) {}
    void println(const char *text) { std::puts(text); }
    void println(double value, int digits) { std::printf("%.*f\\n", digits, value); }
};
static Port Serial;
static uint32_t micros() { static uint32_t now; return now += 2000000U; }
static inline void delay(uint32_t) {}
void setup();
void loop();
"""
PROGRAM = '\nint main() { setup(); loop(); loop(); std::puts("two samples"); return 0; }\n'
#: Functions of Zephyr's build that a module calls.
ZEPHYR = """
cmake_minimum_required(VERSION 3.20)
project(zephyr LANGUAGES C)
set(CMAKE_C_FLAGS "-std=c17 -Wall -Wextra -Werror")
macro(zephyr_library_named name)
  set(ZEPHYR_CURRENT_LIBRARY ${name})
  add_library(${name} STATIC)
endmacro()
function(zephyr_library_sources)
  target_sources(${ZEPHYR_CURRENT_LIBRARY} PRIVATE ${ARGV})
endfunction()
function(zephyr_library_compile_options)
  target_compile_options(${ZEPHYR_CURRENT_LIBRARY} PRIVATE ${ARGV})
endfunction()
function(zephyr_include_directories)
  include_directories(${ARGV})
endfunction()
add_subdirectory(module)
add_executable(application module/examples/main/main.c)
target_include_directories(application PRIVATE module)
target_link_libraries(application PRIVATE axis)
"""
#: Warnings of a strict Arduino build.
STRICT = ("-std=gnu11", "-Wall", "-Wextra", "-Werror")


def succeed(arguments: list[str], folder: Path) -> str:
    """Run a command, which must end well, and return its output."""
    done = command(arguments, folder)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@GCC.needed
@pytest.mark.parametrize("options", [{}, {"steps": "given"}])
def test_a_sketch_links_with_every_source_of_the_folder(options: dict[str, object], tmp_path: Path) -> None:
    estimator = make(pmfid.RIV, **options)
    alarm = ParameterAlarm(estimator.names[0], 1.0, 0.1)
    pmfid.export_firmware(estimator, tmp_path / "axis", alarms=[alarm], blocks=True)
    (tmp_path / "Arduino.h").write_text(ARDUINO)
    sketch = "#include <Arduino.h>\n" + (tmp_path / "axis/examples/sketch/sketch.ino").read_text()
    (tmp_path / "sketch.cpp").write_text(sketch + PROGRAM)
    sources = sorted(str(path) for path in (tmp_path / "axis").glob("*.c"))
    assert succeed(["gcc", *STRICT, "-c", *sources], tmp_path) == ""
    objects = sorted(path.name for path in tmp_path.glob("*.o"))
    warnings = ("-Wall", "-Wextra", "-Werror", "-I.", "-Iaxis")
    succeed(["g++", "-std=gnu++17", *warnings, "sketch.cpp", *objects, "-o", "sketch"], tmp_path)
    assert succeed(["./sketch"], tmp_path) == "two samples\n"


@Target("", "cmake").needed
def test_zephyr_builds_the_folder_as_a_module(tmp_path: Path) -> None:
    pmfid.export_firmware(make(pmfid.RIV), tmp_path / "module")
    assert (tmp_path / "module/zephyr/module.yml").read_text() == "name: axis\nbuild:\n  cmake: .\n"
    (tmp_path / "CMakeLists.txt").write_text(ZEPHYR)
    succeed(["cmake", "-B", "build", "."], tmp_path)
    succeed(["cmake", "--build", "build"], tmp_path)
    succeed(["build/application"], tmp_path)


def test_the_manifests_name_the_header_and_the_version(tmp_path: Path) -> None:
    pmfid.export_firmware(make(pmfid.RLS), tmp_path, prefix="cart")
    library = json.loads((tmp_path / "library.json").read_text())
    lines = (tmp_path / "library.properties").read_text().splitlines()
    properties = dict(line.split("=", 1) for line in lines)
    assert {"name", "version", "author", "maintainer", "sentence", "paragraph", "category", "architectures"} <= set(
        properties
    )
    for manifest, header in ((library, library["headers"]), (properties, properties["includes"])):
        assert (manifest["name"], manifest["version"], header) == ("cart", pmfid.__version__, "cart.h")
    assert library["build"]["srcFilter"] == "+<*.c>"
    assert {path.parts[-3] for path in tmp_path.rglob("*.ino")} == {"examples"}


PREFIXES = [
    "axis", "main", "step", "exit", "alarm", "int", "for", "selftest", "sample", "x", "status", "config", "h",
    "t"
]  # fmt: skip
REFUSED = [
    "int8", "uint32", "int_least64", "size", "real", "truth", "whole", "integer", "scalar", "time", "intmax",
    "float", "pmf", "Ax"
]  # fmt: skip
NAMES = ["mass", "Mass_2", "max", "init", "step", "main", "printf", "int", "NULL", "EOF", "MIN", "t", "config"]


def estimator_of(name: str, unit: str = "kg", second: str = "drag") -> pmfid.RLS:
    terms = (Term("output", 2, name, unit), Term("output", 1, second))
    model = EquationModel(Equation(terms, (Term("input"),)))
    return pmfid.RLS(model, pmfid.Encoder(1e-3), 0.01, 20.0)


def compile_all(folder: Path, prefix: str) -> None:
    files = (f"{prefix}_config.c", "examples/main/main.c", "examples/selftest/selftest.c")
    done = command([GCC.compiler, *REQUIRED, *WARNINGS, "-I.", "-fsyntax-only", *files], folder)
    assert done.returncode == 0, done.stderr[:500]


@GCC.needed
@pytest.mark.parametrize("prefix", long_unless([*PREFIXES][::3].__contains__, PREFIXES))
def test_a_prefix_that_is_taken_compiles(tmp_path: Path, prefix: str) -> None:
    pmfid.export_firmware(estimator_of("mass"), tmp_path, prefix=prefix)
    compile_all(tmp_path, prefix)


@pytest.mark.parametrize("prefix", [*REFUSED, *sorted(name.removesuffix("_t") for name in C_TYPES)])
def test_a_prefix_that_would_not_compile_is_refused(tmp_path: Path, prefix: str) -> None:
    refused(("prefix", lambda: pmfid.export_firmware(estimator_of("mass"), tmp_path / "out", prefix=prefix)))
    assert not (tmp_path / "out").exists()


@GCC.needed
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


#: Cases of `make test`: one of each kind of processor.
OFTEN = [(GCC, "-O3"), (M4F, "-Os")]
BUILDS = [(GCC, "-O2"), (CLANG, "-O2"), (M4F, "-O3"), *OFTEN]


@pytest.mark.parametrize(
    ("target", "optimize"),
    [
        pytest.param(
            *build,
            marks=[build[0].needed, *([] if build in OFTEN else [pytest.mark.long])],
            id=f"{build[0].name}{build[1]}",
        )
        for build in BUILDS
    ],
)
def test_no_call_of_a_library(target: Target, optimize: str, tmp_path: Path) -> None:
    """The export is the one with the most code; `test_exported_code_computes_the_bits_of_python` covers all methods."""
    pmfid.export_firmware(make(pmfid.RIV), tmp_path)
    called = calls(tmp_path, target, objects(tmp_path, target, optimize))
    assert {name for name in called if not name.startswith("axis_pmf_")} == set()
    assert called, "the objects call each other at least"
