"""The first fits of a record: least squares from the blind start, with each force of the table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from pmfid.errors import NotIdentifiableError
from pmfid.fit.build import PIECES
from pmfid.fit.likelihood import ROUNDING, Intervals
from pmfid.fit.machine import OFFSET
from pmfid.fit.problem import PARTS
from pmfid.fit.search import EXPLAINED, FOLLOW, GAIN, SPEEDS, TRIES, WITHIN, FitSearch, mean_square, narrow_most
from pmfid.fit.shooting import join
from pmfid.fit.solve import Optimum
from pmfid.fit.tuning import MOTION

#: Steps of least squares with a set of forces. The set that is kept has more of them.
STEPS = 12
#: Number of the likeliest sets that may explain every count.
LIKELY = 3
#: Numbers of parts of a record that a motion follows first, where it does not follow the whole record.
NUMBERS = (PIECES, 4 * PIECES, 16 * PIECES)
#: Cost of an observation of pieces that leave rounding alone: 1/2, and a fifth more.
NEAR = 0.6


class LostMotionError(NotIdentifiableError):
    """Forces of the position push the motion away from the record, and shorter stretches may follow it."""


@dataclass(frozen=True, eq=False)
class Opening:
    """The end of least squares with a set of forces, and the state of the search.

    `cost` is minus the log likelihood, `held` that with forces at the measured positions, `rounding` that of a motion
    near rounding.
    """

    cost: float
    held: float
    rounding: float
    rows: int
    chosen: list[int]
    state: dict[str, object]

    @property
    def order(self) -> float:
        """The cost by Schwarz (1978), with forces at the measured positions if that is lower."""
        return self.rows * math.log(min(self.cost, self.held)) + len(self.chosen) * math.log(self.rows)

    @property
    def lost(self) -> bool:
        """Whether forces of the position push the motion away, and none does at the measured positions."""
        return self.held < self.cost and self.cost > self.rounding

    def enter(self, search: FitSearch) -> None:
        """Return the search to this state."""
        search.return_to(self.state)


def begin(search: FitSearch, whole: bool = False) -> Intervals | None:
    """Solve from the blind start without a further force, and with each force of the table, and keep the best end.

    Steps from the plain motion do not show a force that bends the motion far. Where an end is near rounding, further
    forces may explain every count. The search is left at the first set whose motion explains every count, or else at
    that of the lowest cost. Returns the likelihood of the intervals if a motion explains every count.

    Raises LostMotionError if forces of the position push a motion away from a `whole` record.
    """
    plain, share = _begin_plain(search, whole)
    likelihood = _explain_any(search, [plain])
    if likelihood is not None:
        return likelihood
    plain.enter(search)
    ends = [plain]
    for chosen in list_openings(search):
        search.restart(chosen, share)
        ends.append(_end(search, held=plain.lost))
    leaders = _lead(search, ends)
    _check_lost(leaders[0], whole)
    best = _find_constants(search, leaders[0])
    likelihood = _explain_any(search, [best, *leaders[1:]], plain)
    if likelihood is None and (shorter := _forget_input(search, best)) is not best:
        best, likelihood = shorter, _explain_any(search, [shorter])
    if likelihood is None:
        best.enter(search)
    return likelihood


def _begin_plain(search: FitSearch, whole: bool) -> tuple[Opening, float]:
    """Return the best end without a further force, and the share of the highest speed that it started from.

    Only a motion that leaves more than rounding calls for further starts, and for parts of the record.
    """
    free = any(force.free for force in search.plain.machine.forces)
    ends = list[tuple[Opening, float]]()
    for share in SPEEDS if free else SPEEDS[:1]:
        search.restart((), share)
        ends.append((_end(search, 3 * STEPS), share))
        best, first = min(ends, key=lambda pair: pair[0].order)
        if best.cost < best.rounding:
            return _forget_input(search, best), first
    _check_lost(best, whole and best.held < best.rounding)
    best.enter(search)
    if search.problem.integrates and not search.plain.machine.elastic:
        best = _shoot(search, best, first, whole)
    return best, first


def _shoot(search: FitSearch, before: Opening, share: float, whole: bool) -> Opening:
    """Return the end of a motion that follows short parts of the record first. The end `before` stays if the joined
    parts leave more than rounding.

    Short parts stay near the record, wherever the search begins (Bock 1983).
    Raises LostMotionError for a `whole` record if the motion follows parts of it alone.
    """
    for number in NUMBERS:
        joined = _join_parts(search, number, share)
        if joined is None:
            continue
        search.q, search.starts = joined.q, joined.starts
        end = _open(search, search.solve(search.noise).cost)
        if end.cost < end.rounding:
            search.refine()
            if search.problem.parts < MOTION.parts:
                return _forget_input(search, _open(search, end.cost))
        if whole:
            raise LostMotionError(f"the motion follows parts of the record alone; {FOLLOW}")
        before.enter(search)
    return before


def _join_parts(search: FitSearch, number: int, share: float) -> Optimum | None:
    """Return the fit of the record by a number of parts of it, or None if the motion does not follow the parts."""
    record = search.problem
    try:
        pieces = FitSearch(record.cut(number))
    except NotIdentifiableError:  # the parts are too short for a blind start
        return None
    pieces.restart((), share)
    if _end(pieces, 3 * STEPS).cost > NEAR * pieces.plain.rows:
        return None
    length = sum(float(one.times[-1]) for one in record.stretches) / number
    return join(record, pieces.problem, pieces.solve(pieces.noise), length, search.prior(record))


def list_openings(search: FitSearch) -> list[tuple[int, ...]]:
    """Return the sets of forces that a fit may begin with: each force alone, gravity, and a spring with a load."""
    table = search.table
    loads = [i for i, row in enumerate(table) if row.base == OFFSET]
    if search.plain.machine.elastic:
        return [tuple(loads)] if loads else []
    springs = [i for i, row in enumerate(table) if row.name == "spring"]
    pairs: dict[str, list[int]] = {}  # sine and cosine of gravity and of errors of the encoder
    for i, row in enumerate(table):
        if row.name == "gravity" or row.reading is not None:
            pairs.setdefault(row.words, []).append(i)
    paired = [tuple(pair) for pair in pairs.values()]
    alone = [(i,) for i in range(len(table)) if i not in (*springs, *sum(paired, ()))]
    return [one for one in ((*loads, *springs), *paired, *alone) if one]


def _end(search: FitSearch, steps: int = STEPS, held: bool = False) -> Opening:
    """Return the end of least squares. Forces are held over at least half of an interval, which saves time. Only
    `held`, forces of the position stay at the measured positions."""
    fine = search.problem
    search.problem = replace(fine, parts=min(PARTS, fine.parts))
    at_measured = search.approach(steps)
    cost = at_measured if held and math.isfinite(at_measured) else search.solve(search.noise, steps).cost
    search.problem = fine
    return _open(search, cost, at_measured)


def _check_lost(end: Opening, whole: bool) -> None:
    if whole and end.lost:
        raise LostMotionError(f"forces of the position push the motion away from the record; {FOLLOW}")


def _open(search: FitSearch, cost: float, held: float = math.inf) -> Opening:
    rows = search.plain.rows
    return Opening(cost, held, rows * WITHIN / (2 * ROUNDING), rows, search.chosen, search.remember())


def _lead(search: FitSearch, ends: Sequence[Opening]) -> list[Opening]:
    """Return the likeliest ends by their costs, after more steps of a motion that is as fine as needed."""
    leaders = []
    for end in sorted(ends, key=lambda end: end.order)[:LIKELY]:
        end.enter(search)
        after = _open(search, search.solve(search.noise, STEPS).cost, end.held)
        if not after.lost:
            search.refine()
            after = _open(search, search.solve(search.noise, STEPS).cost)
        leaders.append(after)
    return sorted(leaders, key=lambda end: end.order)


def _forget_input(search: FitSearch, end: Opening) -> Opening:
    """Return the end without observations that depend on the input before the record, or the end if there are none."""
    end.enter(search)
    return _open(search, search.solve(search.noise, STEPS).cost) if search.forget_input() else end


def _find_constants(search: FitSearch, end: Opening) -> Opening:
    """Return the end with the best constants of its columns, which move until the cost stays."""
    for _ in range(STEPS if any(search.table[i].with_constant is not None for i in end.chosen) else 0):
        end.enter(search)
        search.move_constants()
        before, end = end, _end(search)
        if end.order > before.order - GAIN:
            return min(before, end, key=lambda one: one.order)
    return end


def _explain_any(search: FitSearch, ends: Sequence[Opening], failed: Opening | None = None) -> Intervals | None:
    """Return the likelihood of the intervals of the first set that explains every count, with further forces if
    needed. The first set has more tries, and one that `failed` before has none."""
    for place, end in enumerate(ends):
        if end is failed:
            continue
        end.enter(search)
        if not end.lost:
            search.refine()
        likelihood = search.explain(0 if place else TRIES)
        likelihood = _gather(search) if likelihood is None else likelihood
        if likelihood is not None:
            return likelihood
    return None


def _gather(search: FitSearch) -> Intervals | None:
    """Add and drop forces in the likelihood of the intervals until the motion explains every count, or no force gains.

    Next to rounding, least squares hardly tells two forces apart. The few counts beyond their intervals do.
    """
    before, seen = search.remember(), list[list[int]]()
    while (
        search.explains
        and not search.plain.machine.elastic
        and mean_square(search) < WITHIN
        and search.chosen not in seen
    ):
        likelihood = narrow_most(search)
        if likelihood.spread <= EXPLAINED:
            return likelihood
        seen.append(search.chosen)
        step = search.local(likelihood).best_step(search.chosen, range(len(search.table)))
        if step is None:
            break
        search.choose(step)
    search.return_to(before)
    return None
