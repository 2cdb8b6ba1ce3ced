"""What became of a motion: the first sample at which it fails, and why."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxik.reasons import Reason
from jaxik.robot.chain import Chain
from jaxik.robot.reach_bound import reach_bound
from jaxik.robot.task import Task

FASTER = 1e-4  # of a joint's velocity limit, that rounding and differences of samples may add


class Course(NamedTuple):
    """A motion's samples: q and qdot (k, n), the tip's error (k, m) [m, rad], the damping (k,), the pose (k, 4, 4) that was
    asked, whether limits held a joint back (k,), and what each costs (k,)."""

    q: Any
    qdot: Any
    error: Any
    damping: Any
    pose: Any
    held: Any = False
    costs: Any = 0.0


def diagnose(chain: Chain, task: Task, course: Course, tolerance: float, keep: bool) -> tuple[Any, Any]:
    """The `Reason` and the sample where it happened, the number of samples where all is well. Traced.

    A motion fails where something is not a number, its cost included (INVALID), where a joint passes the limits of position or
    velocity that it should `keep` (LIMITS), and where the tip's error exceeds `tolerance` in a component: because the path
    leaves the workspace (OUT_OF_REACH), or because since the tip began to fall behind a joint was held back by its limits
    (LIMITS) or damping acted (SINGULAR), or else for no reason but that its loop is not closed well, or that it begins
    elsewhere (NOT_CONVERGED). A path without length is STILL.
    """
    count = len(course.q)
    finite = lambda x: jnp.all(jnp.isfinite(x.reshape(count, -1)), axis=1)
    costs = jnp.broadcast_to(jnp.asarray(course.costs), count)
    lost = ~(finite(course.q) & finite(course.qdot) & finite(course.error) & finite(course.pose) & finite(costs))
    near = 1e-6 * (1.0 + jnp.abs(course.q))
    lower, upper, fastest = (jnp.asarray(bound, course.q.dtype) for bound in (chain.lower, chain.upper, chain.velocity))
    outside = (course.q < lower - near) | (course.q > upper + near) | (jnp.abs(course.qdot) > (1.0 + FASTER) * fastest)
    outside = jnp.any(outside, axis=1) & keep & ~lost
    late = ~(jnp.max(jnp.abs(course.error), axis=1) <= tolerance) & ~lost
    fails = lost | outside | late
    k, index = jnp.argmax(fails), jnp.arange(count)
    well = (jnp.max(jnp.abs(course.error), axis=1) <= 0.1 * tolerance) & (index < k)
    since = (index >= jnp.max(jnp.where(well, index, 0))) & (index <= k)
    beyond = jnp.any(_beyond(chain, task, course.pose) & (index >= k))  # an arm is stretched there, and late already before
    behind = jnp.where(jnp.any(course.damping * since > 0.0), Reason.SINGULAR, Reason.NOT_CONVERGED)
    behind = jnp.where(jnp.any(course.held & since) | outside[k], Reason.LIMITS, behind)
    behind = jnp.where(late[0], Reason.NOT_CONVERGED, behind)
    failed = jnp.where(lost[k], Reason.INVALID, jnp.where(beyond & late[k], Reason.OUT_OF_REACH, behind))
    moves = jnp.any(jnp.abs(course.pose - course.pose[0]) > 100.0 * jnp.finfo(course.q.dtype).eps)
    well_done = jnp.where(moves, Reason.SOLVED, Reason.STILL)
    any_fails = jnp.any(fails)
    return jnp.where(any_fails, failed, well_done), jnp.where(any_fails, k, jnp.where(moves, count, 0))


def _beyond(chain: Chain, task: Task, pose: Any) -> Any:
    """Which poses ask for a position that no configuration has, by the components that are bound."""
    bounds = reach_bound(chain, False)
    apart = pose[:, :3, 3] - jnp.asarray(bounds.origin, pose.dtype)
    if task.axes == "tool":
        apart = jnp.einsum("kji,kj->ki", pose[:, :3, :3], apart)
    return jnp.linalg.norm(apart[:, list(task.positions)], axis=1) > bounds.longest
