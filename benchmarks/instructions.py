"""Instructions per step, counted by callgrind: `python -m benchmarks.instructions RESULT.json`.

Unlike times they do not depend on what else the machine does. Needs valgrind; without it the result is empty.
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
    """All estimators one after the other; each new one begins with pmf_init, at which callgrind writes a part."""
    import pmfid
    from pmfid.simulation.scenarios import CART, make_scenario

    run = make_scenario("prbs", seed=1, increments=1024, duration=STEPS * 0.01)
    drive, encoder = pmfid.Drive(CART.input_gain), pmfid.Encoder(run.resolution)
    for precision in PRECISIONS:
        for cls in RECURSIVE:
            estimator = cls(drive, encoder, run.dt, 50.0, forgetting=0.999, precision=precision)
            estimator.run(run.motion.u, run.counts)


def count(folder: Path) -> list[dict[str, float]]:
    """Runs the workload under callgrind; instructions per step of each part of the kernel, per estimator."""
    output = folder / "callgrind.out"
    command = ["valgrind", "--tool=callgrind", f"--callgrind-out-file={output}", "--dump-before=pmf_init"]
    command += ["--toggle-collect=pmf_step*", sys.executable, "-m", "benchmarks.instructions", "--workload"]
    subprocess.run(command, check=True, capture_output=True)
    dumps = sorted(folder.glob("callgrind.out.*"), key=lambda path: int(path.suffix[1:]))
    counted = [inclusive(path) for path in [*dumps, output] if path.exists()]  # the last one has no number
    return [one for one in counted if one]


def inclusive(path: Path) -> dict[str, float]:
    """Inclusive instructions per step of the kernel's functions in one part; empty where none ran."""
    command = ["callgrind_annotate", "--inclusive=yes", "--threshold=100", str(path)]
    text = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    found = re.findall(r"^\s*([\d,]+)\s.*?:(pmf_\w+)", text, re.MULTILINE)
    straight = re.compile(r"^pmf_step_(rls|bcrls|riv)$")  # all parts of it are one function
    parts = [(straight.sub("pmf_step", name), int(number.replace(",", "")) / STEPS) for number, name in found]
    return {name: number for name, number in parts if name in PARTS}


def instruction_rows(counted: Counted) -> list[str]:
    """A line for each estimator; one that says so where nothing was counted."""
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
