"""Show with Frama-C that no step of an export accesses memory out of bounds, or overflows an integer.

`python -m docs.proof` writes docs/reference/frama_c.md in some minutes.
"""

from __future__ import annotations

import re
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from pmfid import BCRLS, RIV, Drive, Encoder, REdge, TransferFunction, export_firmware
from pmfid.estimators.recursive import RecursiveEstimator

HERE = Path(__file__).parent
PAGE = HERE / "reference" / "frama_c.md"
PROOF = HERE / "proof.c"
#: Numbers may be infinite and NaN, as they are on the processor.
OPTIONS = ("-c11", "-warn-special-float", "none", "-eva", "-eva-no-print")
DT, CUTOFF, ENCODER = 0.01, 30.0, Encoder(2e-4, bits=16, max_speed=5.0)


def drive(cls: type[RecursiveEstimator], **options: str) -> RecursiveEstimator:
    return cls(Drive(2.0), ENCODER, DT, CUTOFF, forgetting=0.995, precision="float32", **options)


def estimators() -> Mapping[str, RecursiveEstimator | REdge]:
    """Return estimators whose exports are analysed, in float32."""
    process = TransferFunction(2, 1, delay=2, offset=True)
    return {
        "`bcrls`": drive(BCRLS),
        "`riv`": drive(RIV),
        "`riv`, varying step": drive(RIV, steps="given"),
        "`bcrls`, linear process": BCRLS(
            process, Encoder(1e-3, bits=16), DT, 10.0, forgetting=0.999, precision="float32"
        ),
        "`REdge`": REdge(Drive(2.0), ENCODER, DT, lines=16, tick=1e-6, memory=8.0, precision="float32"),
    }


@dataclass(frozen=True)
class Proof:
    """The result of Frama-C: numbers of analysed functions and statements, and alarms with their place."""

    functions: int
    statements: int
    alarms: tuple[str, ...]


def analyse(folder: Path, function: str) -> str:
    """Return what Frama-C writes about a function of proof.c and an export with the prefix "axis"."""
    files = [folder / "axis_config.c", *sorted(folder.glob("pmf*.c"))]
    precision = "4" if (folder / "pmf_redge.c").exists() else "2"  # more takes longer, and edges need it
    options = [*OPTIONS, "-eva-precision", precision, f"-cpp-extra-args=-I{folder}", "-main", function]
    words = ["frama-c", *options, str(PROOF), *map(str, files)]
    return subprocess.run(words, capture_output=True, text=True, check=True, timeout=1800).stdout


def prove(folder: Path) -> Proof:
    """Analyse a step of an export, and the refusal of states that the step does not accept."""
    refusals, step = analyse(folder, "prove_refusals"), analyse(folder, "prove_step")
    (functions,), (statements,) = (
        re.findall(rf"(\d+) {what}", step) for what in ("functions analyzed", "statements reached")
    )
    alarms = re.findall(r"\[eva:alarm\] (.*): Warning: \s*([^\n]*)", refusals + step)
    return Proof(
        int(functions), int(statements), tuple(f"`{Path(place).name}`: {message}" for place, message in alarms)
    )


TEXT = """# No access out of bounds, no overflow

Written by `python -m docs.proof` with Frama-C {version}, plug-in Eva.

`docs/proof.c` calls one step. Every byte of the state is unknown, and so are input, count, step and age, which may
also be infinite or NaN. Only some numbers of the state have bounds, because they are indices. For each of them,
Frama-C shows that `pmf_plausible()`, and so `pmf_load()`, refuses every number beyond its bound. Frama-C then follows
the step, with encoder and guard, through all functions below. These are alarms: an access out of bounds, a value that
was never set, and an overflow of a signed integer. Alarms are also a shift or a conversion beyond the type, and a
division of integers by zero.

{table}

{remark}

Integers without a sign count modulo 2^32 on purpose, and their overflow is no alarm. Frama-C analyses each export in
float32 with its own configuration. The kernel needs no annotation, and the assertion is in `docs/proof.c`.
"""
REMARK = """The remaining alarms are conversions of a number that Frama-C takes for NaN:

{alarms}

In each case a comparison has excluded NaN before, for example `x > 0 ? x : 0`. Frama-C draws this conclusion only from
`x != x`."""


def main() -> None:
    version = subprocess.run(["frama-c", "-version"], capture_output=True, text=True, check=True).stdout.strip()
    rows, alarms = ["| export | functions | statements | alarms |", "|---|---|---|---|"], []
    for name, estimator in estimators().items():
        with tempfile.TemporaryDirectory() as folder:
            export_firmware(estimator, folder)
            proof = prove(Path(folder))
        rows.append(f"| {name} | {proof.functions} | {proof.statements} | {len(proof.alarms)} |")
        alarms += [f"- {name}, {alarm}" for alarm in proof.alarms]
        print(rows[-1], *proof.alarms, flush=True)
    remark = REMARK.format(alarms="\n".join(alarms)) if alarms else "No alarm remains."
    PAGE.write_text(TEXT.format(version=version, table="\n".join(rows), remark=remark), encoding="utf-8")


if __name__ == "__main__":
    main()
