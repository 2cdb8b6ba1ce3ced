"""A study: which robots, from which bases and of which shapes, are asked for which targets, among what.

Written as TOML (`docs/how-to/reach-map.md` lists the keys), or as the same nested dictionaries in Python, where a robot may be
a `Chain`, a scene a `Scene`, and the targets an array of poses.
"""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

import jaxik
from jaxik.collision.clearances import check_geometry
from jaxik.collision.scene import Scene
from jaxik.files import load, load_scene
from jaxik.files.targets import read_targets
from jaxik.files.toml import Table, read_toml
from jaxik.harvesting.scanning import Grasp, Weights
from jaxik.ik.options import IKOptions
from jaxik.robot.chain import Chain
from jaxik.robot.reach_bound import millimetres
from jaxik.robot.spherical_wrist import closed_form_obstacle
from jaxik.robot.task import Task
from jaxik.sweeps import targets as sources
from jaxik.sweeps.targets import Targets

CHUNK = 10_000
POSITION_TOLERANCE, ROTATION_TOLERANCE = 1e-6, 1e-6  # [m], [rad]
IK_KEYS = ("max_seeds", "choice", "seeds", "solutions")
KEYS = (
    *("name", "robot", "robots", "base", "parameters", "collision", "tool", "targets", "ik"),
    *("seed", "slides", "refine", "chunk", "audited", "origin"),
)
LENGTHS = ("length", "x", "y", "z")


@dataclasses.dataclass(frozen=True)
class Variant:
    """One robot in one place and shape: what a chunk of targets is asked of, and its place along the study's `axes`."""

    chain: Chain
    index: tuple[int, ...]


@dataclasses.dataclass(frozen=True)
class Study:
    """Everything that decides a sweep's result, read and checked. `axes` are what varies besides the targets: name and labels.

    `slides` are positions of each leading joint where the closed form answers, `refine` how often the gaps between them are
    halved where they have nothing; `ik` the options where the search answers; `audited` so many targets are asked again, more
    densely, for what was missed.
    """

    name: str
    variants: tuple[Variant, ...]
    axes: tuple[tuple[str, tuple[Any, ...]], ...]
    targets: Targets
    scene: Scene | None
    collision: bool
    margin: float
    weights: Weights
    slides: int
    refine: int
    seed: int
    chunk: int
    ik: IKOptions
    audited: int

    @staticmethod
    def of(source: Study | str | Path | Mapping[str, Any], **changes: Any) -> Study:
        """From a TOML file or nested dictionaries; `changes` replace keys of the top level.

        Raises `LoadError` (a `ValueError`) with one line: the file, the table, what is allowed, the mend.
        """
        if isinstance(source, Study):
            if changes:
                raise ValueError(f"a study that is read does not change ({', '.join(changes)}); change what it was read from")
            return source
        path = Path("study") if isinstance(source, Mapping) else Path(source)
        content = dict(source) if isinstance(source, Mapping) else read_toml(path).content
        folder = Path() if isinstance(source, Mapping) else path.parent
        return _read(Table(path, "study", content | {k: v for k, v in changes.items() if v is not None}), folder)

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the axes besides the targets."""
        return tuple(len(labels) for _, labels in self.axes)

    @property
    def chunks(self) -> int:
        """Of one variant."""
        return -(-len(self.targets) // self.chunk)

    @property
    def joints(self) -> int:
        """Of the chain that has most."""
        return max(v.chain.num_joints for v in self.variants)

    def work(self, number: int) -> tuple[Variant, int, slice]:
        """The variant, chunk and targets of one piece of work; there are `len(variants) * chunks`."""
        variant, chunk = divmod(number, self.chunks)
        start = chunk * self.chunk
        return self.variants[variant], chunk, slice(start, min(start + self.chunk, len(self.targets)))

    def describe(self) -> dict[str, Any]:
        """All that the results depend on, as JSON holds it. Two studies are one where this is equal."""
        return {
            "name": self.name,
            "axes": {name: [str(label) for label in labels] for name, labels in self.axes},
            "models": {variant_name(v.index): f"{v.chain.name} {v.chain.digest[:16]}" for v in self.variants},
            "targets": self.targets.describe(),
            "scene": None if self.scene is None else f"{self.scene.name} {_digest(self.scene)}",
            "crops": [_digest(s) for s in self.targets.scenes] if self.collision else [],
            "collision": self.collision,
            "margin": self.margin,
            "weights": dataclasses.asdict(self.weights),
            "slides": self.slides,
            "refine": self.refine,
            "seed": self.seed,
            "chunk": self.chunk,
            "audited": self.audited,
            "ik": {k: getattr(self.ik, k) for k in (*IK_KEYS, "position_tolerance", "rotation_tolerance")},
            "versions": {module.__name__: module.__version__ for module in (jaxik, jax, np)},
        }

    def method(self, chain: Chain) -> str:
        """How a chain's targets are answered: "closed form" or "search"."""
        return "search" if self.targets.free_rotation or closed_form_obstacle(chain) else "closed form"


