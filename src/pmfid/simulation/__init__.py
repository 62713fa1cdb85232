"""The laboratory drive, simulated exactly; it knows the truth, so nothing below this room may import it."""

from pmfid.simulation.control import position_control
from pmfid.simulation.drive import DriveParameters, Motion, Schedule, quantize, simulate_drive
from pmfid.simulation.scenarios import (
    CART,
    CART_DT,
    CART_RESOLUTION,
    SCENARIOS,
    Scenario,
    make_scenario,
    resolution_of,
    write_csv,
)
from pmfid.simulation.signals import mls, multisine, prbs, s_curve, stop_and_go, trapezoid

__all__ = [
    "CART",
    "CART_DT",
    "CART_RESOLUTION",
    "SCENARIOS",
    "DriveParameters",
    "Motion",
    "Scenario",
    "Schedule",
    "make_scenario",
    "mls",
    "multisine",
    "position_control",
    "prbs",
    "quantize",
    "resolution_of",
    "s_curve",
    "simulate_drive",
    "stop_and_go",
    "trapezoid",
    "write_csv",
]
