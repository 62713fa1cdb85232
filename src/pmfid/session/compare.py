"""All methods on one record, side by side."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pmfid.errors import NotIdentifiableError
from pmfid.estimators.registry import methods_for
from pmfid.session.config import Axis
from pmfid.session.pipeline import Result, identify
from pmfid.session.records import Record


@dataclass(frozen=True)
class Comparison:
    """Results by method, and the reason for each method that has none."""

    record: Record
    results: dict[str, Result]
    refused: dict[str, str]

    def to_json(self) -> dict[str, Any]:
        """The object that `--json` prints."""
        methods: dict[str, Any] = {name: result.to_json() for name, result in self.results.items()}
        methods |= {name: {"error": reason} for name, reason in self.refused.items()}
        return {"record": self.record.name, "samples": int(self.record.u.size), "methods": methods}


def compare(record: Record, axis: Axis, done: Callable[[str], None] | None = None) -> Comparison:
    """Runs every method with the settings of `axis`; `done` is called with each name. Raises UsageError as `identify`
    does, and NotIdentifiableError where no method has an answer."""
    results: dict[str, Result] = {}
    refused: dict[str, str] = {}
    for method in methods_for(axis.model.make()):
        estimator = axis.estimator.model_copy(update={"method": method})
        try:
            results[method] = identify(record, axis.model_copy(update={"estimator": estimator}))
        except NotIdentifiableError as error:
            refused[method] = str(error)
        if done is not None:
            done(method)
    if not results:
        raise NotIdentifiableError(next(iter(refused.values())))
    return Comparison(record, results, refused)