def variant_name(index: tuple[int, ...]) -> str:
    """How the store's attributes call a variant."""
    return "/".join(map(str, index)) or "only"


def _digest(scene: Scene) -> str:
    content = hashlib.sha256()
    for leaf in jax.tree_util.tree_leaves(scene):
        content.update(np.ascontiguousarray(np.asarray(leaf, np.float64)).tobytes())
    return content.hexdigest()[:16]


# --------------------------------------------------------------------------------------------------------------------
# Reading


def _read(table: Table, folder: Path) -> Study:
    given = table.content
    table.only(KEYS)
    table.asked.update(("robot", "robots"))
    name = table.text("name", "sweep")
    robots = _robots(table, folder)
    bases, shapes = _bases(table), _shapes(table)
    axes, variants = _variants(table, robots, bases, shapes)
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
    found = []
    for i, each in enumerate(given if isinstance(given, list | tuple) else [given]):
        if isinstance(each, Chain):
            found.append((each.name, each))
        elif isinstance(each, str):
            found.append((Path(each).stem, load(_file(folder, each))))
        elif isinstance(each, dict):
            row = Table(table.path, f"robots {i + 1}", each)
            file = row.text("file")
            options = {k: row.text(k) for k in ("tip", "base") if k in each}
            row.asked.update(("meshes", "tip", "base"))
            srdf = _file(folder, row.text("srdf")) if "srdf" in each else None
            row.asked.add("srdf")
            label, meshes = row.text("name", Path(file).stem), each.get("meshes", False)
            if not isinstance(meshes, bool):
                raise row.fail(f"meshes = {str(meshes)[:40]!r}", "write meshes = true, or false")
            chain = load(_file(folder, file), **options, srdf=srdf, meshes=meshes)
            row.close()
            found.append((label, chain))
        else:
            raise table.fail(f"robot {i + 1} is {type(each).__name__}", "write a shipped model's name, a file, or a table")
    if not found or len({label for label, _ in found}) < len(found):
        raise table.fail("two robots of one name" if found else "no robot", "give each its own: {file = ..., name = ...}")
    return found


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


def _shapes(table: Table) -> list[tuple[str, np.ndarray]]:
    row = table.table("parameters")
    nested = row.content  # TOML reads joint.upper = ... as a table in a table
    flat = {f"{k}.{w}": v for k, inner in nested.items() if isinstance(inner, dict) for w, v in inner.items()}
    row = Table(row.path, row.where, flat | {k: v for k, v in nested.items() if not isinstance(v, dict)})
    found = []
    for key in row.content:
        name, unit = (key.removesuffix("_deg"), "angle") if key.endswith("_deg") else (key, "plain")
        values = row.array(name, unit, (-1,))
        if not len(values):
            raise row.fail(f"{key} holds no number", "write one or several")
        found.append((name, values))
    row.close()
    if len(found) > 2:
        raise row.fail(f"{len(found)} parameters", "vary at most two in a study")
    return found


def _variants(
    table: Table,
    robots: list[tuple[str, Chain]],
    bases: list[tuple[str, np.ndarray]],
    shapes: list[tuple[str, np.ndarray]],
) -> tuple[tuple[tuple[str, tuple[Any, ...]], ...], tuple[Variant, ...]]:
    """What varies, and each combination of it, in C order of the axes; what has one value only is no axis."""
    every: list[tuple[str, tuple[Any, ...], list[Callable[[Chain], Chain]]]] = []
    every.append(("base", tuple(n for n, _ in bases), [_moved(frame) for _, frame in bases]))
    for key, values in shapes:
        every.append((key, tuple(float(v) for v in values), [_reshaped(table, key, float(v)) for v in values]))
    axes = [(name, labels) for name, labels, _ in every if len(labels) > 1]
    if len(robots) > 1:
        axes.insert(0, ("robot", tuple(label for label, _ in robots)))
    variants, robot_axis = [], len(robots) > 1
    for r, (_, robot) in enumerate(robots):
        for picks in itertools.product(*(range(len(labels)) for _, labels, _ in every)):
            chain = robot
            for pick, (_, _, changes) in zip(picks[1:], every[1:], strict=True):
                chain = changes[pick](chain)
            chain = every[0][2][picks[0]](chain)
            index = [p for p, (_, labels, _) in zip(picks, every, strict=True) if len(labels) > 1]
            variants.append(Variant(chain, tuple([r, *index] if robot_axis else index)))
    return tuple(axes), tuple(variants)


