"""The size of the project: each figure may only fall. A change that makes the project smaller lowers its bound."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TEXTS = {".py", ".pyx", ".pxi", ".pxd", ".pyi", ".c", ".h", ".inl", ".js", ".css", ".html", ".j2"}
#: What is counted -> its largest value.
MOST = {
    "lines of src": 63584,
    "lines of code in src": 37103,
    "lines of code in report and cli": 2891,
    "thresholds in src": 836,
    "lines of csrc": 8758,
    "defines of csrc": 194,
    "conditionals of csrc": 104,
    "lines of tests": 27665,
    "match= in tests": 20,
    "lines of studies": 8147,
}


def texts_of(folder: str, suffixes: set[str] = TEXTS) -> list[str]:
    """Return the texts of the files in a folder, without those of others."""
    paths = (path for path in sorted((ROOT / folder).rglob("*")) if path.suffix in suffixes and path.is_file())
    return [path.read_text(encoding="utf-8", errors="replace") for path in paths if "vendor" not in str(path)]


def count_lines(folder: str) -> int:
    return sum(text.count("\n") for text in texts_of(folder))


def count_directives(names: str) -> int:
    """Return the number of directives of the C preprocessor in the kernel."""
    return sum(len(re.findall(rf"^\s*#\s*(?:{names})\b", text, re.MULTILINE)) for text in texts_of("csrc"))


def count_code(folder: str) -> int:
    """Return the number of lines of Python without blank lines, comments and docstrings."""
    return sum(len(code_lines(text) - docstring_lines(text)) for text in texts_of(folder, {".py"}))


@cache
def parse(text: str) -> ast.Module:
    return ast.parse(text)


def code_lines(text: str) -> set[int]:
    """Return the lines with code or within a string."""
    filled = {k for k, line in enumerate(text.splitlines(), 1) if line.strip() and not line.lstrip().startswith("#")}
    strings = [node for node in ast.walk(parse(text)) if isinstance(node, ast.Constant | ast.JoinedStr)]
    return filled | {k for one in strings for k in range(one.lineno, (one.end_lineno or one.lineno) + 1)}


def docstring_lines(text: str) -> set[int]:
    documented = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef | ast.Module
    firsts = [node.body[0] for node in ast.walk(parse(text)) if isinstance(node, documented) and node.body]
    texts = [one for one in firsts if isinstance(one, ast.Expr) and isinstance(one.value, ast.Constant)]
    return {k for one in texts for k in range(one.lineno, (one.end_lineno or one.lineno) + 1)}


def count_thresholds(folder: str) -> int:
    """Return the number of constants of modules and defaults of classes that contain a number."""
    bodies = [node for text in texts_of(folder, {".py"}) for node in parse(text).body]
    nodes = [one for node in bodies for one in (node.body if isinstance(node, ast.ClassDef) else [node])]
    values = [one.value for one in nodes if isinstance(one, ast.Assign | ast.AnnAssign)]
    plain = [value for value in values if isinstance(value, ast.Constant | ast.UnaryOp | ast.BinOp | ast.Tuple)]
    return sum(any(map(is_number, ast.walk(value))) for value in plain)


def is_number(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and type(node.value) in (int, float)


def measure() -> dict[str, int]:
    return {
        "lines of src": count_lines("src"),
        "lines of code in src": count_code("src"),
        "lines of code in report and cli": count_code("src/pmfid/report") + count_code("src/pmfid/cli"),
        "thresholds in src": count_thresholds("src"),
        "lines of csrc": count_lines("csrc"),
        "defines of csrc": count_directives("define"),
        "conditionals of csrc": count_directives("if|ifdef|ifndef|elif"),
        "lines of tests": count_lines("tests"),
        "match= in tests": sum(len(re.findall("match=", text)) for text in texts_of("tests", {".py"})),
        "lines of studies": count_lines("studies"),
    }


@pytest.fixture(scope="module")
def sizes() -> dict[str, int]:
    return measure()


@pytest.mark.parametrize("what", MOST)
def test_no_size_grows(what: str, sizes: dict[str, int]) -> None:
    assert sizes[what] <= MOST[what], f"{what}: remove as much as was added, and lower the bound if more goes"
    assert sizes[what] > MOST[what] // 2, f"lower the bound of {what}"
