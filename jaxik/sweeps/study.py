"""A study: which robots, from which bases and of which shapes, are asked for which targets, among what.

Written as TOML (`docs/how-to/reach-map.md` lists the keys), or as the same nested dictionaries in Python, where a robot may be
a `Robot`, a scene a `Scene`, and the targets an array of poses.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

import jaxik
from jaxik.analytic.families import scan_obstacle
from jaxik.collision.scene import Scene
from jaxik.files.robot_toml import Table, read_toml
from jaxik.ik.options import IKOptions
from jaxik.kinematics.robot import Robot
from jaxik.reach.ranking import PostureOptions
from jaxik.sweeps.robot_variants import Variant, variant_name
from jaxik.sweeps.targets import Targets

CHUNK = 10_000
POSITION_TOLERANCE, ROTATION_TOLERANCE = 1e-6, 1e-6  # [m], [rad]
OWN = ("name", "collision", "margin", "slides", "refine", "seed", "chunk", "audited")  # of a study, as they are
IK_KEYS = ("max_seeds", "choice", "seeds", "solutions")


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
    wanted: PostureOptions
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
        from jaxik.sweeps.study_file import read_study  # late: it makes studies

        if isinstance(source, Study):
            if changes:
                raise ValueError(f"a study that is read does not change ({', '.join(changes)}); change what it was read from")
            return source
        path = Path("study") if isinstance(source, Mapping) else Path(source)
        content = dict(source) if isinstance(source, Mapping) else read_toml(path).content
        folder = Path() if isinstance(source, Mapping) else path.parent
        return read_study(Table(path, "study", content | {k: v for k, v in changes.items() if v is not None}), folder)

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
        """Of the robot that has most."""
        return max(v.robot.num_joints for v in self.variants)

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
            "crops": [_digest(s) for s in self.targets.scenes] if self.collision else [],
            "wanted": dataclasses.asdict(self.wanted),
            **{name: getattr(self, name) for name in OWN},
            "ik": {k: getattr(self.ik, k) for k in (*IK_KEYS, "position_tolerance", "rotation_tolerance")},
            "versions": {module.__name__: module.__version__ for module in (jaxik, jax, np)},
        }

    def method(self, robot: Robot) -> str:
        """How a robot's targets are answered: "closed form" or "search"."""
        return "search" if scan_obstacle(robot) or self.targets.free_rotation else "closed form"


def _digest(scene: Scene) -> str:
    content = hashlib.sha256()
    for leaf in jax.tree_util.tree_leaves(scene):
        content.update(np.ascontiguousarray(np.asarray(leaf, np.float64)).tobytes())
    return content.hexdigest()[:16]


# --------------------------------------------------------------------------------------------------------------------
# Reading
