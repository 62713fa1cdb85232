"""The choice of input and output: one judgement of names, relations and motion for each pair of columns."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from pmfid.encoder import Encoder, fine_counts
from pmfid.estimators.known import CONTRADICTED
from pmfid.estimators.stretches import liveliest
from pmfid.pipeline.checks.readings import READINGS_CERTAIN, READINGS_TURNED, is_turned
from pmfid.pipeline.checks.view import MASS, ONE_WAY, PLAIN, VIEW_MOST_SAMPLES, View, best_view, solve_least_squares
from pmfid.pipeline.guess.columns import is_whole, step_of
from pmfid.pipeline.guess.relations import RELATIONS_COPY, Likeness, compare, is_rate, jumps
from pmfid.pipeline.guess.roles import (
    PAIRS_CERTAIN,
    PAIRS_CLEAR,
    PAIRS_COMPUTED,
    PAIRS_NOTHING,
    NameEvidence,
    Role,
    evidence_of,
    number_of,
    role_of,
)
from pmfid.records.outliers import wrap_of
from pmfid.records.travel import integrate_velocity
from pmfid.types import Floats
from pmfid.units import OUTPUTS, Unit, column_unit

#: Weight of the logarithm of the unexplained part, which is at least `PAIRS_LEAST`. Unmodelled friction leaves more
#: of the input unexplained than noise does, so that the power of the rows counts for no more than two rows.
PAIRS_MOTION = 2.0
PAIRS_LEAST = 0.02
#: Weight of a relation that no input and output have.
PAIRS_RELATION = 10.0
#: Largest number of tried pairs of an input and an output.
MOST_PAIRS = 36
#: Greatest ratio of the part of the input that a pendulum leaves unexplained to the part that a plain drive leaves.
#: A pendulum without gravity costs little, because its gravity is then estimated as zero.
HANGING_BETTER = 0.8
#: Largest travel of a pendulum whose angle has no unit [rad]. A column with a larger travel is not the angle of a
#: pendulum.
MOST_TURNED = 1000.0

#: Roles of an output.
MOTION: tuple[Role, ...] = ("counts", "position", "velocity")


@dataclass(frozen=True, eq=False)
class Pair:
    """Input and output by name.

    `kind` is "counts", "position" or "velocity". `turned` says whether the input drives against the output. `explained`
    is the part of the input that the motion explains. `gravity` says whether a force in the sine of the angle explains
    the input much better, and `load` whether a constant load does. `score` is the logarithm of the odds of this pair,
    up to a common constant. `against` is a relation between the columns that speaks against the pair.
    """

    input: str
    output: str
    kind: str
    turned: bool
    explained: float
    gravity: bool = False
    load: bool = False
    score: float = 0.0
    against: str = ""


@dataclass(frozen=True)
class Judgement:
    """The pairs of a log, the likeliest first, and the columns that cannot be an output, with the reason.

    `likely` is the probability of the first pair and its copies, and `rival` is the best pair that is no copy.
    """

    pairs: tuple[Pair, ...]
    likely: float
    rival: Pair | None
    excluded: dict[str, str]

    @property
    def best(self) -> Pair | None:
        """The likeliest pair, or None if no pair is likelier than a log without an axis."""
        return self.pairs[0] if self.pairs and self.pairs[0].score > PAIRS_NOTHING else None


def judge(
    columns: Mapping[str, Floats], dt: float, chosen_input: str | None = None, chosen_output: str | None = None
) -> Judgement:
    """Return the pairs of input and output among the columns (n,) with a sample period dt [s].

    The score of a pair adds the evidence of the names, the motion that explains the input, and relations of the columns
    that no input and output have. `chosen_input` and `chosen_output` are columns that the user names.
    """
    excluded = {name: reason for name in columns if (reason := _why_no_output(name)) and name != chosen_output}
    outputs = [chosen_output] if chosen_output else [name for name in columns if name not in excluded]
    inputs = [chosen_input] if chosen_input else [name for name in columns if _may_drive(name)]
    moved = {name: _undo_wrap(columns[name]) for name in outputs if role_of(name) != "velocity"}
    columns = {**columns, **moved}
    outputs = [name for name in outputs if chosen_output or _travels(name, outputs, columns)]
    pairs = [(u, y) for y in outputs for u in inputs if u != y and columns[u].size == columns[y].size]
    weights = {pair: _name_weight(*pair, chosen_input, chosen_output) for pair in pairs}
    pairs = sorted(pairs, key=lambda pair: -weights[pair])[:MOST_PAIRS]
    motions = list(dict.fromkeys(y for _, y in pairs))
    tried = [
        replace(pair, score=pair.score + weights[u, y] - _output_penalty(y, motions, columns))
        for u, y in pairs
        if (pair := _try_pair({u: columns[u], y: columns[y]}, u, y, dt))
    ]
    tried.sort(key=lambda pair: -pair.score)
    likely, rival = _weigh_rivals(tried, columns)
    return Judgement(tuple(tried), 1.0 if chosen_input and chosen_output else likely, rival, excluded)


def _weigh_rivals(tried: list[Pair], columns: Mapping[str, Floats]) -> tuple[float, Pair | None]:
    """Return the probability of the first pair and of its copies, and the best pair that is no copy.

    The alternative to all pairs is a log without an axis. A pair of another joint is another axis of the log, and no
    alternative.
    """
    if not tried:
        return 1.0, None
    rivals = [pair for pair in tried if not _other_joint(tried[0], pair)]
    scores = np.array([PAIRS_NOTHING, *(pair.score for pair in rivals)])
    odds = np.exp(scores - scores.max())
    same = np.array([False, *(_is_copy(tried[0], pair, columns) for pair in rivals)])
    others = [pair for pair, copy in zip(rivals, same[1:], strict=True) if not copy]
    return float(odds[same].sum() / odds.sum()), next(iter(others), None)


def _other_joint(best: Pair, other: Pair) -> bool:
    """Return whether two pairs belong to joints with different numbers."""
    numbers = [{number_of(pair.input), number_of(pair.output)} for pair in (best, other)]
    return all(len(joint) == 1 and "" not in joint for joint in numbers) and numbers[0] != numbers[1]


def _is_copy(best: Pair, other: Pair, columns: Mapping[str, Floats]) -> bool:
    """Return whether two pairs have the same input and output, or copies of them, or the velocity of the output."""
    if best.score - other.score > PAIRS_CERTAIN:
        return best is other
    driving = best.input == other.input or _compare(columns[best.input], columns[other.input]).alike
    moving = best.output == other.output or _compare(columns[best.output], columns[other.output]).alike
    return driving and (moving or _is_rate(columns[other.output], columns[best.output]))


def _compare(first: Floats, second: Floats) -> Likeness:
    part = liveliest(second, VIEW_MOST_SAMPLES)
    return compare(first[part], second[part])


def _why_no_output(name: str) -> str:
    """Return the reason by its name why a column is no measured motion, or an empty text."""
    evidence = evidence_of(name)
    if evidence.commanded and evidence.role == "other":
        return "a set point"
    clear = evidence.lean(*MOTION) <= -PAIRS_NOTHING
    return {"input": "an input", "other": "another quantity", "acceleration": "an acceleration"}.get(
        evidence.role if clear else "", ""
    )


def _may_drive(name: str) -> bool:
    """Return whether a column may be an input by its name."""
    evidence = evidence_of(name)
    return evidence.role not in ("other", "acceleration", "time") or evidence.lean("input") > -PAIRS_NOTHING


def _travels(name: str, outputs: list[str], columns: Mapping[str, Floats]) -> bool:
    """Return whether a joint travels, compared with the joints of the same name."""
    stem = re.sub(r"\d+", "", name) if role_of(name) else name
    alike = [other for other in outputs if role_of(other) and re.sub(r"\d+", "", other) == stem]
    most = max((float(np.ptp(columns[other])) for other in alike), default=0.0)
    return float(np.ptp(columns[name])) > ONE_WAY * most


def _name_weight(u: str, y: str, chosen_input: str | None, chosen_output: str | None) -> float:
    """Return the log-odds by their names that two columns are input and output of one axis."""
    driving, moving = evidence_of(u), evidence_of(y)
    weight = _bound(driving.lean("input") if u != chosen_input else np.inf)
    weight += _bound(moving.lean(*MOTION) if y != chosen_output else np.inf)
    weight -= PAIRS_COMPUTED * (driving.changed + moving.changed + 2 * driving.commanded)
    numbers = number_of(u), number_of(y)
    both_named = driving.role == "input" and moving.role in MOTION and all(numbers)
    return weight - PAIRS_RELATION * (both_named and numbers[0] != numbers[1])


def _bound(lean: float) -> float:
    """Return a log-odds by a name within the limits of a clear name, because any name may be wrong."""
    return float(np.clip(lean, -PAIRS_CLEAR, PAIRS_CLEAR))


def _output_penalty(y: str, motions: list[str], columns: Mapping[str, Floats]) -> float:
    """Return the penalty for an output that jumps and whose name is no motion, or that is the velocity of another
    output of the log.
    """
    others = [name for name in motions if name != y and columns[name].size == columns[y].size]
    unnamed = evidence_of(y).lean(*MOTION) < 1
    joint = [name for name in others if role_of(y) == "velocity" and number_of(name) == number_of(y)]
    named = [name for name in joint if role_of(name) in ("counts", "position")]
    rates = (name in named or _is_rate(columns[y], columns[name]) for name in others if not jumps(columns[name]))
    return PAIRS_RELATION if (unnamed and jumps(columns[y])) or any(rates) else 0.0


def _is_rate(rate: Floats, motion: Floats) -> bool:
    part = liveliest(motion, VIEW_MOST_SAMPLES)
    return is_rate(rate[part], motion[part])


def _relations(u: Floats, y: Floats, velocity: bool) -> str:
    """Return the relation of two columns (n,) that an input and an output of a machine do not have, or nothing."""
    likeness = _compare(u, y)
    if likeness.alike and abs(likeness.shift) <= 1:
        return f"both columns are one quantity, equal to {100 * likeness.left:.2g} %"
    if float(np.std(u)) < RELATIONS_COPY * abs(float(np.mean(u))):
        return "the first column is nearly constant"
    if likeness.set_point:
        return f"the gain from one column to the other is {likeness.gain:.2f}, as from a set point"
    if _is_rate(y, u):
        return "the second column is the rate of the first"
    if not velocity and _is_rate(u, y):
        return "the first column is the rate of the second"
    return ""


def _try_pair(columns: Mapping[str, Floats], u: str, y: str, dt: float) -> Pair | None:
    """Return a pair of columns under its best reading, with the evidence of its motion."""
    unit, role = column_unit(y, OUTPUTS), role_of(y)
    kinds = _kinds(evidence_of(y), unit)
    views = [(kind, _view(columns[u], columns[y], kind, dt)) for kind in kinds]
    seen = [(kind, view) for kind, view in views if view is not None]
    if not seen:
        against = _relations(columns[u], columns[y], role == "velocity")
        return _weigh(Pair(u, y, _whole(y, columns[y], kinds[0]), False, 0.0, against=against), 1.0)
    # The mass of a reading that agrees with the name need not be significant.
    kind, view = min(seen, key=lambda pair: pair[1].unexplained if pair[0] == role else _cost(pair[1]))
    against = _relations(columns[u], columns[y], kind == "velocity") or _pure_mass(view)
    left, gravity = _cost(view), False
    if kind != "velocity" and (hanging := _view_pendulum(columns[u], columns[y], unit, dt, view.unexplained)):
        left, gravity = hanging.unexplained if role in MOTION else _cost(hanging), True
    load = view.shows_load(HANGING_BETTER, CONTRADICTED) and not gravity
    kind = kind if kind == "velocity" else _whole(y, columns[y], kind)
    pair = Pair(u, y, kind, is_turned(view), max(0.0, 1 - left), gravity=gravity, load=load, against=against)
    return _weigh(pair, left)


def _weigh(pair: Pair, left: float) -> Pair:
    """Return a pair with the evidence of its motion, where `left` is the part of the input that is not explained."""
    score = -PAIRS_MOTION * float(np.log(max(left, PAIRS_LEAST)))
    score -= PAIRS_RELATION * bool(pair.against)
    return replace(pair, score=score)


def _pure_mass(view: View) -> str:
    """Return a text if the input is only the acceleration of the output, which has no friction."""
    column = view.phi[:, MASS : MASS + 1]
    rest = view.z - column @ solve_least_squares(column, view.z)
    left = float(np.linalg.norm(rest) / np.linalg.norm(view.z))
    return "the first column is the acceleration of the second" if left < RELATIONS_COPY else ""


def _view_pendulum(u: Floats, y: Floats, unit: Unit | None, dt: float, plain: float) -> View | None:
    """Return the view with gravity in the sine of the output, if gravity explains much of the input u (n,) that a plain
    drive leaves unexplained.

    Gravity must also explain more than a spring does. `plain` is the part of the input that the drive leaves. The
    result is None if the output y (n,) is no angle or turns little.
    """
    angle = y * (unit.factor if unit else 1.0)
    if is_whole(y) if unit is None else unit.of != "angle":
        return None
    if not READINGS_TURNED < np.ptp(angle) < MOST_TURNED:
        return None
    encoder, counts = fine_counts(angle)
    part = liveliest(counts, VIEW_MOST_SAMPLES)
    forms = (replace(PLAIN, gravity=True), replace(PLAIN, spring=True))
    hanging, sprung = (best_view(u[part], counts[part], encoder, dt, model=form) for form in forms)
    if hanging is None or hanging.unexplained > HANGING_BETTER * plain:
        return None
    return hanging if sprung is None or hanging.unexplained < sprung.unexplained else None


def _kinds(evidence: NameEvidence, unit: Unit | None) -> tuple[str, ...]:
    """Return the possible kinds of an output, from a clear name or the unit in its name."""
    if evidence.role == "velocity":
        return ("velocity",)
    clear = evidence.weights.get("position", 0.0) >= PAIRS_CLEAR
    travel = evidence.role == "counts" or clear or (unit is not None and unit.of in ("length", "angle"))
    return ("position",) if travel else ("position", "velocity")


def _cost(view: View) -> float:
    """Return the unexplained part of a reading, or 1 without a significant mass. A velocity would always explain
    its own column.
    """
    return view.unexplained if abs(view.sure(np.eye(view.theta.size)[MASS])) > READINGS_CERTAIN else 1.0


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
    part = liveliest(counts, VIEW_MOST_SAMPLES)
    return best_view(u[part], counts[part], encoder, dt)
