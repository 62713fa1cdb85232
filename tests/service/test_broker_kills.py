"""Kills of the broker with the whole service connected to it; `make broker-kills` does more of them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.service.broker import needs_broker

REPOSITORY = Path(__file__).parents[2]


@pytest.mark.long
@needs_broker
@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")
@pytest.mark.parametrize("service_kills", [0, 3])
def test_a_service_whose_broker_is_killed_ends_as_one_whose_broker_was_not(service_kills: int) -> None:
    words = f"-m tests.service.broker_campaign --kills 2 --service-kills {service_kills} --apart 2 --seed 3"
    done = subprocess.run([sys.executable, *words.split()], cwd=REPOSITORY, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert f"2 kills of the broker, {service_kills} of the service" in done.stdout
    assert "every state and row as without kills" in done.stdout
