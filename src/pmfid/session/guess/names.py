"""The role of a column by its name, in English and German."""

from __future__ import annotations

import re
from typing import Literal

from pmfid.session.clock import named_unit
from pmfid.session.units import INPUTS, OUTPUTS, column_unit

__all__ = ["Role", "role_of"]

Role = Literal["time", "number", "counts", "position", "velocity", "acceleration", "input", "other", ""]

#: Role of a column, and the words of its name: whole words, or the end of one; the first match counts.
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
#: Quantity of a unit -> role of the column.
_MEASURED: dict[str, Role] = {
    "length": "position",
    "angle": "position",
    "speed": "velocity",
    "angular speed": "velocity",
}


def role_of(name: str) -> Role:
    """The role of the column with this name; empty if the name shows none."""
    bare = re.sub(r"\s*[\[(][^\])]*[\])]\s*$", "", name)
    output, driven = column_unit(name, OUTPUTS), column_unit(name, INPUTS)
    split = re.sub(r"([a-zäöüß0-9])([A-ZÄÖÜ])", r"\1 \2", bare)  # MotorTorque
    words = [word for word in re.split(r"[\s_.,:/()\[\]-]+", split.lower()) if word]
    if len(words) > 1 and re.search(r"[\s_.,:/-][AVN]$", bare):
        words = words[:-1]  # "i_A", "u_V": a unit, as "a" and "v" alone are none
    if output is not None or driven is not None:  # with any name, except for set points
        set_point = any(re.fullmatch(_WORDS[0][1], word) for word in words)
        return "other" if set_point else "input" if output is None else _MEASURED[output.of]
    for role, pattern in _WORDS:
        if any(re.fullmatch(pattern, word) for word in words):
            return role
    joined = "".join(words)
    for role, pattern in _WORDS:
        long = "|".join(part for part in pattern.split("|") if len(part.replace(r"\w*", "")) > 3)
        if re.search(rf"({long})$", joined) or re.match(rf"({long})", joined):
            return role
    return "time" if named_unit(name) else ""
