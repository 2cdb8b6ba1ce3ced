"""Two arms of a plan at the same time: by how much tours make them wait, and when each stage begins.

Each arm's motions are proven free of what stands, with the fruits of the other arm among it. A fruit that the other arm has
picked in a round before is no obstacle any more: where a motion would touch it, that begins after it is in the other's hand.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxik.harvesting.arm_planner import ArmPlanner, Part, Tour
from jaxik.harvesting.harvest_plan import Stage
from jaxik.harvesting.meeting import STEP, Meeting, Timeline, soonest, starts
from jaxik.kinematics.robot import Robot
from jaxik.planning.collision_checker import touched
from jaxik.reach.grasp import without


class Schedule(NamedTuple):
    """When the stages of each arm begin [s], how long all takes [s], and by how much longer because an arm waits [s]."""

    starts: list[np.ndarray]
    makespan: float
    waits: float


class Together:
    """Two arms, whose planners know of nothing but themselves. Raises `ValueError` where they touch at home."""

    def __init__(self, robot: Robot, planners: Sequence[ArmPlanner]):
        self.planners = planners
        limits = [each.limits.acceleration for each in planners]
        self.meeting = Meeting(robot, [each.arm for each in planners], limits, planners[0].options.margin)
        home = np.zeros(robot.num_joints)
        for each in planners:
            home[list(each.arm.joints)] = each.home
        if self.meeting.checker((0, 0)).hits(home[None])[0]:
            raise ValueError("plan_harvest: home: the arms touch each other; give home=, where they are apart")

    def waits(self, tours: Sequence[Tour]) -> float:
        """Returns by how much longer all takes [s] because arms wait, with tours after what is driven; infinite where they
        cannot but meet."""
        found = self._schedule([*map(ArmPlanner.whole, self.planners, tours)])
        return np.inf if found is None else found.waits

    def scheduled(self) -> list[Stage]:
        """Returns all stages, as they begin."""
        stages = [each.stages() for each in self.planners]
        found = self._schedule([*map(ArmPlanner.whole, self.planners)])
        assert found is not None  # each round was asked whether it fits
        timed = [
            stage._replace(start=float(start))
            for own, when in zip(stages, found.starts, strict=True)
            for stage, start in zip(own, when, strict=True)
        ]
        return sorted(timed, key=lambda stage: stage.start)

    def makespan(self) -> float:
        """Returns how long all that is planned takes [s]; infinite where the arms cannot but meet."""
        found = self._schedule([*map(ArmPlanner.whole, self.planners)])
        return np.inf if found is None else found.makespan

    def _schedule(self, parts: Sequence[Sequence[Part]]) -> Schedule | None:
        number = self.meeting.number
        held = [[number(i, part.held) for part in own] for i, own in enumerate(parts)]
        lines = [
            Timeline.of([part.trajectory for part in own], numbers, each.home)
            for own, numbers, each in zip(parts, held, self.planners, strict=True)
        ]
        free = self.meeting.free(lines)
        for i, own in enumerate(parts):
            view = free if i == 0 else free.T
            for k in range(len(own)):
                view[lines[i].rest[k] : lines[i].rest[k + 1], : self._after(i, k, parts, lines)] = False
        way = soonest(free, [line.rest for line in lines])
        if way is None:
            return None
        takes, longest = len(way[0]) - 1, max(1, *free.shape)
        times = [starts(clock, line.rest) for clock, line in zip(way, lines, strict=True)]
        return Schedule(times, STEP * takes, STEP * (takes - longest))

    def _after(self, i: int, k: int, parts: Sequence[Sequence[Part]], lines: Sequence[Timeline]) -> int:
        """The step of the other arm's clock before which stage `k` of an arm may touch a fruit that it takes for picked: 0 of
        none, beyond the last of one that the arm picks itself later."""
        part, (own, other) = parts[i][k], (lines[i], lines[1 - i])
        taken = [{p.fruit: n for n, p in enumerate(each) if p.kind == "retreat"} for each in parts]
        when = {fruit: int(other.rest[n]) for fruit, n in taken[1 - i].items() if fruit in part.gone}
        when |= {fruit: int(other.rest[-1]) + 1 for fruit, n in taken[i].items() if fruit in part.gone and n > k}
        when.pop(part.fruit, None)
        if not when:
            return 0
        planner = self.planners[i]
        arm, margin = planner.robot if part.held is None else part.held, planner.options.margin
        scene = without(planner.scene, [part.fruit])
        q = own.q[own.rest[k] : own.rest[k + 1] + 1]
        weights, bent = self.meeting.moves(i)
        far = float(np.max(np.abs(np.diff(q, axis=0)) @ weights)) + bent
        hit = touched(arm, scene, q, margin + far).any(axis=0)
        if part.kind == "retreat":  # what touches a fruit where it hangs is no obstacle to it
            hit &= ~touched(arm, scene, q[:1], margin)[0]
        names = {scene.object_names[i] for i in np.flatnonzero(hit)}
        return max((step for fruit, step in when.items() if fruit in names), default=0)
