"""A state with a right checksum is refused if no sample could have made the state.

A refused state changes nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import product

import numpy as np
import pytest

import pmfid
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.kernel.saved import _checksum, configuration, shape_of
from pmfid.kernel.structures import structures
from tests.conftest import long_unless
from tests.hostile.states import estimators, leaves
from tests.refusals import refused
from tests.test_many import AXES, fleet_record, make

PRECISIONS = ("float32", "float64")
#: Whole numbers without a limit: registers, sums modulo 2^32, and counters that saturate.
FREE = {"encoder.count", "encoder.change", "encoder.travel", "encoder.first", "guard.count", "guard.zero",
        "updates", "samples", "auxiliary.turn"}  # fmt: skip
CASES = {name: (cls, options) for name, cls, options in [
    ("bcrls", pmfid.BCRLS, {}),
    ("rls", pmfid.RLS, {}),
    ("riv", pmfid.RIV, {"model": pmfid.Drive(2.0, offset=True)}),
]}  # fmt: skip


def used(name: str, precision: str) -> RecursiveEstimator:
    """Return an estimator with the state of a run."""
    cls, options = CASES[name]
    estimator = make(cls, precision, **options)
    u, counts = fleet_record()
    estimator.run(u[0], counts[0])
    return estimator


def forged(estimator: RecursiveEstimator, field: str, value: float, element: int = 0) -> bytes:
    """Return the state with one number changed, and with the right checksum."""
    types = structures(shape_of(configuration(estimator.kernel, estimator.precision)), estimator.precision)
    data = bytearray(estimator.get_state())
    start = types["pmf_saved_t"].fields["state"][1]  # type: ignore[index]
    places = [(kind, start + at) for name, kind, at in leaves(types["pmf_state_t"]) if name == field]
    kind, place = places[element]
    number = np.array(value, estimator.precision) if kind == "f" else np.array(int(value) % 2**32, "<u4")
    data[place : place + number.nbytes] = number.tobytes()
    checksum = types["pmf_saved_t"].fields["checksum"][1]  # type: ignore[index]
    data[checksum : checksum + 4] = int(_checksum(bytes(data), types)).to_bytes(4, "little")
    return bytes(data)


def fields(estimator: RecursiveEstimator) -> Iterator[tuple[str, str]]:
    types = structures(shape_of(configuration(estimator.kernel, estimator.precision)), estimator.precision)
    yield from dict.fromkeys((name, kind) for name, kind, _ in leaves(types["pmf_state_t"]))


@pytest.mark.parametrize(
    ("name", "precision"),
    long_unless(lambda name, precision: precision == PRECISIONS[[*CASES].index(name) % 2], product(CASES, PRECISIONS)),
)
def test_every_field_has_its_limits(name: str, precision: str) -> None:
    """Each real number is finite, and each whole number is within the limits of the configuration. A new field needs a
    line in csrc/pmf_plausible.c, or here."""
    estimator = used(name, precision)
    before = estimator.get_state()
    for number, (field, kind) in enumerate(fields(estimator)):
        state = forged(estimator, field, (np.nan, np.inf, -np.inf)[number % 3] if kind == "f" else 2**32 - 1)
        if field.rpartition("direct.")[2].rpartition("instrument.")[2] in FREE:
            estimator.set_state(state)
            estimator.set_state(before)
            continue
        refused(("no state of this configuration.*start from an older", partial(estimator.set_state, state)))
        assert estimator.get_state() == before, field


@pytest.mark.parametrize(
    ("name", "field", "value"),
    [
        ("bcrls", "direct.blocks", 101),
        ("bcrls", "settle", 10**6),
        ("riv", "auxiliary.trial", 2**31),
        ("riv", "instrument.mass", 1.5),
        ("rls", "direct.estimate.variance_factor", -1.0),
        ("rls", "direct.sums.cross", -1.0),
        ("bcrls", "direct.sums.square", -1.0),
        ("bcrls", "encoder.velocity", 1e30),
        ("bcrls", "encoder.input", 1e29),
        ("bcrls", "direct.started", 2**20),
    ],
)
def test_a_field_beyond_its_range_is_refused(name: str, field: str, value: float) -> None:
    estimator = used(name, "float32")
    before = estimator.get_state()
    refused(("no state of this configuration", lambda: estimator.set_state(forged(estimator, field, value))))
    assert estimator.get_state() == before


def test_a_fleet_has_a_checksum_and_the_same_limits() -> None:
    u, counts = fleet_record()
    fleet = pmfid.Fleet(make(pmfid.BCRLS), AXES)
    fleet.run(u, counts)
    state = fleet.get_state()
    rng = np.random.default_rng(0)
    for place in rng.integers(0, len(state), 300):
        flipped = bytearray(state)
        flipped[place] ^= 1 << rng.integers(8)
        refused(("checksum is wrong", partial(fleet.set_state, bytes(flipped))))
        assert fleet.get_state() == state
    refused(("not the states of this fleet", lambda: fleet.set_state(state[:-1])))


@pytest.mark.parametrize(("name", "estimator"), list(estimators())[::3])
def test_a_state_that_samples_made_is_taken(name: str, estimator: RecursiveEstimator) -> None:
    """A state after any part of a hostile record is accepted."""
    rng = np.random.default_rng(len(name))
    u = rng.choice([0.0, 1.0, -3.0, 1e15, 1e30, np.nan], 400, p=[0.3, 0.3, 0.3, 0.05, 0.03, 0.02])
    counts = np.cumsum(rng.choice([0, 1, -3, 40, 2**31], 400, p=[0.4, 0.3, 0.2, 0.08, 0.02]))
    for part in np.split(np.arange(400), 40):
        estimator.run(u[part], counts[part])
        state = estimator.get_state()
        estimator.set_state(state)
        assert estimator.get_state() == state
