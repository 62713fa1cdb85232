"""Servos: parameters out of logs of position commands."""

from pmfid.actuators.body import simulate_servo
from pmfid.actuators.fit import ServoFit, fit_logs, fit_servo
from pmfid.actuators.logs import JointLog
from pmfid.actuators.servo import Servo

__all__ = ["JointLog", "Servo", "ServoFit", "fit_logs", "fit_servo", "simulate_servo"]
