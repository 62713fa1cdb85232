"""Constants, names and comments in the C of an export."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import SupportsInt

import numpy as np

from pmfid.errors import UsageError
from pmfid.kernel.structures import HEADERS, Structured, header

INDENT = "    "


def literal(number: SupportsInt) -> str:
    """Return a number as a C constant. A float is hexadecimal, so that nothing is rounded.

    Raises ValueError for a float that is not finite, because C99 has no constant for it.
    """
    if isinstance(number, np.floating):
        if not np.isfinite(number):
            raise ValueError(f"{number} cannot be written as a constant in C")
        mantissa, _, exponent = float(number).hex().partition("p")
        mantissa = mantissa.rstrip("0").rstrip(".") if "." in mantissa else mantissa
        return f"{mantissa}p{exponent}" + ("f" if number.dtype.itemsize == 4 else "")
    return f"{int(number)}U" if isinstance(number, np.unsignedinteger) else str(int(number))


def initializer(structure: Structured, level: int = 0) -> str:
    """Return a structure, or an array of structures, as a braced initialiser with a comment for each field.

    Fields are set by position and not by designators, so that C++17 also reads the initialiser.
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
    if value.dtype.names or value.ndim == 2:
        return _rows([_flat(row) for row in value], level)
    return _flat(value)


def _rows(rows: list[str], level: int) -> str:
    inner = INDENT * (level + 1)
    return "{\n" + "".join(f"{inner}{row},\n" for row in rows) + f"{INDENT * level}}}"


def _flat(row: Structured) -> str:
    """Return the numbers of an array, or the fields of a small structure, in one line."""
    values = [row[name] for name in row.dtype.names] if row.dtype.names else list(row)
    return "{" + ", ".join(literal(value[()]) for value in values) + "}"


#: Ends of the names that an export makes of its prefix for types.
TYPES = ("_t", "_saved_t", "_alarm_t")
#: Types of C99's library whose names end in one of the `TYPES`.
_PLAIN_TYPES = """
size ptrdiff wchar wint wctrans wctype mbstate time clock div ldiv lldiv fpos float double fenv fexcept imaxdiv
sig_atomic va_list intptr uintptr intmax uintmax ssize off
"""
_WIDTHS = [
    f"{sign}int{kind}{bits}" for sign in ("", "u") for kind in ("", "_least", "_fast") for bits in (8, 16, 32, 64)
]
C_TYPES = {f"{name}_t" for name in (*_PLAIN_TYPES.split(), *_WIDTHS)}
#: Other names that an export makes of its prefix in capitals.
TAKEN = {"H", "PARAMETERS", "ALARMS"}
#: ASCII for the signs of units.
PLAIN = str.maketrans({"µ": "u", "μ": "u", "°": "deg", "Ω": "Ohm", "²": "2", "³": "3", "·": " ", "⋅": " "})


def check_names(prefix: str, parameters: Sequence[str]) -> None:
    """Raise UsageError if a prefix or the names of the parameters would not compile."""
    if not re.fullmatch(r"[a-z][a-z0-9_]*", prefix) or prefix.startswith("pmf"):
        raise UsageError(
            "prefix must consist of lower-case letters, digits and _, begin with a letter, and must not "
            f"begin with pmf, because all names of the kernel do; got {prefix!r}, give another (--prefix)"
        )
    of_kernel = set(re.findall(r"\b\w+_t\b", "".join(map(header, HEADERS))))
    clash = sorted({prefix + end for end in TYPES} & (C_TYPES | of_kernel))
    if clash:
        raise UsageError(
            f"prefix {prefix!r} makes the name {clash[0]}, which C or the kernel already uses; give "
            "another prefix (--prefix)"
        )
    capitals = [name.upper() for name in parameters]
    for name, capital in zip(parameters, capitals, strict=True):
        if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
            raise UsageError(
                f"parameter {name!r} contains letters that C does not allow in a name; use a to z, digits and _"
            )
        if capital in TAKEN or capitals.count(capital) > 1:
            raise UsageError(
                f"parameter {name!r} gives the name {prefix.upper()}_{capital}, which the exported code "
                "already uses; rename the parameter"
            )


def remark(text: str) -> str:
    """Return a text for a comment in C: one line of ASCII that cannot end the comment."""
    plain = re.sub(r"[^ -~]|[\\?]", ".", text.translate(PLAIN))  # a question mark begins trigraphs
    return re.sub(r"\*(?=/)|/(?=\*)", ".", plain)
