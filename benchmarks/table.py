"""Writes the page of benchmarks from pytest-benchmark's JSON: `python -m benchmarks.table RESULTS.json PAGE.md`."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

REFERENCE = "test_pmfid_bcrls_run[float64]"
PEER = "test_padasip_rls"
STEP = "test_pmfid_bcrls_step"
LABELS = {
    REFERENCE: "**pmfid BCRLS, `run`, float64**",
    "test_pmfid_bcrls_run[float32]": "pmfid BCRLS, `run`, float32",
    STEP: "pmfid BCRLS, `step(u, counts).theta` in a Python loop",
    "test_pmfid_rls_run[float64]": "pmfid RLS, `run`, float64",
    "test_pmfid_rls_run[float32]": "pmfid RLS, `run`, float32",
    "test_pmfid_filters": "pmfid encoder and filters of BCRLS alone",
    PEER: "padasip `FilterRLS.adapt`, loop ¹",
    "test_statsmodels_rls": "statsmodels `RecursiveLS.fit` ¹ ²",
    "test_numpy_rls": "NumPy, RLS (paper eq. 33), loop ¹",
    "test_numpy_bcrls": "NumPy, BCRLS (paper eq. 33 to 36), loop ¹ ³",
    "test_scipy_lfilter": "SciPy `lfilter`, the stages of BCRLS alone ⁴",
}

PAGE = """\
# Benchmarks

Written by `make bench`, which runs

    python -m pytest benchmarks --benchmark-only --benchmark-sort=name --benchmark-json=.benchmarks/latest.json
    python -m benchmarks.table .benchmarks/latest.json docs/benchmarks.md

{machine}

One record for all: the simulated cart (1.07 kg) under a random binary input of 3 V, sampled every 10 ms, an encoder of
1024 increments per turn, seed 1; cutoff 50 rad/s, order 2, forgetting 0.999. The time is that of the best round divided
by the samples, because the machine may be shared. The mass error is that of the last estimate. With a memory of 1000
samples it scatters by 0.03 %, and the bias of plain least squares is no larger than that with this encoder: the column
shows that each program does its work, and ranks none.

| | samples | ns per sample | ratio | mass error |
|---|---:|---:|---:|---:|
{rows}

Ratio: time per sample over that of pmfid BCRLS, `run`, float64.

1. Given the regressors and the target already filtered, from pmfid: the encoder, the filters and the
   input's pre-filter are not in their time, but are in pmfid's.
2. Without forgetting, which it does not have; it keeps the history of all samples.
3. The code that the tests compare the kernel with: written to be read beside the paper, not for speed.
4. One call per stage over the whole record, the direction by a plain sign; no encoder, no recursion.

## Goals

| goal | measured | |
|---|---:|---|
{goals}

Like with like, pmfid's RLS (with encoder and filters) is {like:.0f} times as fast as padasip's.
"""


@dataclass(frozen=True)
class Result:
    """One benchmark: samples, time per sample [ns], relative error of the mass or None where there is none."""

    samples: int
    ns: float
    mass_error: float | None

    @property
    def mass_text(self) -> str:
        return "–" if self.mass_error is None else f"{100 * self.mass_error:+.3f} %"


def read(path: Path) -> tuple[Mapping[str, Any], dict[str, Result]]:
    """The machine's description and the results by name; exits with one sentence where the file is not usable."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        machine, benchmarks = content["machine_info"], content["benchmarks"]
        results = {entry["name"]: _result(entry) for entry in benchmarks}
    except OSError as error:
        sys.exit(f"cannot read {path}: {error.strerror}; run pytest with --benchmark-json={path} first")
    except (ValueError, KeyError, TypeError):
        sys.exit(f"{path} is not a result file of these benchmarks; run pytest with --benchmark-json={path}")
    missing = sorted(set(LABELS) - set(results))
    if missing:
        sys.exit(f"{path} has no {', '.join(missing)}; run all benchmarks, without -k")
    return machine, results


def _result(entry: Mapping[str, Any]) -> Result:
    extra = entry["extra_info"]
    return Result(extra["samples"], entry["stats"]["min"] / extra["samples"] * 1e9, extra.get("mass_error"))


def machine_text(machine: Mapping[str, Any]) -> str:
    """The processor and the versions that the figures belong to."""
    cpu = machine["cpu"]
    name = cpu.get("brand_raw") or cpu.get("arch_string_raw") or machine["machine"]
    versions = ", ".join(f"{package} {version}" for package, version in machine["packages"].items())
    clock = f" ({cpu['hz_advertised_friendly']})" if cpu.get("hz_advertised_friendly") else ""
    return f"Processor: {name}{clock}. Python {machine['python_version']}, {versions}."


def rows(results: Mapping[str, Result]) -> list[str]:
    """The table's lines: in the order of `LABELS`, names that are not in it last."""
    reference = results[REFERENCE].ns
    names = [*LABELS, *sorted(set(results) - set(LABELS))]
    return [
        f"| {LABELS.get(name, name)} | {one.samples} | {one.ns:.0f} | {one.ns / reference:.2f} | {one.mass_text} |"
        for name, one in ((name, results[name]) for name in names)
    ]


def goals(results: Mapping[str, Result]) -> list[str]:
    """Each goal with what was measured, and whether that meets it."""
    run, ratio, step = results[REFERENCE].ns, results[PEER].ns / results[REFERENCE].ns, results[STEP].ns
    lines = [
        ("BCRLS `run` takes at most 150 ns per sample", f"{run:.0f} ns", run <= 150),
        ("BCRLS `run` is at least 80 times as fast as padasip's bare RLS", f"{ratio:.0f} times", ratio >= 80),
        ("one call of `step` with its `theta` takes at most 1000 ns", f"{step:.0f} ns", step <= 1000),
    ]
    return [f"| {goal} | {measured} | {'met' if met else '**not met**'} |" for goal, measured, met in lines]


def page(machine: Mapping[str, Any], results: Mapping[str, Result]) -> str:
    """The whole page; the same results give the same bytes."""
    return PAGE.format(
        machine=machine_text(machine),
        rows="\n".join(rows(results)),
        goals="\n".join(goals(results)),
        like=results[PEER].ns / results["test_pmfid_rls_run[float64]"].ns,
    )


def main(arguments: list[str]) -> None:
    """Reads the first path, writes the second."""
    if len(arguments) != 2:
        sys.exit(f"two paths are needed, got {len(arguments)}: python -m benchmarks.table RESULTS.json PAGE.md")
    source, target = (Path(argument) for argument in arguments)
    text = page(*read(source))
    try:
        target.write_text(text, encoding="utf-8", newline="\n")
    except OSError as error:
        sys.exit(f"cannot write {target}: {error.strerror}; name a file in a folder that exists")


if __name__ == "__main__":
    main(sys.argv[1:])
