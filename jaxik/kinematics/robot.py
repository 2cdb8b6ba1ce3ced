"""The robot: a tree of joints, which every function of this library takes; a serial arm is its simplest case.

A robot never changes: its arrays cannot be written. They are the leaves of a pytree, so that any of them may be traced:
differentiate the reach with respect to a link's length by `dataclasses.replace`. Names and joint types are static. Numbers that
are concrete while JAX traces fold into the program, so close over a robot (`jax.jit(lambda q: forward_kinematics(robot, q))`)
rather than pass it through `jit`: both are right, the first is several times faster. Only a robot whose shapes are such numbers
is checked by its `convex_parts` and `pair_tables`, too; any other by its volumes alone, which are larger than the links.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxik.checks.arrays import Array, as_given, as_numbers, check_mass, is_known, rigid_frame
from jaxik.checks.options import check_kind, no_such, shown
from jaxik.kinematics.drive import Drive, column
from jaxik.kinematics.link_distance_table import PairTable
from jaxik.kinematics.named import Group, State
from jaxik.kinematics.shapes import Box, ConvexPart, Surface, Unchecked, Value, Volume, hashed
from jaxik.kinematics.tree import JointType, Mimic, Tree, check_structure, tree_of
from jaxik.pytree import Constant, static


class Body(Constant):
    """Mass [kg], centre of gravity [m] and inertia about it [kg m2] of what moves with one joint, in that joint's frame.

    Raises `ValueError` for other shapes; numbers that no body can have are refused where they are used.
    """

    mass: Float[Array, ""]
    com: Float[Array, "3"]
    inertia: Float[Array, "3 3"]

    def __post_init__(self) -> None:
        shapes = {"mass": (), "com": (3,), "inertia": (3, 3)}
        vars(self).update({name: as_given(f"Body: {name}", getattr(self, name), shape) for name, shape in shapes.items()})
        super().__post_init__()

    def moved(self, a_T_b: Any) -> Body:
        """Returns a body in frame b in frame a."""
        turn = a_T_b[:3, :3]
        return Body(self.mass, turn @ self.com + a_T_b[:3, 3], turn @ self.inertia @ turn.T)

    @staticmethod
    def fused(bodies: Sequence[Body]) -> Body:
        """Fuses bodies in one frame into one, about their common centre of gravity."""
        mass = sum((b.mass[None] for b in bodies), np.zeros(1)).reshape(())
        com = sum((b.mass * b.com for b in bodies), np.zeros(3)) / (mass + (mass == 0.0))
        inertia = np.zeros((3, 3))
        for body in bodies:
            inertia = inertia + body.inertia + steiner(body.mass, body.com - com)
        return Body(mass, com, inertia)


class Robot(Value, Constant):
    """A tree of n movable joints from a base to its tips, mostly a serial chain to one tip; fixed joints are fused away.

    `parent_T_joint[i]` is the frame of joint i at q_i = 0 in the (moved) frame of the joint that it hangs on, `parents[i]`: -1
    is the base, and without `parents` each hangs on the one before. `mimics` are joints that follow one of the n: they have
    rows after those of the n in `parent_T_joint`, `axis`, `bodies` and `parents` (m,), m >= n. `link_joint[l]` is the number of
    the row that moves link l, counted from 1, 0 of the base: its frame is `link_offset[l]` in that row's. `joint_T_tip` (4, 4)
    is the tip in the frame of the last joint; or (k, 4, 4), of k tips, which hang on `tip_joints` (numbers as `link_joint`).
    `groups` and `states` are names of some joints, and of values of them, as an SRDF gives.
    `self_pairs` are the links to check against each other, `ignored` links with the object of a scene ("*": any) not to check,
    `pair_tables` bounds of pairs beside their volumes, `unchecked` the pairs that are left out, and why. `convex_parts` of
    fitted meshes decide near a contact, or the links' own `surfaces` (`load(.., exact=True)`). `armature` is the inertia of
    each joint's rotor at the joint, behind its gears [kg m2, kg]; 0 unless given. `effort` is the most that its drive gives
    [Nm, N], infinite unless given; functions keep to it where asked, as by `torque=robot.effort`. `drives` has one for each
    joint, or is empty.
    """

    # not in the instance's dictionary, which copies and pickles take over
    __slots__ = ("_digest",)

    name: str = static()
    joint_names: tuple[str, ...] = static()
    joint_types: tuple[JointType, ...] = static()
    link_names: tuple[str, ...] = static()
    link_joint: tuple[int, ...] = static()
    parent_T_joint: Float[Array, "m 4 4"]
    axis: Float[Array, "m 3"]
    joint_T_tip: Float[Array, "*k 4 4"]
    link_offset: Float[Array, "l 4 4"]
    lower: Float[Array, " n"]
    upper: Float[Array, " n"]
    velocity: Float[Array, " n"]
    world_T_base: Float[Array, "4 4"]
    bodies: tuple[Body, ...] = ()
    boxes: tuple[Box, ...] = ()
    volumes: tuple[Volume, ...] = ()
    self_pairs: tuple[tuple[int, int], ...] = static(default=())
    spheres_per_box: int = static(default=8)
    unread_meshes: tuple[str, ...] = static(default=())
    ignored: tuple[tuple[int, str], ...] = static(default=())
    pair_tables: tuple[PairTable, ...] = static(default=())
    armature: Float[Array, " n"] = dataclasses.field(default_factory=lambda: np.zeros(0))
    drives: tuple[Drive, ...] = ()
    effort: Float[Array, " n"] = dataclasses.field(default_factory=lambda: np.zeros(0))
    unchecked: tuple[Unchecked, ...] = static(default=())
    surfaces: tuple[Surface, ...] = static(default=())
    convex_parts: tuple[ConvexPart, ...] = static(default=())
    parents: tuple[int, ...] = static(default=())
    mimics: tuple[Mimic, ...] = ()
    tip_joints: tuple[int, ...] = static(default=())
    tip_names: tuple[str, ...] = static(default=())
    groups: tuple[Group, ...] = static(default=())
    states: tuple[State, ...] = static(default=())

    def __post_init__(self) -> None:
        self._settle_structure()
        for name, default in (("armature", 0.0), ("effort", np.inf)):
            if self.num_joints and np.shape(getattr(self, name)) == (0,):
                vars(self)[name] = np.full(self.num_joints, default)
        super().__post_init__()

    def _settle_structure(self) -> None:
        """Checks how the bodies hang together, and leaves out what a serial arm need not say: so it equals itself however it
        was made."""
        rows = self.num_joints + len(self.mimics)
        check_structure("robot", self.parents, self.num_joints, [m.joint for m in self.mimics])
        for number in self.tip_joints:
            if not 0 <= number <= rows:
                raise ValueError(f"robot: a tip hangs on joint {number}; allowed: 0 (the base) to {rows}")
        tree = tree_of(self.parents, self.joint_types, tuple((m.type, m.joint) for m in self.mimics))
        if tree.serial:
            single = np.ndim(self.joint_T_tip) == 2 and self.tip_joints == (rows,)
            vars(self).update(parents=(), tip_joints=() if single else self.tip_joints)
        assert len(tree.order) == rows  # raises where rows hang on each other

    @property
    def num_joints(self) -> int:
        return len(self.joint_names)

    @functools.cached_property
    def tree(self) -> Tree:
        """How the bodies that move hang together."""
        return tree_of(self.parents, self.joint_types, tuple((m.type, m.joint) for m in self.mimics))

    @property
    def tips(self) -> tuple[int, ...]:
        """The numbers of the rows that the tips hang on, as `link_joint` counts them."""
        return self.tip_joints or (len(self.tree.parents),)

    @property
    def row_names(self) -> tuple[str, ...]:
        """The joints that move the m bodies, those that follow one of the n last."""
        return (*self.joint_names, *(mimic.name for mimic in self.mimics))

    @property
    def is_prismatic(self) -> tuple[bool, ...]:
        return tuple(t == "prismatic" for t in self.joint_types)

    @property
    def is_limited(self) -> np.ndarray:
        """(n,): whether a joint has both limits."""
        return np.isfinite(self.lower) & np.isfinite(self.upper)

    @property
    def finite_limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Limits (n,), (n,) to sample, draw or scale by: a joint without any ranges over +-pi [rad] or +-1 [m], a joint with a
        single limit over as much beside it."""
        return finite_range(self, self.lower, self.upper)

    def within_limits(self, q: Any) -> Bool[Array, ""]:
        """Whether `q` (n,) [rad, m] lies inside the joint limits, bounds included. Traced."""
        q = as_configuration(self, q)
        return jnp.all((q >= jnp.asarray(self.lower, q.dtype)) & (q <= jnp.asarray(self.upper, q.dtype)))

    def group(self, name: str) -> np.ndarray:
        """Returns which of q (n,) belong to a group of joints, by its name in `groups`: their numbers (k,).

        Raises `ValueError` for a name that is none.
        """
        found = {group.name: group.joints for group in self.groups}
        if name not in found:
            raise ValueError(no_such(f"group: {self.name}", "group", str(name), tuple(found)))
        return np.array([self.joint_names.index(joint) for joint in found[name]], int)

    def state(self, name: str, *, q: Any = None, group: str | None = None) -> Float[np.ndarray, " n"]:
        """Returns a configuration (n,) [rad, m] with the joints of a named state as it says, of all groups that have one of
        this name or of one `group`; the others as in `q` (n,), or at 0 or the limit that is nearest.

        Raises `ValueError` for a name that is none, and where two groups say different values of one joint.
        """
        own = [state for state in self.states if state.name == name and group in (None, state.group)]
        if not own:
            raise ValueError(no_such(f"state: {self.name}", "state", str(name), tuple({s.name: 0 for s in self.states})))
        rest = np.clip(0.0, self.lower, self.upper) if q is None else as_configuration(self, q)
        found, said = np.array(rest, np.float64), dict[str, float]()
        for joint, value in (pair for state in own for pair in state.values):
            if said.setdefault(joint, value) != value:
                of = " and ".join(state.group for state in own)
                raise ValueError(f"state: '{shown(name)}' of {of} says two values of {joint}; choose one by group=")
            found[self.joint_names.index(joint)] = value
        return found

    def mounted(self, world_T_base: Any) -> Robot:
        """The same robot standing elsewhere: `world_T_base` (4, 4) [m]. Poses stay in the base's.

        Raises `ValueError` for what is no rigid frame.
        """
        return dataclasses.replace(self, world_T_base=rigid_frame("world_T_base", world_T_base))

    def with_tips(self, tips: str | Sequence[str]) -> Robot:
        """The same robot, and the same q, with other tips: the link of a name, or the links of a list, whose poses are then
        (k, 4, 4). So every function of a tip is one of any link. The name of a tip that it has is that tip, with its tool.

        Raises `ValueError` for a name that is none of `link_names` or `tip_names`.
        """
        names = [tips] if isinstance(tips, str) else list(tips)
        if not names:
            raise ValueError(f"with_tips: no tip is named; write some of: {', '.join(self.link_names[:8])}")
        known = dict(zip(self.link_names, zip(self.link_joint, self.link_offset, strict=True), strict=True))
        if len(self.tips) == len(self.tip_names):
            known |= dict(zip(self.tip_names, zip(self.tips, self.tip_frames, strict=True), strict=True))
        for name in names:
            if name not in known:
                raise ValueError(no_such(f"with_tips: {self.name}", "link", str(name), tuple(known)))
        numbers, frames = zip(*(known[name] for name in names), strict=True)
        stacked = frames[0] if isinstance(tips, str) else (np if is_known(frames) else jnp).stack(frames)
        return dataclasses.replace(self, joint_T_tip=stacked, tip_joints=numbers, tip_names=tuple(names))

    @property
    def tip_frames(self) -> Any:
        """The tips (k, 4, 4) in the frames of the rows that they hang on [m]."""
        return self.joint_T_tip.reshape(-1, 4, 4)

    def with_tool(self, tip_T_tool: Any) -> Robot:
        """The same robot with its tip, or each of its tips, moved to a tool frame, `tip_T_tool` (4, 4) [m].

        Raises `ValueError` for what is no rigid frame.
        """
        return dataclasses.replace(self, joint_T_tip=self.joint_T_tip @ rigid_frame("tip_T_tool", tip_T_tool))

    def with_drives(self, drives: Iterable[Drive]) -> Robot:
        """The same robot with these drives, one a joint, and their rotors as its armature; or without drives.

        Where a drive has no rotor the joint keeps the armature that its file gives it. Raises `ValueError` for another number
        of drives.
        """
        drives = tuple(drives) if isinstance(drives, Iterable) else (drives,)
        for drive in drives:
            check_kind("with_drives", "a drive", drive, Drive)
        if len(drives) not in (0, self.num_joints):
            raise ValueError(f"with_drives: {len(drives)} drives; {self.name} has {self.num_joints} joints, write one for each")
        rotors, before = ([drive.armature for drive in each] for each in (drives, self.drives))
        if not is_known((rotors, before, self.armature)):
            return dataclasses.replace(self, drives=drives, armature=jnp.stack(rotors) if drives else self.armature)
        of_file = np.where(np.array(before) > 0.0, 0.0, self.armature) if before else self.armature
        armature = np.where(np.array(rotors) > 0.0, rotors, of_file) if drives else self.armature
        return dataclasses.replace(self, drives=drives, armature=armature)

    def with_load(self, mass: Any, *, com: Any = (0.0, 0.0, 0.0), inertia: Any = None) -> Robot:
        """The same robot with a load at its tip: `mass` [kg], `com` (3,) [m] and `inertia` (3, 3) about it [kg m2] in the tip's
        frame; a point mass unless `inertia` is given.

        Raises `ValueError` for a robot without bodies, and for what no body can be.
        """
        if not self.bodies:
            raise ValueError(f"with_load: {self.name} has no bodies, which a load could be added to; give them first")
        row = self.only_tip("with_load") - 1
        if row < 0:
            raise ValueError(f"with_load: the tip of {self.name} is on its base, which does not move; take robot.with_tips(..)")
        own = np.zeros((3, 3)) if inertia is None else inertia
        given = ("mass", mass, ()), ("com", com, (3,)), ("inertia", own, (3, 3))
        load = Body(*(as_given(f"with_load: {name}", value, shape) for name, value, shape in given))
        if is_known(load):
            check_mass("with_load: the load", load.mass, load.com, load.inertia)
        last = Body.fused([self.bodies[row], load.moved(self.tip_frames[0])])
        return dataclasses.replace(self, bodies=(*self.bodies[:row], last, *self.bodies[row + 1 :]))

    def only_tip(self, who: str) -> int:
        """Returns the number of the row that the tip hangs on. Raises `ValueError` of `who` for a list of tips."""
        if np.ndim(self.joint_T_tip) == 3:
            mend = f"choose one: robot.with_tips({shown(next(iter(self.tip_names), 'link'))!r})"
            raise ValueError(f"{who}: {self.name} has a list of tips ({', '.join(self.tip_names)}); {mend}")
        return self.tips[0]

    @property
    def parameters(self) -> Float[Array, " p"]:
        """The bodies as `dynamics.regressor` multiplies them (10 m,): of each m [kg], m c [kg m] and Ixx Ixy Iyy Ixz Iyz Izz
        [kg m2], the moments about the origin of its joint's frame, in that frame's axes. Traced.

        Raises `ValueError` for a robot without bodies.
        """
        need_bodies("parameters", self)
        every: list[Any] = []
        for body in self.bodies:
            inertia = body.inertia + steiner(body.mass, body.com)
            every += [body.mass, *(body.mass * body.com), *(inertia[i, j] for i, j in ENTRIES)]
        return np.array(every) if is_known(every) else jnp.stack(every)

    def with_parameters(self, parameters: Any) -> Robot:
        """The same robot with bodies of other `parameters` (10 m,). Traced.

        Raises `ValueError` for another shape, and for first moments without a mass. Parameters that no body can have are
        refused where the bodies are used.
        """
        rows = as_given("with_parameters: parameters", parameters, (INERTIAL * len(self.row_names),)).reshape(-1, INERTIAL)
        for name, row in zip(self.row_names, rows, strict=True) if is_known(rows) else ():
            if row[0] == 0.0 and np.any(row[1:4]):
                raise ValueError(f"with_parameters: joint '{name}' moves a mass of 0 kg with moments m com; write a mass > 0")
        bodies = []
        for row in rows:
            mass, com = row[:1].reshape(()), row[1:4] / (row[0] + (row[0] == 0.0))
            bodies.append(Body(mass, com, row[TENSOR] - steiner(mass, com)))
        return dataclasses.replace(self, bodies=tuple(bodies))

    def torsion(self, torque: Any) -> Float[Array, " n"]:
        """Returns how far the motors are ahead of the joints, `q_motor / N - q = T / c` (n,) [rad, m], for `torque` (n,) [Nm,
        N].

        Traced. Raises `ValueError` for a robot without drives. Source: Schuetz 2017, (3.17), which prints the difference the
        other way round, and q_motor without its ratio.
        """
        drives, torque = need_drives("torsion", self), as_joint_numbers("torsion: torque", self, torque)
        return torque / column(drives, lambda d: d.stiffness, torque.dtype)

    def with_spheres(self, per_box: int) -> Robot:
        """The same robot, each box covered by 1, 8, 64 or 512 spheres [Van Henten et al. 2010, App. A]."""
        whole = isinstance(per_box, int | np.integer) and not isinstance(per_box, bool)
        if not whole or per_box not in (1, 8, 64, 512):
            raise ValueError(f"with_spheres: {shown(per_box)} spheres a box; allowed: 1, 8, 64, 512")
        return dataclasses.replace(self, spheres_per_box=int(per_box))

    def part(self, first: int, last: int, *, base: bool = False) -> Robot:
        """Joints `first` to `last - 1` of a serial arm as a robot of their own, with what moves with them; its base is the
        parent of the first, with what stands on it if `base` is asked for.

        Its tip is the last joint's frame, or the robot's own tip where it ends there. Raises `ValueError` for joints that the
        robot does not have, and for a robot that is no serial arm.
        """
        need_serial("part", self)
        self.only_tip("part")
        whole = all(isinstance(i, int | np.integer) and not isinstance(i, bool) for i in (first, last))
        if not (whole and 0 <= first <= last <= self.num_joints):
            raise ValueError(
                f"part: joints {shown(first)} to {shown(last)}; allowed: 0 <= first <= last <= {self.num_joints}, whole numbers"
            )
        first, last = int(first), int(last)  # the links' joints are static, and plain
        kept = [i for i, j in enumerate(self.link_joint) if first < j + base and j <= last]
        link = {old: new for new, old in enumerate(kept)}
        cut = slice(first, last)
        joints = self.joint_names[cut]
        own = lambda parts: tuple(dataclasses.replace(part, link=link[part.link]) for part in parts if part.link in link)
        return dataclasses.replace(
            self,
            **{name: getattr(self, name)[cut] for name in _OF_JOINTS},
            link_names=tuple(self.link_names[i] for i in kept),
            link_joint=tuple(self.link_joint[i] - first for i in kept),
            joint_T_tip=self.joint_T_tip if last == self.num_joints else np.eye(4),
            tip_names=self.tip_names if last == self.num_joints else (),
            link_offset=self.link_offset[np.array(kept, int)],
            boxes=own(self.boxes),
            volumes=own(self.volumes),
            surfaces=own(self.surfaces),
            convex_parts=own(self.convex_parts),
            self_pairs=tuple((link[a], link[b]) for a, b in self.self_pairs if a in link and b in link),
            groups=tuple(
                Group(g.name, own_joints) for g in self.groups if (own_joints := tuple(j for j in g.joints if j in joints))
            ),
            states=tuple(s._replace(values=tuple((j, v) for j, v in s.values if j in joints)) for s in self.states),
            unread_meshes=tuple(n for n in self.unread_meshes if n in (self.link_names[i] for i in kept)),
            ignored=tuple((link[i], name) for i, name in self.ignored if i in link),
            unchecked=tuple(u for u in self.unchecked if all(n in (self.link_names[i] for i in kept) for n in u.links)),
            pair_tables=tuple(
                dataclasses.replace(t, links=(link[a], link[b]), joints=(i - first, j - first))
                for t, (a, b), (i, j) in ((t, t.links, t.joints) for t in self.pair_tables)
                if a in link and b in link
            ),
        )

    def __repr__(self) -> str:
        head = f"Robot {self.name}: {self.num_joints} joints, {len(self.link_names)} links, {len(self.boxes)} boxes, "
        head += f"{len(self.volumes)} volumes, {len(self.self_pairs)} pairs of links to check, {len(self.pair_tables)} tables"
        head += f", {len(self.convex_parts)} convex parts" if self.convex_parts else ""
        head += f"; exact, {sum(len(s.corners) for s in self.surfaces):,} triangles" if self.surfaces else ""
        head += f"; {len(self.tips)} tips: {', '.join(self.tip_names)}" if len(self.tips) > 1 else ""
        head += f"; meshes of {len(self.unread_meshes)} links not read" if self.unread_meshes else ""
        spans = [""] * self.num_joints
        if all(isinstance(x, np.ndarray | jax.Array) and is_known(x) for x in (self.lower, self.upper)):
            limits = zip(self.lower, self.upper, self.is_prismatic, strict=True)
            spans = [f" {low:.4g} to {high:.4g} {'m' if slides else 'rad'}" for low, high, slides in limits]
        rows = zip(self.joint_names, self.joint_types, spans, strict=True)
        follow = [f"  {m.name}: {m.type}, follows {self.joint_names[m.joint]}" for m in self.mimics]
        return "\n".join([head, *(f"  {name}: {kind}{span}" for name, kind, span in rows), *follow])

    # A concrete robot is a value: equal numbers, equal robot. So it may be a static argument of `jax.jit` and a cache's key.

    @property
    def digest(self) -> str:
        """A hash of everything in the robot, to name it in caches and results. Needs concrete numbers."""
        known = getattr(self, "_digest", None)  # a robot never changes, and asks for this at every call of a cached function
        if known is None:
            friction = [drive.friction for drive in self.drives]
            for each in (self, *self.bodies, *self.boxes, *self.volumes, *self.drives, *friction, *self.mimics):
                each.freeze()  # `jax.tree_util.tree_map` puts arrays in without a constructor
            known = self._computed_digest()
            object.__setattr__(self, "_digest", known)
        return known

    def _computed_digest(self) -> str:
        leaves, tree = jax.tree_util.tree_flatten(self)
        return hashed(tree, leaves)


