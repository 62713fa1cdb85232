"""Tables of a lake, whose own log determines which of its files still count."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from urllib.parse import unquote

from pmfid.errors import UsageError
from pmfid.session.formats.safety import readable, require_extra

#: Where Delta Lake and Iceberg list the files that count.
DELTA, ICEBERG, METADATA = "_delta_log", "metadata", "*.metadata.json"
#: What a reader of plain files may leave to the log: of everything else, rows in the files may not count, or columns
#: have other names.
_PLAIN = {"timestampNtz", "vacuumProtocolCheck", "v2Checkpoint"}
_PARTITION = "partition."


def is_delta(folder: Path) -> bool:
    """Is the folder itself a Delta table?"""
    return (folder / DELTA).is_dir()


def check_no_table(folders: Sequence[Path]) -> None:
    """Raises UsageError where one of the folders of plain files is a table of a lake: files that no longer count would
    be read as data."""
    logs = [one for one in folders if one.name == DELTA]
    logs += [one for one in folders if one.name == ICEBERG and any(one.glob(METADATA))]
    if not logs:
        return
    table, kind = min(log.parent for log in logs), "Delta" if logs[0].name == DELTA else "Iceberg"
    remedy = "give its own folder as SOURCE" if kind == "Delta" else "write it as plain Parquet"
    raise UsageError(
        f"{table}: a table of {kind} has files that no longer count; {remedy}, or in Python a Polars frame"
    )


def delta_files(folder: Path) -> Iterator[tuple[Path, Mapping[str, str]]]:
    """The files of a Delta table that count now, and what is said of all rows of each. Raises UsageError without the
    package deltalake, for a damaged log, and for a table whose files say less than its log."""
    import polars as pl

    with require_extra("delta"):
        from deltalake import DeltaTable
    with readable("Delta"):
        table = DeltaTable(str(folder))
        protocol, actions = table.protocol(), pl.DataFrame(table.get_add_actions(flatten=True))
    features = set(protocol.reader_features or []) - _PLAIN
    if protocol.min_reader_version == 2 or features:
        named = ", ".join(sorted(features)) or "columnMapping"
        raise UsageError(
            f"{folder}: the Delta table uses {named}; write it as plain Parquet, or without these features"
        )
    keys = [name for name in actions.columns if name.startswith(_PARTITION)]
    for row in actions.select("path", *keys).sort("path").iter_rows(named=True):
        said = {key.removeprefix(_PARTITION): str(row[key]) for key in keys if row[key] is not None}
        yield folder / unquote(row["path"]), said
