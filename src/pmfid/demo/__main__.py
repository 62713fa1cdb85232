"""The demo's table, and with --images FOLDER the picture of the README."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import rich

from pmfid.demo.report import comparison, demo_table
from pmfid.demo.run import run_demo
from pmfid.report.figures import save_png


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table; with --images FOLDER draw the picture of the README there."""
    parser = argparse.ArgumentParser(prog="python -m pmfid.demo", description=main.__doc__)
    parser.add_argument("--images", type=Path, metavar="FOLDER")
    folder = parser.parse_args(arguments).images
    result = run_demo()
    rich.print(demo_table(result))
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        save_png(comparison(result), folder / "demo.png")


if __name__ == "__main__":
    main()
