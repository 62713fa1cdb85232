"""Arduino, PlatformIO, Zephyr and cross compilers take the exported folder as it is."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import pmfid
from pmfid.export.firmware import ParameterAlarm
from tests.firmware.build import CLANG, GCC, M4F, Target, command
from tests.test_export import FMA, PRECISIONS, make, needs, selftest

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


@needs(GCC)
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


@pytest.mark.parametrize(
    ("target", "options"),
    [
        pytest.param(
            GCC, ("-mfma", "-ffp-contract=fast"), marks=[needs(GCC), pytest.mark.skipif(not FMA, reason="no FMA")]
        ),
        pytest.param(
            CLANG, ("-mfma", "-ffp-contract=on"), marks=[needs(CLANG), pytest.mark.skipif(not FMA, reason="no FMA")]
        ),
        pytest.param(M4F, ("-ffp-contract=fast",), marks=needs(M4F)),
    ],
    ids=lambda value: value.name if isinstance(value, Target) else "",
)
@pytest.mark.parametrize("precision", PRECISIONS)
def test_gnu_mode_keeps_the_bits(target: Target, options: tuple[str, ...], precision: str, tmp_path: Path) -> None:
    """Arduino compiles in GNU mode, which contracts a * b + c, and a library of Arduino cannot set options."""
    pmfid.export_firmware(make(pmfid.BCRLS, precision), tmp_path)
    assert selftest(tmp_path, target, "-std=gnu11", *options).stdout == "800 samples, the same bits\n"


@needs(Target("", "cmake"))
def test_zephyr_builds_the_folder_as_a_module(tmp_path: Path) -> None:
    pmfid.export_firmware(make(pmfid.RIV), tmp_path / "module")
    assert (tmp_path / "module/zephyr/module.yml").read_text() == "name: axis\nbuild:\n  cmake: .\n"
    (tmp_path / "CMakeLists.txt").write_text(ZEPHYR)
    succeed(["cmake", "-B", "build", "."], tmp_path)
    succeed(["cmake", "--build", "build"], tmp_path)
    succeed(["build/application"], tmp_path)


@needs(Target("", "cmake"))
def test_cmake_runs_the_self_test(tmp_path: Path) -> None:
    pmfid.export_firmware(make(pmfid.RIV), tmp_path)
    succeed(["cmake", "-B", "build", "."], tmp_path)
    succeed(["cmake", "--build", "build"], tmp_path)
    assert "100% tests passed" in succeed(["ctest", "--test-dir", "build"], tmp_path)


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


@needs(M4F)
def test_make_with_a_cross_compiler_builds_to_the_end(tmp_path: Path) -> None:
    """Without a linker script and start-up code, the library is the end."""
    pmfid.export_firmware(make(pmfid.BCRLS), tmp_path)
    options = " ".join(M4F.options)
    succeed(["make", "-s", f"CC={M4F.compiler}", "AR=arm-none-eabi-ar", f"TARGET={options}"], tmp_path)
    assert "pmf_step.o" in succeed(["arm-none-eabi-ar", "t", "libaxis.a"], tmp_path)
