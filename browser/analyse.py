"""The part of the page that runs in Python: read a log, suggest its columns, and identify the axis."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from pmfid.config.axis import Axis, read_axis
from pmfid.errors import PmfidError, UsageError
from pmfid.io import csv_text
from pmfid.io.reading import ENDINGS, READERS, format_of
from pmfid.io.safety import readable, unpack_file
from pmfid.io.tables import Table
from pmfid.pipeline.conclusion import conclude
from pmfid.pipeline.guess.axis_file import TO_DO, NamedColumns, guess_table, read_duration, read_gain, read_travel
from pmfid.pipeline.guess.columns import numeric
from pmfid.pipeline.identify import identify, kind_of
from pmfid.pipeline.kinds import Records, parameters_of
from pmfid.pipeline.result import Result, findings_lines, parameter_header, parameter_rows
from pmfid.units import OUTPUTS, column_unit

#: Most points of a curve in the figure.
POINTS = 1500
#: Formats whose readers need nothing but NumPy and SciPy.
FORMATS = (".csv", ".mat", ".npz", ".wpilog")
#: Keys that a person must answer if the log does not show them, because a neutral value would give a wrong mass.
UNTOLD = ("resolution", "input_gain", "dt")
log: dict[str, Any] = {"left_out": []}


def open_log(name: str, data: Any, columns: Any = None) -> str:
    """Read a log from its bytes, or take its `columns`. Returns its columns and an AXIS.toml as JSON."""
    log["left_out"] = []
    try:
        table = _read(name, bytes(data.to_py())) if columns is None else _arrays(columns.to_py())
        log.update(name=name, table=table)
        log["names"] = list(numeric(table))
    except PmfidError as error:
        return json.dumps({"problem": f"{name}: {error}"})
    return suggest()


def suggest(output: str | None = None) -> str:
    """Return the columns of the log and the AXIS.toml that they suggest, for a given column of the output."""
    log["axis"] = {}
    found: dict[str, Any] = {"columns": log["names"], "left_out": log["left_out"]}
    try:
        text = guess_table(log["table"], Path(log["name"]), None, NamedColumns(output=output)).text
        log["axis"] = tomllib.loads(text)
        for line in text.splitlines():
            key = line.partition(" = ")[0]
            if TO_DO in line and key in UNTOLD:
                found[key] = next(part.pop(key) for part in log["axis"].values() if key in part)
    except (UsageError, KeyError) as error:
        found["problem"] = str(error)
    return json.dumps(found | {"axis": log["axis"]})


def _read(name: str, data: bytes) -> Table:
    """Return the columns of a file. Raises UsageError for a format that the page cannot read."""
    suffix = Path(name).suffix.lower()
    kind = format_of(data) or ENDINGS.get(suffix, suffix)
    if kind not in FORMATS:
        raise UsageError(
            f"the page reads CSV, Parquet, MATLAB v5, NPZ and WPILOG, not {suffix or 'this'}; export as CSV"
        )
    if not data.strip():
        raise UsageError("the file is empty; export the record again")
    with readable(kind):
        return _read_text(data) if kind == ".csv" else READERS[kind](data)


def _read_text(data: bytes) -> Table:
    """Return the columns of numbers of a text, whose layout is that of `parse_csv`.

    Raises UsageError for a row with too many fields. `log` takes a note on each column that has other text.
    """
    text = csv_text.decode_text(unpack_file(data))
    layout = csv_text.layout_of(text.decode().split("\n")[: csv_text.LOOKED_AT])
    body = csv_text.strip_other_lines(text[csv_text.find_end_of_line(text, layout.first) :]).decode()
    rows = [csv_text.split(line, layout.separator) for line in body.split("\n") if line.strip()]
    width = len(layout.names)
    for number, row in enumerate(rows, 1):
        if len(row) > width:
            raise UsageError(f"row {number} has {len(row)} fields, and the columns are {width}; correct this row")
        row += [""] * (width - len(row))
    table: dict[str, object] = {}
    for name, cells in zip(layout.names, zip(*rows, strict=True), strict=True):
        try:
            table[name] = np.array([_number(cell, layout.decimal) for cell in cells])
        except ValueError as error:
            log["left_out"].append(f"{name} ({error})")
    return table


def _number(cell: str, decimal: str) -> float:
    return np.nan if cell in csv_text.MISSING else float(cell.replace(",", ".") if decimal == "," else cell)


def _arrays(columns: Mapping[str, Any]) -> Table:
    return {name: np.array(values, np.float64) for name, values in columns.items()}


def identify_log(answers: Any) -> str:
    """Return the result with the answers of the form as JSON, or the problem in one sentence."""
    try:
        axis, text = _axis(answers.to_py())
        kind = kind_of(axis)
        data = kind.read_table(log["table"], axis)
        return json.dumps(_describe(identify(data, axis), data, axis) | {"axis": text})
    except (PmfidError, ValueError) as error:
        return json.dumps({"problem": str(error)})


def _axis(answers: dict[str, str]) -> tuple[Axis, str]:
    """Return the configuration with the answers, and its text. Raises ValueError for an answer that cannot be used."""
    sections: dict[str, dict[str, Any]] = {name: dict(part) for name, part in log["axis"].items()}
    record, encoder, model, estimator = (
        sections.setdefault(name, {}) for name in ("record", "encoder", "model", "estimator")
    )
    record |= {key: answers[key] for key in ("input", "output", "output_kind")}
    _set_clock(record, answers)
    if len({answers["input"], answers["output"], answers["time"]}) < 3:
        raise ValueError("force, position and time must be different columns: correct one of them")
    _set_step(record, encoder, answers)
    size = answers["input_gain"].strip()
    gain = _plain(size.removeprefix("-"), read_gain)
    model["input_gain"] = gain if not size.startswith("-") else f"-{gain}" if isinstance(gain, str) else -gain
    model.pop("axis", None)
    if answers["axis"]:
        model["axis"] = answers["axis"]
    if answers["friction"]:
        model["friction"] = answers["friction"]
        model.pop("offset", None)  # the two directions contain it
    if answers["method"]:
        estimator["method"] = answers["method"]
    if answers["cutoff"].strip():
        estimator["cutoff"] = read_duration(answers["cutoff"])
    lines = (
        f"[{name}]\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in part.items())
        for name, part in sections.items() if part
    )  # fmt: skip
    return read_axis(sections), "\n".join(lines)  # type: ignore[arg-type]


def _set_clock(record: dict[str, Any], answers: dict[str, str]) -> None:
    """Set the time column or the sample period. Raises ValueError if neither is given."""
    if answers["time"] != record.get("time"):
        record.pop("time_unit", None)  # of the guessed column
    for key in ("time", "dt"):
        record.pop(key, None)
        if answers[key]:
            record[key] = read_duration(answers[key]) if key == "dt" else answers[key]
    if not record.keys() & {"time", "dt"}:
        raise ValueError("neither a time column nor a sample period is given: give one of them")


def _set_step(record: dict[str, Any], encoder: dict[str, Any], answers: dict[str, str]) -> None:
    """Set the encoder, and the unit of a column without one. Raises ValueError for a step that is no travel."""
    encoder["resolution"] = _plain(answers["resolution"], read_travel)
    record.pop("output_unit", None)
    unit = getattr(read_travel(answers["resolution"]), "unit", None)
    whole = answers["output_kind"] != "position" or "count" in answers["resolution"]
    if unit and not whole and column_unit(answers["output"], OUTPUTS) is None:
        record["output_unit"] = unit.name  # the column has the unit of its step
    encoder.pop("bits", None)
    if answers["bits"]:
        encoder["bits"] = int(answers["bits"])


def _plain(text: str, read: Any) -> float | str:
    """Return an answer as a number, or as the text with its unit. Raises ValueError for an answer that is neither."""
    value = read(text)
    return text.strip().replace(",", ".") if hasattr(value, "unit") else float(value)


def _describe(result: Result, data: Records, axis: Axis) -> dict[str, Any]:
    said = conclude(result)
    return {
        "sentence": said.sentence,
        "action": said.action,
        "status": result.status,
        "names": result.names,
        "theta": result.theta.tolist(),
        "theta_std": result.theta_std.tolist(),
        "header": _put_unit_second(parameter_header(result)),
        "rows": [_put_unit_second(row) for row in parameter_rows(result)],
        "findings": findings_lines(result, notes=False),
        "notes": findings_lines(result, notes=True),
        "figure": _curves(result, data, axis),
    }


def _put_unit_second(row: Sequence[str]) -> list[str]:
    """Return a row of the table with its unit next to the value, because a phone shows the first columns."""
    return [*row[:2], row[-1], *row[2:-1]]


def _curves(result: Result, data: Records, axis: Axis) -> dict[str, Any] | None:
    """Return the measured and the simulated motion, or None if the model cannot be simulated."""
    kind = kind_of(axis)
    chosen = axis.estimator.model_copy(update={"cutoff": result.estimator.cutoff})
    values = dict(zip(result.names, result.theta.tolist(), strict=True))
    with suppress(UsageError, KeyError):
        theta = np.array([values[name] for name in parameters_of(axis.model.make())[0]])
        run = kind.free_runs(data, axis.model_copy(update={"estimator": chosen}), theta)[0]
        every = slice(None, None, max(1, run.t.size // POINTS))
        curves = {"t": run.t, "measured": run.measured, "simulated": run.simulated, "error": run.error}
        return {"unit": kind.unit_of_output(axis)} | {name: part[every].tolist() for name, part in curves.items()}
    return None
