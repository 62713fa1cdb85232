"""Python reads only numbers and sums of numbers from the kernel's header, and no executable code."""

from __future__ import annotations

import re

import pytest

from pmfid.estimators.auxiliary import FOLLOWED
from pmfid.estimators.recursive import LOOK
from pmfid.kernel.structures import constants_of, header, source_folder, structures, value, whole_words
from tests.refusals import refused


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
        "().__class__",
        "SIZE.bit_length()",
        "[1][0]",
        "2 ** 99",
        "OTHER",
        "PMF_R(1e30)",
        "1.5",
        "'a'",
        "a := 1",
        "",
        "1 2",
    ],
)
def test_anything_else_is_refused(text: str) -> None:
    refused(("no constant expression", lambda: value(text, {"SIZE": 8})), kind=ValueError)


def test_the_header_has_the_sizes() -> None:
    constants = constants_of(None)
    assert constants["PMF_MAX_COLUMNS"] == 5 * constants["PMF_MAX_PARAMETERS"] + 4
    assert constants["PMF_STATE_MAGIC"] == 0x53464D50
    assert constants["PMF_OTHER_CONFIG"] == 4
    assert (constants["PMF_LOOK"], constants["PMF_FOLLOWED"]) == (LOOK, FOLLOWED)
    assert "PMF_UNKNOWN" not in constants


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


def test_every_function_of_the_interface_has_a_comment() -> None:
    text = (source_folder() / "pmf.h").read_text(encoding="ascii")
    functions = list(re.finditer(r"^(?:PMF_API )?(?:const )?\w+ \*?(pmf_\w+)\(", text, re.MULTILINE))
    assert len(functions) > 10
    assert [found[1] for found in functions if not text[: found.start()].rstrip().endswith("*/")] == []
