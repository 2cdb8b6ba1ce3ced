"""External torque from motor currents and torsions, alarms, and a simulated plant to try them on."""

from jaxik.estimation.detection import Detector, Judged, detect, fit_detector, judge_alarms
from jaxik.estimation.lowpass import Butterworth
from jaxik.estimation.momentum_observer import MomentumObserver
from jaxik.estimation.plant import Gains, Instruments, Push, SimulatedLog, mujoco_model, play
from jaxik.estimation.sampled import EstimationLoop, Sample, estimate, over_log
from jaxik.estimation.torque_estimation import TorqueEstimator, TorqueFilter

__all__ = [
    "Butterworth",
    "Detector",
    "EstimationLoop",
    "Gains",
    "Instruments",
    "Judged",
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
