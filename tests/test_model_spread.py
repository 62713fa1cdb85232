"""The second error bar: the effect of unmodelled forces on the parameters.

No constant was chosen on these machines, motions and encoders.
"""

from __future__ import annotations

import json
from itertools import product

import numpy as np
import pytest

import pmfid
from pmfid.cli.tables import _parameters as terminal_table
from pmfid.fit.compare import NORMAL_95
from pmfid.pipeline.result import UNKNOWN, DriveResult, parameter_header, parameter_rows
from pmfid.simulation import DriveParameters, Machine
from pmfid.types import Floats
from studies.friction_axes import FRICTIONS
from studies.machines import Axis, _control, record_of, truth
from studies.paper.truth import CartRecord
from tests.conftest import long_unless

#: Machines that are not in the study: an indexing table, 0.3 kg m2, and a lift of 120 kg.
TABLE = Axis(DriveParameters(0.3, 1.1, 0.5, 2.0), 0.004, 4000, 2.0, 15, _control(60, 6, 12), 1.2, 0.5, 0.25, 3e-4, 0.05)
LIFT = Axis(
    DriveParameters(120.0, 400.0, 40.0, 10.0),
    0.005,
    4000,
    25.0,
    20,
    _control(3000, 500, 120),
    0.4,
    1.2,
    0.4,
    3e-5,
    0.02,
)


def identified(axis: Axis, record: CartRecord, **settings: object) -> DriveResult:
    encoder, cutoff = pmfid.Encoder(record.resolution), 1 / (3 * axis.dt)
    model = pmfid.Drive(axis.drive.input_gain)
    result = pmfid.identify(
        record.u, record.counts, model=model, encoder=encoder, dt=axis.dt, cutoff=cutoff, **settings
    )
    assert isinstance(result, DriveResult)
    return result


def bars(result: DriveResult) -> tuple[Floats, Floats]:
    assert result.model_spread is not None
    return result.theta_std, result.model_spread


WRONG = [name for name in FRICTIONS if name != "nothing"]
CELLS = {"table": (TABLE, "prbs", 1024), "lift": (LIFT, "stop-and-go", 512), "coarse table": (TABLE, "multisine", 256)}


@pytest.mark.parametrize(
    ("friction", "cell"),
    long_unless(
        lambda friction, cell: list(CELLS).index(cell) == WRONG.index(friction) % len(CELLS), product(WRONG, CELLS)
    ),
)
def test_the_interval_contains_what_the_machine_has(friction: str, cell: str) -> None:
    axis, motion, increments = CELLS[cell]
    result = identified(axis, record_of(axis, FRICTIONS[friction](axis), motion, increments, 11))
    assert result.interval_95 is not None
    low, high = result.interval_95.T
    slack = 1e-3 * truth(axis)  # a tenth of the tolerance
    assert np.all((low <= truth(axis) + slack) & (truth(axis) - slack <= high)), str(result)


def test_a_method_with_an_error_of_its_own_has_it_in_the_interval() -> None:
    """Least squares of coarse counts gives a mass that is too small by far more than its standard deviation."""
    record = record_of(TABLE, Machine(TABLE.drive), "multisine", 512, 11)
    result = identified(TABLE, record, method="ls")
    off = np.abs(result.theta - truth(TABLE))
    assert off[0] > 5 * result.theta_std[0]
    assert np.all(off <= NORMAL_95 * np.hypot(*bars(result)))


# --- output of the interval ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def result() -> DriveResult:
    return identified(TABLE, record_of(TABLE, FRICTIONS["quadratic 20 %"](TABLE), "prbs", 1024, 11), method="iv")


def test_json_has_it_next_to_what_it_had(result: DriveResult) -> None:
    printed = json.loads(json.dumps(result.to_json(), allow_nan=False))["parameters"]["mass"]
    assert list(printed) == ["value", "std", "unit", "model_spread", "interval_95"]
    std, spread = (float(bar[0]) for bar in bars(result))
    half = NORMAL_95 * np.hypot(std, spread)
    assert printed["interval_95"] == pytest.approx([printed["value"] - half, printed["value"] + half])
    assert (printed["std"], printed["model_spread"]) == (std, spread)


def test_tables_and_text_show_it(result: DriveResult) -> None:
    spread = f"{bars(result)[1][0]:.2g}"
    rows = parameter_rows(result)
    assert parameter_header(result) == ("parameter", "value", "std", "model spread", "95 %", "unit")
    assert rows[0][3] == spread
    headings = [str(column.header).replace("\n", " ") for column in terminal_table(result, 120).columns]
    assert headings == list(parameter_header(result))
    assert [str(column.header) for column in terminal_table(result, 60).columns] == [
        "parameter", "value(std)", "95 %", "unit"
    ]  # fmt: skip
    assert f"(model spread {spread})" in str(result)


def test_it_is_not_known_where_nothing_simulates_the_equation() -> None:
    terms = (
        pmfid.Term("output", 2, "mass", "kg"),
        pmfid.Term("output", 1, "viscous", "N s/m"),
        pmfid.Term("forward", 0, "coulomb", "N"),
    )
    equation = pmfid.Equation(terms, (pmfid.Term("input", 0, coefficient=2.0),))
    assert equation.without_simulation
    record = record_of(TABLE, Machine(TABLE.drive), "prbs", 4096, 11)
    encoder = pmfid.Encoder(record.resolution)
    model = pmfid.EquationModel(equation)
    found = pmfid.identify(record.u, record.counts, model=model, encoder=encoder, dt=TABLE.dt, cutoff=80.0, method="ls")
    assert found.model_spread is not None
    assert np.all(np.isnan(found.model_spread))
    printed = json.loads(json.dumps(found.to_json(), allow_nan=False))["parameters"]["mass"]
    assert (printed["model_spread"], printed["interval_95"]) == (None, None)
    assert parameter_rows(found)[0][3:5] == [UNKNOWN, UNKNOWN]
    assert "model spread" not in str(found)


def test_a_transfer_function_has_an_interval_of_its_standard_errors() -> None:
    rng = np.random.default_rng(2)
    u = np.repeat(np.sign(rng.standard_normal(60)), 10)
    y = np.zeros(u.size)
    for k in range(1, u.size):
        y[k] = 0.9 * y[k - 1] + 0.1 * u[k - 1]
    found = pmfid.identify(
        u, y + 0.01 * rng.standard_normal(y.size), model=pmfid.TransferFunction(1, 0), dt=0.1, cutoff=2
    )
    assert found.model_spread is None
    np.testing.assert_allclose(np.diff(found.interval_95)[:, 0], 2 * 1.96 * found.theta_std, rtol=1e-3)
    assert parameter_header(found) == ("parameter", "value", "std", "95 %", "unit")
    assert found.to_json()["parameters"]["b0"]["interval_95"] == found.interval_95[1].tolist()  # type: ignore[index]
