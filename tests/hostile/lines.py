"""Lines that loggers write into a pipe: good lines and faulty lines."""

from __future__ import annotations

import numpy as np

from tests.hostile.plants import Columns

Rng = np.random.Generator

#: Foreign lines that replace a line or come between two lines.
FOREIGN = [
    *(b"", b"# note", b"garbage", b"nan,nan,nan", b"1e308,1e308,1e308", b"0,0", b"0,0,0,0,0", b"\xff\xfe\0,"),
    *(b"t,u,counts",),
]
FOREIGN += [
    b"-5,1,2",
    b"1e6,0,0",
    b"0.1,inf,3",
    b"0.1,1,0.5",
    b"9" * 70_000,
    b",,,,",
    b"0.1,1," + b"9" * 400,
    b"\x1b[31m,1,2",
]
HEADERS = [
    *(b"t,u,y,counts", b"counts,t,u,y", b" t , u ,y,counts", b"t,u,counts", b"t,u,y,counts,u"),
    *(b"t,u, u,counts", b"", b"\xef\xbb\xbft,u,y,counts"),
]
ENDS = [b"\n", b"\r\n", b"\r"]


def as_pipe(rng: Rng, columns: Columns) -> bytes:
    """Return the record as lines; one line in fifty may be lost, repeated, cut off, moved in time, or foreign."""
    rows = list(
        zip(
            columns["t"].tolist(), columns["u"].tolist(), columns["y"].tolist(), columns["counts"].tolist(), strict=True
        )
    )
    part = float(rng.choice([0.0, 0.02, 0.2, 1.0], p=[0.4, 0.3, 0.2, 0.1]))
    wrong, shift, lines = (
        rng.random(len(rows)) < part,
        0.0,
        [HEADERS[0 if rng.random() < 0.8 else rng.integers(len(HEADERS))]],
    )
    for row, spoilt in zip(rows, wrong.tolist(), strict=True):
        shift += float(rng.choice([0.006, 3600.0, -0.5, 1e12])) if spoilt and rng.random() < 0.2 else 0.0
        line = ",".join(f"{value!r}" for value in (row[0] + shift, *row[1:])).encode()
        lines += _spoilt(rng, line) if spoilt else [line]
    return ENDS[0 if rng.random() < 0.9 else rng.integers(len(ENDS))].join(lines) + (
        b"\n" if rng.random() < 0.9 else b""
    )


def _spoilt(rng: Rng, line: bytes) -> list[bytes]:
    ways = [[], [line, line], [line[: rng.integers(len(line))]], [line], [line, FOREIGN[rng.integers(len(FOREIGN))]]]
    return ways[rng.integers(len(ways))]
