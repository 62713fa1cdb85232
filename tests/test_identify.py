"""`pmfid.identify` gives the same from arrays and objects as the command gives from files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import pmfid
from pmfid.cli.main import main
from pmfid.simulation.scenarios import CART_DT, resolution_of
from tests.conftest import Run, cart_run
from tests.refusals import refused

pytestmark = pytest.mark.usefixtures("without_judgement")

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
    assert result.to_dict() == by_command(tmp_path, run, *options)
    assert isinstance(result, pmfid.Result)
    assert result["mass"] == pytest.approx(1.07, rel=0.02)


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
