"""The command `pmfid`, where `--help` answers at once because only the commands import slow modules."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import click

from pmfid import __version__
from pmfid.cli.actuators import actuators
from pmfid.cli.check import check
from pmfid.cli.design import design
from pmfid.cli.encoder import encoder
from pmfid.cli.explain import explain
from pmfid.cli.export import export
from pmfid.cli.fleet import fleet
from pmfid.cli.friction import friction
from pmfid.cli.init import init
from pmfid.cli.monitor import monitor
from pmfid.cli.serve import serve
from pmfid.cli.simulate import simulate
from pmfid.cli.tables import print_result
from pmfid.cli.terminal import (
    JSON,
    RECORDS,
    SET,
    config_option,
    folder_option,
    print_json,
    print_text,
    progress,
    read_changes,
)
from pmfid.cli.terms import terms
from pmfid.cli.validate import validate
from pmfid.errors import INTERRUPTED, PmfidError
from pmfid.estimators import METHODS
from pmfid.io import SPOKEN

EXIT_USAGE = 2


class CommandGroup(click.Group):
    """A group of commands that turns every PmfidError into one line and an exit code."""

    def invoke(self, ctx: click.Context) -> object:
        try:
            return super().invoke(ctx)
        except PmfidError as error:
            print_text(f"pmfid: {error}", err=True)
            ctx.exit(error.exit_code)
        except BrokenPipeError:  # the reader has closed the pipe and needs no more
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            ctx.exit(0)
        except OSError as error:
            reason = f"{error.filename}: {error.strerror}" if error.filename else str(error)
            print_text(f"pmfid: {reason}; choose another file or folder", err=True)
            ctx.exit(EXIT_USAGE)
        except KeyboardInterrupt:
            click.echo("pmfid: interrupted", err=True)
            ctx.exit(INTERRUPTED)


@click.group(cls=CommandGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__)
def main() -> None:
    """Mass and friction of a drive, or a transfer function, from input and a coarse encoder."""
    _open_closed_streams()


def _open_closed_streams() -> None:
    """Open each closed stream, as by `<&-`, on the null device.

    If a stream stayed closed, the next opened file would get its number and receive the printed text.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115


@main.command(
    short_help="Identify the parameters of a record.",
    help=f"""Identify the parameters of RECORD, a {SPOKEN} file.

    Several records of a process make one estimate.

    Exit code 0: an estimate; 2: wrong usage or unreadable input; 3: the data cannot identify the parameters.
    """,
)
@RECORDS
@config_option()
@click.option(
    "--method",
    type=click.Choice(METHODS),
    help="auto: from the record. Off-line: fit, ls, bcls, iv, srivc; "
    "recursive: rls, bcrls, riv. For a transfer function: srivc, rls, bcrls.",
)
@SET
@folder_option(
    "Write report.html and result.json into this folder, for a recursive method on a drive also track.parquet."
)
@JSON
def identify(
    records: tuple[Path, ...],
    config: Path,
    method: str | None,
    changes: tuple[str, ...],
    out: Path | None,
    as_json: bool,
) -> None:
    """Identify the parameters of a record."""
    given = read_changes(changes)
    given |= {"estimator.method": method} if method else {}
    with progress("identify") as tell:
        from pmfid.config.axis import load_axis
        from pmfid.pipeline.guess.axis_file import find_to_do
        from pmfid.pipeline.identify import identify as run
        from pmfid.pipeline.identify import kind_of

        axis = load_axis(config, given)
        result = run(kind_of(axis).read(records, axis), axis, tell).with_findings(*find_to_do(config))
        if out is not None:
            from pmfid.report.result import write_result

            write_result(out, result)
    if as_json:
        print_json(result.to_dict())
    else:
        print_result(result, out)


COMMANDS = (
    *(actuators, check, design, encoder, explain, export, fleet, friction, init, monitor, serve, simulate),
    *(terms, validate),
)
for command in COMMANDS:
    main.add_command(command)
