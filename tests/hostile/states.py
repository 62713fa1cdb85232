"""Every recursive estimator after a run, and the numbers of a structure, for tests of states."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

import pmfid
from pmfid.estimators.recursive import RecursiveEstimator
from tests.test_many import PROCESS, PROCESSES, VARIANTS, fleet_record, make, process_record

LAGS = {"model": PROCESS, "encoder": pmfid.Encoder(1e-3), "dt": 0.05, "cutoff": 5.0, "forgetting": 0.999}


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
