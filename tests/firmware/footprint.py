"""Measure the flash, stack and instructions of an export on a microcontroller, with the cross compiler."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from tests.firmware.build import HERE, M4F, REQUIRED, Target, command, compiled, run

#: The program calls init, step and theta in an endless loop, as a drive does.
DRIVE = """#include "{prefix}.h"
int main(void);
void _exit(int code);
static {prefix}_t axis;
volatile real_t input, mass, age;
volatile uint32_t counter;
void _exit(int code)
{{
    (void)code;
    for (;;) {{
    }}
}}
int main(void)
{{
    {prefix}_init(&axis);
    for (;;) {{
        (void){prefix}_step(&axis, input, counter{age});
        mass = {prefix}_theta(&axis, 0U);
    }}
}}
"""


@dataclass(frozen=True)
class Cost:
    """The cost of an export on a microcontroller.

    `flash` is the code and constants of the kernel in a drive that calls init, step and theta [byte]. `library` is the
    code and constants of everything in the folder [byte]. `stack` is the deepest stack of pmf_step by its call graph
    [byte]. `mean` and `most` are the instructions of a step over the samples of the self-test, compiled at -O3.
    """

    flash: int
    library: int
    stack: int
    mean: int
    most: int


def cost(folder: Path, prefix: str, target: Target = M4F) -> Cost:
    """Measure the cost of an exported folder."""
    mean, most = instructions(folder, prefix, target)
    return Cost(flash(folder, prefix, target), library(folder, target), stack(folder, prefix, target), mean, most)


def instructions(folder: Path, prefix: str, target: Target, optimize: str = "-O3") -> tuple[int, int]:
    """Return the mean and the largest number of instructions of a step."""
    program = compiled(folder, prefix, target, HERE / "cost.c", optimize)
    printed = run(program, target, clock=True).stdout.split()
    return int(printed[0]), int(printed[1])


def flash(folder: Path, prefix: str, target: Target, optimize: str = "-O2") -> int:
    """Return the bytes that the linker keeps of the kernel's objects, with the libc functions that they need."""
    age = ", age" if "PMF_WITH_EDGES" in (folder / "pmf_sizes.h").read_text() else ""
    (folder / "drive.c").write_text(DRIVE.format(prefix=prefix, age=age))
    sources = [*sorted(path.name for path in folder.glob("pmf_*.c")), f"{prefix}_config.c"]
    objects = []
    for name in [*sources, "drive.c"]:
        objects.append(name.replace(".c", "-drive.o"))
        options = [*REQUIRED, optimize, *target.options, "-ffunction-sections", "-fdata-sections"]
        _checked([target.compiler, *options, "-c", name, "-o", objects[-1]], folder)
    link = ["-nostartfiles", "--specs=nano.specs", "-Wl,--gc-sections,-emain,-Map=drive.map", "-Wl,-Ttext=0"]
    _checked([target.compiler, *target.options, *link, *objects, "-o", "drive.elf"], folder)
    return sum(size for name, size in kept((folder / "drive.map").read_text()) if "drive-drive.o" not in name)


def kept(text: str) -> list[tuple[str, int]]:
    """Return the object and the size of each piece of code and constants in a linker map."""
    placed = text.partition("Linker script and memory map")[2]
    pattern = r"^ \.(?:text|rodata)\S*\s+0x[0-9a-f]+\s+0x([0-9a-f]+)\s+(\S+)$"
    return [(name, int(size, 16)) for size, name in re.findall(pattern, placed, re.MULTILINE)]


def library(folder: Path, target: Target, optimize: str = "-O2") -> int:
    """Return the bytes of code and constants of all objects."""
    size = target.compiler.replace("gcc", "size")
    objects = sorted(path.name for path in folder.glob("*-drive.o") if path.name != "drive-drive.o")
    lines = _checked([size, "-t", *objects], folder).splitlines()
    return int(lines[-1].split()[0])


def stack(folder: Path, prefix: str, target: Target, optimize: str = "-O2") -> int:
    """Return the stack of the deepest call path from pmf_step [byte], by the compiler's size of each frame."""
    frames: dict[str, int] = {}
    calls: dict[str, set[str]] = {}
    for path in sorted(folder.glob("pmf_*.c")):
        options = [*REQUIRED, optimize, *target.options, "-fcallgraph-info=su", "-c", path.name, "-o", "stack.o"]
        _checked([target.compiler, *options], folder)
        text = (folder / "stack.ci").read_text()
        for title, size in re.findall(r'node: \{ title: "([^"]+)" label: "[^"]*?\\n(\d+) bytes', text):
            frames[title] = int(size)
        for source, called in re.findall(r'edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"', text):
            calls.setdefault(source, set()).add(called)
    return _depth(f"{prefix}_pmf_step", frames, calls)


def _depth(name: str, frames: dict[str, int], calls: dict[str, set[str]]) -> int:
    return frames.get(name, 0) + max((_depth(called, frames, calls) for called in calls.get(name, ())), default=0)


def _checked(arguments: list[str], folder: Path) -> str:
    done = command(arguments, folder)
    if done.returncode != 0:
        raise RuntimeError(done.stderr[:2000])
    return done.stdout
