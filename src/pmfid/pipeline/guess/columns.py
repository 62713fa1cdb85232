"""The choice of the time, input and position columns of a file."""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from pmfid.encoder import Encoder, fine_counts
from pmfid.errors import UsageError
from pmfid.estimators.stretches import liveliest
from pmfid.io.tables import Table, column, times
from pmfid.pipeline.checks.readings import integrate_velocity, is_turned
from pmfid.pipeline.checks.view import MASS, PLAIN, View, best_view
from pmfid.pipeline.guess.roles import Role, distance_from_measured, number_of, role_of
from pmfid.pipeline.tuning import TUNING
from pmfid.records.outliers import wrap_of
from pmfid.types import Flags, Floats
from pmfid.units import OUTPUTS, Unit, column_unit

__all__ = ["is_whole", "step_of"]


def is_whole(values: Floats) -> bool:
    """Return whether all values are whole numbers."""
    return bool(np.array_equal(values, np.rint(values)))


def step_of(values: Floats) -> tuple[float, bool]:
    """Return the smallest step that divides all other steps of finite values (n,), and whether such a step exists.

    Steps up to a billionth of the range are rounding, and a log may have rounded each value to a number of decimals.
    Without a common step, the function returns the range divided by columns_fine.
    """
    found = np.unique(values[: TUNING.columns_most])
    reach = float(np.ptp(found))
    if reach == 0:
        return 1.0, False
    steps = np.diff(found)
    steps = steps[steps > 1e-9 * reach]
    step = float(steps.min())
    for most in (4, 16, 64, 256, 1000):  # small multiples come first, because more iterations need more digits
        times = np.rint(steps / step)
        near = (times > 0) & (times < most) & (np.abs(steps / step - times) < 0.25)
        step = float(np.sum(steps[near]) / np.sum(times[near]))
    off = np.abs(steps / step - np.rint(steps / step))
    exact = steps / step < TUNING.columns_exact / 1e-6
    rounded = rounding_of(found) / step
    allowed = max(TUNING.columns_exact, 1.01 * rounded if rounded < TUNING.most_rounded else 0.0)
    if found.size > 3 and np.mean(off[exact] < allowed) > TUNING.columns_part and reach / step < TUNING.columns_fine:
        return _round_step(step), True
    return max(reach / TUNING.columns_fine, _last_digit(found)), False


