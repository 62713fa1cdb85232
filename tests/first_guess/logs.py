"""Logs in the shapes of loggers, with the right columns of time, input and output."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pmfid.types import Floats
from tests.first_guess.bench import Signals, simulate
from tests.first_guess.writers import WRITERS

#: The logs. A line has the logger with "-" if the file has no header, the run of the bench, the columns with their
#: signals in order, and the right columns of time, input and output, or "none" for a log that shows no axis. An empty
#: time means a log without a time.
TABLE = """
scope      | open  | time=repeated; force=force; pos=fine | time; force; pos
controller | open  | Zeit=stuck; Strom=current; Lage=fine | Zeit; Strom; Lage
serial-    | open  | 1=stuck_ms; 2=duty; 3=counts | 1; 2; 3
scope      | open  | Timestamp=odd; Torque (N·m)=force; Angle (rad)=fine | Timestamp; Torque (N·m); Angle (rad)
controller-| open  | 1=odd; 2=current; 3=position | 1; 2; 3
matlab-    | open  | 1=odd; 2=force; 3=fine; 4=velocity | 1; 2; 3
serial     | open  | millis=millis; pwm=duty; enc=counts | millis; pwm; enc
serial     | open  | time=ms; pwm=duty; pulses=counts | time; pwm; pulses
serial     | open  | time(ms)=slow_ms; steps=counts; input=duty | time(ms); input; steps
controller | open  | Zeit [s]=slow; Kraft [N]=force; Weg [mm]=mm | Zeit [s]; Kraft [N]; Weg [mm]
serial     | open  | t_us=us; u=force; counts=counts | t_us; u; counts
scope      | open  | step=ms; current=current; position=fine | step; current; position
matlab     | open  | timestep=t; voltage=voltage; theta=fine | timestep; voltage; theta
matlab     | open  | u=force; y=fine | ; u; y
scope      | open  | Sample=index; Zeit (ms)=ms; Strom (A)=current; Winkel (deg)=deg\
 | Zeit (ms); Strom (A); Winkel (deg)
scope      | open  | q=fine; tau=force; t=t | t; tau; q
scope      | open  | time_exp=t; q_meas=fine; u_in=force | time_exp; u_in; q_meas
controller | open  | t=t; x_out=fine; force_in=force | t; force_in; x_out
matlab     | open  | t=t; v_in=voltage; pos=fine | t; v_in; pos
scope      | open  | t_s=t; i_in=current; encoder_in=counts | t_s; i_in; encoder_in
scope      | open  | Time (s)=t; Position (°)=deg; Torque (N⋅m)=force | Time (s); Torque (N⋅m); Position (°)
scope      | open  | Time (s)=t; Speed (rad/s)=tacho; Torque (N•m)=force | Time (s); Torque (N•m); Speed (rad/s)
controller | open  | Zeit=t; Drehmoment=force; Drehwinkel=fine | Zeit; Drehmoment; Drehwinkel
controller | servo | Zeit [ms]=ms; Sollposition [mm]=goal_mm; Istposition [mm]=mm; Motorstrom [A]=current\
 | Zeit [ms]; Motorstrom [A]; Istposition [mm]
controller | servo | Zeit=t; Lage_Soll=goal; Lage_Ist=position; Schleppfehler=error; Strom_Ist=current;\
 Strom_Soll=wanted | Zeit; Strom_Ist; Lage_Ist
scope      | open  | Zeit/s=t; Kraft/N=force; Weg/mm=mm | Zeit/s; Kraft/N; Weg/mm
controller | speed | Zeit [s]=t; Solldrehzahl [1/min]=goal_rpm; Istdrehzahl [1/min]=rpm; Moment [Nm]=force\
 | Zeit [s]; Moment [Nm]; Istdrehzahl [1/min]
scope      | open  | zeit_s=t; stellgroesse=duty; istwert=position | zeit_s; stellgroesse; istwert
controller | open  | Zeit=t; Stellgröße=duty; Zählerstand=counts | Zeit; Stellgröße; Zählerstand
matlab     | servo | t=t; q=position; q_des=goal; tau=force; tau_des=wanted | t; tau; q
scope      | servo | time=t; tau_des=wanted; i_q=current; theta=fine | time; i_q; theta
matlab     | servo | t=t; q_d=goal; q=position; u=force | t; u; q
scope      | servo | stamp=t; position=fine; velocity=tacho; effort=force; position_command=goal\
 | stamp; effort; position
scope      | speed | t=t; w_ref=goal_speed; w=tacho; iq=current | t; iq; w
scope      | servo | Time [s]=t; CommandedPosition [rad]=goal; ActualPosition [rad]=fine; CommandedTorque [N m]=wanted;\
 ActualTorque [N m]=force | Time [s]; ActualTorque [N m]; ActualPosition [rad]
