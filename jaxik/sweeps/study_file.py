"""A study read from its file, or from nested dictionaries, and checked key by key."""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path
from typing import Any

import numpy as np

from jaxik.collision.clearances import check_geometry
from jaxik.collision.scene import Scene
from jaxik.files import load, load_scene
from jaxik.files.robot_toml import Table
from jaxik.files.targets import read_targets
from jaxik.fitting.capsules import Fit
from jaxik.harvesting.grasp import Grasp
from jaxik.harvesting.scanning import Weights
from jaxik.ik.options import IKOptions
from jaxik.robot.chain import Chain
from jaxik.robot.reach_bound import millimetres
from jaxik.robot.task import Task
from jaxik.sweeps import targets as sources
from jaxik.sweeps.robot_variants import all_variants, read_shapes
from jaxik.sweeps.study import CHUNK, POSITION_TOLERANCE, ROTATION_TOLERANCE, Study
from jaxik.sweeps.targets import Targets

KEYS = (
    *("name", "robot", "robots", "base", "parameters", "collision", "tool", "targets", "ik"),
    *("seed", "slides", "refine", "chunk", "audited", "origin", "ignore"),
)


def read_study(table: Table, folder: Path) -> Study:
    given = table.content
    table.only(KEYS)
    table.asked.update(("robot", "robots"))
    name = table.text("name", "sweep")
    robots = _robots(table, folder)
    bases, shapes = _bases(table), read_shapes(table)
    axes, variants = all_variants(table, robots, bases, shapes)
    scene, margin, weights = _collision(table, folder)
    collision = "collision" in given
    grasp = _grasp(table)
    seed = _count(table, "seed", 0, least=0)
    targets = _targets(table, folder, [v.chain for v in variants], seed, grasp)
    if targets.scenes and scene is not None:
        raise table.fail("the targets' crop and [collision] scene both say what is in the way", "keep one")
    if "tool" in given and not targets.scenes and not len(targets.rotations):
        raise table.fail("[tool] turns the tool into a direction, and no target has a direction", "leave it out")
    ik = _ik(table, targets, margin if collision else 0.0)
    counts = {k: _count(table, k, default) for k, default in (("slides", 41), ("chunk", CHUNK))}
    counts |= {k: _count(table, k, default, least=0) for k, default in (("refine", 5), ("audited", 2000))}
    table.close()
    if collision:
        for variant in variants:
            _check_geometry(table, variant.chain)
    return Study(name, variants, axes, targets, scene, collision, margin, weights, seed=seed, ik=ik, **counts)


def _count(table: Table, key: str, default: int, least: int = 1) -> int:
    value = table.number(key, "plain", float(default))
    if not (value.is_integer() and least <= value <= 2**53):
        raise table.fail(f"{key} = {value:g}", f"write a whole number of at least {least}")
    return int(value)


def _finite(row: Table, key: str, unit: str, shape: tuple[int, ...], default: Any = None) -> np.ndarray:
    """The numbers under a key, at least one and all of them finite."""
    values = row.array(key, unit, shape, default)
    if not values.size or not np.isfinite(values).all():
        raise row.fail(f"{key} holds {'inf' if values.size else 'no number'}", "write finite numbers, at least one")
    return values


def _file(folder: Path, source: str) -> str | Path:
    """A file beside the study, or one of the shipped names."""
    return folder / source if Path(source).suffix else source


def _robots(table: Table, folder: Path) -> list[tuple[str, Chain]]:
    given = table.content.get("robots", table.content.get("robot"))
    if given is None or ("robots" in table.content and "robot" in table.content):
        raise table.fail("no robot" if given is None else "'robot' and 'robots' say the same", 'write robot = "p6r"')
    found, ignore = [], table.listed("ignore")
    for i, each in enumerate(given if isinstance(given, list | tuple) else [given]):
        if isinstance(each, Chain):
            if ignore:
                raise table.fail(f"ignore, and robot {i + 1} is a Chain", "load it with ignore=")
            found.append((each.name, each))
        elif isinstance(each, str):
            found.append((Path(each).stem, load(_file(folder, each), ignore=ignore)))
        elif isinstance(each, dict):
            found.append(_robot(Table(table.path, f"robots {i + 1}", each), folder, ignore))
        else:
            raise table.fail(f"robot {i + 1} is {type(each).__name__}", "write a shipped model's name, a file, or a table")
    if not found or len({label for label, _ in found}) < len(found):
        raise table.fail("two robots of one name" if found else "no robot", "give each its own: {file = ..., name = ...}")
    return found


def _posture(row: Table) -> dict[str, float] | None:
    """Where joints beside the chain are held [rad, m]: `posture = {joint = value}`."""
    if "posture" not in row.content:
        return None
    held = row.table("posture")
    found = {joint: held.number(joint, "plain") for joint in list(held.content)}
    held.close()
    return found


def _robot(row: Table, folder: Path, ignore: list[Any]) -> tuple[str, Chain]:
    """A robot's name in the study, and its chain: the keys are the arguments of `jaxik.load`."""
    given = row.content
    row.asked.update(("meshes", "tip", "base", "srdf", "posture"))
    options: dict[str, Any] = {k: row.text(k) for k in ("tip", "base") if k in given}
    file, meshes = row.text("file"), given.get("meshes", False)
    if not isinstance(meshes, bool):
        raise row.fail(f"meshes = {str(meshes)[:40]!r}", "write meshes = true, or false")
    if "srdf" in given:
        options["srdf"] = _file(folder, row.text("srdf"))
    fit = row.table("fit")
    if fit.content:
        accuracy, most = fit.number("accuracy", "length", Fit().accuracy), _count(fit, "most", Fit().most)
        fit.close()
        options["fit"] = Fit(accuracy, most)
    tool = row.array("tool", "plain", (4, 4), np.eye(4))
    label = row.text("name", Path(file).stem)
    options["ignore"] = [*ignore, *row.listed("ignore")]
    options["posture"] = _posture(row)
    row.close()
    return label, load(_file(folder, file), meshes=meshes, tool=tool if "tool" in given else None, **options)


