"""Crafted states under the sanitizers, with the kernel of Python, of a fleet, and of an export."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import pmfid
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.export.firmware import export_firmware
from pmfid.kernel.saved import configuration, firmware_shape, fleet_layout, tight_state
from pmfid.kernel.structures import resize_structure, structures
from tests.firmware.build import REQUIRED
from tests.test_many import PROCESS, PROCESSES, VARIANTS, fleet_record, make, process_record

SOURCES = Path(__file__).parents[2] / "csrc"
PROGRAM = Path(__file__).with_suffix(".c")
SANITIZE = ("-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
#: The builds of the kernel.
PLACES = ("python", "fleet", "export")
LAGS = {"model": PROCESS, "encoder": pmfid.Encoder(1e-3), "dt": 0.05, "cutoff": 5.0, "forgetting": 0.999}


@dataclass(frozen=True)
class Outcome:
    """The outcome of an attack: numbers of crafted and of accepted states, and the report of a sanitizer or ""."""

    states: int
    taken: int
    report: str


def estimators() -> Iterator[tuple[str, RecursiveEstimator]]:
    """Yield the name and the estimator of every method, model and precision, each after a run."""
    cases = [(cls, options, fleet_record()) for cls, options in VARIANTS]
    cases += [(cls, LAGS | options, process_record()) for cls, options in PROCESSES]
    for precision in ("float32", "float64"):
        for number, (cls, options, (u, counts)) in enumerate(cases):
            estimator = make(cls, precision, **options)
            axis = number % u.shape[0]
            estimator.run(u[axis], counts[axis])
            yield f"{number}-{estimator.method}-{precision}", estimator


def folder_of(estimator: RecursiveEstimator, place: str, folder: Path) -> Path:
    """Write the configuration, the state and its fields for a build with the module's sizes or an export's sizes."""
    config, precision = configuration(estimator.kernel, estimator.precision), estimator.precision
    shape = firmware_shape(config) if place == "export" else None
    types = structures(shape, precision)
    if shape is None:
        state = np.frombuffer(estimator.kernel.raw_state(), types["pmf_state_t"])[0]
    else:
        state = tight_state(estimator.kernel, precision, shape)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "config").write_bytes(resize_structure(config, types["pmf_config_t"]).tobytes())
    (folder / "state").write_bytes(state.tobytes())
    fields = [(offset, int(kind == "f")) for _, kind, offset in leaves(types["pmf_state_t"])]
    (folder / "words").write_bytes(np.array(fields, "<u4").tobytes())
    if place == "fleet":
        (folder / "layout").write_bytes(fleet_layout(estimator.kernel, estimator.precision))
    return folder


def leaves(dtype: np.dtype[Any], start: int = 0, prefix: str = "") -> Iterator[tuple[str, str, int]]:
    """Yield name, kind and offset of every number of a structure; elements of an array have the array's name."""
    for name in dtype.names or ():
        entry, offset = dtype.fields[name][:2]  # type: ignore[index]
        base, shape = entry.subdtype or (entry, ())
        for k in range(int(np.prod(shape, dtype=int))):
            place = start + offset + k * base.itemsize
            if base.names:
                yield from leaves(base, place, f"{prefix}{name}.")
            else:
                yield f"{prefix}{name}", base.kind, place


def program(estimator: RecursiveEstimator, place: str, folder: Path) -> Path:
    """Compile the kernel with the sanitizers; raise RuntimeError with the compiler's output."""
    folder.mkdir(parents=True, exist_ok=True)
    sources = folder / "c"
    if place == "export":
        export_firmware(estimator, sources)
    else:
        shutil.copytree(SOURCES, sources, dirs_exist_ok=True)  # an installation has only the sources for firmware
    files = [str(PROGRAM), *sorted(map(str, sources.glob("pmf_*.c")))]
    options = ["-O0"]
    if place != "export" and estimator.precision == "float32":
        options.append("-DPMF_FLOAT32")
    if place == "fleet":
        files += [str(sources / "many" / name) for name in ("pmf_many.c", "pmf_scores.c", "pmf_lanes.c")]
        lanes = ["-DPMF_LANE_BYTES=16", "-DPMF_HAVE_LANES_16", "-msse4.2"]
        for method in ("rls", "bcrls", "riv", "plain"):
            for name, own in (("pmf_straight", []), *([("pmf_lanes", lanes)] if method != "plain" else [])):
                files.append(f"{name}_{method}.o")
                source = str(sources / "many" / f"{name}.c")
                flags = [*REQUIRED, *options, *own, *SANITIZE, f"-DPMF_STRAIGHT={method}", f"-I{sources}"]
                subprocess.run(["gcc", *flags, "-c", source, "-o", files[-1]], cwd=folder, check=True)
        options += ["-DFLEET", *lanes]
    command = ["gcc", *REQUIRED, *options, *SANITIZE, f"-I{sources}", *files, "-o", "crafted"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(done.stderr[:2000])
    return folder / "crafted"


def attack(built: Path, folder: Path, states: int, seed: int) -> Outcome:
    """Run a program on the files of `folder_of`."""
    command = [str(built), str(folder), str(states), str(seed)]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        return Outcome(states, 0, f"exit code {done.returncode}: {done.stderr[:3000]}")
    made, taken = map(int, done.stdout.split())
    return Outcome(made, taken, done.stderr)
