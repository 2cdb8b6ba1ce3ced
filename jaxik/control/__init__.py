"""What touches the arm, without a sensor for it: external torque from motor currents and torsions, alarms, and a plant to try
them on."""

from jaxik.control.detection import Detector, Judged, detect, fit_detector, judge_alarms
from jaxik.control.estimation import EstimationLoop, Sample, estimate, over_log
from jaxik.control.kalman import KalmanFilter
from jaxik.control.momentum_observer import MomentumObserver
from jaxik.control.plant import Gains, Instruments, Push, SimulatedLog, mujoco_model, play
from jaxik.control.torque_estimation import TorqueEstimator, TorqueFilter

__all__ = [
    "Detector",
    "EstimationLoop",
    "Gains",
    "Instruments",
    "Judged",
    "KalmanFilter",
    "MomentumObserver",
    "Push",
    "Sample",
    "SimulatedLog",
    "TorqueEstimator",
    "TorqueFilter",
    "detect",
    "estimate",
    "fit_detector",
    "judge_alarms",
    "mujoco_model",
    "over_log",
    "play",
]
