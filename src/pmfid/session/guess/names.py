"""What the name of a column says of it, in English and German."""

from __future__ import annotations

import re
from typing import Literal

from pmfid.session.clock import named_unit

__all__ = ["ROTARY", "Role", "role_of", "spoken_unit"]

Role = Literal["time", "number", "counts", "position", "velocity", "acceleration", "input", "other", ""]

#: What a name has in it, as a word of its own or at the end of one -> what the column holds; the first that fits.
_WORDS: tuple[tuple[Role, str], ...] = (
    ("other", r"soll\w*|target|ref\w*|set\w*|desired|demand|error|err|fehler|schleppfehler|status|state|temp\w*|limit"),
    ("time", r"t|time|zeit|timestamp|zeitstempel|stamp|secs?|seconds|sekunden|datum|date|uhrzeit"),
    ("number", r"index|idx|sample|samples|row|zeile|nr|no|number|nummer|k|n|cycle|zyklus"),
    ("acceleration", r"a|acc|accel\w*|beschl\w*"),
    ("counts", r"counts?|cnt|enc|encoder\w*|ticks?|ink\w*|incs?|increments?|zaehler\w*|zähler\w*|impulse?|pulses?"),
    ("velocity", r"v|vel|velocity|speed|geschw\w*|drehzahl|rpm|omega|w|qd|dq"),
    ("position", r"y|x|pos\w*|weg|lage|angle|winkel|phi|theta|q|s|istposition|drehwinkel|auslenkung"),
    ("input", r"u|i|iq|input|torque|moment|drehmoment|current|strom|force|kraft|volts?|voltage|spannung|pwm|effort|tau|"
              r"duty|stell\w*|motor|m|f|eingang|drive"),
)  # fmt: skip
#: Units of a turning axis.
ROTARY = frozenset({"deg", "degree", "degrees", "grad", "°", "rad", "mrad", "rpm", "rev", "turn", "u/min", "1/min"})
#: Units of input, output and its rate -> what the column holds, where the name says nothing.
_UNITS: dict[str, Role] = {
    **dict.fromkeys(("v", "mv", "a", "ma", "nm", "n m", "mnm", "n", "kn", "%"), "input"),
    **dict.fromkeys(("m", "mm", "um", "µm", "deg", "°", "grad", "rad", "mrad", "rev"), "position"),
    **dict.fromkeys(("m/s", "mm/s", "rad/s", "deg/s", "°/s", "rpm", "u/min", "1/min"), "velocity"),
    **dict.fromkeys(("m/s^2", "m/s²", "rad/s^2", "rad/s²"), "acceleration"),
    **dict.fromkeys(("inc", "counts", "ticks", "cnt"), "counts"),
}
#: Ends of names, behind an underscore, that are units.
_BRACKETS = re.compile(r"\s*[\[(]([^\])]*)[\])]$")
_ENDS = re.compile(r"_(deg|rad|mrad|mm|um|m|rpm|ma|a|mv|v|nm|n|counts|inc)$", re.IGNORECASE)


def unit_of(name: str) -> str:
    """The unit in brackets at the end of a column's name; empty where there is none."""
    found = _BRACKETS.search(name)
    return found[1].strip() if found else ""


def spoken_unit(name: str) -> str:
    """The unit in a column's name, in brackets or behind an underscore; empty where there is none."""
    found = _ENDS.search(name)
    return unit_of(name) or (found.group(1) if found else "")


def role_of(name: str) -> Role:
    """What the column of this name holds; empty where the name does not say."""
    unit = unit_of(name)
    bare = name[: name.rfind(unit) - 1] if unit else name
    split = re.sub(r"([a-zäöüß0-9])([A-ZÄÖÜ])", r"\1 \2", bare)  # MotorTorque
    words = [word for word in re.split(r"[\s_.,:/()\[\]-]+", split.lower()) if word]
    for role, pattern in _WORDS:
        if any(re.fullmatch(pattern, word) for word in words):
            return role
    joined = "".join(words)
    for role, pattern in _WORDS:
        long = "|".join(part for part in pattern.split("|") if len(part.replace(r"\w*", "")) > 3)
        if re.search(rf"({long})$", joined) or re.match(rf"({long})", joined):
            return role
    by_unit = _UNITS.get(unit.strip().lower())
    if by_unit:
        return by_unit
    return "time" if unit and named_unit(f"x [{unit}]") else ""
