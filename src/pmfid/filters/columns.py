"""From an equation to the stages and columns that the kernel runs."""

from __future__ import annotations

from dataclasses import dataclass
from math import tanh

from pmfid.filters.chain import (
    HOLD_FILTERS,
    chain,
    derivative,
    differentiating_lag,
    lag,
    mean_velocity_correction,
)
from pmfid.filters.network import DIRECTION, INPUT, MOVING, VELOCITY, Network, Taps, scaled
from pmfid.models.equation import Equation, Term

HELD_SIGNALS = {"input": INPUT, "direction": DIRECTION, "moving": MOVING}


@dataclass(frozen=True)
class FilterSpec:
    """cutoff: pole of the chain [rad/s], > 0 (paper eq. 9); order: stages, >= the equation's order;
    dt: sample period [s]; discretization: a key of `HOLD_FILTERS`; prefilter_zeros: zeros of f(s) [rad/s], < 0,
    one for each noisy column (paper eq. 19), or empty."""

    cutoff: float
    order: int
    dt: float
    discretization: str
    prefilter_zeros: tuple[float, ...] = ()


class ColumnBuilder:
    """Builds the columns of an equation. `columns` order: regressors, target, instruments if asked for."""

    def __init__(self, equation: Equation, spec: FilterSpec) -> None:
        self.equation, self.spec, self.network = equation, spec, Network()
        self._velocity = chain(self.network, VELOCITY, spec.cutoff, spec.order, spec.dt)

    def term(self, term: Term) -> Taps:
        """The filtered derivative that the term stands for, one sample late."""
        if term.signal == "output":
            return self._output(term.derivative)
        return self._held(HELD_SIGNALS[term.signal])

    def regressors(self) -> list[Taps]:
        return [self.term(term) for term in self.equation.unknown]

    def target(self) -> Taps:
        taps: Taps = []
        for term in self.equation.known:
            taps += scaled(self.term(term), term.coefficient)
        return taps

    def instruments(self) -> list[Taps]:
        """Regressors, with the filtered input behind 1/f(s) in place of the noisy ones."""
        columns = self.regressors()
        for j, column in enumerate(self.equation.noisy):
            columns[column] = self.prefiltered(len(self.equation.noisy) - j)
        return columns

    def prefiltered(self, j: int) -> Taps:
        """s^j / f(s) of the filtered target input; j differentiating lags and n - j lags, in series.

        f(s) = prod (1 - s / zero): the lag's pole in the trapezoidal rule is the zero's Tustin image, so that its pole
        in z is exp(zero dt) (paper eq. 36), and the relation between the columns is exact in discrete time.
        """
        taps = self.target()
        poles = [tustin_image(-zero, self.spec.dt) for zero in self.spec.prefilter_zeros]
        for i, pole in enumerate(reversed(poles)):
            build = lag if i < len(poles) - j else differentiating_lag
            taps = [(build(self.network, node, pole, self.spec.dt), weight) for node, weight in taps]
        return taps

    def _held(self, source: int) -> Taps:
        spec = self.spec
        return HOLD_FILTERS[spec.discretization](self.network, source, spec.cutoff, spec.order, spec.dt)

    def _output(self, order: int) -> Taps:
        late = [
            (self.network.delay(node), weight)
            for node, weight in derivative(self._velocity, order - 1, self.spec.cutoff)
        ]
        if order == self.equation.order - 1 and self.spec.discretization == "matched":
            return mean_velocity_correction(self.network, self._velocity[-1])
        return late


def tustin_image(pole: float, dt: float) -> float:
    """(2/dt) tanh(pole dt / 2): the pole whose trapezoidal discretisation is exp(-pole dt) (paper eq. 35, 36)."""
    return (2 / dt) * tanh(pole * dt / 2)