def _bases(table: Table) -> list[tuple[str, np.ndarray]]:
    """Placements in the world: every combination of the shifts along x, y, z [m] and turns about the world's z."""
    row = table.table("base")
    values = [_finite(row, k, "length", (-1,), [0.0]) for k in "xyz"]
    yaw = _finite(row, "yaw", "angle", (-1,), [0.0])
    row.close()
    found = []
    for x, y, z, turn in itertools.product(*values, yaw):
        frame = np.eye(4)
        frame[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
        frame[:3, 3] = x, y, z
        found.append((f"x={x:g} y={y:g} z={z:g} yaw_deg={np.degrees(turn):g}", frame))
    return found


def _collision(table: Table, folder: Path) -> tuple[Scene | None, float, Weights]:
    row = table.table("collision")
    given = row.content
    row.asked.add("scene")
    scene = given.get("scene")
    if scene is not None and not isinstance(scene, Scene):
        scene = load_scene(_file(folder, row.text("scene")))
    margin = float(_finite(row, "margin", "length", (), 0.005))
    names = [f.name for f in dataclasses.fields(Weights)]
    weights = {k: float(_finite(row, k, "plain", (), getattr(Weights(), k))) for k in names}
    row.close()
    try:
        return scene, margin, Weights(**weights)
    except ValueError as error:
        raise row.fail(str(error), "change them") from None


def _check_geometry(table: Table, chain: Chain) -> None:
    try:
        check_geometry(chain)
    except ValueError as error:
        mend = "write {file = ..., meshes = true}" if chain.unread_meshes else "or leave [collision] out"
        raise table.fail(f"[collision]: {error}", mend) from None


def _grasp(table: Table) -> Grasp:
    row = table.table("tool")
    default = Grasp()
    axes = {k: row.array(k, "plain", (3,), getattr(default, k)) for k in ("up", "approach")}
    row.close()
    if not np.allclose([np.linalg.norm(a) for a in axes.values()], 1.0, atol=1e-6) or abs(axes["up"] @ axes["approach"]) > 1e-6:
        raise row.fail(
            "up and approach are no unit vectors at a right angle", "write e.g. up = [-1, 0, 0], approach = [0, 0, 1]"
        )
    return Grasp(*(tuple(float(x) for x in a) for a in axes.values()))  # type: ignore[arg-type]


def _ik(table: Table, targets: Targets, margin: float) -> IKOptions:
    row = table.table("ik")
    default = IKOptions()
    chosen: dict[str, Any] = {k: _count(row, k, getattr(default, k)) for k in ("max_seeds", "solutions")}
    chosen |= {k: row.text(k, getattr(default, k)) for k in ("choice", "seeds")}
    tolerances = ("position_tolerance", "length", POSITION_TOLERANCE), ("rotation_tolerance", "angle", ROTATION_TOLERANCE)
    for key, unit, usual in tolerances:
        chosen[key] = float(_finite(row, key, unit, (), usual))
        if not chosen[key] > 0.0:
            raise row.fail(f"{key} = {chosen[key]:g}", "write a number > 0")
    row.close()
    try:
        task = Task.position() if targets.free_rotation else IKOptions().task
        return IKOptions(task=task, margin=margin, **chosen)
    except ValueError as error:
        raise row.fail(str(error), "change it") from None


def _targets(table: Table, folder: Path, chains: list[Chain], seed: int, grasp: Grasp) -> Targets:
    row = table.table("targets")
    kind = row.text("kind", "file" if "poses" in row.content else "grid", sources.KINDS)
    frame = row.text("frame", "world", ("world", "base"))
    if kind == "file":
        targets = _given_targets(row, folder, frame, grasp)
    elif kind == "crop":
        crop = row.text("crop", "cucumber_row", sources.CROPS)
        if frame != "world":
            raise row.fail(f"frame = '{frame}': a crop stands in the world", "leave it out")
        targets = sources.from_crops(crop, _count(row, "crops", 1), _count(row, "angles", 24), seed, grasp)
    else:
        turned = _rotations(row, grasp)
        if kind == "grid":
            axes = tuple(_axis(row, k) for k in "xyz")
        else:
            size = row.number("size", "length")
            if not size > 0.0:
                raise row.fail(f"size = {size:g}", "write the edge of a voxel [m], > 0")
            axes = sources.voxels(chains, size)
        targets = Targets(kind, frame, turned, axes)
    row.close()
    if not len(targets):
        raise row.fail("no target", "give at least one")
    some = targets.poses_at(np.unique(np.linspace(0, len(targets) - 1, 1000).astype(np.int64)))[:, :3, 3]
    doubts = [millimetres(chain, some, frame == "world") for chain in chains]
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
    given = next((row.content[k] for k in (key, f"{key}_mm", f"{key}_cm") if k in row.content), [0, 0, 1])
    if not (isinstance(given, list | tuple | np.ndarray) and len(given) == 3):
        raise row.fail(f"'{key}' is not 3 numbers, from, to, count", f"write e.g. {key} = [-0.5, 0.5, 11]")
    low, high, _ = row.array(key, "length", (3,))
    count = next(float(row.content[k][2]) for k in row.read if k in (key, f"{key}_mm", f"{key}_cm"))  # which has no unit
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
        along = sources.directions(_count(row, "directions", 1))
    return sources.rotations(along, _finite(row, "roll", "angle", (-1,), [0.0]), grasp)
