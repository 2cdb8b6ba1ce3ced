"""A study read from its file, or from nested dictionaries, and checked key by key."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from jaxik.collision.clearances import check_geometry
from jaxik.collision.scene import Scene
from jaxik.files import load, load_scene
from jaxik.files.robot_toml import UNITS, Table
from jaxik.files.targets import read_targets
from jaxik.fitting.capsules import FitOptions
from jaxik.ik.options import IKOptions
from jaxik.kinematics.reach_bound import millimetres
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import Task
from jaxik.options import fields
from jaxik.reach.grasp import Grasp
from jaxik.reach.ranking import PostureOptions
from jaxik.spatial.rotations import frame, from_rpy
from jaxik.sweeps import targets as sources
from jaxik.sweeps.robot_variants import all_variants, read_shapes
from jaxik.sweeps.study import CHUNK, POSITION_TOLERANCE, ROTATION_TOLERANCE, Study
from jaxik.sweeps.targets import Targets

Made = TypeVar("Made")
KEYS = (
    *("name", "robot", "robots", "base", "parameters", "collision", "tool", "targets", "ik"),
    *("seed", "slides", "refine", "chunk", "audited", "origin", "ignore"),
)


def read_study(table: Table, folder: Path) -> Study:
    """The study that a table describes; files that it names lie in `folder`."""
    given = table.content
    table.only(KEYS)
    table.asked.update(("robot", "robots"))
    name = table.text("name", "sweep")
    robots = _robots(table, folder)
    bases, shapes = _bases(table), read_shapes(table)
    axes, variants = all_variants(table, robots, bases, shapes)
    scene, margin, weights = _collision(table, folder)
    collision = "collision" in given
    grasp, seed = _grasp(table), table.count("seed", 0, least=0)
    targets = _targets(table, folder, [v.robot for v in variants], seed, grasp)
    if targets.scenes and scene is not None:
        raise table.fail("the targets' crop and [collision] scene both say what is in the way", "keep one")
    if "tool" in given and not targets.scenes and not len(targets.rotations):
        raise table.fail("[tool] turns the tool into a direction, and no target has a direction", "leave it out")
    ik = _ik(table, targets, margin if collision else 0.0)
    counts = {k: table.count(k, default) for k, default in (("slides", 41), ("chunk", CHUNK))}
    counts |= {k: table.count(k, default, least=0) for k, default in (("refine", 5), ("audited", 2000))}
    table.close()
    for variant in variants if collision else ():
        mend = "write {file = ..., meshes = true}" if variant.robot.unread_meshes else "or leave [collision] out"
        _made(table.table("collision"), mend, check_geometry, variant.robot)
    return Study(name, variants, axes, targets, scene, collision, margin, weights, seed=seed, ik=ik, **counts)


def _made(row: Table, mend: str, make: Callable[..., Made], *given: Any, **named: Any) -> Made:
    """What is made of a table's values. Where they are refused, so is the table."""
    try:
        return make(*given, **named)
    except ValueError as error:
        raise row.fail(str(error), mend) from None


def _file(folder: Path, source: str) -> str | Path:
    """A file beside the study, or one of the shipped names."""
    return folder / source if Path(source).suffix else source


def _robots(table: Table, folder: Path) -> list[tuple[str, Robot]]:
    given = table.content.get("robots", table.content.get("robot"))
    if given is None or ("robots" in table.content and "robot" in table.content):
        raise table.fail("no robot" if given is None else "'robot' and 'robots' say the same", 'write robot = "p6r"')
    found, ignore = [], table.listed("ignore")
    for i, each in enumerate(given if isinstance(given, list | tuple) else [given]):
        if isinstance(each, Robot):
            if ignore:
                raise table.fail(f"ignore, and robot {i + 1} is a Robot", "load it with ignore=")
            found.append((each.name, each))
        elif isinstance(each, str | dict):
            row = Table(table.path, f"robots {i + 1}", {"file": each} if isinstance(each, str) else each)
            found.append(_robot(row, folder, ignore))
        else:
            raise table.fail(f"robot {i + 1} is {type(each).__name__}", "write a shipped model's name, a file, or a table")
    if not found or len({label for label, _ in found}) < len(found):
        raise table.fail("two robots of one name" if found else "no robot", "give each its own: {file = ..., name = ...}")
    return found


