"""Robot files to robots. The only place that reads them."""

from __future__ import annotations

import dataclasses
import itertools
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxik.checks.arrays import rigid_frame
from jaxik.checks.options import check_finite, check_kind, shown
from jaxik.collision.self_collision_pairs import self_collisions
from jaxik.files.documents import locate
from jaxik.files.held_joints import Posture
from jaxik.files.mesh import Meshes, as_packages
from jaxik.files.mjcf import load_mjcf
from jaxik.files.robot_builder import Notes
from jaxik.files.robot_files import read_robot
from jaxik.files.robot_toml import load_toml, read_toml
from jaxik.files.srdf import read_srdf
from jaxik.files.tree_ways import AskedTips, Tips
from jaxik.files.unchecked_pairs import asked_pairs, disabled_pairs, ignored
from jaxik.files.urdf import load_urdf
from jaxik.fitting.capsules import FitOptions
from jaxik.fitting.links import Shape, link_surfaces
from jaxik.fitting.model import FitReport, fit_of, modelled
from jaxik.kinematics.robot import Robot, solid_links
from jaxik.kinematics.shapes import Unchecked
from jaxik.options import Options, anything, flag, instance
from jaxik.reasons import LoadError

FIT = FitOptions()  # this very object tells that none was given
TOLD = 0.01  # of random configurations, in which a pair touches that is not checked
APART = "leave out pairs that touch by design: ignore=, srdf= (--ignore, --srdf)"


class LoadOptions(Options, who="load"):
    """How a robot's file is read. Raises `ValueError` for `fit`, `pairs` or `exact` without `meshes`."""

    others = ("tip", "base")
    tool: Any = anything(default=None, unit="m", words="tip_T_tool (4, 4): moves the tip")
    meshes: Any = flag(
        default=False,
        words="read collision meshes and fit a model to them, which holds them: what is free by it is free. Without them a "
        "URDF with meshes has its kinematics, and `clearance` says what is missing",
    )
    fit: Any = instance(
        default=FIT,
        kind=FitOptions,
        optional=True,
        words="how concave meshes are cut into convex parts, which decide where links are near, and fitted with capsules for "
        "what is far; None puts one box around each mesh instead",
    )
    exact: Any = flag(
        default=False,
        words="let the meshes' own triangles (`robot.surfaces`) decide, for all that asks for distances, where the model comes "
        "nearer than 25 mm, or the margin; it costs some times as much, and gives up no free room",
    )
    pairs: Any = anything(
        default=(),
        words='pairs of links to check in any case, `[("hand", "forearm")]`, or "all". Otherwise links are not checked that do '
        "not move against each other, whose meshes touch in at least half of the random postures, or never do, and neighbours, "
        "on either side of one joint; `robot.unchecked` lists them, with the reason",
    )
    srdf: Any = anything(
        default=None,
        words="a file whose groups of joints, group states and end effectors have names in the robot (`robot.group`, "
        "`robot.state`, `tip=`), and whose `disable_collisions` pairs are not checked, nor those of its "
        "`disable_default_collisions` links but for its `enable_collisions`. (What an MJCF's `exclude`, contype and "
        "conaffinity keep apart is not, either.)",
    )
    ignore: Any = anything(
        default=(),
        words="what is not checked, either: pairs of links, pairs of a link and an object of the scene, whose name is not "
        "nearly a link's, and links that no object of a scene counts for",
    )
    posture: Any = anything(
        default=None,
        unit="rad, m",
        words="where joints beside the chain are held, those of a head, a gripper, another arm, by their names: "
        '`{"panda_finger_joint1": 0.04}`; others are at 0 (MJCF: the model\'s qpos0), or the limit that is nearest. Mimic '
        "joints follow; one that a joint of the chain drives stands where that is 0. A warning names those whose links have "
        "shapes, unless a posture is given: `{}` says that all of them are right so",
    )
    held: Any = anything(
        default=None,
        unit="rad, m",
        words="where joints are held, be they beside the robot's ways to its tips or on them, by their names: "
        '`{"torso_lift_joint": 0.2}`; one that is held is not in q. It says of joints beside what `posture` says, which knows '
        "no others",
    )
    packages: Any = anything(
        default=(),
        words="folders of ROS packages, or that hold such. A mesh `package://my_pkg/meshes/a.stl` is `meshes/a.stl` in a "
        "folder `my_pkg`: the nearest above the model's file, else one of these, else one that ROS finds (`ROS_PACKAGE_PATH`, "
        "`AMENT_PREFIX_PATH`)",
    )

    def check(self) -> None:
        if not self.meshes:
            pairs = isinstance(self.pairs, str) or len(self.pairs)
            for name, given in (("fit", self.fit is not FIT), ("pairs", pairs)):
                if given:
                    told = f"{name} is {shown(getattr(self, name))}, but no meshes are read"
                    raise ValueError(f"load: {told}; write meshes=True, or leave it out")
        if self.exact and (not self.meshes or self.fit is None):
            mend = "write meshes=True, and leave fit=None out; a model that was saved exact is so without"
            raise ValueError(f"load: exact is True, but no mesh is fitted; {mend}")
        for what, given in (("posture", self.posture), ("held", self.held)):
            if given is None:
                continue
            if not (isinstance(given, Mapping) and all(isinstance(name, str) for name in given)):
                raise ValueError(f'load: {what} is {shown(given)}; write {{"joint": value}} [rad, m]')
            check_finite("load", **{f"{what}['{shown(name)}']": value for name, value in given.items()})


