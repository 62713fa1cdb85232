"""A configuration as a value: frozen, comparable, hashable, and enough to make its object again."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields
from inspect import cleandoc, get_annotations
from typing import TYPE_CHECKING, TypeVar

import numpy as np

if TYPE_CHECKING:
    from _typeshed import DataclassInstance as Configured

#: Where a class keeps its docstring as it was written.
OWN_HELP = "_own_help"
E = TypeVar("E")
C = TypeVar("C", bound="Configured")


@dataclass(frozen=True, eq=False, repr=False)
class ByName(Mapping[str, float]):
    """Numbers by the names of parameters, as a dict that does not change; equal to a dict of the same numbers."""

    pairs: tuple[tuple[str, float], ...]

    def __getitem__(self, name: str) -> float:
        return dict(self.pairs)[name]

    def __iter__(self) -> Iterator[str]:
        return (name for name, _ in self.pairs)

    def __len__(self) -> int:
        return len(self.pairs)

    def __hash__(self) -> int:
        return hash(frozenset(self.pairs))

    def __repr__(self) -> str:
        return repr(dict(self.pairs))


def explain_inherited(cls: type) -> None:
    """Adds the docstrings of the bases with arguments of their own to a class's docstring: `help` of a method then
    explains all that it takes."""
    own = cls.__dict__.get("__doc__")
    if own is None:
        return
    setattr(cls, OWN_HELP, cleandoc(own))
    bases = [base for base in cls.__mro__[1:] if _arguments_of(base)]
    parts = [
        f"As every `{base.__name__}`:\n{base.__dict__.get(OWN_HELP) or cleandoc(base.__doc__ or '')}" for base in bases
    ]
    cls.__doc__ = "\n\n".join([cleandoc(own), *parts])


def _arguments_of(cls: type) -> list[str]:
    """Names of the fields that a class adds by itself."""
    return [name for name, kind in get_annotations(cls).items() if not str(kind).startswith("ClassVar")]


def freeze(estimator: Configured) -> None:
    """Gives an estimator copies that do not change of the lists, arrays and dicts it was made with."""
    for name, value in configuration_of(estimator).items():
        if isinstance(value, Mapping) and not isinstance(value, ByName):
            object.__setattr__(estimator, name, ByName(tuple(value.items())))
        elif isinstance(value, list | np.ndarray):
            object.__setattr__(estimator, name, tuple(value))


def configuration_of(estimator: Configured) -> dict[str, object]:
    """What an estimator was made with, by the names of its arguments."""
    return {field.name: getattr(estimator, field.name) for field in fields(estimator) if field.init}


def construct_estimator(cls: Callable[..., E], configuration: Mapping[str, object]) -> E:
    """A new estimator of a class, without samples."""
    return cls(**configuration)


def change_arguments(estimator: C, changes: Mapping[str, object]) -> C:
    """The same method with some of its arguments changed, without samples: `dataclasses.replace` for a mapping."""
    return construct_estimator(type(estimator), configuration_of(estimator) | dict(changes))


def like(cls: type[C], estimator: Configured, **changes: object) -> C:
    """Another method with all of an estimator's configuration that it has a use for, but for the changes.

    What names parameters (`initial`, `forgetting_of`) goes over with the same model only: another has others.
    """
    taken, given = {field.name for field in fields(cls) if field.init}, configuration_of(estimator)
    kept = {name: value for name, value in given.items() if name in taken}
    if changes.get("model", given["model"]) != given["model"]:
        kept = {name: value for name, value in kept.items() if not isinstance(value, ByName)}
    return construct_estimator(cls, kept | changes)