def _robot(row: Table, folder: Path, ignore: list[Any]) -> tuple[str, Robot]:
    """A robot's name in the study, and its robot: the keys are the arguments of `jaxik.load`."""
    given = row.content
    row.asked.update(("tip", "base", "srdf", "posture", "tool"))
    file, meshes = row.text("file"), row.flag("meshes")
    options: dict[str, Any] = {k: row.text(k) for k in ("tip", "base") if k in given}
    if "srdf" in given:
        options["srdf"] = _file(folder, row.text("srdf"))
    fit = row.table("fit")
    if fit.content:
        options["fit"] = FitOptions(
            accuracy=fit.number("accuracy", "length", FitOptions().accuracy), most=fit.count("most", FitOptions().most)
        )
    if "posture" in given:  # where joints beside the chain are held [rad, m]
        held = row.table("posture")
        options["posture"] = {joint: held.number(joint, "plain") for joint in held.content}
    if "tool" in given:
        options["tool"] = row.array("tool", "plain", (4, 4))
    label, ignored = row.text("name", Path(file).stem), [*ignore, *row.listed("ignore")]
    row.close()
    return label, load(_file(folder, file), meshes=meshes, ignore=ignored, **options)


def _bases(table: Table) -> list[tuple[str, np.ndarray]]:
    """Placements in the world: every combination of the shifts along x, y, z [m] and turns about the world's z."""
    row = table.table("base")
    values = [row.finite(k, (-1,), unit="length", default=[0.0]) for k in "xyz"]
    yaw = row.finite("yaw", (-1,), unit="angle", default=[0.0])
    return [
        (f"x={x:g} y={y:g} z={z:g} yaw_deg={np.degrees(turn):g}", frame((x, y, z), from_rpy((0.0, 0.0, turn))) + 0.0)  # no -0
        for x, y, z, turn in itertools.product(*values, yaw)
    ]


def _collision(table: Table, folder: Path) -> tuple[Scene | None, float, PostureOptions]:
    row = table.table("collision")
    row.asked.add("scene")
    scene = row.content.get("scene")
    if scene is not None and not isinstance(scene, Scene):
        scene = load_scene(_file(folder, row.text("scene")))
    units = {name: "length" if field.unit == "m" else "plain" for name, field in fields(PostureOptions).items()}
    usual = PostureOptions()
    wanted = {name: float(row.finite(name, (), unit=unit, default=getattr(usual, name))) for name, unit in units.items()}
    return scene, wanted["margin"], _made(row, "change them", PostureOptions, **wanted)


def _grasp(table: Table) -> Grasp:
    row = table.table("tool")
    axes = {name: tuple(row.array(name, "plain", (3,), usual).tolist()) for name, usual in vars(Grasp()).items()}
    return _made(row, "change them", Grasp, **axes)


def _ik(table: Table, targets: Targets, margin: float) -> IKOptions:
    row, default = table.table("ik"), IKOptions()
    chosen: dict[str, Any] = {k: row.count(k, getattr(default, k)) for k in ("max_seeds", "solutions")}
    chosen |= {k: row.text(k, getattr(default, k)) for k in ("choice", "seeds")}
    tolerances = ("position_tolerance", "length", POSITION_TOLERANCE), ("rotation_tolerance", "angle", ROTATION_TOLERANCE)
    for key, unit, usual in tolerances:
        chosen[key] = float(row.finite(key, (), unit=unit, default=usual))
        if not chosen[key] > 0.0:
            raise row.fail(f"{key} = {chosen[key]:g}", "write a number > 0")
    task = Task.position() if targets.free_rotation else default.task
    return _made(row, "change it", IKOptions, task=task, margin=margin, **chosen)


