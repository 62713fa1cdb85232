"""The fit of a machine to a record: its estimate, covariance and intervals."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from pmfid.errors import NotIdentifiableError
from pmfid.fit.build import PIECES, add_forces, complete_readings, prune, settle_either
from pmfid.fit.compare import NORMAL_95
from pmfid.fit.likelihood import Gaussian, Intervals
from pmfid.fit.openings import LostMotionError, begin
from pmfid.fit.posterior import allowed_region
from pmfid.fit.problem import FitProblem
from pmfid.fit.search import EXPLAINED, FOLLOW, GAIN, FitSearch, with_columns
from pmfid.fit.second_mass import PairTrial
from pmfid.fit.solve import Normal, Optimum, covariance_of, inverse, normal_of, root_of_rows, solve
from pmfid.fit.tuning import PLAY_TUNING
from pmfid.fit.weighing import WeighedForce, weigh
from pmfid.fit.within import find_depth, information_rows, reach_counts, stack, start_precision, usual_depth
from pmfid.threads import use_one_thread
from pmfid.types import Floats

#: Blocks of a record whose scores are compared with the information.
BLOCKS = 40


@dataclass(frozen=True, eq=False)
class Fitted:
    """A fit with the forces that the comparison added.

    `theta` (p,) and `covariance` (p, p) belong to the machine's parameters. `half` (p,) is the half length of the 95 %
    intervals over the chosen model and the models next to it. `reach` (p,) is the largest error that residuals of this
    size may cause, whatever their shape. `solution` belongs to `problem`, whose candidates are the chosen ones.
    `likelihood` is that of the residuals. `plain` (p,) are the machine's parameters without candidates. `rival` names
    the force that widens the intervals most. `weighed` has an entry for each force of the table. `uncut` is the record
    of a fit to shorter stretches. `trial` is the search for a second mass.
    """

    problem: FitProblem
    solution: Optimum
    likelihood: Gaussian | Intervals
    theta: Floats
    covariance: Floats
    half: Floats
    reach: Floats
    plain: Floats
    rival: str
    weighed: tuple[WeighedForce, ...] = ()
    uncut: FitProblem | None = None
    trial: PairTrial | None = None

    @property
    def whole(self) -> FitProblem:
        """The problem with its candidates on stretches that were not cut."""
        if self.uncut is None:
            return self.problem
        problem, candidates = with_columns(self.uncut, self.problem.candidates)
        return replace(problem, parts=self.problem.parts).with_candidates(candidates)

    @property
    def left(self) -> float:
        """Part of the travel that the motion leaves unexplained, root mean square over root mean square."""
        travel = np.concatenate([one.y - np.mean(one.y) for one in self.problem.stretches]) / self.problem.resolution
        return float(np.linalg.norm(np.concatenate(self.residuals)) / max(float(np.linalg.norm(travel)), 1e-300))

    @property
    def follows(self) -> bool:
        """Whether the motion explains more of the travel than an axis at rest, which leaves all of it."""
        return self.left < 1.0

    def scale_reach(self, sizes: Floats) -> Floats:
        """Return `reach` over sizes (p,), or 0 where the residuals are rounding or white noise."""
        wanders = isinstance(self.likelihood, Gaussian) and self.likelihood.wanders
        return self.reach / sizes if wanders else np.zeros(self.reach.size)

    @property
    def residuals(self) -> list[Floats]:
        """Residuals (k,) of each stretch [counts]."""
        return self.problem.residuals(self.solution.q, self.solution.starts)


#: Makes the search for the forces that explain a record.
MakeSearch = Callable[[FitProblem], FitSearch]


@use_one_thread
def fit(problem: FitProblem, search: MakeSearch = FitSearch, elastic: bool = False) -> Fitted:
    """Fit a machine to a record. A `search` of its own may begin elsewhere.

    A model that explains every count is the end. So are two masses that do, if an `elastic` axis may be meant.
    Otherwise the comparison adds or drops one force at a time, in the noise of the residuals, until the counts are
    explained or no force gains evidence.

    A free axis forgets no error of its position, and a force of the position may even push the axis away. Where no
    motion over the whole record follows, shorter stretches have starts of their own (Bock 1983).

    Raises NotIdentifiableError if the axis does not move, or if no motion of the machine follows it.
    """
    pushes = any(force.kind in ("spring", "wave") for force in problem.machine.forces)
    trial = PairTrial(problem) if elastic else None
    whole, lost = None, False
    try:
        whole = _begin(search(problem), whole=True)
    except NotIdentifiableError as error:
        lost = isinstance(error, LostMotionError)
    # pieces may explain what neither the whole motion nor two masses do
    pending = pushes and whole is not None and whole[1] is None and not (trial and trial.explains)
    if not pending and (fitted := _follow(whole, trial)) is not None:
        return fitted
    try:
        pieces = _begin(search(problem.cut(PIECES)))
        if pending and pieces[1] is None and (fitted := _follow(whole, trial)) is not None:
            return fitted
        return replace(_finish(*pieces, trial), uncut=problem)
    except NotIdentifiableError:
        if not lost:
            raise
        return _finish(*_begin(search(problem)), trial)


def _follow(begun: tuple[FitSearch, Intervals | None] | None, trial: PairTrial | None) -> Fitted | None:
    """Return the fit of a search that has begun, or None if its motion does not follow the record."""
    with suppress(NotIdentifiableError):
        if begun is not None and (fitted := _finish(*begun, trial)).follows:
            return fitted
    return None


def _begin(search: FitSearch, whole: bool = False) -> tuple[FitSearch, Intervals | None]:
    return search, begin(search, whole)


def _finish(search: FitSearch, likelihood: Intervals | None, trial: PairTrial | None) -> Fitted:
    if likelihood is not None:
        return conclude(search, prune(search, likelihood))
    kinds = settle_either(search)
    explains = trial is not None and trial.explains
    return replace(conclude(search, search.noise if explains else add_forces(search, kinds)), trial=trial)


def conclude(search: FitSearch, likelihood: Gaussian | Intervals) -> Fitted:
    complete_readings(search)
    search.move_constants()
    prior = search.prior(search.problem)
    optimum = solve(search.problem, likelihood, search.q, search.starts, prior, 5)
    if isinstance(likelihood, Intervals):
        optimum = _move_inside(search, likelihood, optimum)
    if search.reaches_bound(optimum.q):
        raise NotIdentifiableError(f"no motion of the model follows the record; {FOLLOW}")
    if isinstance(likelihood, Gaussian):
        search.check_followed(likelihood)
    theta, covariance = _estimate(search, optimum, likelihood)
    local = search.local(soften(likelihood))
    half, rival = local.half_length(search.chosen, _rivals(search), np.diag(covariance), np.eye(search.count))
    half = np.hypot(half, NORMAL_95 * _shift_by_noise(search, optimum, likelihood)[: search.count])
    half[list(search.plain.machine.further[3:])] += PLAY_TUNING.narrowest * search.problem.resolution  # the least gap
    lift = np.ones(search.count)
    lift[search.plain.machine.logs] = theta[search.plain.machine.logs]
    shift = local.evidence([])[1][: search.count] - local.evidence(search.chosen)[1][: search.count]
    return Fitted(
        search.problem,
        optimum,
        likelihood,
        theta,
        covariance * np.outer(lift, lift),
        half * lift,
        largest_errors(search, optimum)[: search.count] * lift,
        theta + shift * lift,
        search.table[rival].words if rival is not None else "",
        _weigh(search, optimum, likelihood, lift),
    )


def _rivals(search: FitSearch) -> list[int]:
    """Return the candidates that may be missing. A travel of less than half a period of an error of the encoder shows
    the error as a scale and a bend, and the scale of the encoder is the user's."""
    return [i for i, one in enumerate(search.table) if one.reading is None or one.reading[0] < 4 * search.sizes.travel]


