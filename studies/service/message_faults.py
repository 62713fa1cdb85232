"""Faults of messages: invalid samples, damaged and foreign messages, clocks, counters that wrap."""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from pmfid.stream.blocks import encode
from pmfid.stream.delivery import Block
from studies.service.finding import Finding, changes, others_unchanged, sentences, without_alarm
from studies.service.hall import SAMPLES, Change, Hall, Metrics, hall, lost, name_of
from studies.service.machines import DT

#: Seconds of samples before each fault, during it, and after it.
BEFORE, DURING, AFTER = 5.0, 1.0, 4.0


def nan(block: Block) -> list[bytes]:
    return [encode(lost(block, slice(5, 15)))]


def infinite(block: Block) -> list[bytes]:
    """Return a block with an infinite input, by new bits after the header and a new checksum: no encoder makes one."""
    data = bytearray(encode(replace(block, u=block.u.astype(np.float32).astype(np.float64))))
    at = 40 + len(block.axis) + -len(block.axis) % 8
    struct.pack_into("<f", data, at, math.inf)
    struct.pack_into("<I", data, len(data) - 4, zlib.crc32(data[:-4]))
    return [bytes(data)]


def wrong_crc(block: Block) -> list[bytes]:
    data = encode(block)
    return [data[:-1] + bytes([data[-1] ^ 1])]


def oversized(block: Block) -> list[bytes]:
    """Return a block with enough further bytes to exceed `largest`; the broker still delivers it."""
    return [encode(block) + bytes(2**20)]


def beyond(block: Block) -> list[bytes]:
    """Return a message beyond the size that the service has requested from the broker."""
    return [encode(block) + bytes(2**21)]


def other_version(block: Block) -> list[bytes]:
    data = encode(block)
    return [data[:4] + b"\x02" + data[5:]]


def hour_back(block: Block) -> list[bytes]:
    return [encode(replace(block, time=block.time - 3600.0))]


def hour_forward(block: Block) -> list[bytes]:
    return [encode(replace(block, time=block.time + 3600.0))]


#: Description -> the change, and whether it loses a block.
FAULTS: dict[str, tuple[Change, bool]] = {
    "NaN: 10 of 25 inputs of each block": (nan, False),
    "Inf in each block": (infinite, True),
    "wrong CRC": (wrong_crc, True),
    "oversized: 1 MiB more than a block, delivered": (oversized, True),
    "oversized: 2 MiB, more than the broker may deliver": (beyond, True),
    "blocks of version 2": (other_version, True),
    "the sender's clock an hour back, for good": (hour_back, False),
    "the sender's clock an hour ahead, and back": (hour_forward, False),
}


def message_faults(there: Hall) -> Iterator[Finding]:
    """Yield the findings of the faults, each on its own axis."""
    there.play(BEFORE)
    there.through()
    there.notices()
    always: dict[int, Change] = {}
    for k, (fault, (change, gone)) in enumerate(FAULTS.items()):
        before, since = there.served.metrics(), there.at
        there.play(DURING, changes={k: change, **always})
        if "for good" in fault:
            always[k] = change
        there.play(AFTER, changes=always)
        after, reported = there.through(), there.notices()
        missing = there.total("pmfid_samples_missing_total", after) - there.total("pmfid_samples_missing_total", before)
        wanted = DURING / DT if gone else 0.0
        claims = [
            others_unchanged(there, since),
            (f"{missing:g} samples are said to be missing, {wanted:g} are", missing == wanted),
            (f"{there.sent:g} sent, {there.accounted(after):g} accounted for", there.accounted(after) == there.sent),
            without_alarm(reported),
        ]
        claims += _own_claims(there, k, change, before, after, since)
        own = [one for one in reported if one["axis"] in ("", name_of(k))]
        yield Finding(fault, sentences(own), changes(before, after), claims)
    there.play(1.0)  # the clock is right again
    there.through()


def _own_claims(
    there: Hall, k: int, change: Change, before: Metrics, after: Metrics, since: int
) -> Iterator[tuple[str, bool]]:
    """Yield the claims on the axis itself."""
    if change in (hour_back, hour_forward):
        rows, differ = there.compared(since, [k])
        yield f"{rows} rows of the axis itself to the last bit, {differ} differ: numbers rule", rows > 0 and not differ
    if change is nan:
        name = "pmfid_samples_without_input_total"
        found, wanted = there.total(name, after) - there.total(name, before), 10 * DURING / DT / SAMPLES
        yield f"{found:g} inputs are said to be lost, {wanted:g} are", found == wanted


def wrapped(bits: int) -> Change:
    """Return the change of an axis's counter to one of `bits` bits, which begins just before its wrap."""

    def change(block: Block) -> Sequence[bytes]:
        half = 2 ** (bits - 1)
        counts = (block.counts + half - 1 + half) % (2 * half) - half
        return [encode(replace(block, counts=counts))]

    return change


BITS = (16, 24, 32)


def wraps(place: Path) -> Finding:
    """Compare axes with counters of 16, 24 and 32 bits to one whose counter never wraps, all in the same motion."""
    seconds = 30.0
    more = "".join(f'\n[axes.w{bits}]\nconfig = "w{bits}.toml"\n' for bits in BITS)
    with hall(place, 1, seconds, more, ready=write_wrapping) as there:
        there.notices()
        before = there.served.metrics()
        twins = {bits: wrapped(bits) for bits in BITS}
        _play_twins(there, twins, seconds)
        there.sent *= 1 + len(BITS)
        after, reported = there.through(), there.notices()
        numbers, theta = there.rows(name_of(0))
        claims = [without_alarm(reported)]
        for bits in BITS:
            found, own = there.rows(f"w{bits}")
            differ = int((own.view(np.int64) != theta.view(np.int64)).sum()) if own.shape == theta.shape else -1
            claims.append((f"{bits} bits: {found.size} rows as without a wrap, {differ} numbers differ", differ == 0))
        claims.append((f"{there.accounted(after):g} of {there.sent} samples", there.accounted(after) == there.sent))
        crossed = np.ptp(np.sign(there.counts[: there.at] - 0.5)) > 0
        claims.append(("the counters did wrap", bool(crossed) and numbers.size > 0))
        return Finding("encoders that wrap at 16, 24 and 32 bits", sentences(reported), changes(before, after), claims)


def _play_twins(there: Hall, twins: dict[int, Change], seconds: float) -> None:
    def all_of_them(block: Block) -> list[bytes]:
        own = [data for bits, twin in twins.items() for data in twin(replace(block, axis=f"w{bits}"))]
        return [encode(block), *own]

    there.play(seconds, changes={0: all_of_them})


def write_wrapping(place: Path) -> None:
    """Write an equal AXIS.toml for each number of bits."""
    text = (place / "cell.toml").read_text()
    for bits in BITS:
        (place / f"w{bits}.toml").write_text(text.replace("[model]", f"bits = {bits}\n\n[model]", 1))
