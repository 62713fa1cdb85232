"""All methods on one record, or on the records of one transfer function, side by side."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.registry import methods_for
from pmfid.linear.experiment import Experiment
from pmfid.session.config import Axis
from pmfid.session.diagnosis import check_direction, diagnose
from pmfid.session.pipeline import Result, estimate, explained
from pmfid.session.process import ProcessResult, identify_process
from pmfid.session.records import Record


@dataclass(frozen=True)
class Comparison:
    """Results by method, and the reason for each method that has none; name, samples: of the record or records."""

    name: str
    samples: int
    results: Mapping[str, Result | ProcessResult]
    refused: dict[str, str]

    def to_json(self) -> dict[str, object]:
        """The object that `--json` prints."""
        methods: dict[str, object] = {name: result.to_json() for name, result in self.results.items()}
        methods |= {name: {"error": reason} for name, reason in self.refused.items()}
        return {"record": self.name, "samples": self.samples, "methods": methods}


def compare(record: Record, axis: Axis, done: Callable[[float], None] | None = None) -> Comparison:
    """Runs every method with the settings of `axis`; `done` is called with the part that has run. Raises UsageError as
    `identify` does, and NotIdentifiableError where no method has an answer."""
    results: dict[str, Result] = {}
    refused: dict[str, NotIdentifiableError] = {}
    mistake = check_direction(record, axis)
    if mistake:
        raise UsageError(mistake)
    methods = methods_for(axis.model.make())
    for count, method in enumerate(methods, 1):
        try:
            results[method] = estimate(record, _with_method(axis, method))
        except NotIdentifiableError as error:
            refused[method] = error
        if done is not None:
            done(count / len(methods))
    mistake = diagnose(record, axis) if refused else ""
    reasons = _reasons(results, {method: explained(error, mistake) for method, error in refused.items()})
    return Comparison(record.name, int(record.u.size), results, reasons)


def compare_processes(
    experiments: Sequence[Experiment], axis: Axis, done: Callable[[float], None] | None = None
) -> Comparison:
    """The same for a transfer function, where some methods do not take every record. Raises what the first method
    raised where none has an answer."""
    results: dict[str, ProcessResult] = {}
    refused: dict[str, Exception] = {}
    methods = methods_for(axis.model.make())
    for count, method in enumerate(methods, 1):
        try:
            results[method] = identify_process(experiments, _with_method(axis, method))
        except (NotIdentifiableError, UsageError) as error:
            refused[method] = error
        if done is not None:
            done(count / len(methods))
    name = ", ".join(experiment.name for experiment in experiments)
    return Comparison(name, sum(part.u.size for part in experiments), results, _reasons(results, refused))


def _with_method(axis: Axis, method: str) -> Axis:
    return axis.model_copy(update={"estimator": axis.estimator.model_copy(update={"method": method})})


def _reasons(results: Mapping[str, object], refused: Mapping[str, Exception]) -> dict[str, str]:
    if not results:
        raise next(iter(refused.values()))
    return {method: str(error) for method, error in refused.items()}
