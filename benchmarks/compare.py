"""Compare two versions in turn on one machine: `python -m benchmarks.compare REF` builds the commit REF.

Prints a table of the median ratio new / old over the rounds. The exit code is 1 if a benchmark is slower than
`--allowed`.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
TIMINGS = Path(__file__).with_name("timings.py")


def build_version(ref: str, folder: Path) -> Path:
    """Return the interpreter of an environment with that commit, in a work tree that later calls use again."""
    python = folder / ".venv" / "bin" / "python"
    if not folder.exists():
        subprocess.run(["git", "worktree", "add", "--detach", str(folder), ref], cwd=ROOT, check=True)
    if not python.exists():
        subprocess.run([sys.executable, "-m", "venv", str(folder / ".venv")], check=True)
        pins = str(ROOT / "build" / "pins.txt")
        subprocess.run([str(python), "-m", "pip", "install", "--quiet", "-c", pins, str(folder)], check=True)
    return python


def measure_version(python: Path | str) -> dict[str, float]:
    done = subprocess.run([str(python), str(TIMINGS)], capture_output=True, text=True, check=True)
    found: dict[str, float] = json.loads(done.stdout)
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("ref")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--allowed", type=float, default=1.03)
    options = parser.parse_args()
    old = build_version(options.ref, ROOT / ".benchmarks" / options.ref)
    rounds = [(measure_version(old), measure_version(sys.executable)) for _ in range(options.rounds)]
    ratios = {name: float(np.median([new[name] / before[name] for before, new in rounds])) for name in rounds[0][0]}
    for name, ratio in ratios.items():
        before, new = (float(np.min([pair[side][name] for pair in rounds])) for side in (0, 1))
        print(f"{name:24} {before:9.1f} {new:9.1f} ns   {ratio:5.2f}")
    print(f"geometric mean {np.exp(np.mean(np.log(list(ratios.values())))):.2f}")
    return int(max(ratios.values()) > options.allowed)


if __name__ == "__main__":
    raise SystemExit(main())
