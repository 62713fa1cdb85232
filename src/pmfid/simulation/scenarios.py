"""Named runs of the cart, changes of its parameters, and their files."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import TypedDict

import numpy as np

from pmfid.simulation.drive import DriveParameters, Motion, Schedule, position_control, simulate_drive
from pmfid.simulation.encoder import NO_FAULTS, Faults, check_number, check_whole, quantize
from pmfid.simulation.signals import multisine, prbs, random_moves, steps, stop_and_go
from pmfid.types import Counts, Floats


def change_parameters(parameters: DriveParameters, at: float, ramp: float = 0.0, **changes: float) -> Schedule:
    """Return a schedule in which parameters change, at once or along a ramp.

    Examples are a load that is put down, a container that fills, a dry guide and a slipping belt. If the input gain
    falls, an estimator with the old gain finds every parameter larger by the ratio of old to new gain.

    Parameters
    ----------
    parameters
        Parameters before the change.
    at
        Start of the change [s], > 0.
    ramp
        Duration of the change [s], >= 0.
    changes
        New values by name.

    Raises
    ------
    ValueError
        If an argument is out of range.
    TypeError
        If a drive has no parameter with the given name.

    Examples
    --------
    >>> from pmfid.simulation import CART, change_parameters
    >>> mass, *others = change_parameters(CART, at=10.0, ramp=4.0, mass=1.47).sample([9.0, 12.0, 15.0], dt=0.01)
    >>> mass.round(3).tolist()
    [1.07, 1.27, 1.47]
    """
    return Schedule(((0.0, parameters), (at, replace(parameters, **changes))), (0.0, ramp))


class ControlGains(TypedDict):
    """The gains of `position_control`: kp [V/m], kd [V s/m] and the largest input [V]."""

    kp: float
    kd: float
    u_max: float


CART = DriveParameters(mass=1.07, viscous_friction=12.8, coulomb_friction=0.8, input_gain=2.0)
CART_LOADED = replace(CART, mass=1.44)
CART_DT = 0.01
CART_INCREMENTS = 4096
CART_RESOLUTION = 22.75e-6
#: Gains of the cart's PD position control on the bench [V/m, V s/m], and the largest input [V].
CART_CONTROL: ControlGains = {"kp": 200.0, "kd": 5.0, "u_max": 6.0}
STROKE, MOVE_TIME, DWELL_TIME = 0.2, 0.8, 0.5
#: Frequencies of the multisine [Hz].
TONES = (0.2, 0.5, 0.9, 1.4, 2.1, 3.0, 4.3, 6.2)

Signal = Callable[[int, np.random.Generator], Floats]


def _rest_in_the_middle(samples: int, rng: np.random.Generator) -> Floats:
    moving = stop_and_go(samples, CART_DT, STROKE, MOVE_TIME, DWELL_TIME)
    cycle = round((MOVE_TIME + DWELL_TIME) / CART_DT)
    # The time runs from the end of a dwell to the start of a move at the same place, so the reference does not jump.
    begin, end = (2 * cycle * (part * samples // (8 * cycle)) for part in (1, 3))
    moving[begin:end] = 0.0
    return moving


#: Functions from the number of samples and the random generator to the open-loop input u [V].
INPUTS: Mapping[str, Signal] = MappingProxyType(
    {
        "prbs": lambda n, rng: prbs(n, clock=10, amplitude=3.0, rng=rng),
        "multisine": lambda n, rng: multisine(n, CART_DT, TONES, 6.0, rng),
    }
)
#: Functions from the number of samples and the random generator to the closed-loop position reference [m].
REFERENCES: Mapping[str, Signal] = MappingProxyType(
    {
        "stop-and-go": lambda n, rng: stop_and_go(n, CART_DT, STROKE, MOVE_TIME, DWELL_TIME),
        "trapezoid": lambda n, rng: stop_and_go(n, CART_DT, STROKE, MOVE_TIME, DWELL_TIME, "trapezoid"),
        "moves": lambda n, rng: random_moves(n, CART_DT, 2 * STROKE, MOVE_TIME, DWELL_TIME, rng),
        "steps": lambda n, rng: steps(n, CART_DT, STROKE / 2, 1.0),
        "prbs-reference": lambda n, rng: prbs(n, clock=40, amplitude=STROKE / 8, rng=rng),
        "multisine-reference": lambda n, rng: multisine(n, CART_DT, TONES[:5], STROKE / 4, rng),
        "standstill": _rest_in_the_middle,
    }
)
_WORN = {"viscous_friction": 1.5 * CART.viscous_friction, "coulomb_friction": 1.5 * CART.coulomb_friction}
#: Functions from the duration of the run [s] to the schedule of the parameters.
CHANGES: Mapping[str, Callable[[float], Schedule]] = MappingProxyType(
    {
        "constant": lambda duration: Schedule(((0.0, CART),)),
        "mass-step": lambda duration: change_parameters(CART, duration / 2.0, mass=CART_LOADED.mass),
        "mass-ramp": lambda duration: change_parameters(CART, duration / 3.0, duration / 3.0, mass=CART_LOADED.mass),
        "friction-growth": lambda duration: change_parameters(CART, duration / 3.0, duration / 3.0, **_WORN),
        "slipping-belt": lambda duration: change_parameters(CART, duration / 2.0, input_gain=0.8 * CART.input_gain),
    }
)


@dataclass(frozen=True)
class Recipe:
    """The definition of a scenario: a signal of INPUTS or REFERENCES, and a change of CHANGES."""

    summary: str
    signal: str
    change: str = "constant"

    @property
    def closed_loop(self) -> bool:
        """Whether the cart is under position control through the encoder."""
        return self.signal in REFERENCES


_STEP, _RAMP = "mass 1.07 to 1.44 kg half-way", "mass 1.07 to 1.44 kg over the middle third"
_GROWTH, _SLIP = "friction grows by half over the middle third", "input gain 2.0 to 1.6 N/V half-way"

SCENARIOS: Mapping[str, Recipe] = MappingProxyType(
    {
        "prbs": Recipe("random binary input of 3 V", "prbs"),
        "mass-step": Recipe(f"random binary input of 3 V, {_STEP}", "prbs", "mass-step"),
        "friction-growth": Recipe(f"random binary input of 3 V, {_GROWTH}", "prbs", "friction-growth"),
        "multisine": Recipe("sum of eight sines, 0.2 to 6.2 Hz, 6 V", "multisine"),
        "stop-and-go": Recipe("position control, moves of 0.2 m and dwells", "stop-and-go"),
        "stop-and-go-mass-step": Recipe(f"stop-and-go, {_STEP}", "stop-and-go", "mass-step"),
        "stop-and-go-mass-ramp": Recipe(f"stop-and-go, {_RAMP}", "stop-and-go", "mass-ramp"),
        "stop-and-go-friction-growth": Recipe(f"stop-and-go, {_GROWTH}", "stop-and-go", "friction-growth"),
        "stop-and-go-slipping-belt": Recipe(f"stop-and-go, {_SLIP}", "stop-and-go", "slipping-belt"),
        "trapezoid": Recipe("position control, moves of constant acceleration and dwells", "trapezoid"),
        "moves": Recipe("position control, moves between random places, random dwells", "moves"),
        "moves-mass-step": Recipe(f"random moves, {_STEP}", "moves", "mass-step"),
        "steps": Recipe("position control, steps of 0.1 m: the input saturates", "steps"),
        "prbs-reference": Recipe("position control, random binary reference of 25 mm", "prbs-reference"),
        "multisine-reference": Recipe("position control, reference of five sines", "multisine-reference"),
        "standstill": Recipe("stop-and-go, at rest for the second and third quarter", "standstill"),
    }
)


@dataclass(frozen=True, eq=False)
class Scenario:
    """A simulated run and its true motion and parameters.

    Attributes
    ----------
    name
        Key of `SCENARIOS`.
    motion
        True motion, (n,) each.
    counts
        (n,) counts of the encoder.
    resolution
        Travel per count [m].
    dt
        Sample period [s].
    schedule
        Parameters over time.
    bits
        Width of the counter register in bits; None for a counter that does not wrap.

    Examples
    --------
    >>> from pmfid.simulation import make_scenario
    >>> run = make_scenario("mass-step", duration=10.0)
    >>> run.name, run.dt, run.counts.shape
    ('mass-step', 0.01, (1000,))
    >>> [(time, parameters.mass) for time, parameters in run.schedule.changes]
    [(0.0, 1.07), (5.0, 1.44)]
    """

    name: str
    motion: Motion
    counts: Counts
    resolution: float
    dt: float
    schedule: Schedule
    bits: int | None = None


def resolution_of(increments: int) -> float:
    """Return the travel per count of the cart [m] for an encoder.

    Parameters
    ----------
    increments
        Counts per turn, >= 1.

    Raises
    ------
    ValueError
        If `increments` is not a whole number or is less than 1.

    Examples
    --------
    >>> from pmfid.simulation import resolution_of
    >>> resolution_of(4096), resolution_of(1024)
    (2.275e-05, 9.1e-05)
    """
    check_whole("increments", increments, 1, np.inf, "give the counts per turn of the encoder")
    return CART_RESOLUTION * CART_INCREMENTS / increments


def make_scenario(
    name: str,
    *,
    seed: int = 0,
    increments: int = CART_INCREMENTS,
    duration: float = 30.0,
    bits: int | None = None,
    faults: Faults = NO_FAULTS,
    schedule: Schedule | None = None,
) -> Scenario:
    """Return a named scenario: a simulated run of the cart, with its true motion and parameters.

    The seed draws the start phase on the encoder lattice and the random signals. An input does not depend on
    `increments`.

    Parameters
    ----------
    name
        Key of `SCENARIOS`.
    seed
        Seed of the run, >= 0.
    increments
        Counts of the encoder per turn, >= 1.
    duration
        Length of the run [s].
    bits
        Width of a counter that wraps, in bits; None for a counter that does not wrap.
    faults
        Faults of the encoder.
    schedule
        Parameters over time, which replace the parameters of the scenario.

    Raises
    ------
    ValueError
        If the name is unknown or a value is out of range.

    Examples
    --------
    >>> import pmfid
    >>> from pmfid.simulation import CART, make_scenario
    >>> run = make_scenario("stop-and-go", seed=1, duration=20.0)
    >>> ls = pmfid.LS(pmfid.Drive(CART.input_gain), pmfid.Encoder(run.resolution), run.dt, 20.0)
    >>> fit = ls.fit(run.motion.u, run.counts)
    >>> round(fit["mass"], 2)
    1.07
    """
    if name not in SCENARIOS:
        raise ValueError(f"unknown scenario {name!r}; choose one of: {', '.join(SCENARIOS)}")
    check_whole("seed", seed, 0, np.inf, "give any whole number of at least 0")
    check_number("duration", duration, above=CART_DT, remedy="give the length of the run in seconds")
    recipe, rng, samples = SCENARIOS[name], np.random.default_rng(seed), round(duration / CART_DT)
    resolution = resolution_of(increments)
    phase = resolution * rng.random()
    parameters = CHANGES[recipe.change](duration) if schedule is None else schedule
    if recipe.closed_loop:
        reference = REFERENCES[recipe.signal](samples, rng)
        lattice = {"resolution": resolution, "phase": phase}
        motion, counts = position_control(
            parameters, reference, CART_DT, **CART_CONTROL, **lattice, bits=bits, faults=faults
        )
    else:
        motion = simulate_drive(parameters, INPUTS[recipe.signal](samples, rng), CART_DT)
        counts = quantize(motion.x, resolution, phase, bits, faults)
    return Scenario(name, motion, counts, resolution, CART_DT, parameters, bits)


_AXIS = """\
# {name}: {summary}.

