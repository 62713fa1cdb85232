"""All methods on one record, or on the records of one transfer function, side by side."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from pmfid.errors import NotIdentifiableError, PmfidError, UsageError
from pmfid.estimators.registry import methods_for
from pmfid.session.config import Axis
from pmfid.session.identify import explain_error, kind_of
from pmfid.session.kinds import Progress, Records
from pmfid.session.result import Result


@dataclass(frozen=True)
class Comparison:
    """Results by method, and the reason for each method without a result; name, samples: of the record or records."""

    name: str
    samples: int
    results: Mapping[str, Result]
    refused: dict[str, str]

    def to_json(self) -> dict[str, object]:
        """The object that `--json` prints."""
        methods: dict[str, object] = {name: result.to_json() for name, result in self.results.items()}
        methods |= {name: {"error": reason} for name, reason in self.refused.items()}
        return {"record": self.name, "samples": self.samples, "methods": methods}


def compare(data: Records, axis: Axis, done: Progress | None = None) -> Comparison:
    """Runs every method with the settings of `axis` on the records that `kind_of(axis).read` gives.

    `done` is called with the part that has run. Raises UsageError as `identify` does, and the first method's error if
    no method succeeds.
    """
    kind, methods = kind_of(axis), methods_for(axis.model.make())
    axis = kind.prepare_axis(data, axis)
    results: dict[str, Result] = {}
    refused: dict[str, PmfidError] = {}
    kind.check(data, axis)
    for count, method in enumerate(methods, 1):
        try:
            results[method] = kind.estimate(data, _with_method(axis, method))
        except (NotIdentifiableError, UsageError) as error:
            refused[method] = error
        if done is not None:
            done(count / len(methods))
    unknown = {method: error for method, error in refused.items() if isinstance(error, NotIdentifiableError)}
    found = kind.check_record(data, axis) if unknown else ()
    errors = refused | {method: explain_error(error, found) for method, error in unknown.items()}
    if not results:
        raise next(iter(errors.values()))
    return Comparison(*kind.name_and_samples(data), results, {method: str(error) for method, error in errors.items()})


def _with_method(axis: Axis, method: str) -> Axis:
    return axis.model_copy(update={"estimator": axis.estimator.model_copy(update={"method": method})})
