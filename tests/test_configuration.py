"""The kernel's configuration and header."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

import pmfid
from pmfid import _kernel32, _kernel64
from pmfid.kernel import configuration
from pmfid.kernel.saved import configuration as configuration_of
from pmfid.kernel.structures import constants_of, header, structures, value, whole_words
from pmfid.status import Status
from tests.refusals import refused

NEW = "brand_new"


def made(method: str) -> pmfid.RLS:
    model = pmfid.Drive(input_gain=1.7)
    estimator: pmfid.RLS = getattr(pmfid, method)(model, pmfid.Encoder(3e-5), 2e-3, cutoff=31.0, forgetting=0.997)
    return estimator


def config_of(method: str) -> np.ndarray[Any, Any]:
    return configuration_of(made(method).kernel, "float64").copy()


def grown(place: str) -> np.dtype[Any]:
    """Return the configuration's type with one more field in one of its structures."""
    whole = structures(None, "float64")["pmf_config_t"]
    fields = [(name, whole[name]) for name in whole.names or ()]
    part = [*((name, whole[place][name]) for name in whole[place].names or ()), (NEW, np.dtype("<u4"))]
    return np.dtype([(name, np.dtype(part) if name == place else kind) for name, kind in fields])


@pytest.mark.parametrize(
    ("method", "place"),
    [
        ("RLS", "encoder"),
        ("RLS", "network"),
        ("RLS", "direct"),
        ("RIV", "instrument"),
        ("RIV", "auxiliary"),
    ],
)
def test_a_field_without_a_value_is_found(method: str, place: str, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = config_of("RLS").tobytes()

    class Kernel(_kernel64.Kernel):
        """A kernel that takes the configuration of the original estimator, without the new field."""

        def __init__(self, config: bytes) -> None:
            super().__init__(plain)

    monkeypatch.setattr(_kernel64, "Kernel", Kernel)
    monkeypatch.setattr(configuration, "structures", lambda *_: {"pmf_config_t": grown(place)})
    refused((rf"missing \['{NEW}'\]", lambda: made(method)))


def test_a_value_without_a_field_is_found() -> None:
    tap = np.zeros((), structures(None, "float64")["pmf_tap_t"])
    wrong = {"node": 1, "weight": 2.0, "wait": 3.0}
    refused((r"unknown \['wait'\]", lambda: configuration.fill(tap, wrong)), kind=ValueError)


@pytest.mark.parametrize("kernel", [_kernel32.Kernel, _kernel64.Kernel])
def test_another_number_of_bytes_is_refused(kernel: type[_kernel64.Kernel]) -> None:
    refused(("a configuration has", lambda: kernel(b"\0" * 100)), kind=ValueError)


@pytest.mark.parametrize("method", ["RLS", "RIV"])
def test_a_kernel_from_the_bytes_of_another_gives_its_bits(method: str) -> None:
    one = made(method).kernel
    other = _kernel64.Kernel(one.raw_config())
    u, counts = np.sin(np.arange(300) / 9), (np.arange(300) ** 2 // 50).astype(np.int64)
    for mine, its in zip(one.run(u, counts), other.run(u, counts), strict=True):
        assert mine.tobytes() == its.tobytes()


def test_the_status_has_the_numbers_of_the_header() -> None:
    constants = constants_of(None)
    assert sum(Status) == constants["PMF_STATUS_BITS"]  # every status bit is named
    assert all(constants[f"PMF_{bit.name}"] == bit for bit in Status)


@pytest.mark.parametrize(
    ("text", "number"),
    [
        ("8", 8),
        ("0x1fU", 31),
        ("(4 * SIZE + 4)", 36),
        ("-SIZE + 10 / 3", -5),
        ("SIZE > 7", 1),
        ("SIZE > 0x8U", 0),
        (" 2 - (3 - 4)", 3),
    ],
)
def test_constant_expressions(text: str, number: int) -> None:
    assert value(text, {"SIZE": 8}) == number


@pytest.mark.parametrize(
    "text",
    [
        *("().__class__", "SIZE.bit_length()", "[1][0]", "2 ** 99", "OTHER", "PMF_R(1e30)", "1.5", "'a'"),
        *("a := 1", "", "1 2"),
    ],
)
def test_anything_else_is_refused(text: str) -> None:
    refused(("no constant expression", lambda: value(text, {"SIZE": 8})), kind=ValueError)


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_the_words_of_a_state_that_are_whole_numbers(precision: str) -> None:
    state, words = structures(None, precision)["pmf_state_t"], whole_words(precision)

    def place(*names: str) -> int:
        at, kind = 0, state
        for name in names:
            kind, offset = (kind.fields or {})[name][:2]
            at += offset
        return at // 4

    assert 4 * len(words) == state.itemsize
    assert [words[place(*names)] for names in (("status",), ("guard", "zero"))] == [1] * 2
    assert [words[place(*names)] for names in (("encoder", "position"), ("instrument", "mass"))] == [0] * 2
    estimate = place("direct", "estimate")
    assert not any(words[estimate : place("direct", "mass")])


def test_firmware_needs_none_of_the_inner_names() -> None:
    assert re.findall(r'#include "(.*?)"', header("pmf.h")) == ["pmf_sizes.h", "many/pmf_lanes.h", "pmf_redge_axis.h"]
    assert "pmf_recursion_step" not in header("pmf.h")
    assert "pmf_recursion_step" in header("pmf_internal.h")
