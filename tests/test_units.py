"""Units: the unit by a column's name or a key, numbers with a unit, and refusals of ambiguous units."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from pmfid.config.axis import Axis
from pmfid.errors import UsageError
from pmfid.models.drive import Drive
from pmfid.pipeline.identify import identify
from pmfid.records.record import Record, read_record
from pmfid.stream.lines import LineParser
from pmfid.units import INPUTS, OUTPUTS, column_unit, gain, quantity
from tests.conftest import cart_run
from tests.refusals import refused

pytestmark = pytest.mark.usefixtures("without_judgement")

DT, STEP = 0.01, 22.75e-6
RUN = cart_run(1, samples=1000)
DEG = math.pi / 180


def axis(
    output: str, input_name: str = "u", resolution: object = STEP, input_gain: object = 2.0, **more: object
) -> Axis:
    """Return the axis of the cart; `more` has keys such as record_output_unit."""
    raw: dict[str, dict[str, object]] = {
        "record": {"input": input_name, "output": output, "dt": DT},
        "encoder": {"resolution": resolution},
        "model": {"input_gain": input_gain},
        "estimator": {"method": "iv", "cutoff": 20.0},
    }
    for key, value in more.items():
        section, _, name = key.partition("_")
        raw[section][name] = value
    return Axis.model_validate(raw)


def logged(folder: Path, output: str, factor: float = 1.0, input_name: str = "u", input_factor: float = 1.0) -> Path:
    """Write the cart's counts in units of `factor` m, and its input."""
    y = RUN.counts * STEP / factor
    pl.DataFrame({input_name: RUN.u / input_factor, output: y}).write_csv(folder / "run.csv")
    return folder / "run.csv"


def same(record: Record) -> Record:
    np.testing.assert_array_equal(record.counts - record.counts[0], RUN.counts - RUN.counts[0])
    np.testing.assert_allclose(record.u, RUN.u, rtol=1e-12)
    return record


OF_OUTPUTS = {"pos_mm": "mm", "y [mm]": "mm", "phi (deg)": "deg", "pos [°]": "deg", "n_rpm": "rpm", "v [m/s]": "m/s"}
OF_OUTPUTS |= {"Drehzahl [U/min]": "rpm", "angle/deg": "deg", "x_um": "um", "x [µm]": "um", "y_rad": "rad"}
OF_INPUTS = {"Current [mA]": "mA", "Iq [A]": "A", "i_mA": "mA", "M [N·m]": "N m", "M [N-m]": "N m", "torque_Nm": "N m"}
OF_INPUTS |= {"u [mNm]": "mN m", "Torque [%]": "%", "load_pct": "%", "F_kN": "kN", "iq_A": "A", "I / A": "A"}
OF_INPUTS |= {"motor_i_A": "A", "iq_A_filt": "A", "Iq[A].1": "A", "current_ampere": "A", "uq_V": "V", "Fx_N": "N"}


def test_units_of_columns() -> None:
    for units, table in ((OUTPUTS, OF_OUTPUTS), (INPUTS, OF_INPUTS)):
        found = {name: column_unit(name, units) for name in table}
        assert {name: unit and unit.name for name, unit in found.items()} == table
    for name in ("y_m", "items", "position", "encoder [inc]", "torque [Nm]", "t_ms"):
        assert column_unit(name, OUTPUTS) is None
    for name in ("u_v", "u", "motor_A", "tau(1)"):
        assert column_unit(name, INPUTS) is None


#: Output, input, gain and further keys of an axis, and what its refusal says. "iq_A" per volt was accepted once.
UNITS_REFUSED: list[tuple[str, str, object, dict[str, object], str]] = [
    ("y", "iq_A", "0.35 N m/V", {}, "input_gain is per V: write it per A, or rename the column"),
    ("y", "u_V", "0.35 N m/A", {}, "input_gain is per A: write it per V, or rename the column"),
    ("y", "I / A", "3 N/V", {}, "input_gain is per V: write it per A, or rename the column"),
    ("y", "iq [A] raw", "0.35 N m/%", {}, "input_gain is per %: write it per A, or rename the column"),
    ("y", "torque_cmd [%]", "0.35 N m/A", {}, "input_gain is per A: write it per %, or rename the column"),
    ("y", "iq_mA", "0.35 N m", {}, 'write [model] input_gain = "0.35 N m/mA" or "0.35 N m/A"'),
    ("pos_mm", "u", 2.0, {"record_output_unit": "m"}, 'write output_unit = "mm", or rename'),
    ("pos_mm", "u", 2.0, {"record_output_kind": "counts"}, 'output_kind = "position"'),
    ("v [mm/s]", "u", 2.0, {}, 'output_kind = "velocity"'),
    ("y", "u", "2 N/V", {"encoder_resolution": "0.01 deg"}, "belongs to a rotary axis"),
    ("y", "u", 2.0, {"encoder_resolution": 4096.0, "record_output_kind": "counts"}, 'resolution = "4096 counts/rev"'),
    ("y", "u", 2.0, {"record_time": "t_ms", "record_dt": None, "record_time_unit": "s"}, 'write time_unit = "ms"'),
]


