"""What became of a motion: the first sample at which it fails, and why."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxik.reasons import Reason
from jaxik.robot.chain import Chain
from jaxik.robot.reach_bound import reach_bound
from jaxik.robot.task import Task
from jaxik.spmd import kernel

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
    count, index = len(course.q), jnp.arange(len(course.q))
    columns = [jnp.broadcast_to(x, (count, *jnp.shape(x)[1:])) for x in map(jnp.asarray, course)]
    judge = jax.vmap(lambda *moment: _moment(chain, task, tolerance, bool(keep), *moment))
    lost, outside, late, well, beyond, moves = jnp.moveaxis(judge(*columns, columns[4][:1].repeat(count, 0)), 1, 0)
    fails = lost | outside | late
    k = jnp.argmax(fails)
    since = (index >= jnp.max(jnp.where(well & (index < k), index, 0))) & (index <= k)
    behind = jnp.where(jnp.any((columns[3] > 0.0) & since), Reason.SINGULAR, Reason.NOT_CONVERGED)
    behind = jnp.where(jnp.any(columns[5] & since) | outside[k], Reason.LIMITS, behind)
    behind = jnp.where(late[0], Reason.NOT_CONVERGED, behind)
    stretched = jnp.any(beyond & (index >= k)) & late[k]  # an arm is stretched there, and late already before
    failed = jnp.where(lost[k], Reason.INVALID, jnp.where(stretched, Reason.OUT_OF_REACH, behind))
    any_moves, any_fails = jnp.any(moves), jnp.any(fails)
    well_done = jnp.where(any_moves, Reason.SOLVED, Reason.STILL)
    return jnp.where(any_fails, failed, well_done), jnp.where(any_fails, k, jnp.where(any_moves, count, 0))


@kernel(models=4)
def _moment(
    chain: Chain,
    task: Task,
    tolerance: float,
    keep: bool,
    q: Any,
    qdot: Any,
    error: Any,
    damping: Any,
    pose: Any,
    held: Any,
    costs: Any,
    first: Any,
) -> Any:
    """Of a sample, beside the `first` pose: whether it is lost, outside of the limits, late, well, beyond reach, and moved."""
    finite = [jnp.all(jnp.isfinite(x)) for x in (q, qdot, error, pose, costs)]
    lost = ~jnp.all(jnp.stack(finite))
    lower, upper, fastest = (jnp.asarray(bound, q.dtype) for bound in (chain.lower, chain.upper, chain.velocity))
    near = 1e-6 * (1.0 + jnp.abs(q))
    outside = (q < lower - near) | (q > upper + near) | (jnp.abs(qdot) > (1.0 + FASTER) * fastest)
    away = jnp.max(jnp.abs(error), initial=0.0)
    moved = jnp.any(jnp.abs(pose - first) > 100.0 * jnp.finfo(q.dtype).eps)
    late = ~(away <= tolerance) & ~lost
    return jnp.stack([lost, jnp.any(outside) & keep & ~lost, late, away <= 0.1 * tolerance, _beyond(chain, task, pose), moved])


def _beyond(chain: Chain, task: Task, pose: Any) -> Any:
    """Whether a pose asks for a position that no configuration has, by the components that are bound."""
    bounds = reach_bound(chain, False)
    apart = pose[:3, 3] - jnp.asarray(bounds.origin, pose.dtype)
    if task.axes == "tool":
        apart = pose[:3, :3].T @ apart
    return jnp.linalg.norm(apart[jnp.array(task.positions, int)]) > bounds.longest
