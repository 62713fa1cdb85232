"""The columns of time, input and output in a table, by their names and by how well the motion explains the input."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from pmfid.encoder import Encoder, fine_counts
from pmfid.errors import UsageError
from pmfid.session.checks.log import liveliest
from pmfid.session.checks.readings import integrate_velocity, is_turned
from pmfid.session.checks.view import MASS, View, best_view
from pmfid.session.guess.lattice import is_whole
from pmfid.session.guess.names import Role, role_of
from pmfid.session.tables import Table, column, times
from pmfid.session.units import OUTPUTS, Unit, column_unit
from pmfid.session.wrap import wrap_of
from pmfid.types import Floats

__all__ = ["Pair", "numeric", "pair_of", "time_of"]

#: Roles of an output, best first.
OUTPUT_ROLES: tuple[Role, ...] = ("counts", "position", "velocity")
#: Most inputs and most outputs that are tried.
MOST_COLUMNS = 6
#: Least mass of a reading, in its standard deviations.
SIGNIFICANT = 4.5
#: Factor on the unexplained part of a reading that contradicts the column's name.
AGAINST = 3.0
#: Least part of usual steps in a time column; largest relative deviation of a usual step from the median.
MOSTLY, EVEN = 0.9, 0.2
#: Least jump of a column that is no motion, as a part of its range; least number of jumps in each direction.
JUMP, FEW_JUMPS = 0.4, 3
#: Least correlation of a column with the change of the output that makes it the velocity, and no input.
SAME = 0.99


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
    usual = np.abs(steps - np.median(steps)) < EVEN * np.median(steps)
    return bool(np.all(steps > 0) and np.mean(usual) > MOSTLY)


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
        for output in outputs[:MOST_COLUMNS]
        for name in inputs[:MOST_COLUMNS]
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
    at = np.flatnonzero(np.abs(change) > JUMP * np.ptp(values))
    at = at[at > 0]
    if min(np.sum(change[at] > 0), np.sum(change[at] < 0)) < FEW_JUMPS:
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
    kind, view = min(seen, key=lambda pair: _cost(pair[1]) * (AGAINST if role and pair[0] != role else 1.0))
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
    return size > 0 and float(np.mean((values - values.mean()) * (change - change.mean()))) > SAME * size


def _cost(view: View) -> float:
    """The unexplained part; 1 without a significant mass, for a velocity explains its own column."""
    return view.unexplained if abs(view.sure(np.eye(view.theta.size)[MASS])) > SIGNIFICANT else 1.0


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
