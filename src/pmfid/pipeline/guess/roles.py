"""The evidence in a column's name for the role of the column, its joint, and whether it was measured."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from functools import cache
from typing import Literal

from pmfid.records.clock import named_unit
from pmfid.units import INPUTS, OUTPUTS, column_unit

#: Scores of a pair are logarithms of odds. `PAIRS_NOTHING` is the score of a log without an axis, and the weight
#: from which on a name excludes other roles. A log without names needs a motion that explains two thirds of the
#: input. `PAIRS_CLEAR` is the weight of a clear name, and `PAIRS_COMPUTED` the weight of a word for a filtered
#: value, or half of the weight of a word for a command.
PAIRS_NOTHING = 2.0
PAIRS_CLEAR = 4.0
PAIRS_COMPUTED = 1.0
#: Difference of scores beyond which another pair does not matter, and weight of a unit in a name.
PAIRS_CERTAIN = 6.0
#: Weight of a unit that may stand for any quantity, as a voltage or a ratio on an oscilloscope.
ROLES_ANALOG = 1.5

Role = Literal["time", "number", "counts", "position", "velocity", "acceleration", "input", "other", ""]

#: Words of a set point or command, of a measured value, and of a value that was computed from a measurement.
_COMMANDED = """cmd command commanded con ctrl control controller target goal des desired demand demanded ref reference
    set setpoint soll sollwert request requested req vorgabe führungsgrösse"""
_CHANGED = "filt filtered filter smooth smoothed est estimate estimated model pred predicted kalman gefiltert geglättet"
_NEUTRAL = "meas measured act actual ist istwert fb feedback gemessen"
#: Roles of words with the weight of each as evidence (logarithm of odds). A weight of 4 is a clear word of the field,
#: and a weight of 1 only hints. A word may have several roles.
_WORDS: tuple[tuple[Role, float, str], ...] = (
    ("time", 4, """time zeit timestamp zeitstempel stamp uhrzeit datum date clock elapsed millis micros secs seconds
        sekunden timestep zeitpunkt"""),
    ("time", 2, "t ts sec ms us"),
    ("time", 0.5, "s tick ticks"),
    ("number", 4, "index idx sample samples row zeile nummer number lfd"),
    ("number", 2, "nr no k cycle zyklus num"),
    ("number", 1, "n step steps schritt schritte id"),
    ("counts", 4, """count counts cnt cnts counter enc encoder ink inkrement inkremente inc incs increment increments
        zaehler zähler zählerstand zaehlerstand impuls impulse pulse pulses qei"""),
    ("counts", 3, "tick ticks"),
    ("counts", 1.5, "step steps schritt schritte"),
    ("position", 4, """position pos weg lage angle winkel theta phi drehwinkel auslenkung displacement dist distance
        travel stroke hub verfahrweg height hoehe höhe stellung"""),
    ("position", 3, "q"),
    ("position", 2, "x y alpha output ausgang"),
    ("position", 1.5, "s"),
    ("position", 1, "z beta r p qm"),
    ("position", 0.5, "out"),
    ("velocity", 4, "velocity vel speed geschw geschwindigkeit drehzahl rpm omega tacho"),
    ("velocity", 3, """dq qd dx xd dy dtheta dphi dpos qdot xdot ydot thetadot phidot posdot dot winkelgeschwindigkeit
        gyro"""),
    ("velocity", 2, "v w"),
    ("velocity", 1.5, "n rate"),
    ("acceleration", 4, "acceleration acc accel beschl beschleunigung"),
    ("acceleration", 4, "ddq qdd ddx xdd ddtheta ddphi qddot xddot ddot"),
    ("acceleration", 1, "a"),
    ("input", 4, "torque moment drehmoment current strom force kraft effort tau amp amps ampere iq thrust"),
    ("input", 3, """voltage spannung volt volts pwm duty stellgrösse stellgroesse stellgröße stellwert stellsignal stell
        stellspannung input eingang throttle uq vq ia im cur curr"""),
    ("input", 2.5, "u ua um in cmd command control ctrl"),
    ("input", 1.5, "i f m"),
    ("other", 2, "e"),
    ("input", 1, "motor drive antrieb load last v id signal out"),
    ("other", 5, """error err fehler schleppfehler regelabweichung abweichung deviation status temp temperature
        temperatur limit fric friction reibung rigid enable enabled mask mode fault alarm bus supply batt battery bat
        versorgung zwischenkreis"""),
    ("other", 3, "power leistung energy energie pressure druck noise humidity valid flag"),
)  # fmt: skip
#: Role of a column without any other word than that for a measured value.
_ACTUAL: tuple[Role, float] = ("position", 2.0)
#: Role of a column for the quantity of its unit.
_MEASURED: dict[str, Role] = {
    "length": "position",
    "angle": "position",
    "speed": "velocity",
    "angular speed": "velocity",
}
#: Units in brackets that are neither travel, speed nor input.
_COUNTED = re.compile(r"(inc|counts?|cts|cnts?|ticks?|pulses?|steps?|ink\w*|impulse?)$", re.IGNORECASE)
_FOREIGN = re.compile(r"(°C|degC|K|W|kW|Hz|kHz|bar|Pa|kg|J|dB|lux)$")
_BRACKETS = re.compile(r"\s*[\[(]([^\])]*)[\])]\s*$")


def _vocabulary() -> dict[str, list[tuple[Role, float]]]:
    words: dict[str, list[tuple[Role, float]]] = {}
    for role, weight, text in _WORDS:
        for word in text.split():
            words.setdefault(word, []).append((role, weight))
    for word in " ".join((_COMMANDED, _CHANGED, _NEUTRAL)).split():
        words.setdefault(word, [])
    return words


_KNOWN = _vocabulary()
#: Words that may begin a longer word, longest first, and words that may end it. Other short words end many words.
_PARTS = sorted((word for word in _KNOWN if len(word) > 2), key=len, reverse=True)
_ENDS = [word for word in _PARTS if len(word) > 3 or word in ("pos", "ref", "cmd", "vel", "ist")]


@dataclass(frozen=True)
class NameEvidence:
    """Evidence in a name: the weight of each role, and whether the column is a command or was computed."""

    weights: dict[Role, float] = field(default_factory=dict)
    commanded: bool = False
    changed: bool = False

    @property
    def role(self) -> Role:
        """The likeliest role, or an empty text without any. A set point of a motion is "other"."""
        best: Role = max(self.weights, key=lambda role: self.weights[role], default="")
        if self.commanded and self.weights.get("input", 0.0) < max(self.weights.values(), default=1.0):
            return "other"
        return best

    def lean(self, *roles: Role) -> float:
        """Return the log-odds of the best of some roles against all other roles."""
        good = max((self.weights.get(role, 0.0) for role in roles), default=0.0)
        return good - max((weight for role, weight in self.weights.items() if role not in roles), default=0.0)


@cache
def evidence_of(name: str) -> NameEvidence:
    """Return the evidence in a name."""
    words = _words_and_letters(name)
    weights: dict[Role, float] = {}
    last = max((k for k, word in enumerate(words) if _weight(word) > 2), default=-1)
    for k, word in enumerate(words):
        for role, weight in _KNOWN.get(word, ()):
            # The last clear word of a name is its noun: a motor position is a position, a position error an error.
            weights[role] = max(weights.get(role, 0.0), weight if k == last or last < 0 else min(weight, 2.5))
    if not weights and any(word in _NEUTRAL.split() for word in words):
        weights = dict([_ACTUAL])
    if words and words[0] != "dot" and "dot" in words:
        weights.pop("position", None)
    output, driven = column_unit(name, OUTPUTS), column_unit(name, INPUTS)
    bracket = _BRACKETS.search(name)
    inside = bracket.group(1).strip() if bracket else ""
    if output is not None or driven is not None:
        measured: Role = "input" if output is None else _MEASURED[output.of]
        analog = driven is not None and driven.of in ("voltage", "ratio")
        weights[measured] = max(weights.get(measured, 0.0), ROLES_ANALOG if analog else PAIRS_CERTAIN)
    elif unit := named_unit(name):
        bare = name.strip()[-2:-1] in "_ ." and unit == "s"
        weights["time"] = weights.get("time", 0.0) + (1.0 if bare else 3.0)
    elif _COUNTED.match(inside):
        weights["counts"] = max(weights.get("counts", 0.0), 4.0)
    elif _FOREIGN.match(inside):
        weights["other"] = PAIRS_CERTAIN
    pair = re.fullmatch(r"[a-z]_d", name.strip().lower())
    commanded = bool(pair) and name.strip().lower()[0] in "qxyvw"
    commanded |= any(word in _COMMANDED.split() for word in words)
    return NameEvidence(weights, commanded, any(word in _CHANGED.split() for word in words))


def _weight(word: str) -> float:
    return max((weight for _, weight in _KNOWN.get(word, ())), default=0.0)


def _words_and_letters(name: str) -> list[str]:
    """Return the known words of a name. A letter after the first word is a unit or an index, and does not count."""
    bare = _BRACKETS.sub("", name) or name
    words = words_of(bare)
    if joined := [word for word in ("".join(words), "".join(words[:2])) if word in _KNOWN and len(words) > 1]:
        return [joined[0], *words[2:]] if joined[0] not in ("qd", "xd", "id") or "_" not in bare else words[:1]
    letters = [word for k, word in enumerate(words) if len(word) > 1 or k == 0]
    return [part for word in letters for part in _split_compound(word)]


@cache
def _split_compound(word: str) -> list[str]:
    """Return the known words in a compound, such as "ist" and "position" in "istposition"."""
    if not word or word in _KNOWN:
        return [word] if word else []
    for part in _PARTS:
        if word.startswith(part):
            return [part, *_split_compound(word.removeprefix(part))]
        if part in _ENDS and word.endswith(part):
            return [*_split_compound(word.removesuffix(part)), part]
    return []


def role_of(name: str) -> Role:
    """Return the likeliest role of the column with this name, or an empty text if the name shows no role."""
    return evidence_of(name).role


def words_of(name: str) -> list[str]:
    """Return the words of a column's name, without numbers."""
    split = re.sub(r"([a-zäöüß0-9])([A-ZÄÖÜ])", r"\1 \2", name)
    return [word for word in re.split(r"[\W_\d]+", split.lower()) if word]


def is_commanded(name: str) -> bool:
    """Return whether the name says that the column is a command and not a measurement."""
    return evidence_of(name).commanded


def is_position(name: str) -> bool:
    """Return whether a whole word of the name says that the column is a position.

    The only single letter for a position is q, the angle of a joint.
    """
    return role_of(name) in ("position", "counts") and any(len(word) > 1 or word == "q" for word in words_of(name))


def number_of(name: str) -> str:
    """Return the number in a name, such as a joint's number, or an empty text without a single number."""
    found = re.findall(r"\d+", re.sub(r"[\[(][^\])]*[\])]\s*$", "", name) or name) or re.findall(r"\d+", name)
    return found[0] if len(found) == 1 else ""
