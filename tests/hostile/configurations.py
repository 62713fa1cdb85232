"""Texts of AXIS.toml, drawn from valid and broken parts."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from pmfid.estimators import METHODS
from pmfid.models.signals import SIGNALS
from tests.hostile.plants import Columns

Rng = np.random.Generator

#: Share of the keys that get a broken value, and share of the keys that are left out.
BROKEN, LEFT_OUT = 0.012, 0.006
#: Wrong values that can replace any value.
WRONG: list[Any] = [0, -1, 1e308, 1e-320, -1e-300, 1e30, 1e-30, 10**30, "", "x", "\u001b[31m", True, [], [1], {"a": 1}]
WRONG += [float("nan"), float("inf"), 2**63, 3.7, "[red]", "µm"]


def axis(rng: Rng, kind: str, facts: Columns, methods: tuple[str, ...] = METHODS) -> str:
    """Return the text of an AXIS.toml for a plant with these facts; `methods` are the methods that it may name."""
    counted, process = bool(rng.random() < 0.6), kind == "transfer_function"
    record = {
        "input": "u",
        "output": "counts" if counted else "y",
        "output_kind": "counts" if counted else "position",
        **_clock(rng, facts["dt"]),
        **some(rng, 0.1, input_scale=[1.0, -2.0, 0.001, 1e9, "gain"]),
        **some(rng, 0.25 if process else 0.01, gap=[0.5], hold=["foh"], reference=["r", "u"]),
    }
    encoder = {
        "resolution": facts["resolution"],
        **some(rng, 0.1, bits=[8, 16, 32, 1], guard=[False]),
        **some(rng, 0.02 if process else 0.15, standstill_time=[0.01, 5.0, 1e9], max_speed=[1e-6, 1.0, 1e12]),
    }
    model = {"kind": kind, **_MODELS[kind](rng, facts)}
    estimator = _estimator(rng, facts, methods)
    return text_of(rng, {"record": record, "encoder": encoder, "model": model, "estimator": estimator})


def _estimator(rng: Rng, facts: Columns, methods: tuple[str, ...]) -> Columns:
    return {
        "cutoff": facts["cutoff"] * float(rng.choice([1.0, 0.2, 3.0, 0.01, 100.0], p=[0.7, 0.15, 0.1, 0.03, 0.02])),
        **some(rng, 0.85, method=list(methods)),
        **some(rng, 0.2, order=[2, 3, 6], forgetting=[0.99, 0.5, 1.0, 1e-3, 0.999999]),
        **some(rng, 0.15, precision=["float32", "float64"], discretization=["matched", "paper"]),
        **some(rng, 0.05, prefilter_zeros=[[-3.0, -1.0], [-1e-6, -1e6], [-5.0, -4.0]]),
    }


def monitor(rng: Rng, facts: Columns) -> str:
    """Return the section [monitor] for the end of an AXIS.toml."""
    names = ["mass", "viscous_friction", "coulomb_friction"]
    nominal = dict(zip(names, facts.get("theta", (1.0, 1.0, 1.0)), strict=True))
    section = {
        **some(rng, 0.95, reference=["normal.csv"]),
        **some(rng, 0.15, nominal=[nominal, nominal, {"mass": 1.0}, dict.fromkeys(names, 0.0), {}]),
        **some(rng, 0.2, tolerance=[0.0, 0.02, 0.999]),
        **some(rng, 0.1, mtbf_hours=[0.1, 24.0, 1e6]),
    }
    return text_of(rng, {"monitor": section})


def text_of(rng: Rng, sections: dict[str, Columns], broken: float = BROKEN) -> str:
    """Return sections as TOML; some keys get a wrong value, and at times the text is cut off."""
    for section in sections.values():
        for key in list(section):
            if rng.random() < broken:
                section[key] = WRONG[rng.integers(len(WRONG))]
            if rng.random() < LEFT_OUT:
                del section[key]
    text = "".join(f"[{name}]\n" + "".join(f"{k} = {_toml(v)}\n" for k, v in s.items()) for name, s in sections.items())
    if rng.random() < 0.02:
        text = text[: rng.integers(len(text))] + str(rng.choice(["\0", "[", "= =", "\n[record]\n", "é"]))
    return text


def _clock(rng: Rng, dt: float) -> Columns:
    choices: list[Columns] = [{"time": "t"}, {"dt": dt}, {"time": "t", "dt": dt}, {"time": "t", "time_unit": "ms"}]
    return choices[rng.choice(4, p=[0.6, 0.25, 0.1, 0.05])]


def some(rng: Rng, chance: float, **choices: list[Any]) -> Columns:
    """Return a random choice of the keys, each with one of its values."""
    return {key: values[rng.integers(len(values))] for key, values in choices.items() if rng.random() < chance}


def _drive(rng: Rng, facts: Columns) -> Columns:
    gain = facts["input_gain"] * float(rng.choice([1.0, -1.0, 1e-6, 1e6], p=[0.85, 0.09, 0.03, 0.03]))
    extra = some(rng, 0.2, offset=[True, False], spring=[True], friction=["directional", "symmetric"])
    return {"input_gain": gain, **extra}


def _equation(rng: Rng, facts: Columns) -> Columns:
    signals = sorted((name for name, facts in SIGNALS.items() if not facts.of_process), key="input".__eq__)
    terms = [{"signal": "output", "derivative": 2, "name": "m"}, {"signal": "output", "derivative": 1, "name": "d"}]
    terms += [{"signal": "direction", "name": "c", "unit": str(rng.choice(["N", "[b]", "$\\frac$", "µ*/"]))}]
    if rng.random() < 0.5:
        signal = signals[rng.integers(len(signals))]
        low, high = SIGNALS[signal].derivatives
        derivative = int(rng.integers(low, high + 2 if rng.random() < 0.1 else high + 1))
        terms.append({"signal": signal, "derivative": derivative, "name": f"p{derivative}"})
    kept = [term for term in terms if rng.random() > 0.15]
    known: list[Columns] = [{"signal": "input", "coefficient": facts["input_gain"]}]
    if rng.random() < 0.15:
        known.append({"signal": "output", "derivative": int(rng.choice([0, 2])), "coefficient": -1.0})
    return {"unknown": kept, "known": known}


def _transfer_function(rng: Rng, facts: Columns) -> Columns:
    n = int(rng.choice([1, 2, 3, 6, 7], p=[0.35, 0.5, 0.1, 0.03, 0.02]))
    m = int(rng.integers(0, n + 1 if rng.random() < 0.05 else n))
    return {"n": n, "m": m, **some(rng, 0.2, delay=[0, 1, 20], offset=[True])}


_MODELS = {"drive": _drive, "equation": _equation, "transfer_function": _transfer_function}


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_toml(item)}" for key, item in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_toml, value)) + "]"
    if isinstance(value, float) and not np.isfinite(value):
        return str(value)
    return json.dumps(value, ensure_ascii=True)
