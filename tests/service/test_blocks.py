"""Binary blocks: sent data arrive, a damaged block has a reason, and its neighbours remain."""

from __future__ import annotations

import re
import struct
import subprocess
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pmfid.stream.blocks import MOST_SAMPLES, encode, items
from pmfid.stream.delivery import Block, Unusable, split_tables
from tests.firmware.build import GCC

ROOT = Path(__file__).parents[2]
NAN = float("nan")
EXAMPLE = Block("x1", 7, 12, 1.5, 0.002, np.array([0.5, NAN, -1.25]), np.array([100, 101, 99]))


def decode(data: bytes) -> list[Block | Unusable]:
    return split_tables(items(data))  # type: ignore[return-value]


def block(k: int = 0, n: int = 3, axis: str = "x1") -> Block:
    u = np.random.default_rng(k).normal(size=n)
    return Block(axis, 1, 1000 * k, 0.5 * k, 0.01, u, np.arange(n) * 7 - 5)


def same(one: object, other: Block) -> bool:
    if not isinstance(one, Block):
        return False
    scalars = [(b.axis, b.epoch, b.first, str(b.time), b.dt) for b in (one, other)]
    u, counts = np.array_equal(one.u, other.u, equal_nan=True), np.array_equal(one.counts, other.counts)
    ages = (one.ages is None) == (other.ages is None)
    ages = ages and (one.ages is None or np.array_equal(one.ages, np.asarray(other.ages), equal_nan=True))
    return (
        scalars[0] == scalars[1]
        and u
        and counts
        and ages
        and one.u.dtype == np.float64
        and one.counts.dtype == np.int64
    )


def signed(body: bytes) -> bytes:
    return body + struct.pack("<I", zlib.crc32(body))


numbers = st.floats(allow_infinity=False, width=64) | st.floats(allow_infinity=False, width=32)
samples = st.lists(
    st.tuples(numbers, st.integers(-(2**53) + 1, 2**53 - 1) | st.integers(-9, 9)), min_size=1, max_size=9
)
names = st.text(st.characters(exclude_categories=("C", "Z")), min_size=1, max_size=16)
any_block = st.builds(
    lambda name, epoch, first, time, dt, values, age: Block(
        name,
        epoch,
        first,
        time,
        dt,
        np.array([u for u, _ in values]),
        np.array([c for _, c in values], np.int64),
        None if age is None else np.resize([age, 0.1], len(values)),
    ),
    names,
    st.integers(0, 2**32 - 1),
    st.integers(0, 2**53 - 9),
    st.floats(-1e29, 1e29) | st.just(NAN),
    st.floats(1e-9, 1e9),
    samples,
    st.none() | st.floats() | st.floats(width=32),
)


@settings(max_examples=60)
@given(st.lists(any_block, min_size=1, max_size=4))
def test_what_is_sent_comes_out_to_the_bit(blocks: list[Block]) -> None:
    found = decode(b"".join(map(encode, blocks)))
    assert len(found) == len(blocks)
    assert all(map(same, found, blocks))


