"""The table of forces that a model may lack. A new force is one row and its test."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from pmfid.fit.machine import DELAY, DIRECTIONAL, LAGGING, OFFSET, BodyForce
from pmfid.types import Floats

#: Units of the sizes on a linear axis, by the place among the body's parameters and by the kind of a force.
UNITS: dict[int | str, str] = {OFFSET: "N", DIRECTIONAL: "N s/m", DELAY: "s", LAGGING: "s"}
UNITS |= {"spring": "N/m", "column_viscous": "N s/m", "column": "of the input"}
#: Beginning of a remedy that is a line of [model].
SET = "set "


@dataclass(frozen=True, eq=False)
class ExtraForce:
    """A force that the model may lack, with a Gaussian prior of zero mean.

    `name` is its status word, `words` names it for people, and `remedy` says what to do. `sd` is the standard deviation
    of its size, in the unit of the size. Either `force` has its form, or `base` is the place of the size among the
    body's parameters. A `free` force has its constant, in units of `constant`, among the parameters. `lowest` is the
    lower bound of the size in units of `sd`. `column` makes the column of the record from its input. A `reading`
    has the period and the phase of an error of the encoder, in place of a force, and `late` means the time by which all
    edges are late. The constant of a column is a width of the input or a time: `with_constant` makes the candidate with
    another one, and `by_constant` makes the derivative of the column, which follows the column in the record. A `tied`
    force has the constant of the candidate before: sine and cosine have one period.
    """

    name: str
    words: str
    remedy: str
    sd: float
    base: int = -1
    force: BodyForce | None = None
    free: bool = False
    constant: float = 1.0
    lowest: float = -math.inf
    column: Callable[[Floats, Floats], Floats] | None = None
    reading: tuple[float, float] | None = None
    late: bool = False
    with_constant: Callable[[float], ExtraForce] | None = None
    by_constant: Callable[[Floats, Floats], Floats] | None = None
    tied: bool = False

    @property
    def forces(self) -> list[BodyForce]:
        """The force, and its derivative by the constant of its column if the constant is free."""
        if self.force is None:
            return []
        slope = [replace(self.force, column=self.force.column + 1)] if self.free and self.by_constant else []
        return [self.force, *slope]

    @property
    def columns(self) -> list[Callable[[Floats, Floats], Floats]]:
        """The makers of the column of the force and of its derivative by the constant."""
        return [make for make in (self.column, self.by_constant) if make is not None]

    @property
    def reads(self) -> bool:
        """Whether the candidate changes what is observed and not the motion."""
        return self.late or self.reading is not None

    def free_constant(self, before: ExtraForce | None) -> ExtraForce:
        """Return the candidate with its constant among the parameters, if it has one that the record may determine.
        The constant may be that of the candidate `before`."""
        if self.by_constant is not None:
            return replace(self, free=True)
        if self.with_constant is not None:
            tied = before is not None and before.free and before.words == self.words
            force = None if self.force is None else replace(self.force, free=True)
            return replace(self, free=not tied, tied=tied, force=force)
        if self.force is None or self.force.kind not in ("stribeck", "smooth", "load_stribeck"):
            return self
        return replace(self, free=True, constant=self.force.p, force=replace(self.force, free=True))

    @property
    def unit(self) -> str:
        """Unit of the size on a linear axis."""
        if self.reading is not None:
            return "m"
        return UNITS.get(self.base if self.force is None else self.force.kind, "N")

    @property
    def change(self) -> dict[str, object]:
        """The keys of [model] that the remedy sets, which may be none."""
        return tomllib.loads(self.remedy.removeprefix(SET)) if self.remedy.startswith(SET) else {}

    def describe(self, size: float) -> ExtraForce:
        """Return the candidate with words and remedy for a size [unit]. A dead time below zero is a late log."""
        if self.base != DELAY or size >= 0:
            return self
        words = f"an input that acts {-size:.3g} s before it is logged"
        return replace(self, words=words, remedy=f"shift the input's column earlier by {-size:.3g} s: the log is late")

    def place_on_masses(self) -> list[ExtraForce]:
        """Return the candidates for an elastic body, whose load gravity turns, and whose load may rub as the motor
        does."""
        if self.force is None or self.name not in ("gravity", "smooth"):
            return [self]
        loaded = replace(self, force=replace(self.force, load=True))
        return [loaded] if self.name == "gravity" else [self, replace(loaded, words=f"{self.words} on the load")]

    def place_column(self, column: int) -> ExtraForce:
        """Return the candidate with the number of the column that it makes, if it makes one."""
        if self.force is None or self.column is None:
            return self
        return replace(self, force=replace(self.force, column=column))


def free_constants(candidates: Sequence[ExtraForce], chosen: Sequence[int]) -> list[ExtraForce]:
    """Return the candidates, the chosen ones with their constants among the parameters."""
    freed = list[ExtraForce]()
    for i, one in enumerate(candidates):
        freed.append(one.free_constant(freed[-1] if freed else None) if i in chosen else one)
    return freed


@dataclass(frozen=True)
class Sizes:
    """Sizes of a record that scale the priors, in SI units: root mean square and largest force of the input, highest
    speed, Coulomb friction, viscous friction, half the travel, mean step, the time from start to end, whether the
    input has more than one size, the length of a turn or 0, the mean position, and the standard deviation of the
    column that friction follows, or 0."""

    force: float
    top_force: float
    speed: float
    coulomb: float
    viscous: float
    travel: float
    step: float
    time: float
    levels: bool
    turn: float
    middle: float
    warmth: float = 0.0


#: A row of the table: it yields its candidates for a record.
Row = Callable[[Sizes], Iterator[ExtraForce]]


def load(s: Sizes) -> Iterator[ExtraForce]:
    yield ExtraForce("offset", "a constant load", "set offset = true", 0.3 * s.force, base=OFFSET)


def directional(s: Sizes) -> Iterator[ExtraForce]:
    remedy = 'set friction = "directional"'
    yield ExtraForce("friction", "friction that differs by direction", remedy, 0.3 * s.viscous, base=DIRECTIONAL)


def dead_time(s: Sizes) -> Iterator[ExtraForce]:
    remedy = 'set dead_time = "estimate"'
    yield ExtraForce("dead_time", "a dead time of the input", remedy, s.step, base=DELAY)


def lag(s: Sizes) -> Iterator[ExtraForce]:
    yield ExtraForce("lag", "a lag of the input", 'set lag = "estimate"', s.step, base=LAGGING, lowest=0.0)


def stribeck(s: Sizes) -> Iterator[ExtraForce]:
    for share in (0.01, 0.03, 0.1, 0.2):
        force = BodyForce("stribeck", share * s.speed)
        remedy = 'set stribeck = "estimate"'
        yield ExtraForce("stribeck", "Stribeck friction", remedy, 0.4 * s.coulomb, force=force, lowest=0.0)


def smooth(s: Sizes) -> Iterator[ExtraForce]:
    """Yield what friction in proportion to tanh(v / p) has less than Coulomb friction. No key of [model] sets it."""
    for share in (0.003, 0.015, 0.07, 0.25):
        force = BodyForce("smooth", share * s.speed)
        yield ExtraForce("smooth", "friction that rises smoothly from rest", "", s.coulomb, force=force, lowest=0.0)


def quadratic(s: Sizes) -> Iterator[ExtraForce]:
    force = BodyForce("power", 2.0, s.speed)
    size, remedy = 0.3 * s.viscous * s.speed, "set quadratic = true"
    yield ExtraForce("quadratic", "quadratic friction", remedy, size, force=force, lowest=0.0)


def spring(s: Sizes) -> Iterator[ExtraForce]:
    """Yield a spring about the mean position, where a constant load of the machine stays the mean force."""
    force = BodyForce("spring", q=s.middle)
    yield ExtraForce("spring", "a force of the position", "set spring = true", 0.5 * s.force / s.travel, force=force)


def gravity(s: Sizes) -> Iterator[ExtraForce]:
    if s.turn:
        for phase in (0.0, math.pi / 2):
            force = BodyForce("wave", s.turn, phase)
            yield ExtraForce("gravity", "gravity on a rotary axis", "set gravity = true", 0.5 * s.force, force=force)


#: Longest time constant of friction that drifts, in times of the record.
LONGEST = 30.0
#: Errors of an encoder that repeat with its turn: number in a turn, words and remedy.
READINGS = ((1, "once a turn", "centre the disc of the encoder"), (2, "twice a turn", "align the disc of the encoder"))


def eccentric(s: Sizes) -> Iterator[ExtraForce]:
    """Yield the errors of a disc that is off its axis or tilted."""
    for number, often, remedy in READINGS if s.turn > 0 else ():
        for phase in (0.0, math.pi / 2):
            words = f"an error of the encoder {often}"
            yield ExtraForce("encoder", words, remedy, 0.003 * s.turn, reading=(s.turn / number, phase))


def drift(s: Sizes) -> Iterator[ExtraForce]:
    """Yield friction that falls or rises as an exponential of time while an axis warms up, about its mean."""
    for kind, size, lengths in (("column_friction", s.coulomb, (0.2, 1.0)), ("column_viscous", s.viscous, (0.5,))):
        for length in lengths:
            yield _drift(BodyForce(kind), 0.4 * size, length)


def _drift(force: BodyForce, size: float, length: float) -> ExtraForce:
    """Return friction along an exponential whose time constant is `length` times the time of the record. With
    `LONGEST` it is a line."""
    remedy = "record after the axis is warm, or identify shorter records"
    length = min(length, LONGEST)
    end = math.exp(-1 / length)

    def fall(u: Floats, t: Floats) -> Floats:
        return np.asarray(np.exp(-t / (t[-1] * length)) / (1 - end))

    def differentiate(u: Floats, t: Floats) -> Floats:
        return np.asarray(fall(u, t) * (t / t[-1] + end / (1 - end)) / length**2)

    return ExtraForce(
        "drift",
        "friction that drifts",
        remedy,
        size,
        force=force,
        column=_center(fall),
        constant=length,
        with_constant=partial(_drift, force, size),
        by_constant=_center(differentiate),
    )


def _center(of_time: Callable[[Floats, Floats], Floats]) -> Callable[[Floats, Floats], Floats]:
    """Return a column about its mean, so that the friction of the machine is the mean friction."""

    def column(u: Floats, t: Floats) -> Floats:
        h = of_time(u, t)
        return np.asarray(h - np.mean(h))

    return column


def warmth(s: Sizes) -> Iterator[ExtraForce]:
    """Yield the changes of friction with the first column of the record."""
    remedy = "compare parameters at the same temperature"
    for kind, size in (("column_friction", s.coulomb), ("column_viscous", s.viscous)) if s.warmth else ():
        words = "friction follows friction_temperature"
        yield ExtraForce("warmth", words, remedy, 0.4 * size / s.warmth, force=BodyForce(kind))


AMPLIFIER = "log the force or the current that the drive gives"


def bending(s: Sizes) -> Iterator[ExtraForce]:
    if s.levels:
        column = _column(lambda u: u * np.abs(u) / s.top_force)
        yield ExtraForce(
            "input_curve", "an input that bends", AMPLIFIER, 0.15, force=BodyForce("column"), column=column
        )


def dead_zone(s: Sizes) -> Iterator[ExtraForce]:
    yield from _widths("dead_zone", "a dead zone of the input", 1.0, s, (0.01, 0.03, 0.08))


def saturation(s: Sizes) -> Iterator[ExtraForce]:
    yield from _widths("saturated", "an input that saturates", -1.0, s, (0.9, 0.8, 0.65))


def _widths(name: str, words: str, side: float, s: Sizes, widths: Sequence[float]) -> Iterator[ExtraForce]:
    """Yield the part of the input within several widths, in units of the largest input. `side` is its sign.

    The part beyond a width is the part within it, with the other sign and another gain.
    """

    def make(width: float) -> ExtraForce:
        width = min(width, 1.0)
        top = width * s.top_force
        inside = _column(lambda u: side * np.clip(u, -top, top))
        edge = _column(lambda u: side * s.top_force * np.sign(u) * (np.abs(u) > top))
        return ExtraForce(
            name,
            words,
            AMPLIFIER,
            0.5,
            force=BodyForce("column"),
            column=inside,
            constant=width,
            with_constant=make,
            by_constant=edge,
        )

    if s.levels:
        yield from map(make, widths)


def _column(of_input: Callable[[Floats], Floats]) -> Callable[[Floats, Floats], Floats]:
    """Return a column modulo the gain: the gain of the input is the user's, and no record of one axis shows it."""

    def column(u: Floats, t: Floats) -> Floats:
        h = of_input(u)
        return np.asarray(h - u * float(h @ u) / max(float(u @ u), 1e-300))

    return column


