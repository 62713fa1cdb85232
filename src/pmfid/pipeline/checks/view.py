"""Quantities that the checks derive from a log, which are signals on a common grid, stops and candidate models."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pmfid.config.axis import Axis
from pmfid.diagnostics.drives import counts_per_sample
from pmfid.encoder import Encoder
from pmfid.estimators.cutoff import CUTOFF_TRIED
from pmfid.estimators.ls import LS
from pmfid.estimators.plants import plant_of
from pmfid.estimators.stretches import liveliest
from pmfid.models.drive import Drive
from pmfid.pipeline.known import set_any_gain
from pmfid.records.outliers import repair_as_configured
from pmfid.records.record import Record
from pmfid.types import Counts, Floats

#: Smallest travel that shows a motion [counts].
READINGS_FEWEST = 8
#: Smallest duration of a record in time constants. After slow filters, any columns explain a short record.
VIEW_ENOUGH = 60.0
#: Smallest part of the travel in either direction if the motion has both directions, and of the largest travel of any
#: joint.
ONE_WAY = 0.05
#: Spans that show the edges of a stop [samples]. `VIEW_COUNTS` is the smallest change of the motion at an abrupt
#: edge [counts].
VIEW_SPANS = (1, 2, 4, 8, 16, 32)
VIEW_COUNTS = 6
#: Smallest ratio of the change of the motion at an abrupt stop to the largest change elsewhere.
VIEW_ABRUPT = 2.5
#: Smallest number of samples in a stop, which is also the allowed delay of a motion, and smallest number of counts
#: that the usual speed would bring during the stop.
SHORTEST_STOP = 5
VIEW_MISSED = 4.0
#: Force that moves an axis from rest, as a multiple of the friction.
VIEW_HELD = 2.2
#: Largest number of filtered samples. The filters run over the samples with the most motion.
VIEW_MOST_SAMPLES = 8000

#: Number of pieces of a record for standard deviations, and smallest number of samples in a piece.
PARTS, SHORTEST = 8, 20
MASS, VISCOUS, COULOMB, LOAD = range(4)
#: Model of the first four columns.
PLAIN = Drive(1.0, offset=True)


@dataclass(frozen=True, eq=False)
class View:
    """Filtered columns of motion and the filtered input of a record.

    The first columns of phi (n, p) are the columns of the plain drive. The input z has shape (n,). The filters have a
    time constant of `time` samples.
    """

    time: float
    phi: Floats
    z: Floats

    @cached_property
    def basis(self) -> Floats:
        """An orthonormal basis (n, r) of the columns of phi, without the zero columns."""
        size = np.linalg.norm(self.phi, axis=0)
        return np.asarray(np.linalg.qr(self.phi[:, size > 0] / size[size > 0])[0])

    @cached_property
    def unexplained(self) -> float:
        """The part of the input that no sum of the columns explains."""
        return float(self.measure_rest(self.z))

    def shows_load(self, better: float, sure: float) -> bool:
        """Return whether a constant load is visible.

        The load must have `sure` standard deviations, and reduce the residual of the other columns below the fraction
        `better`.
        """
        certain = abs(self.sure(np.eye(self.theta.size)[LOAD])) > sure
        unloaded = View(self.time, np.delete(self.phi, LOAD, axis=1), self.z)
        return not self.one_way and certain and self.unexplained < better * unloaded.unexplained

    def measure_rest(self, z: Floats) -> float:
        """Return the part of another filtered input (n,) that no sum of the columns explains."""
        size = float(np.linalg.norm(z))
        return float(np.linalg.norm(z - self.basis @ (self.basis.T @ z))) / size if size > 0 else 1.0

    @cached_property
    def theta(self) -> Floats:
        """The parameters (p,) per unit of the input, which are mass, viscous and Coulomb friction, load and further
        terms.

        An invisible parameter is 0.
        """
        return solve_least_squares(self.phi, self.z)

    @cached_property
    def pieces(self) -> Floats:
        """The parameters (PARTS, p), each row estimated without one piece of the record."""
        edges = np.linspace(0, self.z.size, PARTS + 1).astype(int)
        rows = np.arange(self.z.size)
        kept = [(rows < a) | (rows >= b) for a, b in pairwise(edges)]
        return np.array([solve_least_squares(self.phi[keep], self.z[keep]) for keep in kept])

    def sure(self, weights: Floats) -> float:
        """Return the sum of theta (p,) with weights (p,) in standard deviations, by a jackknife over the pieces."""
        value, others = float(self.theta @ weights), self.pieces @ weights
        spread = float(np.sqrt((PARTS - 1) / PARTS * np.sum((others - others.mean()) ** 2)))
        return value / spread if spread > 0 else float(np.sign(value)) * np.inf

    @property
    def one_way(self) -> bool:
        """Whether the axis moves nearly always in one direction, so that dry friction equals a load."""
        velocity = self.phi[:, VISCOUS]
        back = float(np.sum(np.abs(velocity[velocity < 0]))) / max(float(np.sum(np.abs(velocity))), 1e-300)
        return min(back, 1 - back) < ONE_WAY

    @property
    def moving(self) -> float:
        """The effective number of moving rows, computed from the first two moments of the power."""
        power = np.square(self.phi[:, VISCOUS])
        return float(power.sum() ** 2 / max(float(np.sum(power**2)), 1e-300))

    @property
    def friction_work(self) -> Floats:
        """The weights (p,) of the power that friction takes from the motion."""
        velocity, weights = self.phi[:, VISCOUS], np.zeros(self.theta.size)
        weights[VISCOUS], weights[COULOMB] = np.mean(velocity**2), np.mean(self.phi[:, COULOMB] * velocity)
        return weights


def solve_least_squares(phi: Floats, z: Floats) -> Floats:
    """Return the least-squares solution (p,) of phi (n, p) theta = z (n,)."""
    size = np.linalg.norm(phi, axis=0)
    scale = np.where(size > 0, size, 1.0)
    return np.asarray(np.linalg.lstsq(phi / scale, z, rcond=1e-10)[0] / scale)


def view(u: Floats, counts: Counts, encoder: Encoder, dt: float, time: float, model: Drive = PLAIN) -> View | None:
    """Return the view of a record after filters with a time constant of `time` samples.

    The columns belong to the model with an input gain of 1. The result is None if the filters do not settle within the
    record.
    """
    method = LS(model, replace(encoder, guard=False), dt, 1 / (time * dt))
    if u.size < max(method.settle_samples + PARTS * SHORTEST, VIEW_ENOUGH * time):
        return None
    columns = method.columns(u, counts)
    return View(time, columns.phi, columns.z)


def best_view(
    u: Floats, counts: Counts, encoder: Encoder, dt: float, lasting: float = 0.0, model: Drive = PLAIN
) -> View | None:
    """Return the view that explains most of the input, or None if the record is too short or nothing moves.

    The function considers only views whose motion lasts for more than `lasting` time constants.
    """
    views = [view(u, counts, encoder, dt, time, model) for time in CUTOFF_TRIED]
    moved = [one for one in views if one is not None and np.any(one.z) and np.any(one.phi[:, VISCOUS])]
    seen = [one for one in moved if one.moving > lasting * one.time]
    return min(seen, key=lambda one: one.unexplained) if seen else None


#: The first and the last sample of a stretch of equal counts.
Stop = tuple[int, int]


def long_stops(counts: Counts) -> list[Stop]:
    """Return all long stretches of equal counts after the first change.

    A long stretch exceeds the usual time between two changes by far.
    """
    moving: NDArray[np.intp] = np.flatnonzero(np.diff(counts))
    if moving.size < 2:
        return []
    least = max(float(SHORTEST_STOP), VIEW_MISSED / max(counts_per_sample(counts), 1e-9))
    pairs = zip((moving + 1).tolist(), [*moving[1:].tolist(), counts.size - 1], strict=True)
    return [(first, last) for first, last in pairs if last - first >= least]


def sudden(counts: Counts, stops: list[Stop]) -> set[Stop]:
    """Return the stops that begin in full motion and end in motion."""
    edges = (counts == counts.min()) | (counts == counts.max())
    edges[[edge for stop in stops for edge in stop]] = True
    found, elsewhere = set[Stop](), 0.0
    for span in VIEW_SPANS:
        if counts.size < 4 * span:
            break
        turn = np.zeros(counts.size)
        turn[span:-span] = np.abs(counts[2 * span :] - 2 * counts[span:-span] + counts[: -2 * span])
        apart = ~_widen_marks(edges, span)
        if not np.any(apart):
            break
        long_ones = [stop for stop in stops if stop[1] - stop[0] >= span]
        # A longer span leaves fewer rows between the stops, whose change may be too small.
        elsewhere = max(elsewhere, float(np.max(turn[apart])))
        found |= _abrupt(turn, long_ones, elsewhere)
    return found


def _abrupt(turn: Floats, stops: list[Stop], elsewhere: float) -> set[Stop]:
    """Return the stops at whose ends the change of the motion (n,) is far larger than elsewhere."""
    limit = max(VIEW_ABRUPT * (elsewhere + 1), VIEW_COUNTS)
    begins, ends = (np.array([turn[stop[side]] for stop in stops]) for side in (0, 1))
    # A counter that catches up jumps to its true value. After a jump of the counter, the larger edge of a stop says
    # more than the smaller edge.
    both = (np.sqrt(begins * ends) >= limit) & (np.minimum(begins, ends) > elsewhere + 1)
    return {stop for stop, yes in zip(stops, both, strict=True) if yes}


def held_back(force: Floats, stops: list[Stop], view: View, offset: int, dt: float, resolution: float) -> set[Stop]:
    """Return the stops during which the input `force` (n,) would have moved the axis.

    `view` holds the filtered rows from `offset` on.
    """
    rows = np.arange(view.z.size) + offset
    memory = round(3 * view.time)
    resting = np.zeros(force.size, dtype=bool)
    for first, last in stops:
        resting[first : last + memory] = True
    keep = ~resting[rows]
    if np.count_nonzero(keep) < PARTS * SHORTEST:
        return set()
    theta = solve_least_squares(view.phi[keep], view.z[keep])
    if not (theta[MASS] > 0 and theta[COULOMB] >= 0):
        return set()
    return {stop for stop in stops if _moves(force[stop[0] : stop[1]], theta, dt) > READINGS_FEWEST * resolution}


def _moves(force: Floats, theta: Floats, dt: float) -> float:
    """Return the least distance by which a force (n,) moves a plant with parameters theta from rest."""
    load = theta[3] if theta.size > 3 else 0.0
    moved = 0.0
    for sign in (1.0, -1.0):
        above = sign * (force - load) - VIEW_HELD * theta[COULOMB]
        breaks = np.flatnonzero(np.diff(np.r_[0, above > 0, 0]))
        for first, last in zip(breaks[::2].tolist(), breaks[1::2].tolist(), strict=True):
            time = dt * max(0, last - first - SHORTEST_STOP)
            push = float(np.mean(above[first:last]))
            fastest = push / max(float(theta[VISCOUS]), 1e-300) if theta[VISCOUS] > 0 else np.inf
            moved = max(moved, min(push / float(theta[MASS]) * time**2 / 2, fastest * time))
    return moved


def _widen_marks(marked: NDArray[np.bool_], span: int) -> NDArray[np.bool_]:
    """Mark also the neighbours of the marked samples (n,), within `span` samples on either side."""
    return np.asarray(np.convolve(marked, np.ones(2 * span + 1), mode="same") > 0.5)


@dataclass(frozen=True, eq=False)
class CheckedLog:
    """A record as read with a configuration, and quantities that several checks share."""

    record: Record
    axis: Axis

    @cached_property
    def change(self) -> Counts:
        """The changes (n - 1,) of the counts from sample to sample."""
        return np.asarray(np.diff(self.record.counts))

    @cached_property
    def is_machine(self) -> bool:
        """Whether the model has a position and a mass, as the readings assume."""
        equation = set_any_gain(self.axis).model.make().equation
        return plant_of(equation).rests and equation.order == 2

    @cached_property
    def place_matters(self) -> bool:
        """Whether a force depends on the position, as gravity that holds a joint at rest does."""
        return set_any_gain(self.axis).model.make().equation.place_matters

    @cached_property
    def known(self) -> Record:
        """The record without samples that no motion explains."""
        return repair_as_configured(self.record, set_any_gain(self.axis)).record

    @cached_property
    def force(self) -> Floats:
        """The input (n,) with the sign of its force in the configuration."""
        gain = set_any_gain(self.axis).model.make().equation.input_gain
        return np.asarray(np.sign(gain) * self.known.u)

    @cached_property
    def encoder(self) -> Encoder:
        return Encoder(self.record.resolution, standstill_time=self.axis.encoder.standstill_time)

    @cached_property
    def part(self) -> slice:
        """The range of samples that are filtered."""
        return liveliest(self.known.counts, VIEW_MOST_SAMPLES)

    @cached_property
    def view(self) -> View | None:
        """The filtered record with the configured columns, or None if the record shows no motion."""
        return best_view(self.force[self.part], self.known.counts[self.part], self.encoder, self.record.dt)

    @cached_property
    def closest_view(self) -> View | None:
        """The view of the plain drive or the configured drive, whichever explains more of the input.

        The configured drive includes gravity, spring and cogging.
        """
        model = set_any_gain(self.axis).model.make()
        if self.view is None or not isinstance(model, Drive):
            return self.view
        own = replace(model.symmetric, input_gain=1.0, offset=True, dead_time=0.0, lag=0.0, axis="linear")
        counts = self.known.counts[self.part]
        configured = best_view(self.force[self.part], counts, self.encoder, self.record.dt, model=own)
        known = [one for one in (self.view, configured) if one is not None]
        return min(known, key=lambda one: one.unexplained)

    @property
    def elastic(self) -> bool:
        """Whether the model has two masses."""
        return set_any_gain(self.axis).model.make().equation.elastic

    @cached_property
    def sudden_stops(self) -> list[Stop]:
        """Stretches of equal counts during which the axis is not at rest."""
        counts = self.record.counts
        if self.elastic:
            return []  # a motor that friction holds stops suddenly, because its load moves on
        stops = long_stops(counts)
        found = sudden(counts, stops) if stops else set()
        if stops and not found and self.view is not None and self.is_machine and not self.place_matters:
            offset = self.part.stop - self.view.z.size
            inside = [stop for stop in stops if stop[1] < self.part.stop]
            found = held_back(self.force, inside, self.view, offset, self.record.dt, self.record.resolution)
        return sorted(found)


def hasty(change: Counts | Floats) -> float:
    """Return the size of the differences between successive changes (n,), relative to the size of the changes."""
    power = float(np.mean(np.square(change, dtype=np.float64)))
    return float(np.sqrt(np.mean(np.square(np.diff(change), dtype=np.float64)) / max(power, 1e-300)))
