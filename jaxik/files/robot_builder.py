"""Makes a robot of its joints, each with the link before it, which every robot file becomes; checks it in one place.

`Notes` collects what a file says and its robot cannot hold, a line of warning each; and the links that it lets pass.
"""

from __future__ import annotations

import collections
import dataclasses
import itertools
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, get_args

import numpy as np
from numpy.polynomial import Polynomial

from jaxik.checks.options import shown
from jaxik.kinematics.drive import Drive, Friction
from jaxik.kinematics.robot import Body, Robot
from jaxik.kinematics.shapes import Box, Volume
from jaxik.kinematics.tree import JointType, Mimic
from jaxik.reasons import LoadError
from jaxik.spatial.rotations import about, frame

NAMED = 4  # in one line
COLUMNS = ("axis", "lower", "upper", "velocity", "effort", "armature")  # numbers of a joint that a robot has, too
JOINT_TYPES = (*get_args(JointType), "fixed")


@dataclasses.dataclass
class Notes:
    """Lines to tell (`told`: what is so, of which joints or links), pairs of links that the file does not check (`apart`), all
    links that it has, those that are no part of the robot, too; and of each link the joint and the link `above` it."""

    told: dict[str, list[str]] = dataclasses.field(default_factory=dict)
    apart: set[frozenset[str]] = dataclasses.field(default_factory=set)
    links: tuple[str, ...] = ()
    above: dict[str, tuple[str, str]] = dataclasses.field(default_factory=dict)

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
    follows: tuple[str, float, float] | None = None  # of a robot's own: that it follows a joint, by a factor and an offset
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


class Tip(NamedTuple):
    """A tip of a robot: the name that it is asked by, the link that it is on, and its frame there (4, 4)."""

    name: str
    link: str
    link_T_tip: np.ndarray


def assemble(
    file: Path,
    name: str,
    base: str,
    joints: Sequence[Joint],
    links: dict[str, Link],
    tool: np.ndarray | None = None,
    mount: np.ndarray | None = None,
) -> Robot:
    """The serial robot of `joints`, in order from `base`, with its tip at the last one's link, or at the `tool` there."""
    pairs = [*zip([base, *(joint.child for joint in joints)], joints, strict=False)]
    tip = Tip("", joints[-1].child if joints else base, np.eye(4) if tool is None else tool)
    return assemble_tree(file, name, base, pairs, links, tip, mount)


def assemble_tree(
    file: Path,
    name: str,
    base: str,
    pairs: Sequence[tuple[str, Joint]],
    links: dict[str, Link],
    tips: Tip | Sequence[Tip],
    mount: np.ndarray | None = None,
) -> Robot:
    """The robot of joints, each with its parent link and after it; fixed joints fuse into the frames of what they carry.

    Joints that follow others (`follows`) are none of its own. With a single tip, rather than a list of them, it has one pose.
    """
    every = [joint for _, joint in pairs]
    unique(file, "link", (base, *(j.child for j in every)))
    for joint in every:
        _finite(file, joint.element, "origin", joint.parent_T_joint)
    moving = [j for j in every if j.type != "fixed"]
    unique(file, "joint", (j.name for j in moving))
    free, follow = ([checked(file, j) for j in moving if (j.follows is None) == own] for own in (True, False))
    if not free:
        raise LoadError(file, f"chain from '{base}'", "has no movable joint", "choose another base or tip")
    number = {j.name: i for i, j in enumerate([*free, *follow], 1)}
    places, frames, parents = {base: (np.eye(4), 0)}, [np.eye(4)] * len(number), [-1] * len(number)
    for parent, joint in pairs:  # the place of each link: in the frame of the joint that moves it, and which that is
        offset, count = places[parent]
        offset = offset @ joint.parent_T_joint
        if joint.type != "fixed":
            row = number[joint.name] - 1
            frames[row], parents[row] = offset, count - 1
            offset, count = np.eye(4), row + 1
        places[joint.child] = offset, count
    names, (offsets, counts) = tuple(places), zip(*places.values(), strict=True)
    content = [links.get(name, Link()) for name in names]
    each = [*enumerate(zip(content, offsets, strict=True))]
    mimics = tuple(_mimic(joint, free) for joint in follow)
    stacked: dict[str, Any] = {k: np.array([getattr(j, k) for j in free]) for k in COLUMNS if k != "axis"}
    several = [tips] if isinstance(tips, Tip) else [*tips]
    placed = [(places[tip.link][0] @ tip.link_T_tip, places[tip.link][1]) for tip in several]
    return Robot(
        name=name,
        joint_names=tuple(j.name for j in free),
        joint_types=tuple(j.type for j in free),  # type: ignore[misc]
        link_names=names,
        link_joint=counts,
        parent_T_joint=np.array(frames),
        axis=np.array([j.axis for j in (*free, *follow)]),
        joint_T_tip=placed[0][0] if isinstance(tips, Tip) else np.array([frame for frame, _ in placed]),
        link_offset=np.array(offsets),
        world_T_base=np.eye(4) if mount is None else mount,
        bodies=_bodies(content, offsets, counts, len(frames)),
        boxes=tuple(Box(o @ t, h, i) for i, (c, o) in each for t, h in c.boxes),
        volumes=tuple(Volume(p @ o[:3, :3].T + o[:3, 3], np.asarray(r), i) for i, (c, o) in each for p, r in c.volumes),
        unread_meshes=tuple(n for n, c in zip(names, content, strict=True) if c.meshes),
        drives=all_or_none(file, {j.name: j.drive for j in free}),
        parents=tuple(parents),
        mimics=mimics,
        tip_joints=tuple(count for _, count in placed),
        tip_names=() if isinstance(tips, Tip) else tuple(tip.name for tip in several),
        **stacked,
    )


