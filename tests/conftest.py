"""Fixtures and records that several tests share."""

from __future__ import annotations

import re
import signal
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

import pmfid
from pmfid.findings import Finding
from pmfid.monitor.calibration import Calibration, calibrate
from pmfid.simulation.drive import quantize, simulate_drive
from pmfid.simulation.scenarios import CART, CART_DT, resolution_of
from pmfid.simulation.signals import prbs
from pmfid.stream.groups import Prepared, prepare
from studies.monitoring.axis import make_riv, normal_work
from studies.monitoring.pipe import write_axis

#: The time of an example measures the machine, which may be busy with other work.
settings.register_profile("patient", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("patient")

EMPS = Path(__file__).parents[2] / "shared" / "data" / "emps" / "DATA_EMPS.mat"
needs_emps = pytest.mark.skipif(not EMPS.exists(), reason="the EMPS record is not on this machine")

#: On a busy machine, a command with any amount of work can print these progress lines.
PROGRESS = re.compile(r"^pmfid: .*(?:after|running for) \d+ s\n", re.MULTILINE)

#: Most characters of a sentence and of a remedy in a finding.
LONGEST = 140


@pytest.fixture(autouse=True, scope="session")
def short_findings() -> Iterator[None]:
    """Check that each finding of a test has a short sentence and a short remedy."""
    construct = Finding.__init__

    def checked(self: Finding, *values: Any, **named: Any) -> None:
        construct(self, *values, **named)
        long = [part for part in (self.sentence, self.remedy) if len(part) > LONGEST]
        assert not long, f"{len(long[0])} characters: {long[0]}"

    with mock.patch.object(Finding, "__init__", checked):
        yield


TRUTH = np.array([CART.mass, CART.viscous_friction, CART.coulomb_friction])


@pytest.fixture(scope="session")
def calibration() -> Calibration:
    """The calibration of twelve minutes of a cart's normal work at 1024 increments."""
    return calibrate(make_riv(1024), TRUTH, *normal_work(7, 1024, 0.2))


def pytest_configure(config: pytest.Config) -> None:
    """Let a parallel run that `make test` stops by its time limit still print its failures."""
    if getattr(config.option, "numprocesses", None):
        signal.signal(signal.SIGTERM, signal.default_int_handler)


@dataclass(frozen=True)
class Run:
    u: np.ndarray
    counts: np.ndarray
    encoder: pmfid.Encoder


def cart_run(seed: int, *, increments: float | None = 4096, samples: int = 3000, clock: int = 10) -> Run:
    """Return a run of the cart under an open-loop PRBS of +-3 V; `increments` None means a nearly exact encoder."""
    rng = np.random.default_rng(seed)
    u = prbs(samples, clock=clock, amplitude=3.0, rng=rng)
    resolution = 1e-9 if increments is None else resolution_of(increments)
    motion = simulate_drive(CART, u, CART_DT)
    return Run(u, quantize(motion.x, resolution, phase=rng.uniform(0, resolution)), pmfid.Encoder(resolution))


def long_unless(few: Callable[..., bool], cases: Iterable[Any]) -> list[Any]:
    """Mark the cases of a test as `long` unless `few` returns true for the values of the case."""
    values = [(case, case if isinstance(case, tuple) else (case,)) for case in cases]
    return [case if few(*parts) else pytest.param(*parts, marks=pytest.mark.long) for case, parts in values]


@pytest.fixture(scope="session", autouse=True)
def silent_progress() -> Iterator[None]:
    """Suppress progress reports of commands in this process: on a busy machine any command can print them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pmfid.cli.terminal.EVERY", 3600.0)
        yield


@pytest.fixture(scope="session")
def drive() -> pmfid.Drive:
    return pmfid.Drive(input_gain=CART.input_gain)


def assert_near(theta: np.ndarray, truth: np.ndarray, within: list[float]) -> None:
    """Check each relative error against its own bound; a failure shows the errors in percent."""
    error = np.asarray(theta) / truth - 1
    assert np.all(np.abs(error) < within), f"errors in percent: {100 * error}"


def unjudged() -> AbstractContextManager[object]:
    """Switch off the judgement of estimates within the block: the judgement takes most of the time."""
    return mock.patch("pmfid.diagnostics.verdict.fit_again", return_value=None)


@pytest.fixture(scope="module")
def without_judgement() -> Iterator[None]:
    """Switch off the judgement of estimates for a file of tests that ask for no status."""
    with unjudged():
        yield


@pytest.fixture(scope="session")
def plant_place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with axis.toml and its reference record, written once."""
    place = tmp_path_factory.mktemp("plant")
    write_axis(place, 60.0)
    return place


@pytest.fixture(scope="session")
def prepared(plant_place: Path) -> Prepared:
    """Return the calibrated axis of axis.toml."""
    return prepare(plant_place / "axis.toml")