matlab     | servo | t=t; tau_cmd=wanted; q=position | t; tau_cmd; q
serial     | servo | ms=ms; set=goal_counts; act=counts; out=duty | ms; out; act
scope      | open  | t=t; motor_pos=fine; load_pos=second; torque=force | t; torque; motor_pos
controller | open  | t=t; pos_mm=mm; i_A=current | t; i_A; pos_mm
scope-     | open  | 1=t; 2=current; 3=fine; 4=again | 1; 2; 3
matlab     | open  | t=t; i1=current; i1_filt=late; x=position | t; i1; x
matlab     | open  | t=t; x=position; dx=velocity; F=force | t; F; x
scope      | open  | t=t; pos=position; vel=velocity; acc=pull; F=force | t; F; pos
matlab     | servo | t=t; q=position; dq=velocity; ddq=pull; tau=force | t; tau; q
scope-     | open  | 1=t; 2=force; 3=position | 1; 2; 3
controller-| open  | 1=t; 2=fine; 3=duty | 1; 3; 2
controller-| servo | 1=t; 2=goal; 3=position; 4=current | 1; 4; 3
matlab-    | open  | 1=t; 2=force; 3=counts; 4=velocity | 1; 2; 3
scope-     | open  | 1=t; 2=tacho; 3=force | 1; 3; 2
serial-    | open  | 1=duty; 2=counts | ; 1; 2
controller | servo | Zeit=t; Temperatur=warm; Status=status; Strom=current; Position=position | Zeit; Strom; Position
scope      | servo | idx=index; time_ms=ms; bus_voltage=bus; temp=warm; speed=tacho; pos=fine; iq=current; id=ripple\
 | time_ms; iq; pos
scope      | open  | t=t; v=voltage; theta=position | t; v; theta
serial     | open  | t_ms=ms; pwm_duty=duty; enc=counts | t_ms; pwm_duty; enc
matlab     | open  | time=t; in=force; out=position | time; in; out
scope      | open  | Time(s)=t; CH1(V)=voltage; CH2(V)=position | Time(s); CH1(V); CH2(V)
matlab     | open  | t=t; u [V]=voltage; Position [V]=position | t; u [V]; Position [V]
controller | servo | t=t; F_soll=wanted; F_ist=force; x_soll=goal; x_ist=position | t; F_ist; x_ist
matlab     | speed | t=t; Ua=voltage; Ia=current; omega=tacho | t; Ia; omega
scope      | servo | t=t; w=goal; x=position; y=wanted | t; y; x
controller | servo | Zeit=t; Sollposition=goal; Motorstrom=current | none
scope      | open  | t=t; i_a=current; i_b=late; v_bus=bus | none
scope      | speed | t=t; speed_ref=goal_speed; speed=velocity | none
matlab     | speed | t=t; r=goal_speed; y=velocity | none
controller | rest  | Zeit [s]=t; Kraft [N]=force; Weg [mm]=mm | none
serial     | open  | t_ms=ms; a0=warm; a1=ripple | none
"""


@dataclass(frozen=True)
class Log:
    """A log: logger, run, columns with their signals, and names of time, input and output, or None for no axis."""

    logger: str
    run: str
    columns: dict[str, str]
    answer: tuple[str, str, str] | None

    @property
    def header(self) -> bool:
        return not self.logger.endswith("-")

    def write(self, folder: Path, seed: int) -> Path:
        """Write the log with a run of its own, and return its path."""
        signals = simulate(self.run, seed)
        rows = _rows(set(self.columns.values()))
        columns = {name: _pick(signals, source, rows) for name, source in self.columns.items()}
        return WRITERS[self.logger.rstrip("-")](folder / "log", columns, self.header)


def _rows(sources: set[str]) -> NDArray[np.intp]:
    """Return the steps of the bench that a log shows: every 5 ms, every 100 ms, uneven, or the first one 20 times."""
    if sources & {"slow", "slow_ms"}:
        return np.arange(0, 9000, 100)
    if "odd" in sources:
        return np.cumsum(np.random.default_rng(3).choice([10, 12], 800))
    rows = np.arange(0, 9000, 5)
    return np.r_[np.zeros(19, int), rows] if sources & {"stuck", "stuck_ms"} else rows


def _pick(signals: Signals, source: str, rows: NDArray[np.intp]) -> Floats:
    """Return a signal at some rows. Some sources are faulty clocks."""
    t = signals["t"][rows]
    if source == "repeated":
        return np.r_[t[:700], t[699], t[701:]]
    if source == "odd":
        return np.round(366.377 + t, 3)
    if source == "millis":  # whole milliseconds of a clock of 2.5 ms
        return np.floor(5e2 * t + 0.3)
    return signals[{"slow": "t", "slow_ms": "ms", "stuck": "t", "stuck_ms": "ms"}.get(source, source)][rows]


def _parse(line: str) -> Log:
    logger, run, columns, answer = (part.strip() for part in line.split("|"))
    pairs = [pair.rpartition("=") for pair in columns.split(";")]
    signals = {name.strip(): source.strip() for name, _, source in pairs}
    if answer == "none":
        return Log(logger, run, signals, None)
    stem = "" if not logger.endswith("-") else "data_" if "matlab" in logger else "column_"
    time, u, y = (f"{stem}{name.strip()}" if name.strip() else "" for name in answer.split(";"))
    return Log(logger, run, signals, (time, u, y))


LOGS = [_parse(line) for line in TABLE.strip().splitlines()]
