"""Carts whose encoders give the instants of their edges: motions, records and configurations."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from pmfid.simulation import CART, CART_DT, Schedule, capture_edges, resolution_of, simulate_drive
from studies.monitoring.axis import changing

#: Increments per turn.
TURN = 64
EVERY = 10

AXIS = """
[record]
input = "u"
output = "n"
output_kind = "counts"
time = "t"
[encoder]
resolution = %r
edge_age = "age"
lines = 64
tick = 1e-6
[model]
kind = "drive"
input_gain = 2.0
[monitor]
%s
"""
#: Columns u, counts and ages (n,).
Motion = tuple[np.ndarray, np.ndarray, np.ndarray]


def heavier(when: float, **factors: float) -> Schedule:
    """Return the cart whose parameters are multiplied by factors at a time [s], by default its mass by 1.3."""
    changed = {name: factor * getattr(CART, name) for name, factor in (factors or {"mass": 1.3}).items()}
    return Schedule(((0.0, CART), (when, replace(CART, **changed))))


def cart_edges(schedule: Schedule, seed: int, seconds: float, rest: int = 0) -> Motion:
    """Return the motion of a cart with lines off by 1 % of a step, and `rest` samples of rest at the end."""
    u = np.r_[changing(schedule, seed, 4096, seconds)[0], np.zeros(rest)]
    step, rng = resolution_of(TURN), np.random.default_rng(seed)
    motion = simulate_drive(schedule, np.repeat(u, EVERY), CART_DT / EVERY)
    errors = 0.01 * step * rng.uniform(-1, 1, TURN)
    return u, *capture_edges(motion, step, 0.4 * step, every=EVERY, tick=1e-6, line_errors=errors)


def write_record(path: Path, record: Motion) -> None:
    rows = (
        f"{CART_DT * k:.2f},{u!r},{n},{'' if np.isnan(age) else repr(age)}\n"
        for k, (u, n, age) in enumerate(zip(*(part.tolist() for part in record), strict=True))
    )
    path.write_text("t,u,n,age\n" + "".join(rows))


def write_edge_axis(folder: Path, seconds: float = 24.0) -> None:
    """Write axis.toml and normal.csv."""
    write_record(folder / "normal.csv", cart_edges(Schedule(((0.0, CART),)), 4, seconds))
    (folder / "axis.toml").write_text(AXIS % (resolution_of(TURN), 'reference = "normal.csv"'))
