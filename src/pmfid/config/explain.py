"""The meaning of every key of AXIS.toml and of every word of a status.

Keys come from the models that validate them, and words come from the tables that define them. No text is written twice.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from types import NoneType, UnionType
from typing import Annotated, Literal, Union, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt
from pydantic import BaseModel, WrapValidator
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from pmfid.config.axis import _KEYS_OF_ONE_KIND, Axis
from pmfid.config.model import keys_of
from pmfid.diagnostics.matter import FLAGS
from pmfid.errors import UsageError, did_you_mean
from pmfid.models.drive import Drive
from pmfid.models.transfer_function import TransferFunction
from pmfid.status import ADVICE, Status

#: Pattern of the units in descriptions, which also end error messages.
_UNITS = re.compile(
    r"\bin (?:the )?(rad/s|1/s|unit of y per s|unit of y|s|hours|N per unit of u|whole samples)\b"
    r"|\b(unit of y per count|unit of y)\b"
)
_PLAIN: dict[object, str] = {str: "text", float: "number", bool: "true or false", int: "whole number"}
_LIMITS = {Gt: (">", "gt"), Ge: (">=", "ge"), Lt: ("<", "lt"), Le: ("<=", "le")}
_KEY = "key of AXIS.toml"
STATUS = (
    "The status lists each finding that may move a parameter beyond its error bar and the tolerance. The word none "
    "stands for no such finding. pmfid explain WORD describes a word."
)


@dataclass(frozen=True)
class ReferenceEntry:
    """A key of a file, or a word of a status.

    `name` includes the section. `what` says whether it is a key or a word. `kind`, `unit` and `default` belong to a
    key, or are empty. `models` are the kinds of model that use the key, or an empty text for all kinds. `meaning` is a
    sentence.
    """

    name: str
    what: str
    meaning: str
    kind: str = ""
    unit: str = ""
    default: str = ""
    models: str = ""

    @property
    def section(self) -> str:
        return self.name.rpartition(".")[0]

    @property
    def called(self) -> tuple[str, str, str]:
        """The name with its section, the name alone, and the section."""
        return self.name, self.name.rpartition(".")[2], self.section

    @property
    def text(self) -> str:
        """The entry as text with several lines."""
        if not self.kind:
            return f"{self.name}: {self.what}\n  {self.meaning}"
        rows = {"type": self.kind, "unit": self.unit, "default": self.default, "only with": self.models}
        head = f"[{self.section}] {self.name.rpartition('.')[2]}: {self.meaning}"
        return "\n".join([head, *(f"  {label}: {value}" for label, value in rows.items() if value)])

    def to_json(self) -> dict[str, object]:
        """Return the object that `--json` prints."""
        return {key: value for key, value in vars(self).items() if value}


def entries() -> tuple[ReferenceEntry, ...]:
    """Return the entries of all keys in the order of the file, followed by those of all words of a status."""
    sections = ((name, field) for name, field in Axis.model_fields.items())
    keys = [key for name, field in sections for key in keys_in(name, field.annotation)]
    bits = {str(bit.name).lower(): ADVICE[bit] for bit in Status}
    words = [ReferenceEntry(name, "status of a sample and of an estimate", meaning) for name, meaning in bits.items()]
    words = [ReferenceEntry("status", "line of every result", STATUS), *words]
    return (*keys, *words, *(ReferenceEntry(name, "status of an estimate", meaning) for name, meaning in FLAGS.items()))


def keys_in(section: str, annotation: object, what: str = _KEY) -> Iterator[ReferenceEntry]:
    """Yield the entries of a section with the given type, and of the tables inside the section. `what` is the kind
    of the entries.
    """
    for model in _models_in(annotation):
        for name, own in model.model_fields.items():
            described, default = own.description or "", own.default
            usual = "none" if default is None else "required" if default is PydanticUndefined else _toml(default)
            yield ReferenceEntry(
                f"{section}.{name}",
                what,
                described,
                _kind(own.annotation, own.metadata),
                _unit(described),
                usual,
                _models(section, name),
            )
            yield from keys_in(f"{section}.{name}", own.annotation, what)


def _models_in(annotation: object) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models_in(part)]


def _kind(annotation: object, metadata: Sequence[object] = ()) -> str:
    """Return the type in words, with its limits."""
    bare = [mark for mark in metadata if not isinstance(mark, WrapValidator)]
    if len(bare) < len(metadata):
        return f"{_kind(annotation, bare)} or text with a unit"
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        further = [part for info in parts[1:] for part in (info.metadata if isinstance(info, FieldInfo) else [info])]
        return _kind(parts[0], [*metadata, *further])
    if origin is Literal:
        return " or ".join(json.dumps(value) for value in parts)
    if origin in (Union, UnionType):
        return " or ".join(dict.fromkeys(_kind(part, metadata) for part in parts if part is not NoneType))
    if origin is tuple:
        own = [part for part in parts if part is not Ellipsis]
        inside = _kind(own[0])
        return f"list of {inside}" + (f", {len(own)} of them" if len(own) == len(parts) else "")
    if origin is dict:
        return f"table of {_kind(parts[1])} by name"
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return "table"
    marks = [(mark, *_LIMITS[type(mark)]) for mark in metadata if type(mark) in _LIMITS]
    limits = [f"{sign} {getattr(mark, name):g}" for mark, sign, name in marks if annotation in (float, int)]
    return " ".join([_PLAIN.get(annotation, str(annotation)), ", ".join(limits)]).strip()


def _unit(description: str) -> str:
    found = _UNITS.search(description)
    return (found[1] or found[2]).removeprefix("whole ") if found else ""


def _toml(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, BaseModel):
        value = dict(value)
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{key} = {_toml(item)}' for key, item in value.items())} }}" if value else "{}"
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(_toml, value))}]"
    return f'"{value}"' if isinstance(value, str) else f"{value:g}" if isinstance(value, float) else str(value)


def _models(section: str, name: str) -> str:
    for own, key, of_process in _KEYS_OF_ONE_KIND:
        if (own, key) == (section, name):
            return 'kind = "transfer_function"' if of_process else 'kind = "drive" or "equation"'
    if section != "model" or name == "kind":
        return ""
    lists = {"drive": keys_of(Drive), "transfer_function": keys_of(TransferFunction)}
    lists["equation"] = ("unknown", "known", "dead_time", "lag")
    kinds = [kind for kind, keys in lists.items() if name in keys]
    return "" if len(kinds) == len(lists) else "kind = " + " or ".join(f'"{kind}"' for kind in kinds)


def find(word: str, known: Sequence[ReferenceEntry] | None = None) -> list[ReferenceEntry]:
    """Return the entries for a word among `known`, by default those of AXIS.toml.

    A word is a key with or without its section, a whole section, or a word of a status. A word may have spaces in place
    of underscores. Raises UsageError with similar words.
    """
    wanted = re.sub(r"^\[(.+)\]\s*", r"\1.", word.strip()).rstrip(".").replace(" ", "_").replace("-", "_").lower()
    known = entries() if known is None else known
    if found := [entry for entry in known if wanted and wanted in entry.called]:
        return found
    hint = did_you_mean(wanted, dict.fromkeys(name for entry in known for name in entry.called if name))
    raise UsageError(f"no key or word is called {word!r}: pmfid explain without a key lists them all{hint}")


def explain_entries(found: Sequence[ReferenceEntry]) -> str:
    """Return the entries as text, with all details of a few entries or a list of many."""
    if len(found) <= 4:
        return "\n\n".join(entry.text for entry in found)
    width = max(len(entry.name) for entry in found)
    return "\n".join(f"{entry.name:{width}}  {entry.meaning}" for entry in found)