# what a robot has of each joint
_NUMBERS = ("parent_T_joint", "axis", "lower", "upper", "velocity", "effort", "armature")
_OF_JOINTS = ("joint_names", "joint_types", *_NUMBERS, "bodies", "drives")


INERTIAL = 10  # parameters of a body
ENTRIES = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))  # of its inertia, in their order
TENSOR = np.array([[4, 5, 7], [5, 6, 8], [7, 8, 9]])  # where these are among the parameters


def need_serial(who: str, robot: Robot) -> None:
    """Raises `ValueError` of `who` for a robot that is no serial arm: with branches, mimic joints, several tips, or a tip that
    is not at its end."""
    check_kind(who, "robot", robot, Robot)
    if robot.tree.serial and robot.tips == (robot.num_joints,):
        return
    branches = sum(row not in robot.tree.parents for row in range(len(robot.row_names)))
    what = [f"{branches} branches"] * (branches > 1) + [f"{len(robot.mimics)} mimic joints"] * bool(robot.mimics)
    what += [f"{len(robot.tips)} tips"] * (len(robot.tips) > 1) or ["a tip that is not at its end"] * (not what)
    mend = f"take one branch: kinematics.branch_to(robot, {shown(robot.tip_names[0] if robot.tip_names else 'link')!r})"
    raise ValueError(f"{who}: {robot.name} has {' and '.join(what)}; this takes a serial arm: {mend}")


