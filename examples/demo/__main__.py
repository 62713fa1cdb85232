"""The demo as a command: `python -m examples.demo`."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from examples.demo.report import demo_table, edge_comparison, write_demo
from examples.demo.run import run_demo
from pmfid.report.figures import save_png


def main(arguments: Sequence[str] | None = None) -> None:
    """Watch four methods follow a step of a cart's mass on-line with four encoders, and compare them to the truth."""
    parser = argparse.ArgumentParser(prog="python -m examples.demo", description=main.__doc__)
    parser.add_argument("--out", type=Path, default=Path("demo-report"), metavar="DIR", help="folder of the report")
    parser.add_argument("--seed", type=int, default=0, help="of the input and of the start phase, >= 0")
    parser.add_argument("--images", type=Path, metavar="DIR", help="draw the picture of the README there, too")
    chosen = parser.parse_args(arguments)
    result = run_demo(seed=chosen.seed)
    write_demo(chosen.out, result)
    if chosen.images is not None:
        chosen.images.mkdir(parents=True, exist_ok=True)
        save_png(edge_comparison(result), chosen.images / "demo.png")
    Console().print(demo_table(result))
    print(f"\nreport: {chosen.out / 'report.html'}\nrecord: {chosen.out / 'cart.csv'}")
    print(f"its AXIS.toml: {chosen.out / 'cart.toml'}; change a value there and run")
    print(f"pmfid identify {chosen.out / 'cart.csv'} --config {chosen.out / 'cart.toml'}")


if __name__ == "__main__":
    main()
