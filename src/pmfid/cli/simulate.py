"""The command `pmfid simulate`, which writes a run of the simulated cart as a record."""

from __future__ import annotations

import shlex
from pathlib import Path

import click

from pmfid.cli.terminal import progress
from pmfid.errors import UsageError, did_you_mean


@click.command(short_help="Simulate a run of the laboratory cart as a record.")
@click.argument("scenario", required=False)
@click.option("--list", "listing", is_flag=True, help="Print the scenarios and stop.")
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="RUN.csv",
    help="File for the record; its AXIS.toml is written next to it as RUN.toml.",
)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of everything random.")
@click.option("--increments", type=click.IntRange(min=1), default=4096, show_default=True, help="Counts per turn.")
@click.option(
    "--duration",
    type=click.FloatRange(max=360_000),
    default=30.0,
    show_default=True,
    metavar="S",
    help="Length of the run [s].",
)
@click.option("--bits", type=click.IntRange(2, 32), help="Width of the counter in bits; the counter then wraps around.")
@click.option("--missed", type=float, default=0.0, metavar="P", help="Fraction of the edges that the counter misses.")
@click.option("--jitter", type=float, default=0.0, metavar="COUNTS", help="Standard deviation of the edges' positions.")
@click.option(
    "--line-error",
    type=float,
    default=0.0,
    metavar="COUNTS",
    help="Largest position error of a line on the encoder's disc.",
)
@click.option("--truth", is_flag=True, help="Also write the true position, velocity and parameters.")
def simulate(scenario: str | None, listing: bool, out: Path | None, truth: bool, **options: float) -> None:
    """Simulate SCENARIO, a run of the laboratory cart, and write it as a record for `pmfid identify`."""
    if listing:
        from pmfid.simulation import SCENARIOS

        width = max(map(len, SCENARIOS))
        click.echo("\n".join(f"{name:<{width}}  {recipe.summary}" for name, recipe in SCENARIOS.items()))
        return
    if scenario is None or out is None:
        raise UsageError("give a scenario and --out RUN.csv; pmfid simulate --list names the scenarios")
    if out.suffix.lower() != ".csv":
        raise UsageError(f"the record is written as CSV, not as {out.name!r}; name it {out.stem}.csv")
    with progress("simulate"):
        axis = _write(scenario, out, truth, **options)
    click.echo(f"record: {out}\naxis:   {axis}\npmfid identify {shlex.join([str(out), '--config', str(axis)])}")


def _write(
    name: str, out: Path, truth: bool, missed: float, jitter: float, line_error: float, **options: float
) -> Path:
    from pmfid.simulation import SCENARIOS, Faults, axis_toml, make_scenario, write_csv

    if name not in SCENARIOS:
        raise UsageError(
            f"unknown scenario {name!r}: pmfid simulate --list shows all names{did_you_mean(name, SCENARIOS)}"
        )
    try:
        lines, seed = int(options["increments"]), int(options["seed"])
        faults = Faults(missed, jitter, line_error, lines, seed)
        run = make_scenario(name, faults=faults, **options)  # type: ignore[arg-type]
    except ValueError as error:
        raise UsageError(str(error)) from None
    out.parent.mkdir(parents=True, exist_ok=True)
    write_csv(run, out, truth)
    axis = out.with_suffix(".toml")
    axis.write_text(axis_toml(run), encoding="ascii", newline="\n")
    return axis
