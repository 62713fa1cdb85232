"""Servos: parameters out of logs of position commands."""

from pmfid.actuators.fit import ServoFit, fit_servo
from pmfid.actuators.servo import Servo

__all__ = ["Servo", "ServoFit", "fit_servo"]
