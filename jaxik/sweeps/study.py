"""A study: which robots, from which bases and of which shapes, are asked for postures at, or motions to, which targets, and
among what.

Written as TOML (`docs/how-to/reach-map.md` lists the keys), or as the same nested dictionaries in Python, where a robot may be
a `Robot`, a scene a `Scene`, and the targets an array of poses. It is read and checked key by key.
"""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxik.analytic.families import scan_obstacle
from jaxik.checks.arrays import numbers
from jaxik.checks.options import shown
from jaxik.collision.clearances import check_geometry
from jaxik.collision.scene import Scene
from jaxik.files import load_scene
from jaxik.files.robot_toml import UNITS, Table, read_toml
from jaxik.files.targets import read_targets
from jaxik.ik.options import IKOptions, check_answers_only
from jaxik.kinematics.reach_bound import millimetres
from jaxik.kinematics.robot import Robot
from jaxik.options import anything, count, fields, flag, instance
from jaxik.reach.grasp import Grasp
from jaxik.reach.scoring import PostureOptions
from jaxik.spatial.rotations import frame, from_rpy
from jaxik.sweeps import targets as sources
from jaxik.sweeps.motions import Motions, among_scenes, from_starts, read_around, read_motions, read_study_task, usual_task
from jaxik.sweeps.postures import KINDS as POSTURES
from jaxik.sweeps.postures import read_postures
from jaxik.sweeps.robot_variants import Variant, all_variants, read_shapes, variant_name
from jaxik.sweeps.study_robots import file_of, made, read_robots
from jaxik.sweeps.targets import Targets
from jaxik.version import __version__

KEYS = (
    *("name", "robot", "robots", "base", "parameters", "collision", "tool", "targets", "ik"),
    *("seed", "slides", "refine", "chunk", "audited", "origin", "ignore", "motions", "tip", "posture"),
)
OWN = ("name", "collision", *fields(PostureOptions), "slides", "refine", "seed", "chunk", "audited")  # described as they are
IK_KEYS = ("max_seeds", "choice", "seeds", "solutions")
WRITTEN = "allowed: (N, 4, 4); (N, 7) of x, y, z, qw, qx, qy, qz; positions (N, 3)"
TOLERANCES = {"position_tolerance": "length", "rotation_tolerance": "angle"}


