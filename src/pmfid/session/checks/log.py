"""The material of all checks: a record, its configuration, and quantities derived from both once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pmfid.encoder import Encoder
from pmfid.estimators.plants import plant_of
from pmfid.models.drive import Drive
from pmfid.session.checks.stops import Stop, held_back, long_stops, sudden
from pmfid.session.checks.view import View, best_view
from pmfid.session.config import Axis
from pmfid.session.known import finds_gain, set_any_gain
from pmfid.session.outliers import repair_as_configured
from pmfid.session.records import Record
from pmfid.types import Counts, Floats

__all__ = ["CheckedLog", "hasty", "liveliest"]

#: Samples of the part of a record that is filtered: the part with the most motion.
MOST_SAMPLES = 8000


@dataclass(frozen=True, eq=False)
class CheckedLog:
    """A record as read with a configuration, and quantities that several checks share."""

    record: Record
    axis: Axis

    @cached_property
    def change(self) -> Counts:
        """(n - 1,) of the counts from sample to sample."""
        return np.asarray(np.diff(self.record.counts))

    @cached_property
    def is_machine(self) -> bool:
        """Does the model have a position and a mass, as the readings assume?"""
        equation = set_any_gain(self.axis).model.make().equation
        return plant_of(equation).rests and equation.order == 2

    @cached_property
    def known(self) -> Record:
        """The record without samples that no motion explains."""
        return repair_as_configured(self.record, set_any_gain(self.axis)).record

    @cached_property
    def force(self) -> Floats:
        """(n,): the input with the sign that the configuration gives its force."""
        gain = set_any_gain(self.axis).model.make().equation.input_gain
        return np.asarray(np.sign(gain) * self.known.u)

    @property
    def knows_sign(self) -> bool:
        """Does the configuration say which way the input drives?"""
        return not finds_gain(self.axis)

    @cached_property
    def encoder(self) -> Encoder:
        return Encoder(self.record.resolution, standstill_time=self.axis.encoder.standstill_time)

    @cached_property
    def part(self) -> slice:
        """The samples that are filtered."""
        return liveliest(self.known.counts)

    @cached_property
    def view(self) -> View | None:
        """The filtered record, with the columns as they are named; None if it shows no motion."""
        return best_view(self.force[self.part], self.known.counts[self.part], self.encoder, self.record.dt)

    @cached_property
    def closest_view(self) -> View | None:
        """The view that explains more of the input: of the plain drive, or of the configured one with its gravity,
        spring or cogging."""
        model = set_any_gain(self.axis).model.make()
        if self.view is None or not isinstance(model, Drive):
            return self.view
        own = replace(model.symmetric, input_gain=1.0, offset=True, dead_time=0.0, lag=0.0, axis="linear")
        counts = self.known.counts[self.part]
        configured = best_view(self.force[self.part], counts, self.encoder, self.record.dt, model=own)
        known = [one for one in (self.view, configured) if one is not None]
        return min(known, key=lambda one: one.unexplained)

    @cached_property
    def sudden_stops(self) -> list[Stop]:
        """Stretches of equal counts in which the axis does not rest."""
        counts = self.record.counts
        stops = long_stops(counts)
        found = sudden(counts, stops) if stops else set()
        if stops and not found and self.view is not None and self.is_machine:
            offset = self.part.stop - self.view.z.size
            inside = [stop for stop in stops if stop[1] < self.part.stop]
            found = held_back(self.force, inside, self.view, offset, self.record.dt, self.record.resolution)
        return sorted(found)


def hasty(change: Counts | Floats) -> float:
    """How much changes (n,) differ from one to the next, in parts of their size."""
    power = float(np.mean(np.square(change, dtype=np.float64)))
    return float(np.sqrt(np.mean(np.square(np.diff(change), dtype=np.float64)) / max(power, 1e-300)))


def liveliest(counts: Counts, most: int = MOST_SAMPLES) -> slice:
    """The `most` consecutive samples over which the counts change most; all samples if there are fewer."""
    if counts.size <= most:
        return slice(0, counts.size)
    travelled = np.r_[0, np.cumsum(np.abs(np.diff(counts)))]
    start = int(np.argmax(travelled[most - 1 :] - travelled[: counts.size - most + 1]))
    return slice(start, start + most)
