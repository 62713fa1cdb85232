"""The exported C calls nothing of a library, whatever the compiler makes of loops and assignments."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import pmfid
from tests.firmware.build import CLANG, GCC, M4F, REQUIRED, Target, command
from tests.test_export import make, needs

#: How the objects of an export are looked at.
NM = {"gcc": "nm", "clang": "nm", M4F.compiler: M4F.compiler.replace("gcc", "nm")}
BUILDS = [(GCC, "-O2"), (GCC, "-O3"), (CLANG, "-O2"), (M4F, "-Os"), (M4F, "-O3")]


@pytest.mark.parametrize(
    ("target", "optimize"), [pytest.param(*one, marks=needs(one[0]), id=f"{one[0].name}{one[1]}") for one in BUILDS]
)
def test_no_call_of_a_library(target: Target, optimize: str, tmp_path: Path) -> None:
    for cls, scheme in ((pmfid.RLS, "window"), (pmfid.RIV, "exponential")):
        folder = tmp_path / cls.__name__
        pmfid.export_firmware(make(cls, forgetting_scheme=scheme), folder)
        sources = sorted(path.name for path in folder.glob("pmf_*.c"))
        options = [*REQUIRED, optimize, *target.options, "-c"]
        done = command([target.compiler, *options, *sources], folder)
        assert done.returncode == 0, done.stderr
        objects = [name.replace(".c", ".o") for name in sources]
        listed = command([NM[target.compiler], "-u", *objects], folder).stdout
        called = set(re.findall(r"^\s+U (\S+)$", listed, re.MULTILINE))
        assert {name for name in called if not name.startswith("axis_pmf_")} == set()
        assert called, "the objects call each other at least"
