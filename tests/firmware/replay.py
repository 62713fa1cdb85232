"""Compare Python and the exported C bit by bit on one record."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.redge import REdge
from pmfid.export.firmware import export_firmware
from pmfid.kernel.saved import configuration, shape_of, tight_edge_state, tight_state
from tests.firmware.build import HERE, Target, compiled, run

PREFIX = "axis"


def exported(
    estimator: RecursiveEstimator,
    folder: Path,
    u: NDArray[np.float64],
    counts: NDArray[np.int64],
    gaps: Sequence[int] = (),
    steps: NDArray[np.float64] | None = None,
) -> Path:
    """Export an estimator with a file of samples, in.bin, and the output that Python gives for them, expected.bin.

    `gaps` are the numbers of the samples that follow a gap; replay.c is then compiled with -DGAPS of the same numbers.
    `steps` (n,) are the sample periods of an estimator whose sample period varies [s].
    """
    export_firmware(estimator, folder, prefix=PREFIX)
    real = np.float32 if estimator.precision == "float32" else np.float64
    first: list[Any] = [] if steps is None else [("step", real)]
    samples = np.zeros(u.size, np.dtype([*first, ("u", real), ("count", np.uint32)], align=True))
    samples["u"], samples["count"] = u, counts.astype(np.uint32)
    if steps is not None:
        samples["step"] = steps
    (folder / "in.bin").write_bytes(samples.tobytes())
    (folder / "expected.bin").write_bytes(expected(estimator, u, counts, gaps, steps))
    return folder


def expected(
    estimator: RecursiveEstimator,
    u: NDArray[np.float64],
    counts: NDArray[np.int64],
    gaps: Sequence[int] = (),
    steps: NDArray[np.float64] | None = None,
) -> bytes:
    """Return the bytes that replay.c must write: status and estimate after each sample, then the state."""
    kernel = estimator.make_kernel(estimator.forgetting)
    parts = []
    for first, last in pairwise((0, *gaps, u.size)):
        if first > 0:
            kernel.gap(int(counts[first]))
        parts.append(kernel.run(u[first:last], counts[first:last], None if steps is None else steps[first:last]))
    theta, factor, inflation, innovation, variance, status = map(np.concatenate, zip(*parts, strict=True))
    real = np.dtype(kernel.dtype)
    shape = shape_of(configuration(kernel, estimator.precision))
    columns = (shape.max_parameters,)
    fields: list[Any] = [("status", np.uint32), ("theta", real, columns), ("factor", real, columns)]
    fields += [("inflation", real, columns), ("innovation", real), ("variance", real)]
    rows = np.zeros(u.size, np.dtype(fields, align=True))
    p = theta.shape[1]
    rows["theta"][:, :p], rows["factor"][:, :p], rows["inflation"][:, :p] = theta, factor, inflation
    rows["status"], rows["innovation"], rows["variance"] = status, innovation, variance
    return rows.tobytes() + tight_state(kernel, estimator.precision, shape).tobytes()


def exported_edges(estimator: REdge, folder: Path, record: tuple[NDArray[Any], NDArray[Any], NDArray[Any]]) -> Path:
    """Export a recursion over edges with in.bin and expected.bin of a record of input, counts and ages (n,)."""
    export_firmware(estimator, folder, prefix=PREFIX)
    real = np.dtype(np.float32 if estimator.precision == "float32" else np.float64)
    samples = np.zeros(record[0].size, np.dtype([("age", real), ("u", real), ("count", np.uint32)], align=True))
    with np.errstate(over="ignore"):
        samples["u"], samples["age"] = record[0], record[2]
    samples["count"] = record[1].astype(np.uint32)
    (folder / "in.bin").write_bytes(samples.tobytes())
    estimator.reset()
    theta, variance, innovation, _, status = estimator.kernel.run(
        samples["u"].astype(np.float64), record[1], samples["age"].astype(np.float64)
    )
    p, last = theta.shape[1], tight_edge_state(estimator.kernel, estimator.precision)
    fields: list[Any] = [("status", np.uint32), ("theta", real, p), ("variance", real, p), ("innovation", real)]
    rows = np.zeros(status.size, np.dtype(fields, align=True))
    rows["status"], rows["theta"], rows["variance"], rows["innovation"] = status, theta, variance, innovation
    (folder / "expected.bin").write_bytes(rows.tobytes() + last.tobytes())
    estimator.reset()
    return folder


def difference(folder: Path, target: Target, optimize: str, *options: str) -> int | None:
    """Return the position of the first byte that differs between the exported C and Python, or None."""
    program = compiled(folder, PREFIX, target, HERE / "replay.c", optimize, *options)
    out = folder / f"{program.name}.bin"
    done = run(program, target, "in.bin", out.name)
    if done.returncode != 0:
        raise RuntimeError(f"exit code {done.returncode}: {done.stdout}{done.stderr}")
    one = np.frombuffer((folder / "expected.bin").read_bytes(), np.uint8)
    other = np.frombuffer(out.read_bytes(), np.uint8)
    out.unlink()
    if one.size != other.size:
        return min(one.size, other.size)
    apart = np.flatnonzero(one != other)
    return int(apart[0]) if apart.size else None
