"""Hostile names and units of an export: refused, or the C is the same as with harmless names except for comments."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

import numpy as np

import pmfid
from pmfid.errors import UsageError
from pmfid.models.signals import Signal
from tests.firmware.build import GCC, REQUIRED, WARNINGS, command

#: Input and counts of the self-test, which these tests do not run.
REST = (np.zeros(20), np.zeros(20, np.int64))
#: Terms to which one export gives the names.
SLOTS: list[tuple[Signal, int]] = [("output", 2), ("output", 1), ("direction", 0), ("output", 0), ("moving", 0)]
#: Pieces of C, of the shell, of Make, of templates, of terminals and of other alphabets.
PIECES = ["*/", "/*", "//", "\\", "??/", "\n", "\r", '"', "'", "#define mass 1", ";", "int x;", "main", "}", "{{", "}}"]
PIECES += [
    "{% raw %}",
    "$(rm x)",
    "`id`",
    "%s%n",
    "\0",
    "\x1b[31m",
    "µ",
    "ß",
    "²",
    "\u202e",
    "\u2028",
    "kg",
    "N",
    " ",
    "_",
]
PIECES += [
    "m",
    "mass",
    "Mass",
    "MASS",
    "int",
    "NULL",
    "EOF",
    "h",
    "parameters",
    "1",
    "__LINE__",
    "/",
    "*",
    "?",
    "a" * 300,
]


def hostile_names(amount: int) -> Iterator[tuple[str, str]]:
    """Yield `amount` pairs of a parameter's name and unit; each second name is a valid C name."""
    rng = np.random.default_rng(13)
    for number in range(amount):
        name, unit = ("".join(rng.choice(PIECES, rng.integers(1, 5)).tolist()) for _ in range(2))
        yield (name if number % 2 else f"{rng.choice(['mass', 'int', 'M', 'printf', 'x_1', 'step'])}"), unit


def faults_of_names(pairs: Iterable[tuple[str, str]]) -> Iterator[str]:
    """Yield the faults of the exports of these names and units.

    A name is refused alone, or its export compiles with -Werror to the C of a harmless unit. Several exports are
    compiled at a time, because the compiler takes most of the time.
    """
    waiting: dict[str, str] = {}
    for name, unit in pairs:
        fault = _refused(name, unit)
        if fault is None:
            if name.lower() in map(str.lower, waiting) or len(waiting) == len(SLOTS):
                yield from _faults_together(waiting)
                waiting = {}
            waiting[name] = unit
        elif fault:
            yield f"name {name!r}, unit {unit!r}: {fault}"
    if waiting:
        yield from _faults_together(waiting)


def _refused(name: str, unit: str) -> str | None:
    """Return None if the export accepts the name; otherwise return the fault of the refusal, or ""."""
    with tempfile.TemporaryDirectory() as root:
        folder = Path(root) / "hostile"
        try:
            _export({name: unit}, folder)
        except UsageError as error:
            return "a folder in spite of a refusal" if folder.exists() else _refusal(str(error))
    return None


def _faults_together(named: dict[str, str]) -> Iterator[str]:
    with tempfile.TemporaryDirectory() as root:
        folder = Path(root)
        _export(named, folder)
        for file, text in _harmless(tuple(named)).items():
            if _without_comments(folder / file) != text:
                yield f"{named}: {file} is not what harmless units give"
        for file in ("examples/main/main.c", "examples/selftest/selftest.c"):
            done = command([GCC.compiler, *REQUIRED, *WARNINGS, "-I.", "-fsyntax-only", file], folder)
            if done.returncode != 0:
                yield f"{named}: {file}: {done.stderr[:300]}"


def _refusal(message: str) -> str:
    return "a refusal with control characters" if re.search(r"[\x00-\x1f\x7f]", message) else ""


def _export(named: dict[str, str], folder: Path) -> None:
    """Export an equation whose parameters have these names and units."""
    further = {} if len(named) > 1 else {"drag": ""}
    terms = [
        pmfid.Term(*slot, name, unit) for slot, (name, unit) in zip(SLOTS, (named | further).items(), strict=False)
    ]
    model = pmfid.EquationModel(pmfid.Equation(tuple(terms), (pmfid.Term("input"),)))
    pmfid.export_firmware(pmfid.RLS(model, pmfid.Encoder(1e-3), 0.01, 20.0), folder, prefix="axis", record=REST)


@cache
def _harmless(names: tuple[str, ...]) -> dict[str, str]:
    """Return the files of an export with harmless units, without comments, by file name."""
    with tempfile.TemporaryDirectory() as root:
        _export(dict.fromkeys(names, "kg"), Path(root))
        return {
            str(path.relative_to(root)): _without_comments(path) for path in Path(root).rglob("*") if path.is_file()
        }


def _without_comments(path: Path) -> str:
    """Return a source as the compiler reads it: trigraphs and spliced lines first, then without comments."""
    text = path.read_text("ascii").replace("??/", "\\").replace("\\\n", "")
    return re.sub(r"/\*.*?\*/|//[^\n]*", "", text, flags=re.DOTALL)
