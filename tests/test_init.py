"""`pmfid init` guesses columns, units, step and wrap from a record alone, and its output suffices for `identify`."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from pmfid.config.axis import Axis, load_axis
from pmfid.pipeline.guess.axis_file import guess
from pmfid.pipeline.guess.columns import step_of
from pmfid.pipeline.guess.roles import role_of
from pmfid.pipeline.identify import kind_of
from pmfid.simulation import CART, Scenario, make_scenario
from tests.command import run_command
from tests.conftest import unjudged

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


def test_the_commands_name_a_file_with_a_space_as_one_word(tmp_path: Path) -> None:
    log, axis = saved("counts", tmp_path).rename(tmp_path / "a log.csv"), tmp_path / "an axis.toml"
    done = run_command("init", log, "--out", axis)
    assert done.output.endswith(f"pmfid identify '{log}' --config '{axis}'\n")


@pytest.mark.parametrize("order", [("name", "t"), ("t", "name")])
def test_a_file_of_many_axes_gives_the_settings_of_the_first(order: tuple[str, str], tmp_path: Path) -> None:
    frame = pl.DataFrame(LOGS["counts"][0]())
    many = [frame.with_columns(pl.lit(name).alias("name")) for name in ("M1", "M2")]
    pl.concat(many).sort(order).write_parquet(tmp_path / "day.parquet")
    found = guess(tmp_path / "day.parquet")
    assert found.axes == "name"
    assert "only the rows with name = 'M1', one of 2 axes" in found.text
    assert 'time = "t"  # it grows from row to row, by a sample period of 0.01 s' in found.text


def test_each_line_has_its_reason_and_what_is_not_reported_is_marked(tmp_path: Path) -> None:
    lines = guess(saved("counts", tmp_path)).text.splitlines()
    assert all("# " in line for line in lines if "=" in line)
    marked = [line.partition(" =")[0] for line in lines if "TO DO" in line and "=" in line]
    assert marked == ["resolution", "input_gain"]


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
