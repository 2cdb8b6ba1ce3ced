"""Motions as what a study asks for: from which starts, planned how, and what is kept of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from jaxik.collision.scene import Scene
from jaxik.files.robot_toml import Table
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import POSE, POSITION, Task
from jaxik.kinematics.task_text import read_tasks
from jaxik.kinematics.tasks import check_given
from jaxik.options import Options, anything, count, instance
from jaxik.planning.limits import limit_of, motion_limits
from jaxik.planning.planner import PlanOptions
from jaxik.sweeps.postures import Postures
from jaxik.sweeps.robot_variants import Variant
from jaxik.sweeps.study_robots import made
from jaxik.sweeps.targets import Targets

Axes = tuple[tuple[str, tuple[Any, ...]], ...]
COUNTS, PER_JOINT = ("rounds", "postures"), ("velocity", "acceleration", "jerk")  # of `PlanOptions`, as `winding` is
SEARCHED = ("slides", "refine", "ik")  # keys of a study that motions know nothing of


class Motions(Options, who="study"):
    """The motions of a study: how they are planned, and what is stored of each besides its reason, duration and length."""

    starts: tuple[tuple[str, tuple[float, ...]], ...] = anything(default=(), words="postures to go from, each by its name")
    waypoints: int = count(default=16, least=0, words="most waypoints that are stored of a motion; 0 stores none")
    samples: int = count(default=0, least=0, words="samples of the timed motion, at equal times; 0 stores none")
    plan: PlanOptions = instance(default=PlanOptions(), kind=PlanOptions, words="how they are planned")

    def describe(self) -> dict[str, Any]:
        """All that the motions depend on, as JSON holds it."""
        kept = {name: getattr(self, name) for name in ("waypoints", "samples")}
        plan = {name: getattr(self.plan, name) for name in (*COUNTS, *PER_JOINT, "winding")}
        along = {} if self.plan.along is None else {"along": repr(self.plan.along)}
        return {"starts": {name: list(q) for name, q in self.starts}} | kept | plan | along


def usual_task(targets: Targets | Postures) -> Task:
    """The task of targets unless a study says another."""
    return POSITION if targets.free_rotation else POSE


def read_study_task(row: Table, targets: Targets | Postures) -> Task:
    """The task of a study's targets, in words (`read_task`) or as a `Task`. Raises `LoadError` for what such targets do not
    give."""
    row.asked.add("task")
    if "task" not in row.content:
        return usual_task(targets)
    found = _tasks(row, "task")
    if not isinstance(found, Task):
        raise row.fail(f"{len(found)} tasks", "a target is one pose; write one task")
    if isinstance(targets, Postures):
        raise row.fail("task says what a pose binds, and the targets are postures", "leave it out")
    if found.function is not None:
        raise row.fail("task is a function, by which a store does not know what it holds", "write one in words")
    if targets.free_rotation and found.turned:
        raise row.fail("task asks how targets are turned, and these are positions", "give directions, or poses")
    made(row, "change it", check_given, "task", found, "a target", True)
    return found


def _tasks(row: Table, key: str) -> Any:
    """A task or tasks of one key: in words, or as they are."""
    given = row.content[key]
    each = given if isinstance(given, list | tuple) else [given]
    if not each:
        raise row.fail(f"{key} is an empty list", "write a line such as 'upright z within 10deg', or leave it out")
    return made(row, "change it", read_tasks, each)


def read_motions(table: Table, robots: list[Robot], targets: Targets, margin: float) -> Motions:
    """The motions of a study's table. Raises `LoadError` for what cannot be meant."""
    row = table.table("motions")
    for key in sorted({*SEARCHED} & set(table.content)):
        raise row.fail(f"'{key}' is of a search for postures", "leave it out")
    posture_only = set(table.content.get("collision", {})) & {"clearance_weight", "freedom_weight", "reach"}
    for key in sorted(posture_only):
        raise row.fail(f"[collision] {key} tells which posture is the best", "leave it out")
    starts, theirs = _starts(row, robots), targets.starts if isinstance(targets, Postures) else None
    if starts and theirs is not None:
        raise row.fail("start, and the targets have starts", "keep one")
    if not starts and theirs is None and targets.kind != "random":
        raise row.fail("no start", "write start = [...], a number a joint [rad, m]")
    counts = {name: row.count(name, getattr(PlanOptions, name)) for name in COUNTS}
    kept = {name: row.count(name, getattr(Motions, name), least=0) for name in ("waypoints", "samples")}
    if kept["waypoints"] == 1 or kept["samples"] == 1:
        raise row.fail("one point is no motion", "write 2 or more, or 0 for none")
    task = read_study_task(row, targets)
    row.asked.add("along")
    along = _tasks(row, "along") if "along" in row.content else None
    plan = _checked(row, robots, task=task, along=along, margin=margin, **counts, **_limits(row))
    return Motions(starts=starts, plan=plan, **kept)


