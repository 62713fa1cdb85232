"""Calls of every command with its files and with options from its own table, some of them hostile."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np

from pmfid.cli.main import main
from pmfid.estimators import METHODS
from pmfid.simulation import SCENARIOS
from tests.hostile.configurations import axis, monitor
from tests.hostile.lines import as_pipe
from tests.hostile.plants import PLANTS, Columns
from tests.hostile.records import as_csv, as_file, with_defects
from tests.hostile.specs import spec

Rng = np.random.Generator
Files = dict[str, bytes]
#: A function that draws the words before the options, the files, and the bytes that are piped.
Begin = Callable[[Rng, Path], tuple[Sequence[str], Files, bytes]]

#: Methods that run sample by sample.
RECURSIVE = ("auto", "rls", "bcrls", "riv")
#: Values of an option that no user intends.
ODD = ["0", "-1", "1e308", "1e-320", "nan", "inf", "-inf", "1e400", "x", "1_0", "\u0661", "0x10", "--json"]
ODD += ["", "9" * 400]
#: Values that options of a kind may have, and those of single options by the names of their parameters.
USUAL = {
    "integer": ["1", "2", "12"],
    "integer range": ["1", "2", "7"],
    "float": ["0.1", "1", "1e-3"],
    "float range": ["0.5", "1", "0"],
    "text": ["x", "u", "a b"],
    "path": ["out", "rows.csv", "rows.parquet", "page.html", "axis.toml", "nowhere/x.csv", "."],
    "directory": ["out", "axis.toml", "axis.toml/out", "a" * 300],
}
NAMED = {
    "changes": [
        *("estimator.cutoff=-1", "estimator.forgetting=0.9", "encoder.resolution=1e-3", "model.n=2", "model.delay=20"),
        *("monitor.mtbf_hours=24", "monitor.tolerance=0.05", "monitor.tolerance=0", "x"),
    ],
    "goal": ["u", "u*", "*"],
    "position": ["y", "counts", "*"],
    "given": ["kp=8", "kp=-1", "1.kp=2"],
    "terms": ["gravity", "x"],
    "known_forces": ["y", "u*", "x"],
    "parameter": ["mass", "x"],
    "period": ["day", "run", "shift", "10min", "1e9"],
    "segment": ["60", "5"],
    "want": ["mass=0.01", "colour=1", "x"],
    "truth": ["mass=1.2", "x"],
    "prefix": ["axis", "int", "µ", "a b", "../x"],
    "alarms": ["mass", "m", "b0", "1", "0.5", "-1", "inf"],
    "increments": ["4096", "1", "0", "1000000000"],
    "missed": ["0.1", "1", "2", "-0.5"],
    "jitter": ["0.3", "-1", "1e9"],
}
#: Parameters of the models that are drawn, each with its unit.
KNOWN = {"mass": "kg", "viscous_friction": "N s/m", "coulomb_friction": "N", "offset": "N", "a0": "s^-1", "b0": "s^-1"}
#: Weights of the plants for a command that takes any plant, and for one that watches.
ANY = (*4 * ("cart",), *2 * ("heavy", "process"), "rotary", "rest")
WATCHED = (*12 * ("watched",), "cart", "heavy", "rotary", "rest", "process")


@dataclass(frozen=True)
class Case:
    """One call: the words after `pmfid`, the files of its folder by name, and the bytes piped into it."""

    arguments: tuple[str, ...]
    files: Files
    piped: bytes = b""


@dataclass(frozen=True)
class Maker:
    """A command, its part of all calls, and the chance of each option.

    Options in `never` are not drawn, because they are among the words of `begin` or end the command.
    """

    part: float
    chance: float
    begin: Begin
    never: tuple[str, ...] = ()

    def make(self, name: str, rng: Rng, folder: Path) -> Case:
        words, files, piped = self.begin(rng, folder)
        if name == "none":
            return Case(tuple(words), files)
        command = main.commands["fleet"].commands["history"] if name == "fleet" else main.commands[name]  # type: ignore[attr-defined]
        drawn = [word for one in command.params for word in self._draw(rng, one)]
        return Case((name, *words, *drawn), files, piped)

    def _draw(self, rng: Rng, one: click.Parameter) -> list[str]:
        chance = 0.6 if one.name == "as_json" else self.chance
        if not isinstance(one, click.Option) or one.name in self.never or rng.random() > chance:
            return []
        flag = str(rng.choice([*one.opts, *one.secondary_opts]))
        return [flag] if one.is_flag else [flag, *(_value(rng, one) for _ in range(one.nargs))]


def _value(rng: Rng, one: click.Option) -> str:
    kind = one.type
    if isinstance(kind, click.Choice):
        usual = list(kind.choices)
    else:
        folder = isinstance(kind, click.Path) and not kind.file_okay
        usual = NAMED.get(str(one.name)) or USUAL.get("directory" if folder else kind.name, USUAL["text"])
    return str(rng.choice(ODD if rng.random() < 0.07 else usual))


def _plant(rng: Rng, names: tuple[str, ...] = ANY) -> tuple[str, Columns, Columns]:
    """Draw a plant: the kind of its model, its columns, and its facts."""
    plant = str(rng.choice(names))
    columns, facts = PLANTS[plant](int(rng.integers(4)))
    kind = "transfer_function" if plant == "process" else str(rng.choice(["drive", "equation"], p=[0.75, 0.25]))
    return kind, columns, facts


def recorded(*further: str, methods: tuple[str, ...] = METHODS, config: bool = True) -> Begin:
    """Return a function that draws a record with its AXIS.toml, at times with a second record."""

    def begin(rng: Rng, folder: Path) -> tuple[list[str], Files, bytes]:
        kind, columns, facts = _plant(rng)
        text = axis(rng, kind, facts, methods)
        name, data = as_file(rng, with_defects(rng, columns), folder)
        more = [str(rng.choice([name, "nowhere.csv", "."]))] if rng.random() < 0.03 else []
        words = [name, *more, *(["--config", "axis.toml"] if config else []), *further]
        return words, {"axis.toml": text.encode(), name: data}, b""

    return begin


def _init(rng: Rng, folder: Path) -> tuple[list[str], Files, bytes]:
    words, files, _ = recorded(config=False)(rng, folder)
    place = rng.choice(["new.toml", "axis.toml", "nowhere/x.toml", "."], p=[0.7, 0.1, 0.1, 0.1])
    return [*words, "--out", str(place)], files, b""


def _fleet(rng: Rng, folder: Path) -> tuple[list[str], Files, bytes]:
    """Draw a record as data set, a folder of records, or no data set."""
    (name, *_), files, _ = recorded()(rng, folder)
    source, by = rng.choice([name, ".", "nowhere", "axis.toml"]), rng.choice(["t", "u", "counts", "machine", ""])
    return ["history", str(source), "--config", "axis.toml", "--axis", str(by), "--out", "out"], files, b""


def _validate(rng: Rng, folder: Path) -> tuple[list[str], Files, bytes]:
    words, files, _ = recorded()(rng, folder)
    values = ["1.0", "0.3", "1e-3", "0", "-1", "1e300", "1e-300", "NaN", '"1"', "null", "[]"]
    chances = np.r_[0.5, 0.2, 0.1, np.full(len(values) - 3, 0.2 / (len(values) - 3))]
    own = list(KNOWN)[: int(rng.choice([3, 4, 6], p=[0.7, 0.2, 0.1]))]
    entries = [f'"{key}": {{"value": {rng.choice(values, p=chances)}, "unit": "{KNOWN[key]}"}}' for key in own]
    kind = rng.choice(["drive", "equation", "transfer_function", ""], p=[0.7, 0.1, 0.15, 0.05])
    text = f'{{"model": "{kind}", "parameters": {{{", ".join(entries)}}}}}'
    if rng.random() < 0.1:
        text = text[: int(rng.integers(len(text)))]
    place = str(rng.choice(["result.json", "nowhere.json", ".", "axis.toml"], p=[0.9, 0.04, 0.03, 0.03]))
    return [*words, "--model", place], files | {"result.json": text.encode()}, b""


def _export(rng: Rng, folder: Path) -> tuple[list[str], Files, bytes]:
    (name, *_), files, _ = recorded(methods=(*RECURSIVE, *RECURSIVE, "ls"))(rng, folder)
    return ["axis.toml", "--out", "out", *(["--record", name] if rng.random() < 0.8 else [])], files, b""


def _monitor(rng: Rng, folder: Path) -> tuple[list[str], Files, bytes]:
    """Draw a record of normal work and a second record."""
    kind, columns, facts = _plant(rng, WATCHED)
    kind = "drive" if kind == "equation" and rng.random() < 0.7 else kind
    text = axis(rng, kind, facts, (*2 * ("riv", "bcrls", "auto"), "rls")) + monitor(rng, facts)
    files = {"normal.csv": as_csv(rng, with_defects(rng, columns) if rng.random() < 0.2 else columns)}
    name, data = as_file(rng, with_defects(rng, columns), folder)
    return [name, "--config", "axis.toml"], files | {"axis.toml": text.encode(), name: data}, b""


def _serve(rng: Rng, folder: Path) -> tuple[list[str], Files, bytes]:
    """Draw a PLANT.toml with a pipe, or invalid `[axes]` and `[sources]`; each service ends by itself."""
    _, columns, facts = _plant(rng, ("watched",))
    files = {"normal.csv": as_csv(rng, columns)}
    files["axis.toml"] = (axis(rng, "drive", facts, ("riv", "bcrls")) + monitor(rng, facts)).encode()
    ends = ["--no-page", "--until-end"]
    if rng.random() < 0.7:
        return ["axis.toml", *ends], files, as_pipe(rng, columns)
    return ["plant.toml", *ends], files | {"plant.toml": _odd_plant(rng).encode()}, b""


def _odd_plant(rng: Rng) -> str:
    """Return a PLANT.toml that has a fault in three of four cases."""
    names = ["x1", '"../x"', '"<script>"', '"a b"', '""', "9" * 200]
    name = str(rng.choice([*8 * ("x1",), *names]))
    lines = [f"[axes.{name}]", f'config = "{rng.choice(["axis.toml", "axis.toml", "nowhere.toml", "."])}"']
    lines += ["[sources.a]", f'kind = "{rng.choice(["stdin", "stdin", "stdi", "mqtt", ""])}"', 'axis = "x1"']
    odd = ["[service]", "every = nan", 'state = "state"', "window = -1.0", "[what]", "axes = 3", "x ="]
    return "\n".join([*lines, *([str(rng.choice(odd))] if rng.random() < 0.3 else [])]) + "\n"


def _simulate(rng: Rng, folder: Path) -> tuple[list[str], Files, bytes]:
    """Draw a short simulation of the cart."""
    scenario = str(rng.choice([*3 * tuple(SCENARIOS), "PRBS", "\x1b[31m"]))
    out = str(rng.choice(["run.csv", "run.CSV", "run", "new/run.csv", "."], p=[0.83, 0.05, 0.03, 0.06, 0.03]))
    duration = str(rng.choice([*4 * ("1", "2.5", "0.5"), "0.05", "0.001", "-1", "nan", "inf", "400000"]))
    return [*([scenario] if rng.random() < 0.97 else []), "--out", out, "--duration", duration], {}, b""


def _design(rng: Rng, folder: Path) -> tuple[list[str], Files, bytes]:
    certify = str(rng.choice(["0", "0.01", "-1", "nan", "x"], p=[0.8, 0.14, 0.02, 0.02, 0.02]))
    return ["spec.toml", "--certify", certify], {"spec.toml": spec(rng, 22.75e-6).encode()}, b""


def _explain(rng: Rng, folder: Path) -> tuple[list[str], Files, bytes]:
    """Draw a known key or word, a part of one, or an unknown word."""
    own = str(rng.choice(["record.time_unit", "[model] stribeck", "poor_excitation", "dead time", "mass", "", *ODD]))
    return [own[: rng.integers(len(own) + 1)] if rng.random() < 0.3 else own], {}, b""


def _none(rng: Rng, folder: Path) -> tuple[Sequence[str], Files, bytes]:
    """Draw a call without a command, with a wrong command, or with a command but no files."""
    further = ["--help", "-h", "--json", "nowhere.csv", "--config"]
    words: list[tuple[str, ...]] = [(), ("--version",), ("--help",), ("identfy",), ("",), ("\x1b[31m",), ("-x",)]
    words = [*words, *((name, *rng.choice(further, 2).tolist()) for name in COMMANDS)]
    return words[rng.integers(len(words))], {}, b""


#: Slow commands are rare.
COMMANDS: dict[str, Maker] = {
    "identify": Maker(0.332, 0.05, recorded(), ("config",)),
    "encoder": Maker(0.002, 0.2, recorded(), ("config",)),
    "validate": Maker(0.048, 0.05, _validate, ("config", "stored")),
    "monitor": Maker(0.19, 0.05, _monitor, ("config", "estimates")),
    "serve": Maker(0.01, 0.1, _serve, ("no_page", "until_end")),
    "simulate": Maker(0.13, 0.15, _simulate, ("out", "duration", "listing")),
    "export": Maker(0.15, 0.1, _export, ("out", "record")),
    "design": Maker(0.07, 0.02, _design, ("certify",)),
    "check": Maker(0.001, 0.03, recorded(), ("config",)),
    "init": Maker(0.001, 0.03, _init, ("out",)),
    "terms": Maker(0.004, 0.03, recorded(), ("config",)),
    "friction": Maker(0.004, 0.03, recorded(), ("config",)),
    "fleet": Maker(0.002, 0.2, _fleet, ("config", "out")),
    "explain": Maker(0.008, 0.1, _explain),
    "actuators": Maker(0.002, 0.3, recorded("--no-search", config=False), ("search",)),
    "none": Maker(0.046, 0.0, _none),
}
