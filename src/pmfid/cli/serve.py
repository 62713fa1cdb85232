"""The command `pmfid serve`, which watches many axes as a service."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from pmfid.service.plant import Plant


@click.command(short_help="Watch many axes as a service with a web page.")
@click.argument("config", type=click.Path(path_type=Path, dir_okay=False))
@click.option("--every", type=float, metavar="S", help="Time between two published estimates [s]; 0: publish all.")
@click.option(
    "--state", type=click.Path(path_type=Path, file_okay=False), metavar="DIR", help="Keep checkpoints in this folder."
)
@click.option("--port", type=click.IntRange(0, 65535), help="Port of the page; default: see `pmfid explain page.port`.")
@click.option("--no-page", is_flag=True, help="Serve no page.")
@click.option("--until-end", is_flag=True, help="End when all sources have ended.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object per event.")
def serve(
    config: Path,
    every: float | None,
    state: Path | None,
    port: int | None,
    no_page: bool,
    until_end: bool,
    as_json: bool,
) -> None:
    """Watch all axes of PLANT.toml, given as CONFIG, until a signal. An AXIS.toml is watched on standard input.

    SIGTERM and Ctrl-C end the service after all results are written. SIGHUP reads PLANT.toml again.
    """
    from pmfid.service.run import Service
    from pmfid.service.sinks.plain import NoticeLog, json_line
    from pmfid.stream.sentences import notice_line

    folder, shown = None if state is None else str(state.absolute()), False if no_page else None
    keys = {"service.every": every, "service.state": folder, "page.port": port, "page.enabled": shown}

    def load() -> Plant:
        from pmfid.service.plant import load_plant

        return load_plant(config, keys)

    Service(load, NoticeLog(sys.stdout, json_line if as_json else notice_line), until_end).run()
