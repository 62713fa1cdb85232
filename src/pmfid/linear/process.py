"""A transfer function as a result."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from pmfid.errors import UsageError
from pmfid.linear.experiment import Grid, RecordStretch
from pmfid.linear.responses import Structure, channels
from pmfid.linear.tuning import TUNING
from pmfid.presentation import Presentable, Summary, plain_dict
from pmfid.types import Complex, Floats

if TYPE_CHECKING:
    import control
    from scipy import signal


def number(value: complex) -> str:
    """Return a pole or a zero as text."""
    if value.imag == 0:
        return f"{value.real:.4g}"
    return f"{value.real:.4g} {'+' if value.imag > 0 else '-'} {abs(value.imag):.4g} j"


def spread(real: float, imaginary: float) -> str:
    """Return the standard deviations of real and imaginary part as text."""
    return f"{real:.2g}" if imaginary == 0 else f"{real:.2g}, {imaginary:.2g} j"


def polynomial(coefficients: Floats, power: str = "^%d") -> str:
    """Return the sum of c_i s^i as text, highest power first."""
    parts: list[str] = []
    for i in range(coefficients.size - 1, -1, -1):
        value = float(coefficients[i])
        size = "" if i and abs(value) == 1 else f"{abs(value):.5g}"
        symbol = "" if i == 0 else "s" if i == 1 else "s" + power % i
        sign = ("-" if value < 0 else "") if not parts else (" - " if value < 0 else " + ")
        parts.append(f"{sign}{size}{' ' if size and symbol else ''}{symbol}")
    return "".join(parts)


def with_bar(value: float, std: float) -> str:
    """Return a number and its standard deviation as text."""
    return f"{value:.5g} ± {std:.2g}"


def root_with_bars(value: complex, std: Floats) -> str:
    """Return a pole or a zero and the standard deviations (2,) of its parts as text."""
    if value.imag == 0:
        return with_bar(value.real, float(std[0]))
    sign = "+" if value.imag > 0 else "-"
    return f"{value.real:.5g} ± {std[0]:.2g} {sign} j ({abs(value.imag):.5g} ± {std[1]:.2g})"


#: Name and unit of the steady response to a constant input: the output, its speed or its acceleration.
GAINS = (("gain", ""), ("velocity gain", "1/s"), ("acceleration gain", "1/s^2"))


@dataclass(frozen=True, eq=False, repr=False)
class Process(Presentable):
    """G(s) = exp(-delay s) (b_0 + ... + b_m s^m) / (a_0 + ... + a_{n-1} s^{n-1} + s^n).

    Parameters
    ----------
    a : ndarray (n,)
        Coefficients of the denominator, starting with the constant.
    b : ndarray (m+1,)
        Coefficients of the numerator, starting with the constant.
    cov : ndarray (n+m+1, n+m+1)
        Covariance of a and b, with a further row and column for an estimated delay. Known values, such as a pole at 0,
        have no variance.
    delay : float
        Dead time [s].

    Notes
    -----
    All uncertainties are one standard deviation by the delta method, to first order in the errors of the parameters.
    For poles and zeros, the errors span a 95 % interval.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid import Process
    >>> process = Process(np.array([2.0]), np.array([4.0]), np.diag([0.01, 0.04]))
    >>> float(process.gain), float(process.time_constants[0])
    (2.0, 0.5)
    """

    a: Floats
    b: Floats
    cov: Floats
    delay: float = 0.0

    @classmethod
    def from_theta(cls, structure: Structure, theta: ArrayLike, cov: ArrayLike, delay: float) -> Process:
        """Make the process from theta (p,) and its covariance (p, p), without the offset."""
        theta = np.asarray(theta, float)
        known, late = structure.integrators, structure.latest is not None
        rows = [*range(structure.free + structure.m + 1), *[theta.size - 1] * late]
        whole = np.zeros((known + len(rows),) * 2)
        whole[known:, known:] = np.asarray(cov, float)[np.ix_(rows, rows)]
        return cls(structure.denominator(theta), structure.split(theta)[1], whole, delay)

    @property
    def delay_std(self) -> float:
        """The standard deviation of the dead time [s], or 0 if the dead time was given."""
        return float(np.sqrt(self.cov[-1, -1])) if self._late else 0.0

    @property
    def _late(self) -> bool:
        return len(self.cov) > self.a.size + self.b.size

    @property
    def poles(self) -> Complex:
        """The poles (n,) [rad/s], slowest first."""
        return _roots(np.r_[self.a, 1.0])

    @property
    def zeros(self) -> Complex:
        """The zeros (m,) [rad/s], slowest first."""
        return _roots(self.b)

    @property
    def poles_std(self) -> Floats:
        """The standard deviations (n, 2) of the real and imaginary parts of the poles [rad/s]."""
        return self._root_std(np.r_[self.a, 1.0], self.poles, slice(0, self.a.size))

    @property
    def zeros_std(self) -> Floats:
        """The standard deviations (m, 2) of the real and imaginary parts of the zeros [rad/s]."""
        return self._root_std(self.b, self.zeros, slice(self.a.size, self.a.size + self.b.size))

    @property
    def gain(self) -> float:
        """The static gain G(0), or infinity for an integrating process."""
        return float(self.b[0] / self.a[0]) if self.a[0] else float("inf")

    @property
    def gain_std(self) -> float:
        slope = np.zeros(self.cov.shape[0])
        if not self.a[0]:
            return float("inf")
        slope[0], slope[self.a.size] = -self.b[0] / self.a[0] ** 2, 1 / self.a[0]
        return _deviation(slope, self.cov)

    @property
    def integrators(self) -> int:
        """The number of poles that are known to be at 0."""
        return int(np.argmax(np.r_[self.a, 1.0] != 0))

    @property
    def slope(self) -> tuple[str, float, float, str]:
        """The steady response to a constant input: s^k G(s) at s = 0 with k integrators.

        With integrators, the derivative of order k of the output becomes constant. The property returns the name, the
        value, the standard deviation, and the factor of the unit to output over input.
        """
        k, slope = self.integrators, np.zeros(self.cov.shape[0])
        bottom = np.r_[self.a, 1.0][k]
        if k < self.a.size:
            slope[k] = -self.b[0] / bottom**2
        slope[self.a.size] = 1 / bottom
        name, unit = (*GAINS, (f"gain of derivative {k}", f"s^-{k}"))[min(k, len(GAINS))]
        return name, float(self.b[0] / bottom), _deviation(slope, self.cov), unit

    @property
    def time_constants(self) -> Floats:
        """The time constants 1 / |pole| (n,) [s] in the order of `poles`, infinite for an integrator."""
        with np.errstate(divide="ignore"):
            return np.asarray(1 / np.abs(self.poles))

    @property
    def time_constants_std(self) -> Floats:
        """The standard deviations of the time constants (n,) [s], infinite for an integrator."""
        part, found = self.cov[: self.a.size, : self.a.size], []
        for pole in self.poles:
            if pole == 0:
                found.append(np.inf)
                continue
            slope = self._root_slope(np.r_[self.a, 1.0], pole)[: self.a.size]
            row = -(np.conj(pole) * slope).real / abs(pole) ** 3
            found.append(np.sqrt(max(0.0, row @ part @ row)))
        return np.array(found)

    @property
    def damping(self) -> Floats:
        """The damping -Re(pole) / |pole| (n,), 0 for an integrator."""
        size = np.abs(self.poles)
        return np.asarray(-self.poles.real / np.where(size > 0, size, 1.0))

    def frequency_response(self, frequencies: ArrayLike) -> tuple[Complex, Floats, Floats]:
        """Return the response G (f,) at frequencies (f,) or at a single frequency [rad/s], and two standard deviations
        (f,).

        The standard deviations belong to the relative magnitude and to the phase [rad].
        """
        s = 1j * np.atleast_1d(_real("frequencies", frequencies))
        A = np.polyval(np.r_[1.0, self.a[::-1]], s)
        G = np.polyval(self.b[::-1], s) / A
        slopes = [-(s**i) * G / A for i in range(self.a.size)] + [s**j / A for j in range(self.b.size)]
        slopes += [-s * G] * self._late
        relative = np.array(slopes) / G
        parts_std = [np.sqrt(np.einsum("if,ij,jf->f", part, self.cov, part)) for part in (relative.real, relative.imag)]
        return G * np.exp(-s * self.delay), parts_std[0], parts_std[1]

    def step_response(self, t: ArrayLike) -> tuple[Floats, Floats]:
        """Return the response (k,) to a unit step and its standard deviation (k,) at evenly spaced t (k,) [s],
        starting at 0.
        """
        t = _real("t", t)
        steps = np.diff(t) if t.ndim == 1 else t
        if t.ndim != 1 or t.size < 2 or t[0] != 0 or not (steps[0] > 0 and np.allclose(steps, steps[0])):
            raise UsageError(
                "t of a step response must be evenly spaced and start at 0: give for example np.arange(100) * 0.1"
            )
        rate = max(float(np.max(np.abs(self.poles))), 1 / float(t[-1]))
        n, rows = self.a.size, np.arange(t.size)
        latest = self.delay * rate if self._late else None
        structure = Structure(n, self.b.size - 1, dead_time=self.delay * rate, latest=latest)
        stretch = RecordStretch(
            Grid(float(steps[0]), t.size), np.ones((1, t.size)), np.zeros(t.size), rows, rows, held=True
        )
        factors = structure.scale(rate)
        theta = np.r_[self.a, self.b, [self.delay] * self._late] / factors
        here, b = channels(structure, theta, stretch.scale_time(rate), twice=True), theta[n : n + self.b.size]
        single, double = here.single[:, 0], here.double[:, 0]
        slopes = [-(b @ double[i : i + b.size]) for i in range(n)] + list(single[: b.size])
        sensitivity = np.array(slopes + [-here.moving(b, 0)] * self._late)
        scaled_cov = self.cov / np.outer(factors, factors)
        std = np.sqrt(np.maximum(0.0, np.einsum("it,ij,jt->t", sensitivity, scaled_cov, sensitivity)))
        return b @ single[: b.size], std

    def to_scipy(self) -> signal.TransferFunction:
        """Return a `scipy.signal.TransferFunction`, which has no dead time. The caller must add the dead time."""
        from scipy.signal import TransferFunction

        return TransferFunction(self.b[::-1], np.r_[1.0, self.a[::-1]])

    def to_control(self) -> control.TransferFunction:
        """Return a `control.TransferFunction` of python-control without the dead time.

        Raises UsageError if python-control is not installed.
        """
        try:
            import control
        except ImportError:
            raise UsageError("python-control is not installed; pip install pmfid[control]") from None
        return control.TransferFunction(self.b[::-1], np.r_[1.0, self.a[::-1]])

    def __str__(self) -> str:
        top, bottom = polynomial(self.b), polynomial(np.r_[self.a, 1.0])
        dead = f"  exp(-{self.delay:g} s)" if self.delay else ""
        width = max(len(top), len(bottom))
        return (
            f"       {top.center(width).rstrip()}\nG(s) = {'-' * width}{dead}\n       {bottom.center(width).rstrip()}"
        )

    def __repr__(self) -> str:
        name, value, std, unit = self.slope
        rows = [str(self), "", f"{name} {with_bar(value, std)} {unit}".rstrip()]
        for pole, std, tau in zip(self.poles, self.poles_std, self.time_constants, strict=True):
            known = "pole 0, an integrator"
            rows.append(f"pole {root_with_bars(pole, std)} rad/s, time constant {tau:.4g} s" if pole else known)
        rows += [
            f"zero {root_with_bars(zero, std)} rad/s" for zero, std in zip(self.zeros, self.zeros_std, strict=True)
        ]
        return "\n".join(rows)

    @property
    def rows(self) -> list[list[str]]:
        """Return gain, poles, zeros and dead time as text, each with its standard deviation."""
        name, value, std, unit = self.slope
        rows = [[name, f"{value:.5g}", f"{std:.2g}", unit]]
        taus = zip(self.time_constants, self.time_constants_std, strict=True)
        for (pole, bar), (tau, tau_std) in zip(zip(self.poles, self.poles_std, strict=True), taus, strict=True):
            time = f"time constant {tau:.4g} ± {tau_std:.2g} s" if pole else "integrator"
            rows.append(["pole", number(pole), spread(*bar) if pole else "", time])
        for zero, bar in zip(self.zeros, self.zeros_std, strict=True):
            rows.append(["zero", number(zero), spread(*bar), ""])
        if self.delay:
            bar = f"{self.delay_std:.2g}" if self.delay_std else ""
            rows.append(["dead time", f"{self.delay:.4g} s", bar, ""])
        return rows

    def summary(self) -> Summary:
        top, bottom = polynomial(self.b), polynomial(np.r_[self.a, 1.0])
        dead = f" exp(-{self.delay:g} s)" if self.delay else ""
        return Summary(f"G(s) = ({top}) / ({bottom}){dead}", ("", "value", "std", ""), self.rows)

    def columns(self) -> dict[str, object]:
        """Return the columns of a table with one row for each pole and zero, with standard deviations [rad/s]."""
        roots, bars = np.r_[self.poles, self.zeros], np.r_[self.poles_std, self.zeros_std.reshape(-1, 2)]
        return {
            "root": ["pole"] * self.poles.size + ["zero"] * self.zeros.size,
            "real": roots.real,
            "imaginary": roots.imag,
            "real_std": bars[:, 0],
            "imaginary_std": bars[:, 1],
        }

    def to_dict(self) -> dict[str, object]:
        """Return the coefficients, starting with the constant, and poles and zeros as [real, imaginary] in rad/s."""
        name, value, std, unit = self.slope
        return plain_dict(
            {
                "a": self.a,
                "b": self.b,
                "dead_time": {"value": self.delay, "std": self.delay_std, "unit": "s"},
                name.replace(" ", "_"): {"value": value, "std": std, "unit": unit},
                "poles": self.poles,
                "zeros": self.zeros,
                "time_constants": self.time_constants,
                "damping": self.damping,
            }
        )

    def _repr_latex_(self) -> str:
        dead = rf"\,e^{{-{self.delay:g}s}}" if self.delay else ""
        top, bottom = (polynomial(part, "^{%d}") for part in (self.b, np.r_[self.a, 1.0]))
        return rf"$G(s) = \frac{{{top}}}{{{bottom}}}{dead}$"

    def _root_slope(self, coefficients: Floats, root: complex) -> Complex:
        """Return the derivatives (k,) of a root of sum c_i s^i with respect to all c_i, -s^i / C'(s)."""
        derivative = np.polyval(np.polyder(coefficients[::-1]), root)
        powers = root ** np.arange(coefficients.size)
        with np.errstate(all="ignore"):
            return np.asarray(-powers / derivative)

    def _root_std(self, coefficients: Floats, roots: Complex, part: slice) -> Floats:
        """Return the standard deviations (r, 2) of the roots.

        The coefficients move by two standard deviations in the direction that moves a root most. The standard deviation
        of the root is half of its motion. For distant poles, the result equals that of the delta method. For
        neighbouring poles, the delta method would give nothing or far too little.
        """
        cov = self.cov[part, part]
        found = np.full((roots.size, 2), np.inf)
        for row, root in zip(found, roots, strict=True):
            slope = self._root_slope(coefficients, root)[: cov.shape[0]]
            moved = [self._move_root(coefficients, root, g, cov) for g in (slope.real, slope.imag)]
            if np.all(np.isfinite(slope)) and np.all(np.isfinite(moved)):
                row[:] = np.max(moved, axis=0)
        return found

    def _move_root(self, coefficients: Floats, root: complex, slope: Floats, cov: Floats) -> Floats:
        """Return the standard deviations (2,) of the real and imaginary part of a root in the direction cov slope."""
        with np.errstate(all="ignore"):
            linear = _deviation(slope, cov)
            step = np.zeros(coefficients.size)
            step[: cov.shape[0]] = TUNING.process_interval * (cov @ slope) / linear if linear > 0 else 0.0
        if not np.all(np.isfinite([*step, linear])):
            return np.full(2, np.inf)
        moved = [_roots(coefficients + sign * step) - root for sign in (1.0, -1.0)]
        ends = [one[np.argmin(np.abs(one))] if one.size else complex(np.inf) for one in moved]
        return np.asarray(np.max(np.abs([[end.real, end.imag] for end in ends]), axis=0) / TUNING.process_interval)


def _deviation(slope: Floats, cov: Floats) -> float:
    """Return the standard deviation of slope @ parameters, or infinity if rounding leaves a negative variance."""
    variance = float(slope @ cov @ slope)
    return variance**0.5 if variance >= 0 else float("inf")


def _real(name: str, values: ArrayLike) -> Floats:
    try:
        return np.asarray(values, float)
    except (TypeError, ValueError):
        raise UsageError(f"{name} must be real numbers, got {values!r}") from None


def _roots(coefficients: Floats) -> Complex:
    """Return the roots, slowest first, where the root with the positive imaginary part comes first in a pair."""
    found = [complex(root) for root in np.roots(coefficients[::-1])]
    return np.array(sorted(found, key=lambda root: (round(abs(root), 12), root.real, -root.imag)), np.complex128)
