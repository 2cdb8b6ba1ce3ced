"""A tool's path in several postures: where it lifts off, moves, and comes back; and the whole as one path of joints.

The tool lifts off straight against its own z axis, as far as the arm can, a motion among obstacles leads to the next posture,
and it comes back the same way.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxik.collision.scene import Scene
from jaxik.planning.planner import plan_motion
from jaxik.planning.tool_follow import Followed
from jaxik.planning.tool_line import ToolLine
from jaxik.planning.tool_options import PathOptions
from jaxik.planning.tool_proof import Proven
from jaxik.planning.tool_result import Arc
from jaxik.planning.trajectory import JointPath, straight
from jaxik.reasons import Reason

STRIDE = 0.005  # [m] of a lift


class Joined(NamedTuple):
    """The whole as one path of joints; which of its pieces (k,) are on the tool's path; and where each part begins on it, and
    at which s of the tool's path (p,)."""

    path: JointPath
    tool: np.ndarray
    begins: np.ndarray
    since: np.ndarray

    def places(self, s: np.ndarray, part: np.ndarray) -> np.ndarray:
        """Where on the whole path the tool is at each s (N,), in such parts (N,)."""
        return self.begins[part] + s - self.since[part]


def joined(
    follow: Followed, line: ToolLine, parts: Sequence[Proven], scene: Scene | None, options: PathOptions, seed: int
) -> Joined | Arc:
    """The parts with the motions between them, or where there is none."""
    pieces, tool, begins, length = [parts[0].path], [np.ones(len(parts[0].path.lengths), bool)], [0.0], 0.0
    for before, after in itertools.pairwise(parts):
        away, back = (
            _lifted(follow, before.q[-1], line, before.s[-1], options.lift),
            _lifted(follow, after.q[0], line, after.s[0], options.lift),
        )
        moved = plan_motion(follow.robot, away[-1], back[-1], scene=scene, seed=seed, margin=options.margin)
        if not moved:
            first, last = line.span(before.s[-1], after.s[0])
            words = (
                f"the tool would have to lift off and come back in another posture, and no motion there was found: {moved.why}"
            )
            return Arc(first, last, float(before.s[-1]), float(after.s[0]), Reason.SINGULAR, words)
        between = straight(np.concatenate([away, moved.waypoints[1:-1], back[::-1]]))
        pieces += [between, after.path]
        tool += [np.zeros(len(between.lengths), bool), np.ones(len(after.path.lengths), bool)]
    for on, off in zip(pieces[:-1:2], pieces[1::2], strict=True):
        length += float(np.sum(on.lengths) + np.sum(off.lengths))
        begins.append(length)
    lengths = np.concatenate([np.asarray(piece.lengths) for piece in pieces])
    curves = np.concatenate([np.asarray(piece.coefficients) for piece in pieces])
    return Joined(JointPath(lengths, curves), np.concatenate(tool), np.array(begins), np.array([part.s[0] for part in parts]))


def _lifted(follow: Followed, q: np.ndarray, line: ToolLine, s: float, lift: float) -> np.ndarray:
    """Configurations (k, n) from q on, each a stride further off the path, as long as nothing is in the way."""
    pose, way = line.at(np.array([s])), [q]
    for far in np.arange(STRIDE, lift + 0.5 * STRIDE, STRIDE):
        goal = pose.copy()
        goal[:, :3, 3] -= far * pose[:, :3, 2]
        new, there = follow.brought(way[-1][None], goal)
        moved = np.abs(new[0] - way[-1])
        if not there[0] or (moved > follow.steps.most).any() or not moved.any():
            break
        if follow.space is not None and not follow.space.proven_closely(way[-1][None], new)[0]:
            break
        way.append(new[0])
    return np.array(way)