def _move_inside(search: FitSearch, likelihood: Intervals, optimum: Optimum) -> Optimum:
    """Return an optimum within every count, or the optimum itself if there is none nearby."""
    precision = np.append(search.prior(search.problem), start_precision(optimum.starts))
    at = reach_counts(search.problem, optimum.q, optimum.starts, precision, 0.0)
    if at is None:
        return optimum
    cost, blocks = likelihood(search.problem.linearise(*at))
    return Optimum(*at, cost, normal_of(blocks, at[1]), settled=True)


def _shift_by_noise(search: FitSearch, optimum: Optimum, likelihood: Gaussian | Intervals) -> Floats:
    """Return the changes (p,) of the parameters between a force that wanders and an error of the position.

    Either is as good an estimate of the right model, so that their distance shows what a wrong one does (Hausman 1978).
    """
    shift = np.zeros(optimum.q.size)
    if not isinstance(likelihood, Gaussian) or not likelihood.wanders:
        return shift
    search.q, search.starts = optimum.q, optimum.starts
    for kind in search.wandering:
        noise = search.estimate_noise((kind,))
        other = solve(search.problem, noise, optimum.q, optimum.starts, search.prior(search.problem), 10, GAIN)
        shift = np.maximum(shift, np.abs(other.q - optimum.q))
    return shift