def need_bodies(who: str, robot: Robot) -> None:
    """Raises `ValueError` of `who` for a robot whose joints have no bodies."""
    check_kind(who, "robot", robot, Robot)
    if not robot.bodies:
        mend = "write mass, com and inertia of its joints in its file, or give them by robot.with_parameters"
        raise ValueError(f"{who}: {robot.name} has no bodies; {mend}")
    if len(robot.bodies) != len(robot.row_names):
        raise ValueError(
            f"{who}: {len(robot.bodies)} bodies; {robot.name} has {len(robot.row_names)} joints, write one for each"
        )
    as_given(f"{who}: armature", robot.armature, (robot.num_joints,))


def need_drives(who: str, robot: Robot) -> tuple[Drive, ...]:
    """Returns the drives, one a joint. Raises `ValueError` of `who` for a robot without drives."""
    check_kind(who, "robot", robot, Robot)
    if len(robot.drives) != robot.num_joints:
        mend = "write [joint.drive] in its TOML file, or use robot.with_drives"
        raise ValueError(f"{who}: {robot.name} has no drives; {mend}")
    for drive in robot.drives:
        drive.judged()
    return robot.drives


def steiner(mass: Any, arm: Any) -> Any:
    """Returns the inertia (3, 3) [kg m2] that a mass [kg] adds at an arm (3,) [m]."""
    return mass * (arm @ arm * np.eye(3) - arm[:, None] * arm)


