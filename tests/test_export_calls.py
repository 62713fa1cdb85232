"""The exported C calls no library function, for any code that the compiler makes of loops and assignments."""

from __future__ import annotations

from pathlib import Path

import pytest

import pmfid
from tests.firmware.build import CLANG, GCC, M4F, Target, calls, objects
from tests.test_export import make, needs

#: Cases of `make test`: one of each kind of processor.
OFTEN = [(GCC, "-O3"), (M4F, "-Os")]
BUILDS = [(GCC, "-O2"), (CLANG, "-O2"), (M4F, "-O3"), *OFTEN]


@pytest.mark.parametrize(
    ("target", "optimize"),
    [
        pytest.param(
            *one, marks=[needs(one[0]), *([] if one in OFTEN else [pytest.mark.long])], id=f"{one[0].name}{one[1]}"
        )
        for one in BUILDS
    ],
)
def test_no_call_of_a_library(target: Target, optimize: str, tmp_path: Path) -> None:
    """The export is the one with the most code; `test_exported_code_computes_the_bits_of_python` covers all methods."""
    pmfid.export_firmware(make(pmfid.RIV), tmp_path)
    called = calls(tmp_path, target, objects(tmp_path, target, optimize))
    assert {name for name in called if not name.startswith("axis_pmf_")} == set()
    assert called, "the objects call each other at least"
