"""What stands in a robot's way at one configuration, by name: on the host, for people.

`clearance` is one number; here are the pairs behind it. The point of a volume's skeleton that is nearest comes from the
distance's own gradient: a step f along the shortest way raises the distance by |f|, and corner c of the skeleton carries the
share `f_c . f` of it, which is the point's weight.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.chain import Array, Chain, as_configuration
from jaxik.choice import as_count, check_finite, check_kind
from jaxik.collision import check_geometry, columns_of, obstacles_of, skeleton_gap
from jaxik.given import numbers
from jaxik.scene import FAR, KINDS, Scene, check_scene
from jaxik.spheres import skeletons


@dataclasses.dataclass(frozen=True)
class Contact:
    """A link of the robot and what it is near to, an object of the scene or an earlier link: the signed distance [m] (negative
    is depth), and where on each of them they are nearest (3,) [m, world]."""

    link: str
    other: str
    distance: float
    point: np.ndarray
    other_point: np.ndarray

    def __str__(self) -> str:
        what = "collide by" if self.distance < 0.0 else "are apart by"
        at = ", ".join(f"{x:.3f}" for x in self.point)
        return f"{self.link} and {self.other} {what} {1000.0 * abs(self.distance):.1f} mm at ({at})"


@dataclasses.dataclass(frozen=True)
class Limit:
    """A joint and how far it is inside its nearer limit [rad, m]; negative is beyond."""

    joint: str
    margin: float
    unit: str

    def __str__(self) -> str:
        where = "inside its limits" if self.margin >= 0.0 else "beyond its limits"
        return f"{self.joint} is {abs(self.margin):.3f} {self.unit} {where}"


@dataclasses.dataclass(frozen=True)
class Surroundings:
    """The nearest pairs and the nearest limits, nearest first."""

    contacts: tuple[Contact, ...]
    limits: tuple[Limit, ...]

    @property
    def colliding(self) -> tuple[Contact, ...]:
        """The pairs that collide."""
        return tuple(c for c in self.contacts if c.distance < 0.0)

    def __str__(self) -> str:
        return "\n".join(map(str, (*self.contacts, *self.limits)))


def explain(chain: Chain, scene: Scene | None, q: Float[Array, " n"], count: int = 5, below: float = np.inf) -> Surroundings:
    """What is nearest to the robot at `q` (n,) [rad, m]: the `count` nearest pairs of a link with an object of the scene or
    with another link, those nearer than `below` [m], and the `count` joints nearest to a limit.

    Each pair of names stands once, at its least distance; the first pair's is `clearance`. A host function, in float64.
    Raises `ValueError` for a chain without collision geometry or a q of another shape.
    """
    check_kind("explain", "scene", scene, Scene, optional=True)
    if scene is not None:
        check_scene(scene)
    count = as_count("explain: count", count)
    if below != np.inf:
        check_finite("explain", below=below)
    posture = np.asarray(as_configuration(chain, numbers("explain: q", q)), np.float64)
    check_geometry(chain)
    volumes = skeletons(chain, posture.tolist(), np.float64)
    with jax.enable_x64(True):
        pairs = [*_with_scene(scene, volumes), *_with_itself(chain, volumes)]
        found = [row for apart, *row in _nearest(pairs)[:count] if apart < below]
        contacts = tuple(_contact(chain, scene, pairs, *row) for row in found)
    return Surroundings(contacts, _limits(chain, posture)[:count])


@dataclasses.dataclass(frozen=True)
class _Pairs:
    """Volumes of one kind against obstacles or volumes of one kind: distances (others, volumes), and who they belong to."""

    gap: Any
    volumes: Any
    others: Any
    links: np.ndarray
    owners: np.ndarray
    itself: bool
    distances: np.ndarray


def _with_scene(scene: Scene | None, volumes: Any) -> Iterator[_Pairs]:
    if scene is None:
        return
    for kind, owners in zip(KINDS, scene.owners, strict=True):
        if scene.counts[kind]:
            others, gap = obstacles_of(kind, scene, jnp.float64)
            owner = np.array([*owners, *[-1] * (scene.counts[kind] - len(owners))], int)
            for skeleton in volumes.values():
                ours = columns_of(skeleton, jnp.float64)
                apart = np.asarray(_apart(gap, ours, others))
                yield _Pairs(gap, ours, others, skeleton.link, owner, False, np.where(apart > FAR / 2.0, np.inf, apart))


def _with_itself(chain: Chain, volumes: Any) -> Iterator[_Pairs]:
    """Of each pair of links the later one is the link, the earlier the other."""
    meet = np.zeros((len(chain.link_names),) * 2, bool)
    for a, b in chain.self_pairs:
        meet[a, b] = True
    for mine in volumes.values():
        for theirs in volumes.values():
            wanted = meet[theirs.link[:, None], mine.link]
            if wanted.any():
                ours, others = columns_of(mine, jnp.float64), columns_of(theirs, jnp.float64)
                apart = np.asarray(_apart(skeleton_gap, ours, others))
                yield _Pairs(skeleton_gap, ours, others, mine.link, theirs.link, True, np.where(wanted, apart, np.inf))


@partial(jax.jit, static_argnums=0)
def _apart(gap: Any, volumes: Any, others: Any) -> Any:
    """The distances (others, volumes)."""
    return jax.vmap(lambda other: gap(volumes, other))(others)


@partial(jax.jit, static_argnums=0)
def _pull(gap: Any, corners: Any, radius: Any, other: Any) -> Any:
    """One distance (1,), and its derivative by each corner."""
    value, pull = jax.vjp(lambda corners: gap((corners, radius), other), corners)
    return value, pull(jnp.ones(1))[0]


def _nearest(pairs: list[_Pairs]) -> list[tuple[float, int, int, int]]:
    """Each two names' least distance, the least first, and which of `pairs`, other and volume it belongs to."""
    best: dict[tuple[bool, int, int], tuple[float, int, int, int]] = {}
    for number, each in enumerate(pairs):
        names = np.stack(np.broadcast_arrays(each.owners[:, None], each.links), axis=-1).reshape(-1, 2)
        order = np.argsort(each.distances, axis=None, kind="stable")
        _, first = np.unique(names[order], axis=0, return_index=True)
        for row in order[first]:
            other, volume = np.unravel_index(row, each.distances.shape)
            entry = float(each.distances[other, volume]), number, int(other), int(volume)
            key = each.itself, int(names[row][0]), int(names[row][1])
            best[key] = min(best.get(key, entry), entry)
    return [row for row in sorted(best.values()) if np.isfinite(row[0])]


