"""TOML files with sections, validated by pydantic models that turn every problem into one clear line.

The description of a field ends the error message about the field. Therefore a description must be a sensible text after
"give ...".
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import ErrorDetails

from pmfid.errors import UsageError, did_you_mean, list_some


class FileSection(BaseModel):
    """A section of a file, or a whole file."""

    # The models are strict, because a string "50" or the value `true` in place of a number is a mistake.
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


Whole = TypeVar("Whole", bound=FileSection)


def load_sections(
    whole: type[Whole],
    path: Path,
    overrides: Mapping[str, object] | None,
    kind: str,
    complete: Callable[[dict[str, object]], None] | None = None,
) -> Whole:
    """Read and validate a file whose sections are the fields of `whole`.

    The dotted keys of `overrides`, such as {"estimator.cutoff": 50.0}, replace the file's values. An override of None
    has no effect. `kind` names the file in the message on an unreadable file, such as "an AXIS.toml". `complete` adds
    derived sections to the sections of the file. Raises UsageError with all problems if the file cannot be read or a
    value is not allowed.
    """
    raw = read_toml(path, kind)
    if complete is not None:
        complete(raw)
    try:
        return override_sections(whole, raw, overrides or {})
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from None


def override_sections(whole: type[Whole], raw: dict[str, object], overrides: Mapping[str, object]) -> Whole:
    """Return the sections of `raw` as an object, after the values of `overrides` have replaced those in `raw`.

    Raises UsageError as `validate_sections` does.
    """
    given = {key: value for key, value in overrides.items() if value is not None}
    for dotted, value in given.items():
        section, _, key = dotted.partition(".")
        table = raw.setdefault(section, {})
        if isinstance(table, dict):
            table[key] = value
    return validate_sections(whole, raw, given)


def validate_sections(
    whole: type[Whole], raw: Mapping[str, object], given: Mapping[str, object] | None = None
) -> Whole:
    """Return the sections of `raw` as an object. `given` are the dotted keys that came as options.

    Raises UsageError with all problems in one text.
    """
    try:
        return whole.model_validate(raw)
    except ValidationError as error:
        # A misspelt key is also a missing key. The misspelling comes first, because it explains the missing key.
        details = sorted(error.errors(), key=lambda detail: detail["type"] != "extra_forbidden")
    # A value that is neither a number nor a name fails twice at one place. Therefore the message has only one text for
    # each place.
    places = {detail["loc"][:2]: detail for detail in details}
    problems = [_problem(whole, detail, raw, given or {}) for detail in list(places.values())[:10]]
    more = [f"and {len(places) - len(problems)} more problems"] if len(places) > len(problems) else []
    raise UsageError("\n  ".join(problems + more))


def read_toml(path: Path, kind: str) -> dict[str, Any]:
    """Return the content of a file. Raises UsageError if the file cannot be read; `kind` says what to give instead."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise UsageError(f"{path}: cannot read the configuration: {error.strerror}; give {kind}") from None
    except UnicodeDecodeError:
        raise UsageError(f"{path}: the configuration is not UTF-8 text; give {kind}") from None
    except (ValueError, RecursionError) as error:  # a number may also have thousands of digits
        raise UsageError(
            f"{path}: not valid TOML: {error}; correct this line, and quote a number with a unit"
        ) from None


def _sections(whole: type[FileSection]) -> dict[str, type[BaseModel]]:
    """Return the model of each section by name."""
    types = {name: field.annotation for name, field in whole.model_fields.items()}
    return {name: cls for name, cls in types.items() if isinstance(cls, type) and issubclass(cls, BaseModel)}


def _problem(
    whole: type[FileSection], error: ErrorDetails, raw: Mapping[str, object], given: Mapping[str, object]
) -> str:
    section, *rest = (str(part) for part in error["loc"][:2])
    label = f"[{section}] {rest[0]}" if rest else f"[{section}]"
    inside = error["loc"][2:]
    if len(inside) > 1 and isinstance(inside[0], int):
        description = str(_sections(whole)[section].model_fields[rest[0]].description)
        return _entry_problem(f"{label}, term {inside[0] + 1}: {inside[1]}", error, description)
    if error["type"] == "extra_forbidden":
        return _unknown(whole, section, rest)
    keys = _sections(whole)[section].model_fields if section in _sections(whole) else {}
    field = keys.get("".join(rest), whole.model_fields[section])
    if error["type"] == "missing":
        return f"{label} is missing; give {field.description}"
    table = raw[section]
    message = error["msg"].removeprefix("Value error, ").replace("Input should", "it should")
    message = message.replace("be a valid tuple", "be a list in brackets")
    if not rest:
        return f"{label}: {message}" if isinstance(table, dict) else f"{label} must be a section of keys"
    value = table[rest[0]] if isinstance(table, dict) else None
    origin = " (given as an option)" if f"{section}.{rest[0]}" in given else ""
    choices = re.findall(r"'([^']*)'", error["msg"]) if error["type"] == "literal_error" else []
    hint = did_you_mean(value, choices) if isinstance(value, str) else ""
    shown = f" = {show_value(value)}" if rest and field.repr else ""  # a secret is not repeated
    return f"{label}{shown}{origin}: {message}; give {field.description}{hint}"


def show_value(value: object) -> str:
    """Return a value as it is written, and an address without user and password."""
    return re.sub(r"//[^/'\"\s]*@", "//...@", repr(value))


def _entry_problem(place: str, error: ErrorDetails, description: str) -> str:
    """Describe the problem of a key in one of several entries, such as the terms of an equation."""
    if error["type"] == "missing":
        return f"{place} is missing; write {description}"
    return f"{place} = {error['input']!r}: {error['msg'].replace('Input should', 'it should')}; write {description}"


def _unknown(whole: type[FileSection], section: str, rest: list[str]) -> str:
    sections = _sections(whole)
    word = rest[0] if rest else section
    home = next((name for name, model in sections.items() if word in model.model_fields), None)
    known = list(sections[section].model_fields) if rest else list(sections)
    what = f"[{section}] {word} is an unknown key" if rest else f"[{section}] is an unknown section or key"
    hint = f"; it belongs in [{home}]" if home else did_you_mean(word, known)
    return f"{what}; known are {list_some(known)}{hint}"
