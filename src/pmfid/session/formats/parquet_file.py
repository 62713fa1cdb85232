"""Parquet files."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping

from pmfid.session.formats.safety import check_unpacked, readable


class ParquetTable(Mapping[str, object]):
    """The columns of a Parquet file, each read when it is asked for."""

    def __init__(self, data: bytes) -> None:
        import polars as pl

        self._data, self._names = data, list(pl.read_parquet_schema(io.BytesIO(data)))
        rows = int(pl.scan_parquet(io.BytesIO(data)).select(pl.len()).collect().item())
        check_unpacked(8 * rows, len(data), "a column")

    def __getitem__(self, name: str) -> object:
        import polars as pl

        if name not in self._names:
            raise KeyError(name)
        with readable(".parquet"):
            return pl.read_parquet(io.BytesIO(self._data), columns=[name])[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)
