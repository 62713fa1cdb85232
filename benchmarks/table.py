"""Write the page of benchmarks: `python -m benchmarks.table RESULTS.json INSTRUCTIONS.json READING.json PAGE.md`.

The first three files come from pytest-benchmark, `benchmarks.instructions` and `benchmarks.reading`. A .json file of
the page's name keeps the figures, so that results of several years can be compared.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.instructions import STEPS, Counted, instruction_rows
from benchmarks.reading import section

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
    "test_sippy_rls": "sippy_unipi ARX by recursive least squares ⁵",
    "test_scipy_lfilter": "SciPy `lfilter`, the stages of BCRLS alone ⁴",
}

OPTIONAL = {"test_sippy_rls", "test_sippy_process[OE]", "test_sippy_process[ARMAX]"}
WHOLE = {
    "test_pmfid_srivc_order_4": "**pmfid `SRIVC`**",
    "test_sippy_process[OE]": "sippy_unipi output error, discrete",
    "test_sippy_process[ARMAX]": "sippy_unipi ARMAX, discrete",
}
ON_LINE = "test_pmfid_rls_order_4[{}]"
ZEROS = range(4)
LINEAR = [*WHOLE, *(ON_LINE.format(zeros) for zeros in ZEROS)]
AXES = (1, 10, 100, 1000, 10_000, 100_000)
LOOP = "test_pmfid_bcrls_loop[{}]"
FLEET = "test_pmfid_bcrls_fleet[{}-{}]"
THREAD = "test_pmfid_bcrls_fleet_one_thread[{}]"
NUMPY = "test_numpy_over_axes"
PRECISIONS = ("float64", "float32")
MANY = [
    NUMPY,
    *(form.format(precision) for form in (LOOP, THREAD) for precision in PRECISIONS),
    *(FLEET.format(precision, axes) for precision in PRECISIONS for axes in AXES),
]

PAGE = """\
# Benchmarks

Written by `make bench`, which runs

    python -m pytest benchmarks --benchmark-only --benchmark-sort=name --benchmark-json=.benchmarks/latest.json
    python -m benchmarks.instructions .benchmarks/instructions.json
    python -m benchmarks.reading .benchmarks/reading.json
    python -m benchmarks.table .benchmarks/latest.json .benchmarks/instructions.json .benchmarks/reading.json \\
        results/benchmarks.md

and keeps the figures in [benchmarks.json](benchmarks.json).

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
3. The code that the tests compare the kernel with: written to be read next to the paper, not for speed.
4. One call per stage over the whole record, the direction by a plain sign; no encoder, no recursion.
5. Velocity on input and direction, two terms of the input, without forgetting, which cannot be set. It is a difference
   equation with noise in its regressors, so no mass is compared. Measured where it is installed: it brings CasADi.

## Many axes

`Fleet.run` of BCRLS on {processors} processors, each axis from another start of the same record; the last estimate of
each is kept. In brackets how many times the axis-samples per second of the scalar kernel, which takes the axes one
after the other on one core: {loop64:.0f} ns in float64, {loop32:.0f} ns in float32.

| axes | samples of each | float64, ns per axis and sample | float32, ns per axis and sample |
|---:|---:|---:|---:|
{many}

One thread with 10000 axes: {thread64:.1f} ns ({gain64:.1f}) in float64, {thread32:.1f} ns ({gain32:.1f}) in float32.
NumPy vectorised over 10000 axes takes {numpy:.0f} ns for the recursion alone, on columns that are filtered already and
the same for all axes. The bits of each axis are those of the scalar kernel (`tests/test_many.py`).

## Linear processes

The system of Rao and Garnier (four poles, one zero, T = 10 ms), {samples} samples of a random binary input, white noise
at 10 dB, seed 0. Error: of the output that the model simulates, as a part of the output without noise.

| | seconds | error |
|---|---:|---:|
{whole}

RLS with four poles, `run`, per sample of the same record: {on_line}.

## Instructions

Of one step of the scalar kernel, with the loop of `run`, counted by callgrind over {steps} samples of the record.

| estimator | instructions |
|---|---:|
{instructions}

