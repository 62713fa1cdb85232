"""An addition at the place that docs/extending.md names reaches all other places, or a test says which not."""

from __future__ import annotations

import json
import re
from dataclasses import fields
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

import pmfid
from pmfid.cli.main import identify
from pmfid.config.axis import Axis, load_axis
from pmfid.io import FORMATS, SPOKEN
from pmfid.io.reading import READERS
from pmfid.models.signals import SIGNALS, Signal
from pmfid.pipeline import arrays
from tests.hostile import records

pytestmark = pytest.mark.usefixtures("without_judgement")

REPOSITORY = Path(__file__).parents[1]


# --- a key of [model] -------------------------------------------------------------------------------------------------


class StoppedError(Exception):
    """The signal to stop before the estimate."""


#: A value of each field of a model that differs from its default; a new field needs a line here.
DRIVE = {"input_gain": 3.0, "offset": True, "friction": "directional", "spring": True, "dead_time": 0.003}
DRIVE |= {"stribeck": 0.02, "quadratic": True, "gravity": True, "cogging": 0.01, "friction_period": 0.2, "lag": 0.004}
DRIVE |= {"axis": "rotary", "body": "two-mass", "play": True, "output": "load"}
PROCESS = {"n": 3, "m": 2, "delay": 4, "offset": True, "integrators": 1, "unstable": True, "dead_time": 0.25}
TERM = {"signal": "forward_output", "derivative": 1, "name": "d", "unit": "N s/m", "coefficient": 2.5}
SHAPE = {"form": "stribeck", "speed": 0.02}
SHAPED = pmfid.Term("friction", 0, "stribeck_friction", "N", shape=pmfid.Stribeck(0.02))
#: Further fields that a model needs.
PLAIN: dict[type, dict[str, object]] = {pmfid.Drive: {"input_gain": 2.0}, pmfid.TransferFunction: {"n": 2, "m": 0}}
FIELDS = [(pmfid.Drive, {name: value}) for name, value in DRIVE.items()]
FIELDS += [(pmfid.TransferFunction, {name: value}) for name, value in PROCESS.items()]


def needed_by(field: dict[str, object]) -> dict[str, object]:
    """Return the further fields without which a field is refused."""
    return {"n": 3, "m": 2} if "m" in field else {"body": "two-mass"} if {"play", "output"} & set(field) else {}


def model_of(cls: type, field: dict[str, object]) -> pmfid.Drive | pmfid.TransferFunction:
    model = cls(**(PLAIN[cls] | needed_by(field) | field))
    assert model != cls(**PLAIN[cls])
    return model


def equation_model(**known: object) -> pmfid.EquationModel:
    """Return a model whose unknown terms differ in every field from a plain term."""
    own = pmfid.Term(**TERM)
    unknown = (pmfid.Term("output", 2, "m", "kg", -1.0), own, pmfid.Term("direction", 0, "F"), SHAPED)
    return pmfid.EquationModel(pmfid.Equation(unknown, (pmfid.Term("input", 0, **known),)))


def from_python(model: object, monkeypatch: pytest.MonkeyPatch) -> object:
    """Return the model that `pmfid.identify` takes, by way of AXIS.toml's [model]."""
    seen: list[Axis] = []

    def run(_: object, axis: Axis) -> None:
        seen.append(axis)
        raise StoppedError

    monkeypatch.setattr(arrays, "run", run)
    encoder = None if isinstance(model, pmfid.TransferFunction) else pmfid.Encoder(1e-4)
    with pytest.raises(StoppedError):
        pmfid.identify(np.ones(100), np.arange(100), model=model, dt=0.01, cutoff=20.0, encoder=encoder)
    return seen[0].model.make()


def from_toml(keys: dict[str, object], tmp_path: Path) -> object:
    section = "\n".join(f"{key} = {toml(value)}" for key, value in keys.items())
    path = tmp_path / "axis.toml"
    path.write_text(
        '[record]\ninput = "u"\noutput = "x"\ntime = "t"\n[encoder]\nresolution = 1e-4\n'
        f"[estimator]\ncutoff = 20.0\n[model]\n{section}\n"
    )
    return load_axis(path).model.make()


