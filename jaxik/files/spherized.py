"""A robot as a URDF whose links are spheres: what other programs read (PyRoki, cuRobo, VAMP's generator)."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any
from xml.etree import ElementTree

import numpy as np

from jaxik.collision.volumes import box_spheres
from jaxik.files.robot_builder import listed
from jaxik.kinematics.drive import Drive
from jaxik.kinematics.robot import Body, Robot
from jaxik.spatial.rotations import to_rpy

LOST = (
    "the .srdf beside it names the pairs of links that are not to be checked; tables of distances, ignored objects and the "
    "inertia of rotors are lost, and of drives all but coulomb and viscous friction"
)


def spherized(robot: Robot, beyond: float) -> tuple[str, float]:
    """A URDF of a robot whose links are spheres, and how far these reach beyond the robot's volumes [m], at most `beyond`.

    Raises `ValueError` for a robot whose meshes were not read.
    """
    if robot.unread_meshes:
        raise ValueError(f"save: the meshes of {listed(robot.unread_meshes)} are not read; load with meshes=True")
    root = ElementTree.Element("robot", name=robot.name)
    names = _frame_names(robot)
    spheres: dict[int, list[tuple[np.ndarray, float]]] = {i: [] for i in range(len(robot.link_names))}
    reach = 0.0
    for volume in robot.volumes:
        centres, more = _covering(np.asarray(volume.corners), float(volume.radius), beyond)
        spheres[volume.link] += [(centre, float(volume.radius) + more) for centre in centres]
        reach = max(reach, more)
    for box in robot.boxes:
        middles, size = box_spheres(box, robot.spheres_per_box)
        spheres[box.link] += [(np.asarray(middle), float(size)) for middle in middles]
    tool = _free("tool", (*names, *robot.link_names))
    every = dict.fromkeys((*names, *robot.link_names, tool))
    elements = {name: ElementTree.SubElement(root, "link", name=name) for name in every}
    for i, name in enumerate(robot.link_names):
        element = elements[name]
        if name in names and robot.bodies and robot.link_joint[i]:  # it stands for the frame of what moves with a joint
            _inertial(element, robot.bodies[robot.link_joint[i] - 1])
        back = np.linalg.inv(robot.link_offset[i])
        for centre, radius in spheres[i]:
            collision = ElementTree.SubElement(element, "collision")
            ElementTree.SubElement(collision, "origin", xyz=_words(back[:3, :3] @ centre + back[:3, 3]), rpy="0 0 0")
            ElementTree.SubElement(ElementTree.SubElement(collision, "geometry"), "sphere", radius=repr(float(radius)))
    for i, name in enumerate(robot.joint_names):
        joint = _joined(root, name, robot.joint_types[i], names[i], names[i + 1], robot.parent_T_joint[i])
        ElementTree.SubElement(joint, "axis", xyz=_words(robot.axis[i]))
        ends = {} if robot.joint_types[i] == "continuous" else {"lower": robot.lower[i], "upper": robot.upper[i]}
        effort = robot.effort[i] if np.isfinite(robot.effort[i]) else 0.0  # which the format wants of every joint
        limit = ends | {"velocity": robot.velocity[i], "effort": effort}
        ElementTree.SubElement(joint, "limit", {k: repr(float(v)) for k, v in limit.items() if np.isfinite(v)})
        if robot.drives:
            ElementTree.SubElement(joint, "dynamics", _friction(robot.drives[i]))
    placed = zip(robot.link_names, robot.link_joint, robot.link_offset, strict=True)
    fixed = [(name, names[joint], offset) for name, joint, offset in placed if name not in names]
    for name, parent, frame in (*fixed, (tool, names[-1], robot.joint_T_tip)):
        _joined(root, _free(f"{name}_fixed", robot.joint_names), "fixed", parent, name, frame)
    count = sum(map(len, spheres.values()))
    note = f"{count} spheres, which reach at most {1e3 * reach:.1f} mm beyond the collision model; the tip is '{tool}'"
    root.insert(0, ElementTree.Comment(f" {note} "))
    root.insert(1, ElementTree.Comment(f" {LOST} "))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n", reach


def _frame_names(robot: Robot) -> list[str]:
    """A link for the base's frame and each joint's: one of the robot's that stands there, or another."""
    found: list[str] = []
    for joint in range(robot.num_joints + 1):
        there = [n for n, j, o in zip(robot.link_names, robot.link_joint, robot.link_offset, strict=True)
                 if j == joint and np.array_equal(o, np.eye(4))]  # fmt: skip
        named = "base_frame" if joint == 0 else f"{robot.joint_names[joint - 1]}_frame"
        found.append(there[0] if there else _free(named, (*robot.link_names, *found)))
    return found


def _free(name: str, taken: Sequence[str]) -> str:
    """The name, or with a number after it where it is taken."""
    return next(n for i in itertools.count() if (n := f"{name}_{i}" if i else name) not in taken)


def _inertial(element: ElementTree.Element, body: Body) -> None:
    inertial = ElementTree.SubElement(element, "inertial")
    ElementTree.SubElement(inertial, "origin", xyz=_words(body.com), rpy="0 0 0")
    ElementTree.SubElement(inertial, "mass", value=repr(float(body.mass)))
    entries = {f"i{'xyz'[i]}{'xyz'[j]}": repr(float(body.inertia[i, j])) for i in range(3) for j in range(i, 3)}
    ElementTree.SubElement(inertial, "inertia", entries)


def _friction(drive: Drive) -> dict[str, str]:
    """A drive's friction at its joint, as a URDF has it."""
    ratio = float(drive.ratio) if drive.friction.side == "motor" else 1.0
    rubs = {"friction": ratio * float(drive.friction.coulomb), "damping": ratio**2 * float(drive.friction.viscous)}
    return {key: repr(value) for key, value in rubs.items()}


def _joined(root: Any, name: str, kind: str, parent: str, child: str, frame: Any) -> ElementTree.Element:
    joint = ElementTree.SubElement(root, "joint", name=name, type=kind)
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    ElementTree.SubElement(joint, "origin", xyz=_words(frame[:3, 3]), rpy=_words(to_rpy(frame[:3, :3])))
    return joint


def _words(values: Any) -> str:
    return " ".join(repr(float(x)) for x in values)


def _covering(corners: np.ndarray, radius: float, beyond: float) -> tuple[np.ndarray, float]:
    """Centres (k, 3) of spheres that hold a swept-sphere volume, and how far they reach beyond it, at most `beyond` [m].

    What is r away from the skeleton lies across it there. So a centre on the skeleton, d from the nearest point, holds it with
    a radius of `sqrt(r^2 + d^2)`; centres stand on the ends and edges, too, where all of them have one nearest on their own.
    """
    longest = max(float(np.linalg.norm(a - b)) for a in corners for b in corners)
    if longest == 0.0:
        return corners[:1], 0.0
    held = np.sqrt((radius + beyond) ** 2 - radius**2)
    share = 0.5 if len(corners) == 2 else 3.0**-0.5  # of its longest side that a point of a triangle is from its corners
    count = int(np.ceil(share * longest / held))
    steps = np.arange(count + 1)
    if len(corners) == 2:
        weights = np.stack([count - steps, steps], axis=1)
    else:
        weights = np.array([(i, j, count - i - j) for i in steps for j in steps if i + j <= count])
    return weights / count @ corners, float(np.sqrt(radius**2 + (share * longest / count) ** 2) - radius)
