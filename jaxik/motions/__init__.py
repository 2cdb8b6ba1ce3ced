"""Paths of the tip, and motions along them with redundancy resolved moment by moment or ahead of time."""

from jaxik.motions.controller import PredictiveCommand, PredictiveController, PredictiveState
from jaxik.motions.following import FollowOptions, FollowResult, follow
from jaxik.motions.nullspace import Box, Resolved, resolve
from jaxik.motions.path import Arc, Curve, Line, Path, TipMotion
from jaxik.motions.predictive import PredictOptions, PredictResult, predict

__all__ = [
    "Arc",
    "Box",
    "Curve",
    "FollowOptions",
    "FollowResult",
    "Line",
    "Path",
    "PredictOptions",
    "PredictResult",
    "PredictiveCommand",
    "PredictiveController",
    "PredictiveState",
    "Resolved",
    "TipMotion",
    "follow",
    "predict",
    "resolve",
]
