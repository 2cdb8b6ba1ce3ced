"""External torque from motor currents and torsions, alarms, and a simulated plant to try them on."""

from jaxik.estimation.detection import Detector, Judged, fit_detector, judge_alarms
from jaxik.estimation.estimator import Estimator, estimate
from jaxik.estimation.momentum_observer import MomentumObserver
from jaxik.estimation.plant import Played, PlayOptions, Push, play
from jaxik.estimation.torque_estimation import TorqueEstimator, TorqueFilter

__all__ = [
    "Detector",
    "Estimator",
    "Judged",
    "MomentumObserver",
    "PlayOptions",
    "Played",
    "Push",
    "TorqueEstimator",
    "TorqueFilter",
    "estimate",
    "fit_detector",
    "judge_alarms",
    "play",
]