[record]
input = "u"             # V
output = "counts"
output_kind = "counts"
time = "t"              # s

[encoder]
resolution = {resolution!r}  # m per count
{bits}
[model]
kind = "drive"
input_gain = {input_gain!r}        # N per V

[estimator]
method = "auto"
cutoff = {cutoff:.6g}        # rad/s: a filter time constant of three samples
forgetting = {forgetting!r}{memory}
"""
#: Forgetting factor for a changing parameter: a memory of two seconds.
FORGETTING = 0.995


def axis_toml(scenario: Scenario) -> str:
    """Return an AXIS.toml for the record of a scenario.

    The forgetting factor is below 1 if the parameters change.

    Parameters
    ----------
    scenario
        A simulated run.

    Examples
    --------
    >>> import tomllib
    >>> from pmfid.simulation import axis_toml, make_scenario
    >>> axis = tomllib.loads(axis_toml(make_scenario("mass-step", duration=10.0)))
    >>> axis["model"], axis["estimator"]["forgetting"]
    ({'kind': 'drive', 'input_gain': 2.0}, 0.995)
    """
    recipe, bits = SCENARIOS[scenario.name], scenario.bits
    changes = len(scenario.schedule.changes) > 1
    return _AXIS.format(
        name=scenario.name,
        summary=recipe.summary,
        resolution=scenario.resolution,
        bits="" if bits is None else f"bits = {bits}               # the counter wraps at 2**bits\n",
        input_gain=CART.input_gain,
        cutoff=1 / (3 * scenario.dt),
        forgetting=FORGETTING if changes else 1.0,
        memory=f"      # memory of {scenario.dt / (1 - FORGETTING):g} s" if changes else "        # never",
    )


def write_csv(scenario: Scenario, path: str | Path, truth: bool = False) -> None:
    """Write the record of a scenario: columns t [s], u [V] and counts.

    A reader of the file gets the same bits of each float. Lines end in a line feed.

    Parameters
    ----------
    scenario
        A simulated run.
    path
        The file.
    truth
        Also write x [m], v [m/s], mass, viscous_friction, coulomb_friction, input_gain and offset at every sample.

    Raises
    ------
    OSError
        If the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from pmfid.simulation import make_scenario, write_csv
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_csv(make_scenario("prbs", duration=1.0), Path(folder) / "run.csv")
    ...     lines = (Path(folder) / "run.csv").read_text().splitlines()
    >>> lines[0], len(lines)
    ('t,u,counts', 101)
    """
    motion, names = scenario.motion, ["t", "u", "counts"]
    columns = [motion.t, motion.u, scenario.counts]
    if truth:
        names += ["x", "v", "mass", "viscous_friction", "coulomb_friction", "input_gain", "offset"]
        columns += [motion.x, motion.v, *scenario.schedule.sample(motion.t, scenario.dt)]
    with open(path, "w", encoding="ascii", newline="\n") as file:
        file.write(",".join(names) + "\n")
        for row in zip(*(np.asarray(column).tolist() for column in columns), strict=True):
            file.write(",".join(map(repr, row)) + "\n")
