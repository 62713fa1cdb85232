"""Self-test of a result: the machine is simulated at the estimate and identified again.

The simulation has the record's input, encoder and noise. If the method recovers its own parameters within its own
intervals, motion and method suffice. If the record deviates more from the model than the simulations do, the model is
wrong.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pmfid.config.axis import Axis
from pmfid.diagnostics.free_run import FreeRun
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.findings import MOVE, Finding, Judged, sort_findings
from pmfid.fit.compare import NORMAL_95
from pmfid.pipeline.drives import Drives
from pmfid.pipeline.identify import describe_refusal, identify, kind_of
from pmfid.pipeline.kinds import Records, parameters_of
from pmfid.pipeline.known import set_stored_gain
from pmfid.pipeline.result import Result
from pmfid.pipeline.stored import Stored
from pmfid.pipeline.tuning import TUNING
from pmfid.records.record import Record
from pmfid.types import Floats


@dataclass(frozen=True)
class Recovery:
    """Estimates of one parameter out of simulated records.

    `value` is the parameter of the simulation. `mean` and `rmse` describe the estimates and their errors. `covered` is
    the number of estimates whose interval contains the value.
    """

    name: str
    unit: str
    value: float
    mean: float
    rmse: float
    covered: int


@dataclass(frozen=True)
class SelfTest(Judged):
    """Recoveries by parameter over `runs` simulated records, of which `refused` had no estimate, and findings."""

    record: str
    runs: int
    refused: int
    recoveries: tuple[Recovery, ...]
    findings: tuple[Finding, ...]

    @property
    def coverage(self) -> float:
        """The part of all intervals that contain their parameter, or NaN without an estimate."""
        most = len(self.recoveries) * (self.runs - self.refused)
        return sum(one.covered for one in self.recoveries) / most if most else float("nan")

    def to_json(self) -> dict[str, object]:
        """Return the object that `--json` prints."""
        return {
            "record": self.record,
            "runs": self.runs,
            "refused": self.refused,
            "coverage": self.coverage if self.recoveries else None,
            "parameters": {one.name: {k: v for k, v in vars(one).items() if k != "name"} for one in self.recoveries},
            "status": list(self.status),
            "findings": [finding.to_json() for finding in self.findings],
        }


def run_selftest(
    stored: Stored,
    data: Records,
    axis: Axis,
    *,
    runs: int = TUNING.selftest_runs,
    seed: int = 0,
    tell: Callable[[float], None] = lambda _: None,
) -> SelfTest:
    """Simulate a machine at stored parameters under the record's input, identify `runs` such records, and compare.

    Raises UsageError for a transfer function, or if the parameters belong to another model or allow no simulation.
    """
    kind, axis = kind_of(axis), set_stored_gain(axis, stored)
    if not (isinstance(kind, Drives) and isinstance(data, Record)):
        raise UsageError("a self-test simulates a machine: give an axis with kind = 'drive' or 'equation'")
    names, units = parameters_of(axis.model.make())
    theta = stored.theta(axis.model.kind, names, units)
    kind.check_known(stored, data, axis)
    own = kind.free_runs(data, axis, theta)[0]
    rng, noise = np.random.default_rng(seed), measure_noise(own, data.resolution)
    found, refused, deviations = list[Result](), 0, list[float]()
    for number in range(runs):
        record = _simulate_record(data, own, noise, rng)
        deviations.append(measure_deviation(kind.free_runs(record, axis, theta)[0])[0])
        try:
            found.append(identify(record, axis))
        except NotIdentifiableError:
            refused += 1
        tell((number + 1) / runs)
    recoveries = tuple(_measure_recovery(*row, found) for row in zip(names, units, theta.tolist(), strict=True))
    recoveries = recoveries if found else ()
    findings = [
        *_judge_model(own, deviations),
        *_judge_motion(recoveries, runs, refused),
        *_judge_record(data, axis, names, theta),
    ]
    test = SelfTest(data.name, runs, refused, recoveries, sort_findings(findings))
    return replace(test, findings=sort_findings((*findings, *_judge_coverage(test))))


def measure_noise(run: FreeRun, step: float) -> float:
    """Return the standard deviation of the measured position before rounding, in steps of the encoder.

    Second differences within a stretch remove the motion. The simulated motion, rounded as well, shows what rounding
    contributes.
    """
    simulated, near = np.floor(run.simulated / step), run.rows[2:] - run.rows[:-2] == 2
    power = [np.mean(np.diff(values, 2)[near] ** 2) for values in (run.measured / step, simulated)]
    return float(np.sqrt(max(power[0] - power[1], 0.0) / 6.0))


def measure_deviation(run: FreeRun) -> tuple[float, float]:
    """Return the error of the shortest free runs, and this error as a part of the motion."""
    if not run.horizons:
        return run.rmse, run.rmse / run.standstill
    first = run.horizons[0]
    return first.rmse, first.rmse / max(first.standstill, 1e-300)


def _simulate_record(data: Record, run: FreeRun, noise: float, rng: np.random.Generator) -> Record:
    """Return the record with counts of the simulated motion, at a random phase of the encoder."""
    position = run.simulated / data.resolution + rng.random() + noise * rng.standard_normal(run.simulated.size)
    counts = data.counts.copy()
    counts[run.rows] = np.floor(position).astype(np.int64)
    return replace(data, counts=counts, ages=None)


def _measure_recovery(name: str, unit: str, value: float, found: Sequence[Result]) -> Recovery:
    rows = [_read_parameter(result, name) for result in found if name in result.names]
    estimates = np.array([row[0] for row in rows])
    covered = sum(low <= value <= high for _, low, high in rows)
    rmse = float(np.sqrt(np.mean((estimates - value) ** 2))) if rows else float("nan")
    return Recovery(name, unit, value, float(estimates.mean()) if rows else float("nan"), rmse, covered)


def _read_parameter(result: Result, name: str) -> tuple[float, float, float]:
    """Return an estimate and the ends of its 95 % interval."""
    index = result.names.index(name)
    value, half = float(result.theta[index]), NORMAL_95 * float(result.theta_std[index])
    low, high = result.interval_95[index].tolist()
    return (value, low, high) if np.isfinite(low) else (value, value - half, value + half)


# --- findings ---------------------------------------------------------------------------------------------------------


def _judge_model(own: FreeRun, deviations: Sequence[float]) -> list[Finding]:
    size, part = measure_deviation(own)
    ratio = size / max(float(np.max(deviations)), 1e-300)
    if ratio <= TUNING.selftest_beyond or part <= TUNING.selftest_material:
        return []
    sentence = f"the record deviates {ratio:.1f} times as far from the model as simulated records do"
    return [Finding("unmodelled", sentence, "search for the missing term with `pmfid terms`")]


def _judge_motion(recoveries: Sequence[Recovery], runs: int, refused: int) -> list[Finding]:
    if refused > runs / 2:
        return [Finding("poor_excitation", f"{refused} of {runs} simulated records have no estimate", MOVE, "wrong")]
    lost = [one.name for one in recoveries if not one.rmse <= TUNING.selftest_lost * abs(one.value)]
    if not lost:
        return []
    sentence = f"the method does not recover {', '.join(lost)} from its own simulation"
    return [Finding("poor_excitation", sentence, MOVE)]


def _judge_coverage(test: SelfTest) -> list[Finding]:
    done = test.runs - test.refused
    chances = [_chance_of(done, one.covered) for one in test.recoveries]
    if not chances or not min(chances) * len(chances) < 1e-3:
        return []
    sentence = f"only {100 * test.coverage:.0f} % of the intervals contain their parameter"
    return [Finding("std_too_small", sentence, "widen the error bars, or choose another method")]


def _chance_of(runs: int, covered: int) -> float:
    """Return the probability that at most `covered` of all intervals of 95 % contain their parameter."""
    return sum(math.comb(runs, k) * 0.95**k * 0.05 ** (runs - k) for k in range(covered + 1))


def _judge_record(data: Record, axis: Axis, names: Sequence[str], theta: Floats) -> list[Finding]:
    """Return the doubts of an identification of the record itself, and the parameters of the result that this
    identification excludes."""
    try:
        result = identify(data, axis)
    except NotIdentifiableError as error:
        return [describe_refusal(error)]
    found = [finding for finding in result.findings if finding.severity != "note"]
    for name, value in zip(names, theta.tolist(), strict=True):
        if name not in result.names:
            continue
        index = result.names.index(name)
        own, std = float(result.theta[index]), float(result.theta_std[index])
        if abs(value - own) > max(TUNING.selftest_away * std, axis.estimator.tolerance * abs(own)):
            sentence = f"{name} = {value:.5g} does not belong to this record, which gives {own:.5g}"
            found.append(Finding("biased", sentence, "identify this record again", "wrong"))
    return found
