"""Logs of servos: commands and positions of each joint, out of the columns of a file."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from pmfid.actuators.formats import RobotTable, read_robot_table
from pmfid.actuators.tuning import TUNING
from pmfid.errors import UsageError
from pmfid.io.tables import Table, column, times
from pmfid.records.clock import UNITS, named_unit
from pmfid.types import Flags, Floats

#: Words in the names of columns. A longer word comes before a shorter one that it contains.
TIMES = ("timestamp", "time", "stamp", "t")
# fmt: off
GOALS = (
    "goal_position", "goal", "commanded", "command", "cmd", "target", "setpoint", "desired", "reference", "action",
    "des", "ref",
)
POSITIONS = (
    "observation.state", "present_position", "measured_position", "position", "pos", "measured", "actual", "state", "q",
)
# fmt: on
#: Words that name no joint, as in "desired angle" and "measured angle".
FILLERS = ("position", "pos", "angle", "q", "present", "measured", "actual", "meas")
#: Columns that have a word of a position, but are none.
OTHERS = ("velocity", "vel", "speed", "effort", "torque", "current", "load", "acceleration")
#: Words in the names of columns of torques.
TORQUES = ("torque", "effort", "current", "tau")
#: Columns that are 0 where the torque is off.
SWITCHES = ("torque_enable", "torque_enabled")
#: Registers of servos of Dynamixel and Feetech, in steps of the encoder.
REGISTERS = re.compile(r"(goal|present)[ _]?position", re.IGNORECASE)
#: Unit of goal and position -> its size [rad]. A count is a step of the encoder.
ANGLES = {"rad": 1.0, "deg": np.pi / 180, "counts": 0.0}


@dataclass(frozen=True, eq=False)
class JointLog:
    """Times [s], goals [rad] and positions [rad] of one joint, (n,).

    `resolution` is the step of the encoder [rad], `given` holds parameters that the file states, and `notes` are
    sentences on the reading. `force` (n,) [N m] is a known torque that the motor supplies in addition to the
    model. `on` (n,) is 0 where the torque is off. `stated` is that of the file (`RobotTable`).
    """

    name: str
    t: Floats
    goal: Floats
    position: Floats
    resolution: float
    given: Mapping[str, float] = field(default_factory=dict)
    notes: Sequence[str] = ()
    force: Floats | None = None
    on: Floats | None = None
    stated: Mapping[str, str | float] = field(default_factory=dict)

    def cut(self, rows: slice | Flags) -> JointLog:
        """Return some rows."""
        force, on = (None if own is None else own[rows] for own in (self.force, self.on))
        return replace(self, t=self.t[rows], goal=self.goal[rows], position=self.position[rows], force=force, on=on)


@dataclass(frozen=True)
class LogLayout:
    """What a user says on the columns of a log. None leaves a point to the names of the columns.

    `time` is a column, `goal` and `position` are columns or patterns with one star, which stands for the joint.
    `unit` is one of `ANGLES`, `resolution` is the step of the encoder [rad], and `episode` is one of a
    data set of LeRobot. `goal_unit` is the unit of the goals alone. `known_force` are columns or patterns of torques
    [N m] that the motor supplies in addition to the model.
    """

    time: str | None = None
    goal: str | None = None
    position: str | None = None
    unit: str | None = None
    resolution: float | None = None
    episode: int | None = None
    goal_unit: str | None = None
    known_force: Sequence[str] = ()


def read_joints(path: Path, layout: LogLayout) -> list[JointLog]:
    """Return the logs of all joints of a file. Raises UsageError for a file without a goal and a position."""
    robot = read_robot_table(path, layout.episode)
    table = robot.columns
    name = layout.time or _find_time(table)
    t = times(table, name)[0] * UNITS[named_unit(name) or "s"]
    goals = _find_columns(table, layout.goal, GOALS, ())
    positions = _find_columns(table, layout.position, POSITIONS, (*goals.values(), *OTHERS))
    joints = [joint for joint in positions if joint in goals]
    if not joints:
        goals, positions = _name_bare(goals), _name_bare(positions)
        joints = [joint for joint in positions if joint in goals]
    others = [column for column in table if column not in (name, *goals.values())]
    if not joints and len(goals) == len(others) == 1:
        joints, positions = list(goals), dict(zip(goals, others, strict=True))
    if not joints:
        raise UsageError(_tell_missing(table, goals))
    forces = [_find_forces(table, pattern, joints) for pattern in layout.known_force]
    own = {joint: [found[joint] for found in forces if joint in found] for joint in joints}
    return [_make_joint(robot, t, joint, (goals[joint], positions[joint]), own[joint], layout) for joint in joints]


# --- names of columns -------------------------------------------------------------------------------------------------


def _tell_missing(table: Table, goals: Mapping[str, str]) -> str:
    """Return what to do with a table in which no joint has a goal and a position."""
    torques = [name for name in table if any(_cut(name, word) is not None for word in TORQUES)]
    if torques and not goals:
        return (
            f"the log has no goals, but torques ({torques[0]}): write an AXIS.toml with pmfid init, and use pmfid "
            "identify; or name the goals with --goal"
        )
    columns = ", ".join(list(table)[:30]) or "none"
    return (
        f"no joint has a goal and a position: the columns are {columns}; name them, as with --goal 'goal_*' "
        "--position 'position_*'"
    )


def _find_time(table: Table) -> str:
    for word in TIMES:
        for name in table:
            if re.fullmatch(rf"(.*[/.])?{word}([\s_.]?[\[(]?(s|sec|ms|us|µs|ns)[\])]?)?", name.lower()):
                return name
    raise UsageError(
        f"no time column was recognised among {', '.join(list(table)[:30]) or 'none'}: name it with --time, or add a "
        "column time_s"
    )


def _find_columns(table: Table, pattern: str | None, words: Sequence[str], others: Sequence[str]) -> dict[str, str]:
    """Return the columns of each joint, by a pattern or else by words in their names."""
    if pattern is not None:
        inside = re.compile(re.escape(pattern).replace(r"\*", "(.*)", 1))
        found = {name: inside.fullmatch(name) for name in table}
        columns = {match[1] if "*" in pattern else "": name for name, match in found.items() if match}
        if not columns:
            raise UsageError(f"no column matches {pattern!r}: available are {', '.join(list(table)[:30]) or 'none'}")
        return columns
    for word in words:
        columns = {}
        for name in table:
            if name in others or any(_cut(name, other) is not None for other in others if other in OTHERS):
                continue
            joint = _cut(name, word)
            if joint is not None:
                columns.setdefault(joint, name)
        if columns:
            return columns
    return {}


def _name_bare(columns: Mapping[str, str]) -> dict[str, str]:
    """Return the columns by the names of the joints without fillers."""
    bare: dict[str, str] = {}
    for joint, name in columns.items():
        for word in FILLERS:
            joint = joint if (left := _cut(joint, word)) is None else left
        bare.setdefault(joint, name)
    return bare


def _find_forces(table: Table, pattern: str, joints: Sequence[str]) -> dict[str, str]:
    """Return the column of a known torque by joint. Raises UsageError for a column of no joint."""
    found = _find_columns(table, pattern, (), ())
    if "*" not in pattern and len(joints) == 1:
        return dict(zip(joints, found.values(), strict=True))
    if not any(joint in joints for joint in found):
        raise UsageError(
            f"--known-force {pattern!r} matches no joint: put a star in place of the joint's name, as in 'gravity_*'; "
            f"the joints are {', '.join(joints)}"
        )
    return found


def _cut(name: str, word: str) -> str | None:
    """Return the name without a word and without a unit, or None if the word is not a part of it."""
    plain = re.sub(r"\s*[\[(][^\])]*[\])]$", "", name)
    plain = re.sub(r"[\s_.](rad|deg|counts|ticks)$", "", plain, flags=re.IGNORECASE)
    written = re.escape(word).replace("_", r"[\s_.]?")
    found = re.search(rf"(?:^|(?<=[\s_./:-])){written}(?=$|[\s_./:\d-])", plain, re.IGNORECASE)
    if found is None:
        return None
    parts = (plain[: found.start()].strip(" _./:-"), plain[found.end() :].strip(" _./:-"))
    return ".".join(part for part in parts if part)


def _own_unit(name: str) -> str | None:
    """Return the unit in a column's name, one of `ANGLES`, or None."""
    found = re.search(r"[\s_.\[(](rad|deg|degrees|counts?|ticks?)[\])]?$", name.lower())
    return None if found is None else {"d": "deg", "r": "rad"}.get(found[1][0], "counts")