def _contact(chain: Chain, scene: Scene | None, pairs: list[_Pairs], number: int, other: int, volume: int) -> Contact:
    each = pairs[number]
    one = jax.tree_util.tree_map(lambda x: x[volume : volume + 1], each.volumes)
    obstacle = jax.tree_util.tree_map(lambda x: x[other], each.others)
    value, slopes = _pull(each.gap, *one, obstacle)
    corners, slopes = (np.array([[float(x[0]) for x in corner] for corner in part]) for part in (one[0], slopes))
    force = slopes.sum(axis=0)
    nearest = (slopes @ force) @ corners if force.any() else corners.mean(axis=0)
    radius, gap = float(one[1][0]), float(value[0])
    owner = each.owners[other]
    name = chain.link_names[owner] if each.itself else scene.object_names[owner] if scene and owner >= 0 else "the scene"
    link = chain.link_names[each.links[volume]]
    return Contact(link, name, gap, nearest - radius * force, nearest - (radius + gap) * force)


def _limits(chain: Chain, q: np.ndarray) -> tuple[Limit, ...]:
    margins = np.minimum(q - chain.lower, chain.upper - q)
    units = ["m" if prismatic else "rad" for prismatic in chain.is_prismatic]
    order = [i for i in np.argsort(margins, kind="stable") if np.isfinite(margins[i])]
    return tuple(Limit(chain.joint_names[i], float(margins[i]), units[i]) for i in order)
