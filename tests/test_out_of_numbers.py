"""Values outside the range of numbers, found by generated calls, give one clear error."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import pmfid
from pmfid.config.axis import load_axis
from pmfid.design import Limits, Problem
from pmfid.estimators.least_squares import parts_of_their_own
from pmfid.estimators.recursive import compute_encoder_floor
from pmfid.records.record import read_experiment, read_record
from tests.refusals import refused

EXAMPLE = Path(__file__).parents[1] / "examples" / "cart.toml"
NOMINAL = {"mass": 1.5, "viscous_friction": 6.0, "coulomb_friction": 0.6}


def problem(**changes: object) -> Problem:
    given = {"resolution": 1e-5, "nominal": NOMINAL} | changes
    return Problem(pmfid.Drive(2.0), unknown=("mass",), horizon=2.0, intervals=20, limits=Limits(input=3.0), **given)


def test_sensitivities_whose_squares_are_beyond_numbers_are_distinguished_and_infinite_ones_are_not() -> None:
    apart, _ = parts_of_their_own(np.array([[1e200, 1.0], [1.0, 1e200]]))
    assert np.allclose(apart, 1.0)
    none, inverse = parts_of_their_own(np.array([[np.inf, 1.0], [1.0, 1.0]]))
    assert not np.any(none)
    assert np.all(np.isfinite(inverse))


def test_a_motion_too_small_for_numbers_is_shown_all_the_same() -> None:
    estimator = pmfid.BCRLS(pmfid.Drive(2.0), pmfid.Encoder(1e-29), 1e6, 1e-9, forgetting=0.99)
    assert 0 < compute_encoder_floor(estimator) < 1e37


def test_sizes_that_no_machine_has_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("t,u,counts,y\n" + "".join(f"{k / 100},{k % 7 + 10},{k},{k + 10}\n" for k in range(50)))
    process = {"record.output_kind": "counts", "encoder.resolution": 1.7e308}
    second = EXAMPLE.with_name("second_order.toml")
    unit = r"check the unit|SI units"
    refused(
        ("input_scale", lambda: read_record(path, load_axis(EXAMPLE, {"record.input_scale": 1e308}))),
        ("resolution", lambda: read_experiment(path, load_axis(second, process))),
        (unit, lambda: problem(resolution=1e-200)),
        (unit, lambda: problem(resolution=None, noise_variance=1e200)),
        (unit, lambda: problem(nominal=NOMINAL | {"mass": 1e-200})),
        (unit, lambda: problem(nominal=NOMINAL | {"viscous_friction": 1e200})),
    )
    assert problem().names == ("mass",)
