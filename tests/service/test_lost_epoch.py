"""A sender that restarts without a higher epoch is reported, and the remedy of the report works."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pmfid.simulation import CART, CART_DT, Schedule
from pmfid.stream.delivery import Block, Delivery
from pmfid.stream.groups import Prepared
from pmfid.stream.timeline import Sample
from pmfid.stream.tuning import TUNING
from studies.monitoring.axis import INCREMENTS, changing
from tests.service.collected import Bits, Collected, monitored
from tests.service.test_engine import engine_of

SAMPLES, BLOCK = 1200, 50


@pytest.fixture(scope="module")
def motion() -> tuple[np.ndarray, np.ndarray]:
    return changing(Schedule(((0.0, CART),)), 3, INCREMENTS, SAMPLES * CART_DT)


def blocks(motion: tuple[np.ndarray, np.ndarray], start: int, end: int, epoch: int, first: int) -> list[Delivery]:
    """Return blocks of the samples from `start` to `end` of the motion, numbered from `first`."""
    parts = (slice(k, k + BLOCK) for k in range(start, end, BLOCK))
    made = [Block("x1", epoch, first + p.start - start, math.nan, CART_DT, motion[0][p], motion[1][p]) for p in parts]
    return [Delivery("hall", [block]) for block in made]


def expected(prepared: Prepared, motion: tuple[np.ndarray, np.ndarray], lost: slice) -> list[Bits]:
    """Return the rows of the monitor if the time between the samples around the lost part is unknown."""
    kept = np.delete(np.arange(SAMPLES), lost)
    samples = [Sample(k * CART_DT, float(motion[0][k]), int(motion[1][k]), 0, float(k == lost.stop)) for k in kept]
    return monitored(prepared, samples)[0]


@pytest.mark.parametrize("epoch", [3, 9], ids=["a lower epoch", "the same epoch"])
@pytest.mark.parametrize("remedy", ["a higher epoch", "restart"])
def test_a_sender_that_lost_its_epoch_is_reported_what_helps(
    prepared: Prepared, motion: tuple[np.ndarray, np.ndarray], epoch: int, remedy: str
) -> None:
    outlet = Collected()
    engine = engine_of(prepared, outlet, axes=["x1"])
    engine.process(blocks(motion, 0, 600, epoch=9, first=20_000))
    engine.process(blocks(motion, 600, 700, epoch=epoch, first=0))
    for _ in range(round(TUNING.nothing_new / CART_DT / 100)):  # for two minutes
        engine.process(blocks(motion, 600, 700, epoch=epoch, first=100))
    engine.tick(0.0)
    assert len(outlet.of("x1")) == 600, "none of them is believed"
    reported = outlet.events("x1", "late")
    assert "higher epoch" in reported[-1]["problem"]
    assert "POST /api/axis/NAME/anew" in reported[-1]["problem"]
    assert len(reported) < 20
    if remedy == "restart":
        assert engine.restart_numbers("x1")
        engine.tick(0.0)
    again = epoch if remedy == "restart" else 10
    engine.process(blocks(motion, 700, SAMPLES, again, first=200))
    rows = [bits for _, bits in outlet.of("x1")]
    assert len(rows) == SAMPLES - 100, "all of what comes now"
    assert rows == expected(prepared, motion, slice(600, 700))
