"""The command `pmfid design`, which returns an input, or an estimate from earlier runs and the next input."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import click

from pmfid.cli.tables import deliver_page
from pmfid.cli.terminal import JSON, SET, folder_option, print_json, print_text, progress, read_changes, read_numbers
from pmfid.errors import PmfidError


@click.command(short_help="Find the most informative input within the limits of an axis, or the next one after runs.")
@click.argument("spec", type=click.Path(path_type=Path), metavar="SPEC.toml")
@click.argument("records", nargs=-1, type=click.Path(path_type=Path), metavar="[RECORD]...")
@click.option(
    "--want",
    multiple=True,
    metavar="NAME=STD",
    help="Stop if the parameter has this standard deviation; may be repeated.",
)
@click.option(
    "--truth",
    multiple=True,
    metavar="NAME=VALUE",
    help="Simulate all rounds on an axis with this true value and otherwise nominal values; may be repeated.",
)
@click.option("--rounds", type=click.IntRange(min=1), default=10, show_default=True, help="Maximum number of rounds.")
@SET
@click.option(
    "--certify",
    type=click.FloatRange(min=0),
    default=5.0,
    show_default=True,
    metavar="S",
    help="Maximum processor time [s] for a proof of the distance to the optimum; 0: no proof.",
)
@folder_option("Write report.html, design.json, and t, u, x, v as design.csv into this folder.")
@JSON
def design(
    spec: Path,
    records: tuple[Path, ...],
    want: tuple[str, ...],
    truth: tuple[str, ...],
    rounds: int,
    changes: tuple[str, ...],
    certify: float,
    out: Path | None,
    as_json: bool,
) -> None:
    """Find the input that tells most about an axis within its limits.

    With records of designed runs, or with --want or --truth, the command estimates from these runs and designs the next
    run. Further rounds are unnecessary after the wanted deviation is reached. If records, --want or --truth are given,
    --certify has no effect.

    Exit code 0: a design; 2: wrong usage; 3: the limits cannot be met, or no input identifies a parameter.
    """
    if records or want or truth:
        _commission(spec, records, want, truth, rounds, out, as_json, read_changes(changes))
        return
    with _infeasible_as_json(as_json), progress("design") as tell:
        from pmfid.pipeline.designs import load_spec, run_comparison
        from pmfid.report.design import design_page, write_inputs

        loaded = load_spec(spec, read_changes(changes))
        found = run_comparison(loaded, certify=certify or None, progress=lambda done, total, _: tell(done / total))
        if out is not None:
            write_inputs(out, found)
    deliver_page(design_page(found), out, as_json, motion="design.csv")


def _commission(
    spec: Path,
    records: tuple[Path, ...],
    want: tuple[str, ...],
    truth: tuple[str, ...],
    rounds: int,
    out: Path | None,
    as_json: bool,
    changes: dict[str, object],
) -> None:
    with _infeasible_as_json(as_json), progress("commission"):
        from pmfid.pipeline.designs import compare, load_spec, read_run, run_commissioning
        from pmfid.report.design import design_page, rounds_page, write_inputs
        from pmfid.report.html import write_page

        loaded = load_spec(spec, changes)
        runs = [read_run(loaded, path) for path in records]
        wanted, true = read_numbers("want", want, "mass=0.01"), read_numbers("truth", truth, "mass=1.2")
        state = run_commissioning(loaded, runs, wanted, true or None, rounds)
        if out is not None and state.next is not None:
            found = compare(loaded, state.next)
            write_inputs(out, found)
            write_page(out, design_page(found))
    deliver_page(rounds_page(state), None, as_json)
    if out is not None and state.next is not None and not as_json:
        print_text(f"motion: {out / 'design.csv'}\nreport: {out / 'report.html'}")


@contextmanager
def _infeasible_as_json(as_json: bool) -> Iterator[None]:
    """Print the limits that must be relaxed as a JSON object, before the error appears in one line."""
    try:
        yield
    except PmfidError as error:
        ways = getattr(error, "relaxations", None)
        if as_json and ways is not None:
            changes = [{"limit": way.name, "from": way.value, "to": way.needed, "unit": way.unit} for way in ways]
            print_json({"feasible": False, "relax": changes})
        raise