{reading}
## Goals

| goal | measured | |
|---|---:|---|
{goals}

Like with like, pmfid's RLS (with encoder and filters) is {like:.0f} times as fast as padasip's.
"""


@dataclass(frozen=True)
class Result:
    """One benchmark: samples, time per sample [ns], and relative error of the mass or None."""

    samples: int
    ns: float
    mass_error: float | None
    output_error: float | None = None

    @property
    def mass_text(self) -> str:
        return "–" if self.mass_error is None else f"{100 * self.mass_error:+.3f} %"


Machine, Results = Mapping[str, Any], Mapping[str, Result]


def read(path: Path) -> tuple[Machine, dict[str, Result]]:
    """Return the machine's description and the results by name; exit with one sentence if the file is not usable."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        machine, benchmarks = content["machine_info"], content["benchmarks"]
        results = {entry["name"]: _result(entry) for entry in benchmarks}
    except OSError as error:
        sys.exit(f"cannot read {path}: {error.strerror}; run pytest with --benchmark-json={path} first")
    except (ValueError, KeyError, TypeError):
        sys.exit(f"{path} is not a result file of these benchmarks; run pytest with --benchmark-json={path}")
    missing = sorted((set(LABELS) | set(MANY) | set(LINEAR)) - OPTIONAL - set(results))
    if missing:
        sys.exit(f"{path} has no {', '.join(missing)}; run all benchmarks, without -k")
    return machine, results


def _result(entry: Mapping[str, Any]) -> Result:
    extra = entry["extra_info"]
    return Result(
        extra["samples"],
        entry["stats"]["min"] / extra["samples"] * 1e9,
        extra.get("mass_error"),
        extra.get("output_error"),
    )


def machine_text(machine: Machine) -> str:
    """Return the processor and the versions to which the figures belong."""
    cpu = machine["cpu"]
    name = cpu.get("brand_raw") or cpu.get("arch_string_raw") or machine["machine"]
    versions = ", ".join(f"{package} {version}" for package, version in machine["packages"].items())
    clock = f" ({cpu['hz_advertised_friendly']})" if cpu.get("hz_advertised_friendly") else ""
    return f"Processor: {name}{clock}, {machine['processors']} cores. Python {machine['python_version']}, {versions}."


def rows(results: Results) -> list[str]:
    """Return the table's lines in the order of `LABELS`; other names come last."""
    reference = results[REFERENCE].ns
    names = [name for name in LABELS if name in results] + sorted(set(results) - set(LABELS) - set(MANY) - set(LINEAR))
    return [
        f"| {LABELS.get(name, name)} | {one.samples} | {one.ns:.0f} | {one.ns / reference:.2f} | {one.mass_text} |"
        for name, one in ((name, results[name]) for name in names)
    ]


def many_rows(results: Results) -> list[str]:
    """Return the time per axis and sample by the number of axes, with the gain over the scalar kernel in a loop."""
    lines = []
    for axes in AXES:
        found = {precision: results[FLEET.format(precision, axes)] for precision in PRECISIONS}
        cells = (f"{one.ns:.1f} ({results[LOOP.format(name)].ns / one.ns:.1f})" for name, one in found.items())
        lines.append(f"| {axes} | {found['float64'].samples // axes} | {' | '.join(cells)} |")
    return lines


def many_figures(results: Results) -> dict[str, float]:
    """Return the figures in the text below the table of many axes."""
    loop, thread = ([results[form.format(precision)].ns for precision in PRECISIONS] for form in (LOOP, THREAD))
    return {
        **{"loop64": loop[0], "loop32": loop[1], "thread64": thread[0], "thread32": thread[1]},
        **{"gain64": loop[0] / thread[0], "gain32": loop[1] / thread[1], "numpy": results[NUMPY].ns},
    }


