"""The metrics are read back by a strict parser of Prometheus's text format."""

from __future__ import annotations

import re
from pathlib import Path

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


def test_whatever_the_service_counts_has_its_help() -> None:
    source = Path(metrics.__file__).parent
    texts = (path.read_text(encoding="utf-8") for path in source.rglob("*.py") if path.name != "metrics.py")
    counted = {name for text in texts for name in re.findall(r'\.(?:add|put)\(\s*"(\w+)"', text)}
    assert len(counted) > 10
    assert counted - set(metrics.HELP) == set()
