"""The file of a service, an SQLite database with its states and with the history of its notices."""

from __future__ import annotations

import json
import sqlite3
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any, TypeVar

from pmfid.durable import crash_point, hold
from pmfid.errors import UsageError
from pmfid.presentation import as_json
from pmfid.stream.outcome import URGENT, Notice
from pmfid.stream.tuning import TUNING

#: Name of the file in the folder `[service] state`.
FILE = "pmfid.sqlite"
#: Version of the tables, and the number that marks such a file ("pmfd"). The file contains both.
VERSION, APPLICATION = 5, 0x706D6664

SCHEMA = """
CREATE TABLE checkpoint (sequence INTEGER NOT NULL, checksum INTEGER NOT NULL);
CREATE TABLE states (part INTEGER PRIMARY KEY, body BLOB NOT NULL);
CREATE TABLE notices (
    id INTEGER PRIMARY KEY,
    number INTEGER NOT NULL,  -- raised by one from notice to notice
    axis TEXT NOT NULL,       -- "" for the service itself
    event TEXT NOT NULL,
    wall REAL NOT NULL,       -- seconds since 1970 when it was found
    what TEXT NOT NULL        -- JSON, as `pmfid monitor --json` prints it
);
CREATE INDEX notices_of_event ON notices (event, axis, id);
CREATE VIEW alarms AS SELECT
    id, number, axis, wall,
    json_extract(what, '$.time') AS time,  -- [s] by the clock of the axis
    json_extract(what, '$.changed_at') AS changed_at,
    json_extract(what, '$.parameter') AS parameter,
    json_extract(what, '$.direction') AS direction,
    json_extract(what, '$.change') AS change,
    json_extract(what, '$.std') AS std,
    json_extract(what, '$.unit') AS unit,
    json_extract(what, '$.relative') AS relative,
    json_extract(what, '$.statistic') AS statistic,
    json_extract(what, '$.threshold') AS threshold
FROM notices WHERE event = 'alarm';
CREATE VIEW acknowledgements AS SELECT
    id,
    -- The newest alarm of the number, because a service that lost its state counts from 1 again.
    (SELECT max(alarm.id) FROM notices AS alarm WHERE alarm.event = 'alarm' AND alarm.axis = known.axis
        AND alarm.id < known.id
        AND alarm.number = json_extract(known.what, '$.alarm')
    ) AS alarm,
    axis, wall, coalesce(json_extract(what, '$.note'), '') AS note
FROM notices AS known WHERE event = 'acknowledged';
CREATE VIEW configurations AS SELECT id, axis, wall, config, digest, what FROM (
    SELECT *, lag(digest) OVER (PARTITION BY config, axis ORDER BY id) AS before FROM (
        SELECT *, json_extract(what, '$.config') AS config, json_extract(what, '$.digest') AS digest
        FROM notices WHERE event = 'configuration'
    ) WHERE digest IS NOT NULL
) WHERE digest IS NOT before;
"""

INSERT = "INSERT INTO notices (number, axis, event, wall, what) VALUES (?, ?, ?, ?, ?)"
ALARMS = f"""SELECT axis, number, wall, what FROM notices WHERE event IN {URGENT} ORDER BY id DESC LIMIT ?"""
Event = dict[str, Any]
Content = TypeVar("Content")


@contextmanager
def raise_os_errors(path: Path) -> Iterator[None]:
    """Convert errors of SQLite to OSError, because a full disk or a file in use may be temporary."""
    try:
        yield
    except sqlite3.Error as error:
        raise OSError(f"{path.name}: {error}") from None


def open_database(path: Path) -> sqlite3.Connection:
    """Open the file, which is made if it is absent. Any thread may use the connection, but only one at a time.

    Raises sqlite3.Error for a file that cannot be used, and UsageError for a file of another version.
    """
    database = sqlite3.connect(path, timeout=TUNING.store_busy, isolation_level=None, check_same_thread=False)
    try:
        _prepare(database, path)
    except BaseException:
        database.close()
        raise
    return database


def _prepare(database: sqlite3.Connection, path: Path) -> None:
    """Make the tables in a new file, or check an existing file."""
    (application,), (version,) = (
        database.execute(f"PRAGMA {key}").fetchone() for key in ("application_id", "user_version")
    )
    new = application == 0 and not database.execute("SELECT 1 FROM sqlite_master").fetchone()
    if not new and (application, version) != (APPLICATION, VERSION):
        raise UsageError(
            f"{path}: another version of pmfid, or another program, wrote this file; use that version, or choose "
            "another folder"
        )
    # Readers do not delay the writer, and a transaction is on the disk when it ends.
    database.execute("PRAGMA journal_mode = WAL")
    database.execute("PRAGMA synchronous = FULL")
    if new:
        with transaction(database):
            for statement in SCHEMA.split(";\n"):
                database.execute(statement)
            database.execute(f"PRAGMA application_id = {APPLICATION}")
            database.execute(f"PRAGMA user_version = {VERSION}")