class Study(PostureOptions, who="study"):
    """Everything that decides a sweep's result. `Study.of` reads it."""

    name: str = anything(default="sweep", words="what the store is called by")
    variants: tuple[Variant, ...] = anything(words="each robot in one place and shape")
    axes: tuple[tuple[str, tuple[Any, ...]], ...] = anything(
        default=(), words="what varies besides the targets, the name and labels of each"
    )
    targets: Targets = instance(kind=Targets, words="what each variant is asked for")
    held: dict[str, dict[str, float]] = anything(
        default={}, words="of each robot of which `tip` chose a branch the joints that are held, and where", unit="rad, m"
    )
    scene: Scene | None = instance(default=None, kind=Scene, optional=True, words="the obstacles, the same for all targets")
    around: tuple[tuple[str, Scene], ...] = anything(
        default=(), words="the obstacles of each place along an axis of scenes, by its name, in the place of one scene"
    )
    collision: bool = flag(default=False, words="whether postures are to be clear of the scene and of the robot itself")
    slides: int = count(default=41, words="positions of each leading joint where the closed form answers")
    refine: int = count(default=5, least=0, words="halvings of the gaps between them where they have nothing")
    chunk: int = count(default=10_000, words="targets a chunk")
    audited: int = count(default=2000, least=0, words="targets that are asked again, more densely, for what was missed")
    seed: int = count(default=0, least=0, words="of searches and of the audit")
    ik: IKOptions = instance(default=IKOptions(), kind=IKOptions, words="how targets are searched for without a closed form")
    motions: Motions | None = instance(
        default=None,
        kind=Motions,
        optional=True,
        words="how motions to the targets are planned, unless postures are asked for",
    )

    @staticmethod
    def of(source: Study | str | Path | Mapping[str, Any], **changes: Any) -> Study:
        """Reads a TOML file or nested dictionaries; `changes` replace keys of the top level. Host.

        Raises `LoadError` (a `ValueError`) with one line: the file, the table, what is allowed, the mend.
        """
        if isinstance(source, Study):
            if changes:
                raise ValueError(f"a study that is read does not change ({', '.join(changes)}); change what it was read from")
            return source
        if not isinstance(source, str | Path | Mapping):
            raise ValueError(f"study is {shown(source)}; write a TOML file's name, the same as dictionaries, or a Study")
        path = Path("study") if isinstance(source, Mapping) else Path(source)
        content = dict(source) if isinstance(source, Mapping) else read_toml(path).content
        folder = Path() if isinstance(source, Mapping) else path.parent
        return _read(Table(path, "study", content | {k: v for k, v in changes.items() if v is not None}), folder)

    def check(self) -> None:
        check_answers_only("study: ik", self.ik)

    @property
    def shape(self) -> tuple[int, ...]:
        """The counts of the axes besides the targets."""
        return tuple(len(labels) for _, labels in self.axes)

    @property
    def chunks(self) -> int:
        """The number of chunks of one variant."""
        return -(-len(self.targets) // self.chunk)

    @property
    def joints(self) -> int:
        """The number of joints of the robot that has most."""
        return max(v.robot.num_joints for v in self.variants)

    def scene_of(self, variant: Variant) -> Scene | None:
        """The obstacles around a variant, the same for all targets."""
        if not self.around:
            return self.scene
        return self.around[variant.index[[name for name, _ in self.axes].index("scene")]][1]

    def work(self, number: int) -> tuple[Variant, int, slice]:
        """The variant, chunk and targets of one piece of work; there are `len(variants) * chunks`."""
        variant, chunk = divmod(number, self.chunks)
        start = chunk * self.chunk
        return self.variants[variant], chunk, slice(start, min(start + self.chunk, len(self.targets)))

    def describe(self) -> dict[str, Any]:
        """All that the results depend on, as JSON holds it. Two studies are one where this is equal."""
        return {
            "axes": {name: [str(label) for label in labels] for name, labels in self.axes},
            "models": {variant_name(v.index): f"{v.robot.name} {v.robot.digest[:16]}" for v in self.variants},
            "targets": self.targets.describe(),
            "scene": None if self.scene is None else f"{self.scene.name} {_digest(self.scene)}",
            "scenes": [_digest(s) for s in self.targets.scenes] if self.collision else [],
            **({"around": {name: _digest(scene) for name, scene in self.around}} if self.around else {}),
            **{name: getattr(self, name) for name in OWN},
            "ik": {name: getattr(self.ik, name) for name in (*IK_KEYS, *TOLERANCES)},
            **({} if self.ik.task == usual_task(self.targets) else {"task": repr(self.ik.task)}),
            **({"held": self.held} if self.held else {}),
            **({} if self.motions is None else {"motions": self.motions.describe()}),
            "versions": {"jaxik": __version__, "jax": jax.__version__, "numpy": np.__version__},
        }

    def method(self, robot: Robot) -> str:
        """How a robot's targets are answered: "closed form", "search" or "motion"."""
        if self.motions is not None:
            return "motion"
        return "closed form" if self.ik.task.whole and not scan_obstacle(robot) else "search"


def _digest(scene: Scene) -> str:
    names = scene.object_names, scene.owners, [mark.name for mark in scene.marks]  # links may ignore objects by these
    content = hashlib.sha256(repr(names).encode())
    for leaf in jax.tree_util.tree_leaves(scene):
        content.update(np.ascontiguousarray(np.asarray(leaf, np.float64)).tobytes())
    return content.hexdigest()[:16]


# --------------------------------------------------------------------------------------------------------------------
# Reading


def _read(table: Table, folder: Path) -> Study:
    """The study that a table describes; files that it names lie in `folder`."""
    given = table.content
    table.only(KEYS)
    table.asked.update(("robot", "robots"))
    robots, beside = read_robots(table, folder)
    bases, shapes = _bases(table), read_shapes(table)
    axes, variants = all_variants(table, robots, bases, shapes)
    scene, around, wanted = _collision(table, folder)
    moving = "motions" in given
    collision = moving or "collision" in given
    tool = table.table("tool")
    held = {name: tuple(tool.array(name, "plain", (3,), usual).tolist()) for name, usual in vars(Grasp()).items()}
    grasp = made(tool, "change them", Grasp, **held)
    targets = _targets(table, folder, [v.robot for v in variants], scene, grasp)
    if targets.scenes:  # which are around the targets instead
        scene = None
    if "tool" in given and not targets.scenes and not len(targets.rotations):
        raise table.fail("[tool] turns the tool into a direction, and no target has a direction", "leave it out")
    ik = _ik(table, targets, wanted["margin"] if collision else None)
    least = {"slides": 1, "chunk": 1, "refine": 0, "audited": 0, "seed": 0}
    usual = {key: 0 if moving and key == "audited" else getattr(Study, key) for key in least}
    counts = {key: table.count(key, usual[key], least=few) for key, few in least.items()}
    robots_of = [v.robot for v in variants]
    motions = read_motions(table, robots_of, targets, wanted["margin"]) if moving else None
    ik = ik if motions is None else ik.changed({"task": motions.plan.task})
    if motions is not None:
        axes, variants = from_starts(motions, *among_scenes(around, axes, variants))
    name = table.text("name", "sweep")
    table.close()
    for variant in variants if collision else ():
        mend = "write {file = ..., meshes = true}" if variant.robot.unread_meshes else "or leave [collision] out"
        made(table.table("collision"), mend, check_geometry, variant.robot)
    own: dict[str, Any] = {"variants": variants, "axes": axes, "targets": targets, "scene": scene, "collision": collision}
    own["held"] = beside
    return Study(name=name, ik=ik, motions=motions, around=around, **own | wanted | counts)


def _bases(table: Table) -> list[tuple[str, np.ndarray]]:
    """Placements in the world: every combination of the shifts along x, y, z [m] and turns about the world's z."""
    row = table.table("base")
    values = [row.finite(k, (-1,), unit="length", default=[0.0]) for k in "xyz"]
    yaw = row.finite("yaw", (-1,), unit="angle", default=[0.0])
    return [
        (f"x={x:g} y={y:g} z={z:g} yaw_deg={np.degrees(turn):g}", frame((x, y, z), from_rpy((0.0, 0.0, turn))) + 0.0)  # no -0
        for x, y, z, turn in itertools.product(*values, yaw)
    ]


def _collision(table: Table, folder: Path) -> tuple[Scene | None, tuple[tuple[str, Scene], ...], dict[str, float]]:
    """The scene, or several that are an axis, and the fields of `PostureOptions`."""
    row = table.table("collision")
    row.asked.update(("scene", "scenes"))
    scene = row.content.get("scene")
    if scene is not None and not isinstance(scene, Scene):
        scene = load_scene(file_of(folder, row.text("scene")))
    around = read_around(row, "motions" in table.content, lambda name: load_scene(file_of(folder, name)))
    if len(around) == 1:
        scene, around = around[0][1], ()
    units = {name: "length" if field.unit == "m" else "plain" for name, field in fields(PostureOptions).items()}
    number = lambda name: float(row.finite(name, (), unit=units[name], default=getattr(PostureOptions, name)))
    wanted = {name: number(name) for name in units}
    made(row, "change it", PostureOptions, **wanted)
    return scene, around, wanted


def _ik(table: Table, targets: Targets, margin: float | None) -> IKOptions:
    """The options of a search that keeps a margin, or looks at nothing that may be hit."""
    row, default = table.table("ik"), IKOptions()
    chosen: dict[str, Any] = {k: row.count(k, getattr(default, k)) for k in ("max_seeds", "solutions")}
    chosen |= {k: row.text(k, getattr(default, k)) for k in ("choice", "seeds")}
    for key, unit in TOLERANCES.items():
        chosen[key] = float(row.finite(key, (), unit=unit, default=getattr(default, key)))
        if not chosen[key] > 0.0:
            raise row.fail(f"{key} = {chosen[key]:g}", "write a number > 0")
    chosen |= {"collision": False} if margin is None else {"margin": margin}
    return made(row, "change it", IKOptions, task=read_study_task(row, targets), **chosen)


def _targets(table: Table, folder: Path, robots: list[Robot], scene: Scene | None, grasp: Grasp) -> Targets:
    row = table.table("targets")
    usual = next((kind for key, kind in (("poses", "file"), ("goals", "postures")) if key in row.content), "grid")
    kind = row.text("kind", usual, (*sources.KINDS, *POSTURES))
    if kind in POSTURES:
        if "motions" not in table.content:
            raise row.fail(f"kind = '{kind}': postures are goals of motions", "write [motions]")
        return read_postures(row, folder, kind, robots)
    frame = row.text("frame", "world", ("world", "base"))
    if kind == "file":
        targets = _given_targets(row, folder, frame, grasp)
    elif kind == "marks":
        if frame != "world":
            raise row.fail(f"frame = '{frame}': a scene's marks stand in the world", "leave it out")
        targets = sources.around_marks(_scenes(row, folder, scene), row.count("angles", 24), grasp)
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


def _scenes(row: Table, folder: Path, scene: Scene | None) -> list[Scene]:
    """The scenes whose marks are asked for: those that are listed, or that of [collision]."""
    listed = row.listed("scenes", "a list of scenes or files", 'scenes = ["cucumber_row"]')
    if scene is not None and listed:
        raise row.fail("scenes and [collision] scene both say what is in the way", "keep one")
    found = []
    for each in [scene] if scene is not None else listed:
        if not isinstance(each, Scene | str):
            raise row.fail(f"a scene is {type(each).__name__}", "write a shipped scene's name, a file, or a Scene")
        found.append(each if isinstance(each, Scene) else load_scene(file_of(folder, each)))
        if not found[-1].marks:
            raise row.fail(f"scene '{found[-1].name}' has no mark", "write [[mark]] with a name and a position")
    return found


def _given_targets(row: Table, folder: Path, frame: str, grasp: Grasp) -> Targets:
    row.asked.update(("path", "poses"))
    known = row.content.get("poses")
    if known is not None and "path" in row.content:
        raise row.fail("path and poses say the same", "keep one")
    poses = read_targets(folder / row.text("path")) if known is None else made(row, WRITTEN, numbers, "poses", known)
    if poses.shape[1:] in ((4, 4), (7,)):
        return Targets("file", frame, np.zeros((0, 3, 3)), poses=poses)
    if poses.ndim == 2 and poses.shape[1] == 3:
        return Targets("file", frame, _rotations(row, grasp), positions=poses)
    raise row.fail(f"poses of shape {poses.shape}", WRITTEN)


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
    if isinstance(given, str):
        raise row.fail(f"directions = '{shown(given)}'", 'write "any", a count, or a list of [x, y, z]')
    if isinstance(given, list | tuple | np.ndarray):
        along = row.array("directions", "plain", (-1, 3))
        if not np.all(np.linalg.norm(along, axis=1) > 1e-9):
            raise row.fail("a direction has no length", "write [x, y, z]")
    else:
        along = sources.directions(row.count("directions", 1))
    return sources.rotations(along, row.finite("roll", (-1,), unit="angle", default=[0.0]), grasp)
