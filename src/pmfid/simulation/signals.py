"""Inputs that excite a drive, and position references for a controlled drive."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from pmfid.elementary import cos_sin
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
    """Return a random binary sequence (samples,) of +-amplitude [V].

    Parameters
    ----------
    samples
        Length of the signal, >= 1.
    clock
        Samples for which each value is held, >= 1.
    amplitude
        Size of the values [V], > 0.
    rng
        Random generator of the values.

    Raises
    ------
    ValueError
        If samples or clock are not whole numbers >= 1, or if the amplitude is not > 0.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid.simulation import prbs
    >>> u = prbs(1000, clock=10, amplitude=3.0, rng=np.random.default_rng(1))
    >>> u.shape, np.unique(u).tolist()
    ((1000,), [-3.0, 3.0])
    """
    _check_samples(samples)
    _check_clock(clock)
    _check_amplitude(amplitude)
    bits = rng.integers(0, 2, size=-(-samples // clock))
    return np.repeat(amplitude * (2.0 * bits - 1.0), clock)[:samples]


def mls(stages: int, clock: int, amplitude: float) -> Floats:
    """Return one period of a maximum length sequence: ((2**stages - 1) * clock,) values +-amplitude [V].

    The autocorrelation of the sequence is 1 at zero lag, and -1/(2**stages - 1) at all other multiples of the clock.

    Parameters
    ----------
    stages
        Stages of the shift register, 2 to 24.
    clock
        Samples for which each value is held, >= 1.
    amplitude
        Size of the values [V], > 0.

    Raises
    ------
    ValueError
        If an argument is out of range.

    Examples
    --------
    >>> from pmfid.simulation import mls
    >>> u = mls(stages=4, clock=1, amplitude=1.0)
    >>> u.size, float(u.sum()), float(u[1:] @ u[:-1] + u[0] * u[-1])
    (15, 1.0, -1.0)
    """
    check_whole("stages", stages, 2, _MAX_STAGES, "the period is 2**stages - 1 clocks")
    _check_clock(clock)
    _check_amplitude(amplitude)
    # SciPy's signal module is slow to import, and only this function needs it.
    from scipy.signal import max_len_seq

    bits = np.asarray(max_len_seq(int(stages))[0], dtype=np.float64)
    return np.repeat(amplitude * (2.0 * bits - 1.0), clock)


def multisine(samples: int, dt: float, frequencies: ArrayLike, amplitude: float, rng: np.random.Generator) -> Floats:
    """Return a sum of sines (samples,) of equal size and random phase [V].

    Parameters
    ----------
    samples
        Length of the signal, >= 1.
    dt
        Sample period [s], > 0.
    frequencies
        (q,) frequencies [Hz], each in (0, 1/(2 dt)).
    amplitude
        Largest value of the sum [V], > 0.
    rng
        Random generator of the phases.

    Raises
    ------
    ValueError
        If an argument is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid.simulation import multisine
    >>> u = multisine(1000, 0.01, [0.5, 1.5, 3.0], amplitude=6.0, rng=np.random.default_rng(1))
    >>> u.shape, round(float(abs(u).max()), 6)
    ((1000,), 6.0)
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
    phases = rng.uniform(0.0, 1.0, tones.size)
    total = np.zeros(samples)
    for tone, phase in zip(tones.tolist(), phases.tolist(), strict=True):
        total += cos_sin(tone * t + phase)[1]
    return total * (amplitude / float(np.abs(total).max()))


def _phase_of_move(samples: int, dt: float, stroke: float, move_time: float) -> Floats:
    """Check the arguments that all profiles share, and return t / move_time at the samples."""
    _check_samples(samples)
    check_number("dt", dt, above=0.0, remedy="give the sample period in seconds")
    check_number("stroke", stroke, remedy="give the length of the move in m, with its sign")
    check_number("move_time", move_time, above=0.0, remedy="give the time for one move in seconds")
    return sample_times(samples, dt) / move_time


def _smooth_step(tau: Floats) -> Floats:
    """Return a rise from 0 at tau <= 0 to 1 at tau >= 1 with least jerk.

    Velocity and acceleration are 0 at both ends.
    """
    tau = np.clip(tau, 0.0, 1.0)
    return tau * tau * tau * (10.0 + tau * (6.0 * tau - 15.0))


def _trapezoid_step(tau: Floats) -> Floats:
    """Return a rise from 0 at tau <= 0 to 1 at tau >= 1, with a third of the time each to accelerate, cruise and
    brake."""
    tau = np.clip(tau, 0.0, 1.0)
    rise, fall = np.minimum(tau, 1.0 / 3.0), np.maximum(tau - 2.0 / 3.0, 0.0)
    return 2.25 * rise**2 + 1.5 * (tau - rise) - 2.25 * fall**2


