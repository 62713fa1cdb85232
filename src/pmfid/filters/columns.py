"""Columns of an equation as stages and taps of the network that the kernel runs."""

from __future__ import annotations

from dataclasses import dataclass

from pmfid.elementary import tanh
from pmfid.errors import UsageError
from pmfid.filters.chain import (
    HOLD_FILTERS,
    chain,
    correct_turns,
    correct_uneven_velocity,
    derivative,
    differentiating_lag,
    hold_exact,
    lag,
    matched_input,
    mean_velocity_correction,
)
from pmfid.filters.network import (
    ACCELERATION,
    AUXILIARY,
    BACKWARD,
    BACKWARD_VELOCITY,
    DIRECTION,
    FORWARD,
    FORWARD_VELOCITY,
    INPUT,
    LATE_INPUT,
    LATE_POSITION,
    MISREAD_DIRECTION,
    MISREAD_INPUT,
    MISREAD_MOVING,
    MODEL_POSITION,
    MOVING,
    ONE,
    POSITION,
    SPLIT_BACKWARD,
    SPLIT_FORWARD,
    SPLIT_POSITION,
    START,
    TURN,
    VELOCITY,
    Network,
    Taps,
    scale_taps,
)
from pmfid.models.equation import Equation, Term

#: Nodes of the signals that are constant during a sampling interval, in the block from the counts.
HELD = {"input": INPUT, "direction": DIRECTION, "moving": MOVING, "forward": FORWARD, "backward": BACKWARD}
#: Error of each held signal from misread counts, as taps.
MISREAD: dict[str, Taps] = {
    "input": [(MISREAD_INPUT, 1.0)],
    "direction": [(MISREAD_DIRECTION, 1.0)],
    "moving": [(MISREAD_MOVING, 1.0)],
    "forward": [(MISREAD_DIRECTION, 0.5), (MISREAD_MOVING, 0.5)],
    "backward": [(MISREAD_DIRECTION, 0.5), (MISREAD_MOVING, -0.5)],
}
#: Weight of a reversal in each signal.
TURNS = {"direction": 1.0, "forward": 0.5, "backward": 0.5}
#: Nodes of the velocity in one direction, in the block from the counts.
SPLIT = {"forward_output": FORWARD_VELOCITY, "backward_output": BACKWARD_VELOCITY}
#: Nodes of the measured velocity, split by the direction of the auxiliary model.
SPLIT_BY_MODEL = {"forward_output": SPLIT_FORWARD, "backward_output": SPLIT_BACKWARD}
#: Nodes of the position times a moving fraction. "measured" takes both from the counts. "modelled" takes the moving
#: fraction from the auxiliary model. "simulated" takes both from the auxiliary model.
POSITIONS = {"measured": POSITION, "modelled": SPLIT_POSITION, "simulated": MODEL_POSITION}


@dataclass(frozen=True)
class FilterSpec:
    """Settings of the filters.

    `cutoff` is the pole of the chain [rad/s], > 0 (paper eq. 9), and `order` the number of its stages, at least the
    order of the equation. `dt` is the sample period [s]; if `uneven` is True, the step varies and `dt` is its mean.
    `discretization` is a key of `HOLD_FILTERS`. `prefilter_zeros` are the zeros of f(s) [rad/s], < 0, one for each
    noisy column (paper eq. 19), or empty.
    """

    cutoff: float
    order: int
    dt: float
    discretization: str
    prefilter_zeros: tuple[float, ...] = ()
    uneven: bool = False


