"""What if the encoder were another one: `pmfid encoder`."""

from __future__ import annotations

import numpy as np
import pytest

from pmfid.pipeline.encoders import EncoderChoice


def choice(counts: list[float], edges: list[float], turn: float | None = None) -> EncoderChoice:
    steps = np.array([1e-1, 1e-2, 1e-3])
    return EncoderChoice("run", "mass", 0.01, 1e-3, turn, "m", steps, np.array(counts), np.array(edges))


@pytest.mark.parametrize(
    ("counts", "edges", "answer"),
    [
        ([0.1, 0.02, 0.005], [0.005, 0.001, 1e-4], "counts need steps of 0.001 m, and edge times need steps of 0.1 m"),
        (
            [0.005, 0.02, 0.03],
            [np.nan, 0.001, 1e-4],
            "counts need finer steps than these, and edge times need steps of 0.01 m",
        ),
    ],
)
def test_an_encoder_suffices_if_all_finer_ones_do(counts: list[float], edges: list[float], answer: str) -> None:
    assert choice(counts, edges).answer == f"to determine mass to 1 %, {answer}"
