"""The path of a tool as a line of poses: straight from each pose to the next, turning about one axis by the shorter way.

Lengths along it are s: that of a step is `sqrt(|dp|^2 + (RADIUS |turn|)^2)`, so that a turn on the spot has one, too.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

RADIUS = 0.1  # [m] that a turn by a radian counts for
EQUAL = 1e-9  # [m] of s, below which a pose is the one before it


class ToolLine(NamedTuple):
    """Poses (k, 4, 4) at increasing s (k,) [m], k >= 1, and the rotation vectors (k-1, 3) from each to the next, in base axes;
    `given` (N,) are the numbers of the poses among these that the path was given by."""

    poses: np.ndarray
    s: np.ndarray
    turns: np.ndarray
    given: np.ndarray

    @staticmethod
    def of(poses: np.ndarray) -> ToolLine:
        """The line through poses (N, 4, 4), each of which is a pose; one that is equal to the one before it counts once."""
        steps, turns = _steps(poses)
        kept = np.concatenate([[True], steps > EQUAL])
        return ToolLine(poses[kept], _since(steps[kept[1:]]), turns[kept[1:]], np.cumsum(kept) - 1)

    @property
    def length(self) -> float:
        return float(self.s[-1])

    def stations(self, spacing: float) -> np.ndarray:
        """All s of the poses, and of others between them that are no further than the `spacing` [m] apart."""
        if len(self.s) == 1:
            return self.s
        counts = np.maximum(1, np.ceil(np.diff(self.s) / spacing - 1e-9)).astype(int)
        row = np.repeat(np.arange(len(counts)), counts)
        share = (np.arange(len(row)) - np.repeat(np.cumsum(counts) - counts, counts)) / counts[row]
        return np.append(self.s[row] + share * np.diff(self.s)[row], self.s[-1])

    def pieces(self, s: np.ndarray) -> np.ndarray:
        """The number of the step that each s is in."""
        return np.clip(np.searchsorted(self.s, s, side="right") - 1, 0, max(0, len(self.s) - 2))

    def at(self, s: np.ndarray, piece: np.ndarray | None = None) -> np.ndarray:
        """The poses (b, 4, 4) at each s (b,), in such steps."""
        if len(self.s) == 1:
            return np.repeat(self.poses, len(s), axis=0)
        piece = self.pieces(s) if piece is None else piece
        share = ((s - self.s[piece]) / (self.s[piece + 1] - self.s[piece]))[:, None]
        found = self.poses[piece].copy()
        found[:, :3, 3] += share * (self.poses[piece + 1, :3, 3] - self.poses[piece, :3, 3])
        turned = self.turns[piece].any(axis=1)
        if turned.any():
            from scipy.spatial.transform import Rotation

            found[turned, :3, :3] = (
                Rotation.from_rotvec((share * self.turns[piece])[turned]).as_matrix() @ found[turned, :3, :3]
            )
        return found

    def slopes(self, piece: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The derivatives of place (b, 3) and the angular velocities (b, 3) by s in such steps, in base axes."""
        length = np.diff(self.s)[piece][:, None]
        return (self.poses[piece + 1, :3, 3] - self.poses[piece, :3, 3]) / length, self.turns[piece] / length

    def span(self, begin: float, end: float) -> tuple[int, int]:
        """The numbers of the first and the last given pose from one s to another, or else of those next to them."""
        s = self.s[self.given]
        inside = np.flatnonzero((s >= begin - EQUAL) & (s <= end + EQUAL))
        if len(inside):
            return int(inside[0]), int(inside[-1])
        after = int(np.searchsorted(s, begin))
        return max(0, after - 1), min(after, len(s) - 1)

    def moved(self, by: np.ndarray) -> ToolLine:
        """The line with all of its poses moved by a transform (4, 4) of the base."""
        return self._replace(poses=by @ self.poses, turns=self.turns @ by[:3, :3].T)


def _steps(poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The lengths (N-1,) of the steps between poses, and their turns (N-1, 3)."""
    if len(poses) < 2:
        return np.zeros(0), np.zeros((0, 3))
    from scipy.spatial.transform import Rotation

    turns = Rotation.from_matrix(poses[1:, :3, :3] @ poses[:-1, :3, :3].swapaxes(1, 2)).as_rotvec()
    turns[np.linalg.norm(turns, axis=1) < 1e-9] = 0.0
    moved = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    return np.hypot(moved, RADIUS * np.linalg.norm(turns, axis=1)), turns


def _since(steps: np.ndarray) -> np.ndarray:
    return np.concatenate([[0.0], np.cumsum(steps)])
