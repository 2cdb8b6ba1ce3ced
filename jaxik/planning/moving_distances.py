"""How far a robot is from things that move, at many configurations and times in one call of a kernel."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxik.collision.bvh import Grouped, decided_within, grouped
from jaxik.collision.held import Carried, apart, together
from jaxik.collision.leaf_rows import FAR
from jaxik.collision.moving import MovingScene
from jaxik.collision.moving_clearance import alone, inverse
from jaxik.collision.nearest_pair import Space
from jaxik.collision.own_shape import CLOSE, told_below
from jaxik.kinematics.robot import Robot, as_configuration
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.host import host_kernels


class MovingDistances:
    """The distances of a robot to what moves in a scene. Where its volumes are nearer than the margin and what it may be off
    until the time `until` [s], its own shape decides, as in `collides`."""

    def __init__(self, robot: Robot, moving: MovingScene, margin: float, until: float):
        self.moving, self.base = moving, np.asarray(robot.world_T_base, float)
        self.robot, carried = apart(alone(robot))
        around = tuple(jax.tree_util.tree_map(np.asarray, grouped(scene, self.robot)) for scene in moving.alone)
        told = margin + float(np.max(moving.errors(until), initial=0.0))
        self.fixed = around, carried, np.float64(told)

    def at(self, q: np.ndarray, times: np.ndarray, double: bool = True) -> np.ndarray:
        """The signed distances (b, o) of configurations (b, n) at times (b,) [s] to where what moves is predicted, infinite to
        what is out of the way."""
        if not (self.moving.tracks and len(q)):
            return np.full((len(q), len(self.moving.tracks)), np.inf)
        return self._measured(np.asarray(q, float), self._seen(times), double)

    def over(self, q: np.ndarray, times: np.ndarray) -> np.ndarray:
        """The same in float32 of each configuration (b, n) at each of the times (t,): (b, t, o)."""
        shape = len(q), len(times), len(self.moving.tracks)
        if not all(shape):
            return np.full(shape, np.inf)
        rows = np.repeat(np.asarray(q, np.float32), len(times), axis=0)
        seen = np.broadcast_to(self._seen(times).astype(np.float32), (len(q), *shape[1:], 4, 4))
        return self._measured(rows, seen.reshape(-1, shape[2], 4, 4), False).reshape(shape)

    def _seen(self, times: np.ndarray) -> np.ndarray:
        """The robot's base (t, o, 4, 4) in the frames of what moves."""
        return np.asarray(inverse(self.moving.poses(times)) @ self.base)

    def _measured(self, q: np.ndarray, seen: np.ndarray, double: bool) -> np.ndarray:
        (found,) = in_blocks(_distances(self.robot), q, seen, fixed=self.fixed, double=double)
        return np.where(found > FAR / 2.0, np.inf, found)


@host_kernels(2)
def _distances(robot: Robot, q: Any, seen: Any, around: tuple[Grouped, ...], carried: Carried, told: Any) -> Any:
    """The distances (o,) of a configuration (n,) to each group of obstacles, in whose frame the base is `seen` (o, 4, 4)."""
    robot = together(robot, carried)

    def near(i: int) -> Any:
        there = dataclasses.replace(robot, world_T_base=seen[i])
        own = decided_within(around[i], lambda usual: told_below(usual, told, CLOSE))
        return Space(there, own, as_configuration(there, q)).all().distance

    return jnp.stack([near(i) for i in range(len(around))])
