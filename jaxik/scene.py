"""Obstacles and fruits in a z-up world [m], and how they are padded to a few sizes.

A scene is a pytree of arrays, so obstacles may be traced (moved, differentiated) and two scenes padded to the same sizes run
the same compiled program. Every obstacle belongs to a named object: a leaf of fifteen points is one object.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from jaxik.chain import Array

FAR = 1e6  # [m] where padding stands: exact in float32 as a square, and no scene file may hold more than 100 m
SIZES = (0, 8, 32, *(k * 2**n for n in range(5, 14) for k in (2, 3)))
KINDS = ("points", "spheres", "capsules", "boxes", "cylinders")


class Points(eqx.Module):
    """Points of one common `radius` [m] (0 for bare points): the cheapest obstacle, one square root a configuration."""

    center: Float[Array, "k 3"]
    radius: Float[Array, ""]


class Spheres(eqx.Module):
    """Balls, each with its own radius [m]."""

    center: Float[Array, "k 3"]
    radius: Float[Array, " k"]


class Capsules(eqx.Module):
    """Segments from `a` to `b`, swept by a ball."""

    a: Float[Array, "k 3"]
    b: Float[Array, "k 3"]
    radius: Float[Array, " k"]


class Boxes(eqx.Module):
    """`half` holds half the edges along the axes of `world_T_box`."""

    world_T_box: Float[Array, "k 4 4"]
    half: Float[Array, "k 3"]


class Cylinders(eqx.Module):
    """Round about z of `world_T_cylinder`, from -`half` to `half` along it."""

    world_T_cylinder: Float[Array, "k 4 4"]
    radius: Float[Array, " k"]
    half: Float[Array, " k"]


class Fruit(eqx.Module):
    """What is to be picked: the tip goes to `position` [m] and may turn about `axis` (unit, up along the fruit)."""

    position: Float[Array, "3"]
    axis: Float[Array, "3"]
    name: str = eqx.field(static=True)


class Scene(eqx.Module):
    """Obstacles by kind; `owners` gives, kind by kind in the order of `KINDS`, the object that each obstacle belongs to.

    `removable[i]` says whether object i may be taken away for a fruit's sake (leaves may, stems may not). A fruit that is an
    obstacle to others is the object of its own name.
    """

    points: Points
    spheres: Spheres
    capsules: Capsules
    boxes: Boxes
    cylinders: Cylinders
    fruits: tuple[Fruit, ...] = ()
    name: str = eqx.field(static=True, default="scene")
    object_names: tuple[str, ...] = eqx.field(static=True, default=())
    removable: tuple[bool, ...] = eqx.field(static=True, default=())
    owners: tuple[tuple[int, ...], ...] = eqx.field(static=True, default=((),) * 5)

    @property
    def counts(self) -> dict[str, int]:
        """How many obstacles of each kind there are, padding included."""
        return {k: int(jax.tree_util.tree_leaves(getattr(self, k))[0].shape[0]) for k in KINDS}

    def without(self, objects: Any) -> Scene:
        """The scene with these objects (indices or names) moved out of the way; shapes stay. Who is not there cannot be."""
        gone = set(objects)
        gone |= {i for i, name in enumerate(self.object_names) if name in gone}
        masks = {k: np.array([o in gone for o in owners], bool) for k, owners in zip(KINDS, self.owners, strict=True)}
        return dataclasses.replace(self, **{k: _moved_away(getattr(self, k), masks[k]) for k in KINDS})

    def moved(self, a_T_world: np.ndarray) -> Scene:
        """The same scene as seen from another frame: all its points `p` become `a_T_world @ p`."""
        turn, shift = a_T_world[:3, :3], a_T_world[:3, 3]
        to = lambda points: np.asarray(points) @ turn.T + shift
        return dataclasses.replace(
            self,
            points=dataclasses.replace(self.points, center=to(self.points.center)),
            spheres=dataclasses.replace(self.spheres, center=to(self.spheres.center)),
            capsules=dataclasses.replace(self.capsules, a=to(self.capsules.a), b=to(self.capsules.b)),
            boxes=dataclasses.replace(self.boxes, world_T_box=a_T_world @ self.boxes.world_T_box),
            cylinders=dataclasses.replace(self.cylinders, world_T_cylinder=a_T_world @ self.cylinders.world_T_cylinder),
            fruits=tuple(dataclasses.replace(f, position=to(f.position), axis=turn @ f.axis) for f in self.fruits),
        )

    def geometry(self) -> Scene:
        """The obstacles alone, padded and without names: scenes of like sizes then run the same compiled program."""
        full = self.padded()
        return Scene(full.points, full.spheres, full.capsules, full.boxes, full.cylinders)

    def padded(self) -> Scene:
        """The scene with each kind padded to the next of a few sizes by obstacles that are out of the way."""
        kinds, owners = {}, []
        for kind, own in zip(KINDS, self.owners, strict=True):
            count = self.counts[kind]
            extra = next((s for s in SIZES if s >= count), count) - count
            kinds[kind] = _padded(getattr(self, kind), extra)
            owners.append((*own, *([-1] * (count + extra - len(own)))))
        return dataclasses.replace(self, owners=tuple(owners), **kinds)


def _moved_away(obstacles: Any, mask: np.ndarray) -> Any:
    if not mask.any():
        return obstacles

    def move(leaf: Any) -> Any:
        if leaf.ndim == 0 or leaf.ndim == 1:
            return leaf
        column = mask.reshape(-1, *([1] * (leaf.ndim - 1)))
        far = np.full(leaf.shape[1:], FAR)
        if leaf.shape[1:] == (4, 4):
            far = np.eye(4) + np.pad(np.full((3, 1), FAR), ((0, 1), (3, 0)))
        return np.where(column, far.astype(leaf.dtype), leaf)

    moved = jax.tree_util.tree_map(move, obstacles)
    # a box's `half` is a size, not a place
    return dataclasses.replace(moved, half=obstacles.half) if isinstance(obstacles, Boxes) else moved


def _padded(obstacles: Any, extra: int) -> Any:
    if not extra:
        return obstacles

    def pad(leaf: Any) -> Any:
        if leaf.ndim == 0:
            return leaf
        return np.concatenate([leaf, np.zeros((extra, *leaf.shape[1:]), leaf.dtype)])

    count = jax.tree_util.tree_leaves(obstacles)[0].shape[0]
    return _moved_away(jax.tree_util.tree_map(pad, obstacles), np.arange(count + extra) >= count)


class SceneBuilder:
    """Collects named objects and fruits into a `Scene`. All lengths in metres, the world's z up."""

    def __init__(self, name: str = "scene", point_radius: float = 0.0):
        self.name, self.point_radius = name, point_radius
        self.names: list[str] = []
        self.removable: list[bool] = []
        self.fruits: list[Fruit] = []
        self.rows: dict[str, list[Any]] = {k: [] for k in KINDS}
        self.owners: dict[str, list[int]] = {k: [] for k in KINDS}

    def add(self, name: str, removable: bool = True, **obstacles: Any) -> None:
        """An object of `points` (k, 3), `spheres` (k, 4) centre and radius, `capsules` (k, 7) both ends and radius, `boxes`
        (pairs of a (4, 4) frame and three edges), `cylinders` (triples of a (4, 4) frame, radius and length)."""
        self.names.append(name)
        self.removable.append(removable)
        for kind, rows in obstacles.items():
            if kind not in KINDS:
                raise ValueError(f"obstacle kind '{kind}'; allowed: {', '.join(KINDS)}")
            rows = list(rows)
            self.rows[kind] += rows
            self.owners[kind] += [len(self.names) - 1] * len(rows)

    def add_fruit(
        self, name: str, position: Any, axis: Any = (0.0, 0.0, 1.0), length: float = 0.0, radius: float = 0.0
    ) -> None:
        """A fruit; with a `radius` its body, hanging `length` below `position`, is an obstacle to all others."""
        up = np.asarray(axis, dtype=np.float64)
        up = up / np.linalg.norm(up)
        top = np.asarray(position, dtype=np.float64)
        self.fruits.append(Fruit(top, up, name))
        body = [[*top, *(top - length * up), radius]] if radius > 0.0 else []
        self.add(name, removable=False, capsules=body)

    def scene(self) -> Scene:
        def array(kind: str, width: int) -> np.ndarray:
            return np.array(self.rows[kind], dtype=np.float64).reshape(-1, width)

        def framed(kind: str, width: int) -> tuple[np.ndarray, np.ndarray]:
            frames = np.array([r[0] for r in self.rows[kind]], dtype=np.float64).reshape(-1, 4, 4)
            return frames, np.array([np.ravel(r[1:]) for r in self.rows[kind]], dtype=np.float64).reshape(-1, width)

        spheres, capsules = array("spheres", 4), array("capsules", 7)
        (boxes, edges), (cylinders, sizes) = framed("boxes", 3), framed("cylinders", 2)
        return Scene(
            Points(array("points", 3), np.asarray(self.point_radius, dtype=np.float64)),
            Spheres(spheres[:, :3], spheres[:, 3]),
            Capsules(capsules[:, :3], capsules[:, 3:6], capsules[:, 6]),
            Boxes(boxes, edges / 2.0),
            Cylinders(cylinders, sizes[:, 0], sizes[:, 1] / 2.0),
            tuple(self.fruits),
            name=self.name,
            object_names=tuple(self.names),
            removable=tuple(self.removable),
            owners=tuple(tuple(self.owners[k]) for k in KINDS),
        )


def make_scene(point_radius: float = 0.0, name: str = "scene", **obstacles: Any) -> Scene:
    """A scene from plain arrays, each obstacle an object of its own; the keywords are those of `SceneBuilder.add` [m]."""
    builder = SceneBuilder(name, point_radius)
    for kind, rows in obstacles.items():
        for i, row in enumerate(rows):
            builder.add(f"{kind}_{i + 1}", True, **{kind: [row]})
    return builder.scene()
