"""Records of a drive with gaps: missing samples, parts that are left out, several records in one estimate."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pmfid import Drive, Encoder, identify
from pmfid.config.axis import Axis
from pmfid.estimators.iv import RIV
from pmfid.pipeline.identify import kind_of
from pmfid.simulation import DriveParameters, multisine, prbs, quantize, simulate_drive
from pmfid.status import Status
from pmfid.types import Counts, Flags, Floats
from tests.conftest import long_unless

DT, STEP, CUTOFF = 0.004, 2e-5, 20.0
STAGE = DriveParameters(6.3, 9.0, 2.6, 3.34)
TRUTH = np.array([STAGE.mass, STAGE.viscous_friction, STAGE.coulomb_friction])
SETTINGS = {"model": Drive(STAGE.input_gain), "dt": DT, "encoder": Encoder(STEP), "cutoff": CUTOFF}


def run(samples: int = 5000, seed: int = 0) -> tuple[Floats, Counts]:
    rng = np.random.default_rng(seed)
    u = prbs(samples, clock=25, amplitude=4.0, rng=rng)
    return u, quantize(simulate_drive(STAGE, u, DT).x, STEP, STEP * rng.random())


def kept(samples: int, part: float, burst: int = 1, seed: int = 1) -> Flags:
    rng, there = np.random.default_rng(seed), np.ones(samples, bool)
    for first in rng.integers(50, samples - 100, round(part * samples / burst)):
        there[first : first + burst] = False
    return there


def lacking(there: Flags, u: Floats, counts: Counts) -> tuple[Floats, Floats]:
    return np.where(there, u, np.nan), np.where(there, counts, np.nan)


def write(path: Path, there: Flags, stamps: Floats, **columns: np.ndarray) -> Path:
    names = ["t", *columns]
    rows = np.column_stack([stamps, *columns.values()])[there]
    path.write_text(",".join(names) + "\n" + "\n".join(",".join(f"{x:.9g}" for x in row) for row in rows) + "\n")
    return path


def axis(method: str = "iv", **record: object) -> Axis:
    return Axis.model_validate(
        {
            "record": {"input": "u", "output": "n", "output_kind": "counts", "time": "t"} | record,
            "encoder": {"resolution": STEP},
            "model": {"kind": "drive", "input_gain": STAGE.input_gain},
            "estimator": {"method": method, "cutoff": CUTOFF},
        }
    )


def test_missing_lines_and_empty_cells_are_the_same_and_scattered_stamps_are_resampled(tmp_path: Path) -> None:
    u, counts = run(2000)
    t, there, whole = np.arange(2000) * DT, kept(2000, 0.1), np.ones(2000, bool)
    gone = write(tmp_path / "gone.csv", there, t, u=u, n=counts)
    empty = write(tmp_path / "empty.csv", whole, t, u=np.where(there, u, np.nan), n=counts)
    scattered = np.cumsum(np.random.default_rng(4).uniform(0.3, 2.5, 2000)) * DT
    paths = (gone, empty, write(tmp_path / "scattered.csv", whole, scattered, u=u, n=counts))
    first, second, third = (kind_of(axis()).read([path], axis()) for path in paths)
    np.testing.assert_array_equal(first.there, there)
    for name in ("u", "counts", "there"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    assert third.jitter > 0.3


@pytest.mark.parametrize("method", ["ls", "bcls", "iv", "rls", "riv"])
@pytest.mark.parametrize(("part", "burst"), [(0.003, 1), pytest.param(0.1, 50, marks=pytest.mark.long)])
def test_methods_with_filters_restart_after_each_gap(method: str, part: float, burst: int) -> None:
    u, counts = run(3000)
    found = identify(*lacking(kept(u.size, part, burst), u, counts), method=method, **SETTINGS)
    assert np.all(np.abs(found.theta - TRUTH) < np.maximum(4 * found.theta_std, 0.03 * TRUTH))
    assert not {"invalid_input", "count_jump"} & set(found.status)
    assert any("restart after each of" in note for note in found.notes)
    assert any("samples are missing" in note for note in found.notes)


@pytest.mark.parametrize(
    "method",
    long_unless(
        lambda method: method in ("bcls", "fit", "riv"),
        ["ls", "bcls", "fit", "auto", "rls", "bcrls", "riv"],
    ),
)
def test_every_method_takes_long_gaps(method: str) -> None:
    u, counts = run(3000)
    found = identify(*lacking(kept(u.size, 0.03, 50), u, counts), method=method, **SETTINGS)
    np.testing.assert_allclose(found.theta, TRUTH, rtol=0.03)
    assert not {"unmodelled", "invalid_input", "count_jump"} & set(found.status)


# --- on-line ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_a_gap_leaves_what_was_gathered(precision: str) -> None:
    u, counts = run(4000)
    riv = RIV(**SETTINGS, precision=precision)
    before = riv.run(u[:3000], counts[:3000])
    riv.gap(int(counts[3400]))
    after = riv.run(u[3400:], counts[3400:])
    assert np.max(np.abs(after.theta / before.theta[-1] - 1)) < 0.02
    assert not np.any(after.has_status(Status.FALLBACK | Status.STARTING))


# --- rows and places --------------------------------------------------------------------------------------------------


def test_parts_and_masked_rows_are_left_out(tmp_path: Path) -> None:
    u, counts = run(2000)
    t, bad = np.arange(2000) * DT, np.zeros(2000)
    bad[100:110] = 1
    path = write(tmp_path / "run.csv", np.ones(2000, bool), t, u=u, n=counts, bad=bad)
    record = kind_of(axis()).read([path], axis(mask="bad", exclude=((2.0, 2.02),)))
    lost = np.flatnonzero(~record.there)
    assert lost.tolist() == [*range(100, 110), *range(500, 506)]
    assert any("mask 'bad'" in note for note in record.notes)


@pytest.mark.parametrize("kind", ["prbs", "multisine"])
def test_an_input_that_is_lost_is_unknown_to_the_fit(kind: str) -> None:
    """An interpolated input is wrong by half a step where the input switches, and moves the axis by many counts."""
    errors = []
    for seed in range(2):
        rng, dt, step = np.random.default_rng(seed), 0.01, 1e-3
        frequencies = np.array([0.3, 0.7, 1.7, 3.1])
        u = (
            prbs(1000, clock=10, amplitude=4.0, rng=rng)
            if kind == "prbs"
            else multisine(1000, dt, frequencies, 4.0, rng)
        )
        counts = quantize(simulate_drive(DriveParameters(1.07, 12.8, 0.8, 2.0), u, dt).x, step)
        u[rng.integers(1, 999, 10)] = np.nan
        result = identify(u, counts, model=Drive(2.0), dt=dt, encoder=Encoder(step))
        assert result.status == ()
        errors.append((result.theta - [1.07, 12.8, 0.8]) / result.theta_std)
    assert np.sqrt(np.mean(np.square(errors))) < 1.7
