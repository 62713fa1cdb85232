"""Pictures of status words of an estimate and of a sample: each next to the same without the word."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from matplotlib.figure import Figure

import pmfid
from pmfid.simulation import CART, CART_DT, Machine, drive_machine, prbs
from pmfid.simulation.drive import MachineRun

FINE, COARSE = 91e-6, 5.8e-3
DRIVE = pmfid.Drive(input_gain=2.0)


def _push(samples: int = 2000) -> np.ndarray:
    return prbs(samples, clock=8, amplitude=3.0, rng=np.random.default_rng(1))


def _move(u: np.ndarray, resolution: float = FINE) -> MachineRun:
    return drive_machine(Machine(CART), u, CART_DT, resolution)


def _rest(start: int, end: int) -> MachineRun:
    u = _push()
    u[start:end] = 0.0
    return _move(u)


def _constant_push() -> MachineRun:
    u = _push()
    u[800:1500] = u[800]
    return _move(u)


def _without_input() -> MachineRun:
    run = _move(_push())
    run.u[800:830] = np.nan
    return run


def _reversed_input() -> MachineRun:
    run = _move(_push())
    run.u[800:1000] *= -1
    return run


#: Of a word of a sample: the estimator, its encoder's resolution and other options, and the record with the word.
SAMPLES: Mapping[str, tuple[Any, float, dict[str, Any], Callable[[], MachineRun]]] = MappingProxyType(
    {
        "starting": (pmfid.RIV, FINE, {}, lambda: _rest(0, 700)),
        "settling": (pmfid.RIV, FINE, {}, _without_input),
        "compensation_held": (pmfid.BCRLS, FINE, {}, _constant_push),
        "fallback": (pmfid.RIV, FINE, {}, _reversed_input),
        "invalid_input": (pmfid.RIV, FINE, {}, _without_input),
        "standstill": (pmfid.RIV, FINE, {}, lambda: _rest(800, 1500)),
    }
)
#: Of a word of an estimate: names, samples, resolution and options of the estimates without it and with it.
ESTIMATES: Mapping[str, tuple[tuple[str, int, float, dict[str, Any]], ...]] = MappingProxyType(
    {
        "biased": (("iv", 3000, COARSE, {"method": "iv"}), ("bcls", 3000, COARSE, {"method": "bcls"})),
        "implausible": (("iv", 3000, COARSE, {"method": "iv"}), ("ls", 3000, COARSE, {"method": "ls"})),
        "uncertain": (("30 s", 3000, COARSE, {"method": "iv"}), ("1.5 s", 150, COARSE, {"method": "iv"})),
        "prior_contradicted": (
            ("prior 1.1(1) kg", 3000, FINE, {"method": "iv", "prior": {"mass": (1.1, 0.1)}}),
            ("prior 1.50(5) kg", 3000, FINE, {"method": "iv", "prior": {"mass": (1.5, 0.05)}}),
        ),
    }
)


def draw_samples(word: str) -> Figure:
    """Draw the motion and the estimated mass of a good record, and of a record with the word at marked samples."""
    kind, resolution, options, bad = SAMPLES[word]
    figure = Figure(figsize=(8, 3.6), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True)
    for column, (run, title) in enumerate(((_move(_push(), resolution), "a good record"), (bad(), word))):
        estimator = kind(DRIVE, pmfid.Encoder(resolution), CART_DT, cutoff=33.0, forgetting=0.995, **options)
        track = estimator.run(run.u, run.counts)
        time = CART_DT * np.arange(run.u.size)
        marked = (track.status & pmfid.Status[word.upper()]) != 0
        usable = (track.status & pmfid.Status.STARTING) == 0
        axes[0, column].set_title(title)
        axes[0, column].plot(time, run.counts * resolution, lw=1)
        axes[1, column].plot(time, np.where(usable, track["mass"], np.nan), lw=1)
        for axis in axes[:, column]:
            ends = axis.get_xaxis_transform()
            axis.fill_between(time, 0, 1, where=marked, transform=ends, color="tab:red", alpha=0.3, lw=0)
        axes[1, column].set(xlabel="time [s]; red: the word", ylim=(0.9, 1.25))
    if not marked.any():
        raise ValueError(f"no sample has the word {word}")
    axes[0, 0].set_ylabel("position [m]")
    axes[1, 0].set_ylabel("mass [kg]")
    return figure


def draw_estimates(word: str) -> Figure:
    """Draw the mass with its interval, of an estimate without the word and of one with the word."""
    figure = Figure(figsize=(8, 2), layout="constrained")
    axis = figure.subplots()
    for place, (name, samples, resolution, options) in enumerate(ESTIMATES[word]):
        run = _move(_push(samples), resolution)
        encoder = pmfid.Encoder(resolution)
        found = pmfid.identify(run.u, run.counts, model=DRIVE, encoder=encoder, dt=CART_DT, cutoff=33.0, **options)
        if (word in found.status) != bool(place):
            raise ValueError(f"{name} has the status {found.status}, for a picture of {word}")
        color, error = "tab:red" if place else "tab:blue", 2 * found.theta_std[0]
        axis.plot(found.interval_95[0], [place, place], color=color, lw=1)
        axis.plot(found["mass"] + np.array([-error, error]), [place, place], color=color, lw=6, solid_capstyle="butt")
        axis.plot(found["mass"], place, "o", color="k", ms=4)
        axis.text(
            0.99, place + 0.15, word if place else "no word", transform=axis.get_yaxis_transform(), ha="right", va="top"
        )
    axis.axvline(CART.mass, color="0.3", ls="--")
    axis.set(yticks=[0, 1], yticklabels=[entry[0] for entry in ESTIMATES[word]], ylim=(1.7, -0.5))
    axis.ticklabel_format(axis="x", useOffset=False)
    axis.locator_params(axis="x", nbins=6)
    axis.set_xlabel("mass [kg]; thick: two standard errors; thin: 95 % interval; dashed: true mass")
    return figure
