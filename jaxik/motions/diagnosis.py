"""Judgement of a motion: the first sample at which it fails, and why."""

from __future__ import annotations

import functools
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxik.kinematics.reach_bound import reach_bound
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import Task
from jaxik.reasons import Reason
from jaxik.results import Result
from jaxik.spmd import kernel

FASTER = 1e-4  # of a joint's velocity limit, that rounding and differences of samples may add


class MotionResult(Result):
    """The base of results that `diagnose` judged: their `why` names the `sample` at which a motion fails."""

    ROW: ClassVar = "motion"
    HELP: ClassVar = {
        Reason.OUT_OF_REACH: "ask solve_ik for poses on the path first",
        Reason.LIMITS: "give it more time, begin elsewhere, or widen the limits",
        Reason.SINGULAR: "lead the path around, or free a component of the task",
        Reason.NOT_CONVERGED: "begin the path at the tip's pose, or change gain or dt",
        Reason.INVALID: "look for NaN in the path, q and the cost",
        Reason.STILL: "give the path a length",
    }

    def _words(self, reason: Reason, row: int) -> str:
        words = super()._words(reason, row)
        if reason in (Reason.SOLVED, Reason.STILL):
            return words
        sample: Any = np.ravel(getattr(self, "sample"))[row]  # noqa: B009  # each subclass declares it
        return words.replace(reason.text, f"{reason.text} at sample {int(sample)}", 1)


class Course(NamedTuple):
    """A motion's samples: q and qdot (k, n), the tip's error (k, m) [m, rad], the damping (k,), the pose (k, 4, 4) that was
    asked, whether limits held a joint back (k,), and the cost of each (k,)."""

    q: Any
    qdot: Any
    error: Any
    damping: Any
    pose: Any
    held: Any = False
    costs: Any = 0.0


def diagnose(robot: Robot, task: Task, course: Course, tolerance: float, keep: bool) -> tuple[Any, Any]:
    """The `Reason` and the sample where it happened, the number of samples where all is well. Traced.

    A motion fails where something is not a number, its cost included (INVALID), where a joint passes the limits of position or
    velocity that it should `keep` (LIMITS), and where the tip's error exceeds `tolerance` in a component: because the path
    leaves the workspace (OUT_OF_REACH), or because since the tip began to fall behind a joint was held back by its limits
    (LIMITS) or damping acted (SINGULAR), or else for no reason but that its loop is not closed well, or that it begins
    elsewhere (NOT_CONVERGED). A path without length is STILL.
    """
    index = jnp.arange(len(course.q))
    q, qdot, error, damping, pose, held, costs = (jnp.broadcast_to(x, (len(index), *jnp.shape(x)[1:])) for x in course)
    moment = functools.partial(_moment, robot, task, float(tolerance), bool(keep), pose[0])
    lost, outside, late, well, beyond, moved = jax.vmap(moment)(q, qdot, error, pose, costs)
    fails = lost | outside | late
    first, moves = jnp.argmax(fails), jnp.any(moved)
    begins = jnp.max(jnp.where(well & ~fails & (index < first), index, 0))  # where the tip was last where it should be
    acted = lambda each: jnp.any(each & (begins <= index) & (index <= first))
    reason = jnp.where(acted(damping > 0.0), int(Reason.SINGULAR), int(Reason.NOT_CONVERGED))
    reason = jnp.where(acted(held) | outside[first], int(Reason.LIMITS), reason)
    reason = jnp.where(late[0], int(Reason.NOT_CONVERGED), reason)
    reason = jnp.where(lost[first], int(Reason.INVALID), reason)
    stretched = late[first] & jnp.any(beyond & (index >= first))  # an arm is stretched there, and late already before
    reason = jnp.where(stretched, int(Reason.OUT_OF_REACH), reason)
    well_done = jnp.where(moves, int(Reason.SOLVED), int(Reason.STILL))
    failed, reached = jnp.any(fails), jnp.where(moves, len(index), 0)
    return jnp.where(failed, reason, well_done), jnp.where(failed, first, reached)


@kernel(models=4)
def _moment(
    robot: Robot, task: Task, tolerance: float, keep: bool, first: Any, q: Any, qdot: Any, error: Any, pose: Any, costs: Any
) -> tuple[Any, ...]:
    """Whether a sample is lost, outside of the limits, late, well, beyond reach, and has moved from the `first` pose."""
    finite = [jnp.all(jnp.isfinite(x)) for x in (q, qdot, error, pose, costs)]
    lost = ~jnp.all(jnp.stack(finite))
    lower, upper, fastest = (jnp.asarray(bound, q.dtype) for bound in (robot.lower, robot.upper, robot.velocity))
    near = 1e-6 * (1.0 + jnp.abs(q))
    outside = (q < lower - near) | (q > upper + near) | (jnp.abs(qdot) > (1.0 + FASTER) * fastest)
    away = jnp.max(jnp.abs(error), initial=0.0)
    moved = jnp.any(jnp.abs(pose - first) > 100.0 * jnp.finfo(q.dtype).eps)
    late = ~(away <= tolerance) & ~lost
    return lost, jnp.any(outside) & keep & ~lost, late, away <= 0.1 * tolerance, _beyond(robot, task, pose), moved


def _beyond(robot: Robot, task: Task, pose: Any) -> Any:
    """Whether a pose asks for a position that no configuration has, by the components that are bound."""
    bounds = reach_bound(robot, False)
    apart = pose[:3, 3] - jnp.asarray(bounds.origin, pose.dtype)
    if task.axes == "tool":
        apart = pose[:3, :3].T @ apart
    return jnp.linalg.norm(apart[jnp.array(task.positions, int)]) > bounds.longest
