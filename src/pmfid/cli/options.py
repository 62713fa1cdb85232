"""Options and arguments that several commands have."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import click

F = TypeVar("F", bound=Callable[..., object])

RECORDS = click.argument("records", type=click.Path(path_type=Path), nargs=-1, required=True, metavar="RECORD...")
CUTOFF = click.option(
    "--cutoff", type=float, metavar="RAD/S", help="Pole of the filters; of a machine, default: chosen by the record."
)
JSON = click.option("--json", "as_json", is_flag=True, help="Print one JSON object and nothing else.")


def step(text: str) -> float | str:
    """A number in SI, or a text with a unit, which the configuration reads as in AXIS.toml."""
    try:
        return float(text)
    except ValueError:
        if re.search(r"\d", text):
            return text
        raise click.BadParameter(f'{text!r} is no number, with a unit or without, as 0.001 or "0.01 mm"') from None


def config_option(text: str = "What the record holds, the encoder, the model, the estimator.") -> Callable[[F], F]:
    """--config AXIS.toml."""
    return click.option("--config", required=True, type=click.Path(path_type=Path), metavar="AXIS.toml", help=text)


def folder_option(text: str) -> Callable[[F], F]:
    """--out DIR."""
    return click.option("--out", type=click.Path(path_type=Path, file_okay=False), metavar="DIR", help=text)
