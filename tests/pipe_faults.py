"""Faults that loggers make, from a row of a record onwards."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np

from pmfid.simulation import CART_DT

HEADER = b"t,u,counts\n"
NOON = datetime(2026, 3, 4, 12)

Row = tuple[float, float, int]
Text = list[bytes]


def text(row: Row) -> bytes:
    return f"{row[0]:.12g},{row[1]!r},{row[2]}\n".encode()


def restamped(rows: list[Row], begin: int, stamp: Callable[[float], float], end: int | None = None) -> list[Row]:
    part = slice(begin, end)
    return [*rows[:begin], *((stamp(t), u, c) for t, u, c in rows[part]), *(rows[end:] if end is not None else [])]


@dataclass(frozen=True)
class Fault:
    """A fault of a logger.

    `do` returns the lines with the fault from row k onwards. `lasts` is the number of wrong lines from row k. `first`
    is the first row at which the fault is possible.
    """

    do: Callable[[list[Row], int, np.random.Generator], Text]
    lasts: int = 1
    first: int = 1


def lines(rows: list[Row]) -> Text:
    return [text(row) for row in rows]


def insert(what: bytes | Callable[[list[Row], int], Text]) -> Fault:
    def do(rows: list[Row], k: int, rng: np.random.Generator) -> Text:
        extra = [what] if isinstance(what, bytes) else what(rows, k)
        return [*lines(rows[:k]), *extra, *lines(rows[k:])]

    return Fault(do)


def in_place(what: Callable[[Row], bytes], count: int = 1, first: int = 1) -> Fault:
    def do(rows: list[Row], k: int, rng: np.random.Generator) -> Text:
        return [*lines(rows[:k]), *(what(row) for row in rows[k : k + count]), *lines(rows[k + count :])]

    return Fault(do, count, first)


def stamp(change: Callable[[float], float], count: int | None = 1) -> Fault:
    def do(rows: list[Row], k: int, rng: np.random.Generator) -> Text:
        return lines(restamped(rows, k, change, None if count is None else k + count))

    return Fault(do, count or 1)


def order(places: list[int]) -> Fault:
    def do(rows: list[Row], k: int, rng: np.random.Generator) -> Text:
        part = [rows[k + place] for place in places]
        return lines([*rows[:k], *part, *rows[k + len(places) :]])

    return Fault(do, len(places))


def without(pick: Callable[[int], bool], count: int) -> Fault:
    def do(rows: list[Row], k: int, rng: np.random.Generator) -> Text:
        return lines([row for i, row in enumerate(rows) if not (k <= i < k + count and pick(i - k))])

    return Fault(do, count)


def starts_again(header: bytes, counts: bool) -> Fault:
    def do(rows: list[Row], k: int, rng: np.random.Generator) -> Text:
        (t0, _, c0), zero = rows[k], 1 if counts else 0
        again = [(t - t0, u, c - zero * c0) for t, u, c in rows[k:]]
        return [*lines(rows[:k]), *([header] if header else []), *lines(again)]

    return Fault(do)


def goes_on(header: bytes, line: str) -> Fault:
    """Return the fault that another program continues: `line` has the places {t}, {ms}, {day}, {u} and {c}."""

    def do(rows: list[Row], k: int, rng: np.random.Generator) -> Text:
        later = [
            line.format(t=f"{t:.12g}", ms=f"{1000 * t:.12g}", day=NOON + timedelta(seconds=t), u=repr(u), c=c)
            for t, u, c in rows[k:]
        ]
        return [*lines(rows[:k]), header, *(f"{one}\n".encode() for one in later)]

    return Fault(do)


def decimal_commas(rows: list[Row], k: int, rng: np.random.Generator) -> Text:
    later = [text(row).replace(b",", b";").replace(b".", b",") for row in rows[k:]]
    return [*lines(rows[:k]), b"t;u;counts\n", *later]


def jitter(rows: list[Row], k: int, rng: np.random.Generator) -> Text:
    later = [(t + 0.15 * CART_DT * float(rng.standard_normal()), u, c) for t, u, c in rows[k:]]
    return lines(rows[:k] + later)


def stall(rows: list[Row], k: int, rng: np.random.Generator) -> Text:
    """Write sixty lines at once, with the time stamps of that moment."""
    late = rows[k + 60][0]
    burst = [(late + 1e-4 * rng.random(), u, c) for _, u, c in rows[k : k + 60]]
    return lines([*rows[:k], *burst, *rows[k + 60 :]])


def two_loggers(rows: list[Row], k: int, rng: np.random.Generator) -> Text:
    other = [(t + 777.7, u + 1, c + 5000) for t, u, c in rows[k : k + 200]]
    mixed = [row for pair in zip(rows[k : k + 200], other, strict=True) for row in pair]
    return lines([*rows[:k], *mixed, *rows[k + 200 :]])


FAULTS: dict[str, Fault] = {
    "a line twice": insert(lambda rows, k: [text(rows[k - 1])]),
    "a line five times": insert(lambda rows, k: 4 * [text(rows[k - 1])]),
    "the last ten lines again": insert(lambda rows, k: lines(rows[max(0, k - 10) : k])),
    "the last three lines again": insert(lambda rows, k: lines(rows[max(0, k - 3) : k])),
    "a line between two": insert(lambda rows, k: [text((rows[k][0] - 0.005, *rows[k][1:]))]),
    "a foreign line": insert(lambda rows, k: [text((123.4, 1.0, 77))]),
    "garbage": insert(b"garbage\n"),
    "a comment": insert(b"# calibrated by hand\n"),
    "a comment of another kind": insert(b"  // calibrated by hand, at 1.5 mm\n"),
    "an empty line": insert(b"\r\n"),
    "empty lines between all": goes_on(b"\n", "{t},{u},{c}\n"),
    "the header again": insert(HEADER),
    "the header again, with a mark of its bytes": insert(b"\xef\xbb\xbft,u,counts\r\n"),
    "the header again, with units": insert(b"t [s],u [V],counts\n"),
    "the header again, with a row of units": insert(b"t,u,counts\ns,V,-\n"),
    "the header of another program": insert(b"time,current\n"),
    "columns in another order": goes_on(b"counts,t,u\n", "{c},{t},{u}"),
    "another column": goes_on(b"t,u,i,counts\n", "{t},{u},0.5,{c}"),
    "semicolons": goes_on(b"t;u;counts\n", "{t};{u};{c}"),
    "semicolons and decimal commas": Fault(decimal_commas),
    "tabs": goes_on(b"counts\tu\tt\n", "{c}\t{u}\t{t}"),
    "columns of spaces": goes_on(b"  counts   u     t\n", "{c:8d}   {u}  {t}"),
    "everything in quotes": goes_on(b'"t","u","counts"\n', '"{t}","{u}","{c}"'),
    "the time in ms": goes_on(b"t [ms],u [V],counts\n", "{ms},{u},{c}"),
    "the time as a date": goes_on(b"t,u,counts\n", "{day},{u},{c}"),
    "the time of day": goes_on(b"t,u,counts\n", "{day:%H:%M:%S.%f},{u},{c}"),
    "lines of Windows": goes_on(b"t,u,counts\r\n", "{t},{u},{c}\r"),
    "two lines swapped": order([1, 0]),
    "two pairs of lines swapped": order([1, 0, 3, 2]),
    "a line late by three": order([1, 2, 3, 0]),
    "three lines reversed": order([2, 1, 0]),
    "a line late by five": order([1, 2, 3, 4, 5, 0]),
    "a stamp 6 ms late": stamp(lambda t: t + 0.006),
    "a stamp 6 ms early": stamp(lambda t: t - 0.006),
    "a clock 6 ms on": stamp(lambda t: t + 0.006, None),
    "a clock 6 ms back": stamp(lambda t: t - 0.006, None),
    "a clock a sample on": stamp(lambda t: t + 0.01, None),
    "a clock a sample back": stamp(lambda t: t - 0.01, None),
    "a clock 3 samples back": stamp(lambda t: t - 0.03, None),
    "a clock a second back": stamp(lambda t: t - 1, None),
    "a clock a minute on": stamp(lambda t: t + 60, None),
    "a clock a year on": stamp(lambda t: t + 3.2e7, None),
    "the logger at 0 again": starts_again(b"", counts=False),
    "the logger and the counter at 0 again": starts_again(HEADER, counts=True),
    "a stamp of 1e6": stamp(lambda t: 1e6),
    "three stamps of 1e6": stamp(lambda t: 1e6, 3),
    "a negative stamp": stamp(lambda t: -5.0),
    "a stamp of a second later": stamp(lambda t: t + 1),
    "a line lost": without(lambda i: True, 1),
    "a second lost": without(lambda i: True, 100),
    "every third line lost for a second": without(lambda i: i % 3 == 0, 100),
    "a line cut off": in_place(lambda row: text(row)[:6]),
    "two lines in one": in_place(lambda row: text(row)[:-1]),
    "no number": in_place(lambda row: b"%.12g,nan,3\n" % row[0]),
    "half a count": in_place(lambda row: b"%.12g,1.0,0.5\n" % row[0]),
    "no time": in_place(lambda row: b"nan,1.0,%d\n" % row[2]),
    "a line cut in two": in_place(lambda row: text(row)[:7] + b"\n" + text(row)[7:]),
    "a line cut in two between its columns": in_place(lambda row: text(row).replace(b",", b"\n", 1)),
    "a line that ends as on old machines": in_place(lambda row: text(row)[:-1] + b"\r"),
    "zero bytes in front of a line": in_place(lambda row: b"\0\0\0\0" + text(row)),
    "zero bytes inside of a line": in_place(lambda row: text(row).replace(b",", b"\0,", 1)),
    "a line of zero bytes": insert(b"\0\0\0\0\n"),
    "no text": in_place(lambda row: b"\xff\xfe\x00\x01,\x00\n"),
    "a line of 200 kB": in_place(lambda row: 200_000 * b"7" + b"\n"),
    "a second of garbage": in_place(lambda row: b"offline\n", 100, first=10),
    "a clock that stands for a third of a second": stamp(lambda t: 4.0, 30),
    "stamps that jitter by 15 %": Fault(jitter),
    "sixty lines at once": Fault(stall, 60),
    "every line twice": Fault(lambda rows, k, rng: lines(rows[:k]) + [x for r in rows[k:] for x in 2 * [text(r)]]),
    "two loggers in one pipe": Fault(two_loggers, 200),
}
