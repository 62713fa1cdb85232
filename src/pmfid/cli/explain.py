"""The command `pmfid explain`, which explains keys of AXIS.toml or PLANT.toml and words of a status."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

from pmfid.cli.terminal import JSON, print_json, print_text
from pmfid.errors import UsageError

if TYPE_CHECKING:
    from pmfid.config.explain import ReferenceEntry


@click.command(short_help="Say what a key of AXIS.toml or a status means.")
@click.argument("key", nargs=-1)
@click.option("--plant", is_flag=True, help="Explain the keys of PLANT.toml, which pmfid serve reads.")
@JSON
def explain(key: tuple[str, ...], plant: bool, as_json: bool) -> None:
    """Explain each KEY, which is a key of a file, a section, or a word of a status.

    Examples of keys are record.time_unit in AXIS.toml, service.window in PLANT.toml and sources.mqtt.qos in PLANT.toml.
    An example of a status is poor_excitation. Without KEY, the command lists all keys of AXIS.toml and all words of a
    status.
    """
    from pmfid.config.explain import entries, explain_entries
    from pmfid.service.plant import plant_entries

    found = _find_all(key, plant) if key else plant_entries() if plant else entries()
    if as_json:
        print_json({"entries": [entry.to_json() for entry in found]})
    else:
        print_text(explain_entries(found))


def _find_all(words: Sequence[str], plant: bool) -> list[ReferenceEntry]:
    """Return the entries of one name in several words, such as "time unit", or otherwise of each word."""
    try:
        return _find_entries(" ".join(words), plant)
    except UsageError:
        if len(words) == 1:
            raise
    return [entry for word in words for entry in _find_entries(word.rstrip(","), plant)]


def _find_entries(word: str, plant: bool) -> list[ReferenceEntry]:
    """Return the entries of a word, only those of PLANT.toml if `plant`. Raises UsageError for an unknown word."""
    from pmfid.config.explain import entries, find
    from pmfid.service.plant import plant_entries, strip_names

    known = plant_entries() if plant else (*entries(), *plant_entries())
    names = {entry.name for entry in known}
    own = [name for name in strip_names(word) if name in names]
    return [entry for entry in known if entry.name in own] if own and word not in names else find(word, known)
