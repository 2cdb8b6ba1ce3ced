"""Newton steps for the branches that a closed form leaves short of digits. [Murray, Li and Sastry 1994, ch. 3.4]

Right angles written as 1.5708 are off by 4e-6 rad; then a wrist's axes miss their point by a micrometre, and a closed form that
takes them to meet misses the pose by as much. And where an ellipse touches a circle a branch has half its digits. Some steps on
the arm as it is mend both.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik.analytic.families import Solver
from jaxik.analytic.turns import ELLIPSE
from jaxik.kinematics.forward import jacobian_columns, joint_frames
from jaxik.optimise.linear import definite_solve, dot
from jaxik.spatial.algebra import Frame, traced

EXACT = 1e-13  # [m, rad] by which axes may miss without it
STEPS = 4
CLOSE = 1e-10  # [m, rad] of a pose, once mended
EDGE = 1e-4  # of a margin, by which a branch may seem to have ended where the steps find that it has not


def polished(solver: Solver, pose: Any, q: Any, margins: Any) -> tuple[Any, Any]:
    """Branches q (m, n) and their margins (m,), after some steps of the solved joints towards the pose (4, 4); a branch that
    does not come close has no margin. As they are where they need no steps, and in float32."""
    eps = float(jnp.finfo(q.dtype).eps)
    if eps > EXACT or (solver.misfit <= EXACT and solver.family.cost != ELLIPSE):
        return q, margins
    aim = Frame.of_entries(traced(pose))

    def branch(carry: None, row: Any) -> tuple[None, Any]:
        q, margin = row
        q = lax.fori_loop(0, STEPS, lambda _, q: q + _step(solver, q, aim), q)
        left = jnp.max(jnp.abs(jnp.stack(_look(solver, q, aim)[1])))
        there = (left <= CLOSE) & (margin >= -EDGE)
        return None, (q, jnp.where(there, jnp.maximum(margin, 0.0), -jnp.maximum(left, EXACT)))

    return lax.scan(branch, None, (q, margins))[1]


def _step(solver: Solver, q: Any, aim: Frame) -> Any:
    """The least step (n,) of the solved joints towards the pose; none next to a singularity, where it would be long."""
    columns, away = _look(solver, q, aim)
    rows = [list(row) for row in zip(*columns, strict=True)]
    squares = [[dot(a, b) for b in rows[: i + 1]] for i, a in enumerate(rows)]
    for i, row in enumerate(squares):
        row[i] = row[i] + 1e-12
    pull = definite_solve(squares, away, 1e-12)
    step = jnp.stack([dot(each, pull) for each in columns])
    step = jnp.where(jnp.max(jnp.abs(step)) < 0.1, step, 0.0)
    return jnp.zeros_like(q).at[np.array(solver.solved)].set(step)


def _look(solver: Solver, q: Any, aim: Frame) -> tuple[list[Any], list[Any]]:
    """The Jacobian's columns of the solved joints, and how far the tip is from the pose, in base axes."""
    frames = joint_frames(solver.robot, list(q), dtype=q.dtype)
    turn = aim.rotation @ frames.tip.rotation.T
    skew = [(turn[i][j] - turn[j][i]) * 0.5 for i, j in ((2, 1), (0, 2), (1, 0))]
    columns = jacobian_columns(solver.robot, frames)[solver.first : solver.solved.stop]
    return columns, [*(aim.translation - frames.tip.translation), *skew]
