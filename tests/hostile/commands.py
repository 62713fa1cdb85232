"""Calls of every command with its files and options, some of them hostile."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pmfid.estimators import METHODS
from pmfid.simulation import SCENARIOS
from tests.hostile.configurations import axis, monitor, some
from tests.hostile.lines import as_pipe
from tests.hostile.plants import PLANTS, Columns
from tests.hostile.records import as_csv, as_file, with_defects
from tests.hostile.specs import spec

Rng = np.random.Generator

#: Methods that run sample by sample.
RECURSIVE = ("auto", "rls", "bcrls", "riv")
#: Values of an option that no user intends.
ODD = [
    "0",
    "-1",
    "1e308",
    "1e-320",
    "nan",
    "inf",
    "-inf",
    "1e400",
    "",
    "x",
    "9" * 400,
    "1_0",
    "\u0661",
    "0x10",
    "--json",
]


@dataclass(frozen=True)
class Case:
    """One call: the words after `pmfid`, the files of its folder by name, and the bytes piped into it."""

    arguments: tuple[str, ...]
    files: dict[str, bytes]
    piped: bytes = b""


def options(rng: Rng, chance: float, **choices: list[str]) -> list[str]:
    """Return options with a valid value, or at times an odd value; `goal_unit` is --goal-unit."""
    found = []
    for key, value in some(rng, chance, **choices).items():
        odd = rng.random() < 0.07
        found += [f"--{key.replace('_', '-')}", str(rng.choice(ODD)) if odd else value]
    return found


def _flags(rng: Rng, chance: float, *names: str) -> list[str]:
    return [name for name in names if rng.random() < chance]


# --- commands that take a record ---


#: Weights of the five plants for a command that takes any plant.
ANY = (*4 * ("cart",), *2 * ("heavy", "process"), "rotary", "rest")


def _plant(rng: Rng, names: tuple[str, ...] = ANY) -> tuple[str, Columns, Columns]:
    """Draw a plant: the kind of its model, its columns, and its facts."""
    plant = str(rng.choice(names))
    columns, facts = PLANTS[plant](int(rng.integers(4)))
    kind = "transfer_function" if plant == "process" else str(rng.choice(["drive", "equation"], p=[0.75, 0.25]))
    return kind, columns, facts


def _recorded(rng: Rng, folder: Path, methods: tuple[str, ...] = METHODS) -> tuple[dict[str, bytes], str]:
    """Return AXIS.toml with a record of that axis, and the name of the record."""
    kind, columns, facts = _plant(rng)
    text = axis(rng, kind, facts, methods)
    name, data = as_file(rng, with_defects(rng, columns), folder)
    return {"axis.toml": text.encode(), name: data}, name


def _identify(rng: Rng, folder: Path) -> Case:
    files, name = _recorded(rng, folder)
    values = [
        "estimator.cutoff=-1",
        "estimator.forgetting=0.9",
        "encoder.resolution=1e-3",
        "model.n=2",
        "model.delay=20",
    ]
    chosen = options(rng, 0.1, method=list(METHODS), set=values)
    chosen += [*_out(rng, 0.01), *_flags(rng, 0.6, "--json"), *(_more(rng, name))]
    return Case(("identify", name, "--config", "axis.toml", *chosen), files)


def _more(rng: Rng, name: str) -> list[str]:
    """Return the record a second time, or a file that does not exist."""
    return [str(rng.choice([name, "nowhere.csv", "."]))] if rng.random() < 0.03 else []


def _out(rng: Rng, chance: float) -> list[str]:
    """Return the place of the results: a new folder, or at times an existing file or an invalid place."""
    place = str(rng.choice(["out", "axis.toml", "axis.toml/out", "a" * 300], p=[0.7, 0.1, 0.1, 0.1]))
    return ["--out", place] if rng.random() < chance else []


def _init(rng: Rng, folder: Path) -> Case:
    files, name = _recorded(rng, folder)
    place = str(rng.choice(["new.toml", "axis.toml", "nowhere/x.toml", "."], p=[0.7, 0.1, 0.1, 0.1]))
    return Case(("init", name, "--out", place), files)


def _check(rng: Rng, folder: Path) -> Case:
    files, name = _recorded(rng, folder)
    return Case(("check", name, "--config", "axis.toml", *_flags(rng, 0.6, "--json"), *_more(rng, name)), files)


def _terms(rng: Rng, folder: Path) -> Case:
    files, name = _recorded(rng, folder)
    chosen = [*_out(rng, 0.03), *_flags(rng, 0.6, "--json")]
    return Case(("terms", name, "--config", "axis.toml", *chosen), files)


def _actuators(rng: Rng, folder: Path) -> Case:
    files, name = _recorded(rng, folder)
    chosen = options(
        rng, 0.5, goal=["u", "u*", "*"], position=["y", "counts", "*"], unit=["counts", "deg"], bits=["12"]
    )
    chosen += options(rng, 0.3, given=["kp=8", "kp=-1", "1.kp=2"], term=["gravity", "x"], known_force=["y", "u*", "x"])
    chosen += [*_out(rng, 0.03), *_flags(rng, 0.6, "--json"), *_flags(rng, 0.7, "--no-search")]
    return Case(("actuators", name, *chosen), files)


def _friction(rng: Rng, folder: Path) -> Case:
    files, name = _recorded(rng, folder)
    return Case(("friction", name, "--config", "axis.toml", *_flags(rng, 0.6, "--json")), files)


def _encoder(rng: Rng, folder: Path) -> Case:
    files, name = _recorded(rng, folder)
    chosen = options(rng, 0.2, want=["0.1", "-1", "nan"], line_error=["0", "60"], parameter=["mass", "x"])
    return Case(("encoder", name, "--config", "axis.toml", *chosen, *_flags(rng, 0.6, "--json")), files)


def _fleet(rng: Rng, folder: Path) -> Case:
    """Draw a call of `pmfid fleet` with a record as data set, a folder of records, or no data set."""
    files, name = _recorded(rng, folder)
    by = str(rng.choice(["t", "u", "counts", "machine", ""]))
    source = str(rng.choice([name, ".", "nowhere", "axis.toml"]))
    chosen = options(rng, 0.2, period=["day", "run", "shift", "10min", "1e9"], segment=["60", "5"], workers=["1", "2"])
    chosen += [*options(rng, 0.1, type=["u"]), *_flags(rng, 0.6, "--json")]
    return Case(("fleet", "history", source, "--config", "axis.toml", "--axis", by, "--out", "out", *chosen), files)


#: Parameters of the models that are drawn, each with its unit.
KNOWN = {"mass": "kg", "viscous_friction": "N s/m", "coulomb_friction": "N", "offset": "N", "a0": "s^-1", "b0": "s^-1"}


def _validate(rng: Rng, folder: Path) -> Case:
    files, name = _recorded(rng, folder)
    values = ["1.0", "0.3", "1e-3", "0", "-1", "1e300", "1e-300", "NaN", '"1"', "null", "[]"]
    chances = np.r_[0.5, 0.2, 0.1, np.full(len(values) - 3, 0.2 / (len(values) - 3))]
    own = list(KNOWN)[: int(rng.choice([3, 4, 6], p=[0.7, 0.2, 0.1]))]
    entries = [f'"{key}": {{"value": {rng.choice(values, p=chances)}, "unit": "{KNOWN[key]}"}}' for key in own]
    kind = rng.choice(["drive", "equation", "transfer_function", ""], p=[0.7, 0.1, 0.15, 0.05])
    text = f'{{"model": "{kind}", "parameters": {{{", ".join(entries)}}}}}'
    if rng.random() < 0.1:
        text = text[: int(rng.integers(len(text)))]
    place = str(rng.choice(["result.json", "nowhere.json", ".", "axis.toml"], p=[0.9, 0.04, 0.03, 0.03]))
    files["result.json"] = text.encode()
    chosen = [*_out(rng, 0.05), *_flags(rng, 0.6, "--json"), *_more(rng, name)]
    return Case(("validate", name, "--config", "axis.toml", "--model", place, *chosen), files)


def _export(rng: Rng, folder: Path) -> Case:
    files, name = _recorded(rng, folder, (*RECURSIVE, *RECURSIVE, "ls"))
    chosen = options(rng, 0.2, precision=["float32", "float64"], method=list(RECURSIVE))
    chosen += options(rng, 0.1, dt=["0.01", "1e-3"], prefix=["axis", "int", "µ", "a b", "../x"])
    chosen += _flags(rng, 0.1, "--blocks") + _alarms(rng)
    out = _out(rng, 1.0) if rng.random() < 0.2 else ["--out", "out"]
    record = ["--record", name] if rng.random() < 0.8 else []
    return Case(("export", "axis.toml", *record, *out, *chosen), files)


def _alarms(rng: Rng) -> list[str]:
    numbers = ["1", "0.5", "0", "-1", "nan", "inf", "1e308"]
    name = str(rng.choice(["mass", "m", "viscous_friction", "b0", "x", ""]))
    return ["--alarm", name, *rng.choice(numbers, 2).tolist()] if rng.random() < 0.15 else []


# --- watching ---------------------------------------------------------------------------------------------------------


def _monitor(rng: Rng, folder: Path) -> Case:
    """Draw a record of normal work and a second record."""
    kind, columns, facts = _plant(rng, (*12 * ("watched",), "cart", "heavy", "rotary", "rest", "process"))
    kind = "drive" if kind == "equation" and rng.random() < 0.7 else kind
    text = axis(rng, kind, facts, (*2 * ("riv", "bcrls", "auto"), "rls")) + monitor(rng, facts)
    files = {"normal.csv": as_csv(rng, with_defects(rng, columns) if rng.random() < 0.2 else columns)}
    files["axis.toml"] = text.encode()
    chosen = options(rng, 0.2, set=["monitor.mtbf_hours=24", "monitor.tolerance=0.05", "monitor.tolerance=0"])
    places = ["rows.csv", "rows.parquet", "normal.csv", "axis.toml", "nowhere/x.csv", "x.txt", "."]
    chosen += options(rng, 0.3, out=places) + options(rng, 0.01, report=["page.html", "normal.csv", "nowhere/x.html"])
    chosen += _flags(rng, 0.6, "--json")
    name, files_of_run = as_file(rng, with_defects(rng, columns), folder)
    return Case(("monitor", name, "--config", "axis.toml", *chosen), files | {name: files_of_run})


def _serve(rng: Rng, folder: Path) -> Case:
    """Draw a PLANT.toml with a pipe, or invalid `[axes]` and `[sources]`; each service ends by itself."""
    _, columns, facts = _plant(rng, ("watched",))
    files = {"normal.csv": as_csv(rng, columns)}
    files["axis.toml"] = (axis(rng, "drive", facts, ("riv", "bcrls")) + monitor(rng, facts)).encode()
    chosen = ["--no-page", "--until-end", *_flags(rng, 0.5, "--json")]
    chosen += options(
        rng, 0.1, every=["0", "0.5", "-1"], state=["state", "axis.toml", "nowhere/state"], port=["0", "x"]
    )
    kind = rng.random()
    if kind < 0.7:
        return Case(("serve", "axis.toml", *chosen), files, as_pipe(rng, columns))
    return Case(("serve", "plant.toml", *chosen), files | {"plant.toml": _odd_plant(rng).encode()})


def _odd_plant(rng: Rng) -> str:
    """Return a PLANT.toml that has a fault in three of four cases."""
    names = ["x1", '"../x"', '"<script>"', '"a b"', '""', "9" * 200]
    name = str(rng.choice([*8 * ("x1",), *names]))
    lines = [f"[axes.{name}]", f'config = "{rng.choice(["axis.toml", "axis.toml", "nowhere.toml", "."])}"']
    lines += ["[sources.a]", f'kind = "{rng.choice(["stdin", "stdin", "stdi", "mqtt", ""])}"', 'axis = "x1"']
    lines += some_lines(
        rng, ["[service]", "every = nan", 'state = "state"', "window = -1.0", "[what]", "axes = 3", "x ="]
    )
    return "\n".join(lines) + "\n"


def some_lines(rng: Rng, lines: list[str]) -> list[str]:
    """Return none or one of the lines."""
    return [str(rng.choice(lines))] if rng.random() < 0.3 else []


def _simulate(rng: Rng, folder: Path) -> Case:
    """Draw a short simulation of the cart."""
    scenario = (
        [str(rng.choice([*SCENARIOS, *SCENARIOS, *SCENARIOS, "PRBS", "\x1b[31m"]))] if rng.random() < 0.97 else []
    )
    out = [
        "--out",
        str(rng.choice(["run.csv", "run.CSV", "run", "new/run.csv", "."], p=[0.83, 0.05, 0.03, 0.06, 0.03])),
    ]
    duration = [
        "--duration",
        str(
            rng.choice(
                ["1", "2.5", "0.5", "0.05", "0.001", "-1", "nan", "inf", "400000"],
                p=[0.4, 0.3, 0.1, 0.1, 0.02, 0.02, 0.02, 0.02, 0.02],
            )
        ),
    ]
    chosen = options(rng, 0.2, seed=["0", "7", "-3", "4294967296"], increments=["4096", "1", "0", "1000000000"])
    chosen += options(
        rng, 0.2, bits=["8", "2", "32", "33"], missed=["0.1", "1", "2", "-0.5"], jitter=["0.3", "-1", "1e9"]
    )
    chosen += (
        options(rng, 0.2, line_error=["0.2", "-1", "1e300"]) + _flags(rng, 0.3, "--truth") + _flags(rng, 0.03, "--list")
    )
    return Case(("simulate", *scenario, *out, *duration, *chosen), {})


# --- design -----------------------------------------------------------------------------------------------------------


def _design(rng: Rng, folder: Path) -> Case:
    chosen = options(rng, 0.1, want=["mass=0.01", "colour=1", "x"], rounds=["1", "0"]) + _out(rng, 0.01)
    chosen += ["--certify", str(rng.choice(["0", "0.01", "-1", "nan", "x"], p=[0.8, 0.14, 0.02, 0.02, 0.02]))]
    chosen += _flags(rng, 0.6, "--json")
    return Case(("design", "spec.toml", *chosen), {"spec.toml": spec(rng, 22.75e-6).encode()})


# --- other commands ---------------------------------------------------------------------------------------------------


def _explain(rng: Rng, folder: Path) -> Case:
    """Draw a call of `pmfid explain` with a known key or word, a part of one, or an unknown word."""
    words = ["record.time_unit", "[model] stribeck", "poor_excitation", "dead time", "mass", "", *ODD]
    own = str(rng.choice(words))
    return Case(
        ("explain", *[own[: rng.integers(len(own) + 1)] if rng.random() < 0.3 else own], *options(rng, 0.2)), {}
    )


def _none(rng: Rng, folder: Path) -> Case:
    """Draw a call without a command, with a wrong command, or with a command but no files."""
    further = ["--help", "-h", "--json", "nowhere.csv", "--config"]
    words: list[tuple[str, ...]] = [(), ("--version",), ("--help",), ("identfy",), ("",), ("\x1b[31m",), ("-x",)]
    words = [*words, *((name, *rng.choice(further, 2).tolist()) for name in COMMANDS)]
    return Case(words[rng.integers(len(words))], {})


#: Command -> function that draws its calls, and the share of all calls: slow commands are rare.
COMMANDS: dict[str, tuple[Callable[[Rng, Path], Case], float]] = {
    "identify": (_identify, 0.332),
    "encoder": (_encoder, 0.002),
    "validate": (_validate, 0.048),
    "monitor": (_monitor, 0.19),
    "serve": (_serve, 0.01),
    "simulate": (_simulate, 0.13),
    "export": (_export, 0.15),
    "design": (_design, 0.07),
    "check": (_check, 0.001),
    "init": (_init, 0.001),
    "terms": (_terms, 0.004),
    "friction": (_friction, 0.004),
    "fleet": (_fleet, 0.002),
    "explain": (_explain, 0.008),
    "actuators": (_actuators, 0.002),
    "none": (_none, 0.046),
}
