"""Steering a robot by hand: devices, mappings, passivity over a delayed channel, and the force that the hand feels."""

from jaxik.teleoperation.delay_line import DelayLine
from jaxik.teleoperation.devices import GamePad, Keyboard, RecordedHand
from jaxik.teleoperation.hand import Hand, Watchdog
from jaxik.teleoperation.hand_mapping import PositionControl, RateControl
from jaxik.teleoperation.passivity import Direct, PassivityController, WaveVariables
from jaxik.teleoperation.reflection import reflect, reflect_cost
from jaxik.teleoperation.teleoperation import Teleoperation, TeleoperationCommand, TeleoperationState
from jaxik.teleoperation.teleoperation_loop import TeleoperationLoop
from jaxik.teleoperation.teleoperation_simulation import HandImpedance, Teleoperated, simulate_teleoperation

__all__ = [
    "DelayLine",
    "Direct",
    "GamePad",
    "Hand",
    "HandImpedance",
    "Keyboard",
    "PassivityController",
    "PositionControl",
    "RateControl",
    "RecordedHand",
    "Teleoperated",
    "Teleoperation",
    "TeleoperationCommand",
    "TeleoperationLoop",
    "TeleoperationState",
    "Watchdog",
    "WaveVariables",
    "reflect",
    "reflect_cost",
    "simulate_teleoperation",
]
