"""Arrow files (Feather and IPC) in the file format or the stream format."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

from pmfid.errors import UsageError
from pmfid.io.parquet import LazyColumns
from pmfid.io.safety import check_unpacked

if TYPE_CHECKING:
    import polars as pl

FILE, OLD = b"ARROW1", b"FEA1"


class ArrowTable(LazyColumns):
    """The columns of an Arrow file, each read on access."""

    kind = ".arrow"

    def __init__(self, data: bytes) -> None:
        import polars as pl

        if data.startswith(OLD):
            raise UsageError("Feather of version 1 is not read; save it with version 2, as Arrow does by default")
        self._data, self._is_file = data, data.startswith(FILE)
        names = list(pl.read_ipc_schema(io.BytesIO(data))) if self._is_file else []
        rows = int(pl.scan_ipc(io.BytesIO(data)).select(pl.len()).collect().item()) if self._is_file else 0
        check_unpacked(8 * rows, len(data), "a column")
        super().__init__(names or pl.read_ipc_stream(io.BytesIO(data), n_rows=0).columns)

    def read(self, name: str) -> pl.Series:
        import polars as pl

        if self._is_file:
            return pl.read_ipc(io.BytesIO(self._data), columns=[name])[name]
        return pl.read_ipc_stream(io.BytesIO(self._data), columns=[name])[name]
