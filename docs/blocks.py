"""The code blocks of a page, run in their order as a reader would run them.

Fenced blocks of the languages `python` and `sh` run. An indented block shows a command and does not run.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

ROOT = Path(__file__).parents[1]
FENCE = re.compile(r"^```(python|sh)\n(.*?)^```\n", re.DOTALL | re.MULTILINE)
#: Width of a terminal on which the pages' tables are read [characters].
COLUMNS = 78


@dataclass(frozen=True)
class Outcome:
    """What one block showed: `text` is its output, `figures` are the figures that it made.

    `end` is the position after the block in the page.
    """

    end: int
    text: str
    figures: tuple[Figure, ...]


def run_blocks(page: str, folder: Path, names: dict[str, Any] | None = None) -> Iterator[Outcome]:
    """Run the blocks of the text `page` in `folder`, and yield the outcome of each.

    All `python` blocks share the namespace `names`. A folder `examples` is there, as in a checkout. Raises the error of
    the first block that fails.
    """
    names = {"__name__": "page"} if names is None else names
    if not (folder / "examples").exists():
        (folder / "examples").symlink_to(ROOT / "examples")
    for fence in FENCE.finditer(page):
        language, code = fence.groups()
        if language == "sh":
            yield Outcome(fence.end(), run_commands(code, folder), ())
            continue
        before, output = dict(names), io.StringIO()
        with contextlib.chdir(folder), contextlib.redirect_stdout(output):
            exec(compile(code, "page", "exec"), names)
        made = [value for name, value in names.items() if isinstance(value, Figure) and before.get(name) is not value]
        yield Outcome(fence.end(), output.getvalue(), tuple(made))


def run_commands(code: str, folder: Path) -> str:
    """Run shell commands in `folder`, and return their output. Raises RuntimeError if one fails."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    environment = os.environ | {"PATH": path, "COLUMNS": str(COLUMNS)}
    ended = subprocess.run(
        ["sh", "-e", "-c", code], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    if ended.returncode:
        raise RuntimeError(f"{code}\nended with exit code {ended.returncode}: {ended.stderr or ended.stdout}")
    return ended.stdout.replace(f"{folder}/", "")
