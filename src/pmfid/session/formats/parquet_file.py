"""Parquet files."""

from __future__ import annotations

import io
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, ClassVar

from pmfid.session.formats.parquet_footer import column_sizes
from pmfid.session.formats.safety import check_unpacked, readable

if TYPE_CHECKING:
    import polars as pl


class LazyColumns(Mapping[str, object], ABC):
    """The columns of a file, each read on access. "column.0" is an element of a column of lists, "column.field" a field
    of a column of structures."""

    kind: ClassVar[str]

    def __init__(self, names: Sequence[str]) -> None:
        self._names = names

    @abstractmethod
    def read(self, name: str) -> pl.Series:
        """The column of that name in the file."""

    def __getitem__(self, name: str) -> object:
        whole, _, part = (name, "", "") if name in self._names else name.rpartition(".")
        if whole not in self._names:
            raise KeyError(name)
        with readable(self.kind):
            series = self.read(whole)
        return _part(series, part, name) if part else series

    def __contains__(self, name: object) -> bool:
        if name in self._names or not isinstance(name, str) or name.rpartition(".")[0] not in self._names:
            return name in self._names
        try:
            return self[name] is not None
        except KeyError:
            return False

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


def _part(series: pl.Series, part: str, name: str) -> pl.Series:
    """An element or a field of every value. Raises KeyError if no value has it."""
    import polars as pl

    if isinstance(series.dtype, pl.Struct) and part in series.struct.fields:
        return series.struct.field(part).alias(name)
    if not part.isdigit() or not isinstance(series.dtype, pl.List | pl.Array):
        raise KeyError(name)
    elements = series.cast(pl.List(series.dtype.inner)).list
    if int(part) >= (elements.len().max() or 0):  # type: ignore[operator]
        raise KeyError(name)
    return elements.get(int(part), null_on_oob=True).alias(name)


class ParquetTable(LazyColumns):
    """The columns of a Parquet file."""

    kind = ".parquet"

    def __init__(self, data: bytes) -> None:
        import polars as pl

        self._data, self._sizes = data, column_sizes(data)
        super().__init__(list(pl.read_parquet_schema(io.BytesIO(data))))
        rows = int(pl.scan_parquet(io.BytesIO(data)).select(pl.len()).collect().item())
        check_unpacked(8 * rows, len(data), "a column")

    def read(self, name: str) -> pl.Series:
        import polars as pl

        check_unpacked(self._sizes.get(name, 0), len(self._data), f"column {name!r}")
        return pl.read_parquet(io.BytesIO(self._data), columns=[name])[name]
