"""All joints of a log: the fit of each one, or the reason why it has none."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from pmfid.actuators.checks import check_joint
from pmfid.actuators.fit import ServoFit, fit_servo
from pmfid.actuators.logs import JointLog
from pmfid.actuators.servo import Servo
from pmfid.errors import PmfidError, UsageError

HEADER = ("joint", "parameter", "value", "std", "unit")


@dataclass(frozen=True)
class FittedJoint:
    """A joint of a log with its fit, or with the reason of a refusal."""

    log: JointLog
    fit: ServoFit | None
    refused: str = ""

    @property
    def status(self) -> str:
        """One line on the result."""
        if self.fit is None:
            return f"refused: {self.refused}"
        return ", ".join(self.fit.status) or "none"

    @property
    def lines(self) -> list[str]:
        """The status and the findings, one line each."""
        found = [line for finding in self.fit.findings for line in finding.lines] if self.fit else []
        return [f"{self.log.name}: status: {self.status}", *(f"  {line}" for line in found)]

    @property
    def rows(self) -> list[list[str]]:
        """Rows of the table with the columns of `HEADER`."""
        if self.fit is None:
            return [[self.log.name, "refused", "", "", ""]]
        found = zip(self.fit.names, self.fit.theta, self.fit.theta_std, self.fit.units, strict=True)
        return [[self.log.name, name, *format_pair(value, std), unit] for name, value, std, unit in found]

    def to_dict(self) -> dict[str, object]:
        """Return the result as text, numbers, lists and dicts."""
        own: dict[str, object] = {"resolution": self.log.resolution, "samples": self.log.t.size}
        own |= {"notes": list(self.log.notes)}
        return own | (self.fit.to_dict() if self.fit else {"refused": self.refused})


def format_pair(value: float, std: float) -> tuple[str, str]:
    """Return an estimate and its standard error as text, the estimate with the digits of two of the error."""
    if not (math.isfinite(std) and std > 0 and math.isfinite(value)):
        return f"{value:.4g}", f"{std:.2g}"
    places = 1 - math.floor(math.log10(float(f"{std:.1e}")))
    digits = places + math.floor(math.log10(abs(value))) + 1 if value else 1
    text = f"{value:#.{min(max(digits, 1), 15)}g}" if digits > 0 else f"{0.0:.{max(places, 0)}f}"
    return text.rstrip(".").replace(".e", "e"), f"{std:#.2g}".rstrip(".").replace(".e", "e")


def fit_joints(
    logs: Sequence[JointLog],
    given: Mapping[str, float],
    terms: Sequence[str],
    loop_period: float,
    *,
    search: bool = True,
    tell: Callable[[float], None] = lambda _: None,
) -> list[FittedJoint]:
    """Fit a servo to each joint.

    A key "2.kp" of `given` is for the joint "2" alone, and has priority over "kp". Raises UsageError for a key of a
    joint that the log does not have.
    """
    names = [log.name for log in logs]
    for key in given:
        joint = key.rpartition(".")[0]
        if joint and joint not in names:
            raise UsageError(f"given {key!r}: there is no joint {joint!r}; the joints are {', '.join(names)}")
    found = []
    for number, log in enumerate(logs):
        own = {key: value for key, value in given.items() if "." not in key}
        own |= {key.rpartition(".")[2]: value for key, value in given.items() if key.rpartition(".")[0] == log.name}
        servo = Servo(log.resolution, {**log.given, **own}, terms, loop_period, log.force is not None)
        found.append(_fit_joint(log, logs, servo, search))
        tell((number + 1) / len(logs))
    return found


def _fit_joint(log: JointLog, others: Sequence[JointLog], servo: Servo, search: bool) -> FittedJoint:
    try:
        check_joint(log, others)
        return FittedJoint(log, fit_servo(servo, log.t, log.goal, log.position, force=log.force, search=search))
    except PmfidError as error:
        return FittedJoint(log, None, str(error))
