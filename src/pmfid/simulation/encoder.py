"""An incremental encoder that watches a simulated axis, and what a cheap one does wrong."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pmfid.simulation._plant import read_encoder
from pmfid.simulation.checks import check_number, check_signal, check_whole
from pmfid.types import Counts, Floats

# Up to 2**53 every whole number is a double of its own; a larger count would be made up.
COUNT_LIMIT = 2**53


@dataclass(frozen=True)
class Faults:
    """Faults of an encoder; none by default. The same seed gives the same faults.

    missed: probability in [0, 1) that an edge is not counted, so that the count stays wrong from then on.
    jitter: standard deviation [counts] >= 0 by which the edges lie elsewhere at each sample (noise of the receiver).
    line_error: largest displacement of a line of the disc [counts], in [0, 0.5). Displacements are uniform, and the
    same on every turn of `lines` >= 1 counts. Edges inside one sample follow from its net travel.
    Raises ValueError for a value outside its range.
    """

    missed: float = 0.0
    jitter: float = 0.0
    line_error: float = 0.0
    lines: int = 4096
    seed: int = 0

    def __post_init__(self) -> None:
        for name, end, remedy in (
            ("missed", 1.0, "it is the part of the edges that is lost"),
            ("jitter", np.inf, "it is a standard deviation in counts"),
            ("line_error", 0.5, "further off, two lines would change places"),
        ):
            value = getattr(self, name)
            if not 0.0 <= value < end:
                raise ValueError(f"{name} must be in [0, {end:g}), got {value}; {remedy}")
        check_whole("lines", self.lines, 1, 2**24, "give the counts per turn of the disc")
        check_whole("seed", self.seed, 0, np.inf, "any whole number from 0 on will do")

    def draw(self, samples: int) -> tuple[Floats, Floats, float, int]:
        """Places of the lines (lines,), shift of each sample (samples,) or (0,) [counts], missed, seed: for C."""
        rng = np.random.default_rng(self.seed)
        seed = int(rng.integers(2**63))
        lines = rng.uniform(-self.line_error, self.line_error, self.lines) if self.line_error else np.zeros(1)
        shift = self.jitter * rng.standard_normal(samples) if self.jitter else np.zeros(0)
        return lines, shift, self.missed, seed


NO_FAULTS = Faults()


def wrap_counts(counts: Counts, bits: int | None) -> Counts:
    """Counts modulo 2**bits, as a register without sign holds them; None: as they are."""
    if bits is None:
        return counts
    check_whole("bits", bits, 1, 63, "give the width of the counter register")
    return counts & np.int64(2**bits - 1)


def quantize(
    x: ArrayLike, resolution: float, phase: float = 0.0, bits: int | None = None, faults: Faults = NO_FAULTS
) -> Counts:
    """Return the encoder counts floor((x + phase) / resolution), shape of `x`, int64 (paper eq. 3).

    x, phase, resolution > 0 in the same unit [m]. With `bits` (1 to 63) the counter is that of a register
    without sign: it wraps modulo 2**bits. With `faults`, x is (n,), one position per sample. Raises ValueError for
    values that aren't finite or exceed 2**53 counts.
    """
    check_number("resolution", resolution, above=0.0, remedy="give the travel per count in m")
    check_number("phase", phase, remedy="give the start position on the encoder lattice in m")
    with np.errstate(over="ignore"):  # the check below tells it
        level = np.floor((np.asarray(x, dtype=np.float64) + phase) / resolution)
    if not (np.abs(level) <= COUNT_LIMIT).all():
        raise ValueError(
            f"x must be finite and within 2**53 counts of {resolution} m; check the units of x and resolution"
        )
    if faults == NO_FAULTS:
        return wrap_counts(np.asarray(level, dtype=np.int64), bits)
    signal = check_signal("x", x)
    return wrap_counts(read_encoder(signal, resolution, phase, *faults.draw(signal.size)), bits)
