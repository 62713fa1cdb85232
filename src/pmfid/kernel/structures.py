"""The structures of the kernel as NumPy types, read from csrc/pmf.h. Python and firmware thus share their bytes.

The structures of the Python module have room for every configuration. Those of an export or a saved state have room
for one configuration.
"""

from __future__ import annotations

import ast
import math
import operator
import re
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from pmfid.errors import UsageError

#: C divides positive integers in the same way.
_OPERATORS: dict[type[ast.operator], Callable[[int, int], int]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.floordiv,
    ast.BitOr: operator.or_,
}

Structures = dict[str, np.dtype[np.void]]
#: A structure, or a part of one, as NumPy represents it.
Structured = NDArray[np.void]
#: Name, type and dimensions of a field.
Field = tuple[str, np.dtype[np.generic], tuple[int, ...]]

#: Firmware includes the first header, which has all structures. The kernel's sources share the second.
HEADERS = ("pmf.h", "pmf_internal.h", "pmf_outlier.h")
#: An export with edges has the structures of these headers in place of those of the first.
EDGE_HEADERS = ("edges/pmf_redge.h", "edges/pmf_redge_axis.h")


@dataclass(frozen=True)
class KernelSizes:
    """The sizes and parts of the kernel that a configuration needs, named as in pmf_sizes.h."""

    max_stages: int
    max_taps: int
    max_parameters: int
    max_misreads: int
    max_columns: int
    max_shapes: int
    max_knots: int
    max_rates: int
    max_late: int
    with_dead_time: int
    with_auxiliary: int
    with_process: int
    with_guard: int
    with_split: int
    with_misread: int
    with_steps: int
    with_network: int = 1

    def macros(self) -> dict[str, int]:
        """The macros of pmf_sizes.h with their values."""
        return {f"PMF_{name.upper()}": value for name, value in vars(self).items()}


def source_folder() -> Path:
    """Return the folder of the kernel's sources, in the package or the checkout. Raises UsageError if it is missing."""
    import pmfid

    places = [Path(__file__).parents[3] / "csrc", *(Path(path) / "csrc" for path in pmfid.__path__)]
    for place in places:
        if (place / "pmf.h").exists():
            return place
    raise UsageError("the kernel's sources are not in this installation; install pmfid again")


@cache
def header(name: str) -> str:
    """Return a header of the kernel without its comments."""
    text = (source_folder() / name).read_text(encoding="ascii")
    return re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)


@cache
def structures(shape: KernelSizes | None, precision: str) -> Structures:
    """Return the NumPy type of each structure, in the layout of C. Without `shape` the module's sizes apply."""
    return _types_in(header("pmf.h"), precision, constants_of(shape))


@cache
def edge_structures(lines: int, precision: str, parameters: int | None = None) -> Structures:
    """Return the NumPy type of each structure of the recursion over edges with `lines` lines that repeat.

    The layout is that of an export with `parameters` unknowns, or of the module without them.
    """
    text = "".join(map(header, EDGE_HEADERS))
    own = {} if parameters is None else {"PMF_BODY": parameters}
    constants = constants_in(text, {"PMF_MAX_LINES": max(lines, 1)} | own)
    saved = re.findall(r"typedef struct \{[^{}]*\}\s*pmf_(?:saved|alarm_config|alarm_state)_t;", header("pmf.h"))
    types = _types_in(text + "".join(saved), precision, constants)
    return types | {"pmf_config_t": types["pmf_redge_config_t"]}


def _types_in(text: str, precision: str, constants: Mapping[str, int]) -> Structures:
    whole, integer, real = (np.dtype(name) for name in ("<u4", "<i4", "<f4" if precision == "float32" else "<f8"))
    types: Structures = {"uint32_t": whole, "whole_t": whole, "int32_t": integer, "integer_t": integer}
    types |= {"scalar_t": real, "real_t": real}
    for body, name in re.findall(r"typedef struct \{(.*?)\}\s*(\w+);", text, re.DOTALL):
        types[name] = np.dtype(_fields(_choose_lines(body, constants), types, constants), align=True)
    return types


def value(text: str, constants: Mapping[str, int]) -> int:
    """Return the value of a constant expression of C. The header is parsed, never executed.

    The expression consists of integers, names in `constants` and the signs + - * / | ( ) and >. Raises ValueError for
    any other text.
    """
    plain = re.sub(r"\b(0x[0-9a-fA-F]+|\d+)[uU]\b", r"\1", " ".join(text.split()))
    try:
        tree = ast.parse(plain, mode="eval")
    except SyntaxError:
        raise ValueError(f"no constant expression: {text!r}") from None
    return _value(tree.body, constants)


