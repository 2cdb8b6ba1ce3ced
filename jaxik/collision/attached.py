"""Makes what is grasped part of the robot: it moves with its tip, and is no obstacle any more."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array, check_known
from jaxik.checks.options import as_count, check_kind, no_such, shown
from jaxik.collision.leaf_rows import FAR
from jaxik.collision.obstacle_kinds import KINDS, SHAPES
from jaxik.collision.scene import Scene, check_scene
from jaxik.collision.surface_trees import surface_of
from jaxik.collision.volumes import box_spheres
from jaxik.kinematics.forward import as_posture, joint_frames
from jaxik.kinematics.robot import Robot, solid_links
from jaxik.kinematics.shapes import Box, Surface, Volume, brick, fan, prism
from jaxik.spatial.algebra import Frame

MOST = 1000  # volumes that an arm carries: each is measured against all obstacles


class Attached(NamedTuple):
    """The robot with what it holds, and the scene without it."""

    robot: Robot
    scene: Scene


def attach(robot: Robot, scene: Scene, name: str, q: Float[Array, " n"], *, touches: Iterable[str] = ()) -> Attached:
    """Makes the object `name`, as it lies when the robot is at `q` (n,) [rad, m], a link of that name which moves with the tip;
    and returns the scene without it (`Scene.without`: its name stays in `object_names`). Host.

    Points become balls of the scene's radius; spheres and capsules stay what they are; boxes become boxes of the robot, which
    `spheres_per_box` spheres cover; a cylinder is carried as a capsule up to 42 % of its radius larger, the one about it that
    protrudes least; triangles stay surfaces, so what is wholly inside of a body that they enclose is not seen. The link is
    checked against the scene and against the robot's other links, but for those that move with the tip, too, and those
    that it `touches` (MoveIt's touch_links). It has no mass.

    In a robot `with_room` it fills the room instead, a link that is there already: programs that were compiled for one object
    serve the next, and none. A robot that holds something puts it down where its programs go on with the robot with the empty
    room, and the scene that has the object (`Scene.moved`). What holds two things at once takes them as one object.

    With several tips `robot.with_tips(name)` chooses the one that grasps; what is put into a room moves with the tip that the
    room was made with. Raises `ValueError` for an object that is not there, has no obstacle, the name of a link or more
    obstacles than there is room for, for a room in which something is held, for links that the robot does not have, for a q of
    another shape, and for what is traced.
    """
    check_kind("attach", "robot", robot, Robot)
    check_kind("attach", "scene", scene, Scene)
    check_known("attach", robot=robot, scene=scene)
    check_scene(scene)
    room, link = room_of(robot), len(robot.link_names)
    last = robot.only_tip("attach") if room is None else robot.link_joint[room]
    if name not in scene.object_names:
        raise ValueError(no_such("attach", "object", str(name), scene.object_names))
    if name in robot.link_names:
        raise ValueError(f"attach: {robot.name} has a link '{shown(name)}' already; give the object another name")
    free = _free("attach", robot, touches := _as_links("attach", touches), last)
    posture = as_posture("attach", robot, q)
    if room is not None and touches:
        raise ValueError("attach: touches of a robot with room; say them where the room is made (with_room)")
    if room is not None and any(float(v.radius) > -FAR for v in robot.volumes if v.link == room):  # it would be nowhere
        mend = "put it down first: attach to the robot with the empty room"
        raise ValueError(f"attach: {robot.name} holds something in its room already; {mend}")
    frames = joint_frames(robot, posture.tolist(), Frame.of(robot.world_T_base)).joints
    joint_T_world = np.linalg.inv(frames[last - 1].matrices if last else Frame.of(robot.world_T_base).matrices)
    found = [*_carried(scene, name, joint_T_world, link if room is None else room)]
    if not (count := len(found)):
        raise ValueError(f"attach: '{shown(name)}' has no obstacle in '{scene.name}'; there is nothing to carry")
    if count > MOST:
        mend = f"at most {MOST:,}; put a few spheres or boxes around it"
        raise ValueError(f"attach: '{shown(name)}' has {count:,} obstacles; {mend}")
    shapes = [each for each, _, _ in found]
    if room is not None:
        return Attached(_filled(robot, room, shapes, shown(name)), scene.without([name]))
    held = _with_link(
        robot,
        name,
        last,
        free,
        surfaces=(*robot.surfaces, _surface(link, found)) if robot.surfaces else (),
        boxes=(*robot.boxes, *(each for each in shapes if isinstance(each, Box))),
        volumes=(*robot.volumes, *(each for each in shapes if isinstance(each, Volume))),
    )
    return Attached(held, scene.without([name]))


def with_room(
    robot: Robot, *, name: str = "held", spheres: int = 8, capsules: int = 0, triangles: int = 0, touches: Iterable[str] = ()
) -> Robot:
    """Gives a robot a link of a `name` that moves with its tip, with room for what it may hold, and nothing in it. Host.

        arm = jaxik.collision.with_room(robot, spheres=8, capsules=1)
        solver = jaxik.Solver(arm, scene=scene)  # compiles
        held = jaxik.collision.attach(arm, scene, "cup", q)
        solver.update(held.scene, robot=held.robot)  # compiles nothing
        solver.update(scene.moved("cup", pose), robot=arm)  # and puts it down

    `spheres` is for spheres and points, and for boxes, each of which takes as many as cover a box of the robot
    (`robot.with_spheres`), 8 unless that was changed; `capsules` for capsules and cylinders. What is held keeps its form and
    radii in float32. The link is checked as `attach` says, but for the links that it `touches`. What is behind the room costs
    nearly nothing while it is empty.

    Raises `ValueError` for a name that is none or that a link has, counts that are none or no room at all, links that the robot
    does not have, and for a robot that convex parts or surfaces decide of, as of any with meshes (`load(.., meshes=True)`):
    `dataclasses.replace(robot, surfaces=(), convex_parts=())` is the same robot, of which the volumes around its links decide.
    """
    check_kind("with_room", "robot", robot, Robot)
    check_known("with_room", robot=robot)
    if not isinstance(name, str) or not name:
        raise ValueError(f"with_room: name is {shown(name)!r}; write the name of a link, e.g. 'held'")
    if room_of(robot) is not None or name in robot.link_names:
        raise ValueError(f"with_room: {robot.name} has a link '{shown(name)}' or room already; take the robot without")
    if robot.surfaces or robot.convex_parts:
        mend = "dataclasses.replace(robot, surfaces=(), convex_parts=()) is measured by its volumes"
        raise ValueError(f"with_room: {robot.name} has convex parts or surfaces, which decide by fixed numbers; {mend}")
    asked = {"spheres": spheres, "capsules": capsules, "triangles": triangles}
    counts = [as_count(f"with_room: {kind}", count, least=0) for kind, count in asked.items()]
    if not 0 < sum(counts) <= MOST:
        raise ValueError(f"with_room: room for {sum(counts):,} volumes; allowed: 1 to {MOST:,}, such as spheres=8")
    last, link = robot.only_tip("with_room"), len(robot.link_names)
    nothing = [_nothing(robot, corners, link) for corners, count in enumerate(counts, 1) for _ in range(count)]
    free = _free("with_room", robot, _as_links("with_room", touches), last)
    return _with_link(robot, name, last, free, volumes=(*robot.volumes, *nothing))


def room_of(robot: Robot) -> int | None:
    """The number of the link that is a robot's room; None where it has none."""
    links = {v.link for v in robot.volumes if isinstance(v.corners, jax.Array)}
    others = {v.link for v in robot.volumes if not isinstance(v.corners, jax.Array)} | {box.link for box in robot.boxes}
    return next(iter(links)) if len(links) == 1 and not links & others else None


def _nothing(robot: Robot, corners: int, link: int) -> Volume:
    """A volume that is further from everything than anything: of the same form as what may be in its place."""
    tip = np.asarray(robot.tip_frames[0], np.float32)
    return Volume(jnp.asarray(tip[:3, 3] + 1e-3 * np.eye(3, dtype=np.float32)[:corners]), jnp.float32(-FAR), link)


def _filled(robot: Robot, room: int, shapes: list[Box | Volume], name: str) -> Robot:
    """The robot with these shapes in its room. Raises `ValueError` where there is no room for them."""
    given: dict[int, list[tuple[Any, Any]]] = {1: [], 2: [], 3: []}
    for shape in shapes:
        if isinstance(shape, Box):
            centres, radius = box_spheres(shape, robot.spheres_per_box)
            given[1] += [(centre[None], radius) for centre in np.asarray(centres)]
        else:
            given[len(shape.corners)].append((shape.corners, shape.radius))
    volumes = list(robot.volumes)
    for count, words in ((1, "spheres"), (2, "capsules"), (3, "triangles")):
        places = [i for i, v in enumerate(volumes) if v.link == room and len(v.corners) == count]
        if len(given[count]) > len(places):
            mend = f"make more (with_room({words}={len(given[count])}))"
            raise ValueError(f"attach: '{name}' takes {len(given[count])} {words} with room for {len(places)}; {mend}")
        for i in places:
            volumes[i] = _nothing(robot, count, room)
        for i, (corners, radius) in zip(places, given[count], strict=False):
            volumes[i] = Volume(jnp.asarray(corners, jnp.float32), jnp.float32(radius), room)
    return dataclasses.replace(robot, volumes=tuple(volumes))


def _with_link(robot: Robot, name: str, joint: int, free: set[int], **shapes: Any) -> Robot:
    """The robot with one more link, which moves with a joint and is checked against all links but some."""
    pairs = (*robot.self_pairs, *((i, len(robot.link_names)) for i in solid_links(robot) if i not in free))
    offset = np.concatenate([robot.link_offset, np.eye(4)[None]])
    names, joints = (*robot.link_names, name), (*robot.link_joint, joint)
    return dataclasses.replace(robot, link_names=names, link_joint=joints, link_offset=offset, self_pairs=pairs, **shapes)


def _free(who: str, robot: Robot, touches: tuple[str, ...], last: int) -> set[int]:
    """The links that what is held is not checked against: those that it touches, and those that move with it."""
    for name in touches:
        if name not in robot.link_names:
            raise ValueError(no_such(f"{who}: {robot.name}", "link", str(name), robot.link_names))
    touched = {robot.link_names.index(name) for name in touches}
    return touched | {i for i, joint in enumerate(robot.link_joint) if joint == last}


def _as_links(who: str, touches: Any) -> tuple[str, ...]:
    if isinstance(touches, str) or not isinstance(touches, Iterable):
        example = touches if isinstance(touches, str) else "link"
        raise ValueError(f"{who}: touches is '{shown(touches)}'; write a list of links, ['{shown(example)}']")
    return tuple(touches)


Carried = tuple[Box | Volume, np.ndarray, float]


def _carried(scene: Scene, name: str, joint_T_world: np.ndarray, link: int) -> Iterator[Carried]:
    """Yields the object's obstacles in the last joint's frame, each with its triangles (t, 3, 3) and a radius around them."""
    index = scene.object_names.index(name)
    if index in scene.owners[KINDS.index("fields")]:
        raise ValueError(f"attach: '{shown(name)}' is a distance field, which no arm carries; put boxes in its place")
    if any(cloud.name == name for cloud in scene.clouds):
        raise ValueError(
            f"attach: '{shown(name)}' is a cloud of points, which no arm carries; put spheres or boxes in its place"
        )
    placed = lambda points, a_T_b=joint_T_world: points @ a_T_b[:3, :3].T + a_T_b[:3, 3]
    for kind, obstacles, owners in scene.by_kind():
        fields = {at: np.asarray(getattr(obstacles, at), np.float64) for at in SHAPES[kind]}
        for i in np.flatnonzero((owners == index) & obstacles.there):
            row = {at: np.asarray(x[i] if x.ndim else x) for at, x in fields.items()}
            if kind == "boxes":
                frame = joint_T_world @ row["world_T_box"]
                yield Box(frame, row["half"], link), placed(brick(row["half"]), frame), 0.0
            elif kind == "cylinders":
                frame, (ends, radius) = row["world_T_cylinder"], _capsule(*row.values())
                own = placed(prism(float(row["radius"]), float(row["half"])), joint_T_world @ frame)
                yield Volume(placed(ends), np.asarray(radius), link), own, 0.0
            else:
                corners = placed(np.stack([row[at] for at in ("center", "a", "b", "c") if at in row]))
                radius = row.get("radius", np.zeros(()))
                yield Volume(corners, radius, link), fan(corners), float(radius)


def _surface(link: int, found: list[Carried]) -> Surface:
    """The object's own surface, for an exact robot; its triangles together, of which some may close around a body."""
    flat = [own for shape, own, _ in found if isinstance(shape, Volume) and len(shape.corners) == 3]
    others = [(own, radius) for shape, own, radius in found if isinstance(shape, Box) or len(shape.corners) < 3]
    return surface_of(link, [*others, *([(np.concatenate(flat), 0.0)] if flat else [])])


def _capsule(world_T_cylinder: np.ndarray, radius: Any, half: Any) -> tuple[np.ndarray, Any]:
    """Ends and radius of the capsule about a cylinder whose largest protrusion is least.

    With ends d inside the cylinder's it needs the radius sqrt(r^2 + d^2), and protrudes by that less r at the side, less d at
    the ends. The first grows with d and the second falls: they meet at d = r, at (sqrt 2 - 1) r; a flat cylinder has d <= half.
    """
    inside = min(float(radius), float(half))
    axis, centre = world_T_cylinder[:3, 2] * (float(half) - inside), world_T_cylinder[:3, 3]
    return np.stack([centre - axis, centre + axis]), np.hypot(radius, inside)
