"""The AXIS.toml that a record suggests, each line with its reason."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pmfid.errors import UsageError
from pmfid.session.clock import UNITS, even_grid, named_unit
from pmfid.session.formats.reading import read_table
from pmfid.session.guess.columns import Pair, numeric, pair_of, time_of
from pmfid.session.guess.lattice import step_of
from pmfid.session.guess.names import ROTARY, role_of, spoken_unit
from pmfid.session.tables import Table
from pmfid.session.wrap import wrap_of
from pmfid.types import Floats

__all__ = ["Guess", "guess"]

#: Asks for a number that the record does not tell: the question and what is taken without an answer.
Ask = Callable[[str, str], str]

#: Sample periods that an axis has [s], from this up to that, and the most usual one.
SHORTEST, LONGEST, USUAL = 1e-5, 0.1, 1e-3
HEADING = """\
# {name}: guessed from the record by pmfid init. Each line says why; what is marked TO DO the record does not tell.
"""
TO_DO = "TO DO: "


@dataclass
class Guess:
    """Lines of an AXIS.toml, by section."""

    name: str
    sections: dict[str, list[str]] = field(default_factory=dict)

    def add(self, section: str, line: str, reason: str) -> None:
        self.sections.setdefault(section, []).append(f"{line}  # {reason}")

    @property
    def text(self) -> str:
        """The whole file."""
        parts = ["\n".join([f"[{name}]", *lines]) for name, lines in self.sections.items()]
        return "\n".join([HEADING.format(name=self.name), "\n\n".join(parts), ""])


def guess(path: Path, ask: Ask | None = None) -> Guess:
    """What a record suggests; ask: who is asked for what it does not tell. Raises UsageError where it cannot be read,
    or has not two columns of numbers."""
    table = read_table(path)
    columns = numeric(table)
    found, dt = _time(table, columns, ask)
    rest = {
        name: values
        for name, values in columns.items()
        if role_of(name) not in ("time", "number", "acceleration", "other") and name != (found or [""])[0]
    }
    pair = pair_of(rest, dt)
    if pair is None:
        listed = ", ".join(table) or "none"
        raise UsageError(f"{path}: no two columns can be input and output of an axis, of these: {listed}; name them")
    result = Guess(path.name)
    _record(result, pair, found, dt)
    _encoder(result, pair, columns[pair.output], ask)
    _model(result, pair, ask)
    return result


def _record(result: Guess, pair: Pair, found: tuple[str, str, str] | None, dt: float) -> None:
    result.add("record", f"input = {quoted(pair.input)}", pair.reason)
    result.add("record", f"output = {quoted(pair.output)}", _why(pair))
    result.add("record", f'output_kind = "{pair.kind}"', KINDS[pair.kind])
    if found is None:
        result.add("record", f"dt = {dt:g}", f"{TO_DO}no column is a time; the sample period in s")
        return
    name, unit, reason = found
    result.add("record", f"time = {quoted(name)}", f"it grows from row to row; a sample period of {dt:.6g} s")
    if unit:
        result.add("record", f'time_unit = "{unit}"', reason)


KINDS = {
    "counts": "nothing but whole numbers",
    "position": "it has parts of a whole number",
    "velocity": "the motion explains the input as a rate",
}


def _why(pair: Pair) -> str:
    said = role_of(pair.output)
    return f"its name says {said}" if said else "the input drives it"


def _time(table: Table, columns: Mapping[str, Floats], ask: Ask | None) -> tuple[tuple[str, str, str] | None, float]:
    """Name, unit and reason of the time column, and the sample period [s]."""
    found = time_of(table, columns)
    if found is None:
        answer = ask("sample period in s", "0.001") if ask else ""
        return None, _number(answer, USUAL)
    name, values, written = found
    mean, grid = even_grid(values)
    step = mean if grid else float(np.median(np.diff(values)))
    if written or named_unit(name):
        return (name, "", ""), step * (1.0 if written else UNITS[named_unit(name) or "s"])
    fitting = [unit for unit, length in UNITS.items() if SHORTEST <= step * length < LONGEST]
    if "s" in fitting or not fitting:
        return (name, "", ""), step
    unit = min(fitting, key=lambda one: abs(np.log(step * UNITS[one] / USUAL)))
    return (name, unit, f"it steps by {step:g}: in s no axis is sampled so"), step * UNITS[unit]


def _encoder(result: Guess, pair: Pair, output: Floats, ask: Ask | None) -> None:
    if pair.kind == "counts":
        answer = ask("travel per count, in m or rad (1: results in counts)", "1") if ask else ""
        told = "as told" if answer else f"{TO_DO}travel per count in m or rad; with 1 a length is in counts"
        result.add("encoder", f"resolution = {_number(answer, 1.0)!r}", told)
        wrap = wrap_of(output.astype(np.int64))
        if wrap is not None and wrap.bits is not None:
            result.add("encoder", f"bits = {wrap.bits}", f"the counter wraps, the first time at row {wrap.row}")
        return
    step, found = step_of(output)
    reason = "the smallest step of the column" if found else "the column has no steps: as fine as its numbers"
    result.add("encoder", f"resolution = {step!r}", reason)


def _model(result: Guess, pair: Pair, ask: Ask | None) -> None:
    unit = spoken_unit(pair.output)
    axis = f"a {'rotary' if unit.lower() in ROTARY else 'linear'} axis: {unit}" if unit else "mass and friction"
    result.add("model", 'kind = "drive"', axis)
    answer = ask("force or torque per unit of the input, in N or N m (1: results per unit of it)", "1") if ask else ""
    gain = _number(answer, 1.0)
    sign = "; negative, for the input drives against the output" if pair.turned else ""
    told = (
        "as told"
        if answer
        else f"{TO_DO}force in N or torque in N m per unit of the input; with 1 results are per unit"
    )
    result.add("model", f"input_gain = {-abs(gain) if pair.turned else gain!r}", told + sign)


def _number(answer: str, usual: float) -> float:
    """What was answered. Raises UsageError for what is no number above zero."""
    if not answer.strip():
        return usual
    try:
        value = float(answer.replace(",", "."))
    except ValueError:
        value = 0.0
    if not (np.isfinite(value) and value != 0):
        raise UsageError(f"{answer!r} is no number other than zero; write one like 0.25")
    return value


def quoted(name: str) -> str:
    """A name as TOML has it."""
    escaped = "".join(c if c.isprintable() and c not in '"\\' else f"\\u{ord(c):04x}" for c in name)
    return f'"{escaped}"'
