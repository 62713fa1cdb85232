"""Accuracy of the cart with models wrong on purpose: what is said of each, in values and in words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

import pmfid
from pmfid.errors import NotIdentifiableError
from pmfid.pipeline.result import DriveResult
from pmfid.simulation import CART, CART_DT
from studies.paper.truth import TRUTH, Study, Task, table, triple
from studies.wrong_models import FORGETTING, INCREMENTS, SCENARIOS
from studies.wrong_plants import DESCRIPTIONS, PLANTS, wrong_record

METHODS = ("auto", "riv", "output-error", "interval")
#: Notes that tell what is wrong begin or go on so.
TELLING = ("the counts show", "friction or a dead time", "has an error of its own")


def tasks(seeds: int) -> list[Task]:
    return [(scenario, wrong, seed) for scenario in SCENARIOS for wrong in PLANTS for seed in range(seeds)]


def work(scenario: str, wrong: str, seed: int) -> dict[str, Any]:
    """Method -> error, std, model spread, each (3,) in percent of the truth, and what is said; or the refusal."""
    record = wrong_record(PLANTS[wrong], scenario, seed, INCREMENTS)
    settings: dict[str, Any] = {"model": pmfid.Drive(CART.input_gain), "dt": CART_DT, "cutoff": 1 / (3 * CART_DT)}
    found: dict[str, Any] = {}
    for method in METHODS:
        options: dict[str, Any] = {"method": method} | ({"forgetting": FORGETTING} if method == "riv" else {})
        encoder = pmfid.Encoder(record.resolution)
        try:
            result = pmfid.identify(record.u, record.counts, encoder=encoder, **settings, **options)
        except NotIdentifiableError as error:
            found[method] = str(error)
            continue
        if isinstance(result, DriveResult) and result.model_spread is not None:
            bars = result.theta - TRUTH, result.theta_std, result.model_spread
            found[method] = *(100 * bar / TRUTH for bar in bars), (*result.status, *reported(result.notes))
    return found


def reported(notes: tuple[str, ...]) -> list[str]:
    """The sentences on the model among the notes."""
    return [f"“{note}”" for note in notes if any(part in note for part in TELLING)]


def write(seeds: int, results: Mapping[Task, Any]) -> list[str]:
    lines = [
        "## Models wrong on purpose, and what is said now",
        "",
        f"The plants of [accuracy](accuracy.md): the cart, {INCREMENTS} increments, Tf = 3 T; `riv` with forgetting "
        f"{FORGETTING}, its last value; seed 0. Error, std and model spread of mass, viscous and "
        "Coulomb friction in percent of the cart's parameters; in: which of the three the 95 % interval contains.",
        "",
        *(f"- {wrong}: {text}." for wrong, text in DESCRIPTIONS.items()),
        "",
    ]
    for scenario in SCENARIOS:
        rows = [
            [wrong, f"`{method}`", *_cells(results[scenario, wrong, 0].get(method))]
            for wrong in PLANTS
            for method in METHODS
        ]
        header = ["wrong", "method", "error [%]", "std [%]", "model spread [%]", "in", "said"]
        lines += [f"{scenario}:", "", *table(header, rows)]
    return lines


def _cells(found: Any) -> list[str]:
    if isinstance(found, str):
        return ["refused", "–", "–", "–", found]
    error, std, spread, said = found
    inside = np.abs(error) <= 1.96 * np.hypot(std, spread)
    marks = ", ".join("yes" if there else "no" for there in inside)
    return [triple(error), triple(std, sign=""), triple(spread, sign=""), marks, ", ".join(said) or "–"]


SAID = Study("said", tasks, work, write)
