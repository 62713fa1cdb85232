"""Friction over velocity without an assumed law, on machines with a known law."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import pmfid
from pmfid.cli.main import main
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.friction_curve import FrictionCurve
from pmfid.report.friction import curve_figure
from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, DriveParameters, Machine, drive_machine, multisine
from pmfid.types import Floats
from studies.friction_axes import BENCHES, FRICTIONS, stribeck
from studies.machines import Axis, _control, record_of
from studies.paper.truth import CartRecord
from tests.conftest import long_unless

#: Machines that are not in the study: a lift of 120 kg, slow at the ends of its moves, and an indexing table.
LIFT = Axis(
    DriveParameters(120.0, 400.0, 40.0, 10.0),
    0.005,
    5000,
    25.0,
    60,
    _control(3000, 500, 120),
    0.4,
    1.2,
    0.4,
    3e-5,
    0.03,
)
TABLE = Axis(DriveParameters(0.3, 1.1, 0.5, 2.0), 0.004, 5000, 2.0, 40, _control(60, 6, 12), 1.2, 0.5, 0.25, 3e-4, 0.1)


def law(machine: Machine, v: Floats) -> Floats:
    """Return the friction [N] of a machine at velocities (n,), by the law of `Machine`."""
    drive, side = machine.drive, np.sign(v)
    dry = drive.coulomb_friction + machine.stribeck * np.exp(-((v / machine.stribeck_speed) ** 2))
    force = drive.viscous_friction * v + side * dry + machine.quadratic * v * np.abs(v)
    return np.asarray(force * (1 + machine.asymmetry * side))


def curve(axis: Axis, record: CartRecord, cutoff: float | None = None, **settings: object) -> FrictionCurve:
    return pmfid.friction_curve(
        record.u,
        record.counts,
        model=pmfid.Drive(axis.drive.input_gain),
        encoder=pmfid.Encoder(record.resolution),
        dt=axis.dt,
        cutoff=cutoff or 1 / (3 * axis.dt),
        **settings,  # type: ignore[arg-type]
    )


CELLS = {"lift": (LIFT, "prbs"), "table": (TABLE, "prbs"), "stage": (BENCHES["stage"], "multisine")}


@pytest.mark.parametrize(
    ("friction", "cell"),
    long_unless(
        lambda friction, cell: list(CELLS).index(cell) == list(FRICTIONS).index(friction) % len(CELLS),
        product(FRICTIONS, CELLS),
    ),
)
def test_the_law_is_within_the_band(friction: str, cell: str) -> None:
    axis, motion = CELLS[cell]
    machine = FRICTIONS[friction](axis)
    found = curve(axis, record_of(axis, machine, motion, 1024, 77))
    z = (found.force - law(machine, found.velocity)) / found.std
    assert np.mean(np.abs(z) < 2) >= 0.7
    assert np.max(np.abs(z)) < 5
    assert found.mass == pytest.approx(axis.drive.mass, rel=0.01)
    assert abs(found.mass - axis.drive.mass) < 5 * found.mass_std
    known = np.median(found.std) / axis.drive.coulomb_friction
    assert known < 0.15  # a narrow band


@pytest.mark.parametrize("friction", ["nothing", "Stribeck 50 %", "quadratic 20 %", "directional 15 %"])
def test_nothing_but_the_encoder_is_between_the_curve_and_the_law(friction: str) -> None:
    """Through a fine encoder the nodes follow the law, except for straight lines near a minimum within 20 mm/s."""
    axis = BENCHES["stage"]
    machine = FRICTIONS[friction](axis)
    found = curve(axis, record_of(axis, machine, "multisine", 400_000, 3), nodes=16)
    error = found.force - law(machine, found.velocity)
    near = 0.03 if machine.stribeck else 5e-3
    assert np.sqrt(np.mean(error**2)) < near * axis.drive.coulomb_friction
    assert found.mass == pytest.approx(axis.drive.mass, rel=1e-3)


def test_stribeck_friction_shows_as_a_minimum() -> None:
    axis = replace(BENCHES["stage"], stribeck_speed=0.08)
    for machine, falls in ((stribeck(axis, 0.5), True), (FRICTIONS["nothing"](axis), False)):
        found = curve(axis, record_of(axis, machine, "multisine", 1024, 5))
        for side in (1, -1):
            way = found.velocity * side > 0
            speed, force = np.abs(found.velocity[way][::side]), np.abs(found.force[way][::side])
            assert (np.argmin(force) > 0) == falls
            true = np.abs(law(machine, side * speed))
            drop = force[0] - force.min()
            assert drop == pytest.approx(true[0] - true.min(), abs=2.5 * found.std[way][::side][0] + 1e-12)


@pytest.mark.parametrize(("amplitude", "fastest"), [(3.0, 2.0), (5.0, 1.0), (5.0, 3.0)])
def test_the_bar_of_the_mass_contains_what_strong_stribeck_friction_leaves(amplitude: float, fastest: float) -> None:
    u = multisine(6000, CART_DT, np.linspace(0.1, fastest, 12), amplitude, np.random.default_rng(1))
    run = drive_machine(Machine(CART, stribeck=1.2, stribeck_speed=0.04), u, CART_DT, CART_RESOLUTION)
    setting = {"model": pmfid.Drive(2.0), "encoder": pmfid.Encoder(CART_RESOLUTION), "dt": CART_DT}
    curve = pmfid.friction_curve(run.u, run.counts, **setting)
    assert abs(curve.mass - CART.mass) < 2 * curve.mass_std


def test_a_curve_that_may_not_fall_does_not() -> None:
    axis = BENCHES["stage"]
    record = record_of(axis, stribeck(axis, 0.5), "multisine", 1024, 5)
    found = curve(axis, record, rising_from=0.0)
    for side in (found.velocity > 0, found.velocity < 0):
        assert np.all(np.diff(found.force[side]) >= -1e-9)
    late = curve(axis, record, rising_from=0.1)
    ahead = late.velocity > 0
    assert np.any(np.diff(late.force[ahead]) < 0)
    assert np.all(np.diff(late.force[ahead & (late.velocity >= 0.1)]) >= -1e-9)


def test_nothing_is_said_of_what_was_not_visited() -> None:
    axis = LIFT
    found = curve(axis, record_of(axis, FRICTIONS["nothing"](axis), "prbs", 1024, 8))
    (back, slow_back), (slow, ahead) = found.visited
    assert back < slow_back < 0 < slow < ahead
    outside = np.array([1.01 * back, slow_back / 2, 0.0, slow / 2, 1.01 * ahead])
    assert np.all(np.isnan(found.evaluate(outside)))
    assert np.all(np.isnan(found.std_at(outside)))
    inside = np.array([0.5 * (back + slow_back), 0.5 * (slow + ahead)])
    assert found.evaluate(inside) == pytest.approx(law(FRICTIONS["nothing"](axis), inside), rel=0.05)
    figure = curve_figure(found)
    assert "hardly visited" in [text.get_text() for text in figure.axes[0].get_legend().get_texts()]


def test_a_known_dead_time_is_taken_into_account() -> None:
    axis = TABLE
    late = Machine(axis.drive, dead_time=1.5 * axis.dt)
    record = record_of(axis, late, "prbs", 1024, 4)
    model = pmfid.Drive(axis.drive.input_gain, dead_time=1.5 * axis.dt)
    found = pmfid.friction_curve(
        record.u,
        record.counts,
        model=model,
        encoder=pmfid.Encoder(record.resolution),
        dt=axis.dt,
        cutoff=1 / (3 * axis.dt),
    )
    assert found.mass == pytest.approx(axis.drive.mass, rel=0.01)
    assert np.max(np.abs(found.force - law(late, found.velocity)) / found.std) < 5


def test_feedback_is_said() -> None:
    axis = BENCHES["cart"]
    found = curve(axis, record_of(axis, FRICTIONS["nothing"](axis), "stop-and-go", 512, 3))
    assert any("position control" in note for note in found.notes)


@pytest.mark.parametrize(
    ("model", "said"),
    [
        (pmfid.Drive(2.0, spring=True), "with spring"),
        (pmfid.Drive(2.0, dead_time="estimate"), "needs a number as dead time"),
        (pmfid.Drive(2.0, gravity=True), "with gravity"),
        (pmfid.Drive(2.0, lag=0.003), "with a lag"),
        (pmfid.Drive(2.0, lag="estimate"), "with a lag"),
    ],
)
def test_what_it_cannot_take_is_said(model: pmfid.Drive, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        pmfid.friction_curve(
            np.ones(500), np.arange(500), model=model, encoder=pmfid.Encoder(1e-4), dt=0.004, cutoff=80.0
        )


def test_wrong_settings_and_one_way_motion_are_refused() -> None:
    axis = TABLE
    record = record_of(axis, FRICTIONS["nothing"](axis), "prbs", 1024, 2)
    with pytest.raises(UsageError, match="nodes"):
        curve(axis, record, nodes=2)
    with pytest.raises(UsageError, match="rising_from"):
        curve(axis, record, rising_from=-1.0)
    one_way = CartRecord(np.abs(record.u), np.abs(np.cumsum(np.abs(np.diff(record.counts, prepend=0)))), 3e-4)
    with pytest.raises((NotIdentifiableError, UsageError)):
        curve(axis, one_way)


def test_the_command(tmp_path: Path) -> None:
    axis = TABLE
    record = record_of(axis, FRICTIONS["quadratic 20 %"](axis), "prbs", 1024, 6)
    lines = [f"{u!r},{c}" for u, c in zip(record.u.tolist(), record.counts.tolist(), strict=True)]
    (tmp_path / "run.csv").write_text("\n".join(["u,counts", *lines]) + "\n")
    (tmp_path / "axis.toml").write_text(
        '[record]\ninput = "u"\noutput = "counts"\noutput_kind = "counts"\ndt = 0.004\n'
        f"[encoder]\nresolution = {record.resolution!r}\n[model]\ninput_gain = 2.0\n[estimator]\ncutoff = 80.0\n"
    )
    command = ["friction", str(tmp_path / "run.csv"), "--config", str(tmp_path / "axis.toml")]
    shown = CliRunner().invoke(main, [*command, "--out", str(tmp_path / "out")])
    assert shown.exit_code == 0, shown.output
    assert "friction [N]" in shown.output
    reported = json.loads(CliRunner().invoke(main, [*command, "--json"]).stdout)
    assert reported["mass"]["value"] == pytest.approx(0.3, rel=0.01)
    assert reported == json.loads((tmp_path / "out" / "friction.json").read_text())
    page = (tmp_path / "out" / "friction.html").read_text()
    assert "The curve ends at these velocities" in page


def test_a_curve_without_a_mass_is_refused() -> None:
    """With filters of a hundred samples the mass was once -0.65 +- 0.95 kg, and a curve was still shown."""
    axis = TABLE
    record = record_of(axis, FRICTIONS["quadratic 20 %"](axis), "prbs", 1024, 6)
    with pytest.raises(NotIdentifiableError, match="higher cutoff"):
        curve(axis, record, cutoff=2.5)


def test_a_wrong_count_is_left_out(tmp_path: Path) -> None:
    axis = TABLE
    record = record_of(axis, FRICTIONS["quadratic 20 %"](axis), "prbs", 1024, 6)
    counts = record.counts.copy()
    counts[700] += 40_000
    lines = [f"{u!r},{c}" for u, c in zip(record.u.tolist(), counts.tolist(), strict=True)]
    (tmp_path / "run.csv").write_text("\n".join(["u,counts", *lines]) + "\n")
    (tmp_path / "axis.toml").write_text(
        '[record]\ninput = "u"\noutput = "counts"\noutput_kind = "counts"\ndt = 0.004\n'
        f"[encoder]\nresolution = {record.resolution!r}\n[model]\ninput_gain = 2.0\n"
    )
    command = ["friction", str(tmp_path / "run.csv"), "--config", str(tmp_path / "axis.toml"), "--json"]
    reported = json.loads(CliRunner().invoke(main, command).stdout)
    assert reported["mass"]["value"] == pytest.approx(0.3, rel=0.01)
    assert any("701" in note for note in reported["notes"])
