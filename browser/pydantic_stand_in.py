"""The part of pydantic that pmfid's configuration needs, for the page in the browser.

PyPI has no pydantic-core for this Pyodide. The page builds the configuration itself, so that ranges and types need no
check here. Validators run, because units and kinds of axis come from them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from inspect import get_annotations
from types import SimpleNamespace
from typing import Any, NamedTuple, Self, get_args, get_type_hints

PydanticUndefined = object()
ErrorDetails = dict
ConfigDict = dict


class ValidationError(ValueError):
    """Never raised here."""


class AfterValidator(NamedTuple):
    """A function of the value after the check of its type."""

    change: Callable[[Any], Any]


class WrapValidator(NamedTuple):
    """A function of the value and the check of its type."""

    change: Callable[[Any, Callable[[Any], Any]], Any]


class FieldInfo(SimpleNamespace):
    """The facts of a field."""

    __hash__ = object.__hash__  # Python 3.11 hashes the parts of a type


def Field(default: object = PydanticUndefined, **facts: Any) -> Any:
    """Return the facts of a field."""
    return FieldInfo(default=default, **facts)


def PrivateAttr(default: object) -> Any:
    """Return the first value of an attribute that is no field."""
    return default


def model_validator(mode: str) -> Callable[[Callable[[Any], Any]], Callable[[Any], Any]]:
    """Mark a method that runs on the complete object."""

    def mark(method: Callable[[Any], Any]) -> Callable[[Any], Any]:
        method.runs_after = True
        return method

    return mark


class BaseModel:
    """An object with the fields of its annotations."""

    model_fields: dict[str, Any]

    def __init_subclass__(cls) -> None:
        cls.model_fields = dict(getattr(cls, "model_fields", {}))
        for name in (name for name in get_annotations(cls) if not name.startswith("_")):
            given = cls.__dict__.get(name, PydanticUndefined)
            cls.model_fields[name] = given if isinstance(given, FieldInfo) else Field(given)

    def __init__(self, **values: object) -> None:
        types = get_type_hints(type(self), include_extras=True)
        for name, field in self.model_fields.items():
            self.__dict__[name] = _validated(types[name], values[name]) if name in values else field.default
        self.__dict__["model_fields_set"] = set(values)
        for name in dir(type(self)):
            if getattr(getattr(type(self), name), "runs_after", False):
                getattr(self, name)()

    def __iter__(self) -> Iterator[tuple[str, object]]:
        return ((name, getattr(self, name)) for name in self.model_fields)

    @classmethod
    def model_validate(cls, raw: Mapping[str, object]) -> Self:
        """Return an object with the values of `raw`."""
        return cls(**raw)

    def model_copy(self, update: Mapping[str, object]) -> Self:
        """Return a copy with other values."""
        copy = object.__new__(type(self))
        copy.__dict__.update({**self.__dict__, **update})
        return copy


def _validated(kind: object, value: object) -> object:
    """Return a value after the validators of its type."""
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return value if isinstance(value, kind) else kind.model_validate(value)
    return None if value is None else _check_of(kind)(value)


def _check_of(kind: object) -> Callable[[Any], Any]:
    """Return the validators of a type as one function. Of an annotated type, each validator contains those before."""
    check: Callable[[Any], Any] = lambda value: value  # noqa: E731
    for part in get_args(kind):
        if isinstance(part, AfterValidator):
            check = partial(lambda own, inner, value: own(inner(value)), part.change, check)
        elif isinstance(part, WrapValidator):
            check = partial(lambda own, inner, value: own(value, inner), part.change, check)
        elif get_args(part):
            check = partial(lambda own, inner, value: own(inner(value)), _check_of(part), check)
    return check
