"""Inputs that excite a drive, and position references that it is to follow."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from pmfid.simulation.encoder import check_number, check_signal, check_whole, sample_times
from pmfid.types import Floats

_MAX_STAGES = 24


def _check_samples(samples: int) -> None:
    check_whole("samples", samples, 1, np.inf, "give the length of the signal")


def _check_clock(clock: int) -> None:
    check_whole("clock", clock, 1, np.inf, "give the number of samples for which a value is held")


def _check_amplitude(amplitude: float) -> None:
    check_number("amplitude", amplitude, above=0.0, remedy="give the largest input in V")


def prbs(samples: int, *, clock: int, amplitude: float, rng: np.random.Generator) -> Floats:
    """Return a random binary sequence (samples,), +-amplitude [V], each value held for `clock` samples.

    Raises ValueError unless samples and clock are whole and >= 1, amplitude > 0.
    """
    _check_samples(samples)
    _check_clock(clock)
    _check_amplitude(amplitude)
    bits = rng.integers(0, 2, size=-(-samples // clock))
    return np.repeat(amplitude * (2.0 * bits - 1.0), clock)[:samples]


def mls(stages: int, clock: int, amplitude: float) -> Floats:
    """Return one period of a maximum length sequence, ((2**stages - 1) * clock,), +-amplitude [V].

    Each value is held for `clock` samples. Its autocorrelation at multiples of the clock is 1 at zero and
    -1/(2**stages - 1) elsewhere. Raises ValueError unless 2 <= stages <= 24, clock >= 1, amplitude > 0.
    """
    check_whole("stages", stages, 2, _MAX_STAGES, "the period is 2**stages - 1 clocks")
    _check_clock(clock)
    _check_amplitude(amplitude)
    # scipy.signal is slow to import, and only this function needs it.
    from scipy.signal import max_len_seq

    bits = np.asarray(max_len_seq(int(stages))[0], dtype=np.float64)
    return np.repeat(amplitude * (2.0 * bits - 1.0), clock)


def multisine(samples: int, dt: float, frequencies: ArrayLike, amplitude: float, rng: np.random.Generator) -> Floats:
    """Return a sum of sines (samples,) of equal size and random phase whose largest value is `amplitude` [V].

    frequencies (q,) [Hz], each in (0, 1/(2 dt)); dt > 0 [s]. Raises ValueError for values out of range.
    """
    _check_samples(samples)
    check_number("dt", dt, above=0.0, remedy="give the sample period in seconds")
    _check_amplitude(amplitude)
    tones = check_signal("frequencies", frequencies)
    bad = tones[(tones <= 0.0) | (tones >= 0.5 / dt)]
    if bad.size:
        raise ValueError(
            f"frequencies must lie in (0, {0.5 / dt:g}) Hz, half the sample rate, got {bad[0]:g}; "
            "leave it out or take a smaller dt"
        )
    t = sample_times(samples, dt)
    phases = rng.uniform(0.0, 2.0 * np.pi, tones.size)
    total: Floats = np.sin(2.0 * np.pi * np.outer(t, tones) + phases).sum(axis=1)
    return total * (amplitude / float(np.abs(total).max()))


def _phase_of_move(samples: int, dt: float, stroke: float, move_time: float) -> Floats:
    """Return t / move_time at the samples, after the checks common to all profiles."""
    _check_samples(samples)
    check_number("dt", dt, above=0.0, remedy="give the sample period in seconds")
    check_number("stroke", stroke, remedy="give the length of the move in m, with its sign")
    check_number("move_time", move_time, above=0.0, remedy="give the time for one move in seconds")
    return sample_times(samples, dt) / move_time


def _smooth_step(tau: Floats) -> Floats:
    """Rise from 0 at tau <= 0 to 1 at tau >= 1 with least jerk, velocity and acceleration 0 at both ends."""
    tau = np.clip(tau, 0.0, 1.0)
    return tau**3 * (10.0 + tau * (6.0 * tau - 15.0))


def _trapezoid_step(tau: Floats) -> Floats:
    """Rise from 0 at tau <= 0 to 1 at tau >= 1: a third of the time to accelerate, to cruise and to brake."""
    tau = np.clip(tau, 0.0, 1.0)
    rise, fall = np.minimum(tau, 1.0 / 3.0), np.maximum(tau - 2.0 / 3.0, 0.0)
    return 2.25 * rise**2 + 1.5 * (tau - rise) - 2.25 * fall**2


#: Shape of one move -> rise from 0 to 1 over tau in [0, 1].
SHAPES: dict[str, Callable[[Floats], Floats]] = {"s-curve": _smooth_step, "trapezoid": _trapezoid_step}


def trapezoid(samples: int, dt: float, stroke: float, move_time: float) -> Floats:
    """Return a position reference (samples,) [m] from 0 to `stroke` in move_time [s], then held.

    The velocity is a trapezoid: a third of the time each to accelerate, cruise (at 1.5 stroke/move_time) and
    brake. Raises ValueError unless dt, move_time > 0 and stroke is finite.
    """
    return stroke * _trapezoid_step(_phase_of_move(samples, dt, stroke, move_time))


def s_curve(samples: int, dt: float, stroke: float, move_time: float) -> Floats:
    """Return a position reference (samples,) [m] from 0 to `stroke` in move_time [s], then held.

    The polynomial of least jerk: acceleration is zero at both ends, peak velocity 1.875 stroke/move_time.
    Raises ValueError unless dt, move_time > 0 and stroke is finite.
    """
    return stroke * _smooth_step(_phase_of_move(samples, dt, stroke, move_time))


def _check_dwell(dwell_time: float) -> None:
    if not (np.isfinite(dwell_time) and dwell_time >= 0.0):
        raise ValueError(f"dwell_time must be finite and >= 0, got {dwell_time}; give the pause in seconds")


def stop_and_go(
    samples: int, dt: float, stroke: float, move_time: float, dwell_time: float, shape: str = "s-curve"
) -> Floats:
    """Return a position reference (samples,) [m]: 0 to `stroke`, dwell, back to 0, dwell, and so on.

    Each move is an `s_curve` (or, by its shape, a `trapezoid`) of move_time [s] > 0, each dwell lasts
    dwell_time [s] >= 0. Raises ValueError for values out of range.
    """
    tau = _phase_of_move(samples, dt, stroke, move_time)
    _check_dwell(dwell_time)
    leg, within = np.divmod(tau, 1.0 + dwell_time / move_time)
    rise = _rise(shape)(within)
    return stroke * np.where(leg % 2.0 == 0.0, rise, 1.0 - rise)


def _rise(shape: str) -> Callable[[Floats], Floats]:
    if shape not in SHAPES:
        raise ValueError(f"unknown shape {shape!r}; choose one of: {', '.join(SHAPES)}")
    return SHAPES[shape]


def steps(samples: int, dt: float, stroke: float, hold_time: float) -> Floats:
    """Return a position reference (samples,) [m] that jumps between `stroke` and 0, each held for hold_time [s] > 0.

    Raises ValueError for values out of range.
    """
    leg = np.floor(_phase_of_move(samples, dt, stroke, hold_time) + 1e-9)
    return np.asarray(np.where(leg % 2.0 == 0.0, stroke, 0.0), dtype=np.float64)


def random_moves(
    samples: int,
    dt: float,
    stroke: float,
    move_time: float,
    dwell_time: float,
    rng: np.random.Generator,
    shape: str = "s-curve",
) -> Floats:
    """Return a position reference (samples,) [m] of moves between random places in [0, stroke].

    Each move takes move_time [s] > 0, each dwell 0 to 2 dwell_time [s], mean dwell_time >= 0. Raises ValueError for
    values out of range.
    """
    tau = _phase_of_move(samples, dt, stroke, move_time)
    _check_dwell(dwell_time)
    rise, moves = _rise(shape), int(tau[-1]) + 1
    places = np.r_[0.0, rng.uniform(0.0, stroke, moves)]
    begin = np.r_[0.0, np.cumsum(1.0 + rng.uniform(0.0, 2.0 * dwell_time / move_time, moves))][:moves]
    move = np.searchsorted(begin, tau, side="right") - 1
    return np.asarray(places[move] + np.diff(places)[move] * rise(tau - begin[move]))