def load(
    path: str | Path, *, tip: Tips = None, base: str | None = None, options: LoadOptions | None = None, **changes: Any
) -> Robot:
    """Reads the robot of a shipped model (`"p6r"`) or of a file: `.urdf`, `.xml` (MJCF) or `.toml`. Host.

    `tip` and `base` name links (bodies or a site in MJCF); without them the robot runs from the root to the only leaf that is
    no finger. One `tip` is a serial chain; a list, `tip=["left_hand", "right_hand"]`, is the tree of the ways to them, its
    joints in their order, each tip's pose a row. A tip may be an end effector's or a group's name in `srdf`. `base="planar"`
    stands the root on a base that moves, by x, y [m] and heading [rad]; `base="floating"` by x, y, z, yaw, pitch, roll: three
    or six joints before the others, whose parent is a new link "world". A joint that another drives (`<mimic>`, an equality of
    joints in MJCF) follows it by factor and offset, and is not in q.

    `options` and `changes`, fields of `LoadOptions` by name, say how the file is read: `load("arm.urdf", meshes=True)`.

    All that hangs on the robot belongs to it, with shapes and masses; joints beside it are held (`held`, `posture`). What is
    above `base` is left out, and what flies freely or is led by hand (mocap) in an MJCF. Damping and dry friction of a URDF's
    and an MJCF's joints are in `drives`, which are ideal otherwise: a current is a torque. A warning, one line each, tells what
    a file has besides that the robot has not (springs, gravity of its own), and what it is likely to mean otherwise (limits in
    degrees).

    A mesh's name is a path from the file's folder, which stays below it (below the folder above, where the file's own is called
    urdf, urdfs, xacro, robots, mjcf or xml), or `package://` (`packages`). Links are followed. DAE needs
    `pip install "jaxik[dae]"`.

    Raises `LoadError` (a `ValueError`) with one line: the file, the element, what is allowed, the mend; and `ValueError` for
    options that do not go together, for an `exact` file without meshes, and for MJCF without MuJoCo (the extra `mjcf`).
    """
    asked = LoadOptions.chosen(options, changes)
    read = _Read.of(path, tip, base, asked, asked.fit is not None)
    robot, shapes, notes, stance = read.robot, read.shapes, read.notes, read.stance
    pairs, beside = read.pairs(asked)
    for line in notes.lines():
        warnings.warn(f"{shown(robot.name)}: {line}", stacklevel=2)
    robot = dataclasses.replace(robot, ignored=tuple(dict.fromkeys(robot.ignored + beside)))
    if (
        asked.posture is None
        and asked.held is None
        and not robot.unread_meshes
        and (told := stance.told(_solid(robot, shapes)))
    ):
        warnings.warn(f"{shown(robot.name)}: {told}", stacklevel=2)
    if asked.exact and not shapes and not robot.surfaces:
        mend = "leave it out: its shapes are what is measured"
        raise ValueError(f"load: exact is True, but {read.path.name} has no meshes; {mend}")
    if read.saved is not None:
        names = robot.link_names
        kept = tuple(pair for pair in read.saved if frozenset(names[i] for i in pair) not in pairs.apart)
        return dataclasses.replace(robot, self_pairs=_with_asked(robot, kept, pairs))
    if shapes and asked.fit is not None:
        model = modelled(robot, shapes, asked.fit, pairs, stance.behind)
        _tell(robot, "meshes", model.at_home, model.colliding)
        modelled_robot = model.of(robot, shapes)
        _tell_unchecked(modelled_robot)
        surfaces = link_surfaces(robot, shapes) if asked.exact else ()
        return dataclasses.replace(modelled_robot, surfaces=surfaces)
    found = self_collisions(robot, pairs.apart, stance.behind)
    if asked.meshes:
        _tell(robot, "boxes", dict.fromkeys(found.at_home), found.share)
    return dataclasses.replace(robot, self_pairs=_with_asked(robot, found.pairs, pairs))


