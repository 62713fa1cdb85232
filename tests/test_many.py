"""Many axes at once: each has the bits of a separate run, whatever happens to its neighbours."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pmfid
from pmfid import Status, _kernel64
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.registry import RECURSIVE
from pmfid.kernel.saved import fleet_layout
from tests.conftest import cart_run
from tests.patience import PATIENCE
from tests.refusals import refused
from tests.test_architecture import C_FLAGS, COMPILER, CSRC

DT, CUTOFF, AXES, SAMPLES = 0.01, 50.0, 21, 700
PRECISIONS = ("float64", "float32")
ENCODER = pmfid.Encoder(22.75e-6 * 4, max_speed=3.0)
DRIVE = pmfid.Drive(2.0)
ARRAYS = ("theta", "variance_factor", "inflation", "innovation", "innovation_variance", "status")
WAYS = range(_kernel64.ManyKernel.fastest_way + 1)
START = {"mass": 1.0, "viscous_friction": 12.0, "coulomb_friction": 0.7}
VARIANTS: list[tuple[type[RecursiveEstimator], dict[str, Any]]] = [
    *((cls, {}) for cls in RECURSIVE),
    (pmfid.BCRLS, {"forgetting": 1.0}),
    (pmfid.RLS, {"prefilter_zeros": (-5.0, -0.2)}),
    (pmfid.BCRLS, {"model": pmfid.Drive(2.0, offset=True)}),
    (pmfid.RIV, {"model": pmfid.Drive(2.0, friction="directional")}),
    (pmfid.RIV, {"model": pmfid.Drive(2.0, spring=True)}),
    (pmfid.RIV, {"initial": START}),
]
PROCESS = pmfid.TransferFunction(2, 1, delay=2, offset=True)
PROCESSES: list[tuple[type[RecursiveEstimator], dict[str, Any]]] = [
    *((cls, {}) for cls in (pmfid.RLS, pmfid.BCRLS)),
    (pmfid.RLS, {"model": pmfid.TransferFunction(2, 0, initial_conditions=True)}),
]


@cache
def fleet_record() -> tuple[np.ndarray, np.ndarray]:
    """Return u and counts (axes, n) of independent motions. Most axes have a fault, each at another time."""
    rng = np.random.default_rng(5)
    run = cart_run(3, increments=1024, samples=4 * SAMPLES)
    starts = rng.integers(0, 3 * SAMPLES, AXES)
    u = np.stack([run.u[k : k + SAMPLES] for k in starts])
    counts = np.stack([run.counts[k : k + SAMPLES] for k in starts])
    for axis, at in enumerate(rng.integers(100, SAMPLES - 150, AXES)):
        event = axis % 7
        if event == 1:
            u[axis, at : at + 3] = (np.nan, np.inf, -np.inf)
        elif event == 2:
            counts[axis, at:] += 5_000_000  # a jump
        elif event == 3:
            u[axis, at : at + 100], counts[axis, at : at + 100] = 0.0, counts[axis, at]  # held by its stiction
            counts[axis, at + 100 :] += counts[axis, at] - counts[axis, at + 100]
        elif event == 4:
            u[axis, at], u[axis, at + 40] = (
                1e200,
                1e30,
            )  # impossible inputs of a drive: refused, the second one only in float32
        elif event == 5:
            u[axis, at:] *= -1.0  # the model no longer follows
        elif event == 6:
            u[axis], counts[axis] = 0.0, 0  # an axis at rest
    return u, counts


@cache
def process_record() -> tuple[np.ndarray, np.ndarray]:
    """Return u, counts (axes, n) of two lags, 2 and 0.5 s^-1."""
    rng = np.random.default_rng(6)
    u = rng.choice([-1.0, 1.0], (AXES, 300)).repeat(10, axis=1)
    y, slow, fast = np.zeros(u.shape), np.zeros(AXES), np.zeros(AXES)
    for k in range(u.shape[1]):
        y[:, k] = slow
        slow, fast = slow + 0.05 * (fast - slow), fast + 0.2 * (u[:, k] - fast)
    counts = np.floor(2000 * y + 100 + rng.standard_normal(y.shape)).astype(int)
    u[3, 900], u[4, 901], counts[5, 1000:] = np.nan, 1e30, counts[5, 1000:] + 5_000_000
    u[6], counts[6] = 0.0, 0
    return u, counts


def make(cls: type[RecursiveEstimator], precision: str = "float64", **options: Any) -> RecursiveEstimator:
    settings = {"model": DRIVE, "encoder": ENCODER, "dt": DT, "cutoff": CUTOFF, "forgetting": 0.98}
    return cls(**(settings | options), precision=precision)


def fleet_of(estimator: RecursiveEstimator, axes: int, way: int, workers: int = 1) -> pmfid.Fleet:
    fleet = pmfid.Fleet(estimator, axes, workers=workers)
    assert fleet._way == _kernel64.ManyKernel.fastest_way
    fleet._way = way
    return fleet


def assert_equal_tracks(fleet: pmfid.Track, single: pmfid.Track) -> None:
    for name in ARRAYS:
        assert np.array_equal(getattr(fleet, name), getattr(single, name)), name


@dataclass(frozen=True)
class Alone:
    """The output of an axis in a separate run."""

    track: pmfid.Track
    state: bytes


@lru_cache(maxsize=1)
def each_alone(kind: str, number: int, precision: str) -> tuple[Alone, ...]:
    """Return the separate run of every axis, for one of VARIANTS or PROCESSES. The cached result serves all ways of the
    kernel, which are tested in series."""
    found = []
    for inputs, counts in zip(*RECORDS[kind](), strict=True):
        estimator = one_of(kind, number, precision)
        found.append(Alone(estimator.run(inputs, counts), estimator.get_state()))
    return tuple(found)


RECORDS = {"drive": fleet_record, "process": process_record}


def one_of(kind: str, number: int, precision: str) -> RecursiveEstimator:
    if kind == "drive":
        cls, options = VARIANTS[number]
        return make(cls, precision, **options)
    cls, options = PROCESSES[number]
    return make(cls, precision, **({"model": PROCESS, "forgetting": 0.999, "cutoff": 10.0} | options))


def in_ways(cases: list[tuple[type[RecursiveEstimator], dict[str, Any]]]) -> list[Any]:
    """Return number, precision and way of the cases. `make test` has the methods in both precisions and their options
    in one by turns. Each case has the widest way and, by turns, one of the others."""
    return [
        pytest.param(
            k,
            precision,
            way,
            id=f"{cls.__name__}-{options}-{precision}-{way}",
            marks=[pytest.mark.long] if (options and precision != turn) or way not in (WAYS[-1], others) else [],
        )
        for k, (cls, options) in enumerate(cases)
        for turn, others in [(PRECISIONS[k % 2], WAYS[k % max(len(WAYS) - 1, 1)])]
        for precision in PRECISIONS
        for way in WAYS
    ]


def side_by_side_as_alone(kind: str, number: int, precision: str, way: int) -> tuple[Alone, ...]:
    alone = each_alone(kind, number, precision)
    fleet = fleet_of(one_of(kind, number, precision), AXES, way)
    tracks = fleet.run(*RECORDS[kind](), every=1)
    for axis in range(AXES):
        assert_equal_tracks(tracks.axis(axis), alone[axis].track)
        assert fleet.axis(axis).get_state() == alone[axis].state
    return alone


@pytest.mark.parametrize(("number", "precision", "way"), in_ways(VARIANTS))
def test_every_axis_has_the_bits_that_it_has_alone(number, precision, way):
    occurred = Status(0)
    for axis in side_by_side_as_alone("drive", number, precision, way):
        occurred |= Status(int(np.bitwise_or.reduce(axis.track.status)))
    expected = Status.INVALID_INPUT | Status.COUNT_JUMP | Status.STANDSTILL | Status.POOR_EXCITATION
    assert expected in occurred, "the record does not test what it is for"


@pytest.mark.parametrize(("number", "precision", "way"), in_ways(PROCESSES))
def test_every_linear_process_has_the_bits_that_it_has_alone(number, precision, way):
    alone = side_by_side_as_alone("process", number, precision, way)
    followed = [not Status(int(axis.track.status[-1])) & (Status.FALLBACK | Status.STARTING) for axis in alone]
    assert sum(followed) > AXES // 2, "the record does not test what it is for"


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_hostile_input(precision, way):
    rng = np.random.default_rng(9)
    u = rng.choice([0.0, 3.0, -3.0, np.nan, np.inf, 1e30, -1e30, 1e-40], (17, 2000))
    counts = rng.integers(-(2**31), 2**31, (17, 2000))
    counts[5:] = rng.integers(-3, 4, (12, 2000)).cumsum(axis=1)
    tracks = fleet_of(make(pmfid.RIV, precision, encoder=pmfid.Encoder(1e-5)), 17, way).run(u, counts, every=1)
    for axis in range(17):
        alone = make(pmfid.RIV, precision, encoder=pmfid.Encoder(1e-5)).run(u[axis], counts[axis])
        assert_equal_tracks(tracks.axis(axis), alone)
    assert np.all(np.isfinite(tracks.theta))


@pytest.mark.parametrize("bits", [8, 16, 31, 32])
@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_counters_wrap(bits, precision):
    u, counts = fleet_record()
    encoder = pmfid.Encoder(ENCODER.resolution, bits=bits)
    wrapped = (counts + 2 ** (bits - 1) - 300) % 2**bits
    tracks = pmfid.Fleet(make(pmfid.RIV, precision, encoder=encoder), AXES).run(u, wrapped, every=1)
    for axis in range(0, AXES, 4):
        alone = make(pmfid.RIV, precision, encoder=encoder).run(u[axis], wrapped[axis])
        assert_equal_tracks(tracks.axis(axis), alone)


@pytest.mark.parametrize("cuts", [[300], [1, 2, 5, 40, 41, 650]])
def test_a_split_run_is_the_whole_run(cuts):
    u, counts = fleet_record()
    fleet = pmfid.Fleet(make(pmfid.RIV), AXES)
    for part in np.split(np.arange(SAMPLES), cuts):
        last = fleet.run(u[:, part], counts[:, part])
    assert_equal_tracks(last, pmfid.Fleet(make(pmfid.RIV), AXES).run(u, counts))


def test_the_kernel_writes_only_where_there_is_room():
    axes, samples, p = 3, 10, 3
    single = make(pmfid.BCRLS).kernel
    kernel = single.many(axes, fleet_layout(single, "float64"))
    u, counts = np.zeros((axes, samples)), np.zeros((axes, samples), np.int64)

    def results(rows: int = axes, kept: int = 4, parameters: int = p) -> list[np.ndarray]:
        wide = [np.zeros((rows, kept, parameters)) for _ in range(3)]
        return [*wide, np.zeros((rows, kept)), np.zeros((rows, kept)), np.zeros((rows, kept), np.uint32)]

    kernel.run(u, counts, 0, axes, 3, results(), 0)  # samples 2, 5, 8 and the last
    short = [*results()[:5], np.zeros((axes, 3), np.uint32)]
    unshaped = (results(kept=3), results(kept=5), results(rows=2), results(parameters=2), short)
    single, split = results(), results()
    single[1], split[4] = single[1].astype(np.float32), np.zeros((2 * axes, 4))[::2]
    inputs, spans = ((u[:2], counts[:2]), (u[:, :9], counts)), ((-1, 2), (0, 4), (2, 1))
    refused(
        *(("must have shapes", partial(kernel.run, u, counts, 0, axes, 3, wrong, 0)) for wrong in unshaped),
        *(("of float64", partial(kernel.run, u, counts, 0, axes, 3, wrong, 0)) for wrong in (single, split)),
        *((r"must be \(3, n\)", partial(kernel.run, *pair, 0, axes, 3, results(), 0)) for pair in inputs),
        ("float32 or float64", partial(kernel.run, u.astype(np.float16), counts, 0, axes, 3, results(), 0)),
        *(("there are 3 axes", partial(kernel.run, u, counts, *span, 3, results(), 0)) for span in spans),
        kind=ValueError,
    )


@pytest.mark.skipif(COMPILER is None, reason="there is no C compiler cc on this machine")
@pytest.mark.parametrize("precision", ["-UPMF_FLOAT32", "-DPMF_FLOAT32"], ids=["float64", "float32"])
@pytest.mark.parametrize("size", [16, 32, 64])
def test_lanes_compile_without_a_warning(size, precision):
    flags = [*C_FLAGS, "-Wno-psabi", precision, f"-DPMF_LANE_BYTES={size}"]  # without options for wide vectors
    source = str(Path(CSRC) / "many" / "pmf_lanes.c")
    run = subprocess.run([str(COMPILER), *flags, source], capture_output=True, text=True, timeout=PATIENCE)
    assert run.returncode == 0, run.stderr


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_a_gap_of_one_axis_is_that_of_a_single_one(precision):
    """The gap has no effect on other axes, and the counter may have wrapped in the gap."""
    u, counts = fleet_record()
    estimator = make(pmfid.RIV, precision)
    fleet = pmfid.Fleet(estimator, AXES)
    fleet.run(u[:, :300], counts[:, :300])
    fleet.gap(2, int(counts[2, 400]) + 2**32)
    tracks = fleet.run(u[:, 400:], counts[:, 400:], every=1)
    for axis in range(AXES):
        single = estimator.start()
        single.run(u[axis, :300], counts[axis, :300])
        if axis == 2:
            single.gap(int(counts[2, 400]))
        assert_equal_tracks(tracks.axis(axis), single.run(u[axis, 400:], counts[axis, 400:]))
    refused(("the axis must be from", lambda: fleet.gap(AXES, 0)))
