"""The command `pmfid actuators`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pmfid.cli.tables import deliver_page, print_table
from pmfid.cli.terminal import JSON, folder_option, print_json, print_text, progress, read_numbers
from pmfid.errors import NotIdentifiableError, UsageError, printable

if TYPE_CHECKING:
    from pmfid.actuators.sysid import Feedforward


@click.command(short_help="Identify the servos in logs of position commands.")
@click.argument("log", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--goal", metavar="PATTERN", help="Columns of the commands, such as 'goal_*'; * is the joint.")
@click.option("--position", metavar="PATTERN", help="Columns of the measured positions, such as 'position_*'.")
@click.option("--time", metavar="NAME", help="Column of the time.")
@click.option("--unit", type=click.Choice(["rad", "deg", "counts"]), help="Unit of goals and positions.")
@click.option(
    "--goal-unit", type=click.Choice(["rad", "deg", "counts"]), help="Unit of the goals, if it differs from --unit."
)
@click.option("--bits", type=click.IntRange(4, 32), help="Bits of the encoder per turn; default: estimated.")
@click.option("--resolution", type=float, metavar="RAD", help="Step of the encoder, in place of --bits.")
@click.option(
    "--given",
    multiple=True,
    metavar="NAME=VALUE",
    help="Known parameter in SI units: kp=8, or for one joint shoulder.kp=8.",
)
@click.option(
    "--known-force",
    "known_forces",
    multiple=True,
    metavar="PATTERN",
    help="Columns of known torques in N m that the model does not contain, such as 'gravity_*' of a robot.",
)
@click.option("--term", "terms", multiple=True, metavar="NAME", help="Further parameter of the model, such as gravity.")
@click.option(
    "--per-log", multiple=True, metavar="NAME", help="Parameter that differs by log, such as kp; all others are shared."
)
@click.option("--loop-period", type=float, default=1e-3, show_default=True, metavar="S", help="Loop period [s].")
@click.option(
    "--search/--no-search", default=True, show_default=True, help="Add parameters for which the log gives evidence."
)
@click.option(
    "--episode", type=click.IntRange(0), metavar="N", help="Episode of a LeRobot data set. Default: a long one."
)
@folder_option("Write a report, JSON and models for MuJoCo, URDF, Isaac, BAM and WPILib into this folder.")
@JSON
def actuators(
    log: tuple[Path, ...],
    goal: str | None,
    position: str | None,
    time: str | None,
    unit: str | None,
    goal_unit: str | None,
    bits: int | None,
    resolution: float | None,
    given: tuple[str, ...],
    known_forces: tuple[str, ...],
    terms: tuple[str, ...],
    per_log: tuple[str, ...],
    loop_period: float,
    search: bool,
    episode: int | None,
    out: Path | None,
    as_json: bool,
) -> None:
    """Find inertia, friction, gain and delay of every joint in LOG, which has its position commands and positions.

    Several logs of the same joints are fitted at once. LOG is a table of any format, a bag of ROS 2, a data set of
    LeRobot, a folder of SAGE, a log of BAM in JSON, or a log of WPILib SysId in JSON, which gives kS, kV and kA.

    Without a known torque, such as kp or gravity, torques are multiples of kp.

    Exit code 0: an estimate of a joint; 2: wrong usage or unreadable input; 3: no joint has an estimate.
    """
    name = ", ".join(path.name for path in log)
    with progress("actuators") as tell:
        from pmfid.actuators.joints import fit_joints
        from pmfid.actuators.logs import LogLayout, read_joints
        from pmfid.actuators.sysid import fit_sysid, is_sysid, read_sysid
        from pmfid.report.actuators import joints_page, write_joints

        if bits is not None and resolution is not None:
            raise UsageError("--bits and --resolution both give the encoder's step: give only one of them")
        step = 2 * math.pi / 2**bits if bits is not None else resolution
        if step is not None and not (math.isfinite(step) and step > 0):
            raise UsageError(f"--resolution must be positive and finite, got {step}: give it in rad")
        if len(log) == 1 and is_sysid(log[0]):
            mechanisms = [fit_sysid(one, one.turn / 2**bits if bits else resolution) for one in read_sysid(log[0])]
            _show_gains(mechanisms, name, out, as_json)
            return
        layout = LogLayout(time, goal, position, unit, step, episode, goal_unit, known_forces)
        logs = [joint for path in log for joint in read_joints(path, layout)]
        found = fit_joints(
            logs, read_numbers("given", given, "kp=8"), terms, loop_period, per_log=per_log, search=search, tell=tell
        )
        if all(joint.fit is None for joint in found):
            raise NotIdentifiableError("; ".join(f"{joint.log.name}: {joint.refused}" for joint in found))
        if out is not None:
            write_joints(out, found)
    deliver_page(joints_page(found, name), out, as_json)


def _show_gains(mechanisms: list[Feedforward], name: str, out: Path | None, as_json: bool) -> None:
    """Print the gains of a log of SysId, and write them into a folder."""
    content = {one.name: one.to_wpilib() for one in mechanisms}
    if out is not None:
        from pmfid.report.html import write_json

        out.mkdir(parents=True, exist_ok=True)
        write_json(out / "wpilib.json", content)
    if as_json:
        print_json({"log": printable(name), "mechanisms": {one.name: one.to_dict() for one in mechanisms}})
        return
    from pmfid.actuators.joints import HEADER

    print_table(name, HEADER, [row for one in mechanisms for row in one.rows])
    lines = [line for one in mechanisms for line in one.lines]
    lines += dict.fromkeys(f"note: {note}" for one in mechanisms for note in one.notes)
    print_text("\n".join([*lines, *([f"gains: {out / 'wpilib.json'}"] if out else [])]))
