"""Simulated encoders, and checks of the arguments of a simulation."""

from dataclasses import dataclass
from math import isfinite

import numpy as np
from numpy.typing import ArrayLike

from pmfid.simulation._plant import read_encoder
from pmfid.types import COUNT_LIMIT, Counts, Floats


def check_number(name: str, value: float, *, above: float = -np.inf, remedy: str = "pass a finite number") -> None:
    """Raise ValueError unless `value` is finite and > `above`."""
    if not (isfinite(value) and value > above):
        bound = "finite" if above == -np.inf else f"finite and > {above:g}"
        raise ValueError(f"{name} must be {bound}, got {value}; {remedy}")


def check_whole(name: str, value: int, low: int, high: float, remedy: str) -> None:
    """Raise ValueError unless `value` is a whole number in [low, high]."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or not low <= value <= high:
        bound = f"of at least {low}" if high == np.inf else f"in [{low}, {high:g}]"
        raise ValueError(f"{name} must be a whole number {bound}, got {value}; {remedy}")


def check_signal(name: str, values: ArrayLike) -> Floats:
    """Return a float64 copy (n,) of `values`; raise ValueError unless 1-D, finite and n >= 1."""
    signal = np.array(values, dtype=np.float64, order="C")
    if np.ndim(values) != 1 or signal.size == 0:
        raise ValueError(f"{name} must have shape (n,), n >= 1, got {np.shape(values)}; pass one value per sample")
    bad = np.flatnonzero(~np.isfinite(signal))
    if bad.size:
        raise ValueError(f"{name}[{bad[0]}] is {signal[bad[0]]} and must be finite; repair this sample or leave it out")
    return signal


def sample_times(samples: int, dt: float) -> Floats:
    """Return the instants k dt, (samples,)."""
    return np.arange(samples, dtype=np.float64) * np.float64(dt)


@dataclass(frozen=True)
class Faults:
    """Faults of an encoder. By default the encoder has none.

    Equal seeds give equal faults. The edges in one sample follow from the net travel in this sample.

    Parameters
    ----------
    missed
        Probability in [0, 1) that an edge is not counted. After a missed edge the count stays wrong.
    jitter
        Standard deviation [counts] >= 0 of the edges' displacement at each sample (noise of the receiver).
    line_error
        Largest displacement of a line of the disc [counts], in [0, 0.5). Displacements are uniform, and the same on
        every turn.
    lines
        Counts per turn, >= 1.
    seed
        Seed of the faults, >= 0.

    Raises
    ------
    ValueError
        If a value is outside its range.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid.simulation import Faults, quantize
    >>> x = np.linspace(0.0, 1e-3, 1001)
    >>> int(quantize(x, 1e-5)[-1]), bool(quantize(x, 1e-5, faults=Faults(missed=0.2))[-1] < 100)
    (100, True)
    """

    missed: float = 0.0
    jitter: float = 0.0
    line_error: float = 0.0
    lines: int = 4096
    seed: int = 0

    def __post_init__(self) -> None:
        for name, end, remedy in (
            ("missed", 1.0, "give the part of the edges that is lost"),
            ("jitter", np.inf, "give a standard deviation in counts"),
            ("line_error", 0.5, "give less than half a count, so that lines keep their order"),
        ):
            value = getattr(self, name)
            if not 0.0 <= value < end:
                raise ValueError(f"{name} must be in [0, {end:g}), got {value}; {remedy}")
        check_whole("lines", self.lines, 1, 2**24, "give the counts per turn of the disc")
        check_whole("seed", self.seed, 0, np.inf, "give any whole number of at least 0")

    def draw(self, samples: int) -> tuple[Floats, Floats, float, int]:
        """Draw the faults for the kernel: line places (lines,), sample shifts [counts], `missed` and a seed.

        The shifts are (samples,), or (0,) without jitter.
        """
        rng = np.random.default_rng(self.seed)
        seed = int(rng.integers(2**63))
        lines = rng.uniform(-self.line_error, self.line_error, self.lines) if self.line_error else np.zeros(1)
        shift = self.jitter * rng.standard_normal(samples) if self.jitter else np.zeros(0)
        return lines, shift, self.missed, seed


NO_FAULTS = Faults()


def wrap_counts(counts: Counts, bits: int | None) -> Counts:
    """Return the counts modulo 2**bits, as an unsigned register holds them. If `bits` is None, return the counts
    unchanged."""
    if bits is None:
        return counts
    check_whole("bits", bits, 1, 63, "give the width of the counter register")
    return counts & np.int64(2**bits - 1)


def quantize(
    x: ArrayLike, resolution: float, phase: float = 0.0, bits: int | None = None, faults: Faults = NO_FAULTS
) -> Counts:
    """Return the encoder counts floor((x + phase) / resolution).

    Parameters
    ----------
    x
        Position [m]. With `faults`, (n,) with one position per sample.
    resolution
        Travel per count [m], > 0.
    phase
        Start position on the encoder lattice [m].
    bits
        Width of an unsigned register, 1 to 63. The counter wraps modulo 2**bits; with None it does not wrap.
    faults
        Faults of the encoder.

    Returns
    -------
    ndarray
        Counts, int64, in the shape of `x`.

    Raises
    ------
    ValueError
        If a value is not finite or exceeds 2**53 counts.

    References
    ----------
    Paper eq. 3.

    Examples
    --------
    >>> from pmfid.simulation import quantize
    >>> quantize([0.0, 0.25, -0.25], resolution=0.1).tolist()
    [0, 2, -3]
    >>> quantize([0.0, 0.25, -0.25], resolution=0.1, bits=8).tolist()
    [0, 2, 253]
    """
    check_number("resolution", resolution, above=0.0, remedy="give the travel per count in m")
    check_number("phase", phase, remedy="give the start position on the encoder lattice in m")
    with np.errstate(over="ignore"):  # the check below reports an overflow
        level = np.floor((np.asarray(x, dtype=np.float64) + phase) / resolution)
    if not (np.abs(level) <= COUNT_LIMIT).all():
        raise ValueError(
            f"x must be finite and within 2**53 counts of {resolution} m; check the units of x and resolution"
        )
    if faults == NO_FAULTS:
        return wrap_counts(np.asarray(level, dtype=np.int64), bits)
    signal = check_signal("x", x)
    return wrap_counts(read_encoder(signal, resolution, phase, *faults.draw(signal.size)), bits)
