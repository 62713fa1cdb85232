"""Writers of the four kinds of loggers: oscilloscope, serial monitor, controller and MATLAB."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import scipy.io

from pmfid.types import Floats

Columns = Mapping[str, Floats]


def write_scope(path: Path, columns: Columns, header: bool) -> Path:
    """Write the CSV of an oscilloscope: commas, 6 digits, and a preamble before the header."""
    lines = ["Model,DSO-2014", "Record Length,2400", ""] if header else []
    return _write(path.with_suffix(".csv"), columns, header, ",", lambda value: f"{value:.7g}", lines)


def write_serial(path: Path, columns: Columns, header: bool) -> Path:
    """Write the text of a serial monitor: tabs, whole numbers as such, four decimals otherwise, and a stray line."""
    path = _write(path.with_suffix(".txt"), columns, header, "\t", _of_serial, ["Axis ready." if header else ""])
    lines = path.read_text(encoding="utf-8").splitlines()
    lines.insert(900, "[wifi] reconnected, status #: 6")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def _of_serial(value: float) -> str:
    return str(int(value)) if value == int(value) else f"{value:.4f}"


def write_controller(path: Path, columns: Columns, header: bool) -> Path:
    """Write the export of a controller: semicolons and decimal commas."""
    return _write(
        path.with_suffix(".csv"), columns, header, ";", lambda value: f"{value:.9g}".replace(".", ","), [], "cp1252"
    )


def write_matlab(path: Path, columns: Columns, header: bool) -> Path:
    """Write a .mat file with a variable for each column, or with one matrix without names."""
    matrix = np.column_stack(list(columns.values()))
    variables = {name: values[:, None] for name, values in columns.items()} if header else {"data": matrix}
    scipy.io.savemat(path.with_suffix(".mat"), variables)
    return path.with_suffix(".mat")


def _write(path, columns, header, mark, form, preamble, encoding="utf-8"):  # type: ignore[no-untyped-def]
    rows = zip(*(values.tolist() for values in columns.values()), strict=True)
    lines = [*preamble, *([mark.join(columns)] if header else []), *(mark.join(map(form, row)) for row in rows)]
    path.write_text("\n".join(line for line in lines if line) + "\n", encoding=encoding)
    return path


WRITERS = {"scope": write_scope, "serial": write_serial, "controller": write_controller, "matlab": write_matlab}
