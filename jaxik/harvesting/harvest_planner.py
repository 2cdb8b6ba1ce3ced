"""A whole harvest in motion: to each fruit and away with it, in an order that takes little time, by one arm or by two.

Each round (`rounds`) picks what can be picked; fruits that are not picked in one are tried in the next, where the fruits before
are gone. Two arms are planned each by itself, as if the other were not there, and share the fruits so that the last one is done
soonest (`sharing`); then each stage begins when the arms do not meet (`meeting`). What the other arm picks in the same round is
an obstacle to both, as if it hung for ever.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from jaxik.checks.arrays import numbers
from jaxik.checks.options import check_kind, check_seed
from jaxik.harvesting.arm_planner import ArmPlanner
from jaxik.harvesting.arms import Arm, arms_of
from jaxik.harvesting.driver import HarvestResult
from jaxik.harvesting.harvest_plan import HarvestPlan, HarvestPlanOptions
from jaxik.harvesting.rounds import Round, planned
from jaxik.harvesting.together import Together
from jaxik.harvesting.tour import EXACT
from jaxik.kinematics.robot import Robot
from jaxik.reasons import Reason

FARTHEST = ("posture", "approach", "retreat", "transfer", "transport", "meeting")  # how far a fruit came that is not picked


def plan_harvest(
    harvest: HarvestResult,
    *,
    seed: int = 0,
    options: HarvestPlanOptions | None = None,
    progress: Callable[[int, int], Any] | None = None,
    **changes: Any,
) -> HarvestPlan:
    """Motions that pick, one after another, the fruits of a harvest, and end where they began. Host driver.

    For each fruit a transfer, a straight approach along the gripper's direction, the grasp, a straight retreat (back, or
    lifted), from there on with the fruit as a part of the robot, and where there is a `place` the transport there: all proven
    free of collision throughout, and timed within the limits of velocity and acceleration (`plan_motion`). What touches the
    fruit where it hangs is no obstacle to it on the retreat. A fruit that is picked is gone for those after it. The order, and
    of each fruit the posture, are the shortest tour by estimated times, planned, and found again with what was planned, until
    it stays. Fruits that cannot be picked at first are tried again when others are gone.

    With two arms each fruit is picked by the one or the other, so that the last arm is home as soon as can be. They
    move at the same time, and a stage begins once that is proven to keep the arms, and what they hold, apart by the margin.
    `home`, `place` and limits are then those of all joints. `changes` are fields of `HarvestPlanOptions`; `progress` is called
    with the numbers of fruits whose approaches were looked for, one an arm, and of all.

    Reasons: SOLVED; what `harvest` says of a fruit without a posture; COLLISION, LIMITS of all approaches, or retreats, from
    all postures; those of `plan_motion` for a transfer or transport; COLLISION with the other arm, a "meeting", where no order
    was found that keeps them apart; `where` says which. Raises `ValueError` for arguments of a wrong shape, name or range, no
    fruit, a home or a place that is not free, arms that share a joint, and, of more than ten fruits, without PyVRP (extra
    `harvest`) for the shortest order. Sources: Suarez-Ruiz et al., RoboTSP, 2018; Wouda et al., PyVRP, 2024; O'Donnell,
    Lozano-Perez, Deadlock-free and collision-free coordination of two robot manipulators, 1989.
    """
    check_kind("plan_harvest", "harvest", harvest, HarvestResult)
    options = HarvestPlanOptions.chosen(options, changes)
    check_seed("plan_harvest", seed)
    if not len(harvest):
        raise ValueError("plan_harvest: a harvest of no fruit; give one or several of its rows")
    began = time.perf_counter()
    arms = arms_of(harvest.robot, "plan_harvest")
    given = [_of_arm(harvest.robot, arm, options) for arm in arms] if len(arms) > 1 else [options]
    planners = [ArmPlanner(*each, seed) for each in zip(arms, harvest.of_arms, given, strict=True)]
    together = Together(harvest.robot, planners) if len(arms) > 1 else None
    _run(planners, together, progress or (lambda done, total: None))
    if together is not None:
        _at_once(planners, together)
    stages = planners[0].stages() if together is None else together.scheduled()
    plan = HarvestPlan.stacked([_row(harvest.robot, row.fruit, planners) for row in harvest])
    home = tuple(_whole(harvest.robot, planners).tolist())
    return dataclasses.replace(plan, stages=tuple(stages), home=home, seconds=time.perf_counter() - began)


def _of_arm(robot: Robot, arm: Arm, options: HarvestPlanOptions) -> HarvestPlanOptions:
    """The options of one of two arms: its part of what has a number for each joint of the robot."""
    n, joints, own = robot.num_joints, list(arm.joints), dict[str, Any]()
    for name in ("home", "place", "velocity", "acceleration"):
        if (value := getattr(options, name)) is None:
            continue
        value = numbers(f"plan_harvest: {name}", value)
        poses = name == "place" and value.shape[-2:] == (4, 4)
        if not poses and value.shape[-1:] == (n,):
            own[name] = value[..., joints]
        elif not poses and value.ndim:
            also = ", or poses (4, 4), (p, 4, 4)" if name == "place" else ""
            raise ValueError(f"plan_harvest: {name} of shape {value.shape}; allowed: ({n},), of both arms{also}")
    return dataclasses.replace(options, **own)


def _run(planners: Sequence[ArmPlanner], together: Together | None, progress: Callable[[int, int], Any]) -> None:
    """Plans rounds, until nothing more can be picked; and home."""
    left, done = [row.fruit for row in planners[0].harvest], 0
    while left:
        gone, rounds = frozenset(part.fruit for each in planners for part in each.driven), []
        for each in planners:
            picks = []
            for fruit in left:
                picks.append(each.picks(fruit, gone))
                done += 1
                if not gone:
                    progress(done, len(left) * len(planners))
            each.rows |= {p.fruit: each.row(p.fruit, p.reason, p.where, p.blockers) for p in picks}
            each.ways |= {p.fruit: (p, gone) for p in picks if p.reason == Reason.SOLVED and p.fruit not in each.ways}
            rounds.append(Round(each, [p for p in picks if p.reason == Reason.SOLVED], gone))
        tours = planned(rounds, None if together is None else together.waits)
        if not any(tour.parts for tour in tours):
            break
        for each, tour in zip(planners, tours, strict=True):
            each.drive(tour)
        picked = {part.fruit for tour in tours for part in tour.parts}
        left = [fruit for fruit in left if fruit not in picked]


def _at_once(planners: Sequence[ArmPlanner], together: Together) -> None:
    """Plans all rounds again as one, where two arms had several and it takes less time: a fruit that could be picked only when
    others were gone comes after those, whichever arm takes them."""
    late = [{fruit: gone for fruit, (_, gone) in each.ways.items() if gone} for each in planners]
    picked = {part.fruit for each in planners for part in each.driven}
    if not any(late) or len(picked) > EXACT or planners[0].options.order != "shortest":
        return
    before, saved = together.makespan(), [(each.driven, each.at, each.homeward, dict(each.rows)) for each in planners]
    rounds = []
    for each, later in zip(planners, late, strict=True):
        each.driven, each.at, each.homeward = [], each.home, None
        found = {fruit: each.needed(picks) if gone else (picks, gone) for fruit, (picks, gone) in each.ways.items()}
        needs = {fruit: needed for fruit, (_, needed) in found.items() if needed}
        rounds.append(Round(each, [picks for picks, _ in found.values()], frozenset(), later, needs))
    for each, tour in zip(planners, planned(rounds, together.waits), strict=True):
        each.drive(tour)
    if {part.fruit for each in planners for part in each.driven} != picked or together.makespan() >= before:
        for each, state in zip(planners, saved, strict=True):
            each.driven, each.at, each.homeward, each.rows = state


def _whole(robot: Robot, planners: Sequence[ArmPlanner]) -> np.ndarray:
    """Where the robot begins (n,)."""
    home = np.zeros(robot.num_joints)
    for each in planners:
        home[list(each.arm.joints)] = each.home
    return home


def _row(robot: Robot, fruit: str, planners: Sequence[ArmPlanner]) -> HarvestPlan:
    """The row of a fruit: of the arm that picks it, or came farthest."""
    picks = lambda each: any(part.fruit == fruit for part in each.driven)
    far = lambda row: FARTHEST.index(row.where) if row.where in FARTHEST else -1
    best = max(planners, key=lambda each: (picks(each), far(each.rows[fruit])))
    row = best.rows[fruit]
    if len(planners) == 1:
        return row
    q = np.full(robot.num_joints, np.nan)
    if row:
        q = _whole(robot, planners)
        q[list(best.arm.joints)] = row.q
    return dataclasses.replace(row, robot=robot, q=q, arm=best.arm.name if row else "", reason=Reason(int(row.reason)))
