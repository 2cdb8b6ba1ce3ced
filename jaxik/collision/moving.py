"""Objects of a scene that move on a known course, and by how much they may be off it."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array, is_known, is_rigid, numbers, rigid_frame
from jaxik.checks.options import check_kind, no_such, shown
from jaxik.collision.bvh import balls_of_object
from jaxik.collision.obstacle_kinds import KINDS
from jaxik.collision.scene import Scene
from jaxik.pytree import Constant
from jaxik.spatial.rotations import from_wxyz, rotation_exp, to_wxyz


class Track(Constant):
    """The course of an object: at `times` (m,) [s] it stands at `poses` (m, 4, 4) [m] of the world. Between them its place goes
    straight and its turn by `turns` (m - 1, 3), rotation vectors in its own axes [rad], both evenly. Before the first and after
    the last of them it goes on with a `velocity` [m/s] and a `turning` [rad/s], in the world's axes, which may be 0.

    It may be as far off that as `bound + growth max(0, t - since)` [m]: each of its points.
    """

    times: Float[Array, " m"]
    poses: Float[Array, "m 4 4"]
    turns: Float[Array, "m-1 3"]
    velocity: Float[Array, "3"]
    turning: Float[Array, "3"]
    bound: Float[Array, ""]
    growth: Float[Array, ""]
    since: Float[Array, ""]

    @classmethod
    def through(cls, times: Any, poses: Any, *, bound: Any = 0.0, growth: Any = 0.0, since: Any = None) -> Track:
        """The course through `poses` (m, 4, 4) at `times` (m,) [s], before and after which it stands. Host.

            Track.through([0.0, 2.0], [jaxik.pose([0.5, -0.6, 0.3]), jaxik.pose([0.5, 0.6, 0.3])], bound=0.01)

        It may be off by `bound` [m], and by `growth` [m/s] more from `since` [s] on, which is the first of the times if it is
        not told. Raises `ValueError` for times that do not increase, poses that are no rigid frames, as many as the times, and
        bounds that are negative or not finite.
        """
        times, poses = numbers("Track: times", times, ("m",), finite=True), numbers("Track: poses", poses, ("m", 4, 4))
        if not len(times) or (np.diff(times) <= 0.0).any():
            row = int(np.argmax(np.diff(times) <= 0.0)) if len(times) else 0
            told = f"{shown(times[row])} and {shown(times[row + 1])} follow each other" if len(times) else "there are none"
            raise ValueError(f"Track: times: {told}; give increasing seconds")
        if len(poses) != len(times):
            raise ValueError(f"Track: {len(poses)} poses at {len(times)} times; give as many")
        if not (rigid := is_rigid(poses).reshape(-1)).all():
            row = int(np.argmin(rigid))
            raise ValueError(
                f"Track: pose {row + 1} is no rigid frame; allowed: finite, a right-handed rotation, 0 0 0 1 below"
            )
        still = np.zeros(3)
        return cls(times, poses, _turns(poses), still, still, *_errors(bound, growth, times[0] if since is None else since))

    @classmethod
    def steady(
        cls,
        pose: Any = None,
        *,
        velocity: Any = (0.0, 0.0, 0.0),
        turning: Any = (0.0, 0.0, 0.0),
        bound: Any = 0.0,
        growth: Any = 0.0,
        since: Any = 0.0,
    ) -> Track:
        """The course that is at a `pose` (4, 4) [m] at `since` [s], or at the origin, and goes on with a `velocity` (3,) [m/s],
        `turning` (3,) [rad/s] about the world's axes through its own origin. Host.

            Track.steady(jaxik.pose([0.9, 0.2, 0.4]), velocity=[-0.3, 0.0, 0.0], bound=0.01, growth=0.05, since=12.5)

        It may be off by `bound` [m], and by `growth` [m/s] more from then on. Raises `ValueError` for a pose that is no rigid
        frame, velocities that are not finite, and bounds that are negative or not finite.
        """
        pose = rigid_frame("Track: pose", np.eye(4) if pose is None else pose)
        rates = {"velocity": velocity, "turning": turning}
        rates = {name: numbers(f"Track: {name}", x, (3,), finite=True) for name, x in rates.items()}
        errors = _errors(bound, growth, since)
        return cls(
            np.reshape(errors[2], 1),
            np.asarray(pose)[None],
            np.zeros((0, 3)),
            **rates,
            **dict(zip(ERRORS, errors, strict=True)),
        )

    def at(self, t: Any) -> Any:
        """The pose (4, 4) at t () [s]; of known times (...) the poses (..., 4, 4) in NumPy. Traced."""
        known = is_known((self, t))
        xp = np if known else jnp
        t, times, poses = xp.asarray(t), xp.asarray(self.times), xp.asarray(self.poses)
        within = xp.clip(t, times[0], times[-1])
        beyond = t - within
        exp = _rotations if known else rotation_exp
        if len(self.times) == 1:
            place, rotation = poses[0, :3, 3], xp.broadcast_to(poses[0, :3, :3], (*t.shape, 3, 3))
        else:
            i = xp.clip(xp.searchsorted(times, within, side="right") - 1, 0, len(self.times) - 2)
            part = ((within - times[i]) / (times[i + 1] - times[i]))[..., None]
            place = poses[i, :3, 3] + part * (poses[i + 1, :3, 3] - poses[i, :3, 3])
            rotation = poses[i, :3, :3]
            rotation = rotation @ exp(part * xp.asarray(self.turns)[i]) if self._turns else rotation
        place = place + beyond[..., None] * xp.asarray(self.velocity)
        rotation = exp(beyond[..., None] * xp.asarray(self.turning)) @ rotation if self._turns else rotation
        rows = xp.concatenate([rotation, place[..., None]], axis=-1)
        last = xp.broadcast_to(xp.asarray([0.0, 0.0, 0.0, 1.0], rows.dtype), (*rows.shape[:-2], 1, 4))
        return xp.concatenate([rows, last], axis=-2)

    def error(self, t: Any) -> Any:
        """How far each of its points may be off at t (...) [m]. Traced."""
        xp = np if is_known((self, t)) else jnp
        return self.bound + self.growth * xp.maximum(0.0, xp.asarray(t) - self.since)

    def travelled(self, t: Any, radius: float) -> np.ndarray:
        """A function of t (...) [s] that grows by no less than a point within a `radius` [m] of its origin moves. Host."""
        t, (ways, angles, speed, turning) = np.asarray(t, float), self._travels
        far = np.interp(t, self.times, ways + radius * angles)
        return np.asarray(far + (speed + radius * turning) * (t - np.minimum(np.maximum(t, self.times[0]), self.times[-1])))

    @functools.cached_property
    def _travels(self) -> tuple[np.ndarray, np.ndarray, float, float]:
        """The way of its origin and the angle (m,) at the times, and how fast both go on before and after."""
        ways = np.linalg.norm(np.diff(self.poses[:, :3, 3], axis=0), axis=-1), np.linalg.norm(self.turns, axis=-1)
        way, angle = (np.concatenate([[0.0], np.cumsum(x)]) for x in ways)
        return way, angle, float(np.linalg.norm(self.velocity)), float(np.linalg.norm(self.turning))

    @functools.cached_property
    def _turns(self) -> bool:
        """Whether it turns, as far as that is known."""
        return not is_known((self.turns, self.turning)) or bool(np.any(self.turns) or np.any(self.turning))

    @property
    def settled(self) -> float:
        """The time from which on nothing of it changes [s]; infinite where that never is. Host."""
        changes = np.any(self.velocity) or np.any(self.turning) or self.growth > 0.0
        return float("inf") if changes else float(self.times[-1])

    def __str__(self) -> str:
        course = f"{len(self.times)} poses from {self.times[0]:g} to {self.times[-1]:g} s"
        if len(self.times) == 1:
            course = f"{np.linalg.norm(self.velocity):.3g} m/s and {np.linalg.norm(self.turning):.3g} rad/s"
        return f"{course}, within {float(self.bound):g} m" + f" + {float(self.growth):g} m/s" * bool(self.growth > 0.0)


class MovingScene(Constant):
    """A scene, some objects of which have `tracks` by their names; the others stand. Such an object is built about the origin,
    as for `Scene.moved`.

        moving = jaxik.MovingScene(scene.with_("ball", spheres=[[0, 0, 0, 0.1]]), {"ball": Track.steady(pose, velocity=v)})

    Raises `ValueError` for what is no scene, no track, and for objects that are not there.
    """

    scene: Any  # a `Scene`; what it is given is checked in one line
    tracks: Any  # dict[str, Track]

    def __post_init__(self) -> None:
        check_kind("MovingScene", "scene", self.scene, Scene)
        check_kind("MovingScene", "tracks", self.tracks, dict)
        for name, track in self.tracks.items():
            if name not in self.scene.object_names:
                raise ValueError(no_such(f"scene '{self.scene.name}'", "object", name, self.scene.object_names))
            check_kind("MovingScene", f"track of '{shown(name)}'", track, Track)
        vars(self)["tracks"] = {name: self.tracks[name] for name in sorted(self.tracks)}  # in the order of a pytree's leaves

    @property
    def names(self) -> tuple[str, ...]:
        """The names of what moves."""
        return tuple(self.tracks)

    def at(self, t: Any) -> Scene:
        """The scene as it is predicted for t () [s], without errors. Traced."""
        return self.scene.moved(list(self.tracks), self.poses(t)) if self.tracks else self.scene

    def poses(self, t: Any) -> Any:
        """Where what moves is at t () [s] (o, 4, 4); at known times (...) (..., o, 4, 4) in NumPy. Traced."""
        return _stacked([track.at(t) for track in self.tracks.values()], t, 4, 4)

    def errors(self, t: Any) -> Any:
        """How far off each may be at t (...) [m] (..., o). Traced."""
        return _stacked([track.error(t) for track in self.tracks.values()], t)

    def travelled(self, t: Any) -> np.ndarray:
        """`Track.travelled` of each object's furthest point at t (...) (..., o) [m]. Host."""
        each = zip(self.tracks.values(), self.radii, strict=True)
        return np.asarray(_stacked([track.travelled(t, radius) for track, radius in each], t))

    @property
    def settled(self) -> float:
        """The time from which on nothing of the scene changes [s]; infinite where that never is. Host."""
        return max((track.settled for track in self.tracks.values()), default=-float("inf"))

    @functools.cached_property
    def standing(self) -> Scene:
        """The scene without what moves."""
        return self.scene.without(list(self.tracks)) if self.tracks else self.scene

    @functools.cached_property
    def alone(self) -> tuple[Scene, ...]:
        """Each moving object alone, about the origin."""
        return tuple(_alone(self.scene, self.scene.owner(name)) for name in self.tracks)

    @functools.cached_property
    def radii(self) -> tuple[float, ...]:
        """How far any point of each moving object is from its origin [m]. Host."""
        return tuple(_radius(scene, scene.owner(name)) for scene, name in zip(self.alone, self.tracks, strict=True))

    def __str__(self) -> str:
        """One line: the scene, and each course."""
        return f"{self.scene}; moving: {'; '.join(f'{name}, {track}' for name, track in self.tracks.items()) or 'nothing'}"


