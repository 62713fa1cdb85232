"""What an estimator owes that runs sample by sample."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from pmfid._estimate import Estimate
from pmfid.errors import UsageError
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.status import Status
from pmfid.testing.case import COPIES, Case, OnLine, last, require, require_refusal, result_of
from pmfid.testing.common import OTHER_DT
from pmfid.types import Counts, Floats

#: Samples before a copy is made or a state saved, and after it.
BEFORE, AFTER = 1000, 400
#: Relative difference of the two precisions.
SINGLE = 2e-3
HOSTILE = (0.0, 3.0, -3.0, np.nan, np.inf, -np.inf, 1e30, -1e30, 1e-40)
HOSTILE_SAMPLES = 20_000


def copies_go_on_alone(case: Case) -> None:
    """After some samples: the copy goes on with the same bits, and the original does not move meanwhile."""
    u, counts = _later(case)
    for name, again in COPIES.items():
        estimator = _run_some(case)
        before, other = estimator.get_state(), again(estimator)
        moved = _bits(other, u, counts)
        require(estimator.get_state() == before, f"the original moves with its {name}")
        require(_bits(estimator, u, counts) == moved, f"{name} goes on with other bits")


def equality_is_of_the_configuration(case: Case) -> None:
    """Not of the samples, so that a running estimator can be a key."""
    begun: object = _run_some(case)
    require(begun == case.configured, "samples make it another configuration")
    require(hash(begun) == hash(case.configured), "samples change the hash")


def parts_are_the_whole(case: Case) -> None:
    """A run in parts, the second of it by steps and from a saved state, has the bits of the whole run."""
    u, counts = _later(case)
    whole = case.start_estimator().run(case.fine.u[: BEFORE + AFTER], case.fine.counts[: BEFORE + AFTER])
    resumed = case.start_estimator()
    resumed.set_state(_run_some(case).get_state())
    stepped = [resumed.step(float(value), int(count)).theta for value, count in zip(u, counts, strict=True)]
    require(np.array_equal(np.array(stepped), whole.theta[BEFORE:]), "step from a saved state has other bits than run")
    require(np.array_equal(resumed.estimate.theta, stepped[-1]), "estimate is not the one of the last step")


def reset_is_a_start(case: Case) -> None:
    estimator = _run_some(case)
    estimator.reset()
    require(estimator.get_state() == case.start_estimator().get_state(), "reset leaves something of the samples")


def a_foreign_state_is_refused(case: Case) -> None:
    """With a UsageError, and without a trace: one of another configuration, a damaged one, and no state at all."""
    estimator = _run_some(case)
    before = estimator.get_state()
    other = Case(replace(case.configured, dt=OTHER_DT * case.configured.dt)).start_estimator()
    damaged = before[:-1] + bytes([before[-1] ^ 1])
    for what, state in (("of another dt", other.get_state()), ("that is damaged", damaged), ("of no bytes", b"")):
        require_refusal(UsageError, f"a state {what}", partial(estimator.set_state, state))
    require(estimator.get_state() == before, "a refused state leaves a trace")


def counts_are_integers(case: Case) -> None:
    require_refusal(TypeError, "a count of 7.9", lambda: case.start_estimator().step(1.0, 7.9))  # type: ignore[arg-type]


def rest_says_poor_excitation(case: Case) -> None:
    """No input and no motion: finite numbers, and the status says that nothing is learned."""
    n = 2 * case.fine.u.size // 3
    track = case.start_estimator().run(np.zeros(n), np.zeros(n, np.int64))
    require(bool(np.all(np.isfinite(track.theta))), "theta is not finite at rest")
    flagged = track.flagged(Status.POOR_EXCITATION) | track.flagged(Status.STARTING)
    require(bool(np.all(flagged[-n // 2 :])), "the status says neither poor excitation nor starting")


def anything_leaves_numbers(case: Case) -> None:
    """Inputs of any size, also none, and counts that jump: theta stays finite, and no error bar is NaN."""
    rng = np.random.default_rng(9)
    u = rng.choice(HOSTILE, HOSTILE_SAMPLES)
    track = case.start_estimator().run(u, rng.integers(-(2**31), 2**31, HOSTILE_SAMPLES))
    require(bool(np.all(np.isfinite(track.theta))), "theta is not finite")
    require(not np.any(np.isnan(track.theta_std)), "theta_std is NaN")


def precisions_agree(case: Case) -> None:
    double, single = (
        last(result_of(replace(case.configured, precision=precision), case.fine.u, case.fine.counts).theta)
        for precision in ("float64", "float32")
    )
    size = np.maximum(np.abs(double), SINGLE * np.max(np.abs(double)))
    require(bool(np.all(np.abs(single - double) < SINGLE * size)), f"float32 finds {single}, float64 {double}")


def the_kernels_own(case: Case) -> None:
    """Of what stands on the kernel: the public class of an estimate, runners that share nothing, axes side by side."""
    estimator = _run_some(case)
    if not isinstance(estimator, RecursiveEstimator):
        return
    require(isinstance(estimator.estimate, Estimate), "the estimate is no pmfid.Estimate")
    before, (u, counts) = estimator.get_state(), _later(case)
    runner = estimator.start(before)
    moved, many = _bits(runner, u, counts), estimator.run_many(u, counts[None])
    require(estimator.get_state() == before, "the estimator moves with a runner or a fleet")
    require(np.array_equal(many.theta[0, -1], runner.estimate.theta), "a fleet has other bits")
    require(_bits(estimator, u, counts) == moved, "a runner has other bits")


def _run_some(case: Case) -> OnLine:
    """The estimator after BEFORE samples."""
    estimator = case.start_estimator()
    estimator.run(case.fine.u[:BEFORE], case.fine.counts[:BEFORE])
    return estimator


def _later(case: Case) -> tuple[Floats, Counts]:
    """The samples after those."""
    part = slice(BEFORE, BEFORE + AFTER)
    return case.fine.u[part], case.fine.counts[part]


def _bits(estimator: OnLine, u: Floats, counts: Counts) -> bytes:
    """What the samples (n,) make of it, and its state after them."""
    track = estimator.run(u, counts)
    return b"".join((track.theta.tobytes(), track.theta_std.tobytes(), track.status.tobytes(), estimator.get_state()))
