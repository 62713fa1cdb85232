"""The metrics are read back by a strict parser of Prometheus's text format."""

from __future__ import annotations

import mmap
import os
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pmfid.service import metrics
from pmfid.stream.outcome import Counters

NAME = r"[a-zA-Z_:][a-zA-Z0-9_:]*"
LABEL = r'([a-zA-Z_][a-zA-Z0-9_]*)="((?:[^"\\\n]|\\\\|\\"|\\n)*)"'
SAMPLE = re.compile(rf"({NAME})(?:\{{({LABEL}(?:,{LABEL})*)?\}})? (NaN|[+-]Inf|-?\d+(?:\.\d+)?(?:e[+-]?\d+)?)")
ESCAPES = {"\\\\": "\\", '\\"': '"', "\\n": "\n"}

Parsed = dict[tuple[str, tuple[tuple[str, str], ...]], float]


def parsed(text: str) -> tuple[Parsed, dict[str, str], dict[str, str]]:
    """Return samples, HELP and TYPE of the families.

    Raises AssertionError for a violation of the format: lines of a family that are apart or precede its TYPE, a sample
    that appears twice, or no line feed at the end.
    """
    assert text.endswith("\n")
    samples: Parsed = {}
    helps: dict[str, str] = {}
    types: dict[str, str] = {}
    family = ""
    for line in text[:-1].split("\n"):
        if line.startswith("# HELP "):
            _, _, family, words = line.split(" ", 3)
            assert family not in helps, "a family comes once"
            helps[family] = words
        elif line.startswith("# TYPE "):
            _, _, name, kind = line.split(" ")
            assert name == family, "TYPE stands after HELP"
            assert kind in ("counter", "gauge")
            types[name] = kind
        else:
            match = SAMPLE.fullmatch(line)
            assert match, line
            assert match[1] == family, "samples stand after the TYPE of their family"
            pairs = re.findall(LABEL, match[2] or "")
            labels = tuple((label, re.sub(r"\\.", lambda m: ESCAPES[m[0]], value)) for label, value in pairs)
            assert len(dict(labels)) == len(labels)
            assert (family, labels) not in samples
            samples[family, labels] = float(match[match.lastindex or 0])
    return samples, helps, types


@given(
    st.dictionaries(
        st.tuples(
            st.sampled_from(["pmfid_samples_total", "pmfid_a_total", "pmfid_level", "pmfid_sink_working"]),
            st.text(max_size=12),
        ),
        st.floats(),
        max_size=12,
    )
)
def test_what_is_counted_is_read_back(values: dict[tuple[str, str], float]) -> None:
    counters = Counters()
    for (name, label), value in values.items():
        counters.put(name, value, source="a", reason=label)
    samples, _, types = parsed(metrics.exposition(counters))
    for (name, label), value in values.items():
        assert samples[name, (("reason", label), ("source", "a"))] == pytest.approx(value, rel=1e-15, nan_ok=True)
        assert types[name] == ("counter" if name.endswith("_total") else "gauge")


def test_totals_have_help_and_type() -> None:
    counters = Counters()
    counters.add("pmfid_samples_total", 3)
    counters.put("pmfid_no_such_thing", np.float64(0.5))
    samples, helps, types = parsed(metrics.exposition(counters))
    assert samples["pmfid_samples_total", ()] == 3
    assert samples["pmfid_no_such_thing", ()] == 0.5
    assert helps["pmfid_samples_total"] == "Samples that a monitor processed."
    assert helps["pmfid_no_such_thing"] == "No such thing."
    assert types["pmfid_samples_total"] == "counter"


def test_names_that_the_format_does_not_know_are_mended() -> None:
    counters = Counters()
    counters.put("pmfid-level é", 1, **{"a label": "x", "1": "y"})
    samples, _, _ = parsed(metrics.exposition(counters))
    assert samples["pmfid_level__", (("_1", "y"), ("a_label", "x"))] == 1


def process_levels() -> dict[str, float]:
    samples, _, _ = parsed(metrics.exposition(Counters()))
    return {name: value for (name, _), value in samples.items()}


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="this system has no /proc")
def test_the_figures_of_the_process(tmp_path: Path) -> None:
    before = process_levels()
    size = 30_000_000
    fresh = mmap.mmap(-1, size)  # memory that the process cannot have had before
    fresh.write(bytes(size))
    files = [open(tmp_path / str(k), "w") for k in range(5)]  # noqa: SIM115
    after = process_levels()
    for file in files:
        file.close()
    fresh.close()
    assert after["process_open_fds"] == before["process_open_fds"] + 5
    assert after["process_resident_memory_bytes"] > before["process_resident_memory_bytes"] + 0.8 * size
    assert after["process_virtual_memory_bytes"] > after["process_resident_memory_bytes"]
    assert after["process_cpu_seconds_total"] > before["process_cpu_seconds_total"]
    assert after["process_start_time_seconds"] == pytest.approx(os.stat("/proc/self").st_ctime, abs=5)
    assert after["process_max_fds"] > after["process_open_fds"] > 3
    _, _, types = parsed(metrics.exposition(Counters()))
    assert types["process_cpu_seconds_total"] == "counter"


def test_a_name_that_is_no_utf8_is_written() -> None:
    counters = Counters()
    counters.put("pmfid_axes", 3, config="cart\udcff.toml")
    samples, _, _ = parsed(metrics.exposition(counters))
    assert samples["pmfid_axes", (("config", "cart?.toml"),)] == 3


def test_the_parser_is_strict() -> None:
    for wrong in ("a 1", "# HELP a A.\n# TYPE a gauge\nb 1", '# HELP a A.\n# TYPE a gauge\na{b="\\x"} 1'):
        with pytest.raises(AssertionError):
            parsed(wrong + "\n")


def test_whatever_the_service_counts_has_its_help() -> None:
    source = Path(metrics.__file__).parent
    texts = (path.read_text(encoding="utf-8") for path in source.rglob("*.py") if path.name != "metrics.py")
    counted = {name for text in texts for name in re.findall(r'\.(?:add|put)\(\s*"(\w+)"', text)}
    assert len(counted) > 10
    assert counted - set(metrics.HELP) == set()