class ColumnBuilder:
    """Builder that adds the columns of an equation to a network.

    The source of a column is "measured", "modelled" or "simulated". A measured column takes output and direction from
    the counts. A modelled column takes the direction from the auxiliary model, and a simulated column the output as
    well. The instrument of a modelled regressor is the same column as a simulated one.
    """

    def __init__(self, equation: Equation, spec: FilterSpec, network: Network | None = None) -> None:
        self.equation, self.spec = equation, spec
        #: with an auxiliary model, the kernel corrects all errors of the discretisation at once
        self.modelled = network is not None
        self.network = Network() if network is None else network

    def regressors(self, source: str = "measured") -> list[Taps]:
        return [self.coefficient(term, source) for term in self.equation.unknown]

    def target(self, source: str = "measured") -> Taps:
        return self._sum(self.equation.known, source)

    def _sum(self, terms: tuple[Term, ...], source: str) -> Taps:
        taps: Taps = []
        for term in terms:
            taps += self.coefficient(term, source)
        return taps

    def misread(self) -> tuple[list[int], list[Taps]]:
        """Return the parameters whose regressors depend on the direction, and the errors of these regressors and of the
        target from misread counts.
        """
        errors = [self._misread((term,)) for term in self.equation.unknown]
        parameters = [i for i, taps in enumerate(errors) if taps]
        target = self._misread(self.equation.known) or [(MISREAD_INPUT, 0.0)]  # the kernel's columns have a tap
        return parameters, [*(errors[i] for i in parameters), target]

    def _misread(self, terms: tuple[Term, ...]) -> Taps:
        return [
            (node, term.coefficient * part * weight)
            for term in terms
            if term.signal in MISREAD and term.derivative == 0 and term.shape is None
            for signal, part in MISREAD[term.signal]
            for node, weight in self._hold(signal)
        ]

    def instruments(self) -> list[Taps]:
        """Return the regressors, with the filtered input after 1/f(s) in place of the noisy ones."""
        columns = self.regressors()
        for column, power in zip(self.equation.noisy, self.equation.instrument_powers, strict=True):
            columns[column] = self.prefilter_input(power)
        return columns

    def prefilter_input(self, j: int) -> Taps:
        """Return the taps of s^j / f(s) for the filtered input and the other known terms.

        The filter is a series of j differentiating lags and n - j lags. With f(s) = prod (1 - s / zero), the lag's pole
        in the trapezoidal rule is the Tustin image of the zero. Its pole in z is therefore exp(zero dt) (paper eq. 36),
        and the relation between the columns is exact in discrete time.
        """
        taps = self._sum(self.equation.driving, "measured")
        poles = [tustin_image(-zero, self.spec.dt) for zero in self.spec.prefilter_zeros]
        for i, pole in enumerate(reversed(poles)):
            build = lag if i < len(poles) - j else differentiating_lag
            taps = [(build(self.network, node, pole, self.spec.dt), weight) for node, weight in taps]
        return taps

    def coefficient(self, term: Term, source: str) -> Taps:
        """Return the taps of the term's filtered derivative times its coefficient."""
        return scale_taps(self.term(term, source), term.coefficient)

    def term(self, term: Term, source: str) -> Taps:
        """Return the taps of the term's filtered derivative, with a delay of one sample."""
        if term.facts.of_process:
            return self.process(term)
        if term.shape is not None:
            if source == "measured" and term.shape.of_speed:
                raise UsageError(f"the counts alone do not give the speed for {term.name}; use iv or riv")
            return self._hold(self.network.slot((source == "measured", *term.place)))
        block = 0 if source == "measured" else AUXILIARY
        if term.signal in HELD:
            return self._hold(HELD[term.signal] + block) + self._turns(term, source)
        if term.signal in SPLIT:
            by_model = source == "modelled"
            return self._hold(SPLIT_BY_MODEL[term.signal] if by_model else SPLIT[term.signal] + block)
        if term.derivative == 0:
            return self._hold(POSITIONS[source])
        return self.velocity(term.derivative - 1, simulated=source == "simulated")

    def _turns(self, term: Term, source: str) -> Taps:
        """Return the taps by which reversals inside an uneven interval change the term's direction."""
        spec, part = self.spec, TURNS.get(term.signal)
        if part is None or source != "measured" or self.modelled or not spec.uneven or spec.discretization != "matched":
            return []
        return scale_taps(correct_turns(self.network, TURN, spec.cutoff, spec.order, spec.dt), part)

    def process(self, term: Term) -> Taps:
        """Return the taps of the filtered derivative of a process's term, without moving fractions."""
        if term.signal == "process_input":
            return self.process_input(term.derivative)
        if term.signal == "constant":
            return self._hold(ONE)
        if term.signal == "start":
            return scale_taps(self._derivative(START, term.derivative), 1 / self.spec.dt)
        return self.process_output(term.derivative)

    def process_output(self, i: int) -> Taps:
        """Return the taps of the i-th derivative of the filtered output, minus c = (n - i) / 12 times its second
        difference.

        To second order, the trapezoidal s_T is s (1 - dt^2 s^2 / 12), and M_k / M_(k-1) is 1 - dt^2 s_T^2 / 12 for k >
        2. Relative to y^(n), every lower derivative has one more such factor, like `mean_velocity_correction` for a
        drive. With M_(n-j) on u^(j), the error is of fourth order in dt for a relative degree of 2 or more. A relative
        degree of 1 has no such factor, because M_2 = M_1.
        """
        equation, delay = self.equation, self.network.delay
        c = (equation.order - i) / 12 if self._corrected else 0.0
        taps: Taps = []
        if i == 0:  # the second difference of mean positions is the difference of mean velocities two samples apart
            for node, weight in self._derivative(VELOCITY, 0) if c else []:
                ends = c * self.spec.dt / 2 * weight
                taps += [(node, -ends), (delay(delay(node)), ends)]
            return taps + self._derivative(LATE_POSITION, 0)
        for node, weight in self._derivative(VELOCITY, i - 1):
            taps.append((delay(node), (1 + 2 * c) * weight))
            if c:
                taps += [(node, -c * weight), (delay(delay(node)), -c * weight)]
        return taps

    @property
    def _corrected(self) -> bool:
        return self.spec.discretization == "matched" and self.equation.relative_degree > 1

    def input_node(self) -> int:
        """Return the node of a process's held input after the dead time."""
        node = LATE_INPUT
        for _ in range(self.equation.delay):
            node = self.network.delay(node)
        return node

    def process_input(self, j: int) -> Taps:
        """Return the taps of the j-th derivative of the filtered and delayed input."""
        spec, source = self.spec, self.input_node()
        r = self.equation.order - j if self._corrected else self.equation.relative_degree
        if spec.discretization == "matched":
            nodes = matched_input(self.network, source, spec.cutoff, spec.order, spec.dt, r)
            return derivative(nodes, j, spec.cutoff)
        return hold_exact(self.network, source, spec.cutoff, spec.order, spec.dt, j)

    def _derivative(self, source: int, j: int) -> Taps:
        spec = self.spec
        return derivative(chain(self.network, source, spec.cutoff, spec.order, spec.dt), j, spec.cutoff)

    def velocity(self, j: int, *, simulated: bool) -> Taps:
        """Return the taps of the j-th derivative of the filtered velocity, from the counts or the auxiliary model."""
        spec = self.spec
        source = VELOCITY + (AUXILIARY if simulated else 0)
        nodes = chain(self.network, source, spec.cutoff, spec.order, spec.dt)
        taps = derivative(nodes, j, spec.cutoff)
        if simulated:  # the simulated velocity already has the delay
            return taps
        if j == self.equation.order - 2 and spec.discretization == "matched" and not self.modelled:
            if spec.uneven:
                return correct_uneven_velocity(self.network, nodes, spec.cutoff, spec.dt)
            return mean_velocity_correction(self.network, taps[0][0])
        return [(self.network.delay(node), weight) for node, weight in taps]

    def model_acceleration(self) -> Taps:
        """Return the taps of the auxiliary model's filtered mean acceleration, without approximation."""
        return self._hold(ACCELERATION)

    def _hold(self, source: int) -> Taps:
        spec = self.spec
        return HOLD_FILTERS[spec.discretization](self.network, source, spec.cutoff, spec.order, spec.dt)


def tustin_image(pole: float, dt: float) -> float:
    """Return the pole (2/dt) tanh(pole dt / 2): its trapezoidal discretisation is exp(-pole dt) (paper eq. 35, 36)."""
    return (2 / dt) * tanh(pole * dt / 2)
