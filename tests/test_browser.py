"""The page of `make browser`: its reader and its stand-in of pydantic here, and the page itself in Chromium."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import polars as pl
import pytest
import scipy.io

from browser import analyse
from browser.analyse import _read_text
from browser.build import PAGE, ROOT, write_text
from pmfid import BCRLS, RIV, RLS, Drive, Encoder, identify, quantize
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.io.csv_text import parse_csv
from pmfid.simulation import CART, prbs, simulate_drive
from tests.formats import write_wpilog
from tests.patience import PATIENCE
from tests.service.chromium import chromium, tab, until, violations

DT = 0.005
STEP = 5e-5
#: Answers to what a log without units does not show.
ASKED = {"resolution": "5e-5 m", "input_gain": "1"}
TEXTS = (
    b"t,u,counts\n0.0,1.5,3\n0.1,,4\n0.2,-2e-3,5\n",
    b"\xef\xbb\xbf# a comment\nZeit [s];Strom [A];Lage [mm]\r\n0,00;1,25;-3\r\n0,01;1,5;4,125\r\n",
    b"0 1.5 2\n1 2.5 4\n2 3.5 8\n",
)


@pytest.mark.parametrize("text", TEXTS)
def test_the_page_reads_a_text_as_the_desktop_does(text: bytes) -> None:
    here, there = parse_csv(text), _read_text(text)
    assert list(there) == list(here)
    for name, column in here.items():
        wanted = np.array([np.nan if value is None else float(value) for value in column])  # type: ignore[attr-defined]
        np.testing.assert_array_equal(there[name], wanted)


CONFIGURED = """
import json
from pmfid.config.axis import read_axis
raw = {"record": {"input": "u", "output": "x [deg]", "dt": 0.001}, "encoder": {"resolution": "0.01 deg"},
       "model": {"input_gain": "0.4 N m/A", "friction": "directional"}, "estimator": {"method": "riv", "cutoff": 50.0}}