def _moved(world_T_place: np.ndarray) -> Callable[[Chain], Chain]:
    """The chain placed elsewhere. At the origin it stays what it was, to the bit."""
    if np.array_equal(world_T_place, np.eye(4)):
        return lambda chain: chain
    return lambda chain: chain.mounted(world_T_place @ chain.world_T_base)


def _reshaped(table: Table, key: str, value: float) -> Callable[[Chain], Chain]:
    """The chain with one number changed: `JOINT.lower`, `.upper` [rad, m], or `.length`, `.x`, `.y`, `.z` [m] of the link
    before the joint (`tip.length` of the last)."""
    joint, _, what = key.rpartition(".")
    allowed = f"JOINT.lower, .upper, .{', .'.join(LENGTHS)}"

    def change(chain: Chain) -> Chain:
        if what not in ("lower", "upper", *LENGTHS) or (joint == "tip" and what not in LENGTHS):
            raise table.fail(f"[parameters] '{key}'", f"allowed: {allowed}, tip.{', tip.'.join(LENGTHS)}")
        if joint not in (*chain.joint_names, "tip"):
            raise table.fail(
                f"[parameters] '{key}': {chain.name} has no joint '{joint}'", f"{', '.join(chain.joint_names)}, tip"
            )
        if what in ("lower", "upper"):
            return _limited(table, chain, chain.joint_names.index(joint), what, value)
        return _stretched(table, chain, joint, what, value)

    return change


def _limited(table: Table, chain: Chain, joint: int, what: str, value: float) -> Chain:
    lower, upper = np.array(chain.lower, np.float64), np.array(chain.upper, np.float64)
    (lower if what == "lower" else upper)[joint] = value
    if not lower[joint] <= upper[joint]:
        name = f"[parameters] {chain.joint_names[joint]}.{what} = {value:g}"
        raise table.fail(f"{name} crosses the other limit", "keep lower <= upper")
    return dataclasses.replace(chain, lower=lower, upper=upper)


def _stretched(table: Table, chain: Chain, joint: str, what: str, value: float) -> Chain:
    """The chain with the offset before `joint` (after the last, for the tip) changed, and that link's geometry with it."""
    number = chain.num_joints if joint == "tip" else chain.joint_names.index(joint)
    before = np.array(chain.joint_T_tip if joint == "tip" else chain.parent_T_joint[number], np.float64)
    old = before[:3, 3].copy()
    if what == "length":
        if not np.linalg.norm(old) > 1e-9:
            raise table.fail(f"[parameters] {joint}.length: the offset is 0 and has no direction", f"give {joint}.x, .y or .z")
        if not value > 0.0:
            raise table.fail(f"[parameters] {joint}.length = {value:g}", "write a length > 0 [m]")
        new = old * (value / np.linalg.norm(old))
    else:
        new = old.copy()
        new["xyz".index(what)] = value
    before[:3, 3] = new
    carried = {link for link, j in enumerate(chain.link_joint) if j == number}
    if joint == "tip":
        changed = dataclasses.replace(chain, joint_T_tip=before)
    else:
        frames = np.array(chain.parent_T_joint, np.float64)
        frames[number] = before
        changed = dataclasses.replace(chain, parent_T_joint=frames)
    return _with_geometry(changed, carried, old, new) if what == "length" else changed


def _with_geometry(chain: Chain, links: set[int], old: np.ndarray, new: np.ndarray) -> Chain:
    """Boxes and swept volumes of a lengthened link, stretched along it by as much."""
    along = old / np.linalg.norm(old)
    more = np.linalg.norm(new) / np.linalg.norm(old) - 1.0

    def stretched(points: np.ndarray) -> np.ndarray:
        return points + more * (points @ along)[..., None] * along

    boxes = []
    for box in chain.boxes:
        if box.link in links:
            frame = np.array(box.joint_T_box, np.float64)
            half = np.asarray(box.half) * (1.0 + more * np.abs(frame[:3, :3].T @ along))
            frame[:3, 3] = stretched(frame[:3, 3])
            box = dataclasses.replace(box, joint_T_box=frame, half=half)
        boxes.append(box)
    volumes = [
        dataclasses.replace(v, corners=stretched(np.asarray(v.corners))) if v.link in links else v for v in chain.volumes
    ]
    return dataclasses.replace(chain, boxes=tuple(boxes), volumes=tuple(volumes))


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
        task = Task((True, True, True, False, False, False), "base") if targets.free_rotation else IKOptions().task
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