def _mimic(joint: Joint, free: Sequence[Joint]) -> Mimic:
    """A joint that follows one of those that are free, which feels its rotor and its friction through the factor."""
    assert joint.follows is not None
    name, factor, offset = joint.follows
    (number,) = (i for i, j in enumerate(free) if j.name == name)
    leader = free[number]
    leader.armature += factor**2 * joint.armature
    if leader.drive is not None:  # where one joint of a robot has a drive, all have
        before, own = leader.drive, (joint.drive or Drive()).friction
        rubs = dataclasses.replace(
            before.friction,
            coulomb=before.friction.coulomb + abs(factor) * own.coulomb,
            breakaway=_known(before.friction.breakaway) + abs(factor) * _known(own.breakaway),
            viscous=before.friction.viscous + factor**2 * own.viscous,
        )
        leader.drive = dataclasses.replace(before, rotor_inertia=leader.armature, friction=rubs)
    return Mimic(joint.name, joint.type, number, np.asarray(factor), np.asarray(offset))  # type: ignore[arg-type]


def _known(value: Any) -> float:
    """A number of a drive that a file gives."""
    return float(value)


MOVING_BASES = {
    "planar": (("x", "prismatic", 0), ("y", "prismatic", 1), ("heading", "continuous", 2)),
    "floating": (
        *((axis, "prismatic", i) for i, axis in enumerate("xyz")),
        *((turn, "continuous", i) for turn, i in (("yaw", 2), ("pitch", 1), ("roll", 0))),
    ),
}


def moving_base(kind: str, root: str, taken: Iterable[str], root_T: np.ndarray | None = None) -> list[tuple[str, Joint]]:
    """The joints of a base that moves, each with its parent, from a new link "world" to the `root`, which stands at `root_T`
    (4, 4) where all of them are 0: "planar", x, y [m] and heading [rad]; or "floating", x, y, z and then yaw, pitch, roll, the
    turns about its own z, y and x axes in this order. None has a limit."""
    known = {*taken}
    free = lambda name: next(n for i in itertools.count() if (n := f"{name}_{i}" if i else name) not in known)
    parent, pairs = free("world"), []
    for what, type_, axis in MOVING_BASES[kind]:
        name = free(f"base_{what}")
        pairs.append((parent, Joint(name, type_, np.eye(4), name, np.eye(3)[axis])))
        parent = name
    return [*pairs, (parent, Joint(free("base_fixed"), "fixed", np.eye(4) if root_T is None else root_T, root))]


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