axis = read_axis(raw)
print(json.dumps([repr(axis.model.make()), axis.encoder.resolution, axis.encoder.bits, axis.estimator.pole]))
print(json.dumps([[key, str(value)] for name, part in axis if name != "model" for key, value in part]))
"""


def test_the_stand_in_of_pydantic_makes_the_same_axis(tmp_path: Path) -> None:
    (tmp_path / "pydantic.py").write_bytes((ROOT / "browser/pydantic_stand_in.py").read_bytes())
    (tmp_path / "pydantic_core.py").write_text("from pydantic import ErrorDetails, PydanticUndefined\n")
    swapped = f"import sys; sys.path.insert(0, {str(tmp_path)!r})\n{CONFIGURED}"
    made = [subprocess.check_output([sys.executable, "-c", code], text=True) for code in (CONFIGURED, swapped)]
    assert made[0] == made[1]
    assert "rotary" in made[0]


def test_text_of_the_page_gives_the_bytes_back() -> None:
    data = bytes(range(256)) * 2
    text = write_text(data).encode("latin-1")
    assert not set(text) & set(b"\0\r<")
    pieces = text.split(b"=")
    assert pieces[0] + b"".join(bytes([piece[0] - 64]) + piece[1:] for piece in pieces[1:]) == data


def write_logs(folder: Path) -> list[Path]:
    """Write one motion in five formats."""
    cart = replace(CART, mass=5.3, viscous_friction=31.0, coulomb_friction=4.0, input_gain=1.0)
    u = prbs(3000, clock=14, amplitude=12.0, rng=np.random.default_rng(35))
    t, x = np.arange(u.size) * DT, quantize(simulate_drive(cart, u, DT).x, STEP) * STEP
    rows = list(zip(t, u, x, strict=True))
    (folder / "plain.csv").write_text("t,force,x\n" + "".join(f"{a:.3f},{b:.3f},{c:.5f}\n" for a, b, c in rows))
    lines = "".join(f"{1e3 * a:.0f};{b:.3f};{1e3 * c:.2f}\n" for a, b, c in rows).replace(".", ",")
    (folder / "german.csv").write_text("Zeit [ms];Kraft [N];Weg [mm]\n" + lines)
    scipy.io.savemat(folder / "log.mat", {"t": t, "force": u, "x": x})
    pl.DataFrame({"t": t, "force": u, "x": x}).write_parquet(folder / "log.parquet")
    write_wpilog(folder / "log.wpilog", {"time": t, "force": u, "x": x})
    return [folder / name for name in ("plain.csv", "german.csv", "log.mat", "log.parquet", "log.wpilog")]


@pytest.fixture(scope="module")
def page() -> Iterator[Any]:
    if not PAGE.exists():
        pytest.skip("the page is not built: make browser builds it")
    with chromium() as browser, tab(browser, width=390) as opened:
        opened.asked = []
        opened.on("request", lambda request: opened.asked.append(request.url))
        opened.goto(PAGE.as_uri(), timeout=1000 * PATIENCE)
        assert until(opened, "!document.getElementById('file').disabled"), opened.inner_text("#state")
        yield opened


def open_log(page: Any, path: Path) -> str:
    """Open a log on the page, and return the problem, or an empty text."""
    page.evaluate("document.getElementById('state').textContent = ''")
    page.set_input_files("#file", path)
    assert until(page, "/^(Done|No)/.test(document.getElementById('state').textContent)")
    return page.inner_text("#problem") if page.is_visible("#problem") else ""


def answer(page: Any, **answers: str) -> dict[str, Any]:
    """Submit the form with some answers, and return what the page shows."""
    page.evaluate("answers => { for (const key in answers) form.elements[key].value = answers[key] }", answers)
    page.evaluate("window.answer = null; form.requestSubmit()")
    assert until(page, "window.answer !== null")
    return dict(page.evaluate("window.answer"))


@pytest.mark.long
def test_five_logs_in_chromium_give_the_result_of_the_desktop(page: Any, tmp_path: Path) -> None:
    for path in write_logs(tmp_path):
        assert open_log(page, path) == ""
        found = answer(page, **({} if path.name == "german.csv" else ASKED))
        own = identify(path, axis=tomllib.loads(found["axis"]))
        assert found["status"] == list(own.status), path.name
        assert found["findings"] == []
        assert found["sentence"].startswith("Good: mass 5.30 kg")
        assert np.all(np.abs(np.array(found["theta"]) - own.theta) < 0.01 * own.theta_std), path.name
        assert max(abs(np.array(found["figure"]["error"]))) < 20 * STEP


RUN = """
import json
import numpy as np
from pmfid._kernel64 import Kernel
config, u, counts = json.loads(given)
found = Kernel(bytes.fromhex(config)).run(np.array(u), np.array(counts, np.int64))
json.dumps([part.tobytes().hex() for part in found])
"""


@pytest.mark.long
@pytest.mark.parametrize("method", [RLS, BCRLS, RIV])
def test_the_kernel_gives_the_bits_of_the_desktop_in_chromium(page: Any, method: type[RecursiveEstimator]) -> None:
    u = prbs(2000, clock=14, amplitude=4.0, rng=np.random.default_rng(11))
    counts = quantize(simulate_drive(CART, u, 0.01).x, 2e-4)
    estimator = method(Drive(CART.input_gain), Encoder(2e-4), 0.01, 21.0)
    config = estimator.make_kernel().raw_config()
    given = json.dumps([config.hex(), u.tolist(), counts.tolist()])
    code = f"given = {given!r}\n{RUN}"
    (worker,) = page.workers
    there = json.loads(worker.evaluate("code => pyodide.runPython(code)", code))
    here = estimator.make_kernel().run(u, counts.astype(np.int64))
    assert there == [part.tobytes().hex() for part in here]


@pytest.mark.long
def test_wrong_input_gets_one_sentence_in_chromium(page: Any, tmp_path: Path) -> None:
    for name, data, part in (
        ("empty.csv", b"", "the file is empty"),
        ("words.csv", b"no numbers\nat all\n", "no lines of numbers"),
        ("photo.png", b"\x89PNG", "the page reads CSV"),
        ("cut.parquet", b"PAR1 and then nothing", "damaged"),
    ):
        (tmp_path / name).write_bytes(data)
        assert part in open_log(page, tmp_path / name)
    logs = write_logs(tmp_path)
    for k, (key, text, part) in enumerate(
        (
            ("resolution", "some", "not a number"),
            ("input_gain", "1 N/kg", "N/kg"),
            ("time", "force", "different columns"),
            ("cutoff", "1e9", "too high"),
        )
    ):
        assert open_log(page, logs[k]) == ""
        assert part in answer(page, **{**ASKED, key: text})["problem"]


@pytest.mark.long
def test_the_page_asks_no_network_and_is_accessible(page: Any, tmp_path: Path) -> None:
    open_log(page, write_logs(tmp_path)[0])
    answer(page, **ASKED)
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    for theme in ("light", "dark"):
        page.emulate_media(color_scheme=theme)
        assert violations(page) == []
    assert [url for url in page.asked if not url.startswith(("file:", "blob:"))] == []
    assert PAGE.stat().st_size < 25e6


@pytest.mark.parametrize(("unit", "factor"), [("m", 1.0), ("mm", 1e3)])
def test_a_column_without_a_unit_has_the_unit_of_its_step(unit: str, factor: float) -> None:
    u = prbs(1500, clock=14, amplitude=4.0, rng=np.random.default_rng(8))
    x = quantize(simulate_drive(CART, u, 0.01).x, 2e-5) * 2e-5 * factor
    analyse.log.update(name="x.csv", table={"u": u, "x": x}, names=["u", "x"], axis={})
    answers = dict.fromkeys(("time", "axis", "friction", "bits", "method", "cutoff"), "")
    answers |= {"input": "u", "output": "x", "output_kind": "position", "dt": "0.01", "input_gain": "2"}
    given = Mock(to_py=lambda: answers | {"resolution": f"{2e-5 * factor:g} {unit}"})
    assert json.loads(analyse.identify_log(given))["theta"][0] == pytest.approx(CART.mass, rel=1e-3)


def test_a_log_of_counts_asks_for_step_and_gain(tmp_path: Path) -> None:
    u = prbs(1000, clock=14, amplitude=4.0, rng=np.random.default_rng(3))
    counts = quantize(simulate_drive(CART, u, 0.01).x, 2e-5)
    analyse.log.update(name="x.csv", table={"t": np.arange(1000) * 0.01, "u": u, "counts": counts}, names=["t"])
    asked = json.loads(analyse.suggest())
    assert "resolution" not in asked["axis"].get("encoder", {})
    assert "input_gain" not in asked["axis"]["model"]
