"""Sixty logs with the right columns of time, input and output."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pmfid.types import Floats
from tests.first_guess.bench import STEP, Signals, simulate
from tests.first_guess.writers import WRITERS

#: A signal of the bench by name, or a function of the signals.
Source = str | Callable[[Signals], Floats]


@dataclass(frozen=True)
class Log:
    """A log with its columns in order, and the names of time, input and output.

    The time is empty without a time column. If `answer` is None, the log shows no axis and must be refused.
    """

    logger: str
    run: str
    columns: dict[str, Source]
    answer: tuple[str, str, str] | None
    header: bool = True
    every: int = 5
    bare: bool = False

    def write(self, folder: Path, seed: int) -> Path:
        signals = simulate(self.run, seed)
        rows = _rows_of(self)
        picked = {name: value[rows] for name, value in signals.items()}
        picked["elapsed"] = picked["t"]
        columns = {
            name: np.asarray(picked[source] if isinstance(source, str) else source(picked), float)
            for name, source in self.columns.items()
        }
        return WRITERS[self.logger](folder / "log", columns, self.header)

    @property
    def named(self) -> tuple[str, str, str] | None:
        """The right columns with the names that a file without a header has."""
        if self.header or self.answer is None:
            return self.answer
        stem = "data" if self.logger == "matlab" else "column"
        places = {name: f"{stem}_{k}" for k, name in enumerate(self.columns, 1)} | {"": ""}
        time, u, y = self.answer
        return places[time], places[u], places[y]


def _rows_of(log: Log) -> Floats:
    rows = np.arange(0, 9000, log.every)
    if "odd" in log.columns.values() or any(source is odd for source in log.columns.values()):
        steps = np.random.default_rng(3).choice([10, 12], 900)
        rows = np.cumsum(steps)
    if any(source in (stuck, stuck_ms) for source in log.columns.values()):
        rows = np.r_[np.zeros(19, int), rows]
    return rows


def odd(s: Signals) -> Floats:
    """Return times with an odd offset."""
    return np.round(366.377 + s["t"], 3)


def stuck(s: Signals) -> Floats:
    """Return times whose first 20 rows are equal, as are all columns."""
    return s["t"]


def stuck_ms(s: Signals) -> Floats:
    return np.round(1e3 * s["t"])


def repeated(s: Signals) -> Floats:
    """Return times with one repeated stamp."""
    t = s["t"].copy()
    t[700] = t[699]
    return t


def ms(s: Signals) -> Floats:
    return 1e3 * s["t"]


def us(s: Signals) -> Floats:
    return np.round(1e6 * s["t"]) + 4_120_008


def millis(s: Signals) -> Floats:
    """Return whole milliseconds of a period of 2.5 ms, which the rows of 5 ms stretch to."""
    return np.floor(5e2 * s["t"] + 0.3)


def scaled(name: str, factor: float, offset: float = 0.0) -> Callable[[Signals], Floats]:
    """Return a signal in another unit."""
    return lambda s: factor * s[name] + offset


def steps_of(name: str, step: float) -> Callable[[Signals], Floats]:
    """Return a signal in steps of an encoder."""
    return lambda s: np.floor(s[name] / step) * step


def lagged(name: str, rows: int) -> Callable[[Signals], Floats]:
    """Return a signal that is late by some rows."""
    return lambda s: np.r_[np.full(rows, s[name][0]), s[name][:-rows]]


rad, deg, mm = steps_of("position", 1e-4), scaled("position", 180 / np.pi), scaled("position", 1e3)

LOGS: dict[str, Log] = {
    # The time column
    "one repeated stamp": Log("scope", "open", {"time": repeated, "force": "force", "pos": rad}, ("time", "force", "pos")),
    "equal rows at the start": Log("controller", "open", {"Zeit": stuck, "Strom": "current", "Lage": rad}, ("Zeit", "Strom", "Lage")),
    "equal rows, in ms, no header": Log("serial", "open", {"a": stuck_ms, "b": "duty", "c": "counts"}, ("a", "b", "c"), header=False),
    "odd offset": Log("scope", "open", {"Timestamp": odd, "Torque (N·m)": "force", "Angle (rad)": rad}, ("Timestamp", "Torque (N·m)", "Angle (rad)")),
    "odd offset, no header": Log("controller", "open", {"a": odd, "b": "current", "c": "position"}, ("a", "b", "c"), header=False),
    "odd offset, matrix": Log("matlab", "open", {"a": odd, "b": "force", "c": rad, "d": "velocity"}, ("a", "b", "c"), header=False),
    "whole ms": Log("serial", "open", {"millis": millis, "pwm": "duty", "enc": "counts"}, ("millis", "pwm", "enc")),
    "whole ms, no name": Log("serial", "open", {"time": ms, "pwm": "duty", "pulses": "counts"}, ("time", "pwm", "pulses")),
    "slow ms": Log("serial", "open", {"time(ms)": ms, "steps": "counts", "input": "duty"}, ("time(ms)", "input", "steps"), every=100),
    "slow s": Log("controller", "open", {"Zeit [s]": "t", "Kraft [N]": "force", "Weg [mm]": mm}, ("Zeit [s]", "Kraft [N]", "Weg [mm]"), every=100),
    "us": Log("serial", "open", {"t_us": us, "u": "force", "counts": "counts"}, ("t_us", "u", "counts")),
    "steps are the time": Log("scope", "open", {"step": ms, "current": "current", "position": rad}, ("step", "current", "position")),
    "timestep": Log("matlab", "open", {"timestep": "t", "voltage": "voltage", "theta": rad}, ("timestep", "voltage", "theta")),
    "no time": Log("matlab", "open", {"u": "force", "y": rad}, ("", "u", "y")),
    "sample number and time": Log("scope", "open", {"Sample": "index", "Zeit (ms)": ms, "Strom (A)": "current", "Winkel (deg)": deg}, ("Zeit (ms)", "Strom (A)", "Winkel (deg)")),
    "time last": Log("scope", "open", {"q": rad, "tau": "force", "t": "t"}, ("t", "tau", "q")),
    # Names of input and output
    "u_in": Log("scope", "open", {"time_exp": "t", "q_meas": rad, "u_in": "force"}, ("time_exp", "u_in", "q_meas")),
    "force_in": Log("controller", "open", {"t": "t", "x_out": rad, "force_in": "force"}, ("t", "force_in", "x_out")),
    "v_in": Log("matlab", "open", {"t": "t", "v_in": "voltage", "pos": rad}, ("t", "v_in", "pos")),
    "i_in_A": Log("scope", "open", {"t_s": "t", "i_in": "current", "encoder_in": "counts"}, ("t_s", "i_in", "encoder_in")),
    "torque with a dot": Log("scope", "open", {"Time (s)": "t", "Position (°)": deg, "Torque (N⋅m)": "force"}, ("Time (s)", "Torque (N⋅m)", "Position (°)")),
    "torque with a bullet": Log("scope", "open", {"Time (s)": "t", "Speed (rad/s)": "tacho", "Torque (N•m)": "force"}, ("Time (s)", "Torque (N•m)", "Speed (rad/s)")),
    "German plain": Log("controller", "open", {"Zeit": "t", "Drehmoment": "force", "Drehwinkel": rad}, ("Zeit", "Drehmoment", "Drehwinkel")),
    "German units": Log("controller", "servo", {"Zeit [ms]": ms, "Sollposition [mm]": scaled("goal", 1e3), "Istposition [mm]": mm, "Motorstrom [A]": "current"}, ("Zeit [ms]", "Motorstrom [A]", "Istposition [mm]")),
    "German drive": Log("controller", "servo", {"Zeit": "t", "Lage_Soll": "goal", "Lage_Ist": "position", "Schleppfehler": "error", "Strom_Ist": "current", "Strom_Soll": "wanted"}, ("Zeit", "Strom_Ist", "Lage_Ist")),
    "German force": Log("scope", "open", {"Zeit/s": "t", "Kraft/N": "force", "Weg/mm": mm}, ("Zeit/s", "Kraft/N", "Weg/mm")),
    "German speed": Log("controller", "speed", {"Zeit [s]": "t", "Solldrehzahl [1/min]": scaled("goal_speed", 30 / np.pi), "Istdrehzahl [1/min]": scaled("tacho", 30 / np.pi), "Moment [Nm]": "force"}, ("Zeit [s]", "Moment [Nm]", "Istdrehzahl [1/min]")),
    "German actuating": Log("scope", "open", {"zeit_s": "t", "stellgroesse": "duty", "istwert": "position"}, ("zeit_s", "stellgroesse", "istwert")),
    "umlauts": Log("controller", "open", {"Zeit": "t", "Stellgröße": "duty", "Zählerstand": "counts"}, ("Zeit", "Stellgröße", "Zählerstand")),
    # Set points and commands next to measured columns
    "tau_des": Log("matlab", "servo", {"t": "t", "q": "position", "q_des": "goal", "tau": "force", "tau_des": "wanted"}, ("t", "tau", "q")),
    "tau_des next to a current": Log("scope", "servo", {"time": "t", "tau_des": "wanted", "i_q": "current", "theta": rad}, ("time", "i_q", "theta")),
    "q_d": Log("matlab", "servo", {"t": "t", "q_d": "goal", "q": "position", "u": "force"}, ("t", "u", "q")),
    "joint states": Log("scope", "servo", {"stamp": "t", "position": rad, "velocity": "tacho", "effort": "force", "position_command": "goal"}, ("stamp", "effort", "position")),
    "reference first": Log("scope", "speed", {"t": "t", "w_ref": "goal_speed", "w": "tacho", "iq": "current"}, ("t", "iq", "w")),
    "command and measured": Log("scope", "servo", {"Time [s]": "t", "CommandedPosition [rad]": "goal", "ActualPosition [rad]": rad, "CommandedTorque [N m]": "wanted", "ActualTorque [N m]": "force"}, ("Time [s]", "ActualTorque [N m]", "ActualPosition [rad]")),
    "only the command": Log("matlab", "servo", {"t": "t", "tau_cmd": "wanted", "q": "position"}, ("t", "tau_cmd", "q")),
    "set, actual": Log("serial", "servo", {"ms": ms, "set": scaled("goal", 1e4), "act": "counts", "out": "duty"}, ("ms", "out", "act")),
    # Copies and second sensors
    "two encoders": Log("scope", "open", {"t": "t", "motor_pos": rad, "load_pos": "second", "torque": "force"}, ("t", "torque", "motor_pos")),
    "two units": Log("controller", "open", {"t": "t", "pos_mm": mm, "pos_inc": "counts", "i_A": "current"}, ("t", "i_A", "pos_mm")),
    "two sensors, no header": Log("scope", "open", {"a": "t", "b": "current", "c": rad, "d": lambda s: s["position"] + 1e-5 * np.sin(s["t"])}, ("a", "b", "c"), header=False),
    "two currents": Log("matlab", "open", {"t": "t", "i1": "current", "i1_filt": lagged("current", 2), "x": "position"}, ("t", "i1", "x")),
    "velocity too": Log("matlab", "open", {"t": "t", "x": "position", "dx": "velocity", "F": "force"}, ("t", "F", "x")),
    "acceleration too": Log("scope", "open", {"t": "t", "pos": "position", "vel": "velocity", "acc": "pull", "F": "force"}, ("t", "F", "pos")),
    "q dq ddq": Log("matlab", "servo", {"t": "t", "q": "position", "dq": "velocity", "ddq": "pull", "tau": "force"}, ("t", "tau", "q")),
    # Without a header
    "three columns": Log("scope", "open", {"a": "t", "b": "force", "c": "position"}, ("a", "b", "c"), header=False),
    "three columns, output first": Log("controller", "open", {"a": "t", "b": rad, "c": "duty"}, ("a", "c", "b"), header=False),
    "four columns": Log("controller", "servo", {"a": "t", "b": "goal", "c": "position", "d": "current"}, ("a", "d", "c"), header=False),
    "four columns, matrix": Log("matlab", "open", {"a": "t", "b": "force", "c": "counts", "d": "velocity"}, ("a", "b", "c"), header=False),
    "velocity, no header": Log("scope", "open", {"a": "t", "b": "tacho", "c": "force"}, ("a", "c", "b"), header=False),
    "two columns, no header": Log("serial", "open", {"a": "duty", "b": "counts"}, ("", "a", "b"), header=False),
    # Other columns next to the axis
    "temperature and status": Log("controller", "servo", {"Zeit": "t", "Temperatur": "warm", "Status": "status", "Strom": "current", "Position": "position"}, ("Zeit", "Strom", "Position")),
    "many": Log("scope", "servo", {"idx": "index", "time_ms": ms, "bus_voltage": lambda s: 24 + 0.02 * np.sin(s["t"]), "temp": "warm", "speed": "tacho", "pos": rad, "iq": "current", "id": lambda s: 0.02 * np.cos(7 * s["t"])}, ("time_ms", "iq", "pos")),
    "voltage": Log("scope", "open", {"t": "t", "v": "voltage", "theta": "position"}, ("t", "v", "theta")),
    "duty": Log("serial", "open", {"t_ms": ms, "pwm_duty": "duty", "enc": "counts"}, ("t_ms", "pwm_duty", "enc")),
    "in, out": Log("matlab", "open", {"time": "t", "in": "force", "out": "position"}, ("time", "in", "out")),
    # Logs without a measured motion, or without a force
    "only set points": Log("controller", "servo", {"Zeit": "t", "Sollposition": "goal", "Motorstrom": "current"}, None),
    "only currents": Log("scope", "open", {"t": "t", "i_a": "current", "i_b": lagged("current", 3), "v_bus": "voltage"}, None),
    "no force": Log("scope", "speed", {"t": "t", "speed_ref": "goal_speed", "speed": "velocity"}, None),
    "set point to speed": Log("matlab", "speed", {"t": "t", "r": "goal_speed", "y": "velocity"}, None),
    "at rest": Log("controller", "rest", {"Zeit [s]": "t", "Kraft [N]": "force", "Weg [mm]": mm}, None),
}
