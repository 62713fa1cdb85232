"""The exactly simulated laboratory drive. The simulation knows the true parameters, so no lower package may import this
package."""

from pmfid.simulation.drive import (
    DriveParameters,
    Machine,
    Motion,
    Schedule,
    control_machine,
    drive_machine,
    position_control,
    simulate_drive,
)
from pmfid.simulation.edges import capture_edges
from pmfid.simulation.encoder import Faults, quantize
from pmfid.simulation.scenarios import (
    CART,
    CART_CONTROL,
    CART_DT,
    CART_INCREMENTS,
    CART_LOADED,
    CART_RESOLUTION,
    SCENARIOS,
    Scenario,
    axis_toml,
    change_parameters,
    make_scenario,
    resolution_of,
    write_csv,
)
from pmfid.simulation.signals import mls, multisine, prbs, random_moves, s_curve, steps, stop_and_go, trapezoid

__all__ = [
    "CART",
    "CART_CONTROL",
    "CART_DT",
    "CART_INCREMENTS",
    "CART_LOADED",
    "CART_RESOLUTION",
    "SCENARIOS",
    "DriveParameters",
    "Faults",
    "Machine",
    "Motion",
    "Scenario",
    "Schedule",
    "axis_toml",
    "capture_edges",
    "change_parameters",
    "control_machine",
    "drive_machine",
    "make_scenario",
    "mls",
    "multisine",
    "position_control",
    "prbs",
    "quantize",
    "random_moves",
    "resolution_of",
    "s_curve",
    "simulate_drive",
    "steps",
    "stop_and_go",
    "trapezoid",
    "write_csv",
]
