"""What a real axis has: an eccentric encoder."""

from __future__ import annotations

import re

import numpy as np
import pytest

import pmfid
from studies.referee.cases import Case, make_cases
from studies.referee.machines import draw_machine


def identify(case: Case) -> pmfid.Result:
    drive = pmfid.Drive(case.input_gain, axis="rotary" if case.rotary else "linear")
    return pmfid.identify(case.u, case.counts, model=drive, dt=case.dt, encoder=pmfid.Encoder(case.resolution))


@pytest.mark.parametrize("index", [0, 9])
def test_an_eccentric_encoder_is_named_with_amplitude_and_phase(index: int) -> None:
    """Without the row of the table, the mass is off, or a wave of an unknown period is named."""
    (case,), effect = make_cases(5, "eccentric encoder", [index]), draw_machine(5, "eccentric encoder", index).effect
    result = identify(case)
    assert result.interval_95 is not None
    assert result.interval_95[0, 0] <= case.truth["mass"] <= result.interval_95[0, 1]
    (named,) = [one.sentence for one in result.findings if "once a turn" in one.sentence]
    texts = re.findall(r"of (\S+) ± (\S+) rad with a phase of (\S+) ± (\S+) deg", named)
    size, error, phase, across = map(float, texts[0])
    first = 2 * np.pi * case.counts[0] / case.facts["increments"]
    off = np.exp(1j * (np.radians(phase) - float(effect["runout"]) - first))
    assert abs(size - float(effect["eccentricity"]) * case.resolution) < 3 * error + 5e-4 * size
    assert abs(np.degrees(np.angle(off))) < 3 * across + 0.05


def test_a_round_encoder_has_no_error() -> None:
    (case,) = make_cases(3, "right", [7])
    result = identify(case)
    assert not any("encoder" in one.sentence for one in result.findings)
