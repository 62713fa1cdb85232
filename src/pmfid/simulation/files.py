"""A simulated run as the files that identification reads."""

from pathlib import Path

import numpy as np

from pmfid.simulation.scenarios import CART, SCENARIOS, Scenario

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
#: Forgetting where a parameter changes; a memory of two seconds.
FORGETTING = 0.995


def axis_toml(scenario: Scenario) -> str:
    """The AXIS.toml that goes with the record of a scenario; it forgets where the scenario changes."""
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
    """Write the columns t [s], u [V], counts; floats read back to the same bits, lines end in a line feed.

    truth: also x [m], v [m/s], mass, viscous_friction, coulomb_friction, input_gain and offset at every sample.
    Raises OSError if the file can't be written.
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