def largest_errors(search: FitSearch, optimum: Optimum) -> Floats:
    """Return the largest errors (p,) of the parameters by least squares, by any errors of the positions with the sum of
    squares that the residuals have in excess of rounding (inequality of Cauchy and Schwarz)."""
    blocks = search.problem.linearise(optimum.q, optimum.starts)
    excess = sum(float(np.sum(block.e**2)) - block.e.size / 12 for block in blocks)
    A = normal_of(blocks, optimum.starts).A + 1e-6 * np.diag(search.prior(search.problem))
    return np.sqrt(np.diag(inverse(A)) * max(excess, 0.0))


def soften(likelihood: Gaussian | Intervals) -> Gaussian | Intervals:
    """Return a likelihood whose curvature is that of the errors, and not that of the few counts at their bounds."""
    return Intervals(likelihood.stretches, EXPLAINED) if isinstance(likelihood, Intervals) else likelihood


def _weigh(
    search: FitSearch, optimum: Optimum, likelihood: Gaussian | Intervals, lift: Floats
) -> tuple[WeighedForce, ...]:
    """Return the forces of the table in the noise of the residuals, which is rounding if every count is explained."""
    noise = likelihood if isinstance(likelihood, Gaussian) else Gaussian(search.plain.stretches)
    normal = normal_of(noise(search.problem.linearise(optimum.q, optimum.starts))[1], optimum.starts)
    covariance = sandwich(normal, search.prior(search.problem))
    at = search.problem.places
    return weigh(
        search.local(noise), search.table, search.chosen, optimum.q[at], np.sqrt(np.diag(covariance))[at], lift
    )


def _estimate(search: FitSearch, optimum: Optimum, likelihood: Gaussian | Intervals) -> tuple[Floats, Floats]:
    """Return the machine's parameters (p,), and their covariance with the mass as a logarithm."""
    theta, prior, count = search.problem.theta(optimum.q), search.prior(search.problem), search.count
    if isinstance(likelihood, Gaussian):
        return theta, sandwich(optimum.normal, prior)[:count, :count]
    if optimum.q.size + optimum.starts.size < BLOCKS:  # more parameters than that would make the walk long
        return _estimate_in_region(search, optimum)
    blocks = search.problem.linearise(optimum.q, optimum.starts)
    if search.plain.machine.precision is not None:  # the columns leave no error of the counts but their bounds
        normal = normal_of(soften(likelihood)(blocks)[1], optimum.starts)
        return theta, covariance_of(normal, prior)[:count, :count]
    plain = normal_of(Gaussian(search.plain.stretches)(blocks)[1], optimum.starts)
    return theta, sandwich(plain, prior)[:count, :count]


