"""What the commands print for machines."""

from __future__ import annotations

import json
from collections.abc import Mapping

import click


def print_json(content: Mapping[str, object]) -> None:
    """One object as one line of JSON, with numbers alone: NaN would be no JSON."""
    click.echo(json.dumps(content, allow_nan=False))