def _is_register(name: str, values: Floats) -> bool:
    """Return whether a column is a register of a servo in steps, which are whole numbers beyond those of angles."""
    return bool(REGISTERS.search(name) and values.size and np.ptp(values) > 4 * math.pi and np.all(values % 1 == 0))


def decode_register(values: Floats) -> Floats:
    """Return the steps (n,) of a register whose sign may be read as its highest bit, of the reading with least travel.

    Feetech has a sign and a magnitude of 15 bits, and Dynamixel the complement of two in 16 or 32 bits.
    """
    readings = [values, np.where(values >= 2**15, 2**15 - values, values)]
    readings += [np.where(values >= 2 ** (bits - 1), values - 2.0**bits, values) for bits in (16, 32)]
    return min(readings, key=lambda reading: float(np.sum(np.abs(np.diff(reading)))))


# --- values -----------------------------------------------------------------------------------------------------------


def _make_joint(
    robot: RobotTable, t: Floats, joint: str, names: tuple[str, str], known: Sequence[str], layout: LogLayout
) -> JointLog:
    label = f"joint {joint}" if joint else "the joint"
    values = [column(robot.columns, what, name) for what, name in zip(("goal", "position"), names, strict=True)]
    forces = [column(robot.columns, "known_force", name) for name in known]
    words = {re.sub(r"\W", "_", name).lower(): name for name in robot.columns}
    switch = next((column(robot.columns, "torque", words[name]) for name in SWITCHES if name in words), None)
    if any(own.size != t.size for own in (*values, *forces)):
        raise UsageError(f"{label}: the columns of time, goal and position differ in length: export one table")
    there = (np.abs([t, *values, *forces]) < TUNING.largest_number).all(axis=0)
    if robot.unitless and layout.unit is None:
        raise UsageError("a data set of LeRobot does not state its unit: give --unit deg, or rad")
    notes = [*robot.notes, *(f"{key} is {value:.4g} by the file" for key, value in robot.given.items())]
    notes += [f"known torques are {', '.join(known)}"] if known else []
    notes += [f"{np.sum(~there)} rows without a number are left out"] if not there.all() else []
    rows = np.flatnonzero(there)
    fresh = np.append(True, np.diff(t[rows]) != 0) if rows.size else np.zeros(0, bool)
    notes += [f"{np.sum(~fresh)} rows with the stamp of the row before are left out"] if not fresh.all() else []
    rows = rows[fresh]
    scaled, resolution = [], layout.resolution
    if layout.unit is None and not any(map(_own_unit, names)) and _is_in_degrees(values[1][rows]):
        layout = replace(layout, unit="deg")
        notes.append(f"{names[1]} is taken in degrees: its steps divide a turn of 360 into a power of two")
    for name, own, said in zip(names, values, (layout.goal_unit or layout.unit, layout.unit), strict=True):
        unit = said or _own_unit(name) or ("counts" if _is_register(name, own[rows]) else "rad")
        if said is None and unit == "counts" and REGISTERS.search(name):
            own, resolution = decode_register(own), resolution or math.tau / TUNING.register
            other = "" if layout.resolution else ": give --bits if the encoder has others"
            notes.append(f"{name} is a register in steps of {resolution:.4g} rad{other}")
        if unit == "counts" and resolution is None:
            raise UsageError(f"column {name!r} is in counts: give the encoder's step with --bits or --resolution")
        scaled.append(own[rows] * (ANGLES[unit] or resolution or 1.0))
    step = resolution or find_step(scaled[1])
    if step is None:
        step = measure_scatter(scaled[1])
        notes.append(f"the positions show no step of an encoder: the fit takes their scatter of {step:.2g} rad")
    elif layout.resolution is None:
        notes.append(f"the encoder's step is {step:.4g} rad by the positions")
    since = t[rows] - (t[rows[0]] if rows.size else 0.0)
    force = np.sum(forces, axis=0)[rows] if forces else None
    on = None if switch is None or np.all(switch[rows] > 0) else np.asarray(switch[rows] > 0, float)
    notes += [f"the torque is off in {np.sum(on == 0)} rows, in which the joint moves freely"] if on is not None else []
    names_and_values = (joint or "joint", since, scaled[0], scaled[1], step, robot.given, notes, force, on)
    return JointLog(*names_and_values, robot.stated)


