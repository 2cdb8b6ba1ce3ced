"""A robot with some of its joints held: a branch of a tree as an arm of its own."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxik.checks.arrays import check_known, numbers
from jaxik.checks.options import check_kind, no_such, shown
from jaxik.kinematics.named import Group
from jaxik.kinematics.robot import Body, Robot, known_parts, link_geometry, moving
from jaxik.kinematics.shapes import ConvexPart, Surface, Volume
from jaxik.kinematics.tree import BASE_ROW, Mimic
from jaxik.spatial.rotations import about, frame

OF_JOINTS = "lower", "upper", "velocity", "effort", "armature"
Place = tuple[int, np.ndarray]  # the row that something moves with now, -1 the base, and its frame in that row's


def hold_joints(robot: Robot, held: Mapping[str, float]) -> Robot:
    """Returns the robot with joints held at values [rad, m], by their names: they are not in q any more, and what they carry
    moves with the joint before. Host.

    Bounds of pairs of links by tables are left out where the joints between are others now. Raises `ValueError` for names that
    are no joints, where none is left, and for traced numbers.
    """
    check_kind("hold_joints", "robot", robot, Robot)
    check_known("hold_joints", robot=robot)
    if not isinstance(held, Mapping):
        raise ValueError(f"hold_joints: held is {shown(held)}; write {{'joint': value}}")
    for name, value in held.items():
        if name not in robot.joint_names:
            raise ValueError(no_such(f"hold_joints: {robot.name}", "joint", str(name), robot.joint_names))
        numbers(f"hold_joints: {shown(name)}", value, (), finite=True)
    if not held:
        return robot
    left = [i for i, name in enumerate(robot.joint_names) if name not in held]
    if not left:
        raise ValueError(f"hold_joints: all joints of {robot.name} are held; leave one that moves")
    tree = robot.tree
    q = [float(held.get(name, 0.0)) for name in robot.joint_names]
    values = [*q, *(mimic.value(q[mimic.joint]) for mimic in robot.mimics)]
    kept = [row for row in range(len(tree.parents)) if tree.joints[row] in left]
    number, places, frames = {row: i for i, row in enumerate(kept)}, {BASE_ROW: (BASE_ROW, np.eye(4))}, {}
    parents: dict[int, int] = {}
    for row in tree.order:
        before, offset = places[tree.parents[row]]
        offset = offset @ robot.parent_T_joint[row]
        if row in number:
            parents[row], frames[row], places[row] = before, offset, (number[row], np.eye(4))
        else:
            axis, value = np.asarray(robot.axis[row]), values[row]
            moved = frame(value * axis) if tree.slides[row] else frame(rotation=about(axis, value))
            places[row] = before, offset @ moved
    return _made(robot, left, kept, places, np.array([frames[row] for row in kept]), tuple(parents[row] for row in kept))


def branch_to(robot: Robot, tip: str, *, q: Any = None) -> Robot:
    """Returns the arm from the base to one tip, or to any link, by its name: joints that are on no way to it are held as in `q`
    (n,) [rad, m], or at 0 or the limit that is nearest. Host.

    Raises `ValueError` for a name that is no link, and for a link that no joint moves.
    """
    alone = robot.with_tips(tip)
    on_way = moving(robot, alone.tips[0])
    rest = np.clip(0.0, robot.lower, robot.upper) if q is None else numbers("branch_to: q", q, (robot.num_joints,), finite=True)
    if not on_way:
        raise ValueError(f"branch_to: no joint of {robot.name} moves '{shown(tip)}'; choose another link")
    arm = hold_joints(alone, {name: float(rest[i]) for i, name in enumerate(robot.joint_names) if i not in on_way})
    return dataclasses.replace(arm, tip_names=())


def _made(
    robot: Robot, left: list[int], kept: list[int], places: dict[int, Place], frames: np.ndarray, parents: tuple[int, ...]
) -> Robot:
    """The robot of the rows that are `kept`, with all that others carry at their places."""
    names = tuple(robot.joint_names[i] for i in left)
    moved = [places[number - 1] for number in robot.link_joint]
    tips = [places[number - 1] for number in robot.tips]
    tip_frames = np.array([place @ tip for (_, place), tip in zip(tips, robot.tip_frames, strict=True)])
    numbers_of_joints: dict[str, Any] = {name: np.asarray(getattr(robot, name))[left] for name in OF_JOINTS}
    held = dataclasses.replace(
        robot,
        joint_names=names,
        joint_types=tuple(robot.joint_types[i] for i in left),
        **numbers_of_joints,
        drives=tuple(robot.drives[i] for i in left) if robot.drives else (),
        parent_T_joint=frames,
        axis=np.asarray(robot.axis)[kept],
        bodies=_bodies(robot, kept, places),
        parents=parents,
        mimics=tuple(_led(m, left) for m in robot.mimics if m.joint in left),
        link_joint=tuple(row + 1 for row, _ in moved),
        link_offset=np.array([place @ offset for (_, place), offset in zip(moved, robot.link_offset, strict=True)]),
        joint_T_tip=tip_frames if np.ndim(robot.joint_T_tip) == 3 else tip_frames[0],
        tip_joints=tuple(row + 1 for row, _ in tips),
        boxes=tuple(dataclasses.replace(b, joint_T_box=moved[b.link][1] @ b.joint_T_box) for b in robot.boxes),
        volumes=tuple(Volume(_carried(moved[v.link], v.corners), v.radius, v.link) for v in robot.volumes),
        surfaces=tuple(Surface(s.link, _carried(moved[s.link], s.corners), s.radius, s.solid, s.shape) for s in robot.surfaces),
        groups=tuple(g for group in robot.groups if (g := Group(group.name, _some(group.joints, names))).joints),
        states=tuple(s._replace(values=tuple((j, x) for j, x in s.values if j in names)) for s in robot.states),
        pair_tables=(),
        self_pairs=(),
        convex_parts=(),
    )
    apart = lambda a, b: held.tree.distance(held.link_joint[a], held.link_joint[b]) > 0
    parts = known_parts(robot)
    new = {link: link_geometry(held, link) for link in {part.link for part in parts}}
    return dataclasses.replace(
        held,
        self_pairs=tuple(pair for pair in robot.self_pairs if apart(*pair)),
        convex_parts=tuple(ConvexPart(p.link, _carried(moved[p.link], p.corners), p.radius, new[p.link]) for p in parts),
    )


def _led(mimic: Mimic, left: list[int]) -> Mimic:
    """A joint that follows one of those that are left, by its new number."""
    return dataclasses.replace(mimic, joint=left.index(mimic.joint))


def _some(names: tuple[str, ...], kept: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(name for name in names if name in kept)


def _carried(place: Place, points: Any) -> np.ndarray:
    """Points (..., 3) in the frame of the joint that moves them now."""
    return np.asarray(points) @ place[1][:3, :3].T + place[1][:3, 3]


def _bodies(robot: Robot, kept: list[int], places: dict[int, Place]) -> tuple[Body, ...]:
    """The bodies that each row carries now, fused."""
    if not robot.bodies:
        return ()
    found: list[list[Body]] = [[] for _ in kept]
    for row, body in enumerate(robot.bodies):
        now, place = places[row]
        if now >= 0:
            found[now].append(body if row in kept else body.moved(place))
    return tuple(Body.fused(own) if len(own) > 1 else own[0] for own in found)