def changed(at: int, new: bytes) -> bytes:
    """Return a block with other bytes at one place and the right checksum."""
    body = bytearray(encode(block())[:-4])
    body[at : at + len(new)] = new
    return signed(bytes(body))


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (changed(0, b"X"), "magic"),
        (changed(4, b"\x03"), "version"),
        (changed(5, b"\x04"), "length"),
        (changed(6, b"\x00\x00"), "length"),
        (changed(6, b"\x01\x04"), "length"),
        (changed(12, b"\x00"), "length"),
        (changed(12, b"\x41"), "length"),
        (encode(block())[:-5], "crc"),
        (encode(block())[:30], "crc"),
        (encode(block())[:-1] + b"\x00", "crc"),
        (changed(40, b"\xff"), "name"),
        (changed(40, b"\n"), "name"),
        (changed(16, struct.pack("<Q", 2**63)), "number"),
        (changed(24, struct.pack("<d", float("inf"))), "not finite"),
        (changed(32, struct.pack("<d", NAN)), "not finite"),
        (changed(32, struct.pack("<d", -1.0)), "not finite"),
        (changed(48, struct.pack("<d", float("-inf"))), "not finite"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_bad_block_says_why_and_its_neighbours_stay(bad: bytes, reason: str) -> None:
    found = decode(encode(block(1)) + bad + encode(block(2)))
    assert same(found[0], block(1))
    assert same(found[-1], block(2))
    (only,) = found[1:-1]
    assert isinstance(only, Unusable)
    assert only.reason == reason
    assert only.problem


@pytest.mark.parametrize("seed", range(4))
def test_damage_anywhere_never_raises_and_costs_little(seed: int) -> None:
    """Bytes change, vanish or appear: every block that is read was sent, and most blocks are read."""
    rng = np.random.default_rng(seed)
    blocks = [block(k, int(rng.integers(1, 40)), f"axis-{k}") for k in range(40)]
    sent = {b.axis: b for b in blocks}
    for _ in range(25):
        data = bytearray(b"".join(map(encode, blocks)))
        for _ in range(hits := int(rng.integers(1, 4))):
            at, size = int(rng.integers(len(data))), int(rng.integers(1, 9))
            data[at : at + size * int(rng.integers(2))] = rng.bytes(size * int(rng.integers(2)))
        found = decode(bytes(data))
        good = [item for item in found if isinstance(item, Block)]
        assert all(same(item, sent[item.axis]) for item in good)
        assert len(good) >= len(blocks) - 2 * hits


def hex_dump(data: bytes) -> str:
    return "\n".join(f"{at:04x}  {data[at : at + 16].hex(' ')}" for at in range(0, len(data), 16))


def test_the_page_shows_the_bytes_of_a_block() -> None:
    shown = re.findall(r"```\n(0000 .*?)\n```", (ROOT / "docs" / "wire.md").read_text(encoding="utf-8"), re.DOTALL)
    assert shown == [hex_dump(encode(EXAMPLE))]


# --- the encoder in C -------------------------------------------------------------------------------------------------

PROGRAM = """\
#include <stdio.h>
#include <string.h>
#include "pmf_block.h"

int main(void)
{
    static uint8_t out[PMF_BLOCK_EDGES_SIZE(PMF_BLOCK_NAME, PMF_BLOCK_SAMPLES)];
    static float u[PMF_BLOCK_SAMPLES], ages[PMF_BLOCK_SAMPLES];
    static int32_t counts[PMF_BLOCK_SAMPLES];
    char name[80];
    pmf_block_t block = {name, 4000000000U, 9007199254730000U, 1.7e9, 0.00025, 0U, u, counts, 0};
    uint32_t sizes[] = {1U, 2U, 50U, 1024U}, letters[] = {1U, 7U, 8U, 64U}, i, k, size;
    for (i = 0U; i < PMF_BLOCK_SAMPLES; ++i) {
        u[i] = (float)i * 0.37f - 100.0f;
        counts[i] = (int32_t)(i * 40503U * 65536U + i);
        ages[i] = (float)i * 1e-7f;
    }
    memset(name, 'a', sizeof name);
    for (k = 0U; k < 4U; ++k) {
        name[letters[k]] = '\\0';
        block.samples = sizes[k];
        size = pmf_block(&block, out, (uint32_t)sizeof out);
        if (size != PMF_BLOCK_SIZE(letters[k], sizes[k]) || pmf_block(&block, out, size - 1U) != 0U) {
            return 1;
        }
        fwrite(out, 1U, size, stdout);
        block.ages = ages;
        size = pmf_block(&block, out, (uint32_t)sizeof out);
        if (size != PMF_BLOCK_EDGES_SIZE(letters[k], sizes[k]) || pmf_block(&block, out, size - 1U) != 0U) {
            return 1;
        }
        fwrite(out, 1U, size, stdout);
        block.ages = 0;
        name[letters[k]] = 'a';
    }
    block.samples = PMF_BLOCK_SAMPLES + 1U;
    name[3] = '\\0';
    k = pmf_block(&block, out, (uint32_t)sizeof out);
    block.samples = 0U;
    k += pmf_block(&block, out, (uint32_t)sizeof out);
    block.samples = 1U;
    name[0] = '\\0';
    k += pmf_block(&block, out, (uint32_t)sizeof out);
    name[0] = name[3] = 'a';
    name[65] = '\\0';
    return (int)(k + pmf_block(&block, out, (uint32_t)sizeof out));
}
"""
WARNINGS = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wconversion", "-Wdouble-promotion"]


@pytest.mark.skipif(bool(GCC.missing), reason=GCC.missing)
def test_the_drive_writes_the_bytes_of_python(tmp_path: Path) -> None:
    wire = ROOT / "csrc" / "wire"
    (tmp_path / "main.c").write_text(PROGRAM)
    sources = ["main.c", str(wire / "pmf_block.c"), f"-I{wire}"]
    subprocess.run(["gcc", *WARNINGS, "-fsanitize=undefined,address", "-o", "main", *sources], cwd=tmp_path, check=True)
    run = subprocess.run([tmp_path / "main"], capture_output=True, check=True)
    i = np.arange(MOST_SAMPLES)
    u = i.astype(np.float32) * np.float32(0.37) - np.float32(100)
    counts = (i * 40503 * 65536 + i).astype(np.uint32).astype(np.int32)
    ages = (i.astype(np.float32) * np.float32(1e-7)).astype(float)
    values = 4_000_000_000, 9007199254730000, 1.7e9, 0.00025
    expected = [
        Block("a" * m, *values, u[:n].astype(float), counts[:n].astype(np.int64), own)
        for m, n in ((1, 1), (7, 2), (8, 50), (64, 1024))
        for own in (None, ages[:n])
    ]
    assert run.stdout == b"".join(map(encode, expected))
    assert all(map(same, decode(run.stdout), expected))
