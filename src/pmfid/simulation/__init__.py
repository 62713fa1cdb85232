"""The exactly simulated laboratory drive. No lower package may import it, because it knows the true parameters."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pmfid.lazy_imports import make_getattr, read_names

if TYPE_CHECKING:
    from pmfid.simulation.drive import DriveParameters as DriveParameters
    from pmfid.simulation.drive import Machine as Machine
    from pmfid.simulation.drive import Motion as Motion
    from pmfid.simulation.drive import Schedule as Schedule
    from pmfid.simulation.drive import control_machine as control_machine
    from pmfid.simulation.drive import drive_machine as drive_machine
    from pmfid.simulation.drive import position_control as position_control
    from pmfid.simulation.drive import simulate_drive as simulate_drive
    from pmfid.simulation.edges import capture_edges as capture_edges
    from pmfid.simulation.encoder import Faults as Faults
    from pmfid.simulation.encoder import quantize as quantize
    from pmfid.simulation.scenarios import CART as CART
    from pmfid.simulation.scenarios import CART_CONTROL as CART_CONTROL
    from pmfid.simulation.scenarios import CART_DT as CART_DT
    from pmfid.simulation.scenarios import CART_INCREMENTS as CART_INCREMENTS
    from pmfid.simulation.scenarios import CART_LOADED as CART_LOADED
    from pmfid.simulation.scenarios import CART_RESOLUTION as CART_RESOLUTION
    from pmfid.simulation.scenarios import SCENARIOS as SCENARIOS
    from pmfid.simulation.scenarios import Scenario as Scenario
    from pmfid.simulation.scenarios import axis_toml as axis_toml
    from pmfid.simulation.scenarios import change_parameters as change_parameters
    from pmfid.simulation.scenarios import make_scenario as make_scenario
    from pmfid.simulation.scenarios import resolution_of as resolution_of
    from pmfid.simulation.scenarios import write_csv as write_csv
    from pmfid.simulation.signals import mls as mls
    from pmfid.simulation.signals import multisine as multisine
    from pmfid.simulation.signals import prbs as prbs
    from pmfid.simulation.signals import random_moves as random_moves
    from pmfid.simulation.signals import s_curve as s_curve
    from pmfid.simulation.signals import steps as steps
    from pmfid.simulation.signals import stop_and_go as stop_and_go
    from pmfid.simulation.signals import trapezoid as trapezoid

_PUBLIC = read_names(__file__)
__all__ = sorted(_PUBLIC)
if not TYPE_CHECKING:  # a type checker would accept every misspelt name
    __getattr__ = make_getattr(__name__, _PUBLIC)


def __dir__() -> list[str]:
    return list(__all__)
