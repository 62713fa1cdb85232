"""Random linear processes, their records with coloured noise, and their estimates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from pmfid.diagnostics.processes import assess, flags_on
from pmfid.encoder import Encoder
from pmfid.errors import NotIdentifiableError
from pmfid.estimators.srivc import SRIVC, make_problem
from pmfid.linear.experiment import Experiment, Hold
from pmfid.linear.process import Process
from pmfid.models.transfer_function import TransferFunction
from pmfid.simulation.process import simulate_process
from pmfid.types import Floats

INPUTS = ("prbs", "steps", "sweep", "multisine", "white")
NOISES = ("white", "AR(1) 0.9", "resonance")
#: Signal to noise [dB], uniform.
OPEN_SNR = (15.0, 40.0)


@dataclass(frozen=True)
class RandomPlant:
    """Process with b, a in descending powers, a with its leading 1; dt [s]; bandwidth [rad/s], the mean pole
    magnitude.
    """

    b: Floats
    a: Floats
    dt: float
    bandwidth: float

    @property
    def poles(self) -> Floats:
        """The poles (n,), the slowest first; of a pair the one with the positive imaginary part, as in `Process`."""
        return np.array(sorted(np.roots(self.a), key=lambda p: (round(abs(p), 12), p.real, -p.imag)))

    @property
    def gain(self) -> float:
        return float(self.b[-1] / self.a[-1])


def random_plant(rng: np.random.Generator, most: int = 4) -> RandomPlant:
    """Return a process of 1 to `most` poles within a decade, pairs with a damping of 0.1 to 0.9, and fewer zeros. The
    zeros are on either side of the imaginary axis."""
    n, dt = int(rng.integers(1, most + 1)), float(10 ** rng.uniform(-3, 0))
    bandwidth = float(10 ** rng.uniform(-1.3, -0.6)) / dt
    roots: list[complex] = []
    while len(roots) < n:
        size, damping = bandwidth * 10 ** rng.uniform(-0.5, 0.5), rng.uniform(0.1, 0.9)
        pair = len(roots) + 2 <= n and rng.uniform() < 0.5
        root = size * complex(-damping, np.sqrt(1 - damping**2))
        roots += [root, root.conjugate()] if pair else [complex(-size)]
    a = np.real(np.poly(roots))
    zeros = bandwidth * 10 ** rng.uniform(-0.5, 0.8, int(rng.integers(0, n))) * rng.choice([-1.0, 1.0])
    top = np.atleast_1d(np.poly(zeros))
    return RandomPlant(top * a[-1] / top[-1] * 10 ** rng.uniform(-2, 2), a, dt, bandwidth)


def make_input(kind: str, samples: int, plant: RandomPlant, rng: np.random.Generator) -> Floats:
    """Return an input (samples,) with an amplitude of about one unit."""
    t, hold = np.arange(samples) * plant.dt, max(1, round(1 / (plant.bandwidth * plant.dt)))
    if kind == "prbs":
        return np.repeat(rng.choice([-1.0, 1.0], samples // hold + 1), hold)[:samples]
    if kind == "steps":
        hold = min(5 * hold, samples // 8)
        return np.repeat(rng.uniform(-1, 1, samples // hold + 1), hold)[:samples]
    if kind == "sweep":
        low, high = 0.1 * plant.bandwidth, min(6 * plant.bandwidth, 2.5 / plant.dt)
        rate = np.log(high / low) / t[-1]
        return np.asarray(np.sin(low / rate * (np.exp(rate * t) - 1)))
    if kind == "multisine":
        period = samples // 3
        lines = np.arange(1, max(3, min(30, round(4 * plant.bandwidth * period * plant.dt / (2 * np.pi)))) + 1)
        phases = rng.uniform(0, 2 * np.pi, lines.size)
        waves = np.cos(2 * np.pi / period * np.outer(np.arange(samples), lines) + phases)
        return np.asarray(waves.sum(axis=1) / np.sqrt(lines.size))
    return rng.standard_normal(samples)


def make_noise(kind: str, samples: int, rng: np.random.Generator) -> Floats:
    """Return noise (samples,) of variance 1: white, AR(1) with 0.9, or a resonance of 2 % damping in white noise."""
    w = rng.standard_normal(samples + 1000)
    if kind == "AR(1) 0.9":
        return np.asarray(lfilter([np.sqrt(0.19)], [1.0, -0.9], w)[1000:])
    if kind == "resonance":
        ring = lfilter([1.0], np.real(np.poly(np.exp(np.array([-0.006 + 0.3j, -0.006 - 0.3j])))), w)
        w = ring / np.std(ring) + 0.3 * rng.standard_normal(w.size)
        return np.asarray(w[1000:] / np.sqrt(1.09))
    return w[1000:]


def open_record(
    plant: RandomPlant, kind: str, noise: str, samples: int, hold: Hold, rng: np.random.Generator
) -> Experiment:
    """Return a record with the hold that made it."""
    u = make_input(kind, samples, plant, rng)
    y = simulate_process(plant.b, plant.a, u, plant.dt, hold=hold)
    size = float(np.std(y)) * 10 ** (-rng.uniform(*OPEN_SNR) / 20)
    return Experiment(u, y + size * make_noise(noise, samples, rng), dt=plant.dt, hold=hold)


def estimator_of(plant: RandomPlant, model: TransferFunction | None = None) -> SRIVC:
    """Return the estimator that a user with known numbers of poles and zeros would take."""
    model = model or TransferFunction(plant.a.size - 1, plant.b.size - 1)
    return SRIVC(model, Encoder(1.0), plant.dt, min(2 * plant.bandwidth, 1.9 / plant.dt))


def identified(estimator: SRIVC, record: Experiment) -> tuple[Process, Floats, tuple[str, ...]]:
    """Identify as `pmfid identify` does: return the process, theta (p,) and the status. Raises NotIdentifiableError."""
    fit = estimator.fit_experiments([record])
    problem = make_problem(estimator, [record])
    theta = fit.theta / problem.structure.scale(problem.rate)
    checks = assess(problem, theta, estimator.equation.delay)
    if not checks.depends:
        raise NotIdentifiableError("chance alone explains as much")
    return fit.process, fit.theta, flags_on(checks, fit.process)
