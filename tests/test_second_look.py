"""The second look: statuses that matter, intervals for unmodelled effects, the check by simulation."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from dataclasses import replace
from html import unescape
from itertools import product
from pathlib import Path
from unittest import mock

import numpy as np
import pytest

import pmfid
from pmfid.cli.tables import _parameters as terminal_table
from pmfid.config.axis import load_axis
from pmfid.estimators.registry import methods_for
from pmfid.findings import Finding, make_notes
from pmfid.fit.compare import NORMAL_95
from pmfid.models.drive import Drive
from pmfid.pipeline.identify import identify
from pmfid.pipeline.result import DriveResult, parameter_header, parameter_rows
from pmfid.records.record import Record
from pmfid.report.result import write_result
from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, DriveParameters, Machine, prbs, simulate_drive
from pmfid.types import Floats
from studies.friction_axes import FRICTIONS
from studies.machines import Axis, _control, record_of, truth
from studies.paper.truth import CartRecord
from studies.real_axes import axis as axis_of
from tests.conftest import cart_run, long_unless, unjudged

#: Machines that are not in the study: an indexing table, 0.3 kg m2, and a lift of 120 kg.
TABLE = Axis(DriveParameters(0.3, 1.1, 0.5, 2.0), 0.004, 2000, 2.0, 15, _control(60, 6, 12), 1.2, 0.5, 0.25, 3e-4, 0.05)
LIFT = Axis(
    DriveParameters(120.0, 400.0, 40.0, 10.0),
    0.005,
    2000,
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


# --- output of the interval ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def result() -> DriveResult:
    return identified(TABLE, record_of(TABLE, FRICTIONS["quadratic 20 %"](TABLE), "prbs", 1024, 11), method="iv")


def test_json_has_it_next_to_what_it_had(result: DriveResult) -> None:
    printed = json.loads(json.dumps(result.to_dict(), allow_nan=False))["parameters"]["mass"]
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


TURRET = axis_of((0.8, 3.0, 1.7, 5.0), 0.003, 2e-4, 1.1, 0.6)


@pytest.mark.parametrize("axis", [TABLE, LIFT, TURRET], ids=["table", "lift", "turret"])
@pytest.mark.parametrize("motion", ["stop-and-go", pytest.param("multisine", marks=pytest.mark.long)])
def test_the_right_model_has_no_status(axis: Axis, motion: str) -> None:
    """Each case once had model_spread and feedback, at errors of at most 0.05 %."""
    record = record_of(axis, Machine(axis.drive), motion, 1024, 21)
    result = identified(axis, record)
    assert np.max(np.abs(result.theta / truth(axis) - 1)) < 0.0005
    assert result.status == (), str(result)


# --- one verdict ------------------------------------------------------------------------------------------------------


def doubts(findings: Iterable[Finding]) -> list[tuple[str, str]]:
    return [(finding.code, finding.text) for finding in findings if finding.severity != "note"]


@pytest.mark.parametrize("friction", [pytest.param("nothing", marks=pytest.mark.long), "quadratic 20 %"])
def test_every_face_says_the_same(friction: str, tmp_path: Path) -> None:
    """Four commands once gave four verdicts on one record."""
    record = record_of(TURRET, FRICTIONS[friction](TURRET), "multisine", 1024, 23)
    own = {"model": pmfid.Drive(TURRET.drive.input_gain), "encoder": pmfid.Encoder(record.resolution), "dt": TURRET.dt}
    result = pmfid.identify(record.u, record.counts, **own)
    said = doubts(result.findings)
    assert bool(said) == (friction != "nothing")
    assert doubts(pmfid.check(record.u, record.counts, **own)) == said
    validation = pmfid.validate(result, record.u, record.counts)
    assert doubts(validation.findings) == said
    assert validation.status == result.status == tuple(dict.fromkeys(code for code, _ in said))
    write_result(tmp_path, result)
    assert json.loads((tmp_path / "result.json").read_text())["status"] == list(result.status)
    page = unescape((tmp_path / "report.html").read_text())
    assert [text for _, text in said if text not in page] == []
    assert ("% off" in page) == bool(said)


EXAMPLES = Path(__file__).parents[1] / "examples"


def result_of(method: str, increments: int = 16384, forgetting: float = 1.0) -> DriveResult:
    """Identify the cart without the status and sentences of `judge`, which the check does not use."""
    run = cart_run(1, increments=increments)
    record = Record(run.u, run.counts, CART_DT, run.encoder.resolution, (), "cart")
    axis = load_axis(EXAMPLES / "cart.toml", {"estimator.method": method, "estimator.forgetting": forgetting})
    with unjudged():
        result = identify(record, axis)
    assert isinstance(result, DriveResult)
    return result


@pytest.mark.parametrize(
    "method", long_unless(lambda method: method in ("riv", "fit"), sorted(methods_for(Drive(1.0))))
)
def test_the_right_model_follows(method: str) -> None:
    run = result_of(method).free_run()
    assert run.fit is not None
    assert run.fit > 99.0


def test_the_report_has_the_check_second(tmp_path: Path) -> None:
    result = replace(result_of("iv"), findings=tuple(make_notes("x", ["one", "two"])))
    write_result(tmp_path, result)
    page = (tmp_path / "report.html").read_text("utf-8")
    assert re.findall(r"<h2>(.*?)</h2>", page)[1] == "Model check: simulated from the input alone"
    assert re.search(r"Fit: (99|100)\.\d\d %", page)
    assert "<p>Note: one.</p>\n<p>Note: two.</p>" in page
    assert "input [N]" in page
    assert "unit of u" not in page


def test_the_methods_share_one_fit_of_the_record() -> None:
    u = prbs(500, clock=10, amplitude=4.0, rng=np.random.default_rng(1))
    counts = pmfid.quantize(simulate_drive(CART, u, CART_DT).x, CART_RESOLUTION)
    settings = {"model": pmfid.Drive(CART.input_gain), "encoder": pmfid.Encoder(CART_RESOLUTION), "dt": CART_DT}
    with mock.patch.object(pmfid.MotionFit, "examine", autospec=True, side_effect=pmfid.MotionFit.examine) as examine:
        results = [pmfid.identify(u, counts, method=name, cutoff=20.0, **settings) for name in ("ls", "iv")]
    assert examine.call_count == 1
    assert results[0].model_spread is not results[1].model_spread
