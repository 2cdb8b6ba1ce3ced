"""What touches the arm, and what it does about it: external torque from motor currents and torsions, alarms, sensors of touch,
reactions, and a plant to try them on; and a hand that steers the arm and feels what it feels."""

from jaxik.control.delay_line import DelayLine
from jaxik.control.detection import Detector, Judged, detect, fit_detector, judge_alarms
from jaxik.control.estimation import EstimationLoop, Sample, estimate, over_log
from jaxik.control.force_law import ForceLaw
from jaxik.control.kalman import KalmanFilter
from jaxik.control.lowpass import Butterworth
from jaxik.control.momentum_observer import MomentumObserver
from jaxik.control.passivity import Direct, PassivityController, WaveVariables
from jaxik.control.plant import Gains, Instruments, Push, SimulatedLog, mujoco_model, play
from jaxik.control.reaction import Command, Reaction, ReactionState
from jaxik.control.reaction_simulation import Encounter, Reacted, simulate_reaction
from jaxik.control.spring_contact import SpringContact, contact_cost
from jaxik.control.stiffness import StiffnessEstimator
from jaxik.control.torque_estimation import TorqueEstimator, TorqueFilter
from jaxik.control.touch import Skin, TouchSensor

__all__ = [
    "Butterworth",
    "Command",
    "DelayLine",
    "Detector",
    "Direct",
    "Encounter",
    "EstimationLoop",
    "ForceLaw",
    "Gains",
    "Instruments",
    "Judged",
    "KalmanFilter",
    "MomentumObserver",
    "PassivityController",
    "Push",
    "Reacted",
    "Reaction",
    "ReactionState",
    "Sample",
    "SimulatedLog",
    "Skin",
    "SpringContact",
    "StiffnessEstimator",
    "TorqueEstimator",
    "TorqueFilter",
    "TouchSensor",
    "WaveVariables",
    "contact_cost",
    "detect",
    "estimate",
    "fit_detector",
    "judge_alarms",
    "mujoco_model",
    "over_log",
    "play",
    "simulate_reaction",
]
