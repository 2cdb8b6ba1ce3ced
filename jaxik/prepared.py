"""A function of models and configurations, ready for a loop: NumPy in, NumPy out, without JAX in the call."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from jaxik.checks.options import check_flag, shown
from jaxik.collision.bvh import forms_of, grouped_in
from jaxik.collision.held import apart, check_same, held_by, together
from jaxik.collision.scene import Scene
from jaxik.kinematics.robot import Robot
from jaxik.spmd.handle import Handle
from jaxik.spmd.packed import packed, unpacked


class Prepared(Handle):
    """A function that `prepare` has made ready. It is called without its models; results are new arrays, or those of `out`,
    which is like a result. Host.

    A call with `out` allocates nothing. With one more axis in front of each array it computes a batch. Threads may share it.
    """

    def __init__(self, function: Callable[..., Any], models: tuple[Any, ...], double: bool):
        scenes = [k for k, each in enumerate(models) if isinstance(each, Scene)]
        robots = [each for each in models if isinstance(each, Robot)]
        who = f"prepared {_name(function)}"
        if scenes and not robots:
            raise ValueError(f"{who}: a scene without a robot; write prepare(function, robot, scene)")
        self.models, self._scenes = models, scenes
        self._robot: Any = next(iter(robots), None)
        self._holders = [k for k, each in enumerate(models) if isinstance(each, Robot) and held_by(each)]
        fixed = tuple(None if k in scenes else apart(each)[0] if k in self._holders else each for k, each in enumerate(models))
        places = tuple(scenes), tuple(self._holders)
        super().__init__(who, functools.partial(_with_models, function, fixed, *places), double)
        around = [grouped_in(models[k], robots[0]) for k in scenes]  # and in the forms by which `update` asks for others
        self._around = [grouped_in(models[k], robots[0], forms_of(each)) for k, each in zip(scenes, around, strict=True)]

    def __reduce__(self) -> Any:
        return _again, (self.function.args[0], self.models, self.double)  # type: ignore[attr-defined]

    def __repr__(self) -> str:
        return f"Prepared({_name(self.function.args[0])}: {', '.join(map(shown, self.models))})"  # type: ignore[attr-defined]

    def update(self, *models: Any) -> None:
        """Puts other scenes in the place of the present ones, from the next call on, without compiling: of kinds of obstacles
        that these have, and no more of them than they have room for; and in the place of robots with room
        (`collision.with_room`) the same that hold something else, if any are told. Raises `ValueError` for others."""
        scenes = tuple(each for each in models if not isinstance(each, Robot))
        if len(scenes) != len(self._scenes) or not all(isinstance(each, Scene) for each in scenes):
            told, wanted = ", ".join(map(shown, models)) or "nothing", len(self._scenes)
            raise ValueError(f"{self.who}: update by {told}; it was prepared with {wanted} scene{'s' * (wanted != 1)}")
        robots = self._robots_of([each for each in models if isinstance(each, Robot)])
        with self._making:
            around = [grouped_in(scene, self._robot, forms_of(now)) for scene, now in zip(scenes, self._around, strict=True)]
            changed = robots | dict(zip(self._scenes, scenes, strict=True))
            self.models = tuple(changed.get(k, each) for k, each in enumerate(self.models))
            self._around = around
            self.put(*self._packed())

    def _robots_of(self, robots: list[Robot]) -> dict[int, Robot]:
        """Robots by their place among the models. Raises `ValueError` for those that are not there."""
        if robots and len(robots) != len(self._holders):
            raise ValueError(
                f"{self.who}: update by {len(robots)} robots; {len(self._holders)} of its own have room (with_room)"
            )
        found = dict(zip(self._holders, robots, strict=False))
        for k, robot in found.items():
            check_same(f"{self.who}: update by", robot, self.models[k], "prepare it anew")
        return found

    def begin(self, *example: Any, shared: tuple[Any, ...] = ()) -> None:
        super().begin(*example, shared=shared or self._packed())

    def _packed(self) -> tuple[Any, ...]:
        shared = [*self._around, *(apart(self.models[k])[1] for k in self._holders)]
        return tuple(packed(each, np.float64 if self.double else np.float32) for each in shared)


def prepare(
    function: Callable[..., Any], *models: Any, example: tuple[Any, ...] | None = None, double: bool = True
) -> Prepared:
    """Returns a traced function of one configuration, ready to be called again and again from Python. Host.

        torque = jaxik.prepare(jaxik.dynamics.inverse_dynamics, robot)
        torque(q, qdot, qddot)  # (n,): NumPy in, NumPy out, a few microseconds

        near = jaxik.prepare(jaxik.clearance, robot, scene)
        near(q)
        near.update(scene)  # another world, without compiling

    `models` are the function's first arguments, which stay: robots, scenes, tasks. Numbers of a robot fold into the program; a
    scene becomes a table, in the form that jaxik's functions take instead of a `Scene`. All other arguments, and the result,
    are arrays or trees of arrays, whose shapes are those of the `example`, or of the first call, which compiles. It computes in
    float64, or in float32 if `double` is False, whatever JAX is set to; by XLA where there is no kernel.

    Raises `ValueError` for what is no function, a scene without a robot, and arguments that the function refuses.
    """
    if not callable(function):
        raise ValueError(f"prepare: {shown(function)} is no function; write e.g. prepare(jaxik.forward_kinematics, robot)")
    check_flag("prepare", double=double)
    if any(isinstance(x, jax.core.Tracer) for x in jax.tree_util.tree_leaves(models)):
        raise ValueError("prepare: a traced model; prepare outside of jit, vmap and grad")
    made = Prepared(function, models, double)
    if example is not None:
        made.begin(*example)
    return made


def _with_models(
    function: Callable[..., Any], models: tuple[Any, ...], scenes: tuple[int, ...], holders: tuple[int, ...], *args: Any
) -> Any:
    """The function of `models`, but for the `scenes` among them, and for what the robots hold that have room, the `holders`:
    these come packed behind the other arguments."""
    given = args[: len(args) - len(scenes) - len(holders)]
    shared = {k: unpacked(each) for k, each in zip((*scenes, *holders), args[len(given) :], strict=True)}
    shared |= {k: together(models[k], shared[k]) for k in holders}
    return function(*(shared.get(k, each) for k, each in enumerate(models)), *given)


def _again(function: Callable[..., Any], models: tuple[Any, ...], double: bool) -> Prepared:
    return prepare(function, *models, double=double)


def _name(function: Any) -> str:
    while isinstance(function, functools.partial):
        function = function.func
    return getattr(function, "__name__", type(function).__name__)
