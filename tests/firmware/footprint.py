"""What an export costs on a microcontroller: flash, stack and instructions, measured with the cross compiler."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from tests.firmware.build import HERE, M4F, REQUIRED, Target, command, compiled, run

#: Calls init, step and theta in an endless loop, as a drive does.
DRIVE = """#include "{prefix}.h"
int main(void);
void _exit(int code);
static {prefix}_t axis;
volatile real_t input, mass;
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
        (void){prefix}_step(&axis, input, counter);
        mass = {prefix}_theta(&axis, 0U);
    }}
}}
"""


@dataclass(frozen=True)
class Cost:
    """flash: code and constants of the kernel and its configuration in a drive that calls init, step and theta [byte];
    library: the same of everything in the folder; stack: of pmf_step by its call graph [byte]; mean, most:
    instructions of a step over the samples of the self-test, at -O3."""

    flash: int
    library: int
    stack: int
    mean: int
    most: int


def cost(folder: Path, prefix: str, target: Target = M4F) -> Cost:
    """Measures an exported folder."""
    mean, most = instructions(folder, prefix, target)
    return Cost(flash(folder, prefix, target), library(folder, target), stack(folder, prefix, target), mean, most)


def instructions(folder: Path, prefix: str, target: Target, optimize: str = "-O3") -> tuple[int, int]:
    """Of a step: mean, and most."""
    program = compiled(folder, prefix, target, HERE / "cost.c", optimize)
    printed = run(program, target, clock=True).stdout.split()
    return int(printed[0]), int(printed[1])


def flash(folder: Path, prefix: str, target: Target, optimize: str = "-O2") -> int:
    """Bytes that the linker keeps of the kernel's objects, by its map; with what it takes from libc for them."""
    (folder / "drive.c").write_text(DRIVE.format(prefix=prefix))
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
    """Object and size of every piece of code and constants in a linker map."""
    placed = text.partition("Linker script and memory map")[2]
    pattern = r"^ \.(?:text|rodata)\S*\s+0x[0-9a-f]+\s+0x([0-9a-f]+)\s+(\S+)$"
    return [(name, int(size, 16)) for size, name in re.findall(pattern, placed, re.MULTILINE)]


def library(folder: Path, target: Target, optimize: str = "-O2") -> int:
    """Bytes of code and constants of all objects."""
    size = target.compiler.replace("gcc", "size")
    objects = sorted(path.name for path in folder.glob("*-drive.o") if path.name != "drive-drive.o")
    lines = _checked([size, "-t", *objects], folder).splitlines()
    return int(lines[-1].split()[0])


def stack(folder: Path, prefix: str, target: Target, optimize: str = "-O2") -> int:
    """Deepest path of the call graph from pmf_step on, with the compiler's size of every frame."""
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
