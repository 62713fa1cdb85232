"""Which columns of a file are time, input and position."""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pmfid.config.units import INPUTS, OUTPUTS, Unit, column_unit
from pmfid.encoder import Encoder, fine_counts
from pmfid.errors import UsageError
from pmfid.io.tables import Table, column, times
from pmfid.pipeline.checks.readings import integrate_velocity, is_turned
from pmfid.pipeline.checks.view import MASS, View, best_view, liveliest
from pmfid.pipeline.tuning import TUNING
from pmfid.records.clock import named_unit
from pmfid.records.outliers import wrap_of
from pmfid.types import Floats

__all__ = ["is_whole", "step_of"]


def is_whole(values: Floats) -> bool:
    """Are all values whole numbers?"""
    return bool(np.array_equal(values, np.rint(values)))


def step_of(values: Floats) -> tuple[float, bool]:
    """The smallest step that divides all others, and whether there is one; values: (n,), finite.

    Steps up to a billionth of the range are rounding, and a log may have rounded each value to a number of decimals.
    Without such a step, the range over columns_fine.
    """
    found = np.unique(values[: TUNING.columns_most])
    reach = float(np.ptp(found))
    if reach == 0:
        return 1.0, False
    steps = np.diff(found)
    steps = steps[steps > 1e-9 * reach]
    step = float(steps.min())
    for most in (4, 16, 64, 256, 1000):  # more digits with every turn: small multiples first
        times = np.rint(steps / step)
        near = (times > 0) & (times < most) & (np.abs(steps / step - times) < 0.25)
        step = float(np.sum(steps[near]) / np.sum(times[near]))
    off = np.abs(steps / step - np.rint(steps / step))
    exact = steps / step < TUNING.columns_exact / 1e-6
    rounded = rounding_of(found) / step
    allowed = max(TUNING.columns_exact, 1.01 * rounded if rounded < TUNING.most_rounded else 0.0)
    if found.size > 3 and np.mean(off[exact] < allowed) > TUNING.columns_part and reach / step < TUNING.columns_fine:
        return _round_step(step), True
    return reach / TUNING.columns_fine, False


def rounding_of(values: Floats) -> float:
    """The power of ten that divides all values (n,); 0.0 if the values have too many digits."""
    for digits in range(10):
        scaled = values * 10.0**digits
        if np.all(np.abs(scaled - np.rint(scaled)) < 1e-6) and np.ptp(scaled) < 1e9:
            return 10.0**-digits
    return 0.0


def _round_step(step: float) -> float:
    """The step with the fewest digits that give its value."""
    for digits in range(1, 8):
        short = float(f"{step:.{digits}g}")
        if abs(short - step) < 1e-5 * step:
            return short
    return step


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


#: Roles of an output, best first.
OUTPUT_ROLES: tuple[Role, ...] = ("counts", "position", "velocity")


@dataclass(frozen=True, eq=False)
class Pair:
    """Input and output by name; kind: "counts", "position" or "velocity"; turned: the input drives against the output;
    explained: part of the input that the motion explains; reason: for people."""

    input: str
    output: str
    kind: str
    turned: bool
    explained: float
    reason: str


def numeric(table: Table) -> dict[str, Floats]:
    """The columns of numbers that are not constant, by name; missing values are interpolated, which suffices for a
    guess."""
    found: dict[str, Floats] = {}
    for name in table:
        with suppress(UsageError):
            values = column(table, "column", name)
            good = np.isfinite(values)
            if values.size > 10 and np.mean(good) > 0.5 and np.ptp(values[good]) > 0:
                found[name] = np.interp(np.arange(values.size), np.flatnonzero(good), values[good])
    return found


def time_of(table: Table, columns: Mapping[str, Floats]) -> tuple[str, Floats, bool] | None:
    """The time column, its values, and whether these are dates or times of day; None without a time column."""
    named = [name for name in table if role_of(name) == "time"]
    content = [name for name in columns if role_of(name) == "" and _even(columns[name])]
    for name in (*named, *content):
        with suppress(UsageError):
            values, written = times(table, name)
            values = values[np.isfinite(values)]
            if values.size > 10 and np.mean(np.diff(values) > 0) > 0.9:
                return name, values, written
    return None


def _even(values: Floats) -> bool:
    """Does a column grow by nearly equal steps, as time does and no motion?"""
    steps = np.diff(values)
    usual = np.abs(steps - np.median(steps)) < TUNING.columns_even * np.median(steps)
    return bool(np.all(steps > 0) and np.mean(usual) > TUNING.columns_mostly)