@contextmanager
def transaction(database: sqlite3.Connection) -> Iterator[None]:
    """Write all or nothing."""
    database.execute("BEGIN IMMEDIATE")
    try:
        yield
        database.execute("COMMIT")
    except BaseException:
        if database.in_transaction:  # SQLite ends the transaction by itself after some errors
            database.execute("ROLLBACK")
        raise


class Vault:
    """States and notices in the file of a folder, which only one service uses at a time. The folder is made if it is
    absent.

    `sequence` is the number of the last checkpoint. Raises UsageError if another service has the folder, or if the
    folder cannot be made.
    """

    def __init__(self, folder: Path) -> None:
        self.path, self.sequence = folder / FILE, 0
        self._lock: IO[bytes] = hold(folder, "[service] state", "another service")
        self._database: sqlite3.Connection | None = None

    def load(self, read: Callable[[bytes, list[Notice]], Content], tell: Callable[[Event], None]) -> Content | None:
        """Return the result of `read` for the states and the latest notices of alarms, or None without states.

        A file that is damaged, or that `read` refuses with ValueError, is renamed and reported. Raises UsageError for a
        file of another version.
        """
        try:
            body = self._body()
            return None if body is None else read(body, self._alarms())
        except (sqlite3.Error, ValueError) as error:
            self._set_aside(str(error), tell)
            return None

    def _body(self) -> bytes | None:
        database = self._open()
        row = database.execute("SELECT sequence, checksum FROM checkpoint").fetchone()
        if row is None:
            return None
        body = b"".join(part for (part,) in database.execute("SELECT body FROM states ORDER BY part"))
        if zlib.crc32(body) != row[1]:
            raise ValueError("its checksum is wrong")
        self.sequence = max(self.sequence, int(row[0]))
        return body

    def _alarms(self) -> list[Notice]:
        rows = self._open().execute(ALARMS, (len(URGENT) * TUNING.outcome_most,)).fetchall()
        return [Notice(axis, number, wall, json.loads(what)) for axis, number, wall, what in reversed(rows)]

    def _open(self) -> sqlite3.Connection:
        self._database = self._database or open_database(self.path)
        return self._database

    def _drop(self) -> None:
        database, self._database = self._database, None
        if database is not None:
            with suppress(sqlite3.Error):
                database.close()

    def _set_aside(self, problem: str, tell: Callable[[Event], None]) -> None:
        """Rename a damaged file, so that people can examine it and no new file overwrites it."""
        self._drop()
        numbered = (self.path.with_name(f"{FILE}.damaged-{k}") for k in range(1, 10**6))
        place = next(path for path in numbered if not path.exists())
        try:
            for end in ("-wal", "-shm", ""):
                if (path := self.path.with_name(FILE + end)).exists():
                    path.rename(place.with_name(place.name + end))
        except OSError as error:
            place, problem = self.path, f"{problem}; it cannot be set aside: {error.strerror}"
        tell({"event": "checkpoint", "damaged": place.name, "problem": problem})

    def write(self, chunks: Sequence[bytes | memoryview], notices: Iterable[Notice] = ()) -> None:
        """Replace the states, if any are given, and add notices.

        Both are on the disk when this method returns. Raises OSError if it fails, and then changes nothing.
        """
        rows = [(one.number, one.axis, one.what.get("event", ""), one.wall, as_json(one.what)) for one in notices]
        try:
            with raise_os_errors(self.path):
                database = self._open()
                with transaction(database):
                    database.executemany(INSERT, rows)
                    if chunks:
                        self._replace_states(database, list(_split(chunks)))
                    crash_point("checkpoint.written")
        except OSError:
            self._drop()  # the disk may be another one
            raise
        self.sequence += bool(chunks)
        crash_point("checkpoint.durable")

    def _replace_states(self, database: sqlite3.Connection, pieces: Sequence[memoryview]) -> None:
        checksum = 0
        database.execute("DELETE FROM checkpoint")
        database.execute("DELETE FROM states")
        for part, piece in enumerate(pieces):
            if part == len(pieces) // 2:
                crash_point("checkpoint.half")
            checksum = zlib.crc32(piece, checksum)
            database.execute("INSERT INTO states VALUES (?, ?)", (part, piece))
        database.execute("INSERT INTO checkpoint VALUES (?, ?)", (self.sequence + 1, checksum))

    def close(self) -> None:
        """Unlock the folder for other services."""
        self._drop()
        self._lock.close()


def _split(chunks: Sequence[bytes | memoryview]) -> Iterator[memoryview]:
    """Yield pieces that SQLite takes as one value."""
    for chunk in chunks:
        view = memoryview(chunk).cast("B")
        for k in range(0, len(view), TUNING.store_piece):
            yield view[k : k + TUNING.store_piece]
