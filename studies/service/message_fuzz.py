"""Send random messages of up to 1 MB for one axis to a service with little memory, while other axes send normally.

python -m studies.service.message_fuzz --minutes 10
"""

from __future__ import annotations

import argparse
import itertools
import json
import random
import re
import resource
import sys
import tempfile
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path

from pmfid.stream.blocks import encode
from pmfid.stream.delivery import Block
from studies.service.finding import Finding, others_unchanged
from studies.service.hall import Hall, hall, name_of

#: Bytes of the largest message and of the service's memory, and its allowed growth.
LARGEST, LIMIT, MORE = 1_000_000, 2**30, 0.5e9
#: Number of axes, number of the fuzzed axis, and random messages in place of each of its blocks.
AXES, FUZZED, AT_ONCE = 4, 3, 1
#: Longest time of the health check [s], and motion between two checks [s].
ANSWER, EVERY = 5.0, 5.0

Value = Callable[[random.Random], str]

VALUES: tuple[Value, ...] = (
    lambda draw: str(draw.randrange(-(2**70), 2**70)),
    lambda draw: repr(draw.uniform(-1e3, 1e3)),
    lambda draw: draw.choice(["1e400", "-1e400", "NaN", "Infinity", "null", "true", '""', "[]", "{}", "-0.0"]),
    lambda draw: json.dumps("x" * int(10 ** draw.uniform(0, 4))),
    lambda draw: "9" * int(10 ** draw.uniform(0, 3.5)),
    lambda draw: "[" * (depth := int(10 ** draw.uniform(0, 3))) + "]" * depth,
    lambda draw: '{"a":' * (depth := int(10 ** draw.uniform(0, 2))) + "1" + "}" * depth,
)
KEYS = ("t", "u", "counts", "axis", "time", "")


def columns(draw: random.Random, axis: str) -> bytes:
    """Return one object of columns with random rows, keys and types."""
    rows = int(10 ** draw.uniform(0, 5.3))
    value = draw.choice(VALUES)
    one = "[" + ",".join(itertools.repeat(value(draw), rows)) + "]"
    fields = [f'"{draw.choice(KEYS)}":{one}' for _ in range(3)]
    short = ",".join(f'"k{k}":[]' if draw.random() < 0.01 else f'"k{k}":0' for k in range(draw.randrange(80_000)))
    return f'{{"axis":"{axis}",{",".join(fields)},{short}}}'.encode()


def objects(draw: random.Random, axis: str) -> bytes:
    """Return objects in an array, or one in each line."""
    value = draw.choice(VALUES)
    fields = "".join(f',"{draw.choice(KEYS)}{k}":{value(draw)}' for k in range(int(10 ** draw.uniform(0, 3))))
    one = f'{{"axis":"{axis}"{fields}}}'
    number = min(int(10 ** draw.uniform(0, 6)), LARGEST // len(one))
    return ("\n".join([one] * number) if draw.random() < 0.5 else "[" + ",".join([one] * number) + "]").encode()


def many_axes(draw: random.Random, axis: str) -> bytes:
    """Return objects that each have another axis."""
    return "\n".join(f'{{"axis":"{axis}{k}","t":0}}' for k in range(draw.randrange(40_000))).encode()


def metrics(draw: random.Random, axis: str) -> bytes:
    """Return samples in the form of Telegraf."""
    fields = ",".join(f'"k{k}":{draw.choice(VALUES)(draw)}' for k in range(int(10 ** draw.uniform(0, 3))))
    own = f'"fields":{{{fields}}},"tags":{{"axis":"{axis}"}},"name":"drive"'
    return "\n".join(f'{{{own},"timestamp":{k}}}' for k in range(draw.randrange(1, 50))).encode()


def brackets(draw: random.Random, axis: str) -> bytes:
    return draw.choice([b"[", b"{", b"[]," * 10, b'{"a":', b'"', b"\\", b"\n", b"{}\n"]) * (LARGEST // 30)


def noise(draw: random.Random, axis: str) -> bytes:
    return draw.randbytes(int(10 ** draw.uniform(0, 6)))


def damaged_block(draw: random.Random, block: Block) -> bytes:
    data = bytearray(encode(block) * draw.randrange(1, 500))
    for _ in range(draw.randrange(1, 20)):
        data[draw.randrange(len(data))] = draw.randrange(256)
    return bytes(data)


KINDS = (columns, columns, objects, many_axes, metrics, brackets, noise)


def fuzzed(draw: random.Random, sent: list[int]) -> Callable[[Block], list[bytes]]:
    """Return a change of a block to random messages."""

    def change(block: Block) -> list[bytes]:
        messages = [draw.choice(KINDS)(draw, block.axis)[:LARGEST] for _ in range(AT_ONCE)]
        messages.append(damaged_block(draw, block)[:LARGEST])
        sent[:] = [sent[0] + len(messages), sent[1] + sum(map(len, messages))]
        return messages

    return change


def peak(process: int) -> float:
    """Return the peak resident memory of a process [byte]."""
    status = Path(f"/proc/{process}/status").read_text()
    return 1024.0 * int(re.findall(r"VmHWM:\s+(\d+)", status)[0])


def healthy(there: Hall) -> float:
    """Return the time of the health check [s], infinite if its answer is not ok."""
    begin = time.monotonic()
    with urllib.request.urlopen(f"http://127.0.0.1:{there.served.port}/healthz", timeout=60) as answer:
        well = answer.status == 200
    return time.monotonic() - begin if well else float("inf")


def attacked(there: Hall, minutes: float, seed: int) -> Iterator[tuple[str, bool]]:
    """Yield the claims after the given minutes of random messages."""
    process = there.served.process.pid
    resource.prlimit(process, resource.RLIMIT_DATA, (LIMIT, LIMIT))
    there.play(EVERY)
    there.through()
    begin, sent, slowest = peak(process), [0, 0], 0.0
    own = fuzzed(random.Random(seed), sent)
    end = time.monotonic() + 60 * minutes
    while time.monotonic() < end and there.served.process.poll() is None:
        there.play(EVERY, speed=1.0, changes={FUZZED: own})
        slowest = max(slowest, healthy(there))
        print(f"{sent[0]} messages, {sent[1] / 1e6:.0f} MB, peak {peak(process) / 1e6:.0f} MB", file=sys.stderr)
    unusable = there.total("pmfid_unusable_total")
    yield f"{sent[0]} messages of {sent[1] / 1e6:.0f} MB", sent[0] > 0
    yield f"alive after {minutes:g} minutes", there.served.process.poll() is None
    grown = peak(process) - begin
    yield f"{grown / 1e6:.0f} MB more than before, with a limit of {LIMIT / 1e6:.0f} MB", grown < MORE
    yield f"the health check answers within {slowest:.2f} s", slowest < ANSWER
    yield f"{unusable:g} notices of what cannot be read", unusable > 0
    time.sleep(5.0)
    yield others_unchanged(there)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        with hall(place, AXES, 60 * options.minutes + 120.0) as there:
            finding = Finding(
                f"fuzz of {name_of(FUZZED)}", [], [], list(attacked(there, options.minutes, options.seed))
            )
        tracebacks = (place / "log.jsonl").read_text(errors="replace").count("Traceback")
    print(finding.row())
    print(f"{tracebacks} tracebacks in the log")
    return int(not finding.holds or tracebacks > 0)


if __name__ == "__main__":
    sys.exit(main())
