"""External torque from motor currents and torsions, alarms, and a simulated plant to try them on."""

from jaxik.estimation.detection import Detector, fit_detector
from jaxik.estimation.estimator import Estimator, estimate
from jaxik.estimation.plant import Played, PlayOptions, Push, play
from jaxik.estimation.torque_estimation import MomentumObserver, TorqueEstimator, TorqueFilter

__all__ = [
    "Detector",
    "Estimator",
    "MomentumObserver",
    "PlayOptions",
    "Played",
    "Push",
    "TorqueEstimator",
    "TorqueFilter",
    "estimate",
    "fit_detector",
    "play",
]
