"""The kinds of plant, with the interface for their records, estimates and checks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import ClassVar, Generic, TypeVar

from pmfid.config.axis import Axis
from pmfid.diagnostics.free_run import FreeRun
from pmfid.encoder import Encoder
from pmfid.errors import UsageError
from pmfid.estimators.auto import AUTO
from pmfid.estimators.base import Estimator
from pmfid.estimators.motion_fit import MotionFit
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.sample_steps import SampleSteps
from pmfid.estimators.srivc import SRIVC
from pmfid.findings import Finding
from pmfid.io.tables import Table
from pmfid.linear.experiment import Experiment
from pmfid.models.drive import Model
from pmfid.pipeline.result import Result
from pmfid.pipeline.stored import Stored
from pmfid.records.record import Record
from pmfid.types import Floats

#: Callback with the completed part of the work, from 0 to 1.
Progress = Callable[[float], None]

Data = TypeVar("Data")
#: Data that a kind of plant reads.
Records = Record | Sequence[Experiment]


class Kind(ABC, Generic[Data]):
    """A kind of plant, which reads, estimates and checks its records.

    `Data` is the type of the records, which is a machine's record or a transfer function's experiments.
    """

    #: Recursive method that replaces "auto" in firmware.
    on_line: ClassVar[str]

    @abstractmethod
    def read(self, paths: Sequence[Path], axis: Axis) -> Data:
        """Read the records at `paths`. Raises UsageError for files without such records, or for too many files."""

    @abstractmethod
    def read_table(self, table: Table, axis: Axis) -> Data:
        """Read the records from a table of columns. Raises UsageError as `read` does."""

    def prepare_axis(self, data: Data, axis: Axis) -> Axis:
        """Return the configuration with values for all settings that the record determines."""
        return axis

    def settle_axis(self, data: Data, axis: Axis) -> Axis:
        """Return the configuration with values for all settings that the estimate needs."""
        return self.prepare_axis(data, axis)

    @abstractmethod
    def estimate(self, data: Data, axis: Axis, progress: Progress | None = None) -> Result:
        """Return the result of the configured method.

        Raises UsageError for a method that does not support the model or the data, and NotIdentifiableError if the data
        cannot identify every parameter.
        """

    @abstractmethod
    def name_and_samples(self, data: Data) -> tuple[str, int]:
        """Return the name of the records and their number of samples."""

    @abstractmethod
    def free_runs(self, data: Data, axis: Axis, theta: Floats) -> list[FreeRun]:
        """Return simulations of the model with parameters theta (p,), and the measured outputs.

        The parameters have the order of `parameters_of`. Raises UsageError if the model cannot be simulated.
        """

    @abstractmethod
    def check_known(self, stored: Stored, data: Data, axis: Axis) -> None:
        """Raise UsageError if the parameters of a file were estimated with other known values."""

    def unit_of_output(self, axis: Axis) -> str:
        """Return the unit of the output, or an empty text if the user defines it."""
        return ""

    def check_on_line(self, axis: Axis) -> None:
        """Raise UsageError for settings that a drive cannot follow sample by sample."""

    def check_record(self, data: Data, axis: Axis) -> tuple[Finding, ...]:
        """Return possible mistakes in the log."""
        return ()


def parameters_of(model: Model) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return names and units of the parameters (p,) with which the model is simulated.

    Raises UsageError for an equation that cannot be simulated.
    """
    equation = model.equation
    if all(method.refuses(equation) for method in (MotionFit, SRIVC)):
        reason = equation.without_simulation
        raise UsageError(f"a free run cannot simulate this equation, because {reason}; change the equation")
    further = tuple(zip(*equation.further, strict=True)) or ((), ())
    return equation.names + further[0], equation.units + further[1]


def make_method(
    cls: type[Estimator], axis: Axis, encoder: Encoder, dt: float, steps: SampleSteps | None = None
) -> Estimator:
    """Return a method with the model and the options of a configuration, for samples every dt [s]."""
    config = axis.estimator
    made = cls(
        axis.model.make(),
        encoder,
        dt,
        config.pole,
        order=config.order,
        discretization=config.discretization,
        prefilter_zeros=config.prefilter_zeros,
        precision=config.precision,
        steps=steps,
    )
    return replace(made, forgetting=config.forgetting) if isinstance(made, RecursiveEstimator) else made


def method_of(axis: Axis, automatic: str) -> str:
    """Return the configured method, or the first method of "auto"."""
    return automatic if axis.estimator.method == AUTO else axis.estimator.method
