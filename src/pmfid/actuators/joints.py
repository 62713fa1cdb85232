"""All joints of some logs: the fit of each one, or the reason why it has none."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from pmfid.actuators.checks import check_joint
from pmfid.actuators.fit import ServoFit, fit_logs
from pmfid.actuators.logs import JointLog
from pmfid.actuators.servo import Servo
from pmfid.errors import PmfidError, UsageError
from pmfid.presentation import format_pair

HEADER = ("joint", "parameter", "value", "std", "unit")


@dataclass(frozen=True)
class FittedJoint:
    """A joint with its logs and its fit, or with the reason of a refusal."""

    logs: Sequence[JointLog]
    fit: ServoFit | None
    refused: str = ""

    @property
    def log(self) -> JointLog:
        """The first log."""
        return self.logs[0]

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
        fit = self.fit
        texts = [
            ("not determined", "by this log") if raw in fit.open else format_pair(value, std)
            for raw, value, std in zip(fit.raw_names, fit.theta.tolist(), fit.theta_std.tolist(), strict=True)
        ]
        return [
            [self.log.name, name, *text, unit] for name, text, unit in zip(fit.names, texts, fit.units, strict=True)
        ]

    @property
    def notes(self) -> list[str]:
        """Sentences on the reading of the logs."""
        return list(dict.fromkeys(note for log in self.logs for note in log.notes))

    def to_dict(self) -> dict[str, object]:
        """Return the result as text, numbers, lists and dicts."""
        own: dict[str, object] = {"resolution": self.log.resolution, "logs": len(self.logs)}
        own |= {"samples": sum(log.t.size for log in self.logs), "notes": self.notes}
        return own | (self.fit.to_dict() if self.fit else {"refused": self.refused})


def fit_joints(
    logs: Sequence[JointLog],
    given: Mapping[str, float],
    terms: Sequence[str],
    loop_period: float,
    *,
    per_log: Sequence[str] = (),
    search: bool = True,
    tell: Callable[[float], None] = lambda _: None,
) -> list[FittedJoint]:
    """Fit a servo to each joint. Logs of one name are fitted at once, each with its own parameters of `per_log`.

    A key "2.kp" of `given` is for the joint "2" alone, and has priority over "kp". Raises UsageError for a key of a
    joint that the logs do not have.
    """
    names = list(dict.fromkeys(log.name for log in logs))
    for key in given:
        joint = key.rpartition(".")[0]
        if joint and joint not in names:
            raise UsageError(f"given {key!r}: there is no joint {joint!r}; the joints are {', '.join(names)}")
    found = []
    for number, name in enumerate(names):
        own = {key: value for key, value in given.items() if "." not in key}
        own |= {key.rpartition(".")[2]: value for key, value in given.items() if key.rpartition(".")[0] == name}
        group = [log for log in logs if log.name == name]
        known = {**group[0].given, **own}
        resolution = min(log.resolution for log in group)
        servo = Servo(resolution, known, terms, loop_period, group[0].force is not None)
        found.append(_fit_joint(servo, group, logs, per_log, search))
        tell((number + 1) / len(names))
    return found


def _fit_joint(
    servo: Servo, logs: Sequence[JointLog], others: Sequence[JointLog], per_log: Sequence[str], search: bool
) -> FittedJoint:
    try:
        for log in logs:
            check_joint(log, others)
            if log.given != logs[0].given:
                raise UsageError("the logs state different pendulums: fit each of them in a call of its own")
        settings = {log.stated.get("kp") for log in logs}
        differs = len(settings) > 1 and "kp" in servo.unknown and "kp" not in per_log
        return FittedJoint(logs, fit_logs(servo, logs, [*per_log, *(["kp"] if differs else [])], search=search))
    except PmfidError as error:
        return FittedJoint(logs, None, str(error))