def toml(value: object) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {toml(item)}" for key, item in value.items()) + " }"
    return f"[{', '.join(map(toml, value))}]" if isinstance(value, list) else json.dumps(value)


def test_every_field_of_a_model_is_tried_here() -> None:
    """`initial_conditions` are refused in one sentence: `identify` always fits the start values."""
    assert set(DRIVE) == {field.name for field in fields(pmfid.Drive)}
    assert {*PROCESS, "initial_conditions"} == {field.name for field in fields(pmfid.TransferFunction)}
    tried = TERM | {"shape": SHAPED.shape}
    assert set(tried) == {field.name for field in fields(pmfid.Term)}
    assert all(tried[field.name] != field.default for field in fields(pmfid.Term))


@pytest.mark.parametrize(("cls", "field"), FIELDS, ids=str)
def test_a_field_of_a_model_arrives_from_python_and_from_a_file(
    cls: type, field: dict[str, object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A lost field would not be reported, and another plant would be identified."""
    model = model_of(cls, field)
    assert from_python(model, monkeypatch) == model
    keys = {name: getattr(model, name) for name in {**PLAIN[cls], **needed_by(field), **field}}
    assert from_toml({"kind": model.kind, **keys}, tmp_path) == model


def test_terms_arrive_from_python_and_from_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model = equation_model(coefficient=0.7)
    assert from_python(model, monkeypatch) == model
    plain = [field.name for field in fields(pmfid.Term) if field.name != "shape"]
    unknown = [
        {name: getattr(term, name) for name in plain} | ({} if term.shape is None else {"shape": SHAPE})
        for term in model.equation.unknown
    ]
    keys = {"kind": "equation", "unknown": unknown, "known": [{"signal": "input", "coefficient": 0.7}]}
    assert from_toml(keys, tmp_path) == model


# --- a signal ---------------------------------------------------------------------------------------------------------


def test_every_signal_has_its_facts() -> None:
    """Every signal holds for an interval or has derivatives, and a term of it has a readable text."""
    assert tuple(SIGNALS) == get_args(Signal)
    for signal, facts in SIGNALS.items():
        for derivative in range(facts.derivatives[0], facts.derivatives[1] + 1):
            form = {"name": "size", "shape": pmfid.Wave(0.1)} if facts.shaped else {}
            read = facts.reads + "'" * derivative
            assert pmfid.Term(signal, derivative, **form).reads.endswith(read)
            assert form or pmfid.Term(signal, derivative).reads == read


# --- a file format ----------------------------------------------------------------------------------------------------


def test_every_format_has_a_reader_is_reported_and_is_attacked() -> None:
    """`test_records.py` and `test_unpacked.py` use the same list."""
    assert set(READERS) == set(FORMATS)
    assert set(records.WRITERS) == set(FORMATS)
    assert SPOKEN in str(identify.help)
    assert SPOKEN in " ".join((REPOSITORY / "docs/howto/records.md").read_text(encoding="utf-8").split())


# --- the recipes ------------------------------------------------------------------------------------------------------


def recipes() -> str:
    pages = [*(REPOSITORY / "docs/decisions").glob("*.md"), REPOSITORY / "docs/extending.md"]
    return "".join(path.read_text(encoding="utf-8") for path in [REPOSITORY / "ARCHITECTURE.md", *pages])


def files() -> list[str]:
    folders = ("src", "csrc", "tests", "docs", "studies")
    inside = [path for folder in folders for path in (REPOSITORY / folder).rglob("*")]
    return [f"/{path}" for path in [*inside, *REPOSITORY.iterdir()]]


def test_every_file_that_a_recipe_names_is_there() -> None:
    named = set(re.findall(r"`([\w./-]*\w\.(?:py|pyi|pyx|pxd|pxi|c|h|md|toml|in))`", recipes()))
    there = files()
    assert len(named) > 30
    missing = {name for name in named if not any(path.endswith(f"/{name}") for path in there)}
    assert {name for name in missing if "NAME" not in name} == set()
