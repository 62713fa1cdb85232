"""All that changes in a monitor, as arrays of a fixed layout: to be kept, moved and saved."""

from __future__ import annotations

import zlib
from collections import deque
from dataclasses import asdict
from typing import Any

import numpy as np

from pmfid.errors import UsageError
from pmfid.kernel.saved import load_state, save_state
from pmfid.monitor.rows import STATES
from pmfid.monitor.saved import IMPLAUSIBLE, States
from pmfid.monitor.scores import Blocks
from pmfid.status import Status

#: A `Monitor`, which imports this.
Monitor = Any
#: Blocks that an alarm looks back on.
LOOK_BACK = 64

WHOLE = {"samples": "samples", "counts": "_counts", "zero": "_zero", "change": "_change", "silence": "_silence"}
REAL = {"statistic": "statistic", "gathered": "_gathered", "crossed": "_crossed", "gain": "_gain", "opened": "_opened"}
REAL |= {"input": "_input", "usual": "_usual"}


def configuration_number(monitor: Monitor) -> int:
    """A checksum of all that does not change."""
    calibration = monitor.calibration
    parts = [
        repr(monitor.estimator),
        repr(monitor.watch),
        repr(monitor.known and (monitor.known.given, monitor.known.prior, monitor.known.find_gain)),
    ]
    parts += [
        calibration.theta.tobytes().hex(),
        repr(calibration.chi_square),
        repr(monitor.threshold),
        repr(calibration.work is None),
    ]
    parts += [repr({k: v.tolist() for k, v in asdict(calibration.scale).items()})]
    return zlib.crc32("\n".join(parts).encode())


def store(monitor: Monitor) -> States:
    """(1, ...) of each part."""
    p, f = monitor.reference.size, monitor._filter
    recent, begun, opened = np.zeros((LOOK_BACK, _width(p))), np.zeros(LOOK_BACK + 1), np.zeros(_width(p))
    for k, unit in enumerate(monitor._recent):
        recent[k] = _flat(unit)
    begun[: len(monitor._begun)] = monitor._begun
    if monitor._open:
        opened = _flat(Blocks.joined(monitor._open).total())
    found: States = {name: np.array(_wrapped(getattr(monitor, own)), np.int64) for name, own in WHOLE.items()}
    found |= {name: np.array(getattr(monitor, own), np.float64) for name, own in REAL.items()}
    found |= {
        "state": np.array(STATES.index(monitor.state), np.uint8),
        "lost": np.array(monitor._lost, np.uint8),
        "flagged": np.array(int(monitor._flagged), np.uint32),
        "refined": np.array(monitor._refined, np.uint8),
        "suspected": np.array(monitor._suspected, np.int64),
        "theta": monitor.reference,
        "before": getattr(monitor, "_before", monitor.reference),
        "estimator": np.frombuffer(monitor.estimator.get_state(), np.uint8),
        "filter": np.frombuffer(save_state(f._kernel, monitor._front.precision), np.uint8),
        "rows": f._rows,
        "row_status": f._status,
        "filled": np.array([f._filled, f._waiting], np.int64),
        "detection": np.concatenate([np.ravel(part) for part in monitor._detection]),
        "recent": recent,
        "begun": begun,
        "units": np.array([len(monitor._recent), len(monitor._begun), len(monitor._open)], np.int64),
        "open": opened,
        "sum": _flat(monitor._sum),
    }
    return {name: np.array(part)[None] for name, part in found.items()}


def load(monitor: Monitor, states: States, axis: int) -> None:
    """The monitor goes on in the state of an axis. Raises UsageError for numbers that no sample could have made."""
    own = {name: part[axis] for name, part in states.items()}
    theta, p = own["theta"].copy(), own["theta"].size
    if not (monitor._plausible(theta) and own["state"] < len(STATES)):
        raise UsageError(IMPLAUSIBLE)
    monitor._refer(theta)
    load_state(monitor._filter._kernel, monitor._front.precision, own["filter"].tobytes())
    monitor.estimator.set_state(own["estimator"].tobytes())
    for name, attribute in WHOLE.items():
        setattr(monitor, attribute, int(own[name]))
    for name, attribute in REAL.items():
        setattr(monitor, attribute, float(own[name]))
    monitor.state, monitor._lost, monitor._refined = STATES[own["state"]], bool(own["lost"]), bool(own["refined"])
    monitor._flagged, monitor._suspected, monitor._before = (
        Status(int(own["flagged"])),
        int(own["suspected"]),
        own["before"].copy(),
    )
    f = monitor._filter
    f._rows[:], f._status[:] = own["rows"], own["row_status"]
    f._filled, f._waiting = own["filled"].tolist()
    shapes, place = [part.shape for part in monitor._detection], 0
    detection = []
    for shape in shapes:
        size = int(np.prod(shape))
        detection.append(own["detection"][place : place + size].reshape(shape).copy())
        place += size
    monitor._detection = tuple(detection)
    units, begun, opened = own["units"].tolist()
    monitor._recent = deque((_blocks(own["recent"][k], p) for k in range(units)), maxlen=monitor._recent.maxlen)
    monitor._begun = deque(own["begun"][:begun].tolist(), maxlen=monitor._begun.maxlen)
    monitor._open = [_blocks(own["open"], p)] if opened else []
    monitor._sum = _blocks(own["sum"], p)


def _width(p: int) -> int:
    return p + 2 * p * p


def _flat(blocks: Blocks) -> np.ndarray:
    return np.concatenate([blocks.score.ravel(), blocks.cross.ravel(), blocks.square.ravel()])


def _blocks(flat: np.ndarray, p: int) -> Blocks:
    flat = flat.copy()
    return Blocks(flat[:p][None], flat[p : p + p * p].reshape(1, p, p), flat[p + p * p :].reshape(1, p, p))


def _wrapped(number: int) -> int:
    return (number + 2**63) % 2**64 - 2**63
