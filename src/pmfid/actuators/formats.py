"""Formats of robots: data sets of LeRobot, folders of SAGE, logs of BAM and bags of ROS, as tables of columns."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import count, takewhile
from pathlib import Path

import numpy as np

from pmfid.actuators.tuning import TUNING
from pmfid.errors import UsageError
from pmfid.io.tables import ClockedSignals, Table, column
from pmfid.types import Floats


@dataclass(frozen=True, eq=False)
class RobotTable:
    """Columns of a log, parameters that the file states, and notes. `unitless` means that no unit is stated.

    `stated` has what a test bench states in addition: `motor`, `kp` in the unit of the firmware, and the inertia of the
    pendulum [kg m2].
    """

    columns: Table
    given: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    unitless: bool = False
    stated: Mapping[str, str | float] = field(default_factory=dict)


def read_robot_table(path: Path, episode: int | None) -> RobotTable:
    """Read a log of any format. `episode` is one of a data set; None is the longest one of its largest file."""
    if (path / "meta" / "info.json").is_file():
        return _read_lerobot(path, episode)
    if episode is not None:
        raise UsageError("only a data set of LeRobot has episodes: leave --episode out")
    if (path / "control.csv").is_file() and (path / "state_motor.csv").is_file():
        return _read_sage(path)
    if path.suffix.lower() == ".json":
        return _read_bam(path)
    from pmfid.io.reading import read_table

    table = read_table(path)
    return _pair_topics(table) if isinstance(table, ClockedSignals) else RobotTable(table)


#: Fields with the position and the command of each joint, the surest first: the state of a controller of ros2_control
#: has both, and a bag with the states of the joints has the command in another topic.
FIELDS = (
    (r"\.(?:feedback|actual)\.positions\.(\d+)", r"\.(?:reference|desired)\.positions\.(\d+)"),
    (r"\.position\.(\d+)", r"\.points\.0\.positions\.(\d+)"),
    (r"\.position\.(\d+)", r"\.data\.(\d+)"),
    (r"\.position\.(\d+)", r"\.position\.(\d+)"),
)


def _pair_topics(table: ClockedSignals) -> RobotTable:
    """Return the goals and positions of a bag of ROS on the clock of the positions, by the number of the joint.

    The goal is held until the next one. The state and the command must have their joints in one order.
    """
    for fields in FIELDS:
        seen, sent = (_group_elements(table, field) for field in fields)
        state = next((topic for topic in seen if fields[0] != fields[1] or "state" in topic), None)
        command = next((topic for topic in sent if topic != state or fields[0] != fields[1]), None)
        if state is None or command is None:
            continue
        names = {
            number: (sent[command][number], name) for number, name in seen[state].items() if number in sent[command]
        }
        if names:
            aligned = table.align(next(iter(seen[state].values())), tuple(goal for goal, _ in names.values()))
            columns = {"time": column(aligned, "time", "time")}
            for number, (goal, position) in names.items():
                columns |= {f"goal.{number}": column(aligned, "goal", goal)}
                columns |= {f"position.{number}": column(aligned, "position", position)}
            return RobotTable(columns, notes=(f"positions are those of {state}, and goals those of {command}",))
    return RobotTable(table)


def _group_elements(table: ClockedSignals, field: str) -> dict[str, dict[str, str]]:
    """Return the columns of a field by topic and number of the element."""
    found: dict[str, dict[str, str]] = {}
    for name in table:
        match = re.search(field + "$", name)
        if match:
            found.setdefault(name[: match.start()], {})[match[1]] = name
    return found


@contextmanager
def _refuse(kind: str) -> Iterator[None]:
    """Turn errors of a file with other contents into a UsageError."""
    try:
        yield
    except OSError as error:
        raise UsageError(f"cannot read the log: {error.strerror}; give the path of a data file") from None
    except (ValueError, KeyError, TypeError, IndexError, AttributeError, RecursionError, csv.Error):
        raise UsageError(
            f"this path is no {kind}: export the log as CSV with columns of time, goals and positions"
        ) from None


def _read_bam(path: Path) -> RobotTable:
    """Read a log of BAM, whose pendulum states its mass [kg] and length [m]. Rows without torque swing freely."""
    with _refuse("log of BAM with mass, length and entries"):
        content = json.loads(path.read_text("utf-8"))
        entries = content["entries"]
        names = [name for name, value in entries[0].items() if isinstance(value, int | float)]
        table = {name: np.array([float(entry[name]) for entry in entries]) for name in names}
        mass, length = float(content["mass"]), float(content["length"])
        torque = mass * TUNING.free_fall * length
        stated = {key: content[key] for key in ("motor", "kp") if isinstance(content.get(key), str | int | float)}
    stated["pendulum"] = mass * length**2
    return RobotTable(table, {"gravity": torque} if torque > 0 else {}, stated=stated)


def _read_sage(folder: Path) -> RobotTable:
    """Read a folder with commands and states, each on a clock of its own. A goal is held until the next one."""
    with _refuse("folder of SAGE with control.csv, state_motor.csv and joint_list.txt"):
        names = [line.strip() for line in (folder / "joint_list.txt").read_text("utf-8").splitlines() if line.strip()]
        stamps, goals = _read_rows(folder / "control.csv")
        t, positions = _read_rows(folder / "state_motor.csv")
        last = np.searchsorted(stamps, t, side="right") - 1
        t, positions, last = t[last >= 0], positions[last >= 0], last[last >= 0]
        table = {"time": t}
        for index, name in enumerate(names):
            table |= {f"goal.{name}": goals[last, index], f"position.{name}": positions[:, index]}
    return RobotTable(table, notes=("goals have stamps of their own: the last one is taken at each position",))


def _read_rows(path: Path) -> tuple[Floats, Floats]:
    """Return times (n,) [s] and positions (n, joints) of a file of SAGE. Real robots have stamps in microseconds."""
    with path.open(encoding="utf-8", newline="") as file:
        rows = [(float(row["timestamp"]), json.loads(row["positions"])) for row in csv.DictReader(file)]
    t = np.array([row[0] for row in rows])
    return t * (1e-6 if t.max() > TUNING.longest_log else 1.0), np.array([row[1] for row in rows], dtype=float)


# --- LeRobot ----------------------------------------------------------------------------------------------------------


def _read_lerobot(folder: Path, episode: int | None) -> RobotTable:
    """Read one episode. Version 2 has one file for each, version 3 has files with many."""
    from pmfid.io.reading import read_table

    with _refuse("data set of LeRobot"):
        features = json.loads((folder / "meta" / "info.json").read_text("utf-8"))["features"]
        labels = {key: _list_names(features[key]) for key in ("action", "observation.state")}
    for path in _list_files(folder, episode):
        table = read_table(path)
        numbers = column(table, "episode", "episode_index")
        values, counts = np.unique(numbers[np.isfinite(numbers)], return_counts=True)
        longest = float(values[np.argmax(counts)]) if values.size else 0.0
        chosen = longest if episode is None else float(episode)
        rows = np.flatnonzero(numbers == chosen)
        if rows.size:
            columns = {"timestamp": column(table, "time", "timestamp")[rows]}
            for key, own in labels.items():
                columns |= {name: values[rows] for name, values in _list_elements(table, key, own).items()}
            note = f"episode {chosen:.0f} of the data set, {rows.size} samples"
            return RobotTable(columns, notes=(note,), unitless=True)
    raise UsageError(f"the data set has no episode {episode}: its folder data contains other episodes")


def _list_elements(table: Table, key: str, labels: Sequence[str]) -> dict[str, Floats]:
    """Return the elements of a column of lists, each as a column (n,) with the name of its joint."""
    numbers = takewhile(lambda number: f"{key}.{number}" in table, count())
    named = {number: labels[number] if number < len(labels) else str(number) for number in numbers}
    return {f"{key}.{label}": column(table, "joint", f"{key}.{number}") for number, label in named.items()}


def _list_names(feature: Mapping[str, object]) -> list[str]:
    """Return the names of the joints, which are a list, or a list in a dict. A name may end in ".pos"."""
    names = feature.get("names") or []
    if isinstance(names, dict):
        names = next(iter(names.values()))
    return [str(name).removesuffix(".pos") for name in names] if isinstance(names, list) else []


def _list_files(folder: Path, episode: int | None) -> list[Path]:
    paths = sorted((folder / "data").rglob("*.parquet"))
    if not paths:
        raise UsageError("the data set has no Parquet file in its folder data: download the complete data set")
    if episode is None:
        return [max(paths, key=lambda path: path.stat().st_size)]
    return [path for path in paths if path.stem == f"episode_{episode:06d}"] or paths
