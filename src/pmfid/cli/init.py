"""The command `pmfid init`."""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Callable
from pathlib import Path

import click

from pmfid.cli.terminal import progress
from pmfid.errors import UsageError, printable


@click.command(short_help="Write an AXIS.toml from a record alone.")
@click.argument("record", type=click.Path(path_type=Path))
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    default=Path("AXIS.toml"),
    show_default=True,
    metavar="AXIS.toml",
    help="File to write; an existing file is never overwritten.",
)
@click.option("--input", "driving", metavar="COLUMN", help="Column of the input, if the guess is wrong.")
@click.option("--output", metavar="COLUMN", help="Column of the output, for example of one joint of several.")
@click.option("--time", metavar="COLUMN", help="Column of the time, if the guess is wrong.")
def init(record: Path, out: Path, driving: str | None, output: str | None, time: str | None) -> None:
    """Write an AXIS.toml from RECORD, with a reason for each guess.

    The command guesses the columns of time, input and output, their units and the step of the encoder. On a terminal,
    the command asks for values that the record does not show. Elsewhere, the file has a neutral value with the mark TO
    DO.

    Exit code 0: a usable file; 2: wrong usage, unreadable input, or an existing file.
    """
    if os.path.lexists(out):
        raise UsageError(f"{out} already exists and is not overwritten; give another file with --out")
    on_terminal = sys.stdin.isatty() and sys.stdout.isatty()
    with progress("init") as tell:
        from pmfid.pipeline.guess.axis_file import NamedColumns, guess

        def ask(question: str, read: Callable[[str], float]) -> float | None:
            def convert(text: str) -> float | None:
                try:
                    return read(text) if text.strip() else None
                except ValueError as error:
                    raise click.BadParameter(printable(str(error))) from None

            tell.end()
            untold = "as guessed" if question.endswith("y or n") else "TO DO"
            answer: float | None = click.prompt(
                f"{question} (Enter: {untold})", default="", show_default=False, value_proc=convert, err=True
            )
            return answer

        found = guess(record, ask if on_terminal else None, NamedColumns(time, driving, output))
    with out.open("x", encoding="utf-8", newline="\n") as file:
        file.write(found.text)
    click.echo(printable(found.text))
    words = shlex.join([str(record), "--config", str(out)])
    following = [f"pmfid check {words}", f"pmfid identify {words}"]
    if found.axes:
        following = [f"pmfid fleet history {words} --out history {shlex.join(['--axis', found.axes])}"]
    click.echo(printable("\n".join(following)))
