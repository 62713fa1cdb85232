"""HDF5 files, and MATLAB v7.3 files, which are HDF5 after a header of MATLAB."""

from __future__ import annotations

import io
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pmfid.session.formats.nested import flatten_fields
from pmfid.session.formats.safety import check_unpacked, require_extra
from pmfid.session.tables import Table

SIGNATURE = b"\x89HDF\r\n\x1a\n"
#: Place of the signature in a MATLAB v7.3 file.
MATLAB_HEADER = 512
#: Most datasets of a record.
MOST = 10_000


class _Dataset(Protocol):
    dtype: np.dtype[np.generic]
    nbytes: int
    ndim: int
    external: object
    is_virtual: bool
    attrs: dict[str, object]

    def __getitem__(self, key: tuple[()]) -> NDArray[np.generic]: ...


def parse_hdf5(data: bytes) -> Table:
    """The datasets of numbers by dotted path, groups and MATLAB structures alike: "run.axis.u".

    Data in other files are left out: a record is one file. Raises UsageError for a decompression bomb; `readable` turns
    errors of h5py into UsageError.
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


def _is_column(item: _Dataset) -> bool:
    """Does a dataset hold numbers, or structures of numbers, in this file?"""
    kind = item.attrs.get("MATLAB_class", b"")
    return item.dtype.kind in "biufV" and not item.external and not item.is_virtual and kind not in (b"char", b"cell")