def sandwich(normal: Normal, prior: Floats) -> Floats:
    """Return the covariance (p, p) for scores whose sums over blocks of the record scatter more than the information
    says (Huber 1967). No parameter has a smaller variance than by the information alone. The prior has precisions
    (p,)."""
    covariance = covariance_of(normal, prior)
    scattered = estimate_variance(covariance, normal, np.eye(prior.size))
    wider = np.sqrt(scattered / np.maximum(np.diag(covariance), 1e-300))
    return np.asarray(covariance * np.outer(wider, wider))


def estimate_variance(covariance: Floats, normal: Normal, rows: Floats) -> Floats:
    """Return the variances (k,) of the products of `rows` (k, p) and the parameters, as `sandwich` does for one
    parameter, for the `covariance` (p, p) by the information."""
    sums = []
    for block, inner in zip(normal.blocks, normal.inner, strict=True):
        scores = (block.J - block.K @ inner[:, 1:]) * block.e[:, None]
        sums += [part.sum(axis=0) for part in np.array_split(scores, max(1, round(BLOCKS * len(scores) / normal.rows)))]
    moves = np.array(sums) @ covariance @ rows.T
    scattered = np.sum(moves**2, axis=0) * len(sums) / max(1, len(sums) - 1)
    return np.asarray(np.maximum(scattered, np.sum((rows @ covariance) * rows, axis=1)))


def _estimate_in_region(search: FitSearch, optimum: Optimum) -> tuple[Floats, Floats]:
    e, J = stack(search.problem.linearise(optimum.q, optimum.starts))
    rows = information_rows(J, np.append(search.prior(search.problem), start_precision(optimum.starts)))
    root, count, p = root_of_rows(rows), search.count, optimum.q.size
    wide = root @ root.T
    size = np.maximum(np.linalg.norm(rows, axis=0), 1e-100)
    if np.linalg.matrix_rank(rows / size) < size.size:  # no count bounds the region
        return search.problem.theta(optimum.q), wide[:count, :count]
    shallow = max(0.0, usual_depth(J) - find_depth(e, J @ root))  # noise leaves too shallow a region
    bound = 0.5 + shallow + 1e-5 + _integration_errors(search.problem, optimum, e)
    e, J, bound = (np.concatenate(pair) for pair in zip((e, J, bound), _bound_rows(search, optimum, wide), strict=True))
    precision = np.append(search.prior(search.problem), np.zeros(len(wide) - p))
    prior = precision, np.append(optimum.q, np.zeros(len(wide) - p))
    mean, inner = allowed_region(e, J, bound, root, np.random.default_rng(1), prior)
    if not np.all(np.diag(inner)[:count] < 100 * np.diag(wide)[:count]):
        return search.problem.theta(optimum.q), wide[:count, :count]
    return search.problem.theta(optimum.q + mean[:p]), inner[:count, :count]


def _bound_rows(search: FitSearch, optimum: Optimum, wide: Floats) -> tuple[Floats, Floats, Floats]:
    """Return residuals, derivatives and bounds of one row for each parameter with a lowest value, and for each start
    state of two masses, whose motion is far from linear. The other end of a parameter's interval is out of reach."""
    lowest, size = search.plain.machine.lowest, np.sqrt(np.diag(wide))
    at = np.flatnonzero(np.isfinite(lowest))
    above = np.maximum(optimum.q[at] - lowest[at], 0.0)
    reach = above + 1e3 * size[at]
    starts = np.arange(optimum.q.size, size.size if search.plain.machine.elastic else optimum.q.size)
    e, bound = np.append(above - reach, 0 * size[starts]), np.append(reach, 3 * size[starts])
    return e, np.eye(size.size)[np.append(at, starts)], bound


def _integration_errors(problem: FitProblem, optimum: Optimum, e: Floats) -> Floats:
    """Return the errors (n,) of the simulated motion [counts]: its change with twice as many parts of an
    interval, which is three quarters of them (Richardson 1911)."""
    if not problem.integrates:
        return np.zeros(e.size)
    finer = stack(replace(problem, parts=2 * problem.parts).linearise(optimum.q, optimum.starts))[0]
    return np.asarray(np.abs(finer - e) / 0.75)
