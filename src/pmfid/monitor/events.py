"""Events and rows of a monitor."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pmfid.errors import UsageError
from pmfid.estimators.facts import INPUT_GAIN
from pmfid.types import Floats

#: The measured motion over the true motion, as a cause of a change.
ENCODER_SCALE = "encoder_scale"

STARTING, WATCHING, CANNOT_TELL, SUSPICIOUS, SETTLING = (
    "starting",
    "watching",
    "cannot tell",
    "suspicious",
    "settling",
)
#: All states, in the order of their numbers.
STATES = (STARTING, WATCHING, CANNOT_TELL, SUSPICIOUS, SETTLING)


@dataclass(frozen=True)
class Watch:
    """The settings of a monitor, with rate of false alarms and tolerance.

    Parameters
    ----------
    mtbf_hours
        Mean time between false alarms [h], in [0.1, 1e6].
    tolerance
        Relative deviation of a parameter that is no change, in [0, 1).

    Raises
    ------
    UsageError
        If a value is outside these bounds.

    Examples
    --------
    >>> from pmfid.monitor import Watch
    >>> Watch(mtbf_hours=100.0)
    Watch(mtbf_hours=100.0, tolerance=0.02)
    """

    mtbf_hours: float = 24.0
    tolerance: float = 0.02

    def __post_init__(self) -> None:
        if not 0.1 <= self.mtbf_hours <= 1e6:
            raise UsageError(f"mtbf_hours must be in [0.1, 1e6], got {self.mtbf_hours}; the unit is hours")
        if not 0 <= self.tolerance < 1:
            raise UsageError(f"tolerance must be in [0, 1), got {self.tolerance}; 0.02 is 2 %")


@dataclass(frozen=True)
class Change:
    """A change of one parameter, or of a common factor of several parameters.

    Attributes
    ----------
    parameter
        Name of the parameter; "input_gain"; "encoder_scale", the measured over the true motion; or "friction" if all
        frictions changed alike.
    unit
        Unit of the parameter.
    change, std
        Size of the change and its standard deviation [unit]; relative for "encoder_scale" and "friction".
    relative
        Change over the reference value. The change of an offset is relative to Coulomb friction if that is larger.

    Examples
    --------
    >>> from pmfid.monitor import Change
    >>> Change("mass", "kg", change=0.37, std=0.02, relative=0.35).scale(2.0).change
    0.74
    """

    parameter: str
    unit: str
    change: float
    std: float
    relative: float

    @property
    def relative_std(self) -> float:
        """Standard deviation of `relative`."""
        return self.std * abs(self.relative / self.change) if self.change else math.inf

    def scale(self, factor: float) -> Change:
        """Return the same relative change of a parameter that is larger by a factor."""
        return replace(self, change=factor * self.change, std=abs(factor) * self.std)


@dataclass(frozen=True)
class Alarm:
    """One change, or several at the same time.

    `parameter`, `unit`, `change`, `std` and `relative` belong to the largest change.

    Attributes
    ----------
    time
        Time of the alarm [s].
    changed_at
        Time at which the change began to show [s].
    changes
        The changes, the largest first.
    statistic, threshold
        Statistic at the first suspicion, and its threshold.
    others
        Other causes that explain the samples so far as well, such as "input_gain and mass".
    tolerance
        Relative deviation that is no change, or 0 if unknown.

    Examples
    --------
    >>> from pmfid.monitor import Alarm, Change
    >>> mass = Change("mass", "kg", change=0.37, std=0.02, relative=0.35)
    >>> alarm = Alarm(12.5, 11.9, (mass,), statistic=30.0, threshold=12.0)
    >>> alarm.parameter, alarm.relative, alarm.others
    ('mass', 0.35, ())
    """

    time: float
    changed_at: float
    changes: tuple[Change, ...]
    statistic: float
    threshold: float
    others: tuple[str, ...] = ()
    tolerance: float = 0.0

    @property
    def parameter(self) -> str:
        return self.changes[0].parameter

    @property
    def unit(self) -> str:
        return self.changes[0].unit

    @property
    def change(self) -> float:
        return self.changes[0].change

    @property
    def std(self) -> float:
        return self.changes[0].std

    @property
    def relative(self) -> float:
        return self.changes[0].relative

    @property
    def causes(self) -> frozenset[str]:
        """The names of all changes."""
        return frozenset(one.parameter for one in self.changes)

    @property
    def advice(self) -> str:
        """Sentences that say what people check first, for every possible cause."""
        causes = [
            *(one.parameter for one in self.changes),
            *(name for one in self.others for name in one.split(" and ")),
        ]
        found = (next((text for name, text in _ADVICE if one.startswith(name)), _USUAL_ADVICE) for one in causes)
        return " ".join(dict.fromkeys(found))


#: What people check first, by the beginning of the parameter's name.
_ADVICE = (
    (("mass", "inertia"), "Check whether the load was changed or came loose, or another part moves with the axis."),
    (("viscous", "friction"), "Check lubrication, temperature and bearings."),
    (("coulomb", "stribeck"), "Check brakes, guides, seals and belt tension for rubbing."),
    (("offset", "gravity"), "Check the counterweight and the load."),
    (("stiffness", "cogging"), "Check springs, couplings and the motor."),
    ((INPUT_GAIN,), "Check the drive, its supply and the sensor of the input."),
    ((ENCODER_SCALE,), "Check the resolution of the encoder, its coupling, and the belt or gear in front of it."),
)
_USUAL_ADVICE = "Compare the charts of the axis with its reference record."


@dataclass(frozen=True)
class Settled:
    """A new reference after an alarm.

    Attributes
    ----------
    time
        Time of the event [s].
    theta, std
        (q,) parameters that the monitor reports, and their standard deviations, in their units.
    before
        (q,) previous reference.
    gain
        New gain, its standard deviation and the previous gain if only the input gain has changed, otherwise None. Then
        theta refers to the previous gain.
    rate
        Relative change per hour of the parameter in the last alarm, while its slow change goes on without a further
        alarm; otherwise None.
    changes, others
        The changes since `before` and other causes, as in `Alarm`, by all samples since the alarm. They are empty for a
        reference on demand.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid.monitor import Settled
    >>> event = Settled(20.0, np.array([1.44]), np.array([0.01]), before=np.array([1.07]))
    >>> (event.theta - event.before).round(2).tolist()
    [0.37]
    """

    time: float
    theta: Floats
    std: Floats
    before: Floats
    gain: tuple[float, float, float] | None = None
    rate: float | None = None
    changes: tuple[Change, ...] = ()
    others: tuple[str, ...] = ()


@dataclass(frozen=True)
class StateChange:
    """A change of the monitor's state.

    Attributes
    ----------
    time
        Time from which the state holds [s].
    state
        "starting", "watching", "cannot tell", "suspicious" or "settling".
    reason
        Reason of the state.

    Examples
    --------
    >>> from pmfid.monitor import StateChange
    >>> StateChange(3.0, "cannot tell", "standstill").reason
    'standstill'
    """

    time: float
    state: str
    reason: str


@dataclass(frozen=True)
class Outlier:
    """A sample that no motion explains. The sample is left out, and monitoring continues.

    Attributes
    ----------
    time
        Time of the sample [s].
    signal
        "counts" or "input".

    Examples
    --------
    >>> from pmfid.monitor import Outlier
    >>> Outlier(3.0, "counts")
    Outlier(time=3.0, signal='counts')
    """

    time: float
    signal: str


Event = Alarm | Settled | StateChange | Outlier


@dataclass(frozen=True)
class FleetRows:
    """Results for n samples of k axes.

    Attributes
    ----------
    theta, std
        (k, n, q) reported parameters and their standard deviations, in their units.
    innovation
        (k, n) errors of the equation before the update.
    status
        (k, n) status bits of the estimates; see `Status`.
    state
        (k, n) states of the monitors after each sample: 0 starting, 1 watching, 2 cannot tell, 3 suspicious, 4
        settling.
    events
        Tuples (row, sample, event), sorted by row and then by time.

    Examples
    --------
    >>> from pmfid.monitor import FleetRows
    >>> rows = FleetRows.empty(axes=2, samples=100, parameters=3)
    >>> rows.theta.shape, rows.state.shape, rows.events
    ((2, 100, 3), (2, 100), [])
    """

    theta: Floats
    std: Floats
    innovation: Floats
    status: NDArray[np.uint32]
    state: NDArray[np.uint8]
    events: list[tuple[int, int, Event]]

    @classmethod
    def empty(cls, axes: int, samples: int, parameters: int) -> FleetRows:
        """Return uninitialised arrays for `axes` axes, `samples` samples and `parameters` parameters."""
        shape = (axes, samples)
        theta, std = np.empty((*shape, parameters)), np.empty((*shape, parameters))
        return cls(theta, std, np.empty(shape), np.empty(shape, np.uint32), np.empty(shape, np.uint8), [])

    def take(self, part: FleetRows, rows: slice, time: slice) -> None:
        """Copy `part` with its events into some rows and samples."""
        for name in ("theta", "std", "innovation", "status", "state"):
            getattr(self, name)[rows, time] = getattr(part, name)
        self.events.extend((rows.start + row, (time.start or 0) + sample, event) for row, sample, event in part.events)
