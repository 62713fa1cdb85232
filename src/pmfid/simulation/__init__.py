"""The laboratory drive, simulated exactly; it knows the truth, so nothing below this room may import it."""

from pmfid.simulation.changes import friction_growth, mass_ramp, mass_step, slipping_belt
from pmfid.simulation.control import position_control
from pmfid.simulation.drive import DriveParameters, Motion, Schedule, simulate_drive
from pmfid.simulation.encoder import NO_FAULTS, Faults, quantize
from pmfid.simulation.files import axis_toml, write_csv
from pmfid.simulation.machine import Machine, control_machine, drive_machine
from pmfid.simulation.scenarios import (
    CART,
    CART_CONTROL,
    CART_DT,
    CART_INCREMENTS,
    CART_LOADED,
    CART_RESOLUTION,
    SCENARIOS,
    Scenario,
    make_scenario,
    resolution_of,
)
from pmfid.simulation.signals import mls, multisine, prbs, random_moves, s_curve, steps, stop_and_go, trapezoid

__all__ = [
    "CART",
    "CART_CONTROL",
    "CART_DT",
    "CART_INCREMENTS",
    "CART_LOADED",
    "CART_RESOLUTION",
    "NO_FAULTS",
    "SCENARIOS",
    "DriveParameters",
    "Faults",
    "Machine",
    "Motion",
    "Scenario",
    "Schedule",
    "axis_toml",
    "control_machine",
    "drive_machine",
    "friction_growth",
    "make_scenario",
    "mass_ramp",
    "mass_step",
    "mls",
    "multisine",
    "position_control",
    "prbs",
    "quantize",
    "random_moves",
    "resolution_of",
    "s_curve",
    "simulate_drive",
    "slipping_belt",
    "steps",
    "stop_and_go",
    "trapezoid",
    "write_csv",
]
