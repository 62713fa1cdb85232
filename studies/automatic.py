"""Is the automatic choice as good as the best single method? A study over encoders, filters and motions."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmfid.encoder import Encoder
from pmfid.errors import NotIdentifiableError
from pmfid.estimators.auto import choose
from pmfid.estimators.iv import IV, RIV
from pmfid.estimators.registry import OFF_LINE
from pmfid.models.drive import Drive, Model
from pmfid.simulation.drive import position_control
from pmfid.simulation.scenarios import CART, CART_DT, make_scenario, resolution_of
from pmfid.status import Status
from studies.paper.truth import table

INCREMENTS = (4096, 1024, 256, 128)
TIME_CONSTANTS = (2, 5, 10)
MOTIONS = ("prbs", "stop-and-go", "creep")
DRIVE = Drive(CART.input_gain)

Run = tuple[NDArray[np.float64], NDArray[np.int64], float]


def record(motion: str, seed: int, increments: int) -> Run:
    """Input (n,), counts (n,) and resolution of a scenario, or of a creep at a count per 20 samples with steps."""
    if motion != "creep":
        scenario = make_scenario(motion, seed=seed, increments=increments)
        return scenario.motion.u, scenario.counts, scenario.resolution
    resolution = resolution_of(increments)
    t = np.arange(6000) * CART_DT
    reference = resolution * t / (20 * CART_DT) + 0.004 * np.floor(t / 3.0)
    phase = resolution * np.random.default_rng(seed).random()
    moved, counts = position_control(
        CART, reference, CART_DT, kp=200.0, kd=5.0, u_max=6.0, resolution=resolution, phase=phase
    )
    return moved.u, counts, resolution


def mass_errors(motion: str, increments: int, time_constant: int, seeds: int) -> tuple[dict[str, float], str]:
    """Root mean square mass error of each off-line method and of auto [%], and what auto chose."""
    found: dict[str, list[float]] = {}
    chosen: set[str] = set()
    for seed in range(seeds):
        u, counts, resolution = record(motion, seed, increments)
        settings = IV(DRIVE, Encoder(resolution), CART_DT, 1 / (time_constant * CART_DT))
        methods: dict[str, Any] = {cls.method: cls(*_positional(settings)) for cls in OFF_LINE}
        methods["auto"] = choose(settings, u, counts, 1.0)[0]
        chosen.add(methods["auto"].method)
        for name, method in methods.items():
            try:
                found.setdefault(name, []).append(100 * (method.fit(u, counts)["mass"] / CART.mass - 1))
            except NotIdentifiableError:
                found.setdefault(name, []).append(np.inf)
    return {name: float(np.sqrt(np.mean(np.square(errors)))) for name, errors in found.items()}, ", ".join(
        sorted(chosen)
    )


def _positional(settings: IV) -> tuple[Model, Encoder, float, float]:
    return settings.model, settings.encoder, settings.dt, settings.cutoff


def off_line(seeds: int) -> Iterator[list[str]]:
    """Rows: motion, encoder, filter, error of each method, what was chosen, ratio to the best."""
    for motion in MOTIONS:
        for increments in INCREMENTS:
            for time_constant in TIME_CONSTANTS:
                errors, chosen = mass_errors(motion, increments, time_constant, seeds)
                auto = errors.pop("auto")
                cells = ["-" if np.isinf(value) else f"{value:.4f}" for value in errors.values()]
                ratio = auto / min(errors.values())
                yield [motion, str(increments), f"{time_constant} T", *cells, f"{auto:.4f}", chosen, f"{ratio:.2f}"]


def on_line(seeds: int) -> Iterator[list[str]]:
    """Rows: samples of the recursive choice outside 0.7 to 1.5 of the true mass, from 1 s on, and those without one."""
    for name in ("mass-step", "stop-and-go-mass-step"):
        for increments in INCREMENTS:
            for time_constant in TIME_CONSTANTS:
                ratios = np.concatenate([_ratio(name, seed, increments, time_constant) for seed in range(seeds)])
                known = ratios[np.isfinite(ratios)]
                outside = int(np.sum((known < 0.7) | (known > 1.5)))
                span = f"{known.min():.3f} to {known.max():.3f}"
                yield [name, str(increments), f"{time_constant} T", span, str(outside), str(ratios.size - known.size)]


def _ratio(name: str, seed: int, increments: int, time_constant: int) -> NDArray[np.float64]:
    scenario = make_scenario(name, seed=seed, increments=increments)
    n = scenario.counts.size
    estimator = RIV(DRIVE, Encoder(scenario.resolution), CART_DT, 1 / (time_constant * CART_DT), forgetting=0.99)
    track = estimator.run(scenario.motion.u, scenario.counts)
    mass = np.where(track.flagged(Status.STARTING), np.nan, track["mass"])
    ratio = mass / np.where(np.arange(n) < n // 2, 1.07, 1.44)
    return np.asarray(np.r_[ratio[100 : n // 2], ratio[n // 2 + 100 :]])


def main() -> None:
    """Writes the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, default=5)
    arguments = parser.parse_args()
    methods = [cls.method for cls in OFF_LINE]
    lines = [
        "# The automatic choice",
        "",
        f"Written by `python -m studies.automatic --out results/automatic.md --seeds {arguments.seeds}`. Root mean "
        f"square error of the mass in percent over {arguments.seeds} seeds; creep: a count per 20 samples, with 4 mm "
        "steps every 3 s.",
        "",
        *table(
            ["motion", "increments", "Tf", *methods, "auto", "chose", "ratio to the best"],
            list(off_line(arguments.seeds)),
        ),
        "",
        "On-line (`riv`, forgetting 0.99): mass over true mass from 1 s on, but for the second after the mass step.",
        "",
        *table(
            ["scenario", "increments", "Tf", "mass / truth", "outside 0.7 to 1.5", "no estimate yet, flagged"],
            list(on_line(2 * arguments.seeds)),
        ),
    ]
    arguments.out.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
