"""Two tips that hold one thing: the pose of one, seen from the other, stays what it is within a tolerance.

A constraint on the whole way is a residual of q with a tolerance on parts of it; here (v, w): how far the origin of a tip is
from where the other one has it [m], and the rotation vector of its turn from that [rad], both in the axes of the tip that it is
seen from. Configurations are brought onto it by Newton's method, `q - J' (J J')^-1 r` [Siciliano et al. 2009, sec. 3.7].

Between samples of a path q(s) both are bounded: the origin moves by `|p'|` and the turn, whose angle is a distance, by no more
than `|omega|`, which are known at a sample, and change by the second derivatives at most,

    |p''| <= sum_i |q_i''| r_i + sum_ij |q_i'| |q_j'| r_max(i,j),   |omega'| <= sum_i |q_i''| + sum_i<j |q_i'| |q_j'|,

of the joints from the one tip to the other, each at most r_i from the origin that it moves.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik.checks.options import shown
from jaxik.kinematics.relative import relative_jacobian, relative_pose
from jaxik.kinematics.robot import Robot
from jaxik.optimise.linear import column, definite_solve, dot
from jaxik.planning.trajectory import JointPath
from jaxik.spatial.rotations import rotation_log
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.host import host_kernels

CLOSE = 1e-9  # [m, rad] of a residual, at which a configuration is on the constraint
NEWTON = 4  # steps from what a stride has moved off the constraint
STRIDES = 16  # of a walk, in one call
PROGRESS = 0.1  # of a stride, by which it comes nearer to what it goes to at least
PARTS = 64  # samples of a piece of a path, at most


class KeptPose:
    """The pose of the tip `names[1]` as `names[0]` sees it, which is to stay as it is at `q` (n,), within a `tolerance` (2,) of
    its place [m] and of its turn [rad]; configurations are sought within `bounds` (n,), (n,).

    Raises `ValueError` for what are no two tips or links, and where no joint moves one of them against the other.
    """

    def __init__(
        self,
        who: str,
        robot: Robot,
        names: tuple[str, ...],
        q: np.ndarray,
        tolerance: np.ndarray,
        bounds: tuple[np.ndarray, np.ndarray],
    ):
        if len(names) != 2:
            raise ValueError(f"{who}: keep is {shown(names)}; write the two tips whose relative pose is kept, by their names")
        self.robot, self.tolerance, (self.lower, self.upper) = robot.with_tips(list(names)), tolerance, bounds
        pairs = self.robot.tree.apart(*self.robot.tips)
        if not any(pairs):
            raise ValueError(f"{who}: keep: no joint moves {names[1]} against {names[0]}; name the tips of two arms")
        self.rows, self.reach = _chain(self.robot, *pairs)
        self.wanted = np.eye(4)
        self.wanted = self.seen(q[None])[2][0]

    def seen(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The residuals (b, 6) of configurations (b, n), their derivatives (b, 6, n), and the poses (b, 4, 4)."""
        residual, slope, pose = in_blocks(_seen(self.robot), q, fixed=(self.wanted,), double=True)
        return residual, slope, pose

    def away(self, q: np.ndarray) -> np.ndarray:
        """How far configurations (b, n) are off, in place and turn (b, 2) [m, rad]."""
        return _sizes(self.seen(q)[0])

    def brought(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Configurations (b, n) on the constraint and within the bounds, near those given; and which are there (b,)."""
        q = np.clip(q, self.lower, self.upper)
        residual, slope, _ = self.seen(q)
        for _ in range(2 * NEWTON):
            left = np.abs(residual).max(axis=1) > CLOSE
            if not left.any():
                break
            j = slope[left]
            normal = j @ j.transpose(0, 2, 1) + 1e-9 * np.eye(6)
            step = np.einsum("bkn,bk->bn", j, np.linalg.solve(normal, residual[left][..., None])[..., 0])
            q[left] = np.clip(q[left] - step, self.lower, self.upper)
            residual[left], slope[left] = self.seen(q[left])[:2]
        return q, np.abs(residual).max(axis=1) <= 10.0 * CLOSE

    def walked(
        self, start: np.ndarray, target: np.ndarray, weights: np.ndarray, step: float, exact: bool
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Takes `STRIDES` of at most a `step` [m] from each start towards a target (b, n), which are on the constraint, the
        targets only if that is `exact`: where each stride ends (b, strides, n), how many there are before one brings it no
        nearer (b,), and whether the last one arrives (b,). Lengths are those of joints times `weights`."""
        how = self.wanted, weights, self.lower, self.upper, np.array([step, float(exact)])
        points, count, arrives = in_blocks(_walked(self.robot), start, target, fixed=how, double=True)
        return points, count, arrives.astype(bool)

    def bounds(self, path: JointPath) -> np.ndarray:
        """The most that each piece (k, 2) of a path of cubics is off, between samples, too, in place and turn [m, rad]; for
        pieces that so many samples do not tell infinite."""
        lengths, curve = np.asarray(path.lengths, float), np.asarray(path.coefficients, float)
        along = lengths[:, None]
        ends = curve[:, 2], (3.0 * curve[:, 0] * along + 2.0 * curve[:, 1]) * along + curve[:, 2]
        rate = np.maximum(*map(np.abs, ends)) + 0.75 * along**2 * np.abs(curve[:, 0])
        bend = np.maximum(np.abs(2.0 * curve[:, 1]), np.abs(6.0 * curve[:, 0] * along + 2.0 * curve[:, 1]))
        second = self._second(rate, bend)
        parts = lengths * np.sqrt(np.max(second / self.tolerance, axis=1))  # a sample's reach then costs an eighth
        count = int(np.clip(np.ceil(np.max(parts, initial=1.0)), 2, PARTS))
        half = 0.5 * lengths / count
        s = (2.0 * np.arange(count) + 1.0) * half[:, None]
        powers = s[..., None] ** np.arange(3, -1, -1)
        q = np.einsum("kmp,kpn->kmn", powers, curve)
        slope = np.einsum("kmp,kpn->kmn", powers[..., 1:] * [3.0, 2.0, 1.0], curve[:, :3])
        residual, jacobian, _ = self.seen(q.reshape(-1, q.shape[2]))
        moved = _sizes(np.einsum("ban,bn->ba", jacobian, slope.reshape(-1, q.shape[2])))
        off = (_sizes(residual) + moved * np.repeat(half, count)[:, None]).reshape(len(lengths), count, 2).max(axis=1)
        return off + 0.5 * second * half[:, None] ** 2

    def _second(self, rate: np.ndarray, bend: np.ndarray) -> np.ndarray:
        """Bounds of the second derivatives (k, 2) of place and turn where joints have at most such derivatives (k, n)."""
        reach, turns, lever = self.reach
        first, second = rate @ self.rows.T, bend @ self.rows.T  # of the chain's own joints
        place = second @ lever + np.einsum("ki,kj,ij->k", first, first, reach)
        turning = first * turns
        pairs = 0.5 * (turning.sum(axis=1) ** 2 - (turning**2).sum(axis=1))
        return np.stack([place, second @ turns + pairs], axis=1)


def _sizes(residual: np.ndarray) -> np.ndarray:
    return np.linalg.norm(residual.reshape(-1, 2, 3), axis=2)


def seen(robot: Robot, q: Any, wanted: Any) -> tuple[Any, Any, Any]:
    """The residual (6,) of a robot's second tip, as its first one sees it, from a pose (4, 4); its derivative (6, n), and the
    pose. Traced."""
    names = robot.tip_names
    pose, slope = relative_pose(robot, q, *names), relative_jacobian(robot, q, *names)
    turned = rotation_log(pose[:3, :3] @ wanted[:3, :3].T)
    return jnp.concatenate([pose[:3, 3] - wanted[:3, 3], turned]), slope, pose


_seen = host_kernels(1)(seen)


@host_kernels(2)
def _walked(
    robot: Robot, q: Any, target: Any, wanted: Any, weights: Any, lower: Any, upper: Any, how: Any
) -> tuple[Any, Any, Any]:
    step, exact = how[0], how[1] > 0.0
    length = lambda moved: jnp.sqrt(jnp.sum((moved * weights) ** 2))
    inside = lambda q: jnp.clip(q, lower, upper)

    def newton(_: Any, q: Any) -> Any:
        residual, slope, _ = seen(robot, q, wanted)
        rows = [[slope[i, k] for k in range(len(weights))] for i in range(6)]
        normal = [[dot(rows[i], rows[j]) + (1e-9 if i == j else 0.0) for j in range(i + 1)] for i in range(6)]
        pull = definite_solve(normal, [residual[i] for i in range(6)], 0.0)
        return inside(q - jnp.stack([dot(column(rows, k), pull) for k in range(len(weights))]))

    def stride(state: tuple[Any, ...], _: Any) -> Any:
        q, going, count, arrives = state
        far = length(target - q)
        last = exact & (far <= step)
        aim = inside(q + jnp.minimum(1.0, step / jnp.maximum(far, 1e-12)) * (target - q))
        new = lax.fori_loop(0, NEWTON, newton, aim)
        there = jnp.max(jnp.abs(seen(robot, new, wanted)[0])) <= 10.0 * CLOSE
        nearer = far - length(target - new) > PROGRESS * jnp.minimum(far, step)
        there = last | (there & nearer & (length(new - q) <= 2.0 * step))
        on = going & there
        new = jnp.where(on, jnp.where(last, target, new), q)
        return (new, on & ~last, count + on, arrives | (on & last)), new

    start = q, jnp.bool_(True), jnp.int32(0), jnp.bool_(False)
    (_, _, count, arrives), points = lax.scan(stride, start, None, STRIDES)
    return points, count, arrives.astype(jnp.int32)


def _chain(robot: Robot, before: tuple[int, ...], behind: tuple[int, ...]) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
    """The joints between two tips: how much each of the robot's moves each (m, n), and bounds of derivatives of the place by
    two of them (m, m), of the turn by each (m,), and of the place by each (m,)."""
    tree, (_, tip) = robot.tree, robot.tip_frames
    far = lambda frame: float(np.linalg.norm(np.asarray(frame)[:3, 3]))
    n, factors = robot.num_joints, np.ones(len(tree.parents))
    for k, mimic in enumerate(robot.mimics):
        factors[n + k] = abs(float(mimic.factor))
    most = np.maximum(np.abs(robot.lower), np.abs(robot.upper))
    offset = lambda k: abs(float(robot.mimics[k - n].offset)) if k >= n else 0.0
    slide = lambda k: factors[k] * most[tree.joints[k]] + offset(k) if tree.slides[k] else 0.0
    apart, reach, levers = lambda k: far(robot.parent_T_joint[k]) + slide(k), far(tip), {}
    for row in behind[::-1]:
        levers[row] = reach
        reach += apart(row)
    for row in before:
        reach += apart(row)
        levers[row] = reach
    chain = [*before[::-1], *behind]
    rows = np.zeros((len(chain), n))
    rows[range(len(chain)), [tree.joints[row] for row in chain]] = [factors[row] for row in chain]
    turns = np.array([not tree.slides[row] for row in chain], float)
    lever = np.where(turns > 0.0, [levers[row] for row in chain], 1.0)
    later = np.maximum.outer(np.arange(len(chain)), np.arange(len(chain)))
    sooner = np.minimum.outer(np.arange(len(chain)), np.arange(len(chain)))
    return rows, (lever[later] * turns[sooner], turns, lever)
