"""Count the instructions per step with callgrind: `python -m benchmarks.instructions RESULT.json`.

Unlike times, these counts do not depend on other load of the machine. Without valgrind the result is empty.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

from pmfid.estimators.registry import RECURSIVE

#: Instructions per step, by estimator.
Counted = Mapping[str, float]
STEPS = 2000
PRECISIONS = ("float64", "float32")


def workload() -> None:
    """Run all estimators in turn, for STEPS and for twice as many samples.

    Callgrind starts a new part whenever a state is read.
    """
    import pmfid
    from pmfid.simulation.scenarios import CART, make_scenario

    run = make_scenario("prbs", seed=1, increments=1024, duration=2 * STEPS * 0.01)
    drive, encoder = pmfid.Drive(CART.input_gain), pmfid.Encoder(run.resolution)
    for precision in PRECISIONS:
        for cls in RECURSIVE:
            estimator = cls(drive, encoder, run.dt, 50.0, forgetting=0.999, precision=precision)
            for samples in (STEPS, STEPS, 2 * STEPS):  # the first run is slower
                estimator.get_state()
                estimator.run(run.motion.u[:samples], run.counts[:samples])
            estimator.get_state()


def count(folder: Path) -> list[float]:
    """Run the workload under callgrind; return the instructions per step of each estimator, with the loop of `run`.
    What a run needs besides its steps cancels in the difference of two lengths."""
    output = folder / "callgrind.out"
    command = ["valgrind", "--tool=callgrind", f"--callgrind-out-file={output}", "--dump-before=pmf_clear_computed"]
    subprocess.run(
        [*command, sys.executable, "-m", "benchmarks.instructions", "--workload"], check=True, capture_output=True
    )
    dumps = sorted(folder.glob("callgrind.out.*"), key=lambda path: int(path.suffix[1:]))
    totals = [_total(path) for path in dumps]
    return [(long - short) / STEPS for short, long in zip(totals[2::4], totals[3::4], strict=True)]


def _total(path: Path) -> int:
    """Return the number of instructions of a part."""
    found = re.search(r"^(?:summary|totals): (\d+)", path.read_text(encoding="utf-8"), re.MULTILINE)
    return int(found[1]) if found else 0


def instruction_rows(counted: Counted) -> list[str]:
    """Return a line for each estimator, or one line that says that nothing was counted."""
    lines = [f"| {name} | {number:.0f} |" for name, number in counted.items()]
    return lines or ["| not counted: valgrind is not installed | |"]


def main(arguments: list[str]) -> None:
    if arguments == ["--workload"]:
        workload()
        return
    if len(arguments) != 1:
        sys.exit(f"one path is needed, got {len(arguments)}: python -m benchmarks.instructions RESULT.json")
    result = {}
    if shutil.which("valgrind"):
        with TemporaryDirectory() as folder:
            names = [f"{cls.method}, {precision}" for precision in PRECISIONS for cls in RECURSIVE]
            result = dict(zip(names, count(Path(folder)), strict=True))
    Path(arguments[0]).write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