def pair_of(columns: Mapping[str, Floats], dt: float) -> Pair | None:
    """Input and output among columns (n,) by name, sampled every dt [s]. Names decide first; among several pairs, the
    one whose motion explains most of the input. None without two columns."""
    roles = {name: role_of(name) for name in columns}
    outputs = next(
        (found for role in OUTPUT_ROLES if (found := [name for name in columns if roles[name] == role])), None
    ) or [name for name in columns if roles[name] in ("", "input")]
    outputs = _moving(columns, outputs) or outputs
    inputs = [name for name in columns if roles[name] == "input"] or [name for name in columns if roles[name] == ""]
    tried = [
        one
        for output in outputs[: TUNING.most_columns]
        for name in inputs[: TUNING.most_columns]
        if name != output
        and columns[name].size == columns[output].size
        and (one := _try_pair(columns, name, output, roles[output], dt))
    ]
    if not tried:
        return None
    best = max(tried, key=lambda one: one.explained)
    others = [f"{one.input} and {one.output} {100 * one.explained:.3g} %" for one in tried if one is not best]
    further = f"; {', '.join(others[:3])}" if others else ""
    reason = f"the motion of {best.output} explains it to {100 * best.explained:.3g} %{further}"
    return Pair(best.input, best.output, best.kind, best.turned, best.explained, reason)


def _moving(columns: Mapping[str, Floats], outputs: list[str]) -> list[str]:
    """The outputs that a mass can have: none that jumps, and no velocity of another one."""
    smooth = [name for name in outputs if role_of(name) or not _jumps(columns[name])]
    rates = {a for a in smooth for b in smooth if a != b and not role_of(a) and _is_rate(columns[a], columns[b])}
    return [name for name in smooth if name not in rates]


def _jumps(values: Floats) -> bool:
    """Does a column (n,) cross much of its range within a sample, in both directions, as a relay does and no mass? A
    counter that wraps moves before it jumps, in the opposite direction."""
    change = np.diff(values)
    at = np.flatnonzero(np.abs(change) > TUNING.columns_jump * np.ptp(values))
    at = at[at > 0]
    if min(np.sum(change[at] > 0), np.sum(change[at] < 0)) < TUNING.few_jumps:
        return False
    wraps = change[at - 1] * change[at] < 0
    return bool(np.mean(wraps) < 0.8)


def _try_pair(columns: Mapping[str, Floats], name: str, output: str, role: Role, dt: float) -> Pair | None:
    """A pair of columns under its best reading; None for a column and its own velocity, in either order."""
    if role != "velocity" and _is_rate(columns[name], columns[output]):
        return None
    if _is_rate(columns[output], columns[name]):
        return None
    kinds = _kinds(role, column_unit(output, OUTPUTS))
    found = [(kind, _view(columns[name], columns[output], kind, dt)) for kind in kinds]
    seen = [(kind, view) for kind, view in found if view is not None]
    if not seen:
        return Pair(name, output, _whole(output, columns[output], kinds[0]), False, 0.0, "")
    # against its name a column is a velocity only if it explains far more as one
    kind, view = min(
        seen, key=lambda pair: _cost(pair[1]) * (TUNING.columns_against if role and pair[0] != role else 1.0)
    )
    explained = max(0.0, 1 - _cost(view))
    return Pair(name, output, _whole(output, columns[output], kind), is_turned(view), explained, "")


def _kinds(role: Role, unit: Unit | None) -> tuple[str, ...]:
    """The possible kinds of an output, by the role and the unit in its name."""
    if role == "velocity":
        return ("velocity",)
    travel = role == "counts" or (unit is not None and unit.of in ("length", "angle"))
    return ("position",) if travel else ("position", "velocity")


def _is_rate(values: Floats, output: Floats) -> bool:
    """Is a column (n,) the velocity of the output (n,), as a drive logs it together with the position?"""
    change = np.gradient(output)
    size = float(np.std(values) * np.std(change))
    return size > 0 and float(np.mean((values - values.mean()) * (change - change.mean()))) > TUNING.columns_same * size


def _cost(view: View) -> float:
    """The unexplained part; 1 without a significant mass, for a velocity explains its own column."""
    return view.unexplained if abs(view.sure(np.eye(view.theta.size)[MASS])) > TUNING.columns_significant else 1.0


def _whole(name: str, output: Floats, kind: str) -> str:
    """The kind of an output: whole numbers are counts, unless the name has a unit of travel."""
    return "counts" if kind == "position" and is_whole(output) and column_unit(name, OUTPUTS) is None else kind


def _view(u: Floats, y: Floats, kind: str, dt: float) -> View | None:
    if kind == "velocity":
        encoder, counts = fine_counts(integrate_velocity(y, dt))
    elif is_whole(y):
        encoder, counts = Encoder(1.0), y.astype(np.int64)
        wrap = wrap_of(counts)
        if wrap is not None:
            change = np.diff(counts)
            undone = (change + wrap.span // 2) % wrap.span - wrap.span // 2
            counts = np.r_[counts[0], counts[0] + np.cumsum(undone)]
    else:
        encoder, counts = fine_counts(y)
    part = liveliest(counts)
    return best_view(u[part], counts[part], encoder, dt)
