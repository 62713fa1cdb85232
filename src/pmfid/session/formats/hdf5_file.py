"""HDF5 files, and those of MATLAB v7.3, which are HDF5 behind a header of their own."""

from __future__ import annotations

import io
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pmfid.session.formats.nested import flatten_fields
from pmfid.session.formats.safety import check_unpacked, require_extra
from pmfid.session.tables import Table

SIGNATURE = b"\x89HDF\r\n\x1a\n"
#: Where the signature of a MATLAB v7.3 file stands.
MATLAB_HEADER = 512
#: Datasets that a record may have.
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

    Data that lie in other files are left out: a record is one file. Raises UsageError for a bomb, and with what h5py
    raises what `readable` turns into one.
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
    """Numbers, or structures of these, that lie in this file."""
    told = item.attrs.get("MATLAB_class", b"")
    return item.dtype.kind in "biufV" and not item.external and not item.is_virtual and told not in (b"char", b"cell")
