"""Configurations along a tool's path, brought on to it and moved along what the path leaves free to the shortest joint motion.

With q_i on the path, all others near it are q_i + N_i z_i, N_i a basis of the null space of the task's rows. The sum

    sum_i |w (q_{i+1} - q_i)|^2 / (s_{i+1} - s_i)  +  stiff sum_i |short of the limits, the regions, the clearance|^2

is quadratic in z for what is linear in it, and its matrix is block tridiagonal: one banded solve a step of Gauss-Newton.
Configurations then return to the path by Newton's method. [Nocedal and Wright 2006, ch. 10; Siciliano et al. 2009, sec. 3.5]
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik.collision.bvh import Grouped
from jaxik.collision.clearances import clearance
from jaxik.kinematics.forward import joint_frames
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.tasks import Tasks
from jaxik.optimise.linear import column, definite_solve, dot
from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.tool_choice import Steps
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.host import host_kernels

CLOSE = 1e-9  # [m, rad] of a residual, at which a configuration is on the path
NEWTON = 8
FULL = 0.95  # of the step that a joint may take, which configurations may come to
ROUNDS, INNER = 20, 6  # of Gauss-Newton
SHARES = (1.0, 0.5, 0.2, 0.05)  # of a step that are tried together
WORTH = 1e-3  # of the sum, below which a step ends it
NEAR, ABOVE = 0.02, 2e-3  # [m] of clearance, within which it counts, and that it is to keep beyond the cushion
SLACK = 0.01  # [rad, m] from the limits that joints are to keep
STIFF = 1e5, 1e6  # [1/m] of what is short of the limits, and of the clearance
PROBE = 1e-3  # of z, over which the clearance's slope is measured


class Followed(NamedTuple):
    """A robot that follows a path: what is bound, the limits (n,), how steps are judged, and the clearance that configurations
    keep beyond the margin, for what is between them [m]."""

    robot: Robot
    tasks: Tasks
    space: CollisionChecker | None
    around: Grouped | None
    lower: np.ndarray
    upper: np.ndarray
    steps: Steps
    cushion: float = 0.0

    def brought(self, q: np.ndarray, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Configurations (b, n) inside the limits with the poses (b, 4, 4), near those given; and which are there (b,)."""
        q, off = in_blocks(_brought(self.robot, self.tasks), q, poses, fixed=(self.lower, self.upper), double=True)
        return q, off <= 10.0 * CLOSE

    def shorter(self, q: np.ndarray, poses: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Configurations (M, n) that are on the path and free, with less joint motion over s (M,), and free as well."""
        if len(q) < 3 or q.shape[1] <= self.tasks.bound:
            return q
        cost, terms = self._judged(q, poses, s)
        damping = 0.0
        for _ in range(ROUNDS):
            basis = self._basis(q, poses)
            step = np.einsum("mnr,mr->mn", basis, self._step(q, s, basis, terms, damping))
            tried = np.concatenate([q + share * step for share in SHARES])
            moved, there = self.brought(tried, np.tile(poses, (len(SHARES), 1, 1)))
            free = (there & ~self._hits(moved)).reshape(len(SHARES), -1, 1)
            each = np.where(free, moved.reshape(len(SHARES), *q.shape), q)  # where one may not move, it stays
            most = max(FULL, self._largest(q))
            judged = [self._judged(one, poses, s) if self._largest(one) <= most else (np.inf, terms) for one in each]
            best = int(np.argmin([one for one, _ in judged]))
            if not judged[best][0] < cost:
                if damping:
                    break
                damping = 1.0
                continue
            ended = judged[best][0] > (1.0 - WORTH) * cost
            q, (cost, terms), damping = each[best], judged[best], 0.0
            if ended:
                break
        return q

    def _largest(self, q: np.ndarray) -> float:
        """The largest share of the step that a joint may take."""
        return float(np.max(np.abs(np.diff(q, axis=0)) / self.steps.most))

    def _hits(self, q: np.ndarray) -> np.ndarray:
        return np.zeros(len(q), bool) if self.space is None else self.space.hits(q, self.cushion)

    def _clearances(self, q: np.ndarray) -> np.ndarray:
        if self.around is None:
            return np.full(len(q), np.inf)
        return in_blocks(_clearance(self.robot), q, fixed=(self.around,), double=False)[0]

    def _judged(self, q: np.ndarray, poses: np.ndarray, s: np.ndarray) -> tuple[float, Any]:
        """The sum; what is left to the limits, and the borders of regions (M, 2 n + c), with the rows (M, c, n) of these; and
        to the clearance (M,)."""
        left, rows = self._inside(q, poses)
        inside = np.concatenate([q - self.lower - SLACK, self.upper - q - SLACK, left], axis=1)
        short = np.minimum(inside, 0.0)
        near = self._clearances(q) - self.cushion - ABOVE - (0.0 if self.space is None else float(self.space.margin))
        moved = self.steps.weights * np.diff(q, axis=0)
        cost = (
            np.sum(moved**2 / np.diff(s)[:, None]) + STIFF[0] * np.sum(short**2) + STIFF[1] * np.sum(np.minimum(near, 0.0) ** 2)
        )
        return float(cost), (inside, rows, near)

    def _basis(self, q: np.ndarray, poses: np.ndarray) -> np.ndarray:
        """Bases (M, n, r) of what the task leaves free."""
        rows = in_blocks(_conditions(self.robot, self.tasks), q, poses, double=True)[0]
        return np.linalg.qr(rows.swapaxes(1, 2), mode="complete")[0][:, :, rows.shape[1] :]

    def _inside(self, q: np.ndarray, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The room (M, c) to the borders of regions, none of it negative inside, and its rows (M, c, n)."""
        if not self.tasks.each[0].within:
            return np.zeros((len(q), 0)), np.zeros((len(q), 0, q.shape[1]))
        _, left, rows = in_blocks(_conditions(self.robot, self.tasks), q, poses, double=True)
        return left, rows

    def _step(self, q: np.ndarray, s: np.ndarray, basis: np.ndarray, terms: Any, damping: float) -> np.ndarray:
        """The z (M, r) of a step of Gauss-Newton."""
        (count, n, r), (inside, borders, near) = basis.shape, terms
        weighted, share = self.steps.weights[:, None] * basis, 1.0 / np.diff(s)
        pulled = self.steps.weights * np.diff(q, axis=0) * share[:, None]
        both = np.zeros(count)
        both[:-1] += share
        both[1:] += share
        diagonal = both[:, None, None] * np.einsum("mni,mnj->mij", weighted, weighted)
        beside = -share[:, None, None] * np.einsum("mni,mnj->mij", weighted[1:], weighted[:-1])
        force = np.zeros((count, n))
        force[:-1] += pulled
        force[1:] -= pulled
        right = np.einsum("mni,mn->mi", weighted, force)
        diagonal += (1e-9 + damping * both)[:, None, None] * np.eye(r)
        rows = np.concatenate([basis, -basis, borders @ basis], axis=1)  # what is left grows by these
        slope = self._slopes(q, basis, near)
        z = np.zeros((count, r))
        for _ in range(INNER):  # Newton's method on what is quadratic but for which limits hold
            tight = STIFF[0] * (inside + np.einsum("mnr,mr->mn", rows, z) < 0.0)
            close = STIFF[1] * (near + np.sum(slope * z, axis=1) < 0.0)
            matrix = diagonal + np.einsum("mni,mn,mnj->mij", rows, tight, rows)
            matrix += close[:, None, None] * slope[:, :, None] * slope[:, None]
            pull = right - np.einsum("mni,mn->mi", rows, tight * inside) - (close * np.where(close, near, 0.0))[:, None] * slope
            before, z = z, _banded(matrix, beside, pull)
            if np.abs(z - before).max() < 1e-6:
                break
        return z

    def _slopes(self, q: np.ndarray, basis: np.ndarray, near: np.ndarray) -> np.ndarray:
        """The derivatives (M, r) of the clearance by z, where it counts."""
        (count, n, r), close = basis.shape, np.flatnonzero(near < NEAR)
        found = np.zeros((count, r))
        if len(close):
            probes = np.stack([q[close] + sign * PROBE * basis[close, :, i] for i in range(r) for sign in (1.0, -1.0)])
            seen = self._clearances(probes.reshape(-1, n)).reshape(r, 2, -1)
            found[close] = ((seen[:, 0] - seen[:, 1]) / (2.0 * PROBE)).T
        return found


def _banded(diagonal: np.ndarray, beside: np.ndarray, right: np.ndarray) -> np.ndarray:
    """The solution (M, r) of a block tridiagonal system: blocks (M, r, r), and those beneath them (M-1, r, r)."""
    from scipy.linalg import solveh_banded

    count, r = right.shape
    banded = np.zeros((2 * r, count * r))  # lower form
    for i in range(r):
        for j in range(r):
            if i >= j:
                banded[i - j, j::r] = diagonal[:, i, j]
            banded[r + i - j, j : (count - 1) * r : r] = beside[:, i, j]
    return solveh_banded(banded, right.ravel(), lower=True).reshape(count, r)


@host_kernels(1)
def _clearance(robot: Robot, q: Any, around: Any) -> Any:
    return clearance(robot, around, q)


@host_kernels(2)
def _conditions(robot: Robot, tasks: Tasks, q: Any, pose: Any) -> tuple[Any, ...]:
    """The rows (m, n) of the tasks' equations; and of tasks with regions what these leave (c,), and its rows (c, n). Traced."""
    frames, targets = joint_frames(robot, list(q), dtype=q.dtype), tasks.targets(pose)
    listed = lambda values: jnp.stack([jnp.asarray(x, q.dtype) for x in values])
    if not tasks.each[0].within:
        return (jnp.stack([listed(row) for each in tasks.rows(robot, frames, targets) for row in each]),)

    def values(q: Any) -> tuple[Any, Any]:
        zero, above = tasks.conditions(joint_frames(robot, list(q), dtype=q.dtype), targets)
        return listed([*zero, 0.0]), listed([*above, 1.0])

    moved = [jax.jvp(values, (q,), (along,))[1] for along in jnp.eye(len(q), dtype=q.dtype)]
    rows, slopes = (jnp.stack(each, axis=1) for each in zip(*moved, strict=True))
    return rows[: tasks.bound], values(q)[1], slopes


def _looked(robot: Robot, tasks: Tasks, q: Any, pose: Any) -> tuple[list[Any], list[list[Any]]]:
    frames, targets = joint_frames(robot, list(q), dtype=q.dtype), tasks.targets(pose)
    residual = [x for parts in tasks.residuals(frames, targets) for part in parts for x in part]
    rows = [row for each in tasks.rows(robot, frames, targets) for row in each]
    return [jnp.asarray(x, q.dtype) for x in residual], [[jnp.asarray(x, q.dtype) for x in row] for row in rows]


@host_kernels(2)
def _brought(robot: Robot, tasks: Tasks, q: Any, pose: Any, lower: Any, upper: Any) -> tuple[Any, Any]:
    """The configuration after some steps of Newton's method inside the limits, and the most that it is off. Traced."""

    step = lambda _, q: newton_step(robot, tasks, q, pose, lower, upper)[0]
    q = lax.fori_loop(0, NEWTON, step, jnp.clip(q, lower, upper))
    return q, newton_step(robot, tasks, q, pose, lower, upper)[1]


def newton_step(robot: Robot, tasks: Tasks, q: Any, pose: Any, lower: Any, upper: Any) -> tuple[Any, Any]:
    """The configuration after a step of Newton's method towards a pose, inside the limits, and the most that it was off.
    Traced."""
    residual, rows = _looked(robot, tasks, q, pose)
    normal = [[dot(a, b) + (1e-12 if a is b else 0.0) for b in rows[: i + 1]] for i, a in enumerate(rows)]
    pull = definite_solve(normal, residual, 1e-12)
    moved = jnp.stack([dot(column(rows, k), pull) for k in range(len(q))])
    return jnp.clip(q - moved, lower, upper), jnp.max(jnp.abs(jnp.stack(residual)))
