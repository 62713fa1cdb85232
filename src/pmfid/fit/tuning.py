"""Sizes of the blind starts of two masses. They bound a search, and no result depends on them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ElasticTuning:
    """Sizes of `fit.driven`, `fit.elastic` and `fit.second_mass`."""

    #: Widths of the kernel [steps], the largest part of rounding in the acceleration, and the steps to wider kernels,
    #: each with a guess of its own. The derivatives of a kernel below 1.1 steps show the position itself (aliasing).
    kernels: tuple[float, ...] = (1.2, 1.8, 2.6, 3.8, 5.7, 8.4, 12.5, 18.5, 27.0, 40.0, 60.0)
    rounding: float = 0.05
    wider: tuple[int, ...] = (0, 2)
    #: Length of the kernel in widths. Derivatives by a shorter one would show the position itself.
    tail: float = 6.0
    #: Loads of the scan by motion: highest rate [1/step] and antiresonance [Hz], loads per octave, damping and
    #: drag over the rate, and Coulomb friction per mass over the size of the acceleration.
    fastest: float = 0.3
    highest_load: float = 150.0
    loads_per_octave: int = 3
    drags: tuple[float, ...] = (0.03, 0.3)
    frictions: tuple[float, ...] = (0.1, 0.5, 2.0, 6.0, 20.0)
    #: Steps of a load between two samples.
    substeps: int = 6
    #: Loads whose four constants are refined.
    kept: int = 3
    #: Samples of the part in which two masses are sought, where no guess follows the record or one mass does not
    #: explain it.
    part: int = 2000
    #: Factor by which the length of parts of a record grows.
    joined: float = 6.0
    #: Parts of the record that a motion with more than rounding starts again from.
    rejoined: tuple[int, ...] = (12, 36, 144)
    #: Resonances of the scan by fits: lowest [Hz], highest [1/step], number per octave, shares of the load in the
    #: inertia, and damping ratio.
    lowest: float = 2.0
    highest: float = 0.45
    per_octave: int = 3
    shares: tuple[float, ...] = (0.3, 0.75)
    ratio: float = 0.05
    #: Largest distance of a mass, or of a constant of a load, from the first guess, as a logarithm.
    far: float = 5.0
    #: Widths of the smoothing of the first guesses, as a part of the record.
    widths: tuple[float, ...] = (0.002, 0.005, 0.01, 0.02, 0.05)

    #: Trial of a second mass where one mass does not explain the record: fewest samples; further parameters and start
    #: values; and the largest standard error of the logarithms of masses and stiffness. Beyond it, the record shows no
    #: resonance.
    fewest: int = 300
    further: int = 7
    vague: float = 0.3


@dataclass(frozen=True)
class PlayTuning:
    """Sizes of the scan for play."""

    #: Scan: number of gaps from one count to a part of the travel, shares of the load in the inertia, and rate [1/step]
    #: and damping ratio of the contact.
    gaps: int = 6
    widest: float = 0.1
    shares: tuple[float, ...] = (0.25, 0.6)
    contact: tuple[float, float] = (1.0, 0.3)
    #: Narrowest gap [counts], far below what a record may show: a gap of nothing has no derivative.
    narrowest: float = 0.01
    #: Bounds of the contact's rate [1/step].
    rates: tuple[float, float] = (0.1, 3.0)


@dataclass(frozen=True)
class ReleaseTuning:
    """Sizes of `fit.release`."""

    #: Rates of the spring [1/step].
    rates: tuple[float, ...] = (0.3, 0.1, 0.05, 0.025, 0.012, 0.006, 0.003)
    #: Starts that a trial holds, steps of the solver with the first spring and with the others, and the least distance
    #: of fits that are followed in the logarithms of the share of the load, and of gap or stiffness.
    held: int = 16
    first: int = 5
    steps: int = 15
    apart: float = 0.15


@dataclass(frozen=True)
class MotionTuning:
    """Precision of a simulated motion."""

    #: Largest step of the parameters by twice the parts of an interval, in standard errors, and most parts.
    refined: float = 0.1
    parts: int = 64
    #: Lags after which the input before a record has no effect: 5e-5 of it is left.
    lags: float = 10.0


@dataclass(frozen=True)
class WithinTuning:
    """Steps of `fit.within`: most rounds, which settle in two to six; longest step along each direction in standard
    errors; distance from the bounds of a count that a step aims at [counts]; cost of a count beyond its bound, far more
    than that of any step inside (exact penalty)."""

    rounds: int = 12
    longest: float = 3.0
    margin: float = 5e-4
    penalty: float = 1e4


TUNING, PLAY_TUNING, RELEASE_TUNING = ElasticTuning(), PlayTuning(), ReleaseTuning()
MOTION, WITHIN_TUNING = MotionTuning(), WithinTuning()