def linear_figures(results: Results) -> dict[str, Any]:
    """Return the figures of the section on linear processes."""
    found = [(label, results[name]) for name, label in WHOLE.items() if name in results]
    times = [f"{results[ON_LINE.format(zeros)].ns:.0f} ns" for zeros in ZEROS]
    return {
        "samples": found[0][1].samples,
        "whole": "\n".join(
            f"| {label} | {one.ns * one.samples / 1e9:.2f} | {100 * (one.output_error or 0.0):.1f} % |"
            for label, one in found
        ),
        "on_line": ", ".join(f"{time} (m = {zeros})" for zeros, time in zip(ZEROS, times, strict=True)),
    }


def goals(results: Results) -> list[str]:
    """Return each goal with the measured figure, and whether the figure meets the goal."""
    run, ratio, step = results[REFERENCE].ns, results[PEER].ns / results[REFERENCE].ns, results[STEP].ns
    order_4 = {zeros: results[ON_LINE.format(zeros)].ns for zeros in (1, 3)}
    many = [results[LOOP.format(name)].ns / results[FLEET.format(name, 10_000)].ns for name in PRECISIONS]
    lines = [
        ("BCRLS `run` takes at most 150 ns per sample", f"{run:.0f} ns", run <= 150),
        ("BCRLS `run` is at least 80 times as fast as padasip's bare RLS", f"{ratio:.0f} times", ratio >= 80),
        ("one call of `step` with its `theta` takes at most 1000 ns", f"{step:.0f} ns", step <= 1000),
        (
            "SRIVC of order 4 takes less than a second on 7161 samples",
            f"{(srivc := results[next(iter(WHOLE))]).ns * srivc.samples / 1e9:.2f} s",
            srivc.ns * srivc.samples < 1e9,
        ),
        *(
            (f"RLS of order 4, m = {zeros}, `run` takes at most 200 ns per sample", f"{ns:.0f} ns", ns <= 200)
            for zeros, ns in order_4.items()
        ),
        ("10000 axes: 4 times the scalar kernel on one core, float64", f"{many[0]:.1f} times", many[0] >= 4),
        ("10000 axes: 4 times the scalar kernel on one core, float32", f"{many[1]:.1f} times", many[1] >= 4),
    ]
    return [f"| {goal} | {measured} | {'met' if met else '**not met**'} |" for goal, measured, met in lines]


def page(machine: Machine, results: Results, counted: Counted, read_in: Mapping[str, float]) -> str:
    """Return the whole page; the same results give the same bytes."""
    return PAGE.format(
        reading=section(read_in),
        machine=machine_text(machine),
        rows="\n".join(rows(results)),
        goals="\n".join(goals(results)),
        like=results[PEER].ns / results["test_pmfid_rls_run[float64]"].ns,
        processors=machine["processors"],
        many="\n".join(many_rows(results)),
        **many_figures(results),
        **linear_figures(results),
        instructions="\n".join(instruction_rows(counted)),
        steps=STEPS,
    )


def kept(machine: Machine, results: Results, counted: Counted, read_in: Mapping[str, float]) -> str:
    """Return the figures under their permanent names with their machine, but without the host's name."""
    figures = {
        name: {key: value for key, value in vars(one).items() if key != "output_error" or value is not None}
        for name, one in results.items()
    }
    content = {
        "machine": machine_text(machine),
        "benchmarks": figures,
        "instructions": counted,
        "reading": read_in,
    }
    return json.dumps(content, indent=1, sort_keys=True) + "\n"


def main(arguments: list[str]) -> None:
    """Read the first three paths; write the fourth and a JSON file of the same name."""
    if len(arguments) != 4:
        usage = "python -m benchmarks.table RESULTS.json INSTRUCTIONS.json READING.json PAGE.md"
        sys.exit(f"four paths are needed, got {len(arguments)}: {usage}")
    source, *others, target = (Path(argument) for argument in arguments)
    machine, results = read(source)
    counted, read_in = (json.loads(path.read_text(encoding="utf-8")) for path in others)
    try:
        target.write_text(page(machine, results, counted, read_in), encoding="utf-8", newline="\n")
        figures = kept(machine, results, counted, read_in)
        target.with_suffix(".json").write_text(figures, encoding="utf-8", newline="\n")
    except OSError as error:
        sys.exit(f"cannot write {target}: {error.strerror}; name a file in a folder that exists")


if __name__ == "__main__":
    main(sys.argv[1:])
