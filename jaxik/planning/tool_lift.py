"""A tool's path in several postures: where it lifts off, moves, and comes back; and the whole as one path of joints.

The tool lifts off straight against its own z axis, as far as the arm can, a motion among obstacles leads to the next posture,
and it comes back the same way.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxik.collision.scene import Scene
from jaxik.kinematics.joint_turns import endless, whole_turns
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
    """The whole as one path of joints, and its parts on the tool's path; which of its pieces (k,) these are; where each part
    begins on it, and at which s of the tool's path (p,)."""

    path: JointPath
    parts: tuple[Proven, ...]
    tool: np.ndarray
    begins: np.ndarray
    since: np.ndarray

    def places(self, s: np.ndarray, part: np.ndarray) -> np.ndarray:
        """Where on the whole path the tool is at each s (N,), in such parts (N,)."""
        return self.begins[part] + s - self.since[part]


def joined(
    follow: Followed, line: ToolLine, parts: Sequence[Proven], scene: Scene | None, options: PathOptions, seed: int
) -> Joined | Arc:
    """The parts with the motions between them, or where there is none. A motion may come to a part by another turn of a joint
    without limits: then this part, and those behind it, are so many turns on."""
    pieces, tool, begins, length = [parts[0].path], [np.ones(len(parts[0].path.lengths), bool)], [0.0], 0.0
    placed = [parts[0]]
    how = {name: getattr(options, name) for name in ("margin", "velocity", "acceleration")}
    for after in parts[1:]:
        before = placed[-1]
        away, back = (
            _lifted(follow, before.q[-1], line, before.s[-1], options.lift),
            _lifted(follow, after.q[0], line, after.s[0], options.lift),
        )
        if follow.space is None:  # nothing is looked at, and a line between postures inside the limits stays inside
            way = np.stack([away[-1], back[-1]])
        elif moved := plan_motion(follow.robot, away[-1], back[-1], scene=scene, seed=seed, **how):
            way = moved.waypoints
        else:
            first, last = line.span(before.s[-1], after.s[0])
            words = (
                f"the tool would have to lift off and come back in another posture, and no motion there was found: {moved.why}"
            )
            return Arc(first, last, float(before.s[-1]), float(after.s[0]), Reason.SINGULAR, words)
        turn = whole_turns(endless(follow.robot), way[-1] - back[-1])
        between = straight(np.concatenate([away, way[1:-1], back[::-1] + turn]))
        after = after.turned(turn) if np.any(turn) else after
        placed.append(after)
        pieces += [between, after.path]
        tool += [np.zeros(len(between.lengths), bool), np.ones(len(after.path.lengths), bool)]
    for on, off in zip(pieces[:-1:2], pieces[1::2], strict=True):
        length += float(np.sum(on.lengths) + np.sum(off.lengths))
        begins.append(length)
    lengths = np.concatenate([np.asarray(piece.lengths) for piece in pieces])
    curves = np.concatenate([np.asarray(piece.coefficients) for piece in pieces])
    since = np.array([part.s[0] for part in parts])
    return Joined(JointPath(lengths, curves), tuple(placed), np.concatenate(tool), np.array(begins), since)


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
