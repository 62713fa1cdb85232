"""Study of transfer functions for real records: integrators, m = n, unstable poles, any dead time."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pmfid.encoder import Encoder
from pmfid.errors import PmfidError
from pmfid.estimators.srivc import SRIVC, make_problem
from pmfid.linear.experiment import Experiment
from pmfid.linear.solve import visit
from pmfid.models.equation import ESTIMATE
from pmfid.models.transfer_function import TransferFunction
from pmfid.types import Floats
from studies.late_processes import Controller, simulate_late, simulate_loop

#: Ratio of the powers of output and noise.
SNR = 100.0
DT, SAMPLES, CLOCK, CUTOFF = 0.1, 1500, 3, 3.0
#: Largest relative difference of the poles and zeros of a run from the nominal ones.
SPREAD = 0.3


@dataclass(frozen=True)
class Case:
    """A process with its options. The process has the gain b_m, zeros and poles [rad/s], further options of the model,
    a controller or None, and the dead time [samples]. A flag says whether the input returns integrators to zero."""

    gain: float
    zeros: tuple[complex, ...]
    poles: tuple[complex, ...]
    integrators: int = 0
    unstable: bool = False
    controller: Controller | None = None
    delay: float | None = None
    balanced: bool = False

    def model(self) -> TransferFunction:
        return TransferFunction(
            len(self.poles),
            len(self.zeros),
            integrators=self.integrators,
            unstable=self.unstable,
            dead_time=0.0 if self.delay is None else ESTIMATE,
        )


RESONANCE = (-0.6 + 2.5j, -0.6 - 2.5j)
FLEXIBLE = (*RESONANCE, -0.5 + 6j, -0.5 - 6j)
LEAD, GAIN = Controller(gain=0.8, lead=2.0, lag=0.3), Controller(gain=2.0)
CASES = {
    "m = n = 1": Case(0.5, (-3.0,), (-1.0,)),
    "m = n = 2": Case(0.8, (-0.5 + 1.0j, -0.5 - 1.0j), RESONANCE),
    "m = n = 3": Case(0.5, (-0.4, -1.5 + 4j, -1.5 - 4j), (-1.2, *RESONANCE)),
    "m = n = 4": Case(0.6, (-0.4 + 1.3j, -0.4 - 1.3j, -0.6 + 4j, -0.6 - 4j), FLEXIBLE),
    "one integrator": Case(2.0, (), (0.0, -1.5), 1, balanced=True),
    "two integrators": Case(1.0, (), (0.0, 0.0), 2, balanced=True),
    "two integrators and a pole": Case(3.0, (-1.0,), (0.0, 0.0, -3.0), 2, balanced=True),
    "one integrator, controlled": Case(2.0, (), (0.0, -1.5), 1, controller=LEAD),
    "two integrators, controlled": Case(1.0, (), (0.0, 0.0), 2, controller=LEAD),
    "unstable pole, controlled": Case(2.0, (), (0.8, -2.0), unstable=True, controller=GAIN),
    "two unstable poles, controlled": Case(1.5, (), (0.3 + 1j, 0.3 - 1j), unstable=True, controller=LEAD),
} | {f"dead time {delay:g} samples": Case(2.0, (), (-1.0, -3.0), delay=delay) for delay in (0.3, 1.0, 2.5, 3.8, 5.7)}


@dataclass(frozen=True, eq=False)
class Run:
    """One simulated record, its true parameters (p,) and the standard deviation of its noise."""

    record: Experiment
    theta: Floats
    noise_std: float


def simulate_run(case: Case, seed: int) -> Run:
    """Simulate a plant near that of the case under random steps, with noise of 1/SNR of the output's power."""
    rng = np.random.default_rng(seed)
    zeros, poles = _near(case.zeros, rng), _near(case.poles, rng)
    b, a = case.gain * np.atleast_1d(np.poly(zeros).real), np.poly(poles).real
    pattern = np.array([1.0, -1.0, -1.0, 1.0] if case.balanced else [1.0])
    steps = np.kron(rng.choice([-1.0, 1.0], SAMPLES // CLOCK + 1), pattern).repeat(CLOCK)[:SAMPLES]
    noise = rng.standard_normal(SAMPLES)
    theta = np.r_[a[:0:-1][case.integrators :], b[::-1]]
    if case.controller is None:
        y = simulate_late(b, a, steps, DT, (case.delay or 0.0) * DT)
        std = float(np.std(y) / np.sqrt(SNR))
        theta = theta if case.delay is None else np.r_[theta, case.delay * DT]
        return Run(Experiment(steps, y + std * noise, dt=DT), theta, std)
    std = float(np.std(simulate_loop(b, a, case.controller, steps, 0 * noise, DT)[1]) / np.sqrt(SNR))
    u, y = simulate_loop(b, a, case.controller, steps, std * noise, DT)
    return Run(Experiment(u, y, dt=DT, reference=steps), theta, std)


def _near(roots: tuple[complex, ...], rng: np.random.Generator) -> Floats:
    """Multiply each root or pair of roots by a random number. Roots at 0 stay."""
    factors = {abs(root): 1 + SPREAD * rng.uniform(-1, 1) for root in dict.fromkeys(roots)}
    return np.array([root * factors[abs(root)] for root in roots])


def work(name: str, seed: int) -> dict[str, Floats]:
    """Return the errors (p,) over the standard deviation of the bound, and over the bars; nan without an estimate."""
    case = CASES[name]
    run = simulate_run(case, seed)
    estimator = SRIVC(case.model(), Encoder(1.0), DT, CUTOFF)
    try:
        fit = estimator.fit_experiments([run.record])
    except PmfidError:
        nothing = np.full(run.theta.size, np.nan)
        return {"bound": nothing, "bar": nothing, "error": nothing}
    error = fit.theta - run.theta
    return {"bound": error / bound(estimator, run), "bar": error / fit.theta_std, "error": error}


def bound(estimator: SRIVC, run: Run) -> Floats:
    """Return the least standard deviations (p,) of an unbiased estimate (Ljung 1999, section 7.4). The noise is white,
    the start unknown, and the input is that of the record."""
    problem = make_problem(estimator, [replace(run.record, reference=None)])
    scale = problem.structure.scale(problem.rate)
    initial = np.zeros((len(problem.stretches), problem.structure.n))
    start = visit(problem, run.theta / scale, initial).initial
    zeta = visit(problem, run.theta / scale, start).zeta
    size = np.linalg.norm(zeta, axis=0)
    fisher = (zeta / size).T @ (zeta / size)
    return np.asarray(np.sqrt(np.diagonal(np.linalg.inv(fisher))) / size * scale * run.noise_std)