def _value(node: ast.AST, constants: Mapping[str, int]) -> int:
    if isinstance(node, ast.Constant) and type(node.value) is int:
        return node.value
    if isinstance(node, ast.Name) and node.id in constants:
        return constants[node.id]
    if isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
        return _OPERATORS[type(node.op)](_value(node.left, constants), _value(node.right, constants))
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        return -_value(node.operand, constants)
    if isinstance(node, ast.Compare) and len(node.ops) == 1 and isinstance(node.ops[0], ast.Gt):
        return int(_value(node.left, constants) > _value(node.comparators[0], constants))
    raise ValueError(f"no constant expression: {ast.unparse(node)!r}")


@cache
def constants_of(shape: KernelSizes | None) -> dict[str, int]:
    """Return the integers that pmf_sizes.h and `HEADERS` define. Without `shape` the sizes are those of the module."""
    constants = {} if shape is None else shape.macros()
    for text in map(header, ("pmf_sizes.h", *HEADERS)):
        constants = constants_in(text, constants)
    return constants


def constants_in(text: str, known: Mapping[str, int]) -> dict[str, int]:
    """Return the integers that a header defines, in addition to the known ones."""
    constants = dict(known)
    for name, expression in re.findall(r"^#define (PMF_\w+) +(\S.*)$", text, re.MULTILINE):
        with suppress(ValueError):  # a macro of the arithmetic is not an integer
            constants.setdefault(name, value(expression, constants))
    for body in re.findall(r"\benum (?:\w+ )?\{(.*?)\}", text, re.DOTALL):
        following = 0
        for entry in filter(None, (part.strip() for part in body.split(","))):
            name, _, expression = (part.strip() for part in entry.partition("="))
            constants[name] = value(expression, constants) if expression else following
            following = constants[name] + 1
    return constants


def _choose_lines(body: str, constants: Mapping[str, int]) -> str:
    """Return the lines of a structure that the C preprocessor keeps."""
    kept, conditions = [], [True]
    for line in body.splitlines():
        directive = line.strip()
        if directive.startswith("#if "):
            conditions.append(bool(value(directive[4:], constants)))
        elif directive == "#else":
            conditions[-1] = not conditions[-1]
        elif directive == "#endif":
            conditions.pop()
        elif all(conditions):
            kept.append(line)
    return "\n".join(kept)


def _fields(body: str, types: Structures, constants: Mapping[str, int]) -> list[Field]:
    fields: list[Field] = []
    for declaration in filter(None, (part.strip() for part in body.split(";"))):
        kind, names = declaration.split(None, 1)
        for name in names.split(","):
            dimensions = tuple(value(size, constants) for size in re.findall(r"\[(.*?)\]", name))
            fields.append((name.partition("[")[0].strip(), types[kind], dimensions))
    return fields


def resize_structure(source: Structured, dtype: np.dtype[np.void]) -> Structured:
    """Return the structure in a layout of other sizes. New elements are zero."""
    target = np.zeros((), dtype)
    copy_fields(source, target)
    return target


def copy_fields(source: Structured, target: Structured) -> None:
    """Copy the fields that two structures share. Of arrays that differ in size, the common elements are copied."""
    for name in set(source.dtype.names or ()) & set(target.dtype.names or ()):
        one, other = source[name], target[name]
        if one.dtype.names and one.ndim == 0:
            copy_fields(one, other)
        else:
            part = tuple(slice(min(sizes)) for sizes in zip(one.shape, other.shape, strict=True))
            if one.dtype.names:
                copy_fields(one[part], other[part])
            else:
                other[part] = one[part]


@cache
def whole_words(precision: str) -> bytes:
    """Return a flag for every four bytes of the module's state, 1 for an integer and 0 for a scalar."""
    state = structures(None, precision)["pmf_state_t"]
    words = np.zeros(state.itemsize // 4, np.uint8)
    words[[place // 4 for place in _whole_places(state, 0)]] = 1
    return words.tobytes()


def _whole_places(dtype: np.dtype[np.generic], start: int) -> Iterator[int]:
    if dtype.names is None:
        yield from [start] if dtype.kind in "iu" else []
        return
    fields = dtype.fields or MappingProxyType({})
    for entry, offset in (fields[name][:2] for name in dtype.names):
        base, shape = entry.subdtype or (entry, ())
        for number in range(math.prod(shape)):
            yield from _whole_places(base, start + offset + number * base.itemsize)


def layout_number(dtype: np.dtype[np.void]) -> int:
    """Return the CRC-32 of the names, types and offsets of all fields, which an export calls PMF_LAYOUT."""
    return zlib.crc32("\n".join(_places(dtype, "")).encode())


def _places(dtype: np.dtype[np.void], prefix: str) -> list[str]:
    lines, fields = [f"{prefix} {dtype.itemsize}"], dtype.fields or MappingProxyType({})
    for name in dtype.names or ():
        entry, offset = fields[name][:2]
        base, shape = entry.subdtype or (entry, ())
        lines.append(f"{prefix}.{name} {base.kind}{base.itemsize} {shape} {offset}")
        lines += _places(base, f"{prefix}.{name}") if base.names else []
    return lines
