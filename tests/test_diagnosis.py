"""The commonest mistakes of a log: each comes first in the text of a refused identification."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from pmfid.config.axis import Axis, load_axis
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.batch import check_identifiable
from pmfid.estimators.results import Columns
from pmfid.findings import texts
from pmfid.pipeline.checks import check_record
from pmfid.pipeline.drives import check_direction
from pmfid.pipeline.identify import compare, identify
from pmfid.records.outliers import wrap_of
from pmfid.records.record import Record, read_record
from pmfid.simulation.drive import DriveParameters, Motion, quantize, simulate_drive
from pmfid.simulation.signals import multisine, prbs
from tests.refusals import refused

DT, GAIN, RESOLUTION = 0.005, 1.5, 2e-4
MACHINES = {
    "damped": DriveParameters(4.0, 30.0, 3.0, GAIN),
    "sticky": DriveParameters(15.0, 10.0, 12.0, GAIN),
    "light": DriveParameters(0.5, 0.4, 0.3, GAIN),
}
FORCES = {"damped": 60.0, "sticky": 60.0, "light": 3.0}  # Input forces of the machines [N].


@cache
def motion(machine: str) -> Motion:
    rng = np.random.default_rng(3)
    amplitude = FORCES[machine] / GAIN
    sines = multisine(2400, DT, [0.7, 1.7, 3.1], amplitude, rng)
    u = prbs(2400, clock=40, amplitude=amplitude, rng=rng) if machine == "damped" else sines
    return simulate_drive(MACHINES[machine], u, DT)


def logged(machine: str, fault: str) -> Record:
    """Return the log of a machine with a fault; `axis_of` reads it as a log without faults."""
    run = motion(machine)
    u, counts = run.u, quantize(run.x, RESOLUTION, phase=1e-5)
    if fault == "reversed":
        counts = -counts
    if fault == "velocity":
        counts = quantize(run.v, RESOLUTION)
    if fault == "exchanged":
        u, counts = counts * RESOLUTION, quantize(run.u, RESOLUTION)
    if fault == "wrapped":
        counts = (counts + 100) % 2 ** (int(np.ptp(counts)).bit_length() - 1)
    return Record(u, counts, DT, RESOLUTION, (), "log")


def axis_of(output_kind: str = "position", method: str = "auto", **model: object) -> Axis:
    return Axis.model_validate(
        {
            "record": {"input": "u", "output": "y", "output_kind": output_kind, "dt": DT},
            "encoder": {"resolution": RESOLUTION},
            "model": model or {"input_gain": GAIN},
            "estimator": {"cutoff": 40.0, "method": method},
        }
    )


def named(record: Record, axis: Axis) -> str:
    """Return the findings on the log as one sentence."""
    return "; ".join(texts(check_record(record, axis)))


MISTAKES = {
    "reversed": "the output has the opposite sign of the input",
    "velocity": "the output column 'y' is a velocity, not a position",
    "exchanged": "input and output are exchanged",
    "wrapped": "the output column 'y' wraps at",
}


LOAD = "a constant load acts on the axis"


@pytest.mark.parametrize("machine", MACHINES)
@pytest.mark.parametrize("fault", MISTAKES)
def test_the_mistake_is_named(machine: str, fault: str) -> None:
    assert named(logged(machine, fault), axis_of()).startswith(MISTAKES[fault])


@pytest.mark.parametrize("machine", MACHINES)
def test_a_right_log_has_no_mistake(machine: str) -> None:
    assert named(logged(machine, "none"), axis_of()) == ""


@pytest.mark.parametrize("machine", MACHINES)
def test_a_constant_input_is_no_load(machine: str) -> None:
    record = logged(machine, "none")
    constant = replace(record, u=np.full_like(record.u, np.mean(np.abs(record.u))))
    assert not named(constant, axis_of()).startswith(LOAD)


@pytest.mark.parametrize("fault", ["reversed", "exchanged"])
def test_the_mistake_stands_first_where_an_identification_is_refused(fault: str) -> None:
    with pytest.raises(NotIdentifiableError) as caught:
        identify(logged("light", fault), axis_of())
    text = str(caught.value)
    assert text.startswith(MISTAKES[fault])
    assert isinstance(caught.value.__cause__, NotIdentifiableError)


def test_the_mistake_stands_before_a_negative_mass() -> None:
    with pytest.raises(NotIdentifiableError) as refused:
        identify(logged("damped", "reversed"), axis_of(method="ls"))
    assert str(refused.value).startswith(MISTAKES["reversed"])
    assert "mass comes out as -" in str(refused.value.__cause__)


def test_the_remedy_for_a_reversed_sign_helps_when_followed_literally() -> None:
    record = logged("sticky", "reversed")
    assert "give [model] input_gain = -1.5" in named(record, axis_of())
    assert identify(record, axis_of(input_gain=-1.5)).theta[0] == pytest.approx(15.0, rel=0.01)


def test_the_remedy_for_forgotten_bits_names_the_width() -> None:
    record = logged("damped", "wrapped")
    bits = int(np.ptp(record.counts)).bit_length()
    assert f"give [encoder] bits = {bits}" in named(record, axis_of("counts"))


@pytest.mark.parametrize("machine", MACHINES)
def test_what_the_model_lacks_is_no_mistake_of_the_log(machine: str) -> None:
    """An integral follows the input more easily than a position. A load or a dead time once made a position look like a
    velocity.
    """
    record = logged(machine, "none")
    load = 0.4 * float(np.std(record.u))
    found = named(replace(record, u=record.u + load), axis_of())
    assert found == "" or found.startswith(LOAD)
    assert named(replace(record, u=np.r_[record.u[6:], np.zeros(6)]), axis_of()) == ""


def test_an_angle_that_wraps_has_another_period_than_a_counter() -> None:
    counts = np.round(3600 * (np.sin(np.linspace(0, 20, 4000)) + 1.2)).astype(np.int64)
    wrap = wrap_of(counts % 3600)
    assert wrap is not None
    assert wrap.bits is None
    assert wrap.span == pytest.approx(3600, rel=0.01)


@pytest.mark.parametrize("jump", [20_000, 3, 100_000])
def test_a_counter_reset_once_does_not_wrap(jump: int) -> None:
    counts = np.round(500 * np.sin(np.linspace(0, 20, 2000))).astype(np.int64)
    counts[1000:] += jump
    assert wrap_of(counts) is None


def test_friction_by_the_direction_of_a_velocity_is_refused() -> None:
    """For a velocity column, the direction is that of the change. Friction was once wrong by factors without a flag."""
    terms = [
        {"signal": "output", "derivative": 1, "name": "mass"},
        {"signal": "output", "derivative": 0, "name": "drag"},
        {"signal": "direction", "name": "dry"},
    ]
    known = [{"signal": "input", "coefficient": GAIN}]
    axis = axis_of(method="ls", kind="equation", unknown=terms, known=known)
    record = logged("sticky", "velocity")
    refused(
        (r"'y' is a velocity.* raise every derivative of the output by one", lambda: identify(record, axis)),
        ("'y' is a velocity", lambda: compare(record, axis)),
    )
    # a position with a spring is also of first order
    slow = replace(record, counts=quantize(motion("sticky").x, RESOLUTION))
    assert check_direction(slow, axis) == ""


def test_a_simulated_motion_at_rest_is_no_input_of_zero() -> None:
    rng = np.random.default_rng(1)
    still = Columns(rng.normal(size=(50, 2)), np.zeros(50), np.zeros((50, 2)), np.ones(50, bool), 0)
    refused(
        ("the simulated motion stays at rest", lambda: check_identifiable(still, ("mass", "drag"), simulated=True)),
        ("the input is zero while the axis moves", lambda: check_identifiable(still, ("mass", "drag"))),
        kind=NotIdentifiableError,
    )


def test_whole_numbers_are_no_position_in_parts_of_a_metre(tmp_path: Path) -> None:
    counts = np.cumsum(np.random.default_rng(3).integers(-9, 10, 300))
    np.savetxt(tmp_path / "run.csv", np.column_stack([counts, counts]), header="u,counts", delimiter=",", comments="")
    text = '[record]\ninput = "u"\noutput = "counts"\noutput_kind = "{}"\ndt = 0.01\n[encoder]\nresolution = 1e-4\n'
    text += "[model]\ninput_gain = 1.0\n[estimator]\ncutoff = 9.0\n"
    (tmp_path / "axis.toml").write_text(text.format("position"))
    with pytest.raises(UsageError, match='give output_kind = "counts"'):
        read_record(tmp_path / "run.csv", load_axis(tmp_path / "axis.toml"))
    (tmp_path / "axis.toml").write_text(text.format("counts"))
    assert np.array_equal(read_record(tmp_path / "run.csv", load_axis(tmp_path / "axis.toml")).counts, counts)


def test_one_wild_count_is_a_jump_and_nothing_else() -> None:
    record = logged("damped", "none")
    counts = record.counts.copy()
    counts[counts.size // 2] += 1_000_000
    axis = axis_of()
    axis = axis.model_copy(update={"encoder": axis.encoder.model_copy(update={"guard": False})})
    assert named(replace(record, counts=counts), axis).startswith("the counts jump by")


@pytest.mark.parametrize("late", [0, 1])
def test_a_step_in_one_direction_is_not_called_a_velocity(late: int) -> None:
    """A fast motor runs at one speed: the input explains its position, which shows no dry friction."""
    dt, resolution = 0.006, 1 / 8192
    u = np.r_[np.zeros(250), np.full(900, 0.25)]
    run = simulate_drive(DriveParameters(1.6e-4, 0.055, 0.003, 1.0), np.r_[np.zeros(late), u[: u.size - late]], dt)
    noise = np.random.default_rng(1).integers(-1, 2, u.size)
    record = Record(u, quantize(run.x, resolution) + noise, dt, resolution, (), "log")
    axis = axis_of("counts", input_gain=1.0)
    axis = axis.model_copy(update={"estimator": axis.estimator.model_copy(update={"cutoff": 10.0})})
    assert "is a velocity" not in named(record, axis)
