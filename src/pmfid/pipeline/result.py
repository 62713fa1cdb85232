"""The result of an identification, with parameters, intervals and findings."""

from __future__ import annotations

import math
import re
from abc import abstractmethod
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from pmfid.diagnostics.drives import recent
from pmfid.diagnostics.free_run import FreeRun, drive_run
from pmfid.diagnostics.matter import Matter, weigh_findings
from pmfid.diagnostics.processes import Assessment
from pmfid.errors import place_of
from pmfid.estimators.base import Estimator
from pmfid.estimators.configuration import like
from pmfid.estimators.known import Known, choose_naming
from pmfid.estimators.motion_fit import MotionFit
from pmfid.estimators.results import Fit, Track
from pmfid.estimators.sample_steps import SampleSteps
from pmfid.findings import Finding, Judged, sort_findings, texts
from pmfid.fit.compare import NORMAL_95
from pmfid.fit.second_mass import SecondMass
from pmfid.fit.weighing import WeighedForce
from pmfid.linear.experiment import Experiment
from pmfid.linear.process import Process
from pmfid.models.controllers import MotorAndLoad
from pmfid.models.transfer_function import TransferFunction
from pmfid.models.two_mass import Coupling, couple
from pmfid.presentation import Parameters, Presentable, Summary, plain_dict
from pmfid.records.record import Record
from pmfid.types import Floats

UNKNOWN = "–"
#: Columns whose cells contain spaces and may need several lines.
FOLDED = ("model spread", "95 %")


def parameter_header(result: Result) -> tuple[str, ...]:
    """Return the names of the columns of `parameter_rows`."""
    return ("parameter", "value", "std", *(FOLDED[1:] if result.model_spread is None else FOLDED), "unit")


def parameter_rows(result: Result) -> list[list[str]]:
    """Return one row of text for each parameter. For a machine, the row includes the model spread."""
    known = {name: f" ({kind})" for name, kind in result.beforehand.items()}
    names, units = [name + known.get(name, "") for name in result.names], result.units
    found = zip(names, result.theta, result.theta_std, _list_intervals(result), units, strict=True)
    return [
        [name, format_value(value, std), f"{std:.2g}", *interval, unit] for name, value, std, interval, unit in found
    ]


def findings_lines(result: Result, notes: bool) -> list[str]:
    """Return the findings that are notes, or all others, as paragraphs, most important first."""
    return [finding.paragraph for finding in result.findings if (finding.severity == "note") == notes]


def format_value(value: float, std: float) -> str:
    """Return a number with as many digits as its standard error has in two digits."""
    if not (std > 0 and math.isfinite(std) and value != 0):
        return f"{value:.6g}"
    digits = 2 + math.floor(math.log10(abs(value))) - math.floor(math.log10(float(f"{std:.2g}")))
    return f"{value:#.{min(max(digits, 1), 15)}g}".rstrip(".").replace(".e", "e")


def format_short(value: float, std: float) -> str:
    """Return a number with its standard error in units of the last digit, such as 3.2001(5)e-04."""
    text = format_value(value, std)
    if not (std > 0 and math.isfinite(std)):
        return text
    number, _, exponent = text.partition("e")
    decimals = len(number.partition(".")[2])
    last = round(std / 10.0 ** (int(exponent or 0) - decimals))
    return f"{number}({last})" + (f"e{exponent}" if exponent else "")


def format_interval(low: float, high: float) -> str:
    """Return an interval as text, with the digits that its width needs and at least five digits."""
    width, size = high - low, max(abs(low), abs(high))
    digits = 5 if not width > 0 else max(5, min(15, 2 + math.ceil(math.log10(size / width))))
    return f"{low:.{digits}g} to {high:.{digits}g}"


def _list_intervals(result: Result) -> list[list[str]]:
    """Return the cells of each parameter for the model spread, if the result has one, and for the interval."""
    intervals = [format_interval(low, high) if np.isfinite(low) else UNKNOWN for low, high in result.interval_95]
    if result.model_spread is None:
        return [[interval] for interval in intervals]
    spreads = [f"{spread:.2g}" if np.isfinite(spread) else UNKNOWN for spread in result.model_spread]
    return [list(cells) for cells in zip(spreads, intervals, strict=True)]


