"""Arguments of commands: flags from the declarations of options, whose defaults, units and words stand there alone; and those
that choose a robot: which chain of its file, where the joints beside it are held, what is not checked."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar

import tyro

import jaxik
from jaxik.options import Options, fields

IGNORED = "What is not checked: two links (forearm:hand), a link and an object (base:floor), a link and any object (rail)."
Ignored = Annotated[tuple[str, ...], tyro.conf.arg(metavar="[LINK|LINK:OTHER]...", help=IGNORED)]

CHECKED = "Links that are checked against each other in any case (forearm:hand), though their meshes mostly touch; or all."
Checked = Annotated[tuple[str, ...], tyro.conf.arg(metavar="[LINK:LINK|all]...", help=CHECKED)]


CLOUD_RADIUS = 0.005  # [m] of the balls around points, which closes a cloud whose points are a centimetre apart
TASK = 'such as "upright z within 10deg", "pose free yaw within x=5cm" or "position at 0.4,0,0.3"; m and rad unless said'


def task_flag(words: str) -> Any:
    """A flag of tasks in words (`kinematics.read_task`), given once or more; `words` say what they are for."""
    return Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="TASK", help=f"{words}, {TASK}.")]


def flags(options: type[Options], words: dict[str, str] | None = None, **kinds: Any) -> Any:
    """A base of a command's arguments with those fields of `options` that `kinds` names, each of the type that it gives: a
    shell knows no objects. Where that is less than the field takes, `words` tell of it. `given` gathers them again."""
    usual, made = options(), []
    for name, kind in kinds.items():
        field = fields(options)[name]
        told = (words or {}).get(name, field.words)
        line = f"{told[0].upper()}{told[1:]}{f' [{field.unit}]' if field.unit else ''}."
        made.append((name, Annotated[kind, tyro.conf.arg(help=line)], dataclasses.field(default=getattr(usual, name))))
    return dataclasses.make_dataclass(f"{options.__name__}Flags", made, kw_only=True)


def given(arguments: Any, options: type[Options]) -> dict[str, Any]:
    """The fields of `options` that a command has as flags, by name."""
    return {name: getattr(arguments, name) for name in fields(options) if hasattr(arguments, name)}


@dataclasses.dataclass(kw_only=True)
class RobotArguments:
    """The chain of a robot's file, or the tree of several tips, where joints beside it are held, and what is not checked."""

    SEVERAL: ClassVar[bool] = False  # whether the command takes several tips
    robot: tyro.conf.Positional[str]
    """A shipped model or a robot file (.urdf, .xml, .toml)."""
    tip: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """The link at the tip, which goes to the targets; needed where the robot has several. Given again, the tree of several."""
    base: str | None = None
    """The link that the robot starts from, and targets are given in; the root unless given."""
    posture: tuple[str, ...] = ()
    """Where joints beside the chain are held, joint=value [rad, m]: a head, a gripper; 0 unless given."""
    held: tuple[str, ...] = ()
    """Where joints are held, those on the way to the tip, too, joint=value [rad, m]: then they are no joints of the robot."""
    srdf: Path | None = None
    """A file that says which links are not checked against each other, and names groups, states and end effectors."""
    ignore: Ignored = ()
    packages: tuple[Path, ...] = ()
    """Folders of ROS packages, or that hold such, beside those above the file and in ROS' environment."""

    def loading(self) -> dict[str, Any]:
        """The arguments of `jaxik.load` among these. Raises `ValueError` for several tips where the command takes one."""
        if len(self.tip) > 1 and not self.SEVERAL:
            raise ValueError(f"--tip {' --tip '.join(self.tip)}: this command moves one tip; name --tip once")
        tip = self.tip[0] if len(self.tip) == 1 else [*self.tip] or None
        more = {"posture": read_posture(self.posture), "ignore": ignored_pairs(self.ignore)}
        more["held"] = read_posture(self.held, "--held")
        return {"tip": tip, "base": self.base, "srdf": self.srdf, "packages": self.packages, **more}


@dataclasses.dataclass(kw_only=True)
class ShapedRobotArguments(RobotArguments):
    """A robot whose shape counts."""

    meshes: bool = True
    """Read the robot's collision meshes (URDF, MJCF), and fit a model to them: the first time it takes some seconds."""
    pairs: Checked = ()
    exact: bool = False
    """Let the meshes' triangles decide what is near: slower, and no free room is given up."""

    def loading(self) -> dict[str, Any]:
        """The arguments of `jaxik.load` among these."""
        return super().loading() | {"meshes": self.meshes, "pairs": checked_pairs(self.pairs), "exact": self.exact}


@dataclasses.dataclass(kw_only=True)
class AroundArguments:
    """The surroundings of a robot."""

    scene: str | None = None
    """A shipped scene or a scene file: obstacles to keep clear of; without one, the robot keeps clear of itself."""
    cloud: Path | None = None
    """Points to keep clear of, too (.ply, .xyz, .pcd, .npy, .npz), in metres in the scene's frame; an object called cloud."""
    cloud_radius: float | None = None
    """The radius of a ball around each of them [m], 0.005 where it is not told."""

    def around(self) -> jaxik.Scene | None:
        """The scene with the cloud; None where neither is given. Raises `ValueError` for a radius without a cloud."""
        scene = None if self.scene is None else jaxik.load_scene(self.scene)
        if self.cloud is None:
            if self.cloud_radius is not None:
                raise ValueError(f"--cloud-radius is {self.cloud_radius:g}, and there are no points; give them by --cloud")
            return scene
        points = jaxik.files.load_cloud(self.cloud)
        radius = CLOUD_RADIUS if self.cloud_radius is None else self.cloud_radius
        return (scene or jaxik.make_scene()).with_cloud(points, radius)


@dataclasses.dataclass(kw_only=True)
class SearchArguments(AroundArguments, ShapedRobotArguments):
    """A robot that keeps clear of what is around it, by a search."""

    seed: int = 0
    """Another number, another (deterministic) search."""


def read_posture(words: Sequence[str], flag: str = "--posture") -> dict[str, float] | None:
    """The `posture=` of `jaxik.load`, or its `held=`; None where nothing is given, and what is held is named. Raises
    `ValueError`."""
    found = {}
    for word in words:
        name, _, value = word.partition("=")
        try:
            found[name] = float(value)
        except ValueError:
            raise ValueError(f"{flag} {word}: write joint=value, such as panda_finger_joint1=0.04 [rad, m]") from None
    return found or None


def ignored_pairs(given: Sequence[str]) -> list[Any]:
    """The `ignore=` of `jaxik.load`, from words as they stand in a command: "LINK", "LINK:LINK" or "LINK:OBJECT"."""
    pairs = [tuple(each.split(":")) for each in given]
    for each, names in zip(given, pairs, strict=True):
        if len(names) > 2 or not all(names):
            example = "--ignore forearm:hand base:floor rail"
            raise ValueError(f"--ignore {each}: write LINK, LINK:LINK or LINK:OBJECT, e.g. {example}")
    return [names if len(names) == 2 else names[0] for names in pairs]


def checked_pairs(given: Sequence[str]) -> Any:
    """The `pairs=` of `jaxik.load`, from words as they stand in a command: "LINK:LINK", or "all"."""
    if tuple(given) == ("all",):
        return "all"
    pairs = [tuple(each.split(":")) for each in given]
    for each, names in zip(given, pairs, strict=True):
        if len(names) != 2 or not all(names):
            raise ValueError(f"--pairs {each}: write LINK:LINK, e.g. --pairs forearm:hand, or all")
    return pairs
