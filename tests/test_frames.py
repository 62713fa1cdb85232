"""Records as frames (pandas, Polars, Arrow, dicts of arrays) with an AXIS.toml."""

from __future__ import annotations

import datetime
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

import pmfid
from pmfid.config.axis import load_axis
from pmfid.io.tables import table_of
from pmfid.records.record import record_of
from tests.conftest import cart_run, unjudged
from tests.refusals import refused

TOML = """\
[record]
input = "u"
output = "counts"
output_kind = "counts"
time = "t"
[encoder]
resolution = 22.75e-6
[model]
input_gain = 2.0
[estimator]
method = "iv"
cutoff = 20.0
"""
RUN = cart_run(1, samples=800)
START = datetime.datetime(2026, 3, 4, tzinfo=datetime.UTC)
COLUMNS = {"t": np.arange(800) * 0.01, "u": RUN.u, "counts": RUN.counts}


class Capsule:
    """A foreign owner of Arrow data."""

    def __init__(self, frame: pl.DataFrame) -> None:
        self.frame = frame

    def __arrow_c_stream__(self, requested_schema: object = None) -> object:
        return self.frame.__arrow_c_stream__(requested_schema)


FRAMES = ("dict", "pandas", "polars", "arrow", "lists", "pandas moments", "polars moments", "pandas nullable")


@cache
def frames() -> dict[str, Any]:
    import pandas as pd

    return {
        "dict": COLUMNS,
        "pandas": pd.DataFrame(COLUMNS),
        "polars": pl.DataFrame(COLUMNS),
        "arrow": Capsule(pl.DataFrame(COLUMNS)),
        "lists": {name: values.tolist() for name, values in COLUMNS.items()},
        "pandas moments": pd.DataFrame(
            COLUMNS | {"t": pd.date_range("2026-03-04", periods=800, freq="10ms", tz="UTC")}
        ),
        "polars moments": pl.DataFrame(
            COLUMNS | {"t": [START + datetime.timedelta(milliseconds=10 * k) for k in range(800)]}
        ),
        "pandas nullable": pd.DataFrame(COLUMNS).convert_dtypes(),
    }


@pytest.fixture(scope="module")
def axis(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("axis") / "axis.toml"
    path.write_text(TOML)
    return path


@pytest.mark.parametrize("kind", FRAMES)
def test_every_frame_is_the_same_record(kind: str, axis: Path) -> None:
    record = record_of(table_of(frames()[kind]), load_axis(axis))
    np.testing.assert_array_equal(record.u, RUN.u)
    np.testing.assert_array_equal(record.counts, RUN.counts)
    assert record.dt == pytest.approx(0.01, rel=1e-9)


def test_identify_takes_a_frame_a_file_and_an_axis(axis: Path, tmp_path: Path) -> None:
    pl.DataFrame(COLUMNS).write_parquet(tmp_path / "run.parquet")
    with unjudged():
        first = pmfid.identify(frames()["pandas"], axis=axis)
        assert first["mass"] == pytest.approx(1.07, rel=0.03)
        for record in (frames()["arrow"], tmp_path / "run.parquet", str(tmp_path / "run.parquet")):
            np.testing.assert_array_equal(pmfid.identify(record, axis=str(axis)).theta, first.theta)


SECTIONS: Any = {
    "record": {"input": "u", "output": "counts", "output_kind": "counts", "time": "t"},
    "encoder": {"resolution": 22.75e-6},
    "model": {"input_gain": 2.0},
}


def test_what_is_wrong_names_what_is_right(axis: Path) -> None:
    drive, encoder, frame = pmfid.Drive(2.0), pmfid.Encoder(22.75e-6), frames()["dict"]
    friction, model = SECTIONS | {"model": {"friction": "direktional"}}, SECTIONS | {"model": 7}
    refused(
        *(("a record must be a frame", lambda x=x: pmfid.identify(x, axis=axis)) for x in (frames, 7, [1, 2])),
        ("axis already describes y", lambda: pmfid.identify(frame, axis=axis, dt=0.01)),
        ("model and axis are both missing", lambda: pmfid.identify(RUN.u, RUN.counts, dt=0.01)),
        ("did you mean 'directional'", lambda: pmfid.identify(frame, axis=friction)),
        ("did you mean 'model'", lambda: pmfid.identify(frame, axis=SECTIONS | {"modell": {}})),
        ("did you mean 'bcls'", lambda: pmfid.identify(frame, axis=SECTIONS, method="bcl")),
        ("did you mean 'cutoff'", lambda: pmfid.identify(frame, axis=SECTIONS, cutof=20.0)),
        ("must be a section of keys", lambda: pmfid.identify(frame, axis=model)),
        ("axis must be the path of an AXIS.toml or a dict", lambda: pmfid.identify(frame, axis=7)),
        ("did you mean 'directional'", lambda: pmfid.Drive(2.0, friction="direktional")),  # type: ignore[arg-type]
        ("did you mean 'rotary'", lambda: pmfid.Drive(2.0, axis="rotatory")),  # type: ignore[arg-type]
        ("did you mean 'matched'", lambda: pmfid.IV(drive, encoder, 0.01, 20.0, discretization="match")),  # type: ignore[arg-type]
        ("did you mean 'float32'", lambda: pmfid.IV(drive, encoder, 0.01, 20.0, precision="float23")),  # type: ignore[arg-type]
        ("is not a known unit", lambda: pmfid.Encoder("0.01")),
        ("not a length or angle", lambda: pmfid.Encoder("3 rpm")),
        ("not a length or angle", lambda: pmfid.Encoder("fine")),
        ("positive and finite", lambda: pmfid.Encoder("0 deg")),
    )
    refused(("did you mean 'identify'", lambda: pmfid.identifi), kind=AttributeError)  # type: ignore[attr-defined]
    assert pmfid.Encoder("4096 counts/rev", max_speed="3000 rpm") == pmfid.Encoder(
        2 * np.pi / 4096, max_speed=100 * np.pi
    )
