"""Very many axes in shards: the bits of a plain fleet, unique handles, and checkpoints that survive kills."""

from __future__ import annotations

import errno
import json
import os
import random
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pmfid
from pmfid import durable as crash
from pmfid import durable as envelope
from pmfid.estimators import shards as stored
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.shards import LAST, Handles, state_of
from pmfid.status import Status
from tests.test_many import assert_equal_tracks, make

AXES, SHARD, SAMPLES = 1000, 256, 40
RNG = np.random.default_rng(11)
U = RNG.choice([-3.0, 3.0], (AXES, SAMPLES // 5)).repeat(5, axis=1)
COUNTS = np.cumsum(np.cumsum(U, axis=1) // 2, axis=1).astype(np.int64) + RNG.integers(-2, 3, U.shape)
BCRLS = make(pmfid.BCRLS)


def some(axes: int = AXES, part: slice = slice(None)) -> tuple[np.ndarray, np.ndarray]:
    return U[:axes, part], COUNTS[:axes, part]


@pytest.fixture(scope="module")
def plain() -> pmfid.Tracks:
    """Return the output of a plain fleet, in two calls."""
    fleet = pmfid.Fleet(BCRLS, AXES)
    fleet.run(*some(part=slice(25)))
    return fleet.run(*some(part=slice(25, None)))


def states(fleet: pmfid.ShardedFleet) -> dict[int, bytes]:
    """Return the state of each axis, as bytes in memory, by its handle."""
    rows = {handle: fleet._row(handle) for handle in fleet.handles().tolist()}
    return {handle: shard.states[row].tobytes() for handle, (shard, row) in rows.items()}


@pytest.fixture(autouse=True)
def closed() -> Iterator[None]:
    """Close the fleets of a test, so that their folders become free."""
    yield
    while _OPEN:
        _OPEN.pop().close()


def kept(fleet: pmfid.ShardedFleet) -> pmfid.ShardedFleet:
    """Register a fleet to be closed after the test."""
    _OPEN.append(fleet)
    return fleet


_OPEN: list[pmfid.ShardedFleet] = []


# --- samples ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("workers", [1, 3])
def test_all_axes_have_the_bits_of_a_plain_fleet(plain: pmfid.Tracks, workers: int) -> None:
    fleet = pmfid.ShardedFleet(shard=SHARD, workers=workers)
    handles = fleet.add(BCRLS, AXES)
    assert handles.tolist() == list(range(AXES))
    fleet.run(handles, *some(part=slice(25)))
    assert_equal_tracks(fleet.run(handles, *some(part=slice(25, None))), plain)
    assert not np.all(plain.status & Status.STARTING), "the record does not test what it is for"


@pytest.mark.parametrize(
    ("cls", "precision"), [(pmfid.RIV, "float64"), (pmfid.BCRLS, "float32"), (pmfid.RLS, "float64")]
)
def test_some_axes_in_any_order_have_the_bits_that_they_have_alone(
    cls: type[RecursiveEstimator], precision: str
) -> None:
    fleet = pmfid.ShardedFleet(shard=16, workers=2)
    handles = fleet.add(make(cls, precision), 70)
    chosen = np.random.default_rng(1).permutation(70)[:41]
    first = fleet.run(handles[chosen], *(table[chosen, :25] for table in some()))
    second = fleet.run(handles, *some(70, slice(25, None)), every=4)
    for place, axis in enumerate(chosen.tolist()):
        alone = make(cls, precision)
        track = alone.run(U[axis, :25], COUNTS[axis, :25])
        assert np.array_equal(first.theta[place, -1], track.theta[-1])
        track = alone.run(U[axis, 25:], COUNTS[axis, 25:])
        assert np.array_equal(second.theta[axis], track.theta[[3, 7, 11, 14]])
        assert fleet.axis(handles[axis]).get_state() == alone.get_state()
    rested = next(axis for axis in range(70) if axis not in chosen)
    fresh = make(cls, precision)
    assert np.array_equal(second.theta[rested, -1], fresh.run(U[rested, 25:], COUNTS[rested, 25:]).theta[-1])


def test_axes_begin_where_their_runner_is() -> None:
    runner = make(pmfid.RIV).start()
    runner.run(U[3, :20], COUNTS[3, :20])
    fleet = pmfid.ShardedFleet(shard=4)
    handles = np.concatenate([fleet.add(BCRLS, 2), fleet.add(make(pmfid.RIV), 2), fleet.add(runner, 3)])
    assert handles.tolist() == [0, 1, 4, 5, 6, 7, 8]
    assert fleet.handles(runner).tolist() == [4, 5, 6, 7, 8]
    tracks = fleet.run(handles[4:], np.tile(U[3, 20:], (3, 1)), np.tile(COUNTS[3, 20:], (3, 1)))
    assert np.array_equal(tracks.theta[2, -1], runner.run(U[3, 20:], COUNTS[3, 20:]).theta[-1])


def test_different_configurations_stand_side_by_side() -> None:
    fleet = pmfid.ShardedFleet(shard=8)
    offset = make(pmfid.RIV, model=pmfid.Drive(2.0, offset=True))
    handles = {estimator: fleet.add(estimator, 11) for estimator in (BCRLS, offset)}
    for estimator, own in handles.items():
        assert_equal_tracks(fleet.run(own, *some(11)), estimator.start().run_many(*some(11)))
        assert np.array_equal(fleet.handles(estimator), own)
    assert fleet.axes == 22
    assert fleet.handles(make(pmfid.RLS)).size == 0
    with pytest.raises(pmfid.UsageError, match=r"axes of one configuration only, got axes of 2.*on its own"):
        fleet.run(fleet.handles(), *some(22))


def test_a_gap_is_that_of_the_axis_alone() -> None:
    fleet = pmfid.ShardedFleet(shard=4)
    handle = int(fleet.add(BCRLS, 6)[5])
    alone = make(pmfid.BCRLS)
    for part in (slice(20), slice(20, None)):
        tracks = fleet.run([handle], U[:1, part], COUNTS[:1, part])
        assert np.array_equal(tracks.theta[0, -1], alone.run(U[0, part], COUNTS[0, part]).theta[-1])
        fleet.gap(handle, 77)
        alone.runner.gap(77)
    assert fleet.axis(handle).get_state() == alone.get_state()


# --- axes come and go -------------------------------------------------------------------------------------------------


def test_a_place_is_used_again_and_its_handle_never() -> None:
    fleet = pmfid.ShardedFleet(shard=8)
    handles = fleet.add(BCRLS, 20)
    fleet.run(handles, *some(20, slice(20)))
    fleet.remove(handles[[3, 9, 10]])
    assert fleet.axes == 17
    for gone in (3, 9):
        with pytest.raises(pmfid.UsageError, match=f"axis {gone} was removed; `handles"):
            fleet.axis(gone)
    new = fleet.add(BCRLS, 4)
    assert (new & 0xFFFFFFFF).tolist() == [3, 9, 10, 20]
    assert not set(new[:3].tolist()) & set(handles.tolist())
    with pytest.raises(pmfid.UsageError, match="axis 3 was removed"):
        fleet.run([3], *some(1))
    track = fleet.run(new, *some(4, slice(20)))
    assert np.array_equal(track.theta, BCRLS.start().run_many(*some(4, slice(20))).theta)
    stayed = np.setdiff1d(np.arange(20), [3, 9, 10])
    whole = pmfid.Fleet(BCRLS, 20)
    whole.run(*some(20, slice(20)))
    later = fleet.run(stayed, U[stayed, 20:], COUNTS[stayed, 20:])
    assert np.array_equal(later.theta, whole.run(*some(20, slice(20, None))).theta[stayed])


def test_a_place_that_has_had_all_its_numbers_stays_empty() -> None:
    handles = Handles(2)
    for before in (LAST - 1, LAST):
        handles.before[0] = before
        (last,) = handles.take(np.array([0])).tolist()
        assert 0 < last < 2**63
        handles.release(np.array([0]))
    assert handles.free(0, 2).tolist() == [1]


def test_anything_that_happens_leaves_every_axis_as_alone(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    riv = make(pmfid.RIV)
    fleet, alone = kept(pmfid.ShardedFleet(tmp_path, shard=8)), dict[int, RecursiveEstimator]()
    for turn in range(60):
        estimator = (BCRLS, riv)[turn % 2]
        own = fleet.handles(estimator)
        if rng.random() < 0.4:
            alone |= {
                handle: estimator.start().estimator for handle in fleet.add(estimator, int(rng.integers(9))).tolist()
            }
        elif own.size and rng.random() < 0.3:
            gone = rng.choice(own, int(rng.integers(own.size)), replace=False)
            fleet.remove(gone)
            for handle in gone.tolist():
                del alone[handle]
        elif own.size:
            chosen = rng.permutation(own)[: int(rng.integers(1, own.size + 1))]
            rows, part = rng.integers(0, AXES, chosen.size), slice(int(rng.integers(1, 12)))
            fleet.run(chosen, U[rows, part], COUNTS[rows, part])
            for handle, row in zip(chosen.tolist(), rows.tolist(), strict=True):
                alone[handle].run(U[row, part], COUNTS[row, part])
        elif rng.random() < 0.5:
            fleet.checkpoint()
        if turn % 20 == 19:
            fleet.checkpoint(turn)
            fleet.close()
            fleet = kept(pmfid.ShardedFleet(tmp_path, [riv, BCRLS]))
    assert len(alone) > 20
    assert fleet.handles().tolist() == sorted(alone, key=lambda handle: handle % 2**32)
    for handle, single in alone.items():
        assert fleet.axis(handle).get_state() == single.get_state()


# --- errors of use ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda fleet: fleet.run([0, 0], *some(2)), "contains an axis twice"),
        (lambda fleet: fleet.run([5], *some(1)), "no axis has the handle 5"),
        (lambda fleet: fleet.run([-1], *some(1)), "no axis has the handle -1"),
        (lambda fleet: fleet.run([2**32], *some(1)), f"no axis has the handle {2**32}"),
        (lambda fleet: fleet.run([0.5], *some(1)), "integers that `add` returned"),
        (lambda fleet: fleet.run([[0]], *some(1)), "integers that `add` returned"),
        (lambda fleet: fleet.run([], *some(0)), "got axes of 0"),
        (lambda fleet: fleet.run([0, 1], *some(3)), r"counts must be \(2, n\)"),
        (lambda fleet: fleet.run([0, 1], some(2)[0], some(2)[1] + 0.5), "integers"),
        (lambda fleet: fleet.run([0, 1], *some(2), every=0), "every must be"),
        (lambda fleet: fleet.remove([0, 9]), "no axis has the handle 9"),
        (lambda fleet: fleet.axis("a"), "handle must be a whole number"),
        (lambda fleet: fleet.axis(10**30), "no axis has the handle"),
        (lambda fleet: fleet.gap(7, 0), "no axis has the handle 7"),
        (lambda fleet: fleet.add(BCRLS, -1), "axes must be a whole number of at least 0"),
        (lambda fleet: fleet.add(BCRLS, 10**12), "at most .* places"),
        (lambda fleet: fleet.add(make(pmfid.RLS).model), "use rls, bcrls or riv"),
        (lambda fleet: fleet.checkpoint(), "no folder for checkpoints; give a folder"),
        (lambda fleet: pmfid.ShardedFleet(shard=0), "shard must be a whole number of at least 1"),
        (lambda fleet: pmfid.ShardedFleet(shard=2**30), "shard must be at most"),
        (lambda fleet: pmfid.ShardedFleet(workers=0), "workers must be"),
        (lambda fleet: pmfid.ShardedFleet(__file__), "folder: .*choose a folder that can be written"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused_and_changes_nothing(call: Callable[[Any], object], said: str) -> None:
    fleet = pmfid.ShardedFleet(shard=3)
    fleet.add(BCRLS, 5)
    before = states(fleet)
    with pytest.raises(pmfid.UsageError, match=said):
        call(fleet)
    assert states(fleet) == before


# --- checkpoints ------------------------------------------------------------------------------------------------------


def opened(folder: Path) -> pmfid.ShardedFleet:
    return kept(pmfid.ShardedFleet(folder, [BCRLS], shard=16, workers=1))


def stepped(fleet: pmfid.ShardedFleet, turn: int) -> None:
    """Step a third of the axes, and sometimes add and remove axes."""
    if not fleet.axes:
        fleet.add(BCRLS, 60)
    if turn % 5 == 4:
        fleet.remove(fleet.handles()[turn::30])
        fleet.add(BCRLS, 3)
    chosen = fleet.handles()[turn % 3 :: 3] if turn % 2 else fleet.handles()[: 10 + turn % 7]
    part = slice(4 * turn % 30, 4 * turn % 30 + 9)
    fleet.run(chosen, *some(chosen.size, part))


@pytest.fixture(scope="module")
def as_it_was() -> list[dict[int, bytes]]:
    """Return the states after each number of turns."""
    fleet = pmfid.ShardedFleet(shard=16, workers=1)
    found = [states(fleet)]
    for turn in range(12):
        stepped(fleet, turn)
        found.append(states(fleet))
    return found


def two_checkpoints(folder: Path) -> None:
    """Write the checkpoints after 6 and after 7 turns."""
    fleet = opened(folder)
    for turn in range(7):
        stepped(fleet, turn)
        if turn > 4:
            fleet.checkpoint({"turns": turn + 1})
    fleet.close()


def test_a_checkpoint_is_taken_up_and_has_what_changed_alone(tmp_path: Path) -> None:
    fleet = opened(tmp_path)
    handles = fleet.add(BCRLS, 40)
    assert fleet.restored is None
    bytes_of_axis = fleet.checkpoint() // 40
    assert bytes_of_axis > 700
    fleet.run(handles[20:22], *some(2))
    assert fleet.checkpoint() == 16 * bytes_of_axis
    fleet.remove(handles[[5]])
    assert fleet.checkpoint({"read": [1, 2]}, sync=False) == 0
    before = states(fleet)
    with pytest.raises(pmfid.UsageError, match="folder: another process already uses"):
        opened(tmp_path)
    fleet.close()
    again = kept(pmfid.ShardedFleet(tmp_path, [make(pmfid.RIV), BCRLS], shard=1000))
    assert states(again) == before
    assert again.restored is not None
    assert (again.restored.mark, again.restored.damaged, again.restored.sequence) == ({"read": [1, 2]}, (), 3)
    assert again.add(BCRLS).tolist() == [2**32 + 5]
    with pytest.raises(pmfid.UsageError, match="mark must be a value that JSON can hold"):
        again.checkpoint(object())


def test_what_was_written_without_waiting_is_synced_with_the_next_that_waits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fleet = opened(tmp_path)
    fleet.add(BCRLS, 32)
    plainly, synced = os.fsync, set[int]()
    monkeypatch.setattr(os, "fsync", lambda number: (synced.add(os.fstat(number).st_ino), plainly(number))[1])
    files = lambda: {path.stat().st_ino for path in tmp_path.glob("shard-*")}  # noqa: E731
    fleet.checkpoint(sync=False)
    assert not files() & synced
    fleet.checkpoint()
    assert files() <= synced
    fleet.close()
    synced.clear()
    fleet = opened(tmp_path)
    fleet.checkpoint()
    assert files() <= synced, "another process may not have waited"
    synced.clear()
    fleet.checkpoint()
    assert not files() & synced


def test_axes_of_another_configuration_are_not_taken_for_ours(tmp_path: Path) -> None:
    two_checkpoints(tmp_path)
    for others in ([], [make(pmfid.BCRLS, forgetting=0.9)], [make(pmfid.BCRLS, "float32")]):
        with pytest.raises(pmfid.UsageError, match=r"none of the . given estimators; give every"):
            pmfid.ShardedFleet(tmp_path, others)
    opened(tmp_path).close()  # the folder is free


def test_an_empty_fleet_comes_back_empty(tmp_path: Path) -> None:
    fleet = opened(tmp_path)
    assert fleet.checkpoint("nothing yet") == 0
    fleet.close()
    fleet = opened(tmp_path)
    assert fleet.restored is not None
    assert fleet.restored.mark == "nothing yet"
    assert fleet.add(BCRLS, 20).size == 20


def killed(folder: Path, setting: str = "", seconds: float | None = None) -> list[int]:
    """Run turns with a checkpoint each in a process until its kill. Return the turns with a complete checkpoint."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        crash.arm(setting)
        fleet = opened(folder)
        for turn in range(fleet.restored.mark if fleet.restored else 0, 12):
            stepped(fleet, turn)
            fleet.checkpoint(turn + 1, sync=False)
            os.write(writing, bytes([turn + 1]))
        os._exit(0)
    os.close(writing)
    if seconds is not None:
        time.sleep(seconds)
        os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    with os.fdopen(reading, "rb") as pipe:
        return list(pipe.read())


def check_whole(folder: Path, done: list[int], as_it_was: list[dict[int, bytes]]) -> int:
    """Check that the last whole checkpoint is present; return its number of turns."""
    fleet = opened(folder)
    turns = int(fleet.restored.mark) if fleet.restored else 0  # type: ignore[call-overload]
    assert fleet.restored is None or not fleet.restored.damaged
    assert states(fleet) == as_it_was[turns]
    assert turns >= max(done, default=0)
    fleet.close()
    return turns


needs_fork = pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")
VAULT = ("checkpoint.half", "checkpoint.written", "checkpoint.synced", "checkpoint.renamed", "checkpoint.durable")


@needs_fork
@pytest.mark.parametrize("point", [*stored.POINTS, *VAULT])
def test_a_kill_at_any_point_loses_nothing(tmp_path: Path, point: str, as_it_was: list[dict[int, bytes]]) -> None:
    turns = [0]
    for times in (1, 2, 7):
        done = killed(tmp_path, f"{point}:{times}")
        turns.append(check_whole(tmp_path, done, as_it_was))
    assert turns == sorted(turns)
    assert 0 < turns[-1] < 12, "the points do not test what they are for"


def kill_at_random(folder: Path, seed: int, as_it_was: list[dict[int, bytes]]) -> int:
    rng, done = random.Random(seed), list[int]()
    while max(done, default=0) < 12:
        done = [check_whole(folder, killed(folder, seconds=rng.uniform(0.0, 0.06)), as_it_was)]
    return done[0]


@needs_fork
def test_a_kill_at_any_time_loses_nothing(tmp_path: Path, as_it_was: list[dict[int, bytes]]) -> None:
    assert kill_at_random(tmp_path, 1, as_it_was) == 12


@needs_fork
@pytest.mark.long
@pytest.mark.parametrize("seed", range(2, 7))
def test_many_kills_lose_nothing(tmp_path: Path, seed: int, as_it_was: list[dict[int, bytes]]) -> None:
    assert kill_at_random(tmp_path, seed, as_it_was) == 12


# --- damage -----------------------------------------------------------------------------------------------------------


def flip(path: Path, place: int) -> None:
    data = bytearray(path.read_bytes())
    data[place] ^= 4
    path.write_bytes(data)


def sides_of(folder: Path, sequence: int) -> list[Path]:
    """Return the files of shards that were written with a checkpoint."""
    return [path for path in sorted(folder.glob("shard-*")) if envelope.read(path).sequence == sequence]


def forge(path: Path) -> None:
    """Write numbers that no sample makes, with the right checksum."""
    found = envelope.read(path)
    body = bytearray(found.body)
    body[40:400] = np.full(45, np.nan).tobytes()
    with open(path, "wb") as file:
        envelope.put(file, found.sequence, [bytes(body)], "")


DAMAGE: dict[str, tuple[Callable[[Path], object], str]] = {
    "a bit": (lambda path: flip(path, 3000), "its checksum is wrong"),
    "a bit of the sequence": (lambda path: flip(path, 16), "its checksum is wrong"),
    "cut short": (lambda path: os.truncate(path, 5000), "it is cut short"),
    "cut in the head": (lambda path: os.truncate(path, 7), "it is shorter than the head"),
    "empty": (lambda path: os.truncate(path, 0), "it is shorter than the head"),
    "no longer there": (lambda path: path.unlink(), "No such file"),
    "of another checkpoint": (
        lambda path: path.write_bytes(path.with_name(path.name[:-1] + str(1 - int(path.name[-1]))).read_bytes()),
        "it belongs to another checkpoint",
    ),
    "numbers that no sample makes": (forge, "cannot be states of its configuration, although their checksum is right"),
}  # fmt: skip


@pytest.mark.parametrize(("damage", "said"), DAMAGE.values(), ids=DAMAGE)
def test_a_damaged_shard_is_set_aside_and_the_older_checkpoint_taken(
    tmp_path: Path, damage: Callable[[Path], object], said: str, as_it_was: list[dict[int, bytes]]
) -> None:
    two_checkpoints(tmp_path)
    path = sides_of(tmp_path, 2)[0]
    there = path.name
    damage(path)
    fleet = opened(tmp_path)
    assert fleet.restored is not None
    assert fleet.restored.mark == {"turns": 6}
    assert states(fleet) == as_it_was[6]
    assert fleet.restored.lost.size == 0
    (sentence,) = fleet.restored.damaged
    assert sentence.startswith(there)
    assert said in sentence
    stepped(fleet, 6)
    fleet.checkpoint(7)
    fleet.close()
    assert check_whole(tmp_path, [7], as_it_was) == 7


def test_where_no_checkpoint_is_whole_only_the_damaged_axes_restart(
    tmp_path: Path, as_it_was: list[dict[int, bytes]]
) -> None:
    two_checkpoints(tmp_path)
    for path in [sides_of(tmp_path, sequence)[0] for sequence in (1, 2)]:
        flip(path, 3000)
    fleet = opened(tmp_path)
    assert fleet.restored is not None
    assert fleet.restored.mark == {"turns": 7}
    assert len(fleet.restored.damaged) == 2
    lost = fleet.restored.lost.tolist()
    assert 0 < len(lost) <= 16
    fresh = state_of(BCRLS.runner).tobytes()
    assert states(fleet) == as_it_was[7] | dict.fromkeys(lost, fresh)
    assert fleet.checkpoint(7) > 0
    fleet.close()
    fleet = opened(tmp_path)
    assert fleet.restored is not None
    assert fleet.restored.damaged == ()


def test_shards_that_were_exchanged_are_reported(tmp_path: Path) -> None:
    fleet = opened(tmp_path)
    fleet.run(fleet.add(BCRLS, 32), *some(32))
    fleet.checkpoint()
    fleet.close()
    one, other = sides_of(tmp_path, 1)
    first, second = one.read_bytes(), other.read_bytes()
    one.write_bytes(second)
    other.write_bytes(first)
    fleet = opened(tmp_path)
    assert fleet.restored is not None
    assert fleet.restored.lost.size == 32
    assert all("to another checkpoint or shard" in sentence for sentence in fleet.restored.damaged)


HOSTILE: dict[str, Callable[[dict[str, Any]], object]] = {
    "no shards": lambda raw: raw.pop("shards"),
    "a size beyond all": lambda raw: raw.update(size=2**40),
    "a negative size": lambda raw: raw.update(size=-16),
    "another size": lambda raw: raw.update(size=17),
    "a size that is none": lambda raw: raw.update(size="16"),
    "more rows than places": lambda raw: raw["shards"][0].__setitem__(1, 17),
    "rows of another number": lambda raw: raw["shards"][0].__setitem__(1, "x"),
    "fewer rows than axes": lambda raw: raw["shards"][0].__setitem__(1, 5),
    "a third side": lambda raw: raw["shards"][0].__setitem__(2, 2),
    "no identity": lambda raw: raw["shards"][0].__setitem__(0, "xyz"),
    "a shard of too little": lambda raw: raw["shards"].__setitem__(0, []),
    "shards that are none": lambda raw: raw.update(shards=7),
}


@pytest.mark.parametrize("change", HOSTILE.values(), ids=HOSTILE)
def test_a_hostile_list_is_set_aside(
    tmp_path: Path, change: Callable[[dict[str, Any]], object], as_it_was: list[dict[int, bytes]], monkeypatch: Any
) -> None:
    two_checkpoints(tmp_path)
    plainly = json.dumps

    def changed(raw: dict[str, Any]) -> str:
        if "shards" in raw:  # leave out the file with only the mark
            change(raw)
        return plainly(raw)

    with monkeypatch.context() as patch:
        patch.setattr(stored.json, "dumps", lambda raw: changed(json.loads(plainly(raw))))
        fleet = opened(tmp_path)
        fleet.checkpoint({"turns": 9})
        fleet.close()
    fleet = opened(tmp_path)
    assert fleet.restored is not None
    assert fleet.restored.mark == {"turns": 7}
    assert "checkpoint-1.damaged-1" in fleet.restored.damaged[0]
    assert states(fleet) == as_it_was[7]


def test_files_that_say_nothing_leave_an_empty_fleet_that_says_so(tmp_path: Path) -> None:
    (tmp_path / "checkpoint-0").write_bytes(b"PMFIDCKP and nothing else")
    fleet = opened(tmp_path)
    assert fleet.restored is not None
    assert fleet.restored.sequence == 0
    assert "checkpoint-0.damaged-1: " in fleet.restored.damaged[0]
    fleet.add(BCRLS, 3)
    fleet.checkpoint()


@pytest.mark.parametrize("stage", ["shards", "list"])
def test_a_full_disk_leaves_the_last_checkpoint(
    tmp_path: Path, stage: str, monkeypatch: pytest.MonkeyPatch, as_it_was: list[dict[int, bytes]]
) -> None:
    two_checkpoints(tmp_path)
    fleet = opened(tmp_path)
    stepped(fleet, 7)

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(*((stored, "put") if stage == "shards" else (os, "replace")), full)
        with pytest.raises(OSError, match="No space left"):
            fleet.checkpoint(8)
    stepped(fleet, 8)
    fleet.close()
    assert opened_states(tmp_path) == as_it_was[7]
    fleet = opened(tmp_path)
    stepped(fleet, 7)
    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", full)
        with pytest.raises(OSError, match="No space left"):
            fleet.checkpoint(8)
    fleet.checkpoint(8)
    fleet.close()
    assert check_whole(tmp_path, [8], as_it_was) == 8


def opened_states(folder: Path) -> dict[int, bytes]:
    fleet = opened(folder)
    found = states(fleet)
    fleet.close()
    return found


def test_a_closed_fleet_leaves_the_folder_to_another(tmp_path: Path) -> None:
    first = pmfid.ShardedFleet(tmp_path / "state", [BCRLS])
    first.add(BCRLS, 2)
    first.close()
    with pmfid.ShardedFleet(tmp_path / "state", [BCRLS]) as second:
        with pytest.raises(pmfid.UsageError, match="was closed"):
            first.checkpoint()
        second.add(BCRLS, 3)
        second.checkpoint()
    with pmfid.ShardedFleet(tmp_path / "state", [BCRLS]) as third:
        assert third.axes == 3
