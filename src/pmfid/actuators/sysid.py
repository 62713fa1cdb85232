"""Logs of WPILib SysId: voltage and position of a mechanism in four runs, and its feedforward gains.

    V = kS sign(v) + kV v + kA dv/dt, + kG for an elevator, + kG cos(angle) for an arm

A file has the keys `sysid`, `test`, `units` and `unitsPerRotation`, and for each run rows of time [s], voltage [V],
position [rotations] and velocity [rotations/s] (docs/data-collection.md of github.com/wpilibsuite/sysid).
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pmfid._body import BASE
from pmfid.actuators.logs import find_step, measure_scatter
from pmfid.actuators.tuning import TUNING
from pmfid.errors import UsageError
from pmfid.findings import Finding, Judged, sort_findings, texts
from pmfid.fit.findings import findings_of
from pmfid.fit.fit import Fitted, fit
from pmfid.fit.machine import COULOMB, MASS, OFFSET, VISCOUS, BodyForce, BodyModel, Excitation
from pmfid.fit.problem import FitProblem, ObservedStretch
from pmfid.presentation import PresentableParameters, Summary, format_pair, plain_dict, remarks_of
from pmfid.types import Floats

RUNS = ("slow-forward", "slow-backward", "fast-forward", "fast-backward")
#: Columns of voltage and position of each mechanism, by the length of a row.
COLUMNS: Mapping[int, Mapping[str, tuple[int, int]]] = {
    4: {"mechanism": (1, 2)},
    9: {"left": (1, 3), "right": (2, 4)},
}
UNITS = {"meters": "m", "feet": "ft", "inches": "in", "radians": "rad", "degrees": "deg", "rotations": "turn"}


@dataclass(frozen=True, eq=False)
class SysIdLog:
    """Runs of a mechanism: times [s], voltages [V] and positions [unit], (n,) each. `turn` is a rotation [unit], and
    `test` is the kind of mechanism in lower case. `notes` are sentences on the reading."""

    name: str
    test: str
    unit: str
    turn: float
    runs: tuple[tuple[Floats, Floats, Floats], ...]
    notes: tuple[str, ...]


@dataclass(frozen=True, repr=False)
class Feedforward(PresentableParameters, Judged):
    """Feedforward gains of a mechanism by name, with standard errors [V and the unit of the position].

    `residual` is the root mean square of the simulated minus the measured position [unit].
    """

    name: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    theta: Floats
    theta_std: Floats
    residual: float
    findings: tuple[Finding, ...]
    notes: tuple[str, ...]

    @property
    def rows(self) -> list[list[str]]:
        """Rows of mechanism, gain, value, standard error and unit."""
        values = zip(self.names, self.theta.tolist(), self.theta_std.tolist(), self.units, strict=True)
        return [[self.name, name, *format_pair(value, std), unit] for name, value, std, unit in values]

    @property
    def lines(self) -> list[str]:
        """The status and the findings, one line each."""
        found = [line for finding in self.findings for line in finding.lines]
        return [f"{self.name}: status: {', '.join(self.status) or 'none'}", *(f"  {line}" for line in found)]

    def summary(self) -> Summary:
        """Return the title, the table and the remarks of the result."""
        title = f"{self.name}: deviation of the simulated motion {self.residual:.3g} (rms)"
        return self._parameters.summary(title, remarks_of(self.status, texts(self.findings)))

    def to_dict(self) -> dict[str, object]:
        """Return the result as text, numbers, lists and dicts."""
        content = {"parameters": self._parameters.content, "residual": self.residual, "status": list(self.status)}
        more = {"findings": [finding.to_json() for finding in self.findings], "notes": list(self.notes)}
        return plain_dict(content | more)

    def to_wpilib(self) -> dict[str, object]:
        """Return the gains and their standard errors by the names of WPILib."""
        std = dict(zip(self.names, self.theta_std.tolist(), strict=True))
        return {**dict(zip(self.names, self.theta.tolist(), strict=True)), "std": std}


def is_sysid(path: Path) -> bool:
    """Return whether a file is a log of SysId in JSON."""
    if path.suffix.lower() != ".json":
        return False
    try:
        content = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(content, dict) and ("sysid" in content or any(name in content for name in RUNS))


def read_sysid(path: Path) -> list[SysIdLog]:
    """Return the mechanisms of a log. Raises UsageError for a file without the four runs."""
    content = json.loads(path.read_text("utf-8"))
    missing = [name for name in RUNS if not content.get(name)]
    if missing:
        raise UsageError(f"the SysId log has no run {missing[0]!r}: record all four tests, and save them in one file")
    test, said = str(content.get("test", "Simple")).lower(), str(content.get("units", "Rotations")).lower()
    if "angular" in test:
        raise UsageError("this is an angular test of a drivetrain: record its linear test instead")
    if said not in UNITS:
        raise UsageError(f"unknown units {said!r} in the SysId log: use one of {', '.join(UNITS)}")
    runs = [_read_rows(name, content[name]) for name in RUNS]
    turn = content.get("unitsPerRotation", 1.0)
    if not isinstance(turn, int | float) or not (math.isfinite(turn) and turn > 0):
        raise UsageError(f"unitsPerRotation must be a positive number, got {turn!r}: correct it in the SysId log")
    width = runs[0].shape[1]
    return [_make_log(name, test, UNITS[said], float(turn), runs, columns) for name, columns in COLUMNS[width].items()]


def _read_rows(name: str, rows: object) -> Floats:
    """Return the rows (n, 4 or 9) of a run, in the order of time."""
    try:
        table = np.array(rows, dtype=float)
    except (TypeError, ValueError):
        table = np.zeros(0)
    if table.ndim != 2 or table.shape[1] not in COLUMNS or not np.isfinite(table).all():
        raise UsageError(
            f"the rows of run {name!r} are not time, voltage, position and velocity: save the log with SysId again"
        )
    _, first = np.unique(table[:, 0], return_index=True)
    if first.size < 10:
        raise UsageError(f"run {name!r} has {first.size} times, but 10 are needed: record a longer run")
    return np.asarray(table[first])


def _make_log(name: str, test: str, unit: str, turn: float, tables: list[Floats], columns: tuple[int, int]) -> SysIdLog:
    runs, turned = [], []
    for run, table in zip(RUNS, tables, strict=True):
        volts, position = table[:, columns[0]], turn * table[:, columns[1]]
        if np.sum(volts) * (position[-1] - position[0]) < 0:
            volts = -volts
            turned.append(run)
        runs.append((table[:, 0] - table[0, 0], volts, position))
    notes = [f"the voltage of run {run} has the sign of the motion, as in SysId" for run in turned]
    return SysIdLog(name, test, unit, turn, tuple(runs), tuple(notes))


def fit_sysid(log: SysIdLog, resolution: float | None = None) -> Feedforward:
    """Estimate the gains of a mechanism. `resolution` is the step of the encoder [unit]; None finds it.

    Raises NotIdentifiableError if the mechanism does not move, or if no motion of a mechanism follows the runs.
    """
    positions = np.concatenate([position - position[0] for _, _, position in log.runs])
    step = resolution or find_step(positions) or max(measure_scatter(position) for _, _, position in log.runs)
    stretches = tuple(_observe(*run) for run in log.runs)
    with np.errstate(all="ignore"):  # motions far from the runs may overflow
        fitted = fit(FitProblem(_body_of(log), stretches, step))
    return _conclude(log, fitted)


def _observe(t: Floats, volts: Floats, position: Floats) -> ObservedStretch:
    """Return a run as observations. A voltage acts until the next row."""
    rows, flags = np.arange(t.size, dtype=np.int32), np.ones(t.size, bool)
    drive = Excitation(np.diff(t), np.ascontiguousarray(volts[:-1]), rows, np.zeros((0, t.size - 1)))
    return ObservedStretch(drive, position, np.full(t.size, 1 / 12), flags, ~flags)


def _body_of(log: SysIdLog) -> BodyModel:
    """Return the body of a mechanism: mass kA, viscous friction kV, Coulomb friction kS and a load."""
    names, rows, forces = ["kA", "kV", "kS"], [MASS, VISCOUS, COULOMB], tuple[BodyForce, ...]()
    if "elevator" in log.test:
        names, rows = [*names, "kG"], [*rows, OFFSET]
    elif "arm" in log.test:
        forces = (BodyForce("wave", log.turn), BodyForce("wave", log.turn, math.pi / 2))
        names, rows = [*names, "sine", "cosine"], [*rows, BASE, BASE + 1]
    lift = np.zeros((BASE + len(forces), len(names)))
    lift[rows, range(len(names))] = 1.0
    lowest = np.array([-np.inf, 0.0, 0.0, *[-np.inf] * (len(names) - 3)])
    turn = log.turn if forces else 0.0
    # kS is the voltage that moves the mechanism, with a dead zone of the motor controller
    return BodyModel(tuple(names), forces, np.zeros(len(lift)), lift, 0, lowest, turn, within=("dead_zone",))


def _conclude(log: SysIdLog, fitted: Fitted) -> Feedforward:
    values = dict(_read_gains(log, fitted))
    names = ("kS", "kV", "kA", *(name for name in values if name not in ("kS", "kV", "kA")))
    units = {"kS": "V", "kV": f"V s/{log.unit}", "kA": f"V s2/{log.unit}", "kG": "V", "kG_angle": log.unit}
    size = np.maximum(np.abs(fitted.theta), 1e-300)
    positive = np.arange(size.size) < 3
    findings = sort_findings(findings_of(fitted, fitted.problem.machine.names, positive, size, TUNING.negligible))
    rms = fitted.problem.resolution * math.sqrt(float(np.mean(np.concatenate(fitted.residuals) ** 2)))
    theta, std = (np.array([values[name][k] for name in names]) for k in (0, 1))
    named = tuple(units[name] for name in names)
    return Feedforward(log.name, names, named, theta, std, rms, tuple(findings), log.notes)


def _read_gains(log: SysIdLog, fitted: Fitted) -> Iterator[tuple[str, tuple[float, float]]]:
    """Yield each gain with its value and standard error. An arm has its largest load, and the position at which the
    load is that."""
    std, theta = fitted.half / TUNING.normal, fitted.theta
    for k, name in enumerate(fitted.problem.machine.names):
        if name not in ("sine", "cosine"):
            yield name, (float(theta[k]), float(std[k]))
    if fitted.problem.machine.forces:
        sine, cosine = float(theta[-2]), float(theta[-1])
        size, radian = math.hypot(sine, cosine), log.turn / (2 * math.pi)
        along = math.hypot(sine * std[-2], cosine * std[-1]) / size
        across = math.hypot(cosine * std[-2], sine * std[-1]) / size
        yield "kG", (size, along)
        yield "kG_angle", (radian * math.atan2(sine, cosine), radian * across / size)
