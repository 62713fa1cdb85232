"""The page of the servos in a log."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pmfid.actuators.exports import make_files
from pmfid.actuators.joints import HEADER, FittedJoint
from pmfid.errors import printable
from pmfid.report.figures import followed_figure
from pmfid.report.html import write_bytes
from pmfid.report.page import ResultPage, Section


def joints_page(found: Sequence[FittedJoint], name: str) -> ResultPage:
    """Return the page of the servos in the log `name`."""
    doubted = [f"{_name_joint(one)}: {one.status}." for one in found if one.status != "none"]
    text = " ".join(["The column std is one standard error.", *(doubted or ["Nothing casts doubt on any joint."])])
    rows = [row for one in found for row in one.rows]
    sections = [Section("Parameters", text, (HEADER, rows)), *(_draw_joint(one) for one in found)]
    content = {"log": printable(name), "joints": {one.log.name: one.to_dict() for one in found}}
    remarks = [line for joint in found for line in joint.lines]
    remarks += dict.fromkeys(f"note: {note}" for joint in found for note in joint.notes)
    return ResultPage("actuators", f"{name}: servos", content, sections, remarks=remarks)


def write_joints(out: Path, found: Sequence[FittedJoint]) -> None:
    """Write the files of simulators into the folder `out`."""
    out.mkdir(parents=True, exist_ok=True)
    for file, content in make_files(found).items():
        write_bytes(out / file, content.encode("utf-8", "replace"))


def _name_joint(joint: FittedJoint) -> str:
    return joint.log.name if "joint" in joint.log.name.lower() else f"Joint {joint.log.name}"


def _draw_joint(joint: FittedJoint) -> Section:
    log, fit = joint.log, joint.fit
    notes = [f"Note: {note}." for note in joint.notes]
    if fit is None:
        return Section(_name_joint(joint), "\n\n".join([f"Refused: {joint.refused}.", *notes]))
    deviation = f"The simulated motion deviates by {fit.residual / log.resolution:.2f} encoder steps (rms)."
    simulated = fit.simulated[0]
    text, samples = "\n\n".join([deviation, *(finding.paragraph for finding in fit.findings), *notes]), simulated.size
    return Section(
        _name_joint(joint),
        text,
        figure=lambda: followed_figure(log.t[:samples], log.position[:samples], simulated, "rad"),
    )
