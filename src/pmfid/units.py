"""Units of columns, by key or by the column's name, and units of numbers in AXIS.toml.

A number is in SI, and a text such as "0.001 mm" has its unit. If a column has another unit, a number alone is refused,
because its unit is ambiguous. Therefore no value is ever wrong by a factor of a thousand.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass

from pmfid.errors import did_you_mean

_PREFIXES = {"": 1.0, "k": 1e3, "c": 1e-2, "m": 1e-3, "u": 1e-6, "n": 1e-9}
_MINUTE = 60.0
_ANGLES = {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180, "rev": 2 * math.pi, "turn": 2 * math.pi}
_LENGTHS = {f"{prefix}m": _PREFIXES[prefix] for prefix in ("", "c", "m", "u", "n")} | {"in": 0.0254, "inch": 0.0254}


@dataclass(frozen=True)
class Unit:
    """A unit with its name, the quantity `of` that it measures, and the factor that converts it to SI."""

    name: str
    of: str
    factor: float

    @property
    def plain(self) -> bool:
        """Whether the unit is the SI unit."""
        return self.factor == 1.0


#: SI unit of each quantity.
SI = {
    "length": "m",
    "angle": "rad",
    "speed": "m/s",
    "angular speed": "rad/s",
    "force": "N",
    "torque": "N m",
    "voltage": "V",
    "current": "A",
    "ratio": "1",
}


def _units(of: str, factors: dict[str, float]) -> dict[str, Unit]:
    return {name: Unit(name, of, factor) for name, factor in factors.items()}


#: Units of outputs, and units of inputs.
OUTPUTS = {
    **_units("length", _LENGTHS),
    **_units("angle", _ANGLES),
    **_units("speed", {f"{name}/s": factor for name, factor in _LENGTHS.items()}),
    **_units("speed", {f"{name}/min": factor / _MINUTE for name, factor in _LENGTHS.items()}),
    **_units("angular speed", {f"{name}/s": factor for name, factor in _ANGLES.items()}),
    **_units("angular speed", dict.fromkeys(("rpm", "rev/min"), 2 * math.pi / _MINUTE)),
}
INPUTS = {
    **_units("voltage", {f"{prefix}V": _PREFIXES[prefix] for prefix in ("", "k", "m", "u")}),
    **_units("current", {f"{prefix}A": _PREFIXES[prefix] for prefix in ("", "k", "m", "u")}),
    **_units("force", {f"{prefix}N": _PREFIXES[prefix] for prefix in ("", "k", "m", "u")}),
    **_units("torque", {f"{prefix}N m": _PREFIXES[prefix] for prefix in ("", "k", "m", "u")}),
    **_units("torque", {"N cm": 1e-2, "N mm": 1e-3}),
    **_units("ratio", {"%": 1e-2, "permille": 1e-3, "1": 1.0}),
}
#: Other spellings of units, in small letters without blanks, with their names.
_ALIASES = {
    "°": "deg", "degree": "deg", "degrees": "deg", "°/s": "deg/s", "dps": "deg/s", "u": "rev", "turns": "rev",
    "1/min": "rpm", "u/min": "rpm", "min-1": "rpm", "r/min": "rpm", "1/s": "rev/s", "rps": "rev/s", "m.s-1": "m/s",
    "pct": "%", "percent": "%", "‰": "permille", "arms": "A", "volt": "V", "volts": "V", "amp": "A", "amps": "A",
    "ampere": "A", "amperes": "A", "newtons": "N", "newtonmeter": "N m", "newtonmetre": "N m", "0.1%": "permille",
    "newton": "N", "metre": "m", "meter": "m", "millimeter": "mm", "radian": "rad", "radians": "rad",
}  # fmt: skip
#: Units that messages name in addition to the SI units.
_USUAL = ("mm", "deg", "rpm", "mA", "kN", "%")
#: Smallest number of letters of a unit after an underscore, stroke, blank or point. A single letter is usually an
#: index.
_LEAST_LETTERS = 2
#: A quantity divided by its unit, such as "F/N" (DIN 1313). A path of a topic has more strokes.
_DIVIDED = re.compile(r"[^/]+/[^/]+$")
#: A name that ends in "in" is an input, unless it begins with the name of a length.
_INCHES = re.compile(r"(pos\w*|travel|stroke|dist\w*|displ\w*|length|height|weg|lage)[\W_]in$", re.IGNORECASE)
#: A single letter is a unit if a word before it is a symbol of its quantity or ends with its name.
_MEASURED = {
    "A": re.compile(r"i[abcdmqs]?|curr|amps?|.*(current|strom)"),
    "V": re.compile(r"[uv][abcdmqs]?|.*(volts?|voltage|spannung)"),
    "N": re.compile(r"f[xyz]?|thrust|.*(force|kraft)"),
}
_IN_BRACKETS = re.compile(r"[\[(]([^\])\d]*|0\.1 ?%)[\])]")
#: Words after the unit.
_AFTER_UNIT = re.compile(r"([\s_.]+(filt\w*|smooth\w*|raw|meas\w*|act|actual|avg|mean|rms))+$", re.IGNORECASE)


class Quantity(float):
    """A number in SI with its original unit."""

    unit: Unit

    def __new__(cls, value: float, unit: Unit) -> Quantity:
        made = super().__new__(cls, value * unit.factor)
        made.unit = unit
        return made

    def __reduce__(self) -> tuple[Callable[[float, Unit], Quantity], tuple[float, Unit]]:
        """Return the arguments for copies and pickles. A copy has the same bits, because no unit is converted twice."""
        return _make_quantity, (float(self), self.unit)


def _make_quantity(value: float, unit: Unit) -> Quantity:
    made = float.__new__(Quantity, value)
    made.unit = unit
    return made


def unit_named(text: str, table: dict[str, Unit]) -> Unit | None:
    """Return the unit in a table that the text names, or None."""
    plain = re.sub(r"[·⋅∙•*]", " ", re.sub(r"[µμ]", "u", text.strip())).replace("^", "")
    close = plain.replace(" ", "").replace("-", "") if "N" in plain else plain.replace(" ", "")
    exact = {name.replace(" ", ""): unit for name, unit in table.items()}
    loose = {name.replace(" ", "").lower(): unit for name, unit in reversed(table.items())}
    alias = table.get(_ALIASES.get(close.lower(), ""))
    return exact.get(close) or alias or (loose.get(close.lower()) if close in (close.lower(), close.upper()) else None)


def column_unit(name: str, table: dict[str, Unit]) -> Unit | None:
    """Return the unit in a column's name, such as "Current [mA]", "pos_mm" or "phi (deg)", or None."""
    for text in reversed(_IN_BRACKETS.findall(name)):
        if unit := unit_named(text, table):
            return unit
    bare = _AFTER_UNIT.sub("", name.strip())
    if found := re.search(rf"[\s_.]({'|'.join((*_LENGTHS, *_ANGLES))})(?:_|_?p(?:er_?)?)s$", bare):
        return table.get(f"{found.group(1)}/s")
    if _DIVIDED.match(bare) and (unit := unit_named(bare.partition("/")[2], table)):
        return unit
    last = re.search(r"[\s_.]([A-Za-zµμ°]+/[a-z]+)$", bare) or re.search(r"[\s_/.,]([A-Za-zµμ°%]+)$", bare)
    if last is None:
        return None
    last_word = last.group(1)
    if last_word.lower() == "in" and not _INCHES.match(bare):
        return None
    clear = len(last_word) >= _LEAST_LETTERS or last_word in "°%" or _follows_quantity(bare[: last.start()], last_word)
    return unit_named(last_word, table) if clear else None