def _last_digit(values: Floats) -> float:
    """Return the last digit of the largest of the values (n,), if a log wrote them with a few significant digits.

    The result is 0.0 if the values have more digits.
    """
    some = values[:: max(1, values.size // 1000)].tolist()
    for digits in range(3, 8):
        if all(float(f"{value:.{digits - 1}e}") == value for value in some):
            return float(10.0 ** (np.floor(np.log10(np.max(np.abs(values)))) - digits + 1))
    return 0.0


def rounding_of(values: Floats) -> float:
    """Return the power of ten that divides all values (n,), or 0.0 if the values have too many digits."""
    for digits in range(10):
        scaled = values * 10.0**digits
        if np.all(np.abs(scaled - np.rint(scaled)) < 1e-6) and np.ptp(scaled) < 1e9:
            return 10.0**-digits
    return 0.0


def _round_step(step: float) -> float:
    """Return the step with the fewest digits that give its value."""
    for digits in range(1, 8):
        short = float(f"{step:.{digits}g}")
        if abs(short - step) < 1e-5 * step:
            return short
    return step


#: Roles of an output, best first.
OUTPUT_ROLES: tuple[Role, ...] = ("counts", "position", "velocity")


@dataclass(frozen=True, eq=False)
class Pair:
    """Input and output by name.

    `kind` is "counts", "position" or "velocity". `turned` says whether the input drives against the output. `explained`
    is the part of the input that the motion explains. `reason` is a text for the user. `gravity` says whether a force
    in the sine of the angle explains the input much better, and `load` whether a constant load does.
    """

    input: str
    output: str
    kind: str
    turned: bool
    explained: float
    reason: str = ""
    gravity: bool = False
    load: bool = False


def numeric(table: Table) -> dict[str, Floats]:
    """Return the columns of numbers that are not constant, by name.

    If the topics of a table have separate rows, the function returns the rows of the position. A missing value inside
    the record takes the preceding value of the column, which suffices for a guess.
    """
    found: dict[str, Floats] = {}
    rows: Flags | None = None
    for name in table:
        with suppress(UsageError):
            values = column(table, "column", name)
            good = np.isfinite(values)
            if values.size > 10 and np.mean(good) > TUNING.columns_filled and np.ptp(values[good]) > 0:
                last = np.maximum.accumulate(np.where(good, np.arange(values.size), 0))
                found[name] = np.where(good[last], values[last], values[good][0])
                if np.mean(good) < TUNING.columns_topic and role_of(name) in ("position", "counts"):
                    rows = good
    return {
        name: values[rows] if rows is not None and values.size == rows.size else values
        for name, values in found.items()
    }


def time_of(table: Table, columns: Mapping[str, Floats]) -> tuple[str, Floats, bool] | None:
    """Return the time column, its values, and whether these are dates or times of day, or None without a time
    column.
    """
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
    """Return whether a column grows by nearly equal steps, as time does and motion does not."""
    steps = np.diff(values)
    usual = np.abs(steps - np.median(steps)) < TUNING.columns_even * np.median(steps)
    return bool(np.all(steps > 0) and np.mean(usual) > TUNING.columns_mostly)


def pair_of(columns: Mapping[str, Floats], dt: float, output: str | None = None) -> Pair | None:
    """Return input and output among the columns (n,) with a sample period dt [s].

    Names decide first. Input and output of one joint have one number, and a measured column is better than a command.
    Among several pairs, the motion of the best pair explains most of the input. The result is None without two columns.
    `output` is the column of the output, or None for a guess.
    """
    roles = {name: role_of(name) for name in columns}
    named = ([name for name in columns if roles[name] == role] for role in OUTPUT_ROLES)
    outputs = next(filter(None, named), None) or [name for name in columns if roles[name] in ("", "input")]
    outputs = [output] if output else outputs
    columns = {**columns, **{name: _undo_wrap(columns[name]) for name in outputs if roles[name] != "velocity"}}
    outputs = _moving(columns, _least_distant(outputs)) or outputs
    stems = {name: re.sub(r"\d+", "", name) if roles[name] else name for name in outputs}
    travel = {name: float(np.ptp(columns[name])) for name in outputs}
    most = {stem: max(travel[name] for name in outputs if stems[name] == stem) for stem in stems.values()}
    outputs = (
        [output] if output else [name for name in outputs if travel[name] > TUNING.least_travel * most[stems[name]]]
    )
    inputs = [name for name in columns if roles[name] == "input"] or [name for name in columns if roles[name] == ""]
    inputs = _least_distant(inputs)
    pairs = [
        (name, output)
        for output in outputs
        for name in inputs
        if name != output and columns[name].size == columns[output].size
    ]
    joints = [pair for pair in pairs if roles[pair[0]] and roles[pair[1]] and number_of(pair[0])]
    numbered = [pair for pair in joints if number_of(pair[0]) == number_of(pair[1])]
    tried = [
        one
        for name, output in (numbered or pairs)[: TUNING.most_pairs]
        if (one := _try_pair(columns, name, output, roles[output], dt))
    ]
    if not tried:
        return None
    best = max(tried, key=lambda one: one.explained * (TUNING.turned_joint if numbered and one.turned else 1.0))
    others = [f"{one.input} and {one.output} {100 * one.explained:.3g} %" for one in tried if one is not best]
    further = f"; {', '.join(others[:3])}" if others else ""
    reason = f"the motion of {best.output} explains it to {100 * best.explained:.3g} %{further}"
    return replace(best, reason=reason)


def _least_distant(names: list[str]) -> list[str]:
    """Return the columns that are closest to a measurement among columns of one number."""
    closest = dict[str, int]()
    for name in names:
        closest[number_of(name)] = min(closest.get(number_of(name), 2), distance_from_measured(name))
    return [name for name in names if distance_from_measured(name) == closest[number_of(name)]]


def _moving(columns: Mapping[str, Floats], outputs: list[str]) -> list[str]:
    """Return the outputs that are possible for a mass, without jumps and velocities of other outputs."""
    smooth = [name for name in outputs if role_of(name) or not _jumps(columns[name])]
    rates = {a for a in smooth for b in smooth if a != b and not role_of(a) and _is_rate(columns[a], columns[b])}
    return [name for name in smooth if name not in rates]


def _jumps(values: Floats) -> bool:
    """Return whether a column (n,) crosses much of its range within a sample in both directions, as a relay does.

    A mass cannot jump. A counter that wraps moves in the opposite direction before it jumps.
    """
    change = np.diff(values)
    at = np.flatnonzero(np.abs(change) > TUNING.columns_jump * np.ptp(values))
    at = at[at > 0]
    if min(np.sum(change[at] > 0), np.sum(change[at] < 0)) < TUNING.few_jumps:
        return False
    wraps = change[at - 1] * change[at] < 0
    return bool(np.mean(wraps) < 0.8)


def _try_pair(columns: Mapping[str, Floats], name: str, output: str, role: Role, dt: float) -> Pair | None:
    """Return a pair of columns under its best reading, or None for a column and its own velocity in either order."""
    if role != "velocity" and _is_rate(columns[name], columns[output]):
        return None
    if _is_rate(columns[output], columns[name]) or _is_set_point(columns[name], columns[output]):
        return None
    kinds = _kinds(role, column_unit(output, OUTPUTS))
    found = [(kind, _view(columns[name], columns[output], kind, dt)) for kind in kinds]
    seen = [(kind, view) for kind, view in found if view is not None]
    if not seen:
        return Pair(name, output, _whole(output, columns[output], kinds[0]), False, 0.0)
    kind, view = min(seen, key=lambda pair: _cost_of_kind(role, *pair))
    explained = max(0.0, 1 - _cost(view))
    load = view.shows_load(TUNING.hanging_better, TUNING.hanging_likely)
    if kind == "velocity":
        return Pair(name, output, kind, is_turned(view), explained, load=load)
    gravity = _hangs(columns[name], columns[output], column_unit(output, OUTPUTS), dt, view.unexplained)
    return Pair(
        name,
        output,
        _whole(output, columns[output], kind),
        is_turned(view),
        explained,
        gravity=gravity,
        load=load and not gravity,
    )


def _cost_of_kind(role: Role, kind: str, view: View) -> float:
    """Return the unexplained part of a reading. A reading that contradicts the column's name must explain far more,
    and the mass of one that agrees with the name need not be significant.
    """
    if kind == role:
        return view.unexplained
    return _cost(view) * (TUNING.columns_against if role else 1.0)


def _hangs(u: Floats, y: Floats, unit: Unit | None, dt: float, plain: float) -> bool:
    """Return whether gravity in the sine of the output explains much of the input u (n,) that a plain drive leaves
    unexplained.

    Gravity must also explain more than a spring does. `plain` is the part of the input that the drive leaves. The
    function returns False if the output y (n,) is no angle or turns little.
    """
    angle = y * (unit.factor if unit else 1.0)
    if is_whole(y) if unit is None else unit.of != "angle":
        return False
    if not TUNING.readings_turned < np.ptp(angle) < TUNING.most_turned:
        return False
    encoder, counts = fine_counts(angle)
    part = liveliest(counts, TUNING.view_most_samples)
    forms = (replace(PLAIN, gravity=True), replace(PLAIN, spring=True))
    hanging, sprung = (best_view(u[part], counts[part], encoder, dt, model=form) for form in forms)
    if hanging is None or hanging.unexplained > TUNING.hanging_better * plain:
        return False
    sure = max(abs(hanging.sure(row)) for row in np.eye(hanging.theta.size)[-2:])
    return sure > TUNING.hanging_likely and (sprung is None or hanging.unexplained < sprung.unexplained)


def _kinds(role: Role, unit: Unit | None) -> tuple[str, ...]:
    """Return the possible kinds of an output, from the role and the unit in its name."""
    if role == "velocity":
        return ("velocity",)
    travel = role == "counts" or (unit is not None and unit.of in ("length", "angle"))
    return ("position",) if travel else ("position", "velocity")


def _is_rate(values: Floats, output: Floats) -> bool:
    """Return whether a column (n,) is the velocity of the output (n,), which a drive may log with the position."""
    change = np.gradient(output)
    size = float(np.std(values) * np.std(change))
    return size > 0 and float(np.mean((values - values.mean()) * (change - change.mean()))) > TUNING.columns_same * size


def _is_set_point(values: Floats, output: Floats) -> bool:
    """Return whether a column (n,) is nearly equal to the output, as a set point is."""
    alike = float(np.std(values - output)) < TUNING.columns_set_point * float(np.std(output))
    return alike and abs(float(np.mean(values - output))) < float(np.std(output))


def _cost(view: View) -> float:
    """Return the unexplained part of a reading, or 1 without a significant mass. A velocity would always explain
    its own column.
    """
    return view.unexplained if abs(view.sure(np.eye(view.theta.size)[MASS])) > TUNING.columns_significant else 1.0


def _whole(name: str, output: Floats, kind: str) -> str:
    """Return the kind of an output. An output of whole numbers is counts, unless its name has a unit of travel."""
    return "counts" if kind == "position" and is_whole(output) and column_unit(name, OUTPUTS) is None else kind


def _undo_wrap(y: Floats) -> Floats:
    """Return an output (n,) without the jumps of a counter or an angle that wraps."""
    step, found = step_of(y)
    wrap = wrap_of(np.floor(y / step + 0.5).astype(np.int64)) if found else None
    return y if wrap is None else np.asarray(np.unwrap(y, period=wrap.span * step))


def _view(u: Floats, y: Floats, kind: str, dt: float) -> View | None:
    if kind == "velocity":
        encoder, counts = fine_counts(integrate_velocity(y, dt))
    elif is_whole(y):
        encoder, counts = Encoder(1.0), y.astype(np.int64)
    else:
        encoder, counts = fine_counts(y)
    part = liveliest(counts, TUNING.view_most_samples)
    return best_view(u[part], counts[part], encoder, dt)
