"""The history of a service in its file: alarms, acknowledgements, configurations and all other notices."""

from __future__ import annotations

import math
import sqlite3
from contextlib import closing
from pathlib import Path

from pmfid.service.sinks.plain import alarm_of, as_json
from pmfid.stream.outcome import EstimateRows, Notice
from pmfid.stream.store import VersionError, open_database, raise_os_errors, transaction

INSERT = "INSERT OR IGNORE INTO notices (number, axis, event, wall, what) VALUES (?, ?, ?, ?, ?)"
INSERT_CONFIGURATION = """
INSERT INTO configurations SELECT ?, ?, ?, ?, ?, ?
WHERE (SELECT digest FROM configurations WHERE config IS ? AND axis = ? ORDER BY id DESC LIMIT 1) IS NOT ?
"""
#: Keys of an alarm that are columns.
ALARM = ("time", "changed_at", "parameter", "direction", "change", "std", "unit", "relative", "statistic", "threshold")


class HistorySink:
    """A sink that writes all given notices in one transaction, or none of them.

    When `put` returns, the notices are on the disk. A notice with the same number, axis and content is not written
    again. The number does not suffice, because a service that lost its state counts from 1 again. The alarms of a new
    start must not look like old alarms.
    """

    name, takes_rows = "history", False
    events: frozenset[str] | None = None

    def __init__(self, path: Path) -> None:
        self._path = path
        self._database: sqlite3.Connection | None = None

    def open(self) -> None:
        """Open the file. Raises OSError if the file cannot be used, or if it is of another version."""
        self.close()
        try:
            with raise_os_errors(self._path):
                self._database = open_database(self._path)
        except VersionError as error:
            raise OSError(str(error)) from None

    def put(self, outcomes: list[EstimateRows | Notice]) -> None:
        """Write the notices. Raises OSError if they cannot be written."""
        if self._database is None:
            raise OSError(f"the database {self._path.name} is not open")
        with raise_os_errors(self._path), closing(self._database.cursor()) as cursor, transaction(self._database):
            for one in outcomes:
                if isinstance(one, Notice):
                    _insert(cursor, one)

    def close(self) -> None:
        """Close the file. All outcomes of `put` are already on the disk."""
        database, self._database = self._database, None
        if database is not None:
            with raise_os_errors(self._path):
                database.close()


def _insert(cursor: sqlite3.Cursor, notice: Notice) -> None:
    what, event = notice.what, str(notice.what.get("event", ""))
    written = cursor.execute(INSERT, (notice.number, notice.axis, event, notice.wall, as_json(what)))
    if written.rowcount == 0:  # the notice came before
        return
    row = cursor.lastrowid
    if event == "alarm":
        values = (row, notice.number, notice.axis, notice.wall, *(_cell(what.get(key)) for key in ALARM))
        cursor.execute(f"INSERT INTO alarms VALUES ({', '.join('?' * len(values))})", values)
    elif event == "acknowledged":
        # The newest alarm of this number, because a service that lost its state counts from 1 again.
        alarm = "(SELECT max(id) FROM alarms WHERE number = ? AND axis = ?)"
        values = (row, alarm_of(notice), notice.axis, notice.axis, notice.wall, str(what.get("note", "")))
        cursor.execute(f"INSERT INTO acknowledgements VALUES (?, {alarm}, ?, ?, ?)", values)
    elif event == "configuration" and what.get("digest") is not None:
        # The service reports its configuration at every start, but only differences belong to the history.
        config, digest = _cell(what.get("config")), _cell(what["digest"])
        values = (row, notice.axis, notice.wall, config, digest, as_json(what), config, notice.axis, digest)
        cursor.execute(INSERT_CONFIGURATION, values)


def _cell(value: object) -> float | str | None:
    """Return a value for a column. SQLite has NULL for a number that is not finite."""
    if isinstance(value, str) or value is None:
        return value
    if isinstance(value, int | float):
        return float(value) if math.isfinite(value) else None
    return as_json(value)
