"""A damaged state of `REdge` is refused, or its estimates stay finite."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from pmfid import Drive, Encoder, REdge, UsageError
from pmfid.kernel.saved import _write_saved, edge_configuration, tight_edge_structures
from pmfid.simulation import CART, capture_edges, prbs, simulate_drive

SAMPLES, CUT = 400, 340
INPUT = prbs(SAMPLES, clock=10, amplitude=4.0, rng=np.random.default_rng(1))
COUNTS, AGES = capture_edges(simulate_drive(CART, np.repeat(INPUT, 10), 1e-3), 0.0015, every=10, tick=1e-6)
LARGE = {"float64": (1e300, -1e30), "float32": (1e38, -1e30)}


def list_reals(kind: np.dtype, prefix: tuple[object, ...] = ()) -> Iterator[tuple[object, ...]]:
    """Yield the path of each real number in a structure."""
    for name in kind.names or ():
        base, shape = kind[name].subdtype or (kind[name], ())
        for index in np.ndindex(*shape):
            path = (*prefix, name, *((index,) if shape else ()))
            if base.names:
                yield from list_reals(base, path)
            elif base.kind == "f":
                yield path


def make(precision: str) -> REdge:
    return REdge(Drive(CART.input_gain), Encoder(0.0015), 0.01, tick=1e-6, memory=10.0, precision=precision)


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_a_number_out_of_range_is_refused_or_harmless(precision: str) -> None:
    """States with a reference of 1e30 or a negative number of edges once ended in infinite estimates."""
    estimator = make(precision)
    for k in range(CUT):
        estimator.step(INPUT[k], int(COUNTS[k]), float(AGES[k]))
    configuration = edge_configuration(estimator.kernel, precision)
    types = tight_edge_structures(configuration, precision)
    saved = np.frombuffer(estimator.get_state(), types["pmf_saved_t"])
    refused = 0
    for path in list_reals(types["pmf_state_t"]):
        for value in LARGE[precision]:
            damaged = saved.copy()
            place = damaged[0]["state"]
            for key in path[:-1]:
                place = place[key]
            place[path[-1]] = value
            other = make(precision)
            try:
                other.set_state(_write_saved(configuration, damaged[0]["state"], types))
            except UsageError:
                refused += 1
                continue
            with np.errstate(all="ignore"):
                for k in range(CUT, SAMPLES):
                    estimate = other.step(INPUT[k], int(COUNTS[k]), float(AGES[k]))
                    assert np.all(np.isfinite(estimate.theta)), (path, value)
    assert refused > 100
