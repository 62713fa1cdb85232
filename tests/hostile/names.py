"""Hostile names and units through an export: refused, or the same C as with harmless ones but for the comments."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np

import pmfid
from pmfid.errors import UsageError
from tests.firmware.build import GCC, REQUIRED, WARNINGS, command

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
    """So many pairs of a parameter's name and unit; each second name is one that C would take."""
    rng = np.random.default_rng(13)
    for number in range(amount):
        name, unit = ("".join(rng.choice(PIECES, rng.integers(1, 5)).tolist()) for _ in range(2))
        yield (name if number % 2 else f"{rng.choice(['mass', 'int', 'M', 'printf', 'x_1', 'step'])}"), unit


def faults_of_name(name: str, unit: str) -> str:
    """What is wrong with the export; "" where it is refused, or compiles with -Werror to what a harmless unit gives."""
    with tempfile.TemporaryDirectory() as root:
        folder = Path(root) / "hostile"
        try:
            _export(name, unit, folder)
        except UsageError as error:
            return "a folder in spite of a refusal" if folder.exists() else _refusal(str(error))
        for file, text in _harmless(name).items():
            if _without_comments(folder / file) != text:
                return f"{file} is not what a harmless unit gives"
        for file in ("main.c", "selftest.c"):
            done = command([GCC.compiler, *REQUIRED, *WARNINGS, "-fsyntax-only", file], folder)
            if done.returncode != 0:
                return f"{file}: {done.stderr[:300]}"
    return ""


def _refusal(message: str) -> str:
    return "a refusal with control characters" if re.search(r"[\x00-\x1f\x7f]", message) else ""


def _export(name: str, unit: str, folder: Path) -> None:
    terms = (pmfid.Term("output", 2, name, unit), pmfid.Term("output", 1, "drag"))
    model = pmfid.EquationModel(pmfid.Equation(terms, (pmfid.Term("input"),)))
    pmfid.export_firmware(pmfid.RLS(model, pmfid.Encoder(1e-3), 0.01, 20.0), folder, prefix="axis")


@cache
def _harmless(name: str) -> dict[str, str]:
    """File -> its text without comments, with a harmless unit."""
    with tempfile.TemporaryDirectory() as root:
        _export(name, "kg", Path(root))
        return {path.name: _without_comments(path) for path in Path(root).iterdir()}


def _without_comments(path: Path) -> str:
    """As the compiler reads it: trigraphs and spliced lines first."""
    text = path.read_text("ascii").replace("??/", "\\").replace("\\\n", "")
    return re.sub(r"/\*.*?\*/|//[^\n]*", "", text, flags=re.DOTALL)
