"""The answer of a replanner: a course that is proven, and why it is that one."""

from __future__ import annotations

import enum
import functools
from typing import Any, NamedTuple

import numpy as np

from jaxik.collision.contact_report import explain
from jaxik.collision.scene import Scene
from jaxik.kinematics.motion import Motion
from jaxik.kinematics.robot import Robot
from jaxik.planning.plan_result import ESCAPES, Place, PlanResult
from jaxik.pytree import Pytree, replaced, static
from jaxik.reasons import Reason
from jaxik.replanning.course import Course


class Event(enum.StrEnum):
    """The kinds of what an update does."""

    KEPT = enum.auto()  # the motion goes on
    REPLANNED = enum.auto()  # a new way to the goal
    STOPPING = enum.auto()  # it brakes, and there is no way to the goal yet
    BLOCKED = enum.auto()  # it stands, and there is no way to the goal, or something is too near (`late`)
    ARRIVED = enum.auto()  # it stands in the goal, or where it was made while there is none


WORDS = {
    Event.KEPT: "the motion is proven in the world as it is",
    Event.REPLANNED: "there is a new way to the goal",
    Event.STOPPING: "the robot brakes, and no way to the goal is known",
    Event.BLOCKED: "the robot stands, and no way to the goal is known",
    Event.ARRIVED: "the robot stands where it is to go",
}


class Refusal(NamedTuple):
    """Why there is no motion, as a `PlanResult` has it: its reason, where, its configurations (2, n), and its rounds."""

    reason: int
    where: str
    stuck: np.ndarray
    rounds: int

    @classmethod
    def of(cls, found: PlanResult) -> Refusal:
        return cls(int(found.reason), str(found.where), np.asarray(found.stuck), int(found.rounds))

    def why(self, place: Place) -> str:
        """The reason in words, looked up in the place where the motion was asked for."""
        found = PlanResult(Reason(self.reason), self.where, stuck=self.stuck, rounds=self.rounds, planned_in=place)
        return str(found.why).removesuffix(f"; {ESCAPES}")  # which is no option here: it cannot be proven


class Command(Pytree):
    """The answer to an update at a `time` [s]: the `course` from then on, proven in the world as it was told, and what the
    update did (`event`).

    hit (n,): a configuration near which the course before met something; None where it met nothing.
    late: whether that is so near that the robot cannot stop before it: it brakes as soon as it can, and what is left of its way
        is not proven; or it stands, and something is nearer than the margin. A course that is not late is proven.
    refusal: why no way to the goal is known; None where there is one.
    place: the robot, the world and the margin, in which `why` is looked up when it is first asked for.
    """

    time: float
    event: Event = static()
    course: Course
    hit: Any = None
    late: bool = static(default=False)
    refusal: Refusal | None = None
    place: Any = static(default=None)

    def __eq__(self, other: object) -> bool:
        """Whether another command is the same to the last bit, wherever its reasons are looked up."""
        if not isinstance(other, Command):
            return False
        return Pytree.__eq__(replaced(self, place=None), replaced(other, place=None))

    __hash__ = Pytree.__hash__

    def at(self, times: Any) -> Motion:
        """The set points at times () or (i,) [s] from that of the command on: q, velocity and acceleration. Host."""
        return self.course.at(times)

    @functools.cached_property
    def why(self) -> str:
        """The words that say what the update did, and what stands in the way."""
        words = [WORDS[self.event]]
        if self.event in (Event.KEPT, Event.ARRIVED) and not self.late:
            return words[0]
        stands = self.late and self.event is Event.BLOCKED
        if self.late and self.event is Event.KEPT:
            words = ["the motion goes on, and is not proven"]
        elif stands:
            words = ["the robot stands too near to something"]
        if self.hit is not None and self.place is not None:
            near = explain(self.place.robot, self.place.scene, self.hit, count=1).contacts
            words += [f"{'on the former way ' * (not stands)}{near[0]}"] if near else []
        words += ["which is too near to stop before it"] * (self.late and not stands)
        if self.refusal is not None and self.place is not None and not (stands and self.refusal.where == "start"):
            words.append(self.refusal.why(self.place))
        return "; ".join(words)


def place_of(robot: Robot, scene: Scene | None, margin: float, weights: np.ndarray) -> Place:
    """The place in which reasons are looked up."""
    return Place(robot, scene, margin, np.asarray(robot.lower), np.asarray(robot.upper), weights, escape=False)
