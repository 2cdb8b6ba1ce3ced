"""The result of inverse kinematics: answers, or reasons, and their words."""

from __future__ import annotations

import dataclasses
import functools
import sys
from collections.abc import Sequence
from typing import Any, ClassVar

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxik.collision.contact_report import Contact, explain
from jaxik.ik.nearest import nearest_words
from jaxik.ik.problem import FAULTS
from jaxik.pytree import static
from jaxik.reasons import Reason
from jaxik.results import Result

HARDLY = 1e-6  # [m, rad], an error that is not told


class Offenders(tuple[tuple[Contact, ...], ...]):
    """The contacts in the way of each target of a batch; they print as a line a target that has any."""

    def __str__(self) -> str:
        return "\n".join(f"target {i}: {'; '.join(map(str, each))}" for i, each in enumerate(self) if each)


class IKResult(Result):
    """The answers of `solve_ik`, or the reasons why there are none: one entry a target; a single target's entries themselves.

    q (n,) [rad, m] is the answer, or, where there is none, the nearest miss inside the limits (NaN for a target that is invalid
    or proven out of reach: it is not searched for). position_error [m] and rotation_error [rad] belong to q, in float64;
    clearance [m] too (to the scene and to itself; NaN where nothing is checked). seed is the number of the seed that led to q,
    iterations the SQP steps from there. solutions (k, n) holds all different answers, best first, NaN where there are no more;
    num_solutions counts them. fault is what makes a target INVALID, a number of `FAULTS`, else 0; `why` says it in words.

    With a list of tips, or of tasks, position_error and rotation_error have a last axis (k,) of theirs, and task is the number
    of the one that the reason is of, -1 where it is of all or of none. beyond is how far a target lies past what the reach
    bound of its tip allows [m], 0 where it does not. Where task and `other` contradict each other, and with `nearest=True` the
    reason is NEAREST, too, apart (2,) is how far what they allow is apart at least [m, rad].

    With `nearest=True` the reason NEAREST says that q is the posture nearest to a target that has no answer; distance is how
    far it is [m], by `metres_per_radian`, and no posture is nearer than least_distance [m]; proven says whether the two are the
    same but for the tolerance. `why` tells how far, and which joints are at their limits. NaN and False without it.
    """

    q: Float[np.ndarray, "*b n"]
    reason: Int[np.ndarray, "*b"] | Any  # `| Any`: a single target's is a number, and who reads many need not ask
    position_error: Float[np.ndarray, "*b"] | Any
    rotation_error: Float[np.ndarray, "*b"] | Any
    clearance: Float[np.ndarray, "*b"] | Any
    seed: Int[np.ndarray, "*b"] | Any
    iterations: Int[np.ndarray, "*b"] | Any
    solutions: Float[np.ndarray, "*b k n"]
    num_solutions: Int[np.ndarray, "*b"] | Any
    fault: Int[np.ndarray, "*b"] | Any = 0
    task: Int[np.ndarray, "*b"] | Any = -1
    beyond: Float[np.ndarray, "*b"] | Any = 0.0
    other: Int[np.ndarray, "*b"] | Any = -1
    apart: Float[np.ndarray, "*b 2"] | Any = 0.0
    distance: Float[np.ndarray, "*b"] | Any = np.nan
    proven: Bool[np.ndarray, "*b"] | Any = False
    least_distance: Float[np.ndarray, "*b"] | Any = np.nan
    tasks: tuple[str, ...] = static(default=())  # their names, where there is a list of them
    solved_in: Any = static(default=None)  # robot, scene or one a target, margin
    joints: Any = static(default=None)  # where the nearest was asked for: what tells which joints bind
    ROW: ClassVar = "target"
    HELP: ClassVar = {
        Reason.OUT_OF_REACH: "check its unit, its frame, which is the robot's base, and the robot's tip, or move one of them",
        Reason.LIMITS: "free components by task=, or move the target or the base",
        Reason.COLLISION: "`offenders` names what is in the way; a free component or more max_seeds may lead around it",
        Reason.NOT_CONVERGED: "raise max_seeds",
        Reason.CONTRADICTION: "widen one of them, move its target, or give one a weight",
    }

    @property
    def why(self) -> Any:
        """The reasons in words, with what would help, or what is wrong with an INVALID target; of a batch an array of texts."""
        fault, words = np.asarray(self.fault, int), super().why
        if fault.any():
            words = np.where(fault > 0, np.array([f"{Reason.INVALID}: {text}" for text in FAULTS])[fault], words)
        words = self._with_misses(self._with_nearest(words))
        if self.tasks and (np.asarray(self.task) >= 0).any():
            each = zip(np.ravel(words), map(self._blamed, range(len(self))), strict=True)
            words = np.array([f"{blamed}: {text}" if blamed else text for text, blamed in each], str)
            words = words.reshape(np.shape(self.task))
        return words if np.ndim(words) else str(words)

    def _blamed(self, row: int) -> str:
        """The task that the reason of a row is of, or the two, and how far they are off; "" where it is of all or of none."""
        task, other = (int(np.ravel(x)[row]) for x in (self.task, self.other))
        if task < 0:
            return ""
        if other < 0:
            beyond = float(np.ravel(self.beyond)[row])
            return f"{self.tasks[task]}{f', {beyond:.3g} m past its reach bound' if beyond > 0.0 else ''}"
        apart = _off(*np.reshape(self.apart, (-1, 2))[row])
        return f"{self.tasks[task]} and {self.tasks[other]}, {apart} apart at least"

    def _with_misses(self, words: Any) -> Any:
        """The words, where the reason is NOT_CONVERGED how far the nearest posture that was found is off, by each task."""
        rows = np.flatnonzero(np.ravel(self.reason) == Reason.NOT_CONVERGED)
        if not len(rows):
            return words
        told, names = np.ravel(words).astype(object), self.tasks or ("",)
        errors = [np.reshape(x, (len(told), -1)) for x in (self.position_error, self.rotation_error)]
        for row in rows:
            each = [(name, _off(*both)) for name, *both in zip(names, *(x[row] for x in errors), strict=True)]
            if np.isfinite([x[row] for x in errors]).all() and any(off for _, off in each):
                misses = ", ".join(f"{name} off by {off}".strip() if off else f"{name} met" for name, off in each)
                first, *mend = str(told[row]).split("; ", 1)
                told[row] = "; ".join([first, f"the nearest found: {misses}", *mend])
        return told.astype(str).reshape(np.shape(self.reason))

    def _with_nearest(self, words: Any) -> Any:
        """The words, where the reason is NEAREST how far the posture is, and what binds."""
        rows = np.flatnonzero(np.ravel(self.reason) == Reason.NEAREST)
        if not len(rows):
            return words
        told, shape = np.ravel(words).astype(object), np.shape(words)
        flat = lambda x: np.reshape(x, (len(told), -1))
        q, away, turned, certain = (flat(x) for x in (self.q, self.position_error, self.rotation_error, self.proven))
        clash = np.ravel(self.other) >= 0
        for row in rows:
            told[row] = nearest_words(self.joints, q[row], away[row], turned[row], bool(certain[row, 0]), bool(clash[row]))
        return told.astype(str).reshape(shape)

    @functools.cached_property
    def offenders(self) -> tuple[Any, ...]:
        """The `Contact`s below the margin at q of a target that ended in COLLISION, nearest first; () for another reason.
        A batch has one such tuple a target, one line each in print. Looked up when first asked."""
        if not self.single:
            return Offenders(row.offenders for row in self)
        if self.reason != Reason.COLLISION or self.solved_in is None:
            return ()
        robot, scene, margin = self.solved_in
        found = explain(robot, scene, self.q, count=sys.maxsize, below=margin).contacts
        return found or explain(robot, scene, self.q, count=1).contacts  # rounding may put the nearest on the margin itself

    def __getitem__(self, rows: Any) -> IKResult:
        found = super().__getitem__(rows)
        if self.solved_in is None or self.single or not isinstance(self.solved_in[1], tuple):
            return found
        robot, scenes, margin = self.solved_in
        numbers = np.arange(len(scenes))[rows]
        own = tuple(scenes[i] for i in numbers) if numbers.ndim else scenes[int(numbers)]
        return dataclasses.replace(found, solved_in=(robot, own, margin))

    @staticmethod
    def joined(parts: Sequence[IKResult]) -> IKResult:
        """Joins batches, at least one, one after another; as many solutions wide as the widest."""
        if len(parts) == 1:
            return parts[0]
        width = max(part.solutions.shape[1] for part in parts)
        fill = lambda x: np.pad(x, ((0, 0), (0, width - x.shape[1]), (0, 0)), constant_values=np.nan)
        wide = [dataclasses.replace(part, solutions=fill(part.solutions)) for part in parts]
        return jax.tree_util.tree_map(lambda *columns: np.concatenate(columns), *wide)


def _off(away: float, turned: float) -> str:
    """Two errors [m], [rad] in words, what is hardly any left out."""
    parts = [f"{away:.3g} m"] * bool(away > HARDLY), [f"{np.degrees(turned):.3g} deg"] * bool(turned > HARDLY)
    return " and ".join([*parts[0], *parts[1]])