def _follows_quantity(before: str, letter: str) -> bool:
    """Return whether the text before a single letter names the quantity that the letter measures."""
    split = re.sub(r"([a-z])([A-Z])", r"\1 \2", before)
    words = [word for word in re.split(r"[\W_\d]+", split.lower()) if word]
    pattern = _MEASURED.get(letter.upper())
    return pattern is not None and any(
        pattern.fullmatch(word) for word in words if letter.isupper() or len(word) > _LEAST_LETTERS
    )


_NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*$")

_COUNTS_PER = re.compile(r"(?:counts?|increments?)\s*(?:/|per)\s*(.+)$")


def keep_unit(value: object, check: Callable[[object], object], read: Callable[[object], object]) -> object:
    """Return the value that `read` makes, with its unit, if a field's `check` accepts it as a number."""
    made = read(value)
    checked = check(float(made) if isinstance(made, Quantity) else made)
    return made if isinstance(made, Quantity) else checked


def quantity(value: object) -> object:
    """Return a text with a number and a unit of travel or speed as a `Quantity`, and any other value unchanged.

    The text "2000 counts/rev" gives the 2000th part of a revolution. Raises ValueError for an unknown unit.
    """
    if not isinstance(value, str) or (found := _NUMBER.match(value)) is None:
        return value
    number, name = float(found.group(1)), found.group(2)
    each = _COUNTS_PER.match(name)
    unit = unit_named(each.group(1) if each else name, OUTPUTS)
    if unit is None or (each and not number > 0):
        known = ", ".join(name for name in OUTPUTS if "/" not in name)
        raise ValueError(
            f'{name or "nothing"!r} is not a known unit; use one of {known}, one of these per s or min, or "counts/rev"'
        )
    return Quantity(1 / number if each else number, unit)


def gain(value: object) -> object:
    """Return a text such as "0.35 N m/A" as a `Quantity` of force or torque per unit of input.

    Raises ValueError for an unknown unit.
    """
    if not isinstance(value, str) or (found := _NUMBER.match(value)) is None:
        return value
    above, stroke, below = found.group(2).partition("/")
    force, per = unit_named(above, INPUTS), unit_named(below.strip(" ()"), INPUTS) if stroke else INPUTS["1"]
    if force is None or per is None or force.of not in ("force", "torque"):
        raise ValueError(
            f'{found.group(2)!r} is not a force or torque per unit of input; write one such as "N/V" or "N m/A"'
        )
    return Quantity(
        float(found.group(1)), Unit(f"{force.name}/{per.name}", f"{force.of}/{per.of}", force.factor / per.factor)
    )


def known_unit(text: str, table: dict[str, Unit]) -> str:
    """Return the unit with the given name in a table. Raises ValueError for an unknown name."""
    unit = unit_named(text, table)
    if unit is None:
        usual = ", ".join(name for name, unit in table.items() if unit.plain or name in _USUAL)
        raise ValueError(f"{text!r} is not a known unit; use for example {usual}{did_you_mean(text, table)}")
    return unit.name
