"""The fit: body with exact derivatives, solver, comparison of forces, and the intervals of the counts."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.stats import truncnorm
from threadpoolctl import threadpool_info, threadpool_limits

import pmfid
from benchmarks.models import identify_case, make_case
from pmfid._body import BASE, KINDS, run, whiten
from pmfid.estimators.motion_fit import MotionFit
from pmfid.fit.compare import mixture_half_length
from pmfid.fit.fit import Fitted
from pmfid.fit.likelihood import interval_terms
from pmfid.fit.posterior import allowed_region
from pmfid.fit.problem import ResidualBlock
from pmfid.fit.solve import inverse, solve
from pmfid.fit.within import reach_counts, start_precision
from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, prbs, simulate_drive
from pmfid.threads import use_one_thread
from pmfid.types import Floats
from studies.referee.cases import Case, make_cases
from studies.referee.judge import identify
from tests.conftest import TRUTH, long_unless
from tests.refusals import refused

STEPS = 600
RNG = np.random.default_rng(4)
INPUT = np.ascontiguousarray(6.0 * RNG.choice([-1.0, -0.4, 0.7, 1.0], STEPS // 10).repeat(10))
CLOCK = 0.01 * (1 + 0.2 * RNG.random(STEPS))
NO_TABLE = np.zeros(1)
FORCES = {
    "spring": (KINDS["spring"], 0, False, NO_TABLE, 0.0, 0.0, False),
    "power": (KINDS["power"], 0, False, NO_TABLE, 1.5, 0.5, False),
    "stribeck": (KINDS["stribeck"], 0, True, NO_TABLE, 0.2, 0.0, False),
    "smooth": (KINDS["smooth"], 0, True, NO_TABLE, 0.2, 0.0, False),
    "wave": (KINDS["wave"], 0, False, NO_TABLE, 0.1, 0.3, False),
    "column": (KINDS["column"], 0, False, NO_TABLE, 0.0, 0.0, False),
    "bend": (KINDS["bend"], 0, False, NO_TABLE, 0.05, 0.3, False),
    "bend_even": (KINDS["bend_even"], 0, False, NO_TABLE, 0.05, 0.3, False),
}


def simulate(theta: Floats, names: list[str], parts: int = 4) -> tuple[Floats, Floats]:
    row, columns = np.arange(STEPS, dtype=np.int32), np.sin(np.arange(STEPS))[None]
    y, _, S, done = run([FORCES[name] for name in names], CLOCK, INPUT, row, columns, theta, parts, np.eye(theta.size))
    assert done == STEPS
    return y, S


LATE = np.array([1.07, 12.8, 0.8, 0.1, 0.5, 0.013, 0.03, 0.001, 0.01])


@pytest.mark.parametrize(("names", "lag"), [([], 0.0), ([], 0.03), *(([name], 0.0) for name in FORCES)])
def test_the_derivatives_are_those_of_the_motion(names: list[str], lag: float) -> None:
    """Through stops, reversals, a delay inside a sample and friction that differs by direction."""
    theta = np.r_[LATE, np.full(len(names), 0.2)]
    theta[BASE - 3] = lag
    theta = np.append(theta, [0.2] * (names in (["stribeck"], ["smooth"])))
    _, S = simulate(theta, names)
    for k in range(theta.size):
        if k == BASE - 3 and lag == 0:
            continue
        step = 1e-7 * max(abs(theta[k]), 1e-2)
        above, below = theta.copy(), theta.copy()
        above[k] += step
        below[k] -= step
        quotient = (simulate(above, names)[0] - simulate(below, names)[0]) / (2 * step)
        assert np.max(np.abs(quotient - S[:, k])) < 3e-3 * np.max(np.abs(S[:, k])), (names, k)


@cache
def right_case(index: int = 1) -> Case:
    """Return a machine of the referee that the plain drive describes."""
    return make_cases(51, "right", [index])[0]


def examine(case: Case) -> Fitted:
    """Return the fit of a plain drive to a case of the referee."""
    steps = None if case.t is None else np.diff(case.t, prepend=case.t[0] - case.dt)
    drive = pmfid.Drive(case.input_gain, axis="rotary" if case.rotary else "linear")
    encoder = pmfid.Encoder(case.resolution)
    there = np.isfinite(case.counts)
    counts = np.where(there, case.counts, 0.0).astype(np.int64)
    return MotionFit(drive, encoder, case.dt, 0.2 / case.dt, steps=steps).examine(case.u, counts, there)


def test_a_body_without_forces_is_exact() -> None:
    """From rest, without Coulomb friction: v = (u/d) (1 - exp(-d t/m)) as long as u is constant."""
    theta = np.r_[2.0, 4.0, np.zeros(BASE - 2)]
    y, v, _, _ = run(
        [], np.full(10, 0.1), np.full(10, 3.0), np.arange(11, dtype=np.int32), np.zeros((0, 10)), theta, 1, None
    )
    t = 0.1 * np.arange(11)
    np.testing.assert_allclose(v, 0.75 * (1 - np.exp(-2 * t)), atol=1e-14)
    np.testing.assert_allclose(y, 0.75 * (t - (1 - np.exp(-2 * t)) / 2), atol=1e-14)


def test_whitening_divides_by_the_covariance() -> None:
    """Squares of the innovations are those of R^-1, and the logarithms those of det R, for a force that wanders."""
    n, step, rate, sd, memory = 40, 0.1, 0.7, 30.0, 0.5
    impulse = np.zeros((n, n))
    for j in range(n):  # response of the position to an acceleration held over one step
        x = v = 0.0
        for i in range(j, n):
            impulse[i, j] = x
            a = 1.0 if i == j else 0.0
            decay = np.exp(-rate * step)
            x += v * (1 - decay) / rate + a * (step - (1 - decay) / rate) / rate
            v = v * decay + a * (1 - decay) / rate
    k = np.arange(n)
    force = sd**2 * np.exp(-step * np.abs(k[:, None] - k) / memory)
    R = np.eye(n) / 12 + impulse @ force @ impulse.T
    e = np.random.default_rng(1).standard_normal((n, 2))
    white = np.ascontiguousarray(e.copy())
    logs = whiten(white, np.full(n, step), np.full(n, 1 / 12), rate, (sd, memory), (0.0, 1.0))
    np.testing.assert_allclose(white.T @ white, e.T @ np.linalg.solve(R, e), rtol=1e-8)
    assert logs == pytest.approx(np.linalg.slogdet(R)[1], rel=1e-9)


def test_the_likelihood_of_an_interval_is_smooth() -> None:
    e = np.linspace(-1.2, 1.2, 49)
    _, slope, curvature = interval_terms(e, 0.1)
    step = 1e-5
    above, below = interval_terms(e + step, 0.1), interval_terms(e - step, 0.1)
    np.testing.assert_allclose(slope, (above[0] - below[0]) / (2 * step), rtol=1e-5, atol=1e-5)
    inside = np.abs(e) > 0.3
    np.testing.assert_allclose(curvature[inside], -(above[1] - below[1])[inside] / (2 * step), rtol=1e-3)


class _Line:
    """A problem whose residuals J q - e are linear, with the lower bound 0 of the first parameter."""

    def __init__(self, e: Floats, J: Floats) -> None:
        self.e, self.J = e, J

    def linearise(self, q: Floats, starts: Floats) -> list[ResidualBlock]:
        return [ResidualBlock(self.J @ q - self.e, self.J, np.zeros((self.e.size, 2)))]

    def clip_to_bounds(self, q: Floats) -> Floats:
        return np.maximum(q, [0.0, -np.inf])


def test_the_solver_goes_along_a_bound() -> None:
    """The best point without the bound is (-1, 3). At the bound, the second parameter alone is best at 2.001."""
    J = np.array([[1.0, 1.0], [1.0, 1.001], [0.0, 0.01]])
    problem = _Line(J @ [-1.0, 3.0], J)
    noise = lambda blocks: (0.5 * float(blocks[0].e @ blocks[0].e), blocks)  # noqa: E731
    end = solve(problem, noise, np.array([0.5, 0.0]), np.zeros((1, 2)), np.zeros(2), small=1e-12)  # type: ignore[arg-type]
    best = float(J[:, 1] @ problem.e / (J[:, 1] @ J[:, 1]))
    assert end.q == pytest.approx([0.0, best], abs=1e-4)


@pytest.mark.parametrize("sd", [0.05, 0.5, 20.0])
def test_a_prior_truncates_to_a_normal_distribution(sd: float) -> None:
    """Bounds on a parameter with a prior about 0.3, for which SciPy has the truncated normal distribution."""
    prior = np.array([sd**-2, 0.0]), np.array([-0.3, 0.0])
    bound = np.array([0.5, 1.0])
    mean, covariance = allowed_region(
        np.zeros(2), np.eye(2), bound, np.eye(2) / np.sqrt(12), np.random.default_rng(2), prior
    )
    exact = truncnorm((-0.5 - 0.3) / sd, (0.5 - 0.3) / sd, 0.3, sd)
    np.testing.assert_allclose(mean, [exact.mean(), 0.0], atol=0.05 * float(exact.std()) + 0.02)
    np.testing.assert_allclose(np.diag(covariance), [exact.var(), 4 / 12], rtol=0.15)


def test_a_constant_input_determines_no_mass() -> None:
    """All parameters with the same ratios of mass, viscous friction and force beyond Coulomb friction move alike."""
    u, encoder = np.full(1000, 8.0), pmfid.Encoder(CART_RESOLUTION)
    counts = pmfid.quantize(simulate_drive(CART, u, CART_DT).x, CART_RESOLUTION)
    result = pmfid.identify(u, counts, model=pmfid.Drive(CART.input_gain), dt=CART_DT, encoder=encoder)
    assert "uncertain" in result.status
    assert result.theta_std[0] > 0.2 * result.theta[0]


def test_a_mixture_has_the_length_of_its_parts() -> None:
    one = mixture_half_length(np.ones(1), np.zeros((1, 1)), np.ones((1, 1)))
    assert one[0] == pytest.approx(1.959964, rel=1e-5)
    rare = mixture_half_length(np.array([0.96, 0.04]), np.zeros((2, 1)), np.array([[1.0], [1e6]]))
    often = mixture_half_length(np.array([0.8, 0.2]), np.zeros((2, 1)), np.array([[1.0], [1e6]]))
    assert rare[0] < 4
    assert often[0] > 1e5


@pytest.mark.parametrize("index", long_unless((1).__eq__, range(7)))
def test_the_right_model_explains_every_count(index: int) -> None:
    """One machine of each motion of the referee: an empty status, and the truth within the intervals."""
    case = right_case(index)
    answer = identify(case)
    assert list(answer.status) == []
    for name, true in case.truth.items():
        low, high = answer.interval[name]
        assert low - 0.2 * (high - low) < true < high + 0.2 * (high - low), name
        assert abs(answer.theta[name] / true - 1) < 0.005


@pytest.mark.parametrize(
    ("kind", "word"),
    [
        pytest.param("Stribeck 50 %", "Stribeck", marks=pytest.mark.long),
        pytest.param("dead time 1", "dead time", marks=pytest.mark.long),
        ("spring", "position"),
    ],
)
def test_a_force_that_the_model_lacks_is_named(kind: str, word: str) -> None:
    """The plain model would be up to 20 % off; the estimate with the force is within 1 %."""
    (case,) = make_cases(52, kind, [3 if kind == "spring" else 1])
    fitted = examine(case)
    assert any(word in one.words for one in fitted.problem.candidates)
    np.testing.assert_allclose(fitted.theta, list(case.truth.values()), rtol=0.01)


def test_friction_that_rises_smoothly_from_rest_is_named_with_its_speed() -> None:
    """An independent integrator simulates friction in proportion to tanh(v / speed)."""
    mass, viscous, coulomb, speed, step = 2.0, 4.0, 6.0, 0.05, 0.002
    u, state, y = 25.0 * RNG.choice([-1.0, 1.0], 40).repeat(40), np.zeros(2), []
    for force in u:

        def rates(_: float, state: Floats, force: float = float(force)) -> list[float]:
            return [state[1], (force - viscous * state[1] - coulomb * np.tanh(state[1] / speed)) / mass]

        y.append(state[0])
        state = solve_ivp(rates, (0, step), state, rtol=1e-9, atol=1e-12).y[:, -1]
    counts = np.floor(np.array(y) / 1e-5 + 0.4).astype(np.int64)
    result = pmfid.identify(u, counts, model=pmfid.Drive(1.0), encoder=pmfid.Encoder(1e-5), dt=step)
    np.testing.assert_allclose(result.theta, [mass, viscous, coulomb], rtol=1e-3)
    assert any("smoothly from rest as tanh(v / (0.05 m/s))" in one.sentence for one in result.findings)


def test_missing_counts_and_a_gap_of_the_input_cost_little() -> None:
    case = right_case()
    counts, u = case.counts.copy(), case.u.copy()
    counts[300:340], u[900:950] = np.nan, np.nan
    fitted = examine(replace(case, counts=counts, u=u))
    assert len(fitted.problem.stretches) == 2
    np.testing.assert_allclose(fitted.theta, list(case.truth.values()), rtol=0.005)


@pytest.mark.long
@pytest.mark.parametrize("uneven", [False, True])
def test_an_input_without_counts_moves_the_axis(uneven: bool) -> None:
    """Fifty counts are lost while a random input goes on: the motion passes the gap."""
    cases = make_cases(54, "right", range(40))
    case = next(one for one in cases if (one.t is not None) == uneven and one.motion == "prbs")
    counts, rng = case.counts.copy(), np.random.default_rng(1)
    for first in rng.integers(50, counts.size - 100, 6):
        counts[first : first + 50] = np.nan
    answer = identify(replace(case, counts=counts))
    assert list(answer.status) == []
    np.testing.assert_allclose(list(answer.theta.values()), list(case.truth.values()), rtol=2e-3)


@pytest.mark.parametrize(
    ("kind", "seed", "index", "bound"),
    [
        ("dead time 0.3", 1, 11, 1e-3),
        pytest.param("lag", 5501, 3, 2e-3, marks=pytest.mark.long),
        pytest.param("friction drift", 3117, 1, 2e-3, marks=pytest.mark.long),
        pytest.param("quadratic", 31337, 0, 3e-5, marks=pytest.mark.long),
        pytest.param("cogging", 777, 2, 1e-4, marks=pytest.mark.long),
    ],
)
def test_a_force_is_found_from_the_blind_start(kind: str, seed: int, index: int, bound: float) -> None:
    """Steps from the plain motion end 0.04 to 67 % off. Least squares sees no dead time next to the time constant."""
    (case,) = make_cases(seed, kind, [index])
    np.testing.assert_allclose(examine(case).theta, list(case.truth.values()), rtol=bound)


@pytest.mark.long
def test_cogging_that_pushes_the_motion_away_is_followed_through_parts() -> None:
    """Without parts of the record first, the mass is 0.08 % off and the record unmodelled."""
    case = make_case("cogging", 2)
    result, true = identify_case(case), case.machine.drive
    assert result.status == ()
    truth = [true.mass, true.viscous_friction, true.coulomb_friction]
    np.testing.assert_allclose(result.theta[:3], truth, rtol=1e-4)


@pytest.mark.parametrize("seed", [15, 17, 20])
def test_noise_far_below_a_count_is_in_the_intervals(seed: int) -> None:
    """Noise makes the region of the counts too small, and errors were up to 4 half lengths of the intervals."""
    rng = np.random.default_rng([5, seed])
    u = prbs(1000, clock=20, amplitude=4.0, rng=rng)
    x, resolution = simulate_drive(CART, u, CART_DT).x, 1e-3
    counts = np.rint(x / resolution + 0.002 * rng.standard_normal(u.size)).astype(int)
    found = pmfid.identify(u, counts, model=pmfid.Drive(CART.input_gain), dt=CART_DT, encoder=pmfid.Encoder(resolution))
    assert found.interval_95 is not None
    low, high = found.interval_95[:3].T
    assert np.all(np.abs(TRUTH - (low + high) / 2) < 0.6 * (high - low))


def test_a_record_without_counts_bounds_no_motion() -> None:
    fitted = examine(right_case())
    floats = [replace(one, counted=np.zeros_like(one.counted)) for one in fitted.problem.stretches]
    q, starts = fitted.solution.q, fitted.solution.starts
    at = q, starts, np.append(np.ones(q.size), start_precision(starts)), 0.01
    assert reach_counts(fitted.problem, *at) is not None
    assert reach_counts(replace(fitted.problem, stretches=tuple(floats)), *at) is None


@pytest.mark.long
def test_forces_at_the_measured_positions_follow_the_record() -> None:
    (case,) = make_cases(4711, "gravity", [7])
    fitted = examine(case)
    held = fitted.problem.hold_position()
    assert {one.force.kind for one in held.candidates if one.name == "gravity" and one.force} == {"column"}
    assert all(np.mean(block.e**2) < 0.15 for block in held.linearise(fitted.solution.q, fitted.solution.starts))


def test_an_axis_at_rest_is_refused() -> None:
    method = MotionFit(pmfid.Drive(1.0), pmfid.Encoder(1e-4), 0.01, 20.0)
    refused(("does not move", lambda: method.fit(INPUT, np.zeros(STEPS, np.int64))), kind=pmfid.NotIdentifiableError)


def test_a_motion_beyond_the_range_of_numbers_is_refused() -> None:
    """A clipped counter once ended with eigenvalues that did not converge."""
    lost = np.full((2, 2), np.nan)
    refused(("exceeds the range of numbers", lambda: inverse(lost)), kind=pmfid.NotIdentifiableError)


def test_linear_algebra_has_one_thread() -> None:
    with threadpool_limits(2, "blas"):
        pools = use_one_thread(threadpool_info)(), threadpool_info()
    assert [{one["num_threads"] for one in pool if one["user_api"] == "blas"} for pool in pools] == [{1}, {2}]
