"""The AXIS.toml that a record suggests, with a reason for each line."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from pmfid.errors import UsageError, did_you_mean
from pmfid.findings import Finding
from pmfid.io.reading import read_table
from pmfid.io.tables import Table
from pmfid.pipeline.guess.columns import COLUMNS_EXACT, COLUMNS_FINE, first_axis, numeric, rounding_of, step_of
from pmfid.pipeline.guess.instants import Stamps, time_of
from pmfid.pipeline.guess.pairs import MOTION, Judgement, Pair, judge
from pmfid.pipeline.guess.roles import role_of
from pmfid.pipeline.guess.verdicts import describe_doubt, explain_refusal
from pmfid.records.clock import (
    LONGEST_PLAIN_PERIOD,
    SHORTEST_PLAIN_PERIOD,
    UNITS,
    drop_repeats,
    even_grid,
    is_rounded,
    named_unit,
)
from pmfid.records.outliers import wrap_of
from pmfid.types import Floats
from pmfid.units import INPUTS, OUTPUTS, SI, Quantity, Unit, column_unit, gain, quantity

#: Most common sample period of an axis [s].
AXIS_FILE_USUAL = 1e-3
#: A step of an angle is a rounded part of a turn if the counts of a turn are this close to a whole number.
WHOLE_TURN = 0.05

#: Reader of an answer. A reader raises ValueError with the remedy for an answer that cannot be used.
Reader = Callable[[str], float]
#: Callback that asks for a number that the record does not show. The arguments are the question and the reader of the
#: answer. The callback returns None without an answer.
Ask = Callable[[str, Reader], float | None]

HEADING = """\
# {name}: guessed from the record by pmfid init. Each line has its reason. Lines marked TO DO need you.
"""
TO_DO = "TO DO: "


@dataclass
class AxisGuess:
    """The lines of an AXIS.toml by section. `axes` is the column that names the axis of each row, if there is one."""

    name: str
    axes: str = ""
    sections: dict[str, list[str]] = field(default_factory=dict)

    def add(self, section: str, line: str, reason: str) -> None:
        self.sections.setdefault(section, []).append(f"{line}  # {reason}")

    @property
    def text(self) -> str:
        """The text of the whole file."""
        parts = ["\n".join([f"[{name}]", *lines]) for name, lines in self.sections.items()]
        return "\n".join([HEADING.format(name=self.name), "\n\n".join(parts), ""])


def find_to_do(path: Path) -> list[Finding]:
    """Return a note on the keys of an AXIS.toml that still have the mark TO DO. A file that is unreadable has none."""
    with suppress(OSError, UnicodeDecodeError):
        lines = path.read_text(encoding="utf-8-sig").splitlines()
        keys = [line.partition("=")[0].strip() for line in lines if TO_DO in line.partition("#")[2]]
        keys = [key for key in keys if key.isidentifier()]
        if keys:
            says = f"{path.name} still has the mark TO DO at {', '.join(keys)}"
            return [
                Finding(
                    "to_do",
                    says,
                    f"make sure that {path.name} has the right {' and '.join(keys)}, and delete each TO DO",
                    "note",
                )
            ]
    return []


@dataclass(frozen=True)
class NamedColumns:
    """The columns of time, input and output that the user names, or None for a guess."""

    time: str | None = None
    input: str | None = None
    output: str | None = None


GUESSED = NamedColumns()


def guess(path: Path, ask: Ask | None = None, choice: NamedColumns = GUESSED) -> AxisGuess:
    """Return the AXIS.toml that a record suggests.

    `ask` asks for numbers that the record does not show. `choice` has the columns that the user names.
    Raises UsageError if the record cannot be read, or if it does not show the input and the motion of an axis.
    """
    try:
        table = read_table(path)
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from None
    return guess_table(table, path, ask, choice)


def guess_table(table: Table, path: Path, ask: Ask | None = None, choice: NamedColumns = GUESSED) -> AxisGuess:
    """Return the AXIS.toml that the table of a file suggests. The arguments and errors are those of `guess`."""
    try:
        return _guess(table, path, ask, choice)
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from None


def _guess(table: Table, path: Path, ask: Ask | None, choice: NamedColumns) -> AxisGuess:
    columns = numeric(table)
    if not columns:
        raise UsageError("no column has numbers that change; export the record with its values")
    for name in (choice.input, choice.output):
        if name is not None and name not in columns:
            raise UsageError(f"the column {name!r} does not have numbers that change{did_you_mean(name, columns)}")
    if choice.time is not None and choice.time not in table:
        raise UsageError(f"there is no column {choice.time!r}{did_you_mean(choice.time, table)}")
    stamps = time_of(table, columns, choice.time)
    if stamps is not None and np.any(np.diff(stamps.values) <= 0) and (axis := first_axis(table, stamps.name)):
        rows, axes, text = axis
        return replace(_guess(rows, path, ask, choice), name=f"{path.name}, {text}", axes=axes)
    clock = _clock(_drop_repeats(stamps, columns), ask)
    rest = {
        name: values
        for name, values in columns.items()
        if name in (choice.input, choice.output) or not (name == clock.name or _is_clock(name, values))
    }
    judgement = judge(rest, clock.dt, choice.input, choice.output)
    pair = judgement.best if choice.input is None or choice.output is None else next(iter(judgement.pairs), None)
    if pair is None:
        raise UsageError(explain_refusal(judgement, rest, table))
    result = AxisGuess(path.name)
    _record(result, pair, judgement, clock, choice)
    travel = _encoder(result, pair, columns[pair.output], clock.dt, ask)
    _model(result, pair, travel, ask)
    _load(result, pair, ask)
    return result


def _is_clock(name: str, values: Floats) -> bool:
    """Return whether a column is a further time or number, because it grows in every row or has such a name."""
    return role_of(name) in ("time", "number") or bool(np.all(np.diff(values) > 0)) or is_rounded(values)


@dataclass(frozen=True)
class GuessedClock:
    """The time column, which has an empty name if there is none, its unit with the reason, and the sample period
    [s].
    """

    name: str
    unit: str
    reason: str
    dt: float


def _record(result: AxisGuess, pair: Pair, judgement: Judgement, clock: GuessedClock, choice: NamedColumns) -> None:
    doubt, role = describe_doubt(pair, judgement), role_of(pair.output)
    for key, name, chosen, why in (
        ("input", pair.input, choice.input, _why_input(pair, judgement)),
        ("output", pair.output, choice.output, f"its name says {role}" if role in MOTION else "the input drives it"),
    ):
        reason = "as given" if chosen else f"{TO_DO}check this column; {doubt}" if doubt else why
        result.add("record", f"{key} = {quote_name(name)}", reason)
    result.add("record", f'output_kind = "{pair.kind}"', KINDS[pair.kind])
    if not clock.name:
        result.add("record", f"dt = {clock.dt:g}", clock.reason)
        return
    result.add(
        "record",
        f"time = {quote_name(clock.name)}",
        f"it grows from row to row, by a sample period of {clock.dt:.6g} s",
    )
    if clock.unit:
        result.add("record", f'time_unit = "{clock.unit}"', clock.reason)


KINDS = {
    "counts": "the column has only whole numbers",
    "position": "the column has a unit or fractions",
    "velocity": "the motion explains the input as a rate",
}


def _why_input(pair: Pair, judgement: Judgement) -> str:
    others = [
        f"{100 * one.explained:.3g} % of {one.input} by {one.output}" for one in judgement.pairs if one is not pair
    ]
    further = f"; other pairs: {', '.join(others[:3])}" if others else ""
    return f"the motion of {pair.output} explains it to {100 * pair.explained:.3g} %{further}"


def _drop_repeats(stamps: Stamps | None, columns: Mapping[str, Floats]) -> Stamps | None:
    """Return the stamps without rows that the log has twice. Topics have rows of their own and are left alone."""
    if stamps is None or any(values.size <= stamps.rows[-1] for values in columns.values()):
        return stamps
    again = np.all([np.diff(values[stamps.rows], prepend=np.nan) == 0 for values in columns.values()], axis=0)
    rows, _ = drop_repeats(stamps.values, again, np.arange(stamps.rows.size))
    return replace(stamps, values=stamps.values[rows], rows=stamps.rows[rows])


def _clock(stamps: Stamps | None, ask: Ask | None) -> GuessedClock:
    """Return the clock of a time column, or of the sample period that the user gives."""
    if stamps is None or stamps.may_be_numbers:
        answer = ask('sample period, in s or as "1 ms"', read_duration) if ask else None
        untold = f"{TO_DO}write the sample period in s, because no column has the time"
        return GuessedClock("", "", untold if answer is None else "as answered", answer or AXIS_FILE_USUAL)
    name, values = stamps.name, stamps.values
    mean, grid = even_grid(values)
    steps = np.diff(values)
    step = mean if grid else float(np.mean(np.minimum(steps, np.quantile(steps, 0.9))))  # without gaps
    if np.any(np.diff(values) < 0) or not step > 0:
        row = int(stamps.rows[np.argmax(np.diff(values) < 0)]) + 1
        raise UsageError(
            f"the time {name!r} falls after row {row}: keep only the rows up to this one, or name another column with "
            "--time"
        )
    unit = named_unit(name)
    if stamps.written or unit:
        return GuessedClock(name, "", "", step * (1.0 if stamps.written else UNITS[unit or "s"]))
    fitting = [unit for unit, length in UNITS.items() if SHORTEST_PLAIN_PERIOD <= step * length <= LONGEST_PLAIN_PERIOD]
    if "s" in fitting or not fitting:
        return GuessedClock(name, "", "", step)
    unit = min(fitting, key=lambda one: abs(np.log(step * UNITS[one] / AXIS_FILE_USUAL)))
    reason = (
        f"{TO_DO}check this unit, because a step of {step:g} s is unusual; ticks of a clock are none of these units"
    )
    return GuessedClock(name, unit, reason, step * UNITS[unit])


def _encoder(result: AxisGuess, pair: Pair, output: Floats, dt: float, ask: Ask | None) -> Unit | None:
    """Add the section [encoder], and return the unit of the output, or None if neither column nor user has one."""
    wrap = wrap_of(output.astype(np.int64)) if pair.kind == "counts" else None
    if pair.kind == "counts":
        question = 'travel per count, in m or rad, or as "0.01 mm" or "2000 counts/rev"'
        answer = ask(question, read_travel) if ask else None
        step = 1.0 if answer is None else answer
        reason = f"{TO_DO}travel per count in m or rad; with 1 a length is in counts"
        result.add("encoder", f"resolution = {_format_answer(step)}", reason if answer is None else "as answered")
        if wrap is not None and wrap.bits is not None:
            result.add("encoder", f"bits = {wrap.bits}", f"the counter wraps, the first time at row {wrap.row}")
        elif wrap is not None:
            size = float(step) * wrap.span
            result.add("encoder", f"range = {size!r}", f"it wraps, the first time at row {wrap.row}")
        return step.unit if isinstance(step, Quantity) else None
    step, found = step_of(output)
    if pair.kind == "velocity" and found and abs(step / max(rounding_of(output), 1e-300) - 1) < COLUMNS_EXACT:
        step, found = float(np.ptp(output)) / COLUMNS_FINE, False  # the step is a digit of the log
    reason = "the smallest step of the column" if found else "the column has no steps: as fine as its numbers"
    unit = column_unit(pair.output, OUTPUTS)
    if unit is None:
        other = f'write "{step:.9g} mm" here and output_unit = "mm" in [record], or "deg" in both'
        reason = f"{TO_DO}assumed to be in m or rad; otherwise {other}; {reason}"
    if pair.kind == "velocity":
        step, reason = step * dt * (unit.factor if unit else 1.0), f"{reason}, times the sample period"
        unit = None if unit is None or unit.plain else Unit("rad" if "ang" in unit.of else "m", "travel", 0.0)
    turn = _count_turn(step, unit) if found and pair.kind == "position" else None
    if turn is not None and unit is not None:
        reason = f"{reason}, {step:.5g} {unit.name}"
        step = 2 * np.pi / turn / unit.factor
    result.add("encoder", "resolution = " + (f'"{turn} counts/rev"' if turn else _format_number(step, unit)), reason)
    wrap = wrap_of(np.floor(output / step + 0.5).astype(np.int64)) if found and pair.kind == "position" else None
    if wrap is not None:
        size = float(f"{wrap.span * step:.9g}")
        result.add("encoder", f"range = {_format_number(size, unit)}", f"it wraps, the first time at row {wrap.row}")
    return column_unit(pair.output, OUTPUTS)


def _count_turn(step: float, unit: Unit | None) -> int | None:
    """Return the counts of a turn if the step of an angle is a whole part of it that the column has rounded."""
    if unit is None or "ang" not in unit.of or f"{step:.4g}" == f"{step:.9g}":
        return None
    counts = 2 * np.pi / (step * unit.factor)
    whole = round(counts)
    return whole if abs(counts - whole) < WHOLE_TURN else None


def _format_number(value: float, unit: Unit | None) -> str:
    """Return a number in TOML, with its unit if that is not the SI unit."""
    return repr(value) if unit is None or unit.plain else f'"{value:.12g} {unit.name}"'


def _model(result: AxisGuess, pair: Pair, travel: Unit | None, ask: Ask | None) -> None:
    result.add("model", 'kind = "drive"', "mass and friction")
    rotary = pair.gravity or (travel is not None and "ang" in travel.of)
    if rotary:
        reason = (
            f"{pair.output} is in {travel.name}" if travel else ("a force with the sine of the position suits an angle")
        )
        result.add("model", 'axis = "rotary"', reason)
    if pair.gravity:
        reason = "the sine of the angle explains a part of the input; false for an axis without gravity"
        result.add("model", "gravity = true", reason)
    unit = column_unit(pair.input, INPUTS)
    force = "N m" if rotary else "N"
    if unit is not None and unit.of in ("force", "torque"):
        own = -1.0 if pair.turned else 1.0
        written = repr(own) if unit.plain else f'"{own:g} {SI[unit.of]}/{SI[unit.of]}"'
        result.add("model", f"input_gain = {written}", f"the input is a {unit.of}{_sign(pair)}")
        return
    base = "" if unit is None else unit.name if unit.of == "ratio" else SI[unit.of]
    per = f"per {base or 'unit'} of"
    example = f"{'0.42' if force == 'N m' else '55'} {force}/{base or 'A'}"
    question = f'force or torque {per} the input, in N or N m, or as "{example}"'
    usual = Unit(f"{force}/{SI[unit.of] if unit else ''}", "torque" if rotary else "force" if travel else "", 1.0)
    answer = ask(question, lambda text: read_gain(text, usual)) if ask else None
    reason = f"{TO_DO}force or torque {per} the input; with 1 results are {per} it"
    value = 1.0 if answer is None else answer
    if not isinstance(value, Quantity) and unit is not None and not unit.plain and unit.of != "ratio":
        value = Quantity(value, Unit(f"{force}/{base}", "gain", 1.0))
    written = _format_answer(value, pair.turned)
    result.add("model", f"input_gain = {written}", (reason if answer is None else "as answered") + _sign(pair))


def _load(result: AxisGuess, pair: Pair, ask: Ask | None) -> None:
    loaded = ask("does a constant load act, such as the weight of a vertical axis? y or n", read_yes) if ask else None
    if loaded is not None:
        result.add("model", f"offset = {'true' if loaded else 'false'}", "as answered")
    elif pair.load:
        result.add("model", "offset = true", "a constant load, or friction that differs with the direction, is seen")
    elif not pair.gravity:
        result.add("model", "offset = false", "no constant load is seen; true for a vertical axis")


def _sign(pair: Pair) -> str:
    return "; negative, because the input drives against the output" if pair.turned else ""


def read_duration(text: str) -> float:
    """Return a positive time [s] from a number, or from a number with a unit of time. Raises ValueError otherwise."""
    number, _, unit = text.strip().partition(" ")
    if unit.strip() not in ("", *UNITS):
        raise ValueError(f"{unit.strip()!r} is not a known unit of time; use one of {', '.join(UNITS)}")
    if _number(number) < 0:
        raise ValueError(f"{text!r} is negative; write a time like 0.001")
    return _number(number) * UNITS[unit.strip() or "s"]


def read_yes(text: str) -> float:
    """Return 1.0 for yes and 0.0 for no. Raises ValueError for any other answer."""
    if text.strip().lower() not in ("y", "yes", "n", "no"):
        raise ValueError(f"{text!r} is neither y nor n")
    return float(text.strip().lower().startswith("y"))


def read_travel(text: str) -> float:
    """Return a positive travel from a number in SI, or from a number with a unit. Raises ValueError otherwise."""
    value = _read(text, quantity)
    if isinstance(value, Quantity) and value.unit.of not in ("length", "angle"):
        raise ValueError(f'{text!r} is a {value.unit.of}, and a travel is a length or an angle, as "0.01 mm"')
    if value < 0:
        raise ValueError(f"{text!r} is negative; the sign of the motion belongs to input_gain")
    return value


def read_gain(text: str, usual: Unit | None = None) -> float:
    """Return a positive gain from a number in SI, or from a number with a unit. Raises ValueError otherwise.

    `usual` is the unit of the answer as far as the columns determine it, with "force", "torque" or nothing as `of`.
    """
    value = _read(text, gain)
    if value < 0:
        raise ValueError(f"{text!r} is negative; give the size only, because the record shows the sign")
    if isinstance(value, Quantity) and usual is not None:
        own, per = value.unit.of.partition("/")[::2]
        if usual.of not in ("", own) or usual.name.partition("/")[2] not in ("", SI[per]):
            raise ValueError(f"{text!r} does not fit these columns: give the gain in {usual.name}")
    return value


def _read(text: str, read: Callable[[object], object]) -> float:
    value = _number(text) if re.fullmatch(r"[\d.,eE+\s-]+", text) else read(text.replace(",", "."))
    if not isinstance(value, float) or value == 0:
        raise ValueError(f"{text!r} is not a number; write one like 0.25, with a unit if it is not in SI")
    return value


def _number(text: str) -> float:
    try:
        value = float(text.replace(",", "."))
    except ValueError:
        value = 0.0
    if not (np.isfinite(value) and value != 0):
        raise ValueError(f"{text!r} is zero or not finite; write a number like 0.25")
    return value


def _format_answer(value: float, turned: bool = False) -> str:
    """Return an answer as TOML, which is a number, or a text with number and unit.

    `turned` makes the number negative.
    """
    unit = value.unit if isinstance(value, Quantity) else None
    number = (-float(value) if turned else float(value)) / (unit.factor if unit else 1.0)
    if unit is not None and unit.name in ("rev", "turn") and abs(1 / number - round(1 / number)) < 1e-6:
        return f'"{round(1 / number)} counts/{unit.name}"'
    return repr(number) if unit is None else f'"{number:.12g} {unit.name}"'


def quote_name(name: str) -> str:
    """Return a name as a TOML string."""
    escaped = "".join(c if c.isprintable() and c not in '"\\' else f"\\u{ord(c):04x}" for c in name)
    return f'"{escaped}"'