TABLE: tuple[Row, ...] = (
    load,
    directional,
    dead_time,
    lag,
    stribeck,
    smooth,
    quadratic,
    spring,
    gravity,
    eccentric,
    drift,
    warmth,
    bending,
    dead_zone,
    saturation,
)


#: Effects that repeat along the travel: name, words and remedy, by the kind of the force; "" is an encoder's error.
WAVES = {
    "wave": ("cogging", "a force", 'set cogging = "{:.6g} {}"'),
    "rub": ("friction_period", "friction", 'set friction_period = "{:.6g} {}"'),
    "": (
        "encoder",
        "an error of the encoder",
        "check the mounting of the encoder: its disc is eccentric, or lines are off",
    ),
}


def waves(kind: str, period: float, size: float, unit: str) -> list[ExtraForce]:
    """Return the sine and the cosine of an effect of one kind of `WAVES` with a period [unit] along the travel."""
    name, what, remedy = WAVES[kind]
    words, remedy = f"{what} that repeats every {period:.4g} {unit} of travel", remedy.format(period, unit)
    moves = (lambda other: waves(kind, other, size, unit)[0], lambda other: waves(kind, other, size, unit)[1])
    candidates = []
    for phase, move in zip((0.0, math.pi / 2), moves, strict=True):
        form = {"force": BodyForce(kind, period, phase)} if kind else {"reading": (period, phase)}
        candidates.append(ExtraForce(name, words, remedy, size, constant=period, with_constant=move, **form))
    return candidates
