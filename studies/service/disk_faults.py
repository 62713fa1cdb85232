"""Faults of disks: full, read-only."""

from __future__ import annotations

import os
import sqlite3
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from pmfid.stream.store import FILE
from studies.service.finding import Finding, changes, others_unchanged, sentences, without_alarm
from studies.service.hall import PATIENCE, Hall, Metrics, Report, hall, name_of

AXES, BEFORE, DURING, AFTER = 6, 5.0, 20.0, 10.0


def run(*command: str | Path) -> bool:
    """Return whether a command of the system succeeded."""
    return subprocess.run(command, capture_output=True).returncode == 0


@contextmanager
def mounted(place: Path, *how: str | Path) -> Iterator[bool]:
    """Mount a file system on a folder; yield whether root permits it."""
    place.mkdir(parents=True, exist_ok=True)
    done = run("mount", *how, place)
    try:
        yield done
    finally:
        while done and run("umount", place):
            pass


def _small(place: Path) -> AbstractContextManager[bool]:
    return mounted(place, "-t", "tmpfs", "-o", "size=3m", "tmpfs")


@dataclass
class Disk:
    """A fault of the disk that holds the state of a hall.

    `how` describes the fault, and `begin` and `end` cause and remove it.
    """

    how: str
    begin: Callable[[], object]
    end: Callable[[], object]


def full(state: Path) -> Disk:
    filler = state / "filler"

    def begin() -> None:
        with suppress(OSError), filler.open("wb", buffering=0) as file:
            while file.write(bytes(4096)):
                pass

    return Disk("disk full (a tmpfs of 3 MB, filled)", begin, filler.unlink)


def disk_fault(place: Path, make: Callable[[Path], Disk]) -> Finding:
    """Compare the service before, during and after the fault, without a restart."""
    with _small(place / "state"), hall(place, AXES, 60.0) as there:
        there.play(BEFORE)
        there.through()
        there.notices()
        start = there.served.metrics()
        disk = make(place / "state")
        disk.begin()
        there.play(DURING / 2)
        there.post(f"/api/axis/{name_of(0)}/reference")  # a notice that must not be lost
        there.play(DURING / 2)
        during, reported = there.through(), there.notices()
        claims = list(_stopped(there, during, reported))
        disk.end()
        there.play(AFTER)
        there.through()
        after, later = _recovered(there), there.notices()
        claims = [others_unchanged(there), without_alarm([*reported, *later]), *claims]
        claims.append(("the checkpoint works again without a restart", _works(after)))
        kept = _notices_in(place / "state" / FILE)
        claims.append((f"reference set meanwhile is in the history ({kept} notices)", kept > 0))
        return Finding(
            disk.how, [*sentences(reported), "*after it:*", *sentences(later)], changes(start, during), claims
        )


def _works(metrics: Metrics) -> bool:
    return metrics.get("pmfid_checkpoint_working") == 1.0


def _recovered(there: Hall) -> Metrics:
    """Return the metrics once checkpoints work again, or after a minute: pauses between attempts grow to a minute."""
    end = time.monotonic() + 1.2 * PATIENCE
    while True:
        metrics = there.served.metrics()
        if _works(metrics) or time.monotonic() > end:
            return metrics
        time.sleep(0.5)


def _stopped(there: Hall, during: Metrics, reported: list[Report]) -> Iterator[tuple[str, bool]]:
    yield "/metrics show that checkpoints do not work", not _works(during)
    yield "a notice says so", any(one["event"] == "checkpoint" and "problem" in one for one in reported)
    yield f"{there.accounted(during):g} of {there.sent} samples so far", there.accounted(during) == there.sent


def _notices_in(database: Path) -> int:
    with closing(sqlite3.connect(f"file:{database}?mode=ro", uri=True)) as found:
        (number,) = found.execute("SELECT count(*) FROM notices WHERE event = 'reference'").fetchone()
    return int(number)


def forced_read_only(place: Path) -> Finding | None:
    """Test an ext4 that the kernel makes read-only after an error; return None if root has no loop device.

    The disk stays read-only until it is mounted again; then the service starts again.
    """
    place.mkdir(parents=True, exist_ok=True)
    image = place / "image"
    with image.open("wb") as file:
        file.truncate(2**24)
    if not run("mkfs.ext4", "-q", "-O", "^has_journal", image):
        return None
    how = ("-o", "loop,errors=remount-ro", image)
    with mounted(place / "state", *how) as done:
        if not done or not (device := _error_of(place / "state")):
            return None
        with hall(place, AXES, 60.0) as there:
            there.play(BEFORE)
            there.through()
            there.notices()
            start = there.served.metrics()
            with suppress(OSError):
                device.write_text("1")
            there.play(DURING)
            during, reported = there.through(), there.notices()
            claims = [others_unchanged(there), without_alarm(reported), *_stopped(there, during, reported)]
            at = there.at
    with mounted(place / "state", *how):
        claims += _again(place, at)
    fault = "disk read-only (an ext4 that the kernel remounts for an error; mounted again, service started again)"
    return Finding(fault, sentences(reported), changes(start, during), claims)


def _error_of(place: Path) -> Path | None:
    """Return the file that triggers an error of the file system on a folder."""
    named = subprocess.run(["findmnt", "-n", "-o", "SOURCE", place], capture_output=True, text=True).stdout.strip()
    found = Path("/sys/fs/ext4") / Path(named).name / "trigger_fs_error"
    return found if named and os.access(found, os.W_OK) else None


def _again(place: Path, at: int) -> Iterator[tuple[str, bool]]:
    """Start the service again on the same disk; its machines continue from sample `at`."""
    with hall(place, AXES, 60.0) as there:
        (reported,) = [one for one in there.notices() if one["event"] == "checkpoint"]
        went_on = reported.get("restored") == AXES
        yield f"started again from the last checkpoint ({reported.get('restored', 0)} axes go on)", went_on
        there.at = at
        there.play(2.0)
        time.sleep(2.0)
        missing, number = there.total("pmfid_samples_missing_total"), int(there.rows(name_of(0))[0][-1])
        claim = f"{missing:g} samples without a checkpoint are said to be missing, and the numbers go on at {number}"
        yield claim, 0 < missing < AXES * at and at < number <= there.at
