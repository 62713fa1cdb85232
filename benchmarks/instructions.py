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

#: Instructions of the parts of a step, by estimator.
Counted = Mapping[str, Mapping[str, float]]
STEPS = 2000
PRECISIONS = ("float64", "float32")
PARTS = ("pmf_step", "pmf_encoder_step", "pmf_auxiliary_step", "pmf_network_step", "pmf_recursion_step")


def workload() -> None:
    """Run all estimators in turn; each begins with pmf_init, at which callgrind starts a new part."""
    import pmfid
    from pmfid.simulation.scenarios import CART, make_scenario

    run = make_scenario("prbs", seed=1, increments=1024, duration=STEPS * 0.01)
    drive, encoder = pmfid.Drive(CART.input_gain), pmfid.Encoder(run.resolution)
    for precision in PRECISIONS:
        for cls in RECURSIVE:
            estimator = cls(drive, encoder, run.dt, 50.0, forgetting=0.999, precision=precision)
            estimator.run(run.motion.u, run.counts)


def count(folder: Path) -> list[dict[str, float]]:
    """Run the workload under callgrind; return the instructions per step of each kernel part for each estimator."""
    output = folder / "callgrind.out"
    command = ["valgrind", "--tool=callgrind", f"--callgrind-out-file={output}", "--dump-before=pmf_init"]
    command += ["--toggle-collect=pmf_step*", sys.executable, "-m", "benchmarks.instructions", "--workload"]
    subprocess.run(command, check=True, capture_output=True)
    dumps = sorted(folder.glob("callgrind.out.*"), key=lambda path: int(path.suffix[1:]))
    counted = [inclusive(path) for path in [*dumps, output] if path.exists()]  # the last dump has no number
    return [one for one in counted if one]


def inclusive(path: Path) -> dict[str, float]:
    """Return the inclusive instructions per step of the kernel's functions in one part, or an empty dict."""
    command = ["callgrind_annotate", "--inclusive=yes", "--threshold=100", str(path)]
    text = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    found = re.findall(r"^\s*([\d,]+)\s.*?:(pmf_\w+)", text, re.MULTILINE)
    straight = re.compile(r"^pmf_step_(rls|bcrls|riv)$")  # all parts of a straight step are one function
    parts = [(straight.sub("pmf_step", name), int(number.replace(",", "")) / STEPS) for number, name in found]
    return {name: number for name, number in parts if name in PARTS}


def instruction_rows(counted: Counted) -> list[str]:
    """Return a line for each estimator, or one line that says that nothing was counted."""
    lines = [
        f"| {name} | " + " | ".join(f"{one[part]:.0f}" if part in one else "–" for part in PARTS) + " |"
        for name, one in counted.items()
    ]
    return lines or ["| not counted: valgrind is not installed | | | | | |"]


def main(arguments: list[str]) -> None:
    if arguments == ["--workload"]:
        workload()
        return
    if len(arguments) != 1:
        sys.exit(f"one path is needed, got {len(arguments)}: python -m benchmarks.instructions RESULT.json")
    result = {}
    if shutil.which("valgrind") and shutil.which("callgrind_annotate"):
        with TemporaryDirectory() as folder:
            names = [f"{cls.method}, {precision}" for precision in PRECISIONS for cls in RECURSIVE]
            result = dict(zip(names, count(Path(folder)), strict=True))
    Path(arguments[0]).write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