def _with_asked(robot: Robot, found: Iterable[tuple[int, int]], asked: Any) -> tuple[tuple[int, int], ...]:
    """The pairs of links that were found, and those that are `asked` for in any case, of links that move apart."""
    names, joints = robot.link_names, robot.link_joint
    wanted = lambda pair: (
        frozenset(names[i] for i in pair) not in asked.apart
        and (asked.all or frozenset(names[i] for i in pair) in asked.checked)
    )
    apart = [(a, b) for a, b in itertools.combinations(solid_links(robot), 2) if joints[a] != joints[b]]
    return tuple(dict.fromkeys([*found, *filter(wanted, apart)]))


@dataclasses.dataclass
class _Read:
    """The content of a file: the robot, the shapes that are to be fitted, the pairs of links to check where the file says them,
    what there is to tell, and how joints beside the chain are held."""

    path: Path
    robot: Robot
    shapes: list[Shape]
    saved: tuple[tuple[int, int], ...] | None
    notes: Notes
    stance: Posture

    @staticmethod
    def of(path: str | Path, tip: Tips, base: str | None, asked: LoadOptions, fitted: bool) -> _Read:
        """Reads a file; meshes are shapes if they are `fitted`, else boxes."""
        path, notes, stance = locate(path), Notes(), Posture(dict(asked.posture or {}), dict(asked.held or {}))
        semantics = read_srdf(asked.srdf)
        tips = AskedTips.of(tip, semantics.tips)
        tool = None if asked.tool is None else np.asarray(rigid_frame("tool (tip_T_tool)", asked.tool), np.float64)
        meshes = Meshes(asked.meshes, asked.meshes and fitted, as_packages("load", asked.packages))
        kind, readers = path.suffix.lower(), {".urdf": load_urdf, ".xml": load_mjcf, ".mjcf": load_mjcf}
        saved = None
        if kind == ".toml":
            model = read_toml(path)
            if model.content.get("convention") == "chain":
                robot = _saved(path, read_robot(model), tip, base, tool, stance)
                saved = robot.self_pairs
            else:
                robot = load_toml(model, tips, base, tool, stance, notes)
        elif kind in readers:
            robot = readers[kind](path, tips, base, tool, meshes, stance, notes)
        else:
            expand = f"; expand a xacro: xacro {path.name} > {path.name.partition('.')[0]}.urdf" if kind == ".xacro" else ""
            raise LoadError(path, "file", f"ending '{kind}'", f"allowed: .urdf, .xml (MJCF), .toml{expand}")
        if semantics.path is not None:
            groups, states = semantics.of(robot, notes)
            robot = dataclasses.replace(robot, groups=groups, states=states)
        return _Read(path, robot, [] if saved is not None else meshes.shapes(robot), saved, notes, stance)

    def pairs(self, asked: LoadOptions) -> tuple[Any, Any]:
        """The pairs of links that are checked, or not, in any case; and the objects that links ignore."""
        wanted = asked_pairs(self.path, self.robot, asked.pairs)
        apart, beside = ignored(self.path, self.robot, asked.ignore)
        apart |= self.notes.apart | disabled_pairs(asked.srdf, self.notes.links or self.robot.link_names, self.notes)
        return dataclasses.replace(wanted, apart=apart), beside


def _solid(robot: Robot, shapes: Iterable[Shape]) -> set[str]:
    """The names of the links that have shapes, be they still to be fitted."""
    return {robot.link_names[i] for i in {*solid_links(robot), *(shape.link for shape in shapes)}}