def moving(robot: Robot, number: int) -> set[int]:
    """The joints, counted from 0, that move what a row moves, counted from 1 (0: the base, which none does)."""
    return {robot.tree.joints[row] for row in robot.tree.way(number)}


def solid_links(robot: Robot) -> list[int]:
    """The links that have collision geometry, from the base on."""
    return sorted({box.link for box in robot.boxes} | {volume.link for volume in robot.volumes})


def link_geometry(robot: Robot, link: int) -> str:
    """A hash of a link's volumes and boxes."""
    shapes = [(v.corners, v.radius) for v in robot.volumes if v.link == link]
    shapes += [(b.joint_T_box, b.half) for b in robot.boxes if b.link == link]
    return hashed([[np.shape(x) for x in shape] for shape in shapes], [x for shape in shapes for x in shape])


def known_parts(robot: Robot) -> tuple[ConvexPart, ...]:
    """The convex parts of links whose volumes are those that these parts are known for."""
    geometry = {link: link_geometry(robot, link) for link in {part.link for part in robot.convex_parts}}
    return tuple(part for part in robot.convex_parts if part.geometry == geometry[part.link])


def geometry_between(robot: Robot, links: tuple[int, int], joints: tuple[int, int]) -> str:
    """A hash of all that decides the distance of two links at given values of the joints between, two of which are `joints`:
    these joints' frames and axes, and the links' shapes."""
    rows = np.array([row for way in robot.tree.apart(*(robot.link_joint[link] for link in links)) for row in way], int)
    shapes = [(v.link == links[0], v.corners, v.radius) for v in robot.volumes if v.link in links]
    shapes += [(b.link == links[0], b.joint_T_box, b.half) for b in robot.boxes if b.link in links]
    kinds = (*robot.joint_types, *(m.type for m in robot.mimics))
    first = rows[0] if len(rows) else robot.link_joint[links[0]]
    words = tuple(kinds[row] for row in rows), [int(j - first) for j in joints], len(shapes)
    return hashed(words, [robot.parent_T_joint[rows], robot.axis[rows], *(x for shape in shapes for x in shape)])


