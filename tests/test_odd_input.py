"""Numbers of odd sizes and kinds, and files that have changed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import pmfid
from pmfid.estimators.configuration import check_arrays
from pmfid.linear.experiment import Experiment, _count_columns
from pmfid.monitor.calibration import Calibration
from pmfid.pipeline.monitored import setup as calibrations
from tests.conftest import cart_run
from tests.refusals import refused


def rls() -> pmfid.RLS:
    return pmfid.RLS(pmfid.Drive(2.0), pmfid.Encoder(1e-4), 0.01, 30.0, forgetting=0.99)


def test_an_array_across_the_alignment_is_copied_before_the_kernel_loads_it() -> None:
    u = np.frombuffer(bytes(81), np.uint8)[1:].view(np.float64)
    assert not u.flags.aligned
    assert all(array.flags.aligned for array in check_arrays(u, u.view(np.int64)))


@pytest.mark.parametrize("turns", [2**63, 2**64, -(2**70)])
def test_a_count_of_any_size_is_taken_modulo_the_counter(turns: int) -> None:
    run = cart_run(1, samples=300)
    near, far = rls(), rls()
    for u, count in zip(run.u, run.counts.tolist(), strict=True):
        near.step(u, count)
        far.step(u, count + turns)
    assert near.get_state()[100:] == far.get_state()[100:]
    assert np.array_equal(near.estimate.theta, far.estimate.theta)


@pytest.mark.parametrize("counts", [[0, 1e30], [0, 2**70], [0.0, -9.3e18]])
def test_counts_beyond_64_bits_are_refused_in_one_sentence(counts: list[float]) -> None:
    refused(
        (r"beyond the range of 64 bits: give them modulo 2\^bits", lambda: rls().run(np.zeros(2), counts)),
        ("beyond the range of 64 bits", lambda: pmfid.Fleet(rls(), 1).run(np.zeros(2), [counts])),
    )


def test_what_is_masked_is_missing() -> None:
    y = np.ma.array(np.arange(30.0), mask=np.arange(30) == 7)
    experiment = Experiment(u=np.ones(30), y=y, dt=0.1)
    assert np.flatnonzero(np.isnan(experiment.y)).tolist() == [7]


def test_a_reference_beyond_the_squares_of_the_number_format() -> None:
    """The unit of the reference does not matter, and causes no warning."""
    rng = np.random.default_rng(2)
    r = rng.standard_normal(400)
    u, y = 0.7 * r + 0.1 * rng.standard_normal(400), np.cumsum(r)
    plain, huge = (Experiment(u=u, y=y, dt=0.1, reference=scale * r).explained_input for scale in (1.0, 1e200))
    np.testing.assert_allclose(huge, plain, rtol=1e-6, atol=1e-9)
    assert _count_columns(np.column_stack([r, u, y]), 1e200 * r) == _count_columns(np.column_stack([r, u, y]), r)


@pytest.mark.parametrize("cutoff", [1e-320, 5e-324, 1e-310])
def test_a_cutoff_below_the_number_format_is_refused(cutoff: float) -> None:
    refused((r"too low for dt = 0\.01 s", lambda: pmfid.RLS(pmfid.Drive(2.0), pmfid.Encoder(1e-4), 0.01, cutoff)))


def test_a_damaged_calibration_is_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The file may also be valid JSON with other numbers or another kind."""
    made: list[int] = []
    tail = calibrations.Tail(1.0, 2.0, 3.0, 4.0, (1.0, 2.0), ((1.0, 2.0, 3.0),))
    scale = calibrations.Scale(*(np.ones(3) for _ in SCALE))
    plain = Calibration(np.ones(3), scale, tail, np.ones(2), 1.0, 1.0, None)
    monkeypatch.setattr(calibrations, "calibrate", lambda *_, **__: made.append(1) or plain)
    monkeypatch.setenv("PMFID_CACHE", str(tmp_path))

    def get() -> bool:
        return calibrations.cached_calibration(rls(), np.ones(3), np.ones(9), None, 1.0)[2]

    assert not get()
    assert get()
    (path,) = tmp_path.iterdir()
    text = path.read_text()
    head, _, body = text.partition("\n")
    other = json.dumps(json.loads(body) | {"hours": 7.0})
    for damaged in (
        text[:-5],
        "",
        "[]",
        f"{head}\n{other}",
        f"{head}\n[1, 2]",
        "\0" * 50,
        body,
        head + "\n" + 10**5 * "[",
    ):
        path.write_text(damaged)
        assert not get(), damaged[:40]
        assert get()
    assert len(made) == 9


SCALE = calibrations.Scale.__dataclass_fields__
