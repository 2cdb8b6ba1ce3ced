"""Makes a robot of a run of joints from base to tip, which every robot file becomes; checks it in one place.

`Notes` collects what a file says and its robot cannot hold, a line of warning each; and the links that it lets pass.
"""

from __future__ import annotations

import collections
import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.polynomial import Polynomial

from jaxik.checks.options import among, shown
from jaxik.kinematics.drive import Drive, Friction
from jaxik.kinematics.robot import Body, JointType, Robot
from jaxik.kinematics.shapes import Box, Volume
from jaxik.reasons import LoadError
from jaxik.spatial.rotations import about, frame

NAMED = 4  # in one line
LEAVES = 40  # that a line names
COLUMNS = ("axis", "lower", "upper", "velocity", "effort", "armature")  # numbers of a joint that a robot has, too
JOINT_TYPES = (*get_args(JointType), "fixed")


@dataclasses.dataclass
class Notes:
    """Lines to tell (`told`: what is so, of which joints or links), pairs of links that the file does not check (`apart`), and
    all links that it has, those that are no part of the chain, too."""

    told: dict[str, list[str]] = dataclasses.field(default_factory=dict)
    apart: set[frozenset[str]] = dataclasses.field(default_factory=set)
    links: tuple[str, ...] = ()

    def add(self, told: str, *names: str) -> None:
        """Adds that something is so of more names."""
        self.told.setdefault(told, []).extend(names)

    def lines(self) -> Iterable[str]:
        """One for each thing that is so: of whom, and what."""
        for told, names in self.told.items():
            yield f"{listed(names)}: {told}" if names else told


def listed(names: Iterable[str], most: int = NAMED) -> str:
    """The first few of some names, and how many there are."""
    every = [*names]
    rest = f", ... ({len(every)} in all)" if len(every) > most else ""
    return ", ".join(map(shown, every[:most])) + rest


@dataclasses.dataclass
class Joint:
    """A joint as the file has it; `element` says where it stands, for the error line."""

    name: str
    type: str
    parent_T_joint: np.ndarray
    child: str
    axis: np.ndarray = dataclasses.field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    lower: float = -np.inf
    upper: float = np.inf
    velocity: float = np.inf
    effort: float = np.inf  # the most that its drive gives [Nm, N]
    armature: float = 0.0  # the rotor's inertia behind its gears [kg m2, kg]
    default: float = 0.0  # where it stands beside a robot [rad, m]
    drive: Drive | None = None
    mimic: tuple[str, Polynomial] | None = None  # the joint that drives it, and how its value follows
    stands: str = ""  # a type that no robot has, of a joint beside one, which is fixed where it stands

    @property
    def element(self) -> str:
        return f"joint '{self.name}'"


@dataclasses.dataclass
class Link:
    """A link's inertia, boxes and swept-sphere volumes, in its frame (link index not yet known)."""

    mass: float = 0.0
    com: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(3))
    inertia: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((3, 3)))
    boxes: list[tuple[np.ndarray, np.ndarray]] = dataclasses.field(default_factory=list)
    volumes: list[tuple[np.ndarray, float]] = dataclasses.field(default_factory=list)
    meshes: list[str] = dataclasses.field(default_factory=list)


def unique(file: Path, kind: str, names: Iterable[str]) -> None:
    """Refuse a name that stands twice."""
    for name, count in collections.Counter(names).items():
        if count > 1:
            raise LoadError(file, f"{kind} '{name}'", "the name stands twice", "give each its own")


