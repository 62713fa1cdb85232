"""How numbers of a transfer function are written."""

from __future__ import annotations

from pmfid.types import Floats


def number(value: complex) -> str:
    """A pole or a zero."""
    if value.imag == 0:
        return f"{value.real:.4g}"
    return f"{value.real:.4g} {'+' if value.imag > 0 else '-'} {abs(value.imag):.4g} j"


def spread(real: float, imaginary: float) -> str:
    """Standard deviations of real and imaginary part."""
    return f"{real:.2g}" if imaginary == 0 else f"{real:.2g}, {imaginary:.2g} j"


def polynomial(coefficients: Floats, power: str = "^%d") -> str:
    """Text of sum c_i s^i, highest power first."""
    parts: list[str] = []
    for i in range(coefficients.size - 1, -1, -1):
        value = float(coefficients[i])
        size = "" if i and abs(value) == 1 else f"{abs(value):.5g}"
        symbol = "" if i == 0 else "s" if i == 1 else "s" + power % i
        sign = ("-" if value < 0 else "") if not parts else (" - " if value < 0 else " + ")
        parts.append(f"{sign}{size}{' ' if size and symbol else ''}{symbol}")
    return "".join(parts)


def with_bar(value: float, std: float) -> str:
    """A number and its standard deviation."""
    return f"{value:.5g} ± {std:.2g}"


def root_with_bars(value: complex, std: Floats) -> str:
    """A pole or a zero and the standard deviations (2,) of its parts."""
    if value.imag == 0:
        return with_bar(value.real, float(std[0]))
    sign = "+" if value.imag > 0 else "-"
    return f"{value.real:.5g} ± {std[0]:.2g} {sign} j ({abs(value.imag):.5g} ± {std[1]:.2g})"
