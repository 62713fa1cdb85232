"""Many monitored axes in one process have the bits of a single monitor for any pieces; states are saved and moved."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from operator import methodcaller
from typing import Any

import numpy as np
import pytest

from pmfid import BCRLS, IV, RIV, RLS, Drive, Encoder, UsageError
from pmfid.estimators.configuration import like
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.kernel.saved import seal_parts
from pmfid.monitor import Alarm, Monitor, MonitorFleet, Watch
from pmfid.monitor.calibration import Calibration, NormalWork
from pmfid.monitor.chance import Chance
from pmfid.monitor.events import SETTLING, STATES, SUSPICIOUS, WATCHING, Settled
from pmfid.monitor.scores import make_scale, scores
from pmfid.simulation import CART, CART_DT, Schedule, resolution_of
from pmfid.types import Counts, Floats
from studies.monitoring.axis import INCREMENTS, changing, normal_work
from tests.conftest import long_unless

AXES = 4
SECONDS = 25.0
#: A threshold of 12.7 for 24 h.
CHANCE = Chance(1.0, (1, 32), np.ones((2, 1)), np.zeros((2, 1)), np.full((2, 1, 1), 1e6))
Report = list[tuple[Any, ...]]


def estimator(kind: type[RecursiveEstimator], start: bool = False, **options: Any) -> RecursiveEstimator:
    model = Drive(CART.input_gain, **{name: options.pop(name) for name in ("offset", "dead_time") if name in options})
    made = kind(model, Encoder(resolution_of(INCREMENTS)), CART_DT, 50.0, forgetting=0.99, **options)
    initial = dict(zip(made.names, reference(made).tolist(), strict=True))
    return like(type(made), made, initial=initial) if start else made


def reference(of: RecursiveEstimator) -> Floats:
    known = {"mass": CART.mass, "viscous_friction": CART.viscous_friction, "coulomb_friction": CART.coulomb_friction}
    return np.array([known.get(name, 0.0) for name in of.names])


@pytest.fixture(scope="module")
def normal() -> tuple[Floats, Counts]:
    return normal_work(7, INCREMENTS, 0.1)


def calibrated(of: RecursiveEstimator, normal: tuple[Floats, Counts]) -> Calibration:
    """Return a calibration with the scale of a record and arbitrary thresholds, which suffice for the comparison."""
    theta = reference(of)
    front = like(IV, of, prefilter_zeros=None)
    blocks = scores(front, theta, *normal)[20:]
    scale = make_scale(blocks)
    work = NormalWork(0.0, np.zeros(theta.size), scale, np.full(theta.size, np.inf), np.zeros(theta.size))
    return Calibration(theta, scale, work, CHANCE, np.ones(theta.size))


def with_work(calibration: Calibration) -> Calibration:
    scale = calibration.scale
    work = NormalWork(4.0, 1e-3 * calibration.theta, scale, np.full(calibration.theta.size, 3.0), scale.sigma)
    return replace(calibration, work=work)


CASES: dict[str, tuple[Callable[[], RecursiveEstimator], bool]] = {
    "riv": (lambda: estimator(RIV, True), False),
    "rls in float32": (lambda: estimator(RLS, precision="float32"), False),
    "riv in float32 with an offset": (lambda: estimator(RIV, precision="float32", offset=True), False),
    "bcrls": (lambda: estimator(BCRLS), False),
    "riv with units of work": (lambda: estimator(RIV), True),
}


def monitor_of(case: str, normal: tuple[Floats, Counts]) -> Monitor:
    make, work = CASES[case]
    calibration = calibrated(make(), normal)
    return Monitor(make(), with_work(calibration) if work else calibration, Watch())


@pytest.fixture(scope="module")
def monitor(normal: tuple[Floats, Counts]) -> Monitor:
    return monitor_of("riv", normal)


@pytest.fixture(scope="module")
def records() -> tuple[Floats, Counts]:
    """Return records (axes, n) of four axes.

    The mass of the first grows, and the second stops. The third has lost samples and glitches. The counter of the
    fourth wraps, and its friction grows.
    """
    heavier = Schedule(((0.0, CART), (6.0, replace(CART, mass=1.3 * CART.mass))))
    rougher = Schedule(((0.0, CART), (9.0, replace(CART, coulomb_friction=1.8 * CART.coulomb_friction))))
    schedules = (heavier, Schedule(((0.0, CART),)), Schedule(((0.0, CART),)), rougher)
    parts = [changing(schedule, k, INCREMENTS, SECONDS) for k, schedule in enumerate(schedules)]
    u, counts = (np.array([part[i] for part in parts]) for i in range(2))
    rng = np.random.default_rng(1)
    u[1, 800:1400], counts[1, 800:1400] = 0.0, counts[1, 800]
    counts[1, 1400:] += counts[1, 800] - counts[1, 1400]
    u[2, rng.random(u.shape[1]) < 0.01] = np.nan
    u[2, 500:540] = np.inf
    counts[2, rng.random(u.shape[1]) < 0.003] += 5000
    counts[3] = (counts[3] + 100) % 2**16
    return u, counts


@dataclass
class Turn:
    """An event of one axis: samples from a place on, or another call."""

    name: str
    values: tuple[Any, ...]


def turns(u: Floats, counts: Counts, seed: int) -> tuple[list[Any], list[list[Turn]]]:
    """Return random calls of a fleet, and the same events for each axis.

    The axes come in any order, with pieces of any length and other calls in between.
    """
    rng, done = np.random.default_rng(seed), np.zeros(len(u), int)
    calls: list[Any] = []
    single: list[list[Turn]] = [[] for _ in u]
    while np.any(left := u.shape[1] - done):
        index = rng.permutation(np.flatnonzero(left))[: rng.integers(1, len(u) + 1)]
        n = int(min(rng.integers(1, 160), left[index].min()))
        pieces = [np.array([part[axis, done[axis] : done[axis] + n] for axis in index]) for part in (u, counts)]
        calls.append(("run", index, *pieces))
        for row, axis in enumerate(index.tolist()):
            single[axis].append(Turn("run", (pieces[0][row], pieces[1][row])))
        done[index] += n
        axis = int(rng.integers(len(u)))
        place = min(int(done[axis]), u.shape[1] - 1)
        others = {
            "skip": (int(rng.integers(1, 60)),),
            "fill_gap": (int(rng.integers(1, 5)), float(u[axis, place]), int(counts[axis, place])),
            "rebase": (int(counts[axis, place - 1]),),
        }
        if done[axis] and rng.random() < 0.15:
            turn = Turn(name := str(rng.choice(list(others))), others[name])
            calls.append((axis, turn))
            single[axis].append(turn)
    return calls, single


def alone(monitor: Monitor, history: list[Turn]) -> Report:
    """Return the reports of a single monitor, sample by sample."""
    reported: Report = []
    for turn in history:
        if turn.name != "run":
            reported.append((turn.name, repr(getattr(monitor, turn.name)(*turn.values))))
            continue
        for one, count in zip(*(part.tolist() for part in turn.values), strict=True):
            estimate, events = monitor.step(one, count)
            seen = monitor.apply_known(estimate)
            numbers = seen.theta.tolist(), seen.theta_std.tolist(), seen.innovation, seen.status
            reported.append((*numbers, STATES.index(monitor.state), [repr(event) for event in events]))
    return reported


def together(fleet: MonitorFleet, calls: list[Any]) -> list[Report]:
    """Return the reports of a fleet."""
    reported: list[Report] = [[] for _ in range(fleet.axes)]
    for call in calls:
        if call[0] != "run":
            axis, turn = call
            reported[axis].append((turn.name, repr(fleet._with(axis, methodcaller(turn.name, *turn.values)))))
            continue
        rows = fleet.run(*call[1:])
        events: dict[tuple[int, int], list[str]] = {}
        for row, sample, event in rows.events:
            events.setdefault((row, sample), []).append(repr(event))
        for row, axis in enumerate(call[1].tolist()):
            lists = [part[row].tolist() for part in (rows.theta, rows.std, rows.innovation, rows.status, rows.state)]
            reported[axis] += [(*one, events.get((row, k), [])) for k, one in enumerate(zip(*lists, strict=True))]
    return reported


@pytest.mark.parametrize("case", long_unless({"riv", "rls in float32", "riv with units of work"}.__contains__, CASES))
def test_every_axis_has_the_bits_of_a_monitor_alone(
    case: str, normal: tuple[Floats, Counts], records: tuple[Floats, Counts]
) -> None:
    source = monitor_of(case, normal)
    calls, single = turns(*records, seed=list(CASES).index(case))
    fleet, before = MonitorFleet(source, AXES), source.get_state()
    reported = together(fleet, calls)
    for axis in range(AXES):
        monitor = MonitorFleet(source, 1).monitor(0)
        assert reported[axis] == alone(monitor, single[axis])
        assert monitor.get_state() == fleet.monitor(axis).get_state()
        assert fleet.samples()[axis] == monitor.samples
    assert source.get_state() == before
    said = str(reported)
    assert all(word in said for word in (WATCHING, SUSPICIOUS, SETTLING, "Alarm", "Settled", "Outlier"))


# --- saved states -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("place", [0, 613, 690, 900])
def test_a_saved_state_goes_on_with_the_same_bits(monitor: Monitor, records: tuple[Floats, Counts], place: int) -> None:
    u, counts = records
    first, second, index = MonitorFleet(monitor, AXES), MonitorFleet(monitor, 0), np.arange(AXES)
    first.run(index, u[:, :place], counts[:, :place])
    second.set_state(first.get_state())
    single = MonitorFleet(monitor, 1).monitor(0)
    single.set_state(first.monitor(0).get_state())
    one, other = (fleet.run(index, u[:, place:], counts[:, place:]) for fleet in (first, second))
    third = single.run(u[0, place:], counts[0, place:])
    assert one.theta.tolist() == other.theta.tolist()
    assert one.theta[0].tolist() == third.theta[0].tolist()
    assert repr(one.events) == repr(other.events)
    assert [repr(event) for row, _, event in one.events if row == 0] == [repr(event) for *_, event in third.events]
    assert any(isinstance(event, Alarm) for _, _, event in one.events)
    assert first.get_state() == second.get_state()
    assert b"".join(seal_parts(first.unsealed_state())) == first.get_state()
    assert first.monitor(0).get_state() == single.get_state()


def refused(fleet: MonitorFleet, state: Any, match: str) -> None:
    before = fleet.get_state()
    with pytest.raises(UsageError, match=match):
        fleet.set_state(state)
    assert fleet.get_state() == before


def test_damaged_states_change_nothing(monitor: Monitor) -> None:
    fleet = MonitorFleet(monitor, 2)
    state = fleet.get_state()
    refused(fleet, state[:100] + b"x" + state[101:], "checksum is wrong")
    for bad in (b"", state[:-1], state + b"0", state + state, state[:28]):
        refused(fleet, bad, "not a state of this monitor|checksum")
    refused(fleet, 7, "must be bytes from get_state, got int")


def test_states_of_another_configuration_are_refused(monitor: Monitor) -> None:
    fleet = MonitorFleet(monitor, 1)
    calibration, riv = monitor.calibration, estimator(RIV, True)
    others = (
        Monitor(riv, calibration, Watch(tolerance=0.05)),
        Monitor(riv, replace(calibration, theta=1.01 * calibration.theta), Watch()),
        Monitor(estimator(RIV), calibration, Watch()),
        Monitor(riv, with_work(calibration), Watch()),
        Monitor(riv, calibration, Watch(mtbf_hours=5.0)),
    )
    for other in others:
        refused(fleet, other.get_state(), "not a state of this monitor")


# --- other methods of a fleet -----------------------------------------------------------------------------------------


def test_a_new_reference_on_demand(monitor: Monitor, records: tuple[Floats, Counts]) -> None:
    """The call comes in the middle of a change: the present state becomes normal, no alarm follows, the estimates
    continue.
    """
    u, counts = records[0][0], records[1][0]
    single = MonitorFleet(monitor, 1).monitor(0)
    with pytest.raises(UsageError, match="no estimate exists yet"):
        MonitorFleet(Monitor(estimator(RIV), monitor.calibration), 1).refer(0)
    rows = single.run(u[:900], counts[:900])
    theta = rows.theta[0, -1]
    said = single.refer()
    assert isinstance(said[0], Settled)
    assert said[0].theta.tolist() == theta.tolist() == single.reference.tolist()
    later = single.run(u[900:], counts[900:])
    untouched = estimator(RIV, True).run(u[:640], counts[:640])
    assert rows.theta[0, :600].tolist() == untouched.theta[:600].tolist()
    assert not [event for *_, event in later.events if isinstance(event, Alarm)]
    with pytest.raises(UsageError, match="no machine has the parameters"):
        single.refer([-1.0, 12.0, 0.8])