def _targets(table: Table, folder: Path, robots: list[Robot], seed: int, grasp: Grasp) -> Targets:
    row = table.table("targets")
    kind = row.text("kind", "file" if "poses" in row.content else "grid", sources.KINDS)
    frame = row.text("frame", "world", ("world", "base"))
    if kind == "file":
        targets = _given_targets(row, folder, frame, grasp)
    elif kind == "crop":
        if frame != "world":
            raise row.fail(f"frame = '{frame}': a crop stands in the world", "leave it out")
        targets = sources.from_crops(row.count("crops", 1), row.count("angles", 24), seed, grasp)
    else:
        turned = _rotations(row, grasp)
        if kind == "grid":
            axes = tuple(_axis(row, k) for k in "xyz")
        else:
            size = row.number("size", "length")
            if not size > 0.0:
                raise row.fail(f"size = {size:g}", "write the edge of a voxel [m], > 0")
            axes = sources.voxels(robots, size)
        targets = Targets(kind, frame, turned, axes)
    if not len(targets):
        raise row.fail("no target", "give at least one")
    some = targets.poses_at(np.unique(np.linspace(0, len(targets) - 1, 1000).astype(np.int64)))[:, :3, 3]
    doubts = [millimetres(robot, some, frame == "world") for robot in robots]
    if all(doubts):
        raise row.fail(str(doubts[0]), "lengths are metres, or those of a key that ends in _mm")
    return targets


def _given_targets(row: Table, folder: Path, frame: str, grasp: Grasp) -> Targets:
    row.asked.update(("path", "poses"))
    known = row.content.get("poses")
    if known is not None and "path" in row.content:
        raise row.fail("path and poses say the same", "keep one")
    poses = read_targets(folder / row.text("path")) if known is None else np.asarray(known, np.float64)
    if poses.shape[1:] in ((4, 4), (7,)):
        return Targets("file", frame, np.zeros((0, 3, 3)), poses=poses)
    if poses.ndim == 2 and poses.shape[1] == 3:
        return Targets("file", frame, _rotations(row, grasp), positions=poses)
    raise row.fail(f"poses of shape {poses.shape}", "allowed: (N, 4, 4); (N, 7) of x, y, z, qw, qx, qy, qz; positions (N, 3)")


def _axis(row: Table, key: str) -> np.ndarray:
    name = next((key + ending for ending in UNITS["length"] if key + ending in row.content), key)
    given = row.content.get(name, (0, 0, 1))
    if not (isinstance(given, list | tuple | np.ndarray) and len(given) == 3):
        raise row.fail(f"'{key}' is not 3 numbers, from, to, count", f"write e.g. {key} = [-0.5, 0.5, 11]")
    low, high, _ = row.array(key, "length", (3,))
    count = float(given[2])  # which has no unit
    if not (np.isfinite(low + high) and count.is_integer() and 1 <= count <= 10**6):
        raise row.fail(f"{key} = [{low:g}, {high:g}, {count:g}]", f"write {key} = [from, to, count] [m]")
    return np.linspace(low, high, int(count))


def _rotations(row: Table, grasp: Grasp) -> np.ndarray:
    """(t, 3, 3): every direction with every roll; none where any direction will do."""
    given = row.content.get("directions", "any")
    row.asked.update(("directions", "roll", "roll_deg"))
    if isinstance(given, str) and given == "any":
        if "roll" in row.content or "roll_deg" in row.content:
            raise row.fail("'roll' without directions turns nothing", "give directions, or leave it out")
        return np.zeros((0, 3, 3))
    if isinstance(given, list | tuple | np.ndarray):
        along = row.array("directions", "plain", (-1, 3))
        if not np.all(np.linalg.norm(along, axis=1) > 1e-9):
            raise row.fail("a direction has no length", "write [x, y, z]")
    else:
        along = sources.directions(row.count("directions", 1))
    return sources.rotations(along, row.finite("roll", (-1,), unit="angle", default=[0.0]), grasp)
