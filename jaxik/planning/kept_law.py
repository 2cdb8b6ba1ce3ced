"""Tasks that are kept on a whole way: how far a configuration is off them, and the nearest one that is not.

All tasks together are a residual of q, which is zero where they are kept: of an equality the deviation itself, of a set with an
inside the distance to it. Configurations are brought there by Newton's method, `q - J' (J J')^-1 r` [Siciliano et al. 2009,
sec. 3.7], many of them at once: they are the lanes of a kernel.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik.kinematics.forward import joint_frames
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.tasks import Tasks
from jaxik.optimise.linear import column, definite_solve, dot
from jaxik.spatial.algebra import Frame, traced
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.host import host_kernels

NEWTON = 8  # steps at most
CLOSE = {np.dtype(np.float32): 1e-5, np.dtype(np.float64): 1e-10}  # [m, rad] of a residual, at which it is reached
DAMPING = {np.dtype(np.float32): 1e-6, np.dtype(np.float64): 1e-9}  # [m2, rad2] at a singular place
Columns = list[list[Any]]


class Law(NamedTuple):
    """The tasks of a robot whose tips they compare. Hashable: a kernel's key."""

    robot: Robot
    tasks: Tasks

    def residual(self, q: Any, targets: Any) -> tuple[list[Any], Columns]:
        """The residual (m,) at q (n,) from targets (k, 4, 4), and its derivative's rows, as scalars. Traced."""
        frames = joint_frames(self.robot, traced(q), dtype=q.dtype)
        wanted = [Frame.of_columns(targets[i]) for i in range(len(self.tasks.each))]
        away = [list(x) for both in self.tasks.residuals(frames, wanted) for x in both]
        rows = self.tasks.rows(self.robot, frames, wanted)
        return [x for part in away for x in part], [row for each in rows for row in each]


def brought(law: Law, q: Any, targets: Any, lower: Any, upper: Any, some: Callable[[Any], Any]) -> tuple[Any, Any]:
    """The configuration (n,) near to q at which tasks are kept, within limits (n,), of joints that these let move; and whether
    it is reached. `some` tells of a lane's truth whether all go on. Traced."""
    close, damping = CLOSE[np.dtype(q.dtype)], DAMPING[np.dtype(q.dtype)]
    moves = jnp.where(upper > lower, 1.0, 0.0).astype(q.dtype)

    def seen(q: Any) -> tuple[Any, Any]:
        away, rows = law.residual(q, targets)
        normal = [[dot(a, [x * m for x, m in zip(b, moves, strict=True)]) for b in rows[: i + 1]] for i, a in enumerate(rows)]
        for i, row in enumerate(normal):
            row[i] = row[i] + damping
        pull = definite_solve(normal, away, 0.0)
        step = jnp.stack([dot(column(rows, k), pull) * moves[k] for k in range(len(q))])
        most = functools.reduce(jnp.maximum, [jnp.abs(x) for x in away])
        return most, step

    def goes_on(state: tuple[Any, ...]) -> Any:
        _, turn, most, _ = state
        return (turn < NEWTON) & some(most > close)

    def newton(state: tuple[Any, ...]) -> Any:
        q, turn, most, step = state
        new = jnp.where(most > close, jnp.clip(q - step, lower, upper), q)
        return new, turn + 1, *seen(new)

    q = jnp.clip(q, lower, upper)
    q, _, most, _ = lax.while_loop(goes_on, newton, (q, jnp.int32(0), *seen(q)))
    return q, most <= 10.0 * close


@host_kernels(1)
def _brought(law: Law, q: Any, targets: Any, lower: Any, upper: Any) -> tuple[Any, Any]:
    new, there = brought(law, q, targets, lower, upper, lambda x: x)
    return new, there.astype(jnp.int32)


@host_kernels(1)
def _away(law: Law, q: Any, targets: Any) -> Any:
    away, _ = law.residual(q, targets)
    return jnp.stack([jnp.asarray(x, q.dtype) for x in away])


@host_kernels(1)
def _seen(law: Law, q: Any) -> Any:
    frames = law.tasks.frames(joint_frames(law.robot, traced(q), dtype=q.dtype))
    return jnp.stack([jnp.stack([jnp.asarray(x, q.dtype) for x in frame.entries]).reshape(4, 4) for frame in frames])


def frames_at(law: Law, q: np.ndarray) -> np.ndarray:
    """The frames (b, k, 4, 4) that the tasks compare with their targets, at configurations (b, n)."""
    return in_blocks(_seen(law), q, double=True)[0]


class Kept:
    """A `law` with its `targets` (k, 4, 4), kept by configurations between `lower` and `upper` (n,)."""

    def __init__(self, law: Law, targets: np.ndarray, lower: Any, upper: Any):
        self.law, self.targets, self.lower, self.upper = law, targets, lower, upper

    def away(self, q: np.ndarray) -> np.ndarray:
        """The residuals (b, m) of configurations (b, n)."""
        return in_blocks(_away(self.law), q, fixed=(self.targets,), double=True)[0]

    def brought(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Configurations (b, n) near those given that keep the tasks, within the bounds; and which of them do (b,)."""
        new, there = in_blocks(_brought(self.law), q, fixed=(self.targets, self.lower, self.upper), double=True)
        return new, there.astype(bool)