def _is_in_degrees(position: Floats) -> bool:
    """Return whether the steps of positions (n,) divide 360, and not 2 pi, into a power of two."""
    step = find_step(position)
    bits = 0.0 if step is None else math.log2(360.0 / step)
    return abs(bits - round(bits)) < TUNING.step_tolerance / 100 and 6 <= round(bits) <= 24


def measure_scatter(position: Floats) -> float:
    """Return the step of an encoder [rad] whose rounding is the white scatter of positions (n,).

    The scatter is that of third differences (von Neumann 1941). A joint that stands still has a step of 1.
    """
    if position.size < 5 or np.unique(position).size < 5:
        return 1.0
    change = np.diff(position, 3)
    scatter = float(np.median(np.abs(change))) / 0.6745 / math.sqrt(20.0)
    return max(scatter * math.sqrt(12.0), 1e-5 * float(np.ptp(position)))


def find_step(position: Floats) -> float | None:
    """Return the step of the encoder [rad] that divides the differences of the positions (n,), or None."""
    levels = np.unique(position)
    gaps = np.diff(levels)
    gaps = gaps[gaps > 1e-9 * max(float(np.ptp(levels)), 1e-300)] if gaps.size else gaps
    if not gaps.size:
        return None
    step = float(gaps.min())
    for multiple in TUNING.step_multiples:
        gaps_near = gaps[gaps < (multiple + 0.5) * step]
        step = float(gaps_near.sum() / np.rint(gaps_near / step).sum())
    near = np.abs(gaps_near / step - np.rint(gaps_near / step)) < TUNING.step_tolerance
    return step if gaps_near.size >= TUNING.step_levels and near.mean() >= TUNING.step_share else None