@dataclass(frozen=True, eq=False, repr=False)
class Result(Presentable, Judged):
    """The parameters of a plant, their uncertainty, and the findings on them.

    Attributes
    ----------
    estimator : Estimator
        The estimator, with the names and units of the parameters.
    theta : ndarray (p,)
        Parameters, for example `result["mass"]`.
    theta_std : ndarray (p,)
        Standard deviations of errors that vary from record to record.
    findings : tuple of Finding
        Findings on the parameters and the record, most important first. The codes of the findings are in `status`.
    model_spread : ndarray (p,), optional
        For machines, the root mean square change of the parameters by unmodelled effects. NaN stands for an unknown
        change, for example if the equation cannot be simulated.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid import Drive, Encoder, identify, quantize
    >>> from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, prbs, simulate_drive
    >>> u = prbs(1500, clock=10, amplitude=4.0, rng=np.random.default_rng(1))
    >>> counts = quantize(simulate_drive(CART, u, CART_DT).x, CART_RESOLUTION)
    >>> settings = {"model": Drive(CART.input_gain), "dt": CART_DT, "encoder": Encoder(CART_RESOLUTION)}
    >>> result = identify(u, counts, cutoff=20.0, method="iv", **settings)
    >>> dict(zip(result.names, result.units))
    {'mass': 'kg', 'viscous_friction': 'N s/m', 'coulomb_friction': 'N'}
    """

    estimator: Estimator
    theta: Floats
    theta_std: Floats
    findings: tuple[Finding, ...]
    model_spread: Floats | None = field(default=None, kw_only=True)

    @property
    def notes(self) -> tuple[str, ...]:
        """The findings as sentences for people."""
        return texts(self.findings)

    def with_findings(self, *further: Finding) -> Self:
        """Return the result with further findings."""
        return replace(self, findings=sort_findings((*further, *self.findings)))

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the parameters (p,), including an estimated input gain."""
        return self.estimator.names

    @property
    def units(self) -> tuple[str, ...]:
        return self.estimator.units

    @property
    def beforehand(self) -> dict[str, str]:
        """The kind of prior information for each parameter, "given" or "prior"."""
        return {}

    @property
    def two_masses(self) -> MotorAndLoad | None:
        """The two masses for transfer functions, controllers and MuJoCo; None for other models."""
        return None

    @property
    def interval_95(self) -> Floats:
        """The intervals (p, 2) that hold the parameters in 95 % of the records.

        The intervals of a machine include the model spread, and are NaN if it is unknown. The intervals of a transfer
        function cover random errors. The interval of a positive mass or friction does not extend below zero.
        """
        spread = 0.0 if self.model_spread is None else self.model_spread
        half = NORMAL_95 * np.hypot(self.theta_std, spread)
        positive = np.zeros(self.theta.size, dtype=bool)
        positive[: len(self.estimator.equation.names)] = self.estimator.equation.positive
        low = self.theta - half
        return np.column_stack([np.where(positive & (self.theta > 0) & (low < 0), 0.0, low), self.theta + half])

    @property
    @abstractmethod
    def name(self) -> str:
        """The name of the record, or the names of all records."""

    @property
    @abstractmethod
    def samples(self) -> int:
        """The number of samples of the output."""

    @abstractmethod
    def particulars(self) -> dict[str, object]:
        """The entries of `to_dict` that belong only to the present kind of result."""

    def __getitem__(self, name: str) -> float:
        """Return one parameter. Raises UnknownParameterError, a KeyError that lists the names."""
        return float(self.theta[place_of(name, self.names)])

    def __str__(self) -> str:
        """Return a line for each parameter, and then the status and the findings."""
        lines = [self.title, *(f"  {line}" for line in self._lines)]
        lines += [f"  {line}" for line in self._list_interval_lines()]
        return "\n".join([*lines, *self._remarks])

    @property
    def title(self) -> str:
        return f"{self.name}: {self.estimator.method}, {self.samples} samples"

    @property
    def _lines(self) -> list[str]:
        """A line of text for each parameter."""
        known = {name: f" ({kind})" for name, kind in self.beforehand.items()}
        lines = Parameters(self.names, self.units, self.theta, self.theta_std).lines
        return [line + known.get(name, "") for name, line in zip(self.names, lines, strict=True)]

    @property
    def _remarks(self) -> list[str]:
        """The status, and one line for each finding."""
        status = [f"status: {', '.join(self.status)}"] if self.status else []
        return [*status, *(finding.line for finding in self.findings)]

    def summary(self) -> Summary:
        return Summary(self.title, parameter_header(self), parameter_rows(self), self._lines, self._remarks)

    def columns(self) -> dict[str, object]:
        """The columns of a table with one row for each parameter, with low and high of the 95 % interval. For a
        machine, the columns include model_spread."""
        columns = Parameters(self.names, self.units, self.theta, self.theta_std).columns
        spread = {} if self.model_spread is None else {"model_spread": self.model_spread}
        low, high = self.interval_95.T
        return columns | spread | {"low": low, "high": high}

    def _list_interval_lines(self) -> list[str]:
        """Return one line for each parameter with a known interval."""
        kind, spreads = "95 %", [""] * len(self.names)
        if self.model_spread is not None:
            kind = "95 % with unmodelled effects"
            spreads = [f" (model spread {spread:.2g})" for spread in self.model_spread]
        rows = zip(self.names, self.interval_95, spreads, strict=True)
        return [
            f"{kind}: {name} {low:.6g} to {high:.6g}{spread}" for name, (low, high), spread in rows if np.isfinite(low)
        ]

    def to_dict(self) -> dict[str, object]:
        """Return the object that `--json` prints. An unknown interval or spread is None."""
        estimator, parameters = self.estimator, dict[str, dict[str, object]]()
        for k, (name, unit) in enumerate(zip(self.names, self.units, strict=True)):
            spread = {} if self.model_spread is None else {"model_spread": self.model_spread[k]}
            interval = self.interval_95[k] if np.all(np.isfinite(self.interval_95[k])) else None
            parameters[name] = {"value": self.theta[k], "std": self.theta_std[k], "unit": unit, **spread}
            parameters[name]["interval_95"] = interval
        return plain_dict(
            {
                "model": estimator.model.kind,
                "method": estimator.method,
                "samples": self.samples,
                "dt": estimator.dt,
                "cutoff": estimator.cutoff,
                "parameters": parameters,
                **self.particulars(),
                "status": self.status,
                "notes": self.notes,
                "findings": [finding.to_json() for finding in self.findings],
            }
        )


@dataclass(frozen=True, eq=False, repr=False)
class DriveResult(Result):
    """The result of a machine with friction.

    `relative_error` belongs to the filtered equation at theta. `fit` or `track` holds details of an off-line or a
    recursive method, without prior information. `known` is the prior information. `matter` says how far unmodelled
    effects may move the parameters, which decides the status. `forces` are those that the fit compared.
    `explained` says whether a motion leaves rounding or white noise alone. `second` is a second mass that explains the
    record better.
    """

    record: Record
    relative_error: float
    matter: Matter
    fit: Fit | None = None
    track: Track | None = None
    known: Known | None = None
    forces: tuple[WeighedForce, ...] = ()
    explained: bool = False
    second: SecondMass | None = None

    def with_findings(self, *further: Finding) -> Self:
        return super().with_findings(*weigh_findings(further, self.matter))

    @property
    def names(self) -> tuple[str, ...]:
        return choose_naming(self.estimator, self.known).names

    @property
    def units(self) -> tuple[str, ...]:
        own = choose_naming(self.estimator, self.known).units
        return tuple(_LENGTH.sub("count", _MASSES.get(one, one)) for one in own) if self.record.in_counts else own

    @property
    def beforehand(self) -> dict[str, str]:
        if self.known is None:
            return {}
        return dict.fromkeys(self.known.given, "given") | dict.fromkeys(self.known.prior, "prior")

    @property
    def name(self) -> str:
        return self.record.name

    @property
    def samples(self) -> int:
        return int(self.record.u.size)

    def free_run(self) -> FreeRun:
        """Return the motion that the input alone gives at the last parameters, next to the measured one.

        With forgetting, the run covers the last three memories. Raises UsageError if the parameters allow no motion.
        """
        record, method = self.record, like(MotionFit, self.estimator)
        part = recent(self.estimator, record.u.size)
        steps = None if record.steps is None else SampleSteps(record.steps.before[part])
        theta, there = self.theta[: len(method.names)], np.isfinite(record.u[part])
        there = there if record.there is None else there & record.there[part]
        return drive_run(replace(method, steps=steps), theta, record.u[part], record.counts[part], record.name, there)

    @property
    def coupling(self) -> Coupling | None:
        """Resonance, damping and inertia ratio of two masses; None for one mass, and for masses with play."""
        equation = self.estimator.equation
        if len(equation.second) != 5 or self.fit is None:
            return None
        names = (equation.names[equation.leading], *(equation.second[i][0] for i in (0, 3, 4)))
        index = [self.names.index(name) for name in names]
        spread = 0.0 if self.model_spread is None else np.diag(self.model_spread[index] ** 2)
        return couple(self.theta[index], self.fit.theta_cov[np.ix_(index, index)] + spread)

    @property
    def two_masses(self) -> MotorAndLoad | None:
        equation = self.estimator.equation
        if len(equation.second) != 5:
            return None
        mass, *friction = equation.role_values(self.theta)[:5]
        load, viscous, coulomb, stiffness, damping = (self[name] for name, _ in equation.second)
        far = load, viscous, coulomb, stiffness, damping, equation.motion.travel == "rad"
        return MotorAndLoad(mass, sum(friction[:2]) / 2, sum(friction[2:]) / 2, *far)

    def particulars(self) -> dict[str, object]:
        beforehand: dict[str, object] = {}
        if self.known is not None:
            beforehand = {"given": self.known.given, "prior": self.known.prior}
        return {
            "equation": self.estimator.equation.text,
            "input_gain": self.estimator.equation.input_gain,
            "fit": {"relative_error": self.relative_error},
            **({} if self.coupling is None else {"coupling": self.coupling.to_json()}),
            "prefilter_zeros": self.estimator.zeros,
            **beforehand,
        }


@dataclass(frozen=True, eq=False, repr=False)
class ProcessResult(Result):
    """The result of a transfer function `process`. `assessment` covers all records. `counted` says that an encoder
    counted the output."""

    experiments: tuple[Experiment, ...]
    process: Process
    assessment: Assessment
    counted: bool = False

    @property
    def name(self) -> str:
        return ", ".join(experiment.name for experiment in self.experiments)

    @property
    def samples(self) -> int:
        return sum(part.size for part in self.assessment.samples)

    @property
    def title(self) -> str:
        return f"{super().title}, {self.fit_text}"

    @property
    def delay(self) -> int:
        return delay_of(self.estimator)

    @property
    def fit(self) -> float | None:
        """The fit of the assessment [%], or None if an unexpectedly unstable process makes the simulation useless."""
        expected = expects_unstable(self.estimator)
        return None if np.any(self.process.poles.real > 0) and not expected else self.assessment.fit

    @property
    def fit_text(self) -> str:
        return "fit unknown, unstable" if self.fit is None else f"fit {self.fit:.2f} %"

    def particulars(self) -> dict[str, object]:
        """Entries of `to_dict` for a transfer function, with poles and zeros as [real, imaginary], and the fit [%]."""
        process, checks = self.process, self.assessment
        return {
            "records": [experiment.name for experiment in self.experiments],
            "delay": self.delay,
            "dead_time": process.delay,
            **dict(zip(self.estimator.names, self.theta.tolist(), strict=True)),
            "poles": process.poles.astype(complex),
            "zeros": process.zeros.astype(complex),
            "gain": process.gain,
            "time_constants": process.time_constants,
            "fit": self.fit,
            "residual": {"white": checks.white, "independent": checks.independent, "feedback": checks.feedback},
        }


#: Patterns for units. Masses become forces per acceleration, and lengths and angles become counts. The metre of a
#: torque remains.
_MASSES = {"kg": "N s2/m", "kg m2": "N m s2/rad"}
_LENGTH = re.compile(r"(?<=/)(?:m|rad)(?=\d|$)|^(?:m|rad)(?=/s|$)")


def delay_of(estimator: Estimator) -> int:
    """Return the known dead time of a transfer function [samples]."""
    return estimator.model.delay if isinstance(estimator.model, TransferFunction) else 0


def expects_unstable(estimator: Estimator) -> bool:
    """Return whether the model allows poles in the right half-plane."""
    return isinstance(estimator.model, TransferFunction) and estimator.model.unstable
