"""Compile the exported C, and run it on this computer or on an emulator."""

from __future__ import annotations

import hashlib
import re
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

HERE = Path(__file__).parent
REQUIRED = ("-std=c99", "-ffp-contract=off")
WARNINGS = ("-Wall", "-Wextra", "-Wvla", "-Werror", "-pedantic", "-Wconversion", "-Wdouble-promotion")
SEMIHOSTING = "-semihosting-config"


@dataclass(frozen=True)
class Target:
    """A compiler with its options, and the emulator's board that runs the program ("" means this computer)."""

    name: str
    compiler: str
    options: tuple[str, ...] = ()
    board: str = ""

    @property
    def missing(self) -> str:
        """The tools that are not installed, as the reason of a skipped test, or ""."""
        needed = [self.compiler, *(["qemu-system-arm"] if self.board else [])]
        absent = [name for name in needed if shutil.which(name) is None]
        return f"not installed: {', '.join(absent)} (make firmware-tools INSTALL_TOOLS=1)" if absent else ""

    @property
    def needed(self) -> pytest.MarkDecorator:
        """The mark that skips a test without these tools."""
        return pytest.mark.skipif(bool(self.missing), reason=self.missing)


ARM = ("-mthumb", "-mfloat-abi=hard")
GCC, CLANG = Target("gcc", "gcc"), Target("clang", "clang")
M4F = Target("Cortex-M4F", "arm-none-eabi-gcc", ("-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16", *ARM), "mps2-an386")
M7 = Target("Cortex-M7", "arm-none-eabi-gcc", ("-mcpu=cortex-m7", "-mfpu=fpv5-d16", *ARM), "mps2-an500")


def command(arguments: list[str], folder: Path, timeout: float = 600) -> subprocess.CompletedProcess[str]:
    """Run a command in a folder and keep its output."""
    return subprocess.run(arguments, cwd=folder, capture_output=True, text=True, timeout=timeout)


#: The key of a compiled kernel is its whole source, because many exports differ only in their configuration.
_MADE: dict[str, bytes] = {}


def objects(folder: Path, target: Target, *options: str) -> list[str]:
    """Return the compiled objects of an exported kernel, cached by source and options.

    Macros are for the main program: the kernel has none of them. Raises RuntimeError with the compiler's output.
    """
    options = tuple(option for option in options if not option.startswith("-D"))
    words = [target.compiler, *REQUIRED, *target.options, *options]
    headers = b"".join(path.read_bytes() for path in sorted([*folder.glob("pmf*.h"), *folder.glob("pmf*.inl")]))
    out = folder / "objects"
    out.mkdir(exist_ok=True)
    keys = {path.stem: _key(words, headers, path) for path in sorted(folder.glob("pmf_*.c"))}
    missing = [name for name, key in keys.items() if key not in _MADE]
    if missing:
        done = command([*words, "-c", *(f"../{name}.c" for name in missing)], out)
        if done.returncode != 0:
            raise RuntimeError(done.stderr[:2000])
    _MADE.update({keys[name]: (out / f"{name}.o").read_bytes() for name in missing})
    for name, key in keys.items():
        (out / f"{name}.o").write_bytes(_MADE[key])
    return [f"objects/{name}.o" for name in keys]


def _key(words: list[str], headers: bytes, source: Path) -> str:
    return hashlib.sha256("\0".join(words).encode() + headers + source.read_bytes()).hexdigest()


def compiled(folder: Path, prefix: str, target: Target, main: Path, optimize: str, *options: str) -> Path:
    """Compile a program from an exported folder and a main file; raise RuntimeError with the compiler's output."""
    program = folder / f"{main.stem}-{target.name}{optimize}"
    kernel = objects(folder, target, optimize, *options)
    board = ["--specs=rdimon.specs", f"-T{HERE / 'mps2.ld'}", str(HERE / "startup.c")] if target.board else []
    macros = [f'-DEXPORT_HEADER="{prefix}.h"', f"-DEXPORT_CONFIG={prefix}_config", "-I.", "-Iexamples/selftest"]
    words = [target.compiler, *REQUIRED, *target.options, optimize, *options, *macros]
    sources = [str(main), f"{prefix}_config.c", *kernel]
    done = command([*words, *sources, *board, "-Wl,--gc-sections", "-o", program.name], folder)
    if done.returncode != 0:
        raise RuntimeError(done.stderr[:2000])
    return program


def calls(folder: Path, target: Target, objects: list[str]) -> set[str]:
    """Return the undefined symbols of the objects."""
    nm = target.compiler.replace("gcc", "nm") if target.board else "nm"
    return set(re.findall(r"^\s+U (\S+)$", command([nm, "-u", *objects], folder).stdout, re.MULTILINE))


@cache
def links(target: Target, *options: str) -> bool:
    """Return whether an empty program compiles and links with these options."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "nothing.c").write_text("int main(void) { return 0; }\n")
        return command([target.compiler, *options, "nothing.c"], Path(folder)).returncode == 0


def run(program: Path, target: Target, *arguments: str, clock: bool = False) -> subprocess.CompletedProcess[str]:
    """Run a program in its folder. With `clock`, each instruction advances the emulated clock by 64 ns."""
    if not target.board:
        return command([f"./{program.name}", *arguments], program.parent)
    semihosting = ",".join(["enable=on", "target=native", *(f"arg={word}" for word in (program.name, *arguments))])
    emulator = ["qemu-system-arm", "-machine", target.board, "-nographic", SEMIHOSTING, semihosting]
    return command([*emulator, *(["-icount", "shift=6"] if clock else []), "-kernel", program.name], program.parent)
