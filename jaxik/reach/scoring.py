"""The rank of a posture among obstacles; and reach as one smooth number that has a gradient in the robot's place, its shape
and the scene.

Reachable or not is a step, and a step has no slope. The score of a posture is instead the least of its margins (of clearance,
of each joint to its limits, and of the pose itself where the arm falls short), and the score of a target the best over some
postures, each smooth. Its derivative holds the tip on the target: the joints follow by `dq = J+ dr`, so nothing is solved for
while the base or a link is moved, and a posture found once serves for a whole neighbourhood.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.analytic.solutions import BRANCHES, closed_forms
from jaxik.checks.arrays import Array, as_numbers, is_known, numbers
from jaxik.checks.options import as_count, check_finite, check_kind, shown
from jaxik.collision.bvh import Grouped, grouped
from jaxik.collision.clearances import check_geometry, clearance
from jaxik.collision.scene import Scene
from jaxik.costs import joint_limit_margin
from jaxik.ik.problem import is_looked_at
from jaxik.kinematics.forward import forward_kinematics, jacobian
from jaxik.kinematics.robot import Robot
from jaxik.optimise.linear import definite_solve
from jaxik.options import Options, number
from jaxik.reach.leading_joints import arm_of, leading_grid
from jaxik.spmd import kernel
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.host import host_kernels

DAMPING = 1e-2  # [m, rad m] below which a direction counts as one that the arm cannot move in
SHORT = 0.03  # [m, rad] that the tip falls short by and that weighs as much as a joint past its limit by half its range
STEP = 0.3  # [rad, m] that a posture follows its target by: beyond, it would be another posture
WIDTH = 0.2  # of the step from 0 to 1, in margins: wide enough that a target far out of reach still has a slope


class PostureOptions(Options, who="posture"):
    """The postures that count, and how they are ranked:

        score = clearance_weight * min(D, reach) / reach + freedom_weight * F

    with the clearance D [m] and the freedom F of the least free joint (`costs.joint_limit_margin`), both terms in [0, 1] times
    their weight.
    """

    margin: float = number(default=0.0, unit="m", words="least clearance")
    clearance_weight: float = number(default=1.0, least=0.0, words="weight of the clearance in the score")
    freedom_weight: float = number(default=0.5, least=0.0, words="weight of the least free joint's freedom in the score")
    reach: float = number(
        default=0.075, above=0.0, unit="m", words="clearance beyond which more is worth nothing, as in (6) of Van Henten 2010"
    )

    def score(self, clearance: np.ndarray, freedom: np.ndarray) -> np.ndarray:
        """The scores of postures of these clearances [m] and freedoms."""
        near = self.clearance_weight * np.clip(clearance, 0.0, self.reach) / self.reach
        return near + self.freedom_weight * np.clip(freedom, 0.0, 1.0)


@host_kernels(1)
def measures(robot: Robot, q: Any, scene: Any) -> Any:
    """The kernel of clearances [m] and freedoms, by rows of q."""
    return clearance(robot, scene, q), joint_limit_margin(robot, q)


def reach_score(
    robot: Robot,
    scene: Scene | None,
    poses: Float[Array, "k 4 4"],
    q: Float[Array, "k n"],
    *,
    margin: Any = 0.0,
    temperature: Any = 0.05,
    collision: bool = True,
) -> Float[Array, ""]:
    """Scores in (0, 1) how well a target is reached by any of k postures `q` (k, n), at its alternative poses `world_T_tip`;
    above 1/2 about where one of them is clear, inside the limits and there. Traced.

        score = sigmoid(T log sum_k exp(worth_k / T) / 0.2),   worth_k = -T log sum_i exp(-margin_ki / T) - short_k / 30 mm

    with margins of clearance (1 at 75 mm) and of each joint to its limits (1 in the middle), and what the tip falls short by.

    Pure: differentiate it in `poses`, in `robot.world_T_base` (`robot.mounted(frame)`), in any number of the robot
    (`dataclasses.replace`) and in the scene. `margin` [m] is the least clearance. `temperature` T, above 0, to 1, is how much
    is smoothed: k postures of m margins count for as much as `T log k` more than the best, and `T log m` less than the least.
    Without a scene the robot keeps clear of itself; with `collision=False` no clearance counts.
    """
    score = log_reach_score(robot, scene, poses, q, margin=margin, temperature=temperature, collision=collision)
    return jnp.exp(score)


def log_reach_score(
    robot: Robot,
    scene: Scene | None,
    poses: Float[Array, "k 4 4"],
    q: Float[Array, "k n"],
    *,
    margin: Any = 0.0,
    temperature: Any = 0.05,
    collision: bool = True,
) -> Float[Array, ""]:
    """The logarithm of `reach_score`, to add up over targets and climb: it has a slope metres away too, where the score itself
    is 0 to the last bit. Traced. Raises `ValueError` for other shapes."""
    check_kind("reach_score", "robot", robot, Robot)
    robot.only_tip("reach_score")
    looked, poses, q = is_looked_at("reach_score", robot, scene, collision), as_numbers("poses", poses), as_numbers("q", q)
    if poses.shape != (*q.shape[:1], 4, 4) or q.shape[1:] != (robot.num_joints,) or not len(q):
        raise ValueError(
            f"poses {poses.shape} and q {q.shape}; {robot.name} takes (k, 4, 4) and (k, {robot.num_joints}), k >= 1"
        )
    as_numbers("margin", margin, ())
    as_numbers("temperature", temperature, ())
    if is_known(temperature) and not float(temperature) > 0.0:
        raise ValueError(f"reach_score: temperature {shown(temperature)}; allowed: above 0, to 1")
    around = grouped(scene, robot) if looked else None
    each = jax.vmap(lambda pose, posture: _worth(robot, around, pose, posture, margin, temperature))
    best = temperature * jax.nn.logsumexp(each(poses, q) / temperature)
    return jax.nn.log_sigmoid(best / WIDTH)


@kernel(models=1)
def _worth(robot: Robot, around: Grouped | None, pose: Any, q: Any, margin: Any, temperature: Any) -> Any:
    """The least margin of a posture that follows its target."""
    q, short = _following(robot, pose, jax.lax.stop_gradient(q))
    low, high = (jnp.asarray(x, q.dtype) for x in robot.finite_limits)
    share = jnp.minimum(q - low, high - q) / jnp.maximum((high - low) / 2.0, 1e-9)
    margins = [jnp.where(robot.is_limited, share, 1.0)]
    if around is not None:
        margins.append((clearance(robot, around, q) - margin)[None] / PostureOptions.reach)
    return -temperature * jax.nn.logsumexp(-jnp.concatenate(margins) / temperature) - short / SHORT


def _following(robot: Robot, pose: Any, q: Any) -> tuple[Any, Any]:
    """The posture moved after its target by one step, and how far the tip then falls short of it [m, rad]."""
    base, pose = jnp.asarray(robot.world_T_base, q.dtype), jnp.asarray(pose, q.dtype)
    wanted = base[:3, :3].T @ jnp.concatenate([pose[:3, :3], pose[:3, 3:] - base[:3, 3:]], axis=1)
    residual, columns = _twist(forward_kinematics(robot, q), wanted), jacobian(robot, q)
    damped: Any = columns @ columns.T + DAMPING**2 * jnp.eye(6, dtype=q.dtype)
    step = columns.T @ jnp.stack(definite_solve(damped, residual, 0.0))
    q = q + step * jnp.minimum(1.0, STEP / jnp.sqrt(step @ step + 1e-12))
    left = _twist(forward_kinematics(robot, q), wanted)
    return q, jnp.sqrt(left @ left + 1e-8) - 1e-4


def _twist(tip: Any, wanted: Any) -> Any:
    """The twist that carries `tip` (4, 4) to `wanted` (3, 4): the shift [m], and the turn [rad] as its sine about its axis."""
    turn = wanted[:3, :3] @ tip[:3, :3].T
    skew = (turn - turn.T) / 2.0
    return jnp.concatenate([wanted[:3, 3] - tip[:3, 3], jnp.stack([skew[2, 1], skew[0, 2], skew[1, 0]])])


class LikelyPostures(NamedTuple):
    """Alternative poses `world_T_tip` (count, 4, 4) of a target, and a posture q (count, n) for each; the best first."""

    poses: np.ndarray
    q: np.ndarray


def likely_postures(
    robot: Robot,
    scene: Scene | None,
    poses: np.ndarray,
    *,
    count: int = 8,
    slides: Any = 11,
    margin: float = 0.0,
    collision: bool = True,
) -> LikelyPostures:
    """Returns the `count` most promising of one target's alternative poses `world_T_tip` (a, 4, 4), with a posture for each: of
    all branches at `slides` positions of each leading joint, past limits and reach too, those of the best worth. Host driver.

    It is for robots with a closed form; others take the answers of `solve_ik`. Without a scene the robot keeps clear of itself;
    with `collision=False` no clearance counts. Raises `ValueError` where the robot has no closed form, or no pose is one.
    """
    looked = is_looked_at("likely_postures", robot, scene, collision)
    robot.only_tip("likely_postures")
    poses, count = numbers("likely_postures: poses", poses, ("N", 4, 4)), as_count("likely_postures: count", count)
    check_finite("likely_postures", margin=margin)
    if not np.isfinite(poses).all(axis=(1, 2)).any():
        raise ValueError(f"likely_postures: poses {poses.shape} hold no finite frame; give (a, 4, 4), world_T_tip")
    if scene is not None:
        check_geometry(robot)
    leading, base_T_world = leading_grid(robot, slides), np.linalg.inv(np.asarray(robot.world_T_base))
    local = base_T_world @ poses
    pose, lead = np.divmod(np.arange(len(poses) * len(leading)), len(leading))
    q, _, _ = in_blocks(closed_forms(arm_of(robot)), local[pose], leading[lead], double=False)
    q, pose = q.reshape(-1, robot.num_joints), np.repeat(pose, BRANCHES)
    around = grouped(None if scene is None else scene.moved(base_T_world), robot) if looked else None
    home = robot.mounted(np.eye(4))
    (worth,) = in_blocks(_worths(home), local[pose], q, fixed=(around, margin), double=False)
    best = np.argsort(-np.where(np.isfinite(worth), worth, -np.inf), kind="stable")[:count]
    return LikelyPostures(poses[pose[best]], q[best])


@host_kernels(2, known=16)
def _worths(robot: Robot, pose: Any, q: Any, around: Grouped | None, margin: Any) -> Any:
    return _worth(robot, around, pose, q, margin, 0.01)