#: Shapes of one move, as functions from tau in [0, 1] to a rise from 0 to 1.
SHAPES: dict[str, Callable[[Floats], Floats]] = {"s-curve": _smooth_step, "trapezoid": _trapezoid_step}


def trapezoid(samples: int, dt: float, stroke: float, move_time: float) -> Floats:
    """Return a position reference (samples,) from 0 to `stroke` [m], with a trapezoid as its velocity.

    Acceleration, cruise (at 1.5 stroke/move_time) and braking take a third of the time each.

    Parameters
    ----------
    samples
        Length of the signal, >= 1.
    dt
        Sample period [s], > 0.
    stroke
        Length of the move [m], with its sign.
    move_time
        Time of the move [s], > 0; the position is held afterwards.

    Raises
    ------
    ValueError
        If an argument is out of range.

    Examples
    --------
    >>> from pmfid.simulation import trapezoid
    >>> trapezoid(6, dt=0.1, stroke=0.2, move_time=0.4).round(3).tolist()
    [0.0, 0.028, 0.1, 0.172, 0.2, 0.2]
    """
    return stroke * _trapezoid_step(_phase_of_move(samples, dt, stroke, move_time))


def s_curve(samples: int, dt: float, stroke: float, move_time: float) -> Floats:
    """Return a position reference (samples,) from 0 to `stroke` [m] with least jerk.

    Acceleration is zero at both ends. The peak velocity is 1.875 stroke/move_time.

    Parameters
    ----------
    samples, dt, stroke, move_time
        See `trapezoid`.

    Raises
    ------
    ValueError
        If an argument is out of range.

    Examples
    --------
    >>> from pmfid.simulation import s_curve
    >>> s_curve(6, dt=0.1, stroke=0.2, move_time=0.4).round(3).tolist()
    [0.0, 0.021, 0.1, 0.179, 0.2, 0.2]
    """
    return stroke * _smooth_step(_phase_of_move(samples, dt, stroke, move_time))


def _check_dwell(dwell_time: float) -> None:
    if not (np.isfinite(dwell_time) and dwell_time >= 0.0):
        raise ValueError(f"dwell_time must be finite and >= 0, got {dwell_time}; give the pause in seconds")


def stop_and_go(
    samples: int, dt: float, stroke: float, move_time: float, dwell_time: float, shape: str = "s-curve"
) -> Floats:
    """Return a position reference (samples,) [m] of moves to `stroke` and back to 0, with a dwell after each.

    Parameters
    ----------
    samples, dt, stroke, move_time
        Values for each move; see `trapezoid`.
    dwell_time
        Time of each dwell [s], >= 0.
    shape
        "s-curve" or "trapezoid".

    Raises
    ------
    ValueError
        If an argument is out of range.

    Examples
    --------
    >>> from pmfid.simulation import stop_and_go
    >>> stop_and_go(9, dt=0.2, stroke=0.2, move_time=0.4, dwell_time=0.4).round(3).tolist()
    [0.0, 0.1, 0.2, 0.2, 0.2, 0.1, 0.0, 0.0, 0.0]
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
    """Return a position reference (samples,) [m] that jumps between `stroke` and 0.

    Parameters
    ----------
    samples, dt, stroke
        See `trapezoid`.
    hold_time
        Time for which each value is held [s], > 0.

    Raises
    ------
    ValueError
        If an argument is out of range.

    Examples
    --------
    >>> from pmfid.simulation import steps
    >>> steps(6, dt=0.1, stroke=0.1, hold_time=0.2).tolist()
    [0.1, 0.1, 0.0, 0.0, 0.1, 0.1]
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
    """Return a position reference (samples,) [m] of moves between random positions in [0, stroke].

    Parameters
    ----------
    samples, dt, stroke, move_time
        Values for each move; see `trapezoid`.
    dwell_time
        Mean time of a dwell [s], >= 0. Each dwell takes 0 to 2 dwell_time.
    rng
        Random generator of positions and dwells.
    shape
        "s-curve" or "trapezoid".

    Raises
    ------
    ValueError
        If an argument is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid.simulation import random_moves
    >>> reference = random_moves(3000, 0.01, 0.4, move_time=0.8, dwell_time=0.5, rng=np.random.default_rng(1))
    >>> float(reference[0]), bool(reference.min() >= 0.0), bool(reference.max() <= 0.4)
    (0.0, True, True)
    """
    tau = _phase_of_move(samples, dt, stroke, move_time)
    _check_dwell(dwell_time)
    rise, moves = _rise(shape), int(tau[-1]) + 1
    places = np.r_[0.0, rng.uniform(0.0, stroke, moves)]
    begin = np.r_[0.0, np.cumsum(1.0 + rng.uniform(0.0, 2.0 * dwell_time / move_time, moves))][:moves]
    move = np.searchsorted(begin, tau, side="right") - 1
    return np.asarray(places[move] + np.diff(places)[move] * rise(tau - begin[move]))
