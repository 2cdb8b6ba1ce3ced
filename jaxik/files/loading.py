"""Robot files to robots. The only place that reads them."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxik.checks.arrays import rigid_frame
from jaxik.checks.options import check_finite, check_flag, check_kind, shown
from jaxik.collision.scene import Scene
from jaxik.collision.self_collision_pairs import self_collisions
from jaxik.files import scene as scene_files
from jaxik.files.held_joints import Posture
from jaxik.files.mesh import Meshes
from jaxik.files.mjcf import load_mjcf
from jaxik.files.notes import Notes
from jaxik.files.packages import as_packages
from jaxik.files.robot_files import read_robot
from jaxik.files.robot_toml import load_toml, read_toml
from jaxik.files.shipped import locate
from jaxik.files.unchecked_pairs import asked_pairs, disabled_pairs, ignored
from jaxik.files.urdf import load_urdf
from jaxik.fitting.capsules import Fit
from jaxik.fitting.links import Shape, link_surfaces
from jaxik.fitting.model import modelled
from jaxik.fitting.report import FitReport, fit_of
from jaxik.kinematics.robot import Robot, solid_links
from jaxik.reasons import LoadError

FIT = Fit()
TOLD = 0.01  # of random configurations, in which a pair touches that is not checked
APART = "leave out pairs that touch by design: ignore=, srdf= (--ignore, --srdf)"


def load(
    source: str | Path,
    tip: str | None = None,
    base: str | None = None,
    *,
    tool: Any = None,
    meshes: bool = False,
    fit: Any = FIT,
    srdf: str | Path | None = None,
    ignore: Any = (),
    pairs: Any = (),
    exact: bool = False,
    posture: Any = None,
    packages: Any = (),
) -> Robot:
    """The serial chain of a shipped model (`"p6r"`) or of a file: `.urdf`, `.xml` (MJCF) or `.toml`. Host.

    `tip` and `base` name links (bodies or a site in MJCF); without them the robot runs from the root to the only leaf.
    `tool` (4, 4) moves the tip [m]. `meshes=True` reads collision meshes, cuts concave ones into convex parts, which decide
    where links are near, and fits capsules for what is far (`fit`; None puts one box around each mesh instead); without it a
    URDF with meshes has its kinematics, and `clearance` says what is missing.

    Links are checked against each other unless they do not move against each other, their meshes touch in at least half of the
    random postures, or never do; nor are neighbours, on either side of one joint. `robot.unchecked` lists each pair that is not
    checked, with the reason. `pairs` names more to check, `[("hand", "forearm")]`, or is "all".

    The model holds the meshes: what is free by it is free. It gives up a little free room; with `exact=True` the meshes' own
    triangles decide where it comes nearer than 25 mm, or the margin (`robot.surfaces`), for all that asks for distances. That
    costs some times as much.

    `srdf` names a file whose `disable_collisions` pairs
    are not checked, nor those of its `disable_default_collisions` links but for its `enable_collisions`; nor what an MJCF's
    `exclude`, contype and conaffinity keep apart. `ignore` lists what is not checked, either: pairs of links, pairs of a link
    and an object of the scene, whose name is not nearly a link's, and links that no object of a scene counts for.

    All that hangs on the chain belongs to it, with shapes and masses: joints beside it, those of a head, a gripper, another
    arm, are held. `posture` says where, by their names [rad, m], `{"panda_finger_joint1": 0.04}`; others are at 0 (MJCF: the
    model's qpos0), or the limit that is nearest. Mimic joints follow; one that a joint of the chain drives stands where that is
    0. A warning names those whose links have shapes, unless a posture is given: `{}` says that all of them are right so. What
    is above `base` is left out, and what flies freely in an MJCF.

    Damping and dry friction of a URDF's and an MJCF's joints are in `drives`, which are ideal otherwise: a current is a torque.
    A warning, one line each, tells what a file has besides that the robot has not (springs, gravity of its own), and what it is
    likely to mean otherwise (limits in degrees).

    A mesh `package://my_pkg/meshes/a.stl` is `meshes/a.stl` in a folder `my_pkg`: the nearest above the model's file, else one
    that `packages` names, or that is in a folder that it names (one, or a list), else one that ROS finds (`ROS_PACKAGE_PATH`,
    `AMENT_PREFIX_PATH`). Any other name is a path from the file's folder, which stays below it (below the folder above, where
    the file's own is called urdf, urdfs, xacro, robots, mjcf or xml). Links are followed. DAE needs `pip install "jaxik[dae]"`.

    Raises `LoadError` (a `ValueError`) with one line: the file, the element, what is allowed, the mend; and `ValueError` for a
    `fit`, `pairs` or `exact` without `meshes`, for an `exact` file without any, for `packages` that are no folders, for a
    `posture` that is no mapping of names to finite numbers, and for MJCF without MuJoCo (the extra `mjcf`).
    """
    path = locate(source)
    tool = None if tool is None else np.asarray(rigid_frame("tool (tip_T_tool)", tool), np.float64)
    check_kind("load", "fit", fit, Fit, optional=True)
    if fit is not FIT and not meshes:
        raise ValueError(f"load: fit is {shown(fit)}, but no meshes are read; write meshes=True, or leave it out")
    if not meshes and (isinstance(pairs, str) or len(pairs)):
        raise ValueError(f"load: pairs is {shown(pairs)}, but no meshes are read; write meshes=True, or leave it out")
    check_flag("load", exact=exact)
    if exact and (not meshes or fit is None):
        mend = "write meshes=True, and leave fit=None out; a model that was saved exact is so without"
        raise ValueError(f"load: exact is True, but no mesh is fitted; {mend}")
    stance, shapes_of = _stance("load", posture), Meshes(meshes, meshes and fit is not None, as_packages("load", packages))
    robot, shapes, saved = _read(path, tip, base, tool, shapes_of, stance, notes := Notes())
    asked = asked_pairs(path, robot, pairs)
    apart, beside = ignored(path, robot, ignore)
    disabled = apart | notes.apart | disabled_pairs(srdf, notes.links or robot.link_names, notes)
    for line in notes.lines():
        warnings.warn(f"{shown(robot.name)}: {line}", stacklevel=2)
    robot = dataclasses.replace(robot, ignored=tuple(dict.fromkeys(robot.ignored + beside)))
    if posture is None and not robot.unread_meshes and (told := stance.told(_solid(robot, shapes))):
        warnings.warn(f"{shown(robot.name)}: {told}", stacklevel=2)
    if exact and not shapes and not robot.surfaces:
        raise ValueError(f"load: exact is True, but {path.name} has no meshes; leave it out: its shapes are what is measured")
    if saved is not None:
        names = robot.link_names
        kept = tuple(pair for pair in saved if frozenset(names[i] for i in pair) not in disabled)
        return dataclasses.replace(robot, self_pairs=kept)
    if shapes:
        model = modelled(robot, shapes, fit, dataclasses.replace(asked, apart=disabled), stance.behind)
        _tell(robot, "meshes", model.at_home, model.colliding)
        modelled_robot = model.of(robot, shapes)
        _tell_unchecked(modelled_robot)
        surfaces = link_surfaces(robot, shapes) if exact else ()
        return dataclasses.replace(modelled_robot, surfaces=surfaces)
    found = self_collisions(robot, disabled, stance.behind)
    if meshes:
        _tell(robot, "boxes", dict.fromkeys(found.at_home), found.share)
    return dataclasses.replace(robot, self_pairs=found.pairs)


def _solid(robot: Robot, shapes: Iterable[Shape]) -> set[str]:
    """The names of the links that have shapes, be they still to be fitted."""
    return {robot.link_names[i] for i in {*solid_links(robot), *(shape.link for shape in shapes)}}


def _stance(who: str, posture: Any) -> Posture:
    """What a caller says of joints beside the chain."""
    if posture is not None and not (isinstance(posture, Mapping) and all(isinstance(name, str) for name in posture)):
        raise ValueError(f'{who}: posture is {shown(posture)}; write {{"joint": value}} [rad, m]')
    for name, value in (posture or {}).items():
        check_finite(who, **{f"posture['{shown(name)}']": value})
    return Posture(dict(posture or {}))


def _read(
    path: Path, tip: str | None, base: str | None, tool: np.ndarray | None, meshes: Meshes, posture: Posture, notes: Notes
) -> tuple[Robot, list[Shape], tuple[tuple[int, int], ...] | None]:
    """The robot of a file, the shapes that are to be fitted, and the pairs of links to check where the file says them."""
    kind, readers = path.suffix.lower(), {".urdf": load_urdf, ".xml": load_mjcf, ".mjcf": load_mjcf}
    if kind == ".toml":
        model = read_toml(path)
        if model.content.get("convention") == "chain":
            robot = _saved(path, read_robot(model), tip, base, tool, posture)
            return robot, [], robot.self_pairs
        robot = load_toml(model, tip, base, tool, posture)
    elif kind in readers:
        robot = readers[kind](path, tip, base, tool, meshes, posture, notes)
    else:
        expand = f"; expand a xacro: xacro {path.name} > {path.name.partition('.')[0]}.urdf" if kind == ".xacro" else ""
        raise LoadError(path, "file", f"ending '{kind}'", f"allowed: .urdf, .xml (MJCF), .toml{expand}")
    return robot, meshes.shapes(robot), None


def _saved(path: Path, robot: Robot, tip: str | None, base: str | None, tool: np.ndarray | None, posture: Posture) -> Robot:
    """A robot that `save` wrote has its base and its tip, and what it carries stands still."""
    if tip is not None or base is not None:
        raise LoadError(path, f"tip '{tip}', base '{base}'", "are fixed in a saved robot", "leave them out, or use robot.part")
    if posture.given:
        where = f"posture '{next(iter(posture.given))}'"
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
    """One line of the pairs that are not checked since they touch mostly, but for neighbours, whose bearings do."""
    joint = dict(zip(robot.link_names, robot.link_joint, strict=True))
    apart = lambda links: abs(joint[links[0]] - joint[links[1]])
    told = [u for u in robot.unchecked if u.reason == "touches" and u.share > TOLD and apart(u.links) > 1]
    if told:
        some = _some(f"{a} and {b} in {u.share:.0%}, by {1e3 * u.depth:.1f} mm" for u in told for a, b in [u.links])
        mend = f"pairs=[{told[0].links}, ...] (--pairs {':'.join(told[0].links)}) checks them"
        warnings.warn(
            f"{robot.name}: these pairs of links are not checked, because their meshes touch in most random configurations: "
            f"{some}; {mend}",
            stacklevel=3,
        )


def _some(words: Iterable[str]) -> str:
    """The first three, and how many there are."""
    every = [*words]
    return "; ".join(every[:3]) + (f"; ... ({len(every)} in all)" if every[3:] else "")


def fit_report(
    source: str | Path,
    tip: str | None = None,
    base: str | None = None,
    *,
    fit: Fit = FIT,
    srdf: str | Path | None = None,
    ignore: Any = (),
    pairs: Any = (),
    posture: Mapping[str, Any] | None = None,
    packages: Any = (),
    progress: Callable[[int, int], None] | None = None,
) -> FitReport:
    """What `load(..., meshes=True, fit=fit)` puts around each mesh of a file, which pairs of links it checks, and at which
    values it holds joints beside the chain, as those of a hand. Host.

    `progress` hears of how many fits are made, of how many. Raises `LoadError` as `load` does.
    """
    path = locate(source)
    check_kind("fit_report", "fit", fit, Fit)
    stance = _stance("fit_report", posture)
    robot, shapes, _ = _read(
        path, tip, base, None, Meshes(True, True, as_packages("fit_report", packages)), stance, notes := Notes()
    )
    disabled = disabled_pairs(srdf, notes.links or robot.link_names, notes) | ignored(path, robot, ignore)[0] | notes.apart
    asked = dataclasses.replace(asked_pairs(path, robot, pairs), apart=disabled)
    model = modelled(robot, shapes, fit, asked, stance.behind, progress)
    return fit_of(robot, shapes, model, stance.joints(_solid(robot, shapes)))


def link_meshes(
    source: str | Path,
    tip: str | None = None,
    base: str | None = None,
    posture: Mapping[str, Any] | None = None,
    packages: Any = (),
) -> list[Shape]:
    """The collision meshes, boxes and cylinders of a file's links, in the frames of the joints that move them, to look at.
    Host."""
    shapes_of = Meshes(True, True, as_packages("link_meshes", packages))
    return _read(locate(source), tip, base, None, shapes_of, _stance("link_meshes", posture), Notes())[1]


def load_scene(source: str | Path) -> Scene:
    """A shipped scene (`"cucumber_row"`) or a scene file: `.toml`, or labelled points as `.csv` or `.ply`. Host.

    Raises `LoadError` (a `ValueError`) with one line: the file, the element, what is allowed, the mend.
    """
    return scene_files.load_scene(locate(source, "scene"))