def _starts(row: Table, robots: list[Robot]) -> tuple[tuple[str, tuple[float, ...]], ...]:
    """The named starts: one posture, several, or a table of them."""
    row.asked.add("start")
    given = row.content.get("start")
    if given is None:
        return ()
    if isinstance(given, dict):
        named = row.table("start")
        found = [(name, named.array(name, "plain", (-1,))) for name in given]
    else:
        several = isinstance(given, list | tuple | np.ndarray) and len(given) > 0 and np.ndim(given[0]) > 0
        postures = row.array("start", "plain", (-1, -1)) if several else row.array("start", "plain", (-1,))[None]
        found = [(f"start {i}", q) for i, q in enumerate(postures, 1)]
    for name, q in found:
        for robot in robots:
            if len(q) != robot.num_joints:
                joints = f"{robot.num_joints}: {', '.join(robot.joint_names)}"
                raise row.fail(f"{name} has {len(q)} numbers; {robot.name} has {joints}", "write one a joint [rad, m]")
        over = [np.max(np.maximum(robot.lower - q, q - robot.upper)) for robot in robots]
        if not min(over) <= 1e-6:
            raise row.fail(f"{name} is {min(over):.3g} rad or m beyond a joint's limit", "write one inside of them")
    return tuple((name, tuple(q.tolist())) for name, q in found)


def _limits(row: Table) -> dict[str, Any]:
    """The limits that are given, one number or one a joint; and how far joints may wind."""
    found: dict[str, Any] = {}
    for name in (name for name in PER_JOINT if name in row.content):
        each = isinstance(row.content[name], list | tuple | np.ndarray)
        values = row.finite(name, (-1,) if each else ())
        found[name] = tuple(values.tolist()) if each else float(values)
    row.asked.update(PER_JOINT)
    if "winding" in row.content or "winding_deg" in row.content:
        found["winding"] = float(row.finite("winding", (), unit="angle"))
    row.asked.update(("winding", "winding_deg"))
    return found


def _checked(row: Table, robots: list[Robot], **options: Any) -> PlanOptions:
    """The planner's options, which every robot can keep."""
    try:
        plan = PlanOptions(**options)
        for robot in robots:
            motion_limits("motions", robot, plan.velocity, plan.acceleration, (robot.num_joints,))
            if plan.jerk is not None:
                limit_of("motions", "jerk", plan.jerk, (robot.num_joints,))
    except ValueError as error:
        raise row.fail(str(error), "change it") from None
    return plan


def read_around(row: Table, moving: bool, read: Callable[[str], Scene]) -> tuple[tuple[str, Scene], ...]:
    """The named scenes of a study's [collision], of which each is a place along an axis: a list of scenes and files, which
    `read` reads, or a table of them. Raises `LoadError` for what cannot be meant."""
    given = row.content.get("scenes")
    if given is None:
        return ()
    if not moving:
        raise row.fail("scenes are an axis of motions", "write [motions], or one scene")
    if "scene" in row.content:
        raise row.fail("scene and scenes both say what is in the way", "keep one")
    pairs = (
        list(given.items()) if isinstance(given, dict) else [("", x) for x in given] if isinstance(given, list | tuple) else []
    )
    if not pairs or not all(isinstance(scene, Scene | str) for _, scene in pairs):
        raise row.fail("scenes is no list or table of scenes", 'write scenes = ["one.toml", "two.toml"]')
    scenes = [(name, scene if isinstance(scene, Scene) else read(scene)) for name, scene in pairs]
    if not isinstance(given, dict):  # by their own names, where these tell them apart
        own = [scene.name for _, scene in scenes]
        told = len({*own} - {""}) == len(own)
        scenes = [(own[i] if told else f"scene {i + 1}", scene) for i, (_, scene) in enumerate(scenes)]
    return tuple(scenes)


def among_scenes(
    around: tuple[tuple[str, Scene], ...], axes: Axes, variants: tuple[Variant, ...]
) -> tuple[Axes, tuple[Variant, ...]]:
    """The variants in each of some scenes; without any they are as they were."""
    if not around:
        return axes, variants
    found = tuple(dataclasses.replace(v, index=(*v.index, i)) for v in variants for i in range(len(around)))
    return (*axes, ("scene", tuple(name for name, _ in around))), found


def from_starts(motions: Motions, axes: Axes, variants: tuple[Variant, ...]) -> tuple[Axes, tuple[Variant, ...]]:
    """The variants from each of the starts; one start is no axis."""
    if not motions.starts:
        return axes, variants
    several = len(motions.starts) > 1
    each = lambda v, i, q: dataclasses.replace(v, index=(*v.index, i) if several else v.index, start=q)
    found = tuple(each(v, i, q) for v in variants for i, (_, q) in enumerate(motions.starts))
    return (*axes, ("start", tuple(name for name, _ in motions.starts))) if several else axes, found