def finite_range(robot: Robot, lower: Any, upper: Any) -> tuple[np.ndarray, np.ndarray]:
    """Returns bounds (n,), (n,) [rad, m] completed as `Robot.finite_limits`."""
    half = np.where(robot.is_prismatic, 1.0, np.pi)
    below, above = np.isfinite(lower), np.isfinite(upper)
    low = np.where(below, lower, np.where(above, upper - 2.0 * half, -half))
    return low, np.where(above, upper, np.where(below, lower + 2.0 * half, half))


def beyond_limits(robot: Robot, q: np.ndarray, by: float) -> str | None:
    """Says which value of q (k, n) is the furthest beyond its joint's limits; None where none is by more than `by` [rad, m].
    Host."""
    beyond = np.maximum(robot.lower - q, q - robot.upper)
    row, joint = np.unravel_index(np.argmax(beyond), beyond.shape)
    if not beyond[row, joint] > by:
        return None
    unit, slip = ("m", "millimetres") if robot.is_prismatic[joint] else ("rad", "degrees")
    limits = f"limits are {robot.lower[joint]:.4g} and {robot.upper[joint]:.4g} [{unit}]; are these {slip}?"
    return f"{robot.joint_names[joint]} is {q[row, joint]:.6g} in row {row}, and its {limits}"


def as_configuration(robot: Robot, q: Any) -> Float[Array, " n"]:
    """`q` as a floating-point array of shape (n,), or a `ValueError` that says what was expected."""
    check_kind("configuration", "robot", robot, Robot)
    q = as_numbers("q", q)
    if q.shape != (robot.num_joints,):
        raise ValueError(
            f"q has shape {q.shape}; {robot.name} takes one configuration of shape ({robot.num_joints},) "
            f"[{', '.join(robot.joint_names)}]; for a batch use jax.vmap"
        )
    return _floats(q)


def as_joint_numbers(what: str, robot: Robot, given: Any) -> Float[jax.Array, " n"]:
    """One number a joint (n,), as floats. Raises `ValueError` for another shape."""
    return _floats(as_numbers(what, given, (robot.num_joints,)))


def _floats(x: jax.Array) -> jax.Array:
    return x if jnp.issubdtype(x.dtype, jnp.floating) else x.astype(jnp.result_type(float))
