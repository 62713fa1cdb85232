"""NumPy files: .npz with an array for each column, or .npy with one array."""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray

from pmfid.errors import UsageError
from pmfid.io.hdf5 import flatten_fields
from pmfid.io.safety import checked_archive
from pmfid.io.tables import Table

ARRAY = b"\x93NUMPY"


def parse_numpy(data: bytes) -> Table:
    """Return the arrays by name, and the columns of a matrix by name and number.

    The columns of a single array have the names of its fields, or the numbers of its columns. Raises UsageError for
    arrays of objects, which would need unpickling, and ValueError for damage.
    """
    if data.startswith(ARRAY):
        return flatten_fields({"": _array(data)})
    with checked_archive(data) as archive:
        names = [name for name in archive.namelist() if name.endswith(".npy")]
        return flatten_fields({name.removesuffix(".npy"): _array(archive.read(name)) for name in names})


def _array(data: bytes) -> NDArray[np.generic]:
    stream = io.BytesIO(data)
    version = np.lib.format.read_magic(stream)
    head = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, by_columns, dtype = head(stream)
    if dtype.hasobject:
        raise UsageError("an array of objects cannot be read: save arrays of float with numpy.savez")
    body = data[stream.tell() :]
    size = int(np.prod(shape, dtype=object)) * dtype.itemsize
    if size != len(body):
        raise ValueError(f"{len(body)} bytes of values, but the shape {shape} has {size}")
    return np.frombuffer(body, dtype).reshape(shape, order="F" if by_columns else "C")
