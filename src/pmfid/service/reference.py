"""The meaning of every key of PLANT.toml, from the models that validate the file."""

from __future__ import annotations

import re
from collections.abc import Iterator

from pmfid.service.kinds import SINKS, SOURCES
from pmfid.service.plant import AxisSection, FleetSection, ServiceSection
from pmfid.service.web.config import HERE, PORT, PageConfig
from pmfid.session.reference import ReferenceEntry, keys_in, tables

__all__ = ["plant_entries", "plant_page", "strip_names"]

_KEY = "key of PLANT.toml"
_ABOUT = {
    "service": "The service as a whole.",
    "page": f"Without this section there is a page on {HERE}:{PORT}.",
    "axes": "A section for each axis, `[axes.NAME]`.",
    "fleets": "A section for each group of axes that are alike, `[fleets.NAME]`.",
    "sources": 'A section for each source, `[sources.NAME]`, with `kind = "{kind}"`.',
    "sinks": 'A section for each sink, `[sinks.NAME]`, with `kind = "{kind}"`.',
}
_HEAD = """\
# All keys of PLANT.toml

Written by `pmfid explain --plant --page`, from the models that validate the file. `pmfid explain KEY` says the same of
one key, as `pmfid explain service.window`, or `pmfid explain sources.mqtt` of a kind. What a plant is, and how it is
begun: [guide/service.md](guide/service.md); the axes themselves: [axis_toml.md](axis_toml.md).
"""


def plant_entries() -> tuple[ReferenceEntry, ...]:
    """Entries of all keys; keys of sources and sinks stand under their kind."""
    return tuple(_entries())


def _entries() -> Iterator[ReferenceEntry]:
    for section, model in (("service", ServiceSection), ("page", PageConfig)):
        yield from keys_in(section, model, _KEY)
    for section, one in (("axes", AxisSection), ("fleets", FleetSection)):
        yield from keys_in(section, one, _KEY)
    for section, kinds in (("sources", SOURCES), ("sinks", SINKS)):
        for kind, made in kinds.items():
            yield from keys_in(f"{section}.{kind}", made(), _KEY)


def strip_names(word: str) -> list[str]:
    """What a word with a name of someone's plant may mean: axes.x1.config is axes.config, and sources.hall.qos that key
    of each kind."""
    found = re.fullmatch(r"\[?(axes|fleets|sources|sinks)\.[^.\]]+\]?[. ](\w+)", word.strip())
    if found is None:
        return []
    table, key = found.groups()
    kinds = {"sources": list(SOURCES), "sinks": list(SINKS)}.get(table)
    return [f"{table}.{key}"] if kinds is None else [f"{table}.{kind}.{key}" for kind in kinds]


def plant_page() -> str:
    """The page of all keys, in Markdown."""
    return "\n".join([_HEAD, *tables(plant_entries(), _describe_section)])


def _describe_section(section: str) -> str:
    table, _, kind = section.partition(".")
    return f"{_ABOUT[table].format(kind=kind)}\n\n"