def _saved(path: Path, robot: Robot, tip: Tips, base: str | None, tool: np.ndarray | None, posture: Posture) -> Robot:
    """A robot that `save` wrote has its base and its tip, and what it carries stands still."""
    if tip is not None or base is not None:
        raise LoadError(path, f"tip '{tip}', base '{base}'", "are fixed in a saved robot", "leave them out, or use robot.part")
    for what, given in (("posture", posture.given), ("held", posture.fixed)):
        if not given:
            continue
        where = f"{what} '{next(iter(given))}'"
        raise LoadError(path, where, "is fixed in a saved robot", "load the robot's own file")
    return robot if tool is None else robot.with_tool(tool)


def _tell(robot: Robot, what: str, at_home: Mapping[tuple[int, int], float | None], share: float) -> None:
    """One line where a robot's shapes collide in its default pose, or mostly: that may not be what its file is to say."""
    names = [tuple(robot.link_names[i] for i in pair) for pair in at_home]
    depths = ["" if depth is None else f" by {1e3 * depth:.1f} mm" for depth in at_home.values()]
    some = _some(f"{a} and {b}{depth}" for (a, b), depth in zip(names, depths, strict=True))
    if names:
        checked = "they are checked; " if None not in at_home.values() else ""
        told = f"its {what} touch with all joints at 0 (or amid limits that leave 0 out): {some}; {checked}{APART}"
    elif share > 0.5:
        told = f"its {what} collide in {share:.0%} of random configurations; {APART}"
    else:
        return
    warnings.warn(f"{robot.name}: {told}", stacklevel=3)


def _tell_unchecked(robot: Robot) -> None:
    """A line of the pairs that are not checked since they touch mostly, but for neighbours, whose bearings do; and one of those
    whose parts alone do."""
    joint = dict(zip(robot.link_names, robot.link_joint, strict=True))
    apart = lambda links: robot.tree.distance(*(joint[name] for name in links))
    mostly = [u for u in robot.unchecked if u.reason == "touches" and u.share > TOLD and apart(u.links) > 1]
    nested = [u for u in robot.unchecked if u.reason == "nested"]
    _tell_pairs(robot, mostly, "their meshes touch in most random configurations", lambda u: f" in {u.share:.0%}")
    _tell_pairs(robot, nested, "their meshes never touch, and the convex parts around them mostly do", lambda u: "")


def _tell_pairs(robot: Robot, pairs: Sequence[Unchecked], why: str, share: Callable[[Unchecked], str]) -> None:
    if pairs:
        some = _some(f"{' and '.join(u.links)}{share(u)}, by {1e3 * u.depth:.1f} mm" for u in pairs)
        mend = f"pairs=[{pairs[0].links}, ...] (--pairs {':'.join(pairs[0].links)}) checks them"
        warnings.warn(f"{robot.name}: these pairs of links are not checked, because {why}: {some}; {mend}", stacklevel=4)


def _some(words: Iterable[str]) -> str:
    """The first three, and how many there are."""
    every = [*words]
    return "; ".join(every[:3]) + (f"; ... ({len(every)} in all)" if every[3:] else "")


def fit_report(
    path: str | Path,
    *,
    tip: Tips = None,
    base: str | None = None,
    options: LoadOptions | None = None,
    progress: Callable[[int, int], None] | None = None,
    **changes: Any,
) -> FitReport:
    """Tells what `load(path, ..., meshes=True)` puts around each mesh of a file, which pairs of links it checks, and at which
    values it holds joints beside the chain, as those of a hand. Host.

    `options` and `changes` are those of `load`, meshes being read in any case. `progress(done, total)` hears of the fits that
    are made. Raises `LoadError` and `ValueError` as `load` does.
    """
    asked = LoadOptions.chosen(options, {"meshes": True} | changes)
    check_kind("fit_report", "fit", asked.fit, FitOptions)
    assert asked.fit is not None
    read = _Read.of(path, tip, base, asked, True)
    model = modelled(read.robot, read.shapes, asked.fit, read.pairs(asked)[0], read.stance.behind, progress)
    return fit_of(read.robot, read.shapes, model, read.stance.joints(_solid(read.robot, read.shapes)))


def link_meshes(
    path: str | Path, *, tip: Tips = None, base: str | None = None, options: LoadOptions | None = None, **changes: Any
) -> list[Shape]:
    """Returns the collision meshes, boxes and cylinders of a file's links, in the frames of the joints that move them, to look
    at: for `view.Page`. `options` and `changes` are those of `load`. Host."""
    return _Read.of(path, tip, base, LoadOptions.chosen(options, {"meshes": True} | changes), True).shapes
