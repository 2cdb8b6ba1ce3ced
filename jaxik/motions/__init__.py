"""Paths of the tip, and motions along them with redundancy resolved moment by moment or ahead of time."""

from jaxik.motions.following import FollowOptions, follow
from jaxik.motions.moving_horizon import MovingHorizon, follow_predictively
from jaxik.motions.nullspace import Box, Resolved, resolve
from jaxik.motions.path import Arc, Curve, Line, Path, TipMotion
from jaxik.motions.predictive import Horizon, energy_cost, multistart, predict, quadratic_cost

__all__ = [
    "Arc",
    "Box",
    "Curve",
    "FollowOptions",
    "Horizon",
    "Line",
    "MovingHorizon",
    "Path",
    "Resolved",
    "TipMotion",
    "energy_cost",
    "follow",
    "follow_predictively",
    "multistart",
    "predict",
    "quadratic_cost",
    "resolve",
]
