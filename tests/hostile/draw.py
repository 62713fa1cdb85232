"""Random calls of the commands, each of valid and broken parts; the same seed draws the same call."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.hostile.commands import COMMANDS, Case

Rng = np.random.Generator


def draw(seed: int, folder: Path) -> Case:
    """Draw the call of a seed; files of the call are written into `folder`."""
    rng = np.random.default_rng([20, seed])
    name = str(rng.choice(list(COMMANDS), p=[maker.part for maker in COMMANDS.values()]))
    return COMMANDS[name].make(name, rng, folder)
