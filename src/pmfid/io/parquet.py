"""Parquet files: the sizes in their footer, and columns that are read on access."""

from __future__ import annotations

import io
import struct
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from pmfid.io.safety import check_unpacked, readable

if TYPE_CHECKING:
    import polars as pl

#: Types in the compact protocol of Apache Thrift.
TRUE, FALSE, BYTE, INTEGERS, DOUBLE, BINARY, LISTS, STRUCT = 1, 2, 3, (4, 5, 6), 7, 8, (9, 10), 12
#: Number of bytes at the end of the file, which hold the length of the footer and the magic word.
TAIL = 8
#: Identifiers of fields in FileMetaData, RowGroup and ColumnChunk.
ROW_GROUPS, COLUMNS, META_DATA = 4, 1, 3
PATH, VALUES, UNCOMPRESSED = 3, 5, 6
#: Number of bytes of a value in memory.
VALUE = 8


def column_sizes(data: bytes) -> Mapping[str, int]:
    """Return the size of each top-level column in memory [bytes]. The size is that of its values or of its unpacked
    pages, whichever is larger.

    Raises ValueError, IndexError, KeyError or TypeError for a damaged footer.
    """
    (length,) = struct.unpack("<I", data[-TAIL : -TAIL + 4])
    footer = _Compact(data[-TAIL - length : -TAIL]).structure()
    sizes: Counter[str] = Counter()
    for group in footer[ROW_GROUPS]:
        for chunk in group[COLUMNS]:
            meta = chunk[META_DATA]
            sizes[meta[PATH][0].decode()] += max(VALUE * meta[VALUES], meta[UNCOMPRESSED])
    return sizes


@dataclass
class _Compact:
    """A reader for the compact protocol of Apache Thrift, with structures as values by the identifiers of their
    fields.
    """

    data: bytes
    place: int = 0

    def structure(self) -> dict[int, Any]:
        fields: dict[int, Any] = {}
        number = 0
        while head := self._byte():
            number = number + (head >> 4) if head >> 4 else self._integer()
            kind = head & 15
            fields[number] = kind == TRUE if kind in (TRUE, FALSE) else self._value(kind)
        return fields

    def _byte(self) -> int:
        self.place += 1
        return self.data[self.place - 1]

    def _bytes(self, length: int) -> bytes:
        self.place += length
        if self.place > len(self.data):
            raise ValueError("the footer is cut")
        return self.data[self.place - length : self.place]

    def _read_unsigned(self) -> int:
        found, shift = 0, 0
        while (byte := self._byte()) & 128:
            found |= (byte & 127) << shift
            shift += 7
        return found | byte << shift

    def _integer(self) -> int:
        """Return a signed integer in zigzag encoding."""
        found = self._read_unsigned()
        return (found >> 1) ^ -(found & 1)

    def _value(self, kind: int) -> Any:
        if kind in (TRUE, FALSE, BYTE):  # in a list, each of these values takes one byte
            return self._byte()
        if kind in INTEGERS:
            return self._integer()
        if kind == DOUBLE:
            return self._bytes(8)
        if kind == BINARY:
            return self._bytes(self._read_unsigned())
        if kind in LISTS:
            head = self._byte()
            length = self._read_unsigned() if head >> 4 == 15 else head >> 4
            return [self._value(head & 15) for _ in range(length)]
        if kind == STRUCT:
            return self.structure()
        raise ValueError(f"the footer has an element of the unknown type {kind}")


class LazyColumns(Mapping[str, object], ABC):
    """The columns of a file, each read on access.

    The name "column.0" is an element of a column of lists, and "column.field" is a field of a column of structures.
    """

    kind: ClassVar[str]

    def __init__(self, names: Sequence[str]) -> None:
        self._names = names

    @abstractmethod
    def read(self, name: str) -> pl.Series:
        """Return the column with the given name in the file."""

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
    """Return an element or a field of every value. Raises KeyError if no value has the element or the field."""
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
