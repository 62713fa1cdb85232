"""The history of a service in its file: all notices, with views of alarms, acknowledgements and configurations."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

from pmfid.service.sinks.plain import as_json
from pmfid.stream.outcome import EstimateRows, Notice
from pmfid.stream.store import VersionError, open_database, raise_os_errors, transaction

INSERT = "INSERT OR IGNORE INTO notices (number, axis, event, wall, what) VALUES (?, ?, ?, ?, ?)"


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
            found = (one for one in outcomes if isinstance(one, Notice))
            cursor.executemany(
                INSERT, ((n.number, n.axis, n.what.get("event", ""), n.wall, as_json(n.what)) for n in found)
            )

    def close(self) -> None:
        """Close the file. All outcomes of `put` are already on the disk."""
        database, self._database = self._database, None
        if database is not None:
            with raise_os_errors(self._path):
                database.close()
