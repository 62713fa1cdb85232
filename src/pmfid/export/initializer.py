"""Values of the kernel's structures as C: exact, and the same text for the same values."""

from __future__ import annotations

from typing import SupportsInt

import numpy as np

from pmfid.kernel.structures import Structured

INDENT = "    "


def literal(number: SupportsInt) -> str:
    """A number as a C constant: hexadecimal where it is a float, so that nothing is rounded.

    Raises ValueError for a float that is not finite: C99 has no constant for it.
    """
    if isinstance(number, np.floating):
        if not np.isfinite(number):
            raise ValueError(f"{number} has no C constant")
        mantissa, _, exponent = float(number).hex().partition("p")
        mantissa = mantissa.rstrip("0").rstrip(".") if "." in mantissa else mantissa
        return f"{mantissa}p{exponent}" + ("f" if number.dtype.itemsize == 4 else "")
    return f"{int(number)}U" if isinstance(number, np.unsignedinteger) else str(int(number))


def initializer(structure: Structured, level: int = 0) -> str:
    """A structure, or an array of structures, as a braced initialiser; a comment names each field.

    Fields are set by position and not by designators, so that C++17 reads the initialiser as well.
    """
    inner = INDENT * (level + 1)
    lines = [
        f"{inner}{_value(structure[name], level + 1)}, /* {_remark(name, structure[name])} */"
        for name in structure.dtype.names or ()
    ]
    return "{\n" + "\n".join(lines) + f"\n{INDENT * level}}}"


def _remark(name: str, value: Structured) -> str:
    scalar_float = value.ndim == 0 and value.dtype.kind == "f"
    return f"{name} = {float(value):.9g}" if scalar_float else name


def _value(value: Structured, level: int) -> str:
    if value.ndim == 0:
        return initializer(value, level) if value.dtype.names else literal(value[()])
    if value.dtype.names:
        return _rows([_flat(row) for row in value], level)
    if value.ndim == 2:
        return _rows([_flat(row) for row in value], level)
    return _flat(value)


def _rows(rows: list[str], level: int) -> str:
    inner = INDENT * (level + 1)
    return "{\n" + "".join(f"{inner}{row},\n" for row in rows) + f"{INDENT * level}}}"


def _flat(row: Structured) -> str:
    """One line: the numbers of an array, or the fields of a small structure."""
    values = [row[name] for name in row.dtype.names] if row.dtype.names else list(row)
    return "{" + ", ".join(literal(value[()]) for value in values) + "}"