def way_up(
    file: Path, names: Sequence[str], above: Mapping[str, str], tip: str | None, base: str | None, one: str = "link"
) -> list[str]:
    """The links from `tip` (the only leaf) up to `base` (the root), of a tree that says what is `above` each link."""
    many = {"link": "links", "body": "bodies"}[one]
    if tip is None:
        leaves = sorted(set(names) - set(above.values()))
        if len(leaves) != 1:
            choice = f"one of: {listed(leaves, LEAVES)}" if leaves else f"the {many} form a loop"
            raise LoadError(file, "tip", f"is not given and the tree has {len(leaves)} leaves", f"pass tip= (--tip), {choice}")
        tip = leaves[0]
    for what, name in (("tip", tip), ("base", base)):
        if name not in (*names, None):
            raise LoadError(file, f"{what} '{name}'", f"no such {one}", among(str(name), names, many))
    way = [tip]
    while way[-1] != base and way[-1] in above:
        way.append(above[way[-1]])
        if len(way) > len(names):
            raise LoadError(file, f"{one} '{way[-1]}'", "the joints form a loop", "a robot needs a tree")
    if base not in (way[-1], None):
        raise LoadError(file, f"tip '{tip}'", f"is not below base '{base}'", f"its root is '{way[-1]}'")
    return way


def assemble(
    file: Path,
    name: str,
    base: str,
    joints: Sequence[Joint],
    links: dict[str, Link],
    tool: np.ndarray | None = None,
    mount: np.ndarray | None = None,
    carried: Sequence[tuple[str, Joint]] = (),
) -> Robot:
    """The robot of `joints`, in order from `base`; fixed joints fuse into the frames of the next movable one.

    `carried` are fixed joints, each with its parent link, that lead aside: what rides on the chain without being a part of it.
    """
    every = [*joints, *(j for _, j in carried)]
    unique(file, "joint", (j.name for j in joints))
    unique(file, "link", (base, *(j.child for j in every)))
    for joint in every:
        _finite(file, joint.element, "origin", joint.parent_T_joint)
    movable = [checked(file, j) for j in joints if j.type != "fixed"]
    if not movable:
        raise LoadError(file, f"chain from '{base}'", "has no movable joint", "choose another base or tip")
    pending, frames = np.eye(4), []
    places = {base: (pending, 0)}  # of each link: in the frame of the joint that moves it, and how many are before it
    for joint in joints:
        pending = pending @ joint.parent_T_joint
        if joint.type != "fixed":
            frames.append(pending)
            pending = np.eye(4)
        places[joint.child] = pending, len(frames)
    for parent, joint in carried:
        offset, count = places[parent]
        places[joint.child] = offset @ joint.parent_T_joint, count
    names, (offsets, counts) = tuple(places), zip(*places.values(), strict=True)
    content = [links.get(name, Link()) for name in names]
    each = [*enumerate(zip(content, offsets, strict=True))]
    stacked: dict[str, Any] = {k: np.array([getattr(j, k) for j in movable]) for k in COLUMNS}
    return Robot(
        name=name,
        joint_names=tuple(j.name for j in movable),
        joint_types=tuple(j.type for j in movable),  # type: ignore[misc]
        link_names=names,
        link_joint=counts,
        parent_T_joint=np.array(frames),
        joint_T_tip=pending if tool is None else pending @ tool,
        link_offset=np.array(offsets),
        world_T_base=np.eye(4) if mount is None else mount,
        bodies=_bodies(content, offsets, counts, len(frames)),
        boxes=tuple(Box(o @ t, h, i) for i, (c, o) in each for t, h in c.boxes),
        volumes=tuple(Volume(p @ o[:3, :3].T + o[:3, 3], np.asarray(r), i) for i, (c, o) in each for p, r in c.volumes),
        unread_meshes=tuple(n for n, c in zip(names, content, strict=True) if c.meshes),
        drives=all_or_none(file, {j.name: j.drive for j in movable}),
        **stacked,
    )


def rubbing(file: Path, joint: Joint, coulomb: float, viscous: float) -> None:
    """Give a joint the friction that its file has, [Nm, N] and [Nm s/rad, N s/m], in a drive that is ideal otherwise."""
    for what, value in (("friction", coulomb), ("damping", viscous)):
        if not 0.0 <= value < np.inf:
            raise LoadError(file, joint.element, f"{what} {value:g}", "write a finite number of at least 0")
    if coulomb or viscous:
        joint.drive = Drive(rotor_inertia=joint.armature, friction=Friction(coulomb, viscous=viscous))


