"""The role of a column, its joint, and whether it was measured, according to its name."""

from __future__ import annotations

import re
from typing import Literal

from pmfid.records.clock import named_unit
from pmfid.units import INPUTS, OUTPUTS, column_unit

Role = Literal["time", "number", "counts", "position", "velocity", "acceleration", "input", "other", ""]

#: Role of a column for each word in its name. The pattern matches a whole word or the end of a word, and the first
#: match counts.
_WORDS: tuple[tuple[Role, str], ...] = (
    ("other", r"soll\w*|target|ref\w*|set\w*|desired|demand|goal|error|err|fehler|schleppfehler|status|temp\w*|"
              r"limit|fric\w*|rigid|enable\w*|mask"),
    ("time", r"t|time|zeit|timestamp|zeitstempel|stamp|secs?|seconds|sekunden|datum|date|uhrzeit"),
    ("number", r"index|idx|sample|samples|row|zeile|nr|no|number|nummer|k|n|cycle|zyklus"),
    ("acceleration", r"a|acc|accel\w*|beschl\w*|qdd|ddq"),
    ("counts", r"counts?|cnt|enc|encoder\w*|ticks?|ink\w*|incs?|increments?|zaehler\w*|zähler\w*|impulse?|pulses?"),
    ("velocity", r"v|vel|velocity|speed|geschw\w*|drehzahl|rpm|omega|w|qd|dq"),
    ("position", r"y|x|pos\w*|weg|lage|angle|winkel|phi|theta|q|s|istposition|drehwinkel|auslenkung"),
    ("input", r"u|i|iq|input|torque|moment|drehmoment|current|strom|force|kraft|volts?|voltage|spannung|pwm|effort|tau|"
              r"duty|stell\w*|motor|m|f|eingang|drive|load|last|cmd|command\w*"),
)  # fmt: skip
#: Role of a column for the quantity of its unit.
_MEASURED: dict[str, Role] = {
    "length": "position",
    "angle": "position",
    "speed": "velocity",
    "angular speed": "velocity",
}


def role_of(name: str) -> Role:
    """Return the role of the column with this name, or an empty text if the name shows no role."""
    bare = re.sub(r"\s*[\[(][^\])]*[\])]\s*$", "", name)
    output, driven = column_unit(name, OUTPUTS), column_unit(name, INPUTS)
    split = re.sub(r"([a-zäöüß0-9])([A-ZÄÖÜ])", r"\1 \2", bare)  # "MotorTorque" has two words
    words = [word.rstrip("0123456789") or word for word in re.split(r"[\s_.,:/()\[\]-]+", split.lower()) if word]
    if len(words) > 1 and re.search(r"[\s_.,:/-][AVN]$", bare):
        words = words[:-1]  # "i_A", "u_V": the letter is a unit here, and "a" or "v" alone is not
    if output is not None or driven is not None:  # a unit decides on the role, except for set points
        set_point = any(re.fullmatch(_WORDS[0][1], word) for word in words)
        return "other" if set_point else "input" if output is None else _MEASURED[output.of]
    joined, long_words = "".join(words), [word for word in words if len(word) > 1]  # a letter may be a unit or an index
    for role, pattern in _WORDS:
        if any(re.fullmatch(pattern, word) for word in long_words or [joined, *words]):
            return role
    for role, pattern in _WORDS:
        long = "|".join(part for part in pattern.split("|") if len(part.replace(r"\w*", "")) > 3)
        if re.search(rf"({long})$", joined) or re.match(rf"({long})", joined):
            return role
    return "time" if named_unit(name) else ""


#: Words of a torque or a position that was not measured or is not the raw measurement.
_COMMANDED = r"cmd|command\w*|con|ctrl|control\w*|target|goal|desired|demand|ref\w*|set\w*|soll\w*"
_CHANGED = r"filt\w*|smooth\w*|est|estimate\w*|model|pred\w*|kalman"


def words_of(name: str) -> list[str]:
    """Return the words of a column's name, without numbers."""
    split = re.sub(r"([a-zäöüß0-9])([A-ZÄÖÜ])", r"\1 \2", name)
    return [word for word in re.split(r"[\W_\d]+", split.lower()) if word]


def is_commanded(name: str) -> bool:
    """Return whether the name says that the column is a command and not a measurement."""
    return any(re.fullmatch(_COMMANDED, word) for word in words_of(name))


def is_position(name: str) -> bool:
    """Return whether a whole word of the name says that the column is a position.

    The only single letter for a position is q, the angle of a joint.
    """
    return role_of(name) in ("position", "counts") and any(len(word) > 1 or word == "q" for word in words_of(name))


def distance_from_measured(name: str) -> int:
    """Return by the name 0 for a measured column, 1 for a filtered or estimated column and 2 for a command."""
    changed = any(re.fullmatch(_CHANGED, word) for word in words_of(name))
    return 2 if is_commanded(name) else int(changed)


def number_of(name: str) -> str:
    """Return the number in a name, such as a joint's number, or an empty text without a single number."""
    found = re.findall(r"\d+", re.sub(r"[\[(][^\])]*[\])]\s*$", "", name) or name) or re.findall(r"\d+", name)
    return found[0] if len(found) == 1 else ""
