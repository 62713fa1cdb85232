"""Study of linear processes: every method on three plants, with white noise and with a quantiser of a few levels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmfid.encoder import Encoder, fine_counts, quantize
from pmfid.errors import NotIdentifiableError
from pmfid.estimators.batch import BatchEstimator
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.registry import ESTIMATORS
from pmfid.linear.process import polynomial
from pmfid.models.transfer_function import TransferFunction
from pmfid.simulation.process import PLANTS, SimulatedProcess, simulate_process
from pmfid.types import Floats
from studies.paper.truth import Study, Task, table

#: Ratio of the powers of output and noise.
SNR = 10.0
NOISES = ("white", "quantiser")
METHODS = ("ls", "bcls", "bcrls", "srivc")
#: Bounds of the mean error of every parameter except b0 of the last plant [%].
GOALS = {"white": 1.0, "quantiser": 2.0}
HARD = ("rao-garnier", "b0")
#: Relative step of the central differences for the bound.
STEP = 1e-5


@dataclass(frozen=True, eq=False)
class NoisyRecord:
    """Input and counts (n,) of an encoder; `noise_std` belongs to its position."""

    u: Floats
    counts: NDArray[np.int64]
    encoder: Encoder
    noise_std: float


def noisy_record(plant: SimulatedProcess, noise: str, seed: int) -> NoisyRecord:
    """Return the plant's input from a random place in its period, and its output with noise of 1/SNR of its power.

    The quantiser rounds down to a step of this variance, with two or three levels in all. The phase of the quantiser
    is random, because the zero of the encoder is unknown.
    """
    rng = np.random.default_rng(seed)
    u = np.roll(plant.u, rng.integers(plant.u.size))
    y = simulate_process(plant.b, plant.a, u, plant.dt)
    std = float(np.std(y)) / np.sqrt(SNR)
    if noise == "white":
        encoder, counts = fine_counts(y + std * rng.standard_normal(y.size))
        return NoisyRecord(u, counts, encoder, std)
    step = std * np.sqrt(12.0)
    return NoisyRecord(u, quantize(y + rng.uniform(0, step), step), Encoder(step), std)


def model_of(plant: SimulatedProcess, noise: str = NOISES[0]) -> TransferFunction:
    """Return the model, with a constant if the zero of the encoder is unknown."""
    return TransferFunction(len(plant.a) - 1, len(plant.b) - 1, offset=noise == "quantiser")


def tasks(seeds: int) -> list[Task]:
    return [(name, noise, seed) for name in PLANTS for noise in NOISES for seed in range(seeds)]


def work(name: str, noise: str, seed: int) -> dict[str, Floats]:
    """Return theta of every method, nan without an estimate; "bound" has the least variances of an unbiased
    estimate.
    """
    plant = PLANTS[name]
    record = noisy_record(plant, noise, seed)
    found = {method: last_estimate(method, model_of(plant, noise), plant, record) for method in METHODS}
    return found | ({"bound": cramer_rao(plant, record)} if noise == "white" else {})


def last_estimate(method: str, model: TransferFunction, plant: SimulatedProcess, record: NoisyRecord) -> Floats:
    """Return the estimate (p,) at the end of a record; nan without an estimate."""
    cls = ESTIMATORS[method]
    options: dict[str, Any] = {"prefilter_zeros": plant.zeros} if cls.instrumental else {}
    estimator = cls(model, record.encoder, plant.dt, plant.cutoff, **options)
    try:
        if isinstance(estimator, BatchEstimator):
            return estimator.fit(record.u, record.counts).theta[: plant.theta.size]
        if isinstance(estimator, RecursiveEstimator):
            return np.asarray(estimator.run(record.u, record.counts).theta[-1, : plant.theta.size])
    except NotIdentifiableError:
        pass
    return np.full(plant.theta.size, np.nan)


def cramer_rao(plant: SimulatedProcess, record: NoisyRecord) -> Floats:
    """Return the least variances (p,) of an unbiased estimate from rest with white noise (Ljung 1999, section 7.4)."""
    columns = []
    for j, size in enumerate(STEP * np.abs(plant.theta)):
        shift = size * np.eye(plant.theta.size)[j]
        above, below = (_simulated(plant, plant.theta + sign * shift, record.u) for sign in (1.0, -1.0))
        columns.append((above - below) / (2 * size))
    sensitivity = np.column_stack(columns)
    scale = np.linalg.norm(sensitivity, axis=0)
    fisher = (sensitivity / scale).T @ (sensitivity / scale)
    return np.asarray(np.diagonal(np.linalg.inv(fisher)) / scale**2 * record.noise_std**2)


def _simulated(plant: SimulatedProcess, theta: Floats, u: Floats) -> Floats:
    n = len(plant.a) - 1
    return simulate_process(theta[n:][::-1], np.r_[1.0, theta[:n][::-1]], u, plant.dt)


def write(seeds: int, results: Mapping[Task, Any]) -> list[str]:
    lines = [
        "## Every method, white noise and a quantiser",
        "",
        f"{seeds} runs each, noise at {10 * np.log10(SNR):g} dB: white, or a quantiser that rounds down to a step of "
        "the same variance, two or three levels in all, at a random phase (the model has an offset then). The input is "
        "a maximum length sequence of 10 stages from a random place on; `bcls` and `bcrls` with pre-filter zeros near "
        "the plant's poles (below), the recursive methods with forgetting 1, last value. Mean error ± standard "
        "deviation over the runs, in percent of the parameter; efficiency: Cramér-Rao bound over the mean square "
        "error.",
        "",
    ]
    for name, plant in PLANTS.items():
        names = model_of(plant).equation.names
        lines += [f"### {name}", "", _description(plant), ""]
        for noise in NOISES:
            runs = [results[name, noise, seed] for seed in range(seeds)]
            lines += [f"{noise} noise", ""]
            lines += table(["method", *names, "runs with an answer"], [_row(m, runs, plant) for m in METHODS])
        runs = [results[name, "white", seed] for seed in range(seeds)]
        lines += ["Efficiency with white noise:", ""]
        lines += table(["method", *names], [_efficiency(m, runs, plant) for m in METHODS])
    return lines + _checks(seeds, results)


def _description(plant: SimulatedProcess) -> str:
    top, bottom = polynomial(np.array(plant.b[::-1])), polynomial(np.array(plant.a[::-1]))
    return (
        f"G(s) = ({top}) / ({bottom}), T = {plant.dt:g} s, clock {plant.clock}, {plant.samples} samples, cutoff "
        f"{plant.cutoff:g} rad/s, zeros {', '.join(f'{zero:g}' for zero in plant.zeros)}."
    )


def errors(runs: list[dict[str, Floats]], method: str, plant: SimulatedProcess) -> Floats:
    """Return errors (runs, p) in percent, of the runs with an estimate."""
    found = np.array([run[method] for run in runs])
    found = found[np.all(np.isfinite(found), axis=1)]
    return np.asarray(100 * (found - plant.theta) / np.abs(plant.theta))


def _row(method: str, runs: list[dict[str, Floats]], plant: SimulatedProcess) -> list[str]:
    found = errors(runs, method, plant)
    if not found.size:
        return [f"`{method}`", *("–" for _ in plant.theta), "0"]
    spread = found.std(axis=0, ddof=1) if len(found) > 1 else np.zeros(plant.theta.size)
    cells = [f"{mean:+.2f} ± {std:.2f}" for mean, std in zip(found.mean(axis=0), spread, strict=True)]
    return [f"`{method}`", *cells, str(len(found))]


def efficiencies(runs: list[dict[str, Floats]], method: str, plant: SimulatedProcess) -> Floats:
    """Return the ratios (p,) of the bound to the mean square error about the truth."""
    bound = np.mean([run["bound"] for run in runs], axis=0) * (100 / plant.theta) ** 2
    return np.asarray(bound / np.mean(errors(runs, method, plant) ** 2, axis=0))


def _efficiency(method: str, runs: list[dict[str, Floats]], plant: SimulatedProcess) -> list[str]:
    if not errors(runs, method, plant).size:
        return [f"`{method}`", *("–" for _ in plant.theta)]
    return [f"`{method}`", *(f"{value:.2g}" for value in efficiencies(runs, method, plant))]


def _checks(seeds: int, results: Mapping[Task, Any]) -> list[str]:
    lines: list[str] = []
    for method in ("bcls", "bcrls", "srivc"):
        for noise in NOISES:
            worst: dict[tuple[str, str], float] = {}
            for name, plant in PLANTS.items():
                runs = [results[name, noise, seed] for seed in range(seeds)]
                mean = errors(runs, method, plant).mean(axis=0)
                kept = model_of(plant).equation.names
                worst |= {(name, n): value for n, value in zip(kept, mean, strict=True) if (name, n) != HARD}
            place = max(worst, key=lambda key: abs(worst[key]))
            verdict = "met" if abs(worst[place]) <= GOALS[noise] else "**not met**"
            lines.append(
                f"- `{method}`, {noise} noise: mean error of every parameter but {HARD[1]} of {HARD[0]} within "
                f"{GOALS[noise]:g} %: {verdict}; the largest is {worst[place]:+.2f} % ({place[1]} of {place[0]})."
            )
    least = min(
        float(np.min(efficiencies([results[name, "white", seed] for seed in range(seeds)], "srivc", plant)))
        for name, plant in PLANTS.items()
    )
    lines.append(
        f"- `srivc`, efficiency with white noise at least 0.9: {'met' if least >= 0.9 else '**not met**'}; the least "
        f"of any parameter is {least:.2f}, uncertain by {100 * np.sqrt(2 / seeds):.0f} % with this number of runs."
    )
    return [*lines, ""]


STUDY = Study("processes", tasks, work, write)
