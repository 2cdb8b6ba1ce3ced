"""Judges of motions that nobody here wrote: coal says how deep a way hits, toppra the least time along a path."""

from __future__ import annotations

from typing import Any

import numpy as np
import toppra
import toppra.algorithm
import toppra.constraint
from peers.collision_peers import Coal
from toppra.interpolator import AbstractGeometricPath

import jaxik
from jaxik.planning import JointPath

APART = 1e-3  # [m] that any point of the robot moves at most between samples
SAMPLES = 5000  # of a way, at least
GRID = 1000  # parts of a path that toppra times
STRAIGHT = 1e-6  # by which the directions on both sides of a place differ at most where there is no corner


class Curve(AbstractGeometricPath):  # type: ignore[misc]
    """Some pieces of a `JointPath`, without a corner, as toppra takes them."""

    def __init__(self, path: JointPath):
        self.path, self.knots = path, np.concatenate([[0.0], np.cumsum(path.lengths)])

    def __call__(self, places: Any, order: int = 0) -> np.ndarray:
        places = np.asarray(places, float)
        piece = np.clip(np.searchsorted(self.knots, places, side="right") - 1, 0, len(self.knots) - 2)
        powers, curve = (places - self.knots[piece])[..., None], np.asarray(self.path.coefficients)[piece]
        for _ in range(order):
            curve = curve[..., :-1, :] * np.arange(curve.shape[-2] - 1, 0, -1)[:, None]
        return sum((curve[..., k, :] * powers ** (curve.shape[-2] - 1 - k) for k in range(curve.shape[-2])), 0.0 * powers)

    @property
    def dof(self) -> int:
        return int(np.shape(self.path.coefficients)[-1])

    @property
    def path_interval(self) -> np.ndarray:
        return self.knots[[0, -1]]

    @property
    def waypoints(self) -> tuple[np.ndarray, np.ndarray]:
        return self.knots, self(self.knots)


def smooth_parts(path: JointPath) -> list[Curve]:
    """The parts of a path between its corners, at which a motion stops."""
    some = np.flatnonzero(path.lengths)
    lengths, curves = np.asarray(path.lengths)[some], np.asarray(path.coefficients)[some]
    degrees = np.arange(curves.shape[1] - 1, 0, -1)
    ends = [np.zeros_like(lengths), lengths]
    begins, finishes = (np.einsum("kcn,kc->kn", curves[:, :-1], degrees * h[:, None] ** (degrees - 1)) for h in ends)
    along = lambda slope: slope / np.linalg.norm(slope, axis=-1, keepdims=True)
    cuts = 1 + np.flatnonzero(np.abs(along(begins)[1:] - along(finishes)[:-1]).max(axis=-1) > STRAIGHT)
    return [Curve(JointPath(lengths[part], curves[part])) for part in np.split(np.arange(len(some)), cuts)]


def least_time(path: JointPath, velocity: np.ndarray, acceleration: np.ndarray) -> float:
    """The least time along a path within limits (n,) by toppra, which keeps them at its grid's places alone [s]."""
    limits = [
        getattr(toppra.constraint, f"Joint{kind}Constraint")(np.stack([-most, most], axis=1))
        for kind, most in (("Velocity", velocity), ("Acceleration", acceleration))
    ]
    total, parts = 0.0, smooth_parts(path)
    whole = sum(part.knots[-1] for part in parts)
    for part in parts:
        grid = np.union1d(np.linspace(0.0, part.knots[-1], max(50, int(GRID * part.knots[-1] / whole))), part.knots)
        grid = grid[np.concatenate([[True], np.diff(grid) > 1e-9 * whole])]
        grid[-1] = part.knots[-1]
        solver = toppra.algorithm.TOPPRA(limits, part, gridpoints=grid, solver_wrapper="seidel")
        total += solver.compute_trajectory(0, 0).duration
    return float(total)


def deepest(robot: jaxik.Robot, coal: Coal, scene: jaxik.Scene, way: np.ndarray) -> tuple[float, int]:
    """How deep a way (k, n) is at its deepest sample [m], 0 where it is free, and the number of samples."""
    reach = jaxik.collision.continuous_collision.joint_reaches(robot)
    along = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(way, axis=0)) @ reach)])
    places = np.linspace(0.0, along[-1], max(SAMPLES, int(np.ceil(along[-1] / APART)) + 1))
    q = np.stack([np.interp(places, along, column) for column in way.T], axis=1)
    hit = np.flatnonzero(coal.collides(scene, q))
    return (max(0.0, -float(coal.clearance(scene, q[hit]).min())) if len(hit) else 0.0), len(q)
