"""Paths of the tip, and motions along them with redundancy resolved moment by moment or ahead of time."""

from jaxik.motions.following import FollowOptions, follow
from jaxik.motions.moving_horizon import MovingHorizon, follow_predictively
from jaxik.motions.nullspace import asc, rac, resolve_acceleration, resolve_velocity, rmrc
from jaxik.motions.path import Arc, Line, motion, via
from jaxik.motions.predictive import Horizon, energy_cost, multistart, predict, quadratic_cost
from jaxik.motions.rate_limits import RateLimits

__all__ = [
    "Arc",
    "FollowOptions",
    "Horizon",
    "Line",
    "MovingHorizon",
    "RateLimits",
    "asc",
    "energy_cost",
    "follow",
    "follow_predictively",
    "motion",
    "multistart",
    "predict",
    "quadratic_cost",
    "rac",
    "resolve_acceleration",
    "resolve_velocity",
    "rmrc",
    "via",
]
