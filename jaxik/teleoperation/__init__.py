"""Steering a robot by hand: devices, mappings, passivity over a delayed channel, and the force that the hand feels."""

from jaxik.teleoperation.hand import Device, GamePad, Hand, Keyboard, PositionControl, RateControl, RecordedHand, Watchdog
from jaxik.teleoperation.passivity import DelayLine, PassivityController, WaveVariables
from jaxik.teleoperation.reflection import reflect
from jaxik.teleoperation.teleoperation import Teleoperation, TeleoperationCommand
from jaxik.teleoperation.teleoperation_simulation import TeleoperationResult, simulate_teleoperation

__all__ = [
    "DelayLine",
    "Device",
    "GamePad",
    "Hand",
    "Keyboard",
    "PassivityController",
    "PositionControl",
    "RateControl",
    "RecordedHand",
    "Teleoperation",
    "TeleoperationCommand",
    "TeleoperationResult",
    "Watchdog",
    "WaveVariables",
    "reflect",
    "simulate_teleoperation",
]
