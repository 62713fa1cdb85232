"""Write the record of examples/second_order.toml: `python -m studies.second_order second_order.csv`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pmfid.simulation.process import PLANTS

#: Standard deviation of the noise over that of the output.
NOISE = 0.1
PLANT = PLANTS["second-order"]


def write(path: Path, seed: int = 0) -> None:
    """Write a CSV file with t [s], u and y of 3 / (s^2 + 4 s + 3) with white noise at 20 dB."""
    rng = np.random.default_rng(seed)
    y = PLANT.y + NOISE * np.std(PLANT.y) * rng.standard_normal(PLANT.samples)
    t = np.arange(PLANT.samples) * PLANT.dt
    rows = [f"{when:.6g},{u:g},{value:.6g}" for when, u, value in zip(t, PLANT.u, y, strict=True)]
    path.write_text("\n".join(["t,u,y", *rows]) + "\n", encoding="utf-8")


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the file and return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m studies.second_order", description=__doc__)
    parser.add_argument("path", type=Path, help="CSV file to write")
    parser.add_argument("--seed", type=int, default=0, help="of the noise (default: %(default)s)")
    options = parser.parse_args(arguments)
    try:
        write(options.path, options.seed)
    except OSError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
