"""Names and remarks from outside that go into C: what would not compile is refused, what could act is made harmless."""

from __future__ import annotations

import re
from collections.abc import Sequence

from pmfid.errors import UsageError
from pmfid.kernel.structures import HEADERS, header

#: Ends of the names that an export makes of its prefix for types.
TYPES = ("_t", "_saved_t", "_alarm_t")
#: Types of C99's library whose names end in one of these.
_PLAIN_TYPES = """
size ptrdiff wchar wint wctrans wctype mbstate time clock div ldiv lldiv fpos float double fenv fexcept imaxdiv
sig_atomic va_list intptr uintptr intmax uintmax ssize off
"""
_WIDTHS = [
    f"{sign}int{kind}{bits}" for sign in ("", "u") for kind in ("", "_least", "_fast") for bits in (8, 16, 32, 64)
]
C_TYPES = {f"{name}_t" for name in (*_PLAIN_TYPES.split(), *_WIDTHS)}
#: What else an export makes of its prefix in capitals.
TAKEN = {"H", "PARAMETERS", "ALARMS"}
#: Signs of units -> what ASCII has for them.
PLAIN = str.maketrans({"µ": "u", "μ": "u", "°": "deg", "Ω": "Ohm", "²": "2", "³": "3", "·": " ", "⋅": " "})


def check_names(prefix: str, parameters: Sequence[str]) -> None:
    """Raises UsageError if a prefix or the names of the parameters would not compile."""
    if not re.fullmatch(r"[a-z][a-z0-9_]*", prefix) or prefix.startswith("pmf"):
        raise UsageError(
            "prefix must be lower-case letters, digits and _, begin with a letter, but not with pmf, as all names in "
            f"the C begin with it; got {prefix!r}, give another (--prefix)"
        )
    of_kernel = set(re.findall(r"\b\w+_t\b", "".join(map(header, HEADERS))))
    clash = sorted({prefix + end for end in TYPES} & (C_TYPES | of_kernel))
    if clash:
        raise UsageError(
            f"prefix {prefix!r} makes {clash[0]}, which C or the kernel has already; give another (--prefix)"
        )
    capitals = [name.upper() for name in parameters]
    for name, capital in zip(parameters, capitals, strict=True):
        if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
            raise UsageError(f"parameter {name!r} has letters that C has not; use a to z, digits and _ in its name")
        if capital in TAKEN or capitals.count(capital) > 1:
            raise UsageError(
                f"parameter {name!r} gives {prefix.upper()}_{capital}, which the C has already; give it another name"
            )


def remark(text: str) -> str:
    """A text for a comment in C: one line of ASCII that cannot end the comment."""
    plain = re.sub(r"[^ -~]|[\\?]", ".", text.translate(PLAIN))  # ? begins trigraphs
    return re.sub(r"\*(?=/)|/(?=\*)", ".", plain)
