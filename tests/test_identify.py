"""`pmfid.identify` gives the same from arrays and objects as the command gives from files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import pmfid
from pmfid.cli.main import main
from pmfid.pipeline.arrays import axis_of
from pmfid.simulation.scenarios import CART_DT, resolution_of
from tests.conftest import Run, cart_run
from tests.refusals import refused

CUTOFF = 50.0
ENCODER = pmfid.Encoder(resolution_of(4096))

TOML = """
[record]
input = "u"
output = "y"
output_kind = "counts"
dt = {dt}
[encoder]
resolution = {resolution!r}
bits = 32
[model]
input_gain = 2.0
[estimator]
cutoff = 50.0
"""


def by_command(folder: Path, run: Run, *options: str) -> dict[str, object]:
    np.savetxt(folder / "run.csv", np.column_stack([run.u, run.counts]), "%.17g", ",", header="u,y", comments="")
    (folder / "axis.toml").write_text(TOML.format(dt=CART_DT, resolution=run.encoder.resolution))
    command = ["identify", str(folder / "run.csv"), "--config", str(folder / "axis.toml"), "--json", *options]
    found: dict[str, object] = json.loads(CliRunner().invoke(main, command, catch_exceptions=False).stdout)
    return found


def identified(run: Run, model: object, **settings: object) -> pmfid.Result:
    return pmfid.identify(run.u, run.counts, model=model, encoder=run.encoder, dt=CART_DT, cutoff=CUTOFF, **settings)


@pytest.mark.parametrize(
    ("options", "settings"),
    [((), {}), (("--method", "riv", "--set", "estimator.forgetting=0.998"), {"method": "riv", "forgetting": 0.998})],
    ids=["auto", "riv"],
)
def test_arrays_give_what_the_command_gives(
    tmp_path: Path, options: tuple[str, ...], settings: dict[str, object]
) -> None:
    run = cart_run(5, samples=800)
    result = identified(run, pmfid.Drive(2.0), **settings)
    assert result.to_json() == by_command(tmp_path, run, *options)
    assert isinstance(result, pmfid.Result)
    assert result["mass"] == pytest.approx(1.07, rel=0.02)


def test_a_transfer_function_from_arrays_and_from_experiments() -> None:
    rng, dt = np.random.default_rng(2), 0.05
    u = np.repeat(np.sign(rng.standard_normal(120)), 10)
    y, a = np.zeros(u.size), np.exp(-dt / 0.7)
    for k in range(1, u.size):
        y[k] = a * y[k - 1] + (1 - a) * 3.0 * u[k - 1]
    y += 0.02 * rng.standard_normal(y.size)
    model = pmfid.TransferFunction(1, 0)
    result = pmfid.identify(u, y, model=model, dt=dt, cutoff=2.0)
    assert result["a0"] == pytest.approx(1 / 0.7, rel=0.02)
    assert result.to_json()["gain"] == pytest.approx(3.0, rel=0.01)
    again = pmfid.identify(pmfid.Experiment(u, y, dt=dt), model=model, cutoff=2.0)
    assert np.array_equal(again.theta, result.theta)


def test_a_result_prints_what_a_person_needs() -> None:
    result = identified(cart_run(5, samples=800), pmfid.Drive(2.0), method="ls")
    first, mass, *_, last = str(result).splitlines()
    assert first == "record: ls, 800 samples"
    assert mass == f"  mass = {result['mass']:.6g} ± {result.theta_std[0]:.2g} kg"
    assert last == result.findings[-1].line


def test_an_equation_with_a_factor_keeps_it() -> None:
    """AXIS.toml once had no key for an unknown term's coefficient, such as -1 for the other side."""
    signal = pmfid.Term
    terms = (signal("output", 2, "m"), signal("output", 1, "d", coefficient=2.0), signal("direction", 0, "F"))
    model = pmfid.EquationModel(pmfid.Equation(terms, (signal("input", 0, coefficient=2.0),)))
    assert axis_of(model, ENCODER, 0.01, {"cutoff": CUTOFF}).model.make() == model
    run = cart_run(5, samples=800)
    half = identified(run, model, method="ls")["d"]
    whole = identified(run, pmfid.Drive(2.0), method="ls")
    assert half == pytest.approx(whole["viscous_friction"] / 2)


def test_wrong_arguments_are_one_clear_error() -> None:
    def wrong(**arguments: object) -> pmfid.Result:
        given = {"u": np.ones(200), "y": np.arange(200), "model": pmfid.Drive(2.0), "encoder": ENCODER, "dt": 0.01}
        return pmfid.identify(**(given | {"cutoff": CUTOFF} | arguments))  # type: ignore[no-any-return]

    refused(
        ("encoder", lambda: wrong(encoder=None)),
        ("dt", lambda: wrong(dt=None)),
        ("quantize|integers", lambda: wrong(y=np.linspace(0.0, 1.0, 200))),
        ("too fast", lambda: wrong(cutoff=1e9)),
        ("method", lambda: wrong(method="magic")),
        ("cutoff", lambda: wrong(cut_off=3.0)),
        ("forgetting", lambda: wrong(forgetting=2.0)),
        ("Drive", lambda: wrong(model="cart")),
    )