def _stacked(each: list[Any], t: Any, *shape: int) -> Any:
    """Arrays (..., *shape) of each object at times t (...) as one (..., o, *shape)."""
    if not each:
        return np.zeros((*np.shape(t), 0, *shape))
    return (np if is_known(each) else jnp).stack(each, axis=-1 - len(shape))


ERRORS = ("bound", "growth", "since")


def _errors(*given: Any) -> list[np.ndarray]:
    found = [numbers(f"Track: {name}", x, (), finite=True) for name, x in zip(ERRORS, given, strict=True)]
    for name, x in zip(ERRORS[:2], found, strict=False):
        if x < 0.0:
            raise ValueError(f"Track: {name} is {x:g}; write 0 or more")
    return found


def _turns(poses: np.ndarray) -> np.ndarray:
    """The rotation vectors (m - 1, 3) from each pose (m, 4, 4) to the next, in its own axes."""
    rotations = poses[:, :3, :3]
    wxyz = to_wxyz(np.swapaxes(rotations[:-1], -1, -2) @ rotations[1:])
    sine = np.linalg.norm(wxyz[:, 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, wxyz[:, :1])
    return np.asarray(wxyz[:, 1:] * np.divide(angle, sine, out=np.full_like(sine, 2.0), where=sine > 1e-12))


def _rotations(vectors: np.ndarray) -> np.ndarray:
    """The rotations (..., 3, 3) of rotation vectors (..., 3) in NumPy."""
    half = 0.5 * np.linalg.norm(vectors, axis=-1, keepdims=True)
    return from_wxyz(np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * vectors], axis=-1))


def _alone(scene: Scene, number: int) -> Scene:
    """The scene that holds one object, of as many names, and no room for others."""
    rows, kinds, owners = dict(scene.rows_of(number)), {}, []
    for kind in KINDS:
        some = rows.get(kind, np.zeros(0, int))
        kinds[kind] = jax.tree_util.tree_map(lambda x, some=some: x[some] if np.ndim(x) else x, getattr(scene, kind))
        owners.append((number,) * len(some))
    clouds = tuple(cloud for cloud in scene.clouds if cloud.name == scene.object_names[number])
    return dataclasses.replace(scene, clouds=clouds, marks=(), owners=tuple(owners), room=(), **kinds)


def _radius(scene: Scene, number: int) -> float:
    """How far any point of an object of a known scene is from the origin [m]."""
    balls = balls_of_object(scene, number)
    balls += [(np.asarray(cloud.center), np.asarray(cloud.radius)) for cloud in scene.clouds]
    reach = [np.linalg.norm(center, axis=-1) + radius for center, radius in balls]
    return max((float(x[x < 1e5].max(initial=0.0)) for x in reach), default=0.0)
