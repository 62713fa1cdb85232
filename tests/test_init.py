"""`pmfid init` guesses columns, units, step and wrap from a record alone, and its output suffices for `identify`."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner

from pmfid.cli.main import main
from pmfid.config.axis import Axis, load_axis
from pmfid.pipeline.guess.axis_file import NamedColumns, Reader, guess, read_duration, read_gain, read_travel, read_yes
from pmfid.pipeline.guess.columns import step_of
from pmfid.pipeline.guess.roles import role_of
from pmfid.pipeline.identify import kind_of
from pmfid.records.record import read_record
from pmfid.simulation import CART, Scenario, make_scenario
from pmfid.units import Unit
from tests.command import run_command
from tests.conftest import unjudged
from tests.refusals import refused

RESOLUTION = 22.75e-6
Frame = dict[str, np.ndarray]


@cache
def run() -> Scenario:
    return make_scenario("moves", seed=4, duration=12.0)


def position() -> np.ndarray:
    return run().counts * RESOLUTION


#: Each log with its columns, and the mass that init and identify find in it, relative to the cart's.
LOGS: dict[str, tuple[Callable[[], Frame], float]] = {
    "counts": (lambda: {"t": run().motion.t, "u": run().motion.u, "counts": run().counts}, RESOLUTION / 2),
    "German": (
        lambda: {"Zeit": run().motion.t, "Drehmoment [N m]": run().motion.u, "Istposition": position()},
        0.5,
    ),
    "ms": (lambda: {"time": np.round(1000 * run().motion.t), "force": run().motion.u, "pos": position()}, 0.5),
    "mm": (lambda: {"t [s]": run().motion.t, "Force [N]": run().motion.u, "pos_mm": 1000 * position()}, 0.5),
    "turned": (lambda: {"t": run().motion.t, "u": -run().motion.u, "y": position()}, 0.5),
    "wrapped": (lambda: {"t": run().motion.t, "u": run().motion.u, "cnt": run().counts % 4096}, RESOLUTION / 2),
    "velocity": (
        lambda: {"t": run().motion.t, "u": run().motion.u, "speed": run().motion.v},
        0.5,
    ),
    "many": (
        lambda: {
            "index": np.arange(run().counts.size),
            "t": run().motion.t,
            "target": np.roll(position(), -3),
            "temperature": np.sin(np.arange(run().counts.size) / 400),
            "current": run().motion.u,
            "torque": np.random.default_rng(1).normal(size=run().counts.size),
            "encoder": run().counts,
        },
        RESOLUTION / 2,
    ),
    "next to its velocity": (
        lambda: {
            "c0": np.r_[run().motion.t[1] - 1e-4, run().motion.t[1:]],
            "c1": run().motion.u,
            "c2": position(),
            "c3": np.gradient(position()) / 0.01,
        },
        0.5,
    ),
    "nameless": (lambda: {"c0": run().motion.t, "c1": position(), "c2": run().motion.u}, 0.5),
}


def saved(name: str, folder: Path) -> Path:
    path = folder / "log.csv"
    pl.DataFrame(LOGS[name][0]()).write_csv(path)
    return path


def guess_axis(path: Path) -> Axis:
    """Return the axis from the text that `pmfid init` writes."""
    place = path.with_suffix(".toml")
    place.write_text(guess(path).text, encoding="utf-8")
    return load_axis(place)


@pytest.mark.parametrize("name", LOGS)
def test_init_then_identify_is_right_with_nothing_edited(name: str, tmp_path: Path) -> None:
    path = saved(name, tmp_path)
    axis = guess_axis(path)
    axis = axis.model_copy(update={"estimator": axis.estimator.model_copy(update={"method": "iv", "cutoff": 20.0})})
    kind = kind_of(axis)
    with unjudged():
        result = kind.estimate(kind.read([path], axis), axis)
    assert result.theta[0] == pytest.approx(LOGS[name][1] * CART.mass, rel=0.01)


def test_each_line_has_its_reason_and_what_is_not_reported_is_marked(tmp_path: Path) -> None:
    lines = guess(saved("counts", tmp_path)).text.splitlines()
    assert all("# " in line for line in lines if "=" in line)
    marked = [line.partition(" =")[0] for line in lines if "TO DO" in line and "=" in line]
    assert marked == ["resolution", "input_gain"]


ASKED = [
    (str(RESOLUTION), "2,0", [f"resolution = {RESOLUTION!r}", "input_gain = 2.0"]),
    ("2,5 um", "0.42 N/A", ['resolution = "2.5 um"', 'input_gain = "0.42 N/A"']),
    ("4096 counts/rev", "0.08 N m", ['resolution = "4096 counts/rev"', 'axis = "rotary"']),
]


@pytest.mark.parametrize(("travel", "gain", "lines"), ASKED)
def test_what_is_asked_is_written(tmp_path: Path, travel: str, gain: str, lines: list[str]) -> None:
    answers = iter([travel, gain, "n"])
    text = guess(saved("counts", tmp_path), lambda question, read: read(next(answers))).text
    assert "TO DO: travel" not in text
    assert all(line in text for line in lines)
    assert "TO DO" in guess(saved("counts", tmp_path), lambda question, read: None).text


def test_the_command_never_writes_over_a_file(tmp_path: Path) -> None:
    path, place = saved("counts", tmp_path), tmp_path / "AXIS.toml"
    command = ["init", str(path), "--out", str(place)]
    first = run_command(*command)
    assert f"pmfid identify {path} --config {place}" in first.stdout
    before = place.read_bytes()
    again = CliRunner().invoke(main, command)
    assert (again.exit_code, place.read_bytes()) == (2, before)
    assert "already exists" in again.stderr


def test_a_record_without_two_columns_is_refused(tmp_path: Path) -> None:
    (tmp_path / "one.csv").write_text("t,u\n" + "".join(f"{k / 100},1.0\n" for k in range(50)), encoding="utf-8")
    result = run_command("init", str(tmp_path / "one.csv"), "--out", str(tmp_path / "a.toml"), code=2)
    assert "no two columns can be input and output" in result.stderr
    assert not (tmp_path / "a.toml").exists()


def answer(question: str, read: Reader) -> float | None:
    return read("4 ms") if "period" in question else None


def test_a_record_without_time_says_what_to_fill_in(tmp_path: Path) -> None:
    pl.DataFrame({"u": run().motion.u, "counts": run().counts}).write_csv(tmp_path / "log.csv")
    assert (
        "dt = 0.001  # TO DO: write the sample period in s, because no column has the time"
        in guess(tmp_path / "log.csv").text
    )
    assert "dt = 0.004  # as answered" in guess(tmp_path / "log.csv", answer).text


@pytest.mark.parametrize("step", [22.75e-6, 0.36, 1.0, 2 * np.pi / 4096])
def test_the_step_of_a_column_is_found(step: float) -> None:
    counts = np.round(300 * np.cumsum(np.random.default_rng(0).normal(size=4000)) / 10)
    found, there = step_of(counts * step)
    assert there
    assert found == pytest.approx(step, rel=1e-5)
    assert not step_of(np.random.default_rng(0).normal(size=4000))[1]


ROLES = {"Zeit [ms]": "time", "MotorTorque": "input", "iq": "input", "Strom (A)": "input", "Lage": "position"}
ROLES |= {"i_mA": "input", "F_kN": "input", "phi_deg": "position", "n_rpm": "velocity"}
ROLES |= {"ActualPosition": "position", "Drehzahl": "velocity", "encoder": "counts", "Sollposition": "other"}
ROLES |= {"tau2": "input", "motor_current_a": "input", "vel1": "velocity", "q_3": "position", "tau_fric1": "other"}


@pytest.mark.parametrize("name", ROLES)
def test_names_in_english_and_german(name: str) -> None:
    assert role_of(name) == ROLES[name]


def test_a_column_that_may_number_the_samples_is_no_time(tmp_path: Path) -> None:
    """The column was once taken for ms, and the mass was 94 % off without a warning."""
    frame = {"t": np.arange(run().counts.size), "u": run().motion.u, "counts": run().counts}
    pl.DataFrame(frame).write_csv(tmp_path / "log.csv")
    text = guess(tmp_path / "log.csv").text
    assert "time =" not in text
    assert "dt = 0.001  # TO DO" in text


def test_lengths_in_counts_and_of_no_unit_are_said(tmp_path: Path) -> None:
    path = saved("counts", tmp_path)
    record = kind_of(guess_axis(path)).read([path], guess_axis(path))
    assert "resolution is 1: lengths are in counts; give the travel of a count in [encoder]" in record.notes
    assert any(note.startswith("input_gain is 1, so forces are in the unit of 'u'") for note in record.notes)
    result = CliRunner().invoke(main, ["identify", str(path), "--config", str(path.with_suffix(".toml")), "--json"])
    units = {name: own["unit"] for name, own in json.loads(result.stdout)["parameters"].items()}
    assert units == {"mass": "N s2/count", "viscous_friction": "N s/count", "coulomb_friction": "N"}
    (line,) = (line for line in guess(saved("nameless", tmp_path)).text.splitlines() if line.startswith("resolution"))
    assert "TO DO: assumed to be in m or rad; otherwise write" in line
    assert 'mm" here and output_unit = "mm" in [record], or "deg" in both' in line


def test_a_resolution_in_another_unit_than_its_column_is_refused_with_the_unit(tmp_path: Path) -> None:
    path = saved("nameless", tmp_path)
    rows = pl.read_csv(path)
    written = guess(path).text
    number = float(re.search(r"^resolution = ([\d.e-]+)", written, re.MULTILINE)[1])  # type: ignore[index]
    axis = re.sub(r"^resolution = [\d.e-]+", f'resolution = "{1000 * number:.9g} mm"', written, flags=re.MULTILINE)
    output = tomllib.loads(axis)["record"]["output"]
    rows.with_columns(pl.col(output) * 1000).write_csv(path)
    (tmp_path / "mm.toml").write_text(axis, encoding="utf-8")
    refused(('output_unit = "mm"', lambda: read_record(path, load_axis(tmp_path / "mm.toml"))))
    (tmp_path / "mm.toml").write_text(axis.replace("[record]", '[record]\noutput_unit = "mm"', 1), encoding="utf-8")
    counts = read_record(path, load_axis(tmp_path / "mm.toml")).counts
    assert np.ptp(counts) == round(float(np.ptp(rows[output].to_numpy())) / number)


def test_a_time_that_starts_again_is_refused_with_its_row(tmp_path: Path) -> None:
    path = saved("nameless", tmp_path)
    rows = pl.read_csv(path)
    name = tomllib.loads(guess(path).text)["record"]["time"]
    half = rows.height // 2
    wrong = rows.with_columns(pl.col(name) - (pl.int_range(pl.len()) >= half) * 3 * rows[name][half])
    wrong.rename({name: "time"}).write_csv(path)
    refused((f"falls after row {half}", lambda: guess(path)))


def _swing(n: int, dt: float, gravity: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return torque and angle of a pendulum of 0.05 kg m2 that a random torque drives."""
    torque = np.repeat(rng.choice([-0.6, -0.3, 0.3, 0.6], n // 40 + 1), 40)[:n]
    angle, speed, seen = 0.0, 0.0, np.empty(n)
    for k in range(n):
        seen[k] = angle
        for _ in range(4):
            drag = 0.05 * speed + 0.05 * np.tanh(speed / 1e-3) + gravity * np.sin(angle)
            speed += dt / 4 * (torque[k] - drag) / 0.05
            angle += dt / 4 * speed
    return torque, seen


@pytest.mark.parametrize("gravity", [0.0, 0.5])
def test_a_pendulum_is_written_with_its_gravity_and_no_other_axis(tmp_path: Path, gravity: float) -> None:
    """Of two joints, the axis is the one that moves by its own torque; the command is not its torque."""
    rng, dt, n = np.random.default_rng(5), 0.005, 2000
    torque, angle = _swing(n, dt, gravity, rng)
    frame = {
        "time": dt * np.arange(n),
        "q": np.column_stack([np.floor(np.abs(np.sin(np.arange(n) / 900)) * 2) * 1e-3, 1e-3 * np.floor(angle / 1e-3)]),
        "tau_cmd": np.column_stack([np.zeros(n), np.roll(torque, 9)]),
        "tau_meas": np.column_stack([rng.normal(size=n), torque]),
    }
    np.savez(tmp_path / "arm.npz", **frame)
    model = guess_axis(tmp_path / "arm.npz").model
    record = guess_axis(tmp_path / "arm.npz").record
    assert (record.input, record.output) == ("tau_meas_2", "q_2")
    assert (model.axis, model.gravity) == (("rotary", True) if gravity else ("linear", False))


def test_two_topics_in_one_table_are_one_record(tmp_path: Path) -> None:
    """The rows of a command and of a state are 2 ms apart: the input was once taken for missing."""
    t, u, y = run().motion.t, run().motion.u, position()
    rows = np.full((2 * t.size, 3), np.nan)
    rows[::2], rows[1::2] = np.c_[t, u, t * np.nan], np.c_[t + 0.002, t * np.nan, np.interp(t + 0.002, t, y)]
    pl.DataFrame(dict(zip(("t", "/cmd/force", "/state/position"), rows.T, strict=True))).fill_nan(None).write_csv(
        tmp_path / "log.csv"
    )
    axis = guess_axis(tmp_path / "log.csv")
    record = kind_of(axis).read([tmp_path / "log.csv"], axis)
    assert (axis.record.input, record.dt) == ("/cmd/force", pytest.approx(0.01))
    assert record.u[:-1] == pytest.approx(0.8 * u[: record.u.size - 1] + 0.2 * u[1 : record.u.size], abs=1e-6)
    assert any("separate rows" in note for note in record.notes)


def test_a_joint_is_named_and_a_few_digits_are_no_encoder(tmp_path: Path) -> None:
    angle = [float(f"{value:.5g}") for value in 50 + 20 * np.sin(np.arange(3000) / 200)]
    frame = {"t": run().motion.t[:1000], "u1": run().motion.u[:1000], "y1": position()[:1000]}
    frame |= {"u2": run().motion.u[:1000], "y2": np.array(angle[:1000])}
    pl.DataFrame(frame).write_csv(tmp_path / "log.csv")
    text = guess(tmp_path / "log.csv", choice=NamedColumns(output="y2")).text
    assert 'input = "u2"' in text
    assert "resolution = 0.001 " in text
    refused(("did you mean 'y2'", lambda: guess(tmp_path / "log.csv", choice=NamedColumns(output="y22"))))


def test_a_servo_without_a_torque_is_refused_with_what_its_controller_gives(tmp_path: Path) -> None:
    t = np.arange(2000) * 0.01
    goal = np.sin(t**1.5)
    frame = {
        "timestamp": t,
        "position": np.roll(goal, 3),
        "goal_position": goal,
        "input_volts": 12 + 0.1 * np.sin(9 * t),
    }
    pl.DataFrame(frame).write_csv(tmp_path / "log.csv")
    refused(("add the column u = goal_position - position", lambda: guess(tmp_path / "log.csv")))


def _relay_log(path: Path, seed: int, step: float) -> None:
    """Write the log of a cart under a relay, as a test rig without a header writes it.

    The columns are time, current, position with a few decimals, and velocity by differences.
    """
    rng, dt, n = np.random.default_rng(seed), 1 / 150, 3000
    x, v, u, rows, before = 0.0, 0.0, 2.0, [], 0.0
    for k in range(n):
        u = -2.0 if x > 0.05 else 2.0 if x < -0.05 else u
        for _ in range(10):
            v += dt / 10 * (6.0 * u - 3.0 * v - 1.5 * np.tanh(v / 1e-3)) / 1.9
            x += dt / 10 * v
        seen = step * np.floor(x / step + rng.uniform(0, 1e-3)) + 0.31511
        rows.append((k * dt, u, seen, (seen - before) / dt if k else 0.0))
        before = seen
    np.savetxt(path, rows, fmt="%.5f", delimiter=", ")


@pytest.mark.parametrize(("seed", "step"), [(1, 8.8e-5), (2, 2.3e-4), (3, 1.47e-4)])
def test_a_relay_is_an_input_and_the_rounding_of_a_log_no_encoder(tmp_path: Path, seed: int, step: float) -> None:
    """The input of a relay that the position switches also fits as a velocity; five decimals are finer than the
    step.
    """
    _relay_log(tmp_path / "log.csv", seed, step)
    text = guess(tmp_path / "log.csv").text
    said = tomllib.loads(text)
    assert (said["record"]["input"], said["record"]["output"]) == ("column_2", "column_3"), text
    assert said["record"]["output_kind"] == "position"
    assert said["encoder"]["resolution"] == pytest.approx(step, rel=1e-3)


def test_a_column_in_turns_is_no_velocity(tmp_path: Path) -> None:
    """A velocity would also explain the input, but the unit decides, and another kind would be refused."""
    columns = {"t [s]": run().motion.t, "voltage [V]": run().motion.u, "position [turns]": run().motion.v}
    pl.DataFrame(columns).write_csv(tmp_path / "log.csv")
    assert tomllib.loads(guess(tmp_path / "log.csv").text)["record"]["output_kind"] == "position"


def test_a_load_is_seen_and_otherwise_asked(tmp_path: Path) -> None:
    record = run()
    columns = {"t": record.motion.t, "force [N]": record.motion.u + 5.0, "pos [m]": position()}
    pl.DataFrame(columns).write_csv(tmp_path / "log.csv")
    assert "offset = true  # a constant load" in guess(tmp_path / "log.csv").text
    assert "offset = true  # as answered" in guess(tmp_path / "log.csv", lambda question, read: read("yes")).text
    columns["force [N]"] -= 5.0
    pl.DataFrame(columns).write_csv(tmp_path / "log.csv")
    assert "offset = false  # no constant load is seen" in guess(tmp_path / "log.csv").text


@pytest.mark.parametrize(
    ("read", "text", "said"),
    [
        (read_travel, "1 furlong", "is no"),
        (read_gain, "zero", "is no"),
        (read_duration, "1 h", "is no"),
        (read_travel, "-5", "negative"),
        (read_travel, "3 rpm", "a travel is a length or an angle"),
        (read_gain, "-5", "negative"),
        (lambda text: read_gain(text, Unit("N/A", "force", 1.0)), "31 N/V", "does not fit"),
        (lambda text: read_gain(text, Unit("N m/", "torque", 1.0)), "31 N/V", "does not fit"),
        (read_yes, "perhaps", "neither y nor n"),
        (read_duration, "-5", "negative"),
    ],
)
def test_an_answer_that_does_not_fit_is_asked_again(read: Reader, text: str, said: str) -> None:
    refused((said, lambda: read(text)), kind=ValueError)


def test_what_is_left_to_do_is_said(tmp_path: Path) -> None:
    path, place = saved("counts", tmp_path), tmp_path / "AXIS.toml"
    run_command("init", str(path), "--out", str(place))
    printed = CliRunner().invoke(main, ["check", str(path), "--config", str(place)]).stdout
    assert "AXIS.toml still has the mark TO DO at resolution, input_gain" in printed


@pytest.mark.parametrize("decimals", [2, 4])
def test_the_rounded_step_of_degrees_is_a_part_of_a_turn(tmp_path: Path, decimals: int) -> None:
    """The steps 0.08789 and 0.0879 deg instead of 360/4096 deg once made each inertia wrong by many intervals."""
    run = LOGS["counts"][0]()
    degrees = np.round(np.asarray(run["counts"]) * 360 / 4096, decimals)
    pl.DataFrame({"t": run["t"], "torque": run["u"], "angle [deg]": degrees}).write_csv(tmp_path / "log.csv")
    assert 'resolution = "4096 counts/rev"' in guess(tmp_path / "log.csv").text
