"""Alarms, acknowledgements, the history of configurations and all other notices in an SQLite database."""

from __future__ import annotations

import math
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Literal

from pydantic import Field

from pmfid.config.model import Name
from pmfid.service.context import Context
from pmfid.service.sinks.plain import alarm_of, as_json
from pmfid.service.sinks.queued import SinkSection
from pmfid.service.tuning import TUNING
from pmfid.stream.outcome import EstimateRows, Notice

#: Version of the layout in this module, and the number that marks such a file ("pmfd"). The file contains both.
VERSION, APPLICATION = 1, 0x706D6664

SCHEMA = """
CREATE TABLE notices (
    id INTEGER PRIMARY KEY,
    number INTEGER NOT NULL,  -- raised by one from notice to notice; starts at 1 if the service has no state
    axis TEXT NOT NULL,       -- "" for the service itself
    event TEXT NOT NULL,
    wall REAL NOT NULL,       -- seconds since 1970 when it was found
    what TEXT NOT NULL,       -- JSON, as `pmfid monitor --json` prints it
    UNIQUE (number, axis, what)
);
CREATE INDEX notices_of_axis ON notices (axis, event, id);
CREATE TABLE alarms (
    id INTEGER PRIMARY KEY REFERENCES notices (id),
    number INTEGER NOT NULL,
    axis TEXT NOT NULL,
    wall REAL NOT NULL,
    time REAL,                -- [s] by the clock of the axis
    changed_at REAL,
    parameter TEXT,
    direction TEXT,
    change REAL,
    std REAL,
    unit TEXT,
    relative REAL,
    statistic REAL,
    threshold REAL
);
CREATE INDEX alarms_by_number ON alarms (number);
CREATE TABLE acknowledgements (
    id INTEGER PRIMARY KEY REFERENCES notices (id),
    alarm INTEGER REFERENCES alarms (id),  -- NULL where that alarm is not in this file
    axis TEXT NOT NULL,
    wall REAL NOT NULL,
    note TEXT NOT NULL
);
CREATE TABLE configurations (
    id INTEGER PRIMARY KEY REFERENCES notices (id),
    axis TEXT NOT NULL,
    wall REAL NOT NULL,
    config TEXT,
    digest TEXT,
    what TEXT NOT NULL
);
"""

INSERT = "INSERT OR IGNORE INTO notices (number, axis, event, wall, what) VALUES (?, ?, ?, ?, ?)"
INSERT_CONFIGURATION = """
INSERT INTO configurations SELECT ?, ?, ?, ?, ?, ?
WHERE (SELECT digest FROM configurations WHERE config IS ? AND axis = ? ORDER BY id DESC LIMIT 1) IS NOT ?
"""
#: Keys of an alarm that are columns.
ALARM = ("time", "changed_at", "parameter", "direction", "change", "std", "unit", "relative", "statistic", "threshold")


class SqliteSection(SinkSection):
    """[sinks.NAME] with kind = "sqlite"."""

    kind: Literal["sqlite"] = Field("sqlite", description='"sqlite"')
    path: Name | None = Field(
        None,
        description=(
            'the file of the database, for example "alarms.sqlite"; by default NAME.sqlite in the folder '
            "of the checkpoints"
        ),
    )

    def wants_rows(self) -> bool:
        return False

    def make(self, name: str, context: Context) -> SqliteSink:
        kept = context.state or context.folder
        return SqliteSink(name, kept / f"{name}.sqlite" if self.path is None else context.folder / self.path)


@contextmanager
def _raise_os_errors(path: Path) -> Iterator[None]:
    """Convert errors of SQLite to OSError, because full disks, damaged files and files in use may be temporary."""
    try:
        yield
    except sqlite3.Error as error:
        raise OSError(f"{path.name}: {error}") from None


class SqliteSink:
    """A sink that writes all given notices in one transaction, or none of them.

    When `put` returns, the notices are on the disk. A notice with the same number, axis and content is not written
    again. The number does not suffice, because a service that lost its state counts from 1 again. The alarms of a new
    start must not look like old alarms.
    """

    def __init__(self, name: str, path: Path) -> None:
        self.name = name
        self._path = path
        self._database: sqlite3.Connection | None = None

    def open(self) -> None:
        """Open the file. Raises OSError if the file cannot be used, or if it is of another kind."""
        self.close()
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with _raise_os_errors(self._path):
            database = sqlite3.connect(self._path, timeout=TUNING.sqlite_busy, isolation_level=None)
            try:
                _prepare(database, self._path)
            except BaseException:
                database.close()
                raise
        self._database = database

    def put(self, outcomes: list[EstimateRows | Notice]) -> None:
        """Write the notices. Raises OSError if they cannot be written."""
        if self._database is None:
            raise OSError(f"the database {self._path.name} is not open")
        with _raise_os_errors(self._path), closing(self._database.cursor()) as cursor, _transaction(self._database):
            for one in outcomes:
                if isinstance(one, Notice):
                    _insert(cursor, one)

    def close(self) -> None:
        """Close the file. All outcomes of `put` are already on the disk."""
        database, self._database = self._database, None
        if database is not None:
            with _raise_os_errors(self._path):
                database.close()


def _prepare(database: sqlite3.Connection, path: Path) -> None:
    """Make the schema in a new file, or check an existing file."""
    (application,), (version,) = (
        database.execute(f"PRAGMA {key}").fetchone() for key in ("application_id", "user_version")
    )
    if application == APPLICATION and version > VERSION:
        raise OSError(f"a newer version of pmfid wrote {path.name}; give another file, or use that version")
    if application != APPLICATION and database.execute("SELECT 1 FROM sqlite_master").fetchone():
        raise OSError(f"{path.name} is a database of another program; give another file")
    # Readers do not delay the writer, and a transaction is on the disk when it ends.
    database.execute("PRAGMA journal_mode = WAL")
    database.execute("PRAGMA synchronous = FULL")
    if application != APPLICATION:
        with _transaction(database):
            for statement in SCHEMA.split(";\n"):
                database.execute(statement)
            database.execute(f"PRAGMA application_id = {APPLICATION}")
            database.execute(f"PRAGMA user_version = {VERSION}")


@contextmanager
def _transaction(database: sqlite3.Connection) -> Iterator[None]:
    database.execute("BEGIN IMMEDIATE")
    try:
        yield
        database.execute("COMMIT")
    except BaseException:
        if database.in_transaction:  # SQLite ends the transaction by itself after some errors
            database.execute("ROLLBACK")
        raise


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
