"""Calibrations on disk: the same configuration and reference record are simulated once."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from pmfid.estimators.base import Estimator
from pmfid.monitor.calibration import Calibration, Tail, block_keep, calibrate
from pmfid.monitor.detectors import make_detectors
from pmfid.monitor.scores import Scale
from pmfid.monitor.work import NormalWork
from pmfid.types import Floats

#: Version of the calibration and of its file; to be raised with every change of either.
VERSION = 6


def cache_dir() -> Path:
    """The folder of calibrations: PMFID_CACHE, or pmfid in the user's cache folder."""
    if os.environ.get("PMFID_CACHE"):
        return Path(os.environ["PMFID_CACHE"])
    home = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA")
    return Path(home) / "pmfid" if home else Path.home() / ".cache" / "pmfid"


def cached_calibration(
    estimator: Estimator,
    theta: Floats,
    u: Floats,
    counts: np.ndarray | None,
    hours: float,
    progress: Callable[[float], None] | None = None,
) -> tuple[Calibration, Path, bool]:
    """The calibration, its file, and whether the file existed. A cache that cannot be written is ignored."""
    detectors = make_detectors(block_keep(estimator))  # the file keeps their thresholds
    digest = sha256(f"{VERSION} {estimator!r} {hours!r} {counts is None} {detectors!r}".encode())
    for part in (theta, u, np.zeros(0) if counts is None else counts):
        digest.update(np.ascontiguousarray(part).tobytes())
    path = cache_dir() / f"calibration-{digest.hexdigest()[:32]}.json"
    known = _read(path)
    if known is not None:
        return known, path, True
    made = calibrate(estimator, theta, u, counts, hours=hours, progress=progress)
    _write(path, made)
    return made, path, False


def _write(path: Path, calibration: Calibration) -> None:
    text = json.dumps(asdict(calibration), default=lambda array: array.tolist())
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(f".{os.getpid()}")
        part.write_text(f"{_digest(text)}\n{text}", encoding="utf-8")
        part.replace(path)  # another run may write the same one
    except OSError:
        return


def _digest(text: str) -> str:
    return sha256(text.encode()).hexdigest()


def _read(path: Path) -> Calibration | None:
    try:
        digest, _, text = path.read_text(encoding="utf-8").partition("\n")
        if digest != _digest(text):
            return None  # damaged: numbers may have changed and still be numbers
        raw: dict[str, Any] = json.loads(text)  # another structure ends in one of the errors below
        return Calibration(
            np.array(raw["theta"]),
            _scale(raw["scale"]),
            tuple(tuple(row) for row in raw["chi_square"]),
            {name: _tail(tail) for name, tail in raw["tails"].items()},
            np.array(raw["noise"]),
            raw["hours"],
            raw["record_hours"],
            None if raw["work"] is None else _work(raw["work"]),
        )
    except (OSError, ValueError, TypeError, KeyError):
        return None  # no file, or not of this version: the calibration is computed again


def _scale(raw: dict[str, Any]) -> Scale:
    return Scale(**{name: np.array(value) for name, value in raw.items()})


def _tail(raw: dict[str, Any]) -> Tail:
    parts = tuple((level, slope, rate) for level, slope, rate in raw["parts"])
    return Tail(**(raw | {"maxima": tuple(raw["maxima"]), "parts": parts}))


def _work(raw: dict[str, Any]) -> NormalWork:
    return NormalWork(raw["size"], np.array(raw["offset"]), _scale(raw["scale"]), np.array(raw["limit"]))