def all_driven(joints: Iterable[Joint]) -> None:
    """Where one joint has a drive, give the others an ideal one."""
    movable = [joint for joint in joints if joint.type != "fixed"]
    for joint in movable if any(joint.drive for joint in movable) else ():
        joint.drive = joint.drive or Drive(rotor_inertia=joint.armature)


def all_or_none(file: Path, drives: Mapping[str, Drive | None]) -> tuple[Drive, ...]:
    """The drives of all joints, by their names, or none. Refuse those of some."""
    known = tuple(drive for drive in drives.values() if drive is not None)
    if known and len(known) < len(drives):
        without = next(name for name, drive in drives.items() if drive is None)
        raise LoadError(file, f"joint '{without}'", "has no drive, and others have", "write [joint.drive], or take theirs away")
    return known


def displacement(kind: str, axis: np.ndarray, value: float) -> np.ndarray:
    """How far a joint at a value [rad, m] has moved what follows it, (4, 4)."""
    return frame(value * axis) if kind == "prismatic" else frame(rotation=about(axis, value))


def symmetric(entries: Sequence[float] | np.ndarray) -> np.ndarray:
    """The tensor (3, 3) of its entries xx, xy, xz, yy, yz, zz."""
    return np.asarray(entries)[[[0, 1, 2], [1, 3, 4], [2, 4, 5]]]


def _finite(file: Path, element: str, what: str, values: np.ndarray) -> None:
    if not np.all(np.isfinite(values)):
        raise LoadError(file, element, f"{what} holds NaN or infinity", "write finite numbers")


def checked(file: Path, joint: Joint) -> Joint:
    """A movable joint with an axis of length 1 and limits in their order."""
    if joint.type == "continuous":
        joint.lower, joint.upper = -np.inf, np.inf
    _finite(file, joint.element, "axis", joint.axis)
    norm = float(np.linalg.norm(joint.axis))
    unit = joint.axis / max(norm, 1e-9)
    written = " ".join(f"{a:.6g}" for a in unit)
    for wrong, problem, mend in (
        (joint.type not in JOINT_TYPES, f"type '{joint.type}' is not supported", f"allowed: {', '.join(JOINT_TYPES)}"),
        (norm < 1e-9, "the axis is zero", "write a unit vector such as 0 0 1"),
        # a rounded unit vector is made exact; anything else is more likely a slip
        (abs(norm - 1.0) > 1e-2, f"the axis has length {norm:.6g}, not 1", f"write {written}"),
        *((np.isnan(getattr(joint, k)), f"'{k}' is NaN", "write a number") for k in COLUMNS[1:]),
        (joint.lower > joint.upper, f"lower limit {joint.lower:g} > upper {joint.upper:g}", "swap them"),
        (joint.velocity < 0.0, f"velocity limit {joint.velocity:g} < 0", "write a positive number"),
        (not joint.effort > 0.0, f"effort limit {joint.effort:g}", "write a positive number [Nm, N], or leave it out"),
        (not 0.0 <= joint.armature < np.inf, f"armature {joint.armature:g}", "write a finite number of at least 0"),
    ):
        if wrong:
            raise LoadError(file, joint.element, problem, mend)
    return dataclasses.replace(joint, axis=unit)


def _bodies(content: Sequence[Link], offsets: Sequence[np.ndarray], counts: Sequence[int], n: int) -> tuple[Body, ...]:
    """The inertia of all links that move with a joint, about their common centre of gravity, in the joint's frame."""
    if not any(link.mass or link.inertia.any() for link in content):
        return ()
    each = [
        Body(np.asarray(link.mass, np.float64), link.com, link.inertia).moved(o)
        for link, o in zip(content, offsets, strict=True)
    ]
    moved = lambda joint: [b for b, c in zip(each, counts, strict=True) if c == joint]
    return tuple(Body.fused(moved(joint)) for joint in range(1, n + 1))
