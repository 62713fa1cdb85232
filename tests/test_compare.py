"""`pmfid identify --method all`: every method on one record."""

from __future__ import annotations

import json
import pickle
from collections.abc import Iterator
from pathlib import Path
from unittest import mock

import pytest

import pmfid
from pmfid.config.axis import Axis
from pmfid.estimators.registry import methods_for
from pmfid.pipeline.identify import Comparison, compare
from pmfid.pipeline.kinds import Progress, Records
from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, make_scenario, write_csv
from studies.second_order import write
from tests.command import run_command

CONFIG = Path(__file__).parents[1] / "examples" / "cart.toml"

METHODS = methods_for(pmfid.Drive(1.0))


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("compare") / "cart.csv"
    write_csv(make_scenario("prbs", seed=1), path)
    return path


@pytest.fixture(autouse=True, scope="module")
def compared() -> Iterator[None]:
    """Compare the same records only once for all tests."""
    known: dict[bytes, Comparison] = {}

    def once(data: Records, axis: Axis, done: Progress | None = None) -> Comparison:
        key = pickle.dumps((data, axis))
        if key not in known:
            known[key] = compare(data, axis, done)
        return known[key]

    with mock.patch("pmfid.pipeline.identify.compare", once):
        yield


def run(*arguments: str) -> str:
    result = run_command("identify", "--method", "all", *arguments)
    return result.stdout


def test_json_has_every_method_near_the_truth(record):
    found = json.loads(run(str(record), "--config", str(CONFIG), "--json"))
    assert set(found["methods"]) == set(METHODS)
    for result in found["methods"].values():
        assert result["parameters"]["mass"]["value"] == pytest.approx(CART.mass, rel=0.005)


def test_the_methods_share_one_fit_of_the_record():
    motion = make_scenario("prbs", seed=1, duration=5.0).motion
    counts = pmfid.quantize(motion.x, CART_RESOLUTION)
    settings = {"model": pmfid.Drive(CART.input_gain), "encoder": pmfid.Encoder(CART_RESOLUTION), "dt": CART_DT}
    with mock.patch.object(pmfid.MotionFit, "examine", autospec=True, side_effect=pmfid.MotionFit.examine) as examine:
        results = [pmfid.identify(motion.u, counts, method=name, cutoff=20.0, **settings) for name in ("ls", "iv")]
    assert examine.call_count == 1
    assert results[0].model_spread is not results[1].model_spread


def test_table_and_report(record, tmp_path):
    printed = run(str(record), "--config", str(CONFIG), "--out", str(tmp_path))
    assert all(method in printed for method in METHODS)
    assert {path.name for path in tmp_path.iterdir()} == {"compare.html", "compare.json"}
    page = (tmp_path / "compare.html").read_text()
    assert "mass in kg" in page
    assert page.count("<figure") == 1


@pytest.mark.long
def test_a_transfer_function_by_every_method(tmp_path):
    record, config = tmp_path / "second_order.csv", CONFIG.with_name("second_order.toml")
    write(record)
    found = json.loads(run(str(record), "--config", str(config), "--json"))["methods"]
    assert set(found) == set(methods_for(pmfid.TransferFunction(2, 0)))
    for result in found.values():
        assert result["gain"] == pytest.approx(1.0, abs=0.03)
        assert result["fit"] == pytest.approx(90.1, abs=0.3)
    printed = run(str(record), str(record), "--config", str(config), "--out", str(tmp_path))
    assert "fit" in printed
    assert "ls has no answer: ls needs one evenly spaced record" in printed
    assert "a0 in s^-2" in (tmp_path / "compare.html").read_text()
