"""HDF5 files and MATLAB files with nested groups."""

from __future__ import annotations

import io
import warnings
import zlib
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmfid.io.safety import MOST_BYTES, MOST_TIMES, check_unpacked, require_extra
from pmfid.io.tables import Table

#: Deepest structure with columns.
DEEPEST = 16


def flatten_fields(arrays: Mapping[str, NDArray[np.generic]]) -> dict[str, object]:
    """Return arrays by name, where the fields of structured arrays of any depth are "name.field"."""
    return {path: found for name, array in arrays.items() for path, found in _fields(name, array, DEEPEST)}


def _fields(path: str, array: NDArray[np.generic], depth: int) -> Iterator[tuple[str, NDArray[np.generic]]]:
    if array.dtype.names is None or depth == 0:
        yield from split_matrix(path, array)
        return
    for name in array.dtype.names:
        field: NDArray[np.generic] = array[name]  # type: ignore[call-overload]
        if field.dtype == object and field.size == 1 and isinstance(field.item(), np.ndarray):
            field = field.item()  # each field of a MATLAB structure is an array
        yield from _fields(f"{path}.{name}".lstrip("."), field, depth - 1)


def split_matrix(name: str, array: NDArray[np.generic]) -> Iterator[tuple[str, NDArray[np.generic]]]:
    """Yield the columns of a matrix, such as q_1 to q_7 for the joints of an arm, or any other array unchanged.

    A matrix has more samples than signals, in its rows or in its columns.
    """
    if array.ndim != 2 or min(array.shape) < 2 or array.shape[0] == array.shape[1]:
        yield name, array
        return
    rows = array if array.shape[0] > array.shape[1] else array.T
    yield from ((f"{name or 'column'}_{k + 1}", rows[:, k]) for k in range(rows.shape[1]))


SIGNATURE = b"\x89HDF\r\n\x1a\n"
#: Position of the signature in a MATLAB v7.3 file.
MATLAB_HEADER = 512
#: Largest number of datasets in a record.
MOST = 10_000


def parse_hdf5(data: bytes) -> Table:
    """Return the datasets of numbers by dotted path, such as "run.axis.u", from groups and MATLAB structures.

    Data in other files are left out, because a record is one file. Raises UsageError for a decompression bomb.
    `readable` turns errors of h5py into UsageError.
    """
    with require_extra("hdf5"):
        import h5py
    found: dict[str, NDArray[np.generic]] = {}
    left = len(data)

    def take(path: str, item: object) -> None:
        nonlocal left
        if not isinstance(item, h5py.Dataset) or path.startswith("#") or not _is_column(item):
            return
        left += item.nbytes
        check_unpacked(left, len(data), "the data")
        if len(found) < MOST:
            found[path.replace("/", ".")] = item[()]

    with h5py.File(io.BytesIO(data), "r") as file:
        file.visititems(take)
    return flatten_fields(found)


def _is_column(item: Any) -> bool:
    """Return whether a dataset holds numbers, or structures of numbers, in the file itself."""
    kind = item.attrs.get("MATLAB_class", b"")
    own = bool(not item.external and not item.is_virtual)
    return own and item.dtype.kind in "biufV" and kind not in (b"char", b"cell")


# Types of the elements in a MATLAB v5 file ("MAT-File Format", MathWorks, table 1-1). Other types are reserved.
_INT8, _INT32, _UINT32, _MATRIX, _COMPRESSED, _UTF8 = 1, 5, 6, 14, 15, 16
_NUMERIC = {1, 2, 3, 4, 5, 6, 7, 9, 12, 13, 16, 17, 18}
_CHAR_CLASS, _SPARSE_CLASS, _LAST_NUMERIC_CLASS, _COMPLEX = 4, 5, 15, 0x800


