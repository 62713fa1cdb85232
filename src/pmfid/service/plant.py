"""The file PLANT.toml, and the meaning of its keys."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, ValidationError, create_model

from pmfid.config.explain import ReferenceEntry, keys_in
from pmfid.config.model import Name
from pmfid.config.toml_file import FileSection, override_sections, read_toml, validate_sections
from pmfid.errors import UsageError, did_you_mean
from pmfid.service.context import SourceSection
from pmfid.service.sinks.mqtt import MqttSinkSection
from pmfid.service.sinks.queued import SinkSection
from pmfid.service.sinks.webhook import WebhookSection
from pmfid.service.sources.mqtt import MqttSourceSection
from pmfid.service.sources.stdin import StdinSource
from pmfid.service.tuning import TUNING
from pmfid.service.web.config import PageConfig

SOURCES: dict[str, type[SourceSection]] = {
    "mqtt": MqttSourceSection,
    "stdin": StdinSource,
}
SINKS: dict[str, type[SinkSection]] = {
    "mqtt": MqttSinkSection,
    "webhook": WebhookSection,
}
#: Pattern of names of the service, axes, sources and sinks, because these names occur in topics and file names.
_PATTERN = r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}"
Word = Annotated[str, Field(pattern=f"^{_PATTERN}$")]
_WORD = "letters, digits, dots, hyphens and underscores, at most 100, beginning with a letter or a digit"


#: A pattern of names with one number, written "{}", "{:d}", or "{:05d}" for at least five digits.
_NUMBER = re.compile(r"([^{}]*)\{(?::0?(\d?)d)?\}([^{}]*)")


class ServiceSection(FileSection):
    """The section [service] with the name, the state folder, and the waiting times of the service."""

    name: Word = Field("pmfid", description=f"the name of the service: {_WORD}")
    state: Name | None = Field(
        None, description='the folder for checkpoints, for example "state"; without it the service saves nothing'
    )
    checkpoint: float = Field(1.0, ge=0.05, le=3600, description="the time between two checkpoints in s")
    window: float = Field(
        0.5,
        ge=0,
        le=600,
        description="the time for which the service holds early samples until missing ones arrive, in s",
    )
    every: float = Field(
        1.0, ge=0, le=1e6, description="the time between two rows of an axis in the output, in s; 0 writes every row"
    )
    silence: float = Field(
        60.0,
        ge=0,
        le=1e6,
        description=(
            "the time in s without data after which an axis, a source or a sink raises an alarm; 0 raises none"
        ),
    )


class AxisSection(FileSection):
    """[axes.NAME]: one axis."""

    config: Name = Field(description='the AXIS.toml of the axis, for example "cart.toml"')


class FleetSection(FileSection):
    """The section [fleets.NAME] of equal axes, which a pattern names."""

    config: Name = Field(description='the AXIS.toml of all these axes, for example "cell.toml"')
    names: Name = Field(description='a pattern for the names with one number in it, for example "cell-{:05d}"')
    count: int = Field(
        ge=1, le=TUNING.most_axes, description="the number of axes; the first axis has number 0 in its name"
    )

    def expand(self, key: str) -> list[str]:
        """Return the names of the axes. `key` is the name of the section.

        Raises UsageError if the pattern does not give different words.
        """
        number = _NUMBER.fullmatch(self.names)
        if number is None:
            where = f"[fleets.{key}] names = {self.names!r}"
            raise UsageError(f'{where} must be a pattern with one number in it, for example "cell-{{:05d}}"')
        before, digits, after = number.groups()
        return [f"{before}{k:0{int(digits or 0)}d}{after}" for k in range(self.count)]


@dataclass(frozen=True)
class Plant:
    """The content of a PLANT.toml.

    `folder` is the folder of PLANT.toml. `axes` maps names to paths of AXIS.toml. `sources` and `sinks` map names to
    sections.
    """

    folder: Path
    service: ServiceSection
    axes: Mapping[str, Path]
    sources: Mapping[str, SourceSection]
    sinks: Mapping[str, SinkSection] = field(default_factory=dict)
    page: PageConfig = field(default_factory=PageConfig)

    @property
    def state(self) -> Path | None:
        return None if self.service.state is None else self.folder / self.service.state

    def unlike(self, other: Plant) -> list[str]:
        """Return the sections of PLANT.toml that differ from the other plant, except sections of axes."""
        single = [f"[{name}]" for name in ("service", "page") if getattr(self, name) != getattr(other, name)]
        return single + [
            f"[{kind}.{name}]"
            for kind, ours, theirs in (("sources", self.sources, other.sources), ("sinks", self.sinks, other.sinks))
            for name in dict.fromkeys([*ours, *theirs])
            if ours.get(name) != theirs.get(name)
        ]


class SingleSections(FileSection):
    """The sections with one table."""

    service: ServiceSection = ServiceSection()
    page: PageConfig = PageConfig()


#: Sections with a table for each name, and those with a kind in each of these tables.
NAMED: dict[str, type[FileSection]] = {"axes": AxisSection, "fleets": FleetSection}
KINDS: dict[str, Mapping[str, type[FileSection]]] = {"sources": SOURCES, "sinks": SINKS}
_SINGLE = tuple(SingleSections.model_fields)
_KNOWN = (*_SINGLE, *NAMED, *KINDS)


def load_plant(path: Path, given: Mapping[str, object] | None = None) -> Plant:
    """Read and validate a PLANT.toml, or an AXIS.toml as a plant of one axis on standard input.

    The dotted keys `given`, such as "service.every", replace the keys in the file. Raises UsageError with the error and
    its place.
    """
    raw = read_toml(path, "the path of a PLANT.toml")
    if {"record", "model"} & set(raw) and not set(raw) & set(_KNOWN):
        raw = _single_axis(path)
    try:
        _check_tables(raw)
        single = override_sections(SingleSections, {key: raw[key] for key in _SINGLE if key in raw}, given or {})
        tables = {
            group: {name: _section(group, name, table) for name, table in raw.get(group, {}).items()}
            for group in (*NAMED, *KINDS)
        }
        axes = _axes(tables["axes"], tables["fleets"], path.parent)
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from None
    return Plant(path.parent, single.service, axes, tables["sources"], tables["sinks"], single.page)


def _single_axis(path: Path) -> dict[str, object]:
    """Return the plant of one AXIS.toml on standard input. With a single pipe, no sample waits for another."""
    name = re.sub(r"[^A-Za-z0-9._-]|^[._-]+", "", path.stem)[:100] or "axis"
    return {
        "service": {"name": name, "window": 0.0, "every": 0.1},
        "axes": {name: {"config": path.name}},
        "sources": {"input": {"kind": "stdin", "axis": name}},
    }


def _check_tables(raw: Mapping[str, Any]) -> None:
    for key, table in raw.items():
        if key not in _KNOWN:
            raise UsageError(f"[{key}] is an unknown section; known are {', '.join(_KNOWN)}{did_you_mean(key, _KNOWN)}")
        named = key not in _SINGLE
        if not isinstance(table, dict):
            label = f"[{key}.NAME]" if named else f"[{key}]"
            raise UsageError(
                f"{key} must be a section; write its name as {label} on the line above its keys, in single brackets"
            )
        for name, part in table.items() if named else ():
            _check_name(key, name)
            if not isinstance(part, dict):
                raise UsageError(
                    f"[{key}] {name} = {part!r} is outside a named section; write [{key}.NAME] above this line, "
                    "with a name of your choice"
                )
    if not (raw.get("axes") or raw.get("fleets")):
        raise UsageError('the plant has no axis; add a section [axes.NAME] with config = "AXIS.toml"')


def _section(group: str, name: str, table: dict[str, object]) -> Any:
    """Return a table with a name as a section. The `kind` of a source or a sink decides on the section."""
    label, kinds = f"{group}.{name}", KINDS.get(group)
    if kinds is not None and "kind" not in table:
        raise UsageError(f"[{label}] has no kind; give one of {', '.join(kinds)}")
    kind = str(table.get("kind"))
    if kinds is not None and kind not in kinds:
        raise UsageError(f"[{label}] kind = {kind!r} is none of {', '.join(kinds)}{did_you_mean(kind, kinds)}")
    cls = NAMED[group] if kinds is None else kinds[kind]
    try:
        return cls.model_validate(table)
    except ValidationError:
        whole = create_model("Whole", __base__=FileSection, **{label: (cls, ...)})  # type: ignore[call-overload]
        validate_sections(whole, {label: table})
        raise


def _check_name(where: str, name: str) -> None:
    if not re.fullmatch(_PATTERN, name):
        raise UsageError(f"[{where}] {name!r} is not a name; use {_WORD}")


def _axes(single: Mapping[str, AxisSection], fleets: Mapping[str, FleetSection], folder: Path) -> dict[str, Path]:
    axes = {name: folder / section.config for name, section in single.items()}
    for key, fleet in fleets.items():
        names = fleet.expand(key)
        _check_name(f"fleets.{key}", max(names, key=len))
        doubled = next((name for name in names if name in axes), None)
        if doubled is not None:
            raise UsageError(f"[fleets.{key}] uses the name {doubled!r} of another axis; choose another pattern")
        axes.update(dict.fromkeys(names, folder / fleet.config))
    if len(axes) > TUNING.most_axes:
        raise UsageError(f"{len(axes)} axes are too many for one service; divide them among several services")
    return axes


def plant_entries() -> tuple[ReferenceEntry, ...]:
    """Return entries of all keys. Keys of sources and sinks are listed by their kind."""
    models: dict[str, type[FileSection]] = {"service": ServiceSection, "page": PageConfig, **NAMED}
    models |= {f"{group}.{kind}": model for group, kinds in KINDS.items() for kind, model in kinds.items()}
    groups = (keys_in(section, model, "key of PLANT.toml") for section, model in models.items())
    return tuple(entry for group in groups for entry in group)


def strip_names(word: str) -> list[str]:
    """Return the possible keys for a word with a name from a plant.

    For example, axes.x1.config means axes.config, and sources.hall.qos means this key of each kind of source.
    """
    match = re.fullmatch(r"\[?(axes|fleets|sources|sinks)\.[^.\]]+\]?[. ](\w+)", word.strip())
    if match is None:
        return []
    table, key = match.groups()
    return [f"{table}.{kind}.{key}" for kind in KINDS[table]] if table in KINDS else [f"{table}.{key}"]
