"""The commonest mistakes of a log: each comes first in the text of a refused identification."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from pmfid.config.axis import Axis
from pmfid.errors import NotIdentifiableError
from pmfid.findings import texts
from pmfid.pipeline.checks import check_record
from pmfid.pipeline.identify import identify
from pmfid.records.record import Record
from pmfid.simulation.drive import DriveParameters, Motion, quantize, simulate_drive
from pmfid.simulation.signals import multisine, prbs

DT, GAIN, RESOLUTION = 0.005, 1.5, 2e-4
MACHINES = {
    "damped": DriveParameters(4.0, 30.0, 3.0, GAIN),
    "sticky": DriveParameters(15.0, 10.0, 12.0, GAIN),
    "light": DriveParameters(0.5, 0.4, 0.3, GAIN),
}
FORCES = {"damped": 60.0, "sticky": 60.0, "light": 3.0}  # Input forces of the machines [N].


@cache
def motion(machine: str) -> Motion:
    rng = np.random.default_rng(3)
    amplitude = FORCES[machine] / GAIN
    sines = multisine(2400, DT, [0.7, 1.7, 3.1], amplitude, rng)
    u = prbs(2400, clock=40, amplitude=amplitude, rng=rng) if machine == "damped" else sines
    return simulate_drive(MACHINES[machine], u, DT)


def logged(machine: str, fault: str) -> Record:
    """Return the log of a machine with a fault; `axis_of` reads it as a log without faults."""
    run = motion(machine)
    u, counts = run.u, quantize(run.x, RESOLUTION, phase=1e-5)
    if fault == "reversed":
        counts = -counts
    if fault == "velocity":
        counts = quantize(run.v, RESOLUTION)
    if fault == "exchanged":
        u, counts = counts * RESOLUTION, quantize(run.u, RESOLUTION)
    if fault == "wrapped":
        counts = (counts + 100) % 2 ** (int(np.ptp(counts)).bit_length() - 1)
    return Record(u, counts, DT, RESOLUTION, (), "log")


def axis_of(output_kind: str = "position", method: str = "auto", **model: object) -> Axis:
    return Axis.model_validate(
        {
            "record": {"input": "u", "output": "y", "output_kind": output_kind, "dt": DT},
            "encoder": {"resolution": RESOLUTION},
            "model": model or {"input_gain": GAIN},
            "estimator": {"cutoff": 40.0, "method": method},
        }
    )


def named(record: Record, axis: Axis) -> str:
    """Return the findings on the log as one sentence."""
    return "; ".join(texts(check_record(record, axis)))


MISTAKES = {
    "reversed": "the output has the opposite sign of the input",
    "velocity": "the output column 'y' is a velocity, not a position",
    "exchanged": "input and output are exchanged",
    "wrapped": "the output column 'y' wraps at",
}


@pytest.mark.parametrize("machine", MACHINES)
@pytest.mark.parametrize("fault", MISTAKES)
def test_the_mistake_is_named(machine: str, fault: str) -> None:
    assert named(logged(machine, fault), axis_of()).startswith(MISTAKES[fault])


@pytest.mark.parametrize("machine", MACHINES)
def test_a_right_log_has_no_mistake(machine: str) -> None:
    assert named(logged(machine, "none"), axis_of()) == ""


@pytest.mark.long
@pytest.mark.parametrize("fault", ["reversed", "exchanged"])
def test_the_mistake_stands_first_where_an_identification_is_refused(fault: str) -> None:
    with pytest.raises(NotIdentifiableError) as caught:
        identify(logged("light", fault), axis_of())
    text = str(caught.value)
    assert text.startswith(MISTAKES[fault])
    assert isinstance(caught.value.__cause__, NotIdentifiableError)


def test_the_remedy_for_a_reversed_sign_helps_when_followed_literally() -> None:
    record = logged("sticky", "reversed")
    assert "give [model] input_gain = -1.5" in named(record, axis_of())
    assert identify(record, axis_of(input_gain=-1.5)).theta[0] == pytest.approx(15.0, rel=0.01)
