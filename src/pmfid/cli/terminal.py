"""Options, output and progress reports that commands share."""

from __future__ import annotations

import json
import re
import shutil
import sys
import textwrap
import threading
import time
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

import click

from pmfid.errors import UsageError, printable

F = TypeVar("F", bound=Callable[..., object])

RECORDS = click.argument("records", type=click.Path(path_type=Path), nargs=-1, required=True, metavar="RECORD...")
SET = click.option(
    "--set",
    "changes",
    multiple=True,
    metavar="KEY=VALUE",
    help="Another value of a key in the file for this run, such as estimator.cutoff=20; may be repeated.",
)
JSON = click.option("--json", "as_json", is_flag=True, help="Print one JSON object and nothing else.")


def read_changes(texts: Sequence[str]) -> dict[str, object]:
    """Return the values of --set by their dotted keys. A value is read as in TOML, or else as text without quotes."""
    found: dict[str, object] = {}
    for text in texts:
        key, equals, value = (part.strip() for part in text.partition("="))
        if not equals or not re.fullmatch(r"\w+\.\w+", key):
            raise UsageError(f"--set {text!r} is not SECTION.KEY=VALUE, for example estimator.cutoff=20")
        try:
            found[key] = tomllib.loads(f"value = {value}")["value"]
        except tomllib.TOMLDecodeError:
            found[key] = value
    return found


def read_numbers(option: str, texts: Sequence[str], example: str) -> dict[str, float]:
    """Return the pairs NAME=NUMBER of a repeated option."""
    found = {}
    for text in texts:
        name, _, value = text.partition("=")
        try:
            found[name.strip()] = float(value)
        except ValueError:
            raise UsageError(f"--{option} {text!r} is not NAME=NUMBER: write --{option} {example}") from None
    return found


def config_option(text: str = "The columns, the encoder, the model and the estimator.") -> Callable[[F], F]:
    """Return the option --config, whose default is the file that `pmfid init` writes."""
    kind = click.Path(path_type=Path)
    return click.option("--config", default="AXIS.toml", type=kind, metavar="FILE", help=f"{text} Default: AXIS.toml.")


def folder_option(text: str) -> Callable[[F], F]:
    """Return the option --out DIR."""
    return click.option("--out", type=click.Path(path_type=Path, file_okay=False), metavar="DIR", help=text)


def result_option(text: str) -> Callable[[F], F]:
    """Return the option --model RESULT.json."""
    return click.option(
        "--model", "stored", required=True, type=click.Path(path_type=Path), metavar="RESULT.json", help=text
    )


def print_text(text: str, err: bool = False, widest: int = 200, narrowest: int = 40) -> None:
    """Print text for people, without control characters, and with long lines folded at spaces.

    `widest` and `narrowest` limit the width of a line. An error that goes to a program instead of a terminal stays one
    line.
    """
    on_terminal = (sys.stderr if err else sys.stdout).isatty()
    width = min(widest, max(narrowest, shutil.get_terminal_size().columns)) if on_terminal else widest
    lines = printable(text).split("\n")
    click.echo("\n".join(lines if err and not on_terminal else (fold(line, width) for line in lines)), err=err)


def fold(line: str, width: int) -> str:
    """Return a line in pieces of at most `width` characters. The further pieces stand two characters to the right."""
    if len(line) <= width:
        return line
    left = line[: len(line) - len(line.lstrip())]
    return textwrap.fill(
        line.strip(), width, initial_indent=left, subsequent_indent=left + "  ", break_long_words=False,
        break_on_hyphens=False,
    )  # fmt: skip


def print_json(content: Mapping[str, object]) -> None:
    """Print one object as one line of JSON. NaN raises ValueError, because JSON has no NaN."""
    click.echo(json.dumps(content, allow_nan=False))


#: Time before a progress line appears on a terminal [s]. Shorter work needs no such line. `REFRESH` is the time between
#: two updates [s].
PATIENCE, REFRESH = 1.5, 0.25
#: In other outputs, time before the first line and between two lines [s].
EVERY = 9.0
#: Characters that go to the start of the line and clear the line.
CLEAR = "\r\x1b[K"


class ProgressReport:
    """A thread that reports the progress of long work, because the work itself may be inside a library.

    The class does not use rich, which would take longer to load than the first report may wait.
    """

    def __init__(self, what: str) -> None:
        self.what, self.done = what, 0.0
        self.over = threading.Event()
        self._start = time.monotonic()
        self._thread = threading.Thread(
            target=_redraw if sys.stderr.isatty() else _write_lines, args=(self,), daemon=True
        )
        self._thread.start()

    def __call__(self, done: float) -> None:
        """Set the completed part of the work, from 0 to 1. A part of 1 means that the remaining time is unknown.

        A smaller part than before has no effect, because a search may learn of more work.
        """
        self.done = max(self.done, done)

    @property
    def measured(self) -> bool:
        return 0.0 < self.done < 1.0

    @property
    def line(self) -> str:
        how = f"{self.done:.0%} after" if self.measured else "running for"
        return f"pmfid: {self.what}: {how} {time.monotonic() - self._start:.0f} s"

    def end(self) -> None:
        self.over.set()
        self._thread.join()


@contextmanager
def progress(what: str) -> Iterator[ProgressReport]:
    """Yield a report that is called with the completed part of the work, and end the report after the work.

    Nothing may be printed before the end, because the progress line is on the terminal.
    """
    work = ProgressReport(what)
    try:
        yield work
    finally:
        work.end()


def _write_lines(work: ProgressReport) -> None:
    while not work.over.wait(EVERY):
        print(work.line, file=sys.stderr, flush=True)


def _redraw(work: ProgressReport) -> None:
    if work.over.wait(PATIENCE):
        return
    while True:
        print(f"{CLEAR}{work.line}", end="", file=sys.stderr, flush=True)
        if work.over.wait(REFRESH):
            break
    print(CLEAR, end="", file=sys.stderr, flush=True)