@pytest.mark.parametrize(("output", "u", "gain", "more", "said"), UNITS_REFUSED)
def test_units_that_contradict_each_other_are_refused(
    tmp_path: Path, output: str, u: str, gain: object, more: dict[str, object], said: str
) -> None:
    t = 10.0 * np.arange(RUN.u.size)
    pl.DataFrame({"t_ms": t, u: RUN.u, output: RUN.counts * STEP}).write_csv(tmp_path / "run.csv")
    with pytest.raises(UsageError) as caught:
        read_record(tmp_path / "run.csv", axis(output, u, input_gain=gain, **more))
    assert said in str(caught.value)


def test_numbers_with_units() -> None:
    assert quantity("0.001 mm") == pytest.approx(1e-6)
    assert quantity("2000 counts/rev") == pytest.approx(2 * math.pi / 2000)
    assert quantity("50 counts per mm") == pytest.approx(2e-5)
    assert quantity("3000 rpm") == pytest.approx(100 * math.pi)
    assert quantity("estimate") == "estimate"
    assert gain("0.35 N m/A") == pytest.approx(0.35)
    assert gain("0.5 mNm/mA") == pytest.approx(0.5)
    assert gain("0.12 N m/%") == pytest.approx(12.0)
    refused(
        ("'parsec' is not a known unit; use one of m, ", lambda: quantity("1 parsec")),
        (r'^.{20,99}use one of m, .* these per s or min, or "counts/rev".{0,9}$', lambda: quantity("0 counts/rev")),
        ("'A/N' is not a force or torque per unit of input", lambda: gain("2 A/N")),
        kind=ValueError,
    )


@pytest.mark.parametrize("extra", [{}, {"encoder_max_speed": 3.0}, {"record_output_unit": "mm"}])
def test_a_number_that_may_be_meant_in_two_units_is_refused_and_either_remedy_is_taken_literally(
    tmp_path: Path, extra: dict[str, object]
) -> None:
    """A resolution of 0.02275 with a column in mm once gave a mass a thousand times too small, in "kg"."""
    path = logged(tmp_path, "pos_mm", 1e-3)
    with pytest.raises(UsageError, match=r'write \[encoder\] resolution = "0.02275 mm" or "0.02275 m"') as caught:
        read_record(path, axis("pos_mm", resolution=0.02275, **extra))
    assert ('max_speed = "3 mm/s" or "3 m/s"' in str(caught.value)) == ("encoder_max_speed" in extra)
    record = read_record(path, axis("pos_mm", resolution="0.02275 mm"))
    assert identify(record, axis("pos_mm", resolution="0.02275 mm"))["mass"] == pytest.approx(1.07, rel=0.02)


def test_an_input_in_another_unit(tmp_path: Path) -> None:
    path = logged(tmp_path, "y", input_name="Current [mA]", input_factor=1e-3)
    per_volt = axis("y", "Current [mA]", input_gain="2 N/V")
    refused(
        (r'write \[model\] input_gain = "2 N/mA" or "2 N/A"', lambda: read_record(path, axis("y", "Current [mA]"))),
        ("is in mA, and .* input_gain is per V: write it per A", lambda: read_record(path, per_volt)),
    )
    right = axis("y", "Current [mA]", input_gain="2 N/A")
    assert identify(same(read_record(path, right)), right)["mass"] == pytest.approx(1.07, rel=0.02)
    per_unit = axis("y", "Current [mA]", input_gain="0.002 N/mA")
    assert per_unit.model.input_gain == pytest.approx(2.0)
    scaled = read_record(path, axis("y", "Current [mA]", record_input_scale=1e-3))
    same(scaled)  # the user converts


def test_a_rotary_axis_has_its_units_everywhere(tmp_path: Path) -> None:
    rotary = axis("phi_deg", resolution=f"{STEP / DEG} deg", input_gain="2 N m/V")
    result = identify(same(read_record(logged(tmp_path, "phi_deg", DEG), rotary)), rotary)
    assert result.names == ("inertia", "viscous_friction", "coulomb_friction")
    assert result.units == ("kg m2", "N m s/rad", "N m")
    linear = axis("y")
    expected = identify(read_record(logged(tmp_path, "y"), linear), linear)
    np.testing.assert_allclose(result.theta, expected.theta, rtol=1e-9)
    assert result.to_dict()["parameters"]["inertia"]["unit"] == "kg m2"  # type: ignore[index]


@pytest.mark.parametrize("friction", ["symmetric", "directional"])
def test_every_term_of_a_rotary_drive(friction: str) -> None:
    own = {"friction": friction, "spring": True, "stribeck": "estimate", "quadratic": True, "gravity": True}
    drive = Drive(1.0, axis="rotary", **own)  # type: ignore[arg-type]
    units = drive.equation.units
    assert set(units) <= {"kg m2", "N m s/rad", "N m", "N m/rad", "N m s2/rad2"}
    assert dict(drive.equation.further)["stribeck_speed"] == "rad/s"
    assert set(drive.equation.symmetric.units) <= {"kg m2", "N m s/rad", "N m", "N m/rad"}


def test_a_pipe_converts_as_a_record_does() -> None:
    parse = LineParser(b"u,pos_mm", axis("pos_mm", resolution="0.1 mm"))
    assert [line.counts for line in map(parse, (b"1.0,0.5", b"1.0,0.6")) if line] == [5, 6]
