"""Changes of a machine: scores of blocks, a detector, calibrated thresholds and the cause of a change.

calibration = calibrate(estimator, nominal, u, counts)          # thresholds, from a record of normal work
monitor = Monitor(estimator, calibration, Watch(mtbf_hours=24.0))
estimate, events = monitor.step(u, count)                       # an Alarm has the parameter, the size and the time
fleet = MonitorFleet(monitor, axes=1000)                        # many axes, each with its own state
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pmfid.lazy_imports import make_getattr, read_names

if TYPE_CHECKING:
    from pmfid.monitor.calibration import Calibration as Calibration
    from pmfid.monitor.calibration import calibrate as calibrate
    from pmfid.monitor.edges import EdgeMonitor as EdgeMonitor
    from pmfid.monitor.events import Alarm as Alarm
    from pmfid.monitor.events import Change as Change
    from pmfid.monitor.events import FleetRows as FleetRows
    from pmfid.monitor.events import Outlier as Outlier
    from pmfid.monitor.events import Settled as Settled
    from pmfid.monitor.events import StateChange as StateChange
    from pmfid.monitor.events import Watch as Watch
    from pmfid.monitor.fleet import MonitorFleet as MonitorFleet
    from pmfid.monitor.monitor import Monitor as Monitor

_PUBLIC = read_names(__file__)
__all__ = sorted(_PUBLIC)
if not TYPE_CHECKING:  # a type checker would accept every misspelt name
    __getattr__ = make_getattr(__name__, _PUBLIC)


def __dir__() -> list[str]:
    return list(__all__)
