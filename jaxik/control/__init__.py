"""What touches the arm, and what it does about it: external torque from motor currents and torsions, alarms, sensors of touch,
reactions, and a plant to try them on; and a hand that steers the arm and feels what it feels."""

from jaxik.control.contact_location import Located, locate_contact
from jaxik.control.delay_line import DelayLine
from jaxik.control.detection import Detector, Judged, detect, fit_detector, judge_alarms
from jaxik.control.devices import GamePad, Keyboard, RecordedHand
from jaxik.control.estimation import EstimationLoop, Sample, estimate, over_log
from jaxik.control.force_law import ForceLaw
from jaxik.control.hand import Hand, Watchdog
from jaxik.control.hand_mapping import PositionControl, RateControl
from jaxik.control.kalman import KalmanFilter
from jaxik.control.lowpass import Butterworth
from jaxik.control.momentum_observer import MomentumObserver
from jaxik.control.passivity import Direct, PassivityController, WaveVariables
from jaxik.control.plant import Gains, Instruments, Push, SimulatedLog, mujoco_model, play
from jaxik.control.reaction import Reaction, ReactionCommand, ReactionState
from jaxik.control.reaction_loop import ReactionLoop
from jaxik.control.reaction_simulation import Encounter, Reacted, simulate_reaction
from jaxik.control.reflection import reflect, reflect_cost
from jaxik.control.spring_contact import SpringContact, contact_cost
from jaxik.control.stiffness import StiffnessEstimator
from jaxik.control.teleoperation import Teleoperation, TeleoperationCommand, TeleoperationState
from jaxik.control.teleoperation_loop import TeleoperationLoop
from jaxik.control.teleoperation_simulation import HandImpedance, Teleoperated, simulate_teleoperation
from jaxik.control.torque_estimation import TorqueEstimator, TorqueFilter
from jaxik.control.touch import Skin, TouchSensor

__all__ = [
    "Butterworth",
    "DelayLine",
    "Detector",
    "Direct",
    "Encounter",
    "EstimationLoop",
    "ForceLaw",
    "Gains",
    "GamePad",
    "Hand",
    "HandImpedance",
    "Instruments",
    "Judged",
    "KalmanFilter",
    "Keyboard",
    "Located",
    "MomentumObserver",
    "PassivityController",
    "PositionControl",
    "Push",
    "RateControl",
    "Reacted",
    "Reaction",
    "ReactionCommand",
    "ReactionLoop",
    "ReactionState",
    "RecordedHand",
    "Sample",
    "SimulatedLog",
    "Skin",
    "SpringContact",
    "StiffnessEstimator",
    "Teleoperated",
    "Teleoperation",
    "TeleoperationCommand",
    "TeleoperationLoop",
    "TeleoperationState",
    "TorqueEstimator",
    "TorqueFilter",
    "TouchSensor",
    "Watchdog",
    "WaveVariables",
    "contact_cost",
    "detect",
    "estimate",
    "fit_detector",
    "judge_alarms",
    "locate_contact",
    "mujoco_model",
    "over_log",
    "play",
    "reflect",
    "reflect_cost",
    "simulate_reaction",
    "simulate_teleoperation",
]
