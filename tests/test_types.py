"""The signatures of all public names have types, without `Any`."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import pytest

import pmfid
import pmfid.testing
from pmfid.monitor.monitor import Monitor

DOORS = [getattr(pmfid, name) for name in pmfid.__all__]
DOORS += [Monitor, pmfid.testing.check_estimator, pmfid.testing.checks_of]


def signatures(thing: object) -> dict[str, str]:
    """Return the signature of a function, or of the public members of a class, as text."""
    if not inspect.isclass(thing):
        return {thing.__name__: str(inspect.signature(thing))}
    found = {}
    for name, member in inspect.getmembers(thing):
        function = member.fget if isinstance(member, property) else member
        ours = getattr(function, "__module__", "") or ""
        if (not name.startswith("_") or name == "__init__") and inspect.isfunction(function) and "pmfid" in ours:
            found[name] = str(inspect.signature(function))
    return found


@pytest.mark.parametrize("thing", DOORS, ids=lambda thing: thing.__name__)
def test_no_any_at_a_public_signature(thing: object) -> None:
    assert [name for name, text in signatures(thing).items() if re.search(r"\bAny\b", text)] == []


@pytest.mark.parametrize(
    "root", [Path(pmfid.__file__).parent, Path(__file__).parents[1] / "studies"], ids=lambda root: root.name
)
def test_arrays_have_their_names_in_one_place(root: Path) -> None:
    named = re.compile(r"^(\w+)(: TypeAlias)? = NDArray\[np\.(?!void)", re.MULTILINE)
    found = {path.name for path in root.rglob("*.py") if named.search(path.read_text(encoding="utf-8"))}
    assert found == ({"types.py"} if root.name == "pmfid" else set())
