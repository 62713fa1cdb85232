"""Records of five plants as columns, and facts for their configuration; short, because calls must be cheap."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from pmfid.simulation.drive import DriveParameters, position_control, quantize, simulate_drive
from pmfid.simulation.process import simulate_process
from pmfid.simulation.signals import multisine, prbs, trapezoid

Columns = dict[str, Any]


def _cart(seed: int, samples: int = 200) -> tuple[Columns, Columns]:
    rng, dt, resolution = np.random.default_rng(seed), 0.01, 2e-4
    u = prbs(samples, clock=8, amplitude=3.0, rng=rng)
    run = simulate_drive(DriveParameters(1.07, 12.8, 0.8, 2.0), u, dt)
    return _logged(u, run.x, resolution, dt, input_gain=2.0, cutoff=30.0, theta=(1.07, 12.8, 0.8))


def _watched(seed: int) -> tuple[Columns, Columns]:
    """Return a record that is long enough for a reference."""
    return _cart(seed, 1000)


def _heavy(seed: int) -> tuple[Columns, Columns]:
    dt, resolution = 0.004, 1e-5 * 4**seed
    reference = np.concatenate([trapezoid(100, dt, 0.05, 0.6), 0.05 + trapezoid(100, dt, -0.05, 0.6)])
    plant = DriveParameters(60.0, 90.0, 20.0, 1.0, offset=5.0)
    run, _ = position_control(plant, reference, dt, kp=3e4, kd=2e3, u_max=600.0, resolution=resolution)
    return _logged(run.u, run.x, resolution, dt, input_gain=1.0, cutoff=50.0)


def _rotary(seed: int) -> tuple[Columns, Columns]:
    dt, resolution = 0.001, 2 * np.pi / 2000
    u = multisine(300, dt, [10.0, 20.0, 40.0], 2.0, np.random.default_rng(seed))
    run = simulate_drive(DriveParameters(3e-4, 1e-3, 5e-3, 0.05), u, dt)
    return _logged(u, run.x, resolution, dt, input_gain=0.05, cutoff=100.0)


def _rest(seed: int) -> tuple[Columns, Columns]:
    u = [np.zeros(150), np.ones(150), np.linspace(0, 1, 150), np.sin(np.arange(150.0))][seed]
    return _logged(u, 1e-5 * u if seed else u, 1e-4, 0.01, input_gain=1.0, cutoff=20.0)


def _process(seed: int) -> tuple[Columns, Columns]:
    rng, dt = np.random.default_rng(seed), 0.05
    u = prbs(120, clock=6, amplitude=1.0, rng=rng)
    y = simulate_process((2.0,), (1.0, 1.2, 4.0), u, dt) + 0.02 * rng.standard_normal(u.size)
    columns, facts = _logged(u, y, 1e-3, dt, cutoff=3.0)
    return columns | {"r": u}, facts


PLANTS: dict[str, Callable[[int], tuple[Columns, Columns]]] = {
    name: cache(make)
    for name, make in {
        "cart": _cart,
        "watched": _watched,
        "heavy": _heavy,
        "rotary": _rotary,
        "rest": _rest,
        "process": _process,
    }.items()
}


def _logged(u: np.ndarray, y: np.ndarray, resolution: float, dt: float, **facts: Any) -> tuple[Columns, Columns]:
    columns = {"t": dt * np.arange(u.size), "u": u, "y": y, "counts": quantize(y, resolution)}
    return columns, {"dt": dt, "resolution": resolution, **facts}