def parse_mat(data: bytes) -> Table:
    """Return the variables as arrays, with dotted paths for fields of structures, such as "run.axis.u".

    Raises ValueError for damage, which `readable` turns into UsageError.
    """
    import scipy.io

    if SIGNATURE in (data[: len(SIGNATURE)], data[MATLAB_HEADER : MATLAB_HEADER + len(SIGNATURE)]):
        return parse_hdf5(data)
    _check_mat(data)
    with warnings.catch_warnings(action="error", category=scipy.io.matlab.MatReadWarning):
        variables = scipy.io.loadmat(io.BytesIO(data))
    named = {name: value for name, value in variables.items() if not name.startswith("__")}
    # A sparse matrix or an object of another class is no column, and raises an error on access.
    arrays = {name: value if isinstance(value, np.ndarray) else np.empty(0, object) for name, value in named.items()}
    return flatten_fields(arrays)


def _check_mat(data: bytes) -> None:
    """Raise ValueError unless all sizes and types in a v5 file are consistent.

    With inconsistent sizes, the reader of SciPy ends the whole process. A file of another version passes the check, and
    the reader refuses the file.
    """
    order = {b"\x00\x01IM": "<", b"\x01\x00MI": ">"}.get(data[124:128])
    if order is None or 0 in data[:4]:
        return
    left = max(MOST_BYTES, MOST_TIMES * len(data))
    for kind, body in _elements(memoryview(data)[128:], order, padding=1):
        if kind == _COMPRESSED:
            inner = _unpack_element(body, left, len(data))
            left -= len(inner)
            ((kind, body),) = _elements(inner, order, padding=1)
        if kind != _MATRIX:
            raise ValueError(f"element of type {kind} in place of a variable")
        _check_matrix(body, order)


def _unpack_element(body: memoryview, most: int, packed: int) -> memoryview:
    """Return a decompressed element with at most `most` bytes. Raises UsageError before more bytes are decompressed."""
    stream = zlib.decompressobj()
    inner = stream.decompress(body, most + 1)
    if len(inner) > most:
        check_unpacked(max(MOST_BYTES, MOST_TIMES * packed) + 1, packed, "a variable")
    if not stream.eof:
        raise ValueError("a compressed variable is cut off")
    return memoryview(inner)


def _elements(data: memoryview, order: str, padding: int = 8) -> Iterator[tuple[int, memoryview]]:
    """Yield type and content of each element. `order` is "<" or ">", and `padding` is the alignment of elements
    [bytes].
    """
    word = np.dtype(f"{order}u4")
    start = 0
    while start < len(data):
        if len(data) - start < 8:
            raise ValueError("an element without its size")
        kind, size = (int(number) for number in np.frombuffer(data, word, 2, start))
        first, step = start + 8, -(-size // padding) * padding
        if kind >> 16:  # up to four bytes are stored in place of the size
            kind, size, first, step = kind & 0xFFFF, kind >> 16, start + 4, 4
        if size > min(step, len(data) - first):
            raise ValueError("an element is longer than the file")
        yield kind, data[first : first + size]
        start = first + step


def _check_matrix(body: memoryview, order: str) -> None:
    parts = list(_elements(body, order))
    if not parts:  # the cell is empty
        return
    kinds, sizes = [kind for kind, _ in parts], [len(part) for _, part in parts]
    if not (kinds[0] == _UINT32 and sizes[0] == 8):
        raise ValueError("a variable without its class")
    flags = int(np.frombuffer(parts[0][1], f"{order}u4", 1)[0])
    if flags & 0xFF <= _LAST_NUMERIC_CLASS:
        _check_array(kinds, sizes, flags)
    for kind, part in parts:
        if kind == _MATRIX:
            _check_matrix(part, order)
        elif kind not in _NUMERIC:
            raise ValueError(f"element of unknown type {kind}")


def _check_array(kinds: list[int], sizes: list[int], flags: int) -> None:
    """Raise ValueError unless an array has flags, dimensions, a name and values.

    In a sparse array, two rows of indices precede the values.
    """
    indices = 2 if flags & 0xFF == _SPARSE_CLASS else 0
    values = 2 if flags & _COMPLEX else 1
    nested = flags & 0xFF < _CHAR_CLASS
    if len(kinds) < (3 if nested else 3 + indices + values):
        raise ValueError("a variable without its dimensions, name or values")
    if kinds[1] not in (_INT32, _UINT32) or sizes[1] < 8 or kinds[2] not in (_INT8, _UTF8):
        raise ValueError("a variable with a wrong dimension or name")
    if not nested and _MATRIX in kinds:
        raise ValueError("a variable in place of values")
