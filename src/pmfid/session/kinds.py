"""What is particular to a kind of plant, as an object of that kind."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import ClassVar, Generic, TypeVar

from pmfid.estimators.auto import AUTO
from pmfid.estimators.base import Estimator
from pmfid.estimators.output_error import OE
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.session.config import Axis
from pmfid.session.records import Record
from pmfid.session.result import Result
from pmfid.transfer.experiment import Experiment

#: Called with the part of the work that is done, 0 to 1.
Progress = Callable[[float], None]

Data = TypeVar("Data")
#: What some kind of plant reads.
Records = Record | Sequence[Experiment]


class Kind(ABC, Generic[Data]):
    """A kind of plant: how its records are read, estimated from, and what a mistake in them looks like. `Data` is what
    it reads: one record of a machine, or the experiments of one transfer function."""

    #: what "auto" is on a drive, sample by sample
    on_line: ClassVar[str]

    @abstractmethod
    def read(self, paths: Sequence[Path], axis: Axis, quantize: float | None = None) -> Data:
        """The records at `paths`. Raises UsageError for what is no such record, or too many of them."""

    @abstractmethod
    def estimate(self, data: Data, axis: Axis, progress: Progress | None = None) -> Result:
        """The result of the method that is configured. Raises UsageError for a method that cannot take the model or the
        data and NotIdentifiableError where they cannot identify every parameter."""

    @abstractmethod
    def name_and_samples(self, data: Data) -> tuple[str, int]:
        """Of the record, or of all of them."""

    def check(self, data: Data, axis: Axis) -> None:
        """Raises UsageError for what makes every estimate wrong."""

    def check_on_line(self, axis: Axis) -> None:
        """Raises UsageError for what a record may have and a drive, sample by sample, has not."""

    def mistake(self, data: Data, axis: Axis) -> str:
        """What a log may have got wrong, with its remedy; empty where nothing is found."""
        return ""


def settings(axis: Axis, cls: type[Estimator]) -> dict[str, object]:
    """The options of [estimator] that a method has, by name."""
    config = axis.estimator
    options: dict[str, object] = {"order": config.order, "discretization": config.discretization}
    options |= {"precision": config.precision, "prefilter_zeros": config.prefilter_zeros}
    if issubclass(cls, OE):
        options |= {"window": config.window}
    if issubclass(cls, RecursiveEstimator):
        options |= {"forgetting": config.forgetting, "forgetting_scheme": config.forgetting_scheme}
    return options


def method_of(axis: Axis, automatic: str) -> str:
    """The configured method, or what "auto" begins with."""
    return automatic if axis.estimator.method == AUTO else axis.estimator.method
