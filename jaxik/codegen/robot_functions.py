"""The functions of a robot that are exported by name: `FUNCTIONS`, and the arguments that they take: `ARGUMENTS`.

Another one is a line in each: what makes it of a robot and what is around it, the names of its arguments and of its results.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxik.codegen.functions import Function, function_of
from jaxik.collision.clearances import check_geometry, clearance
from jaxik.collision.scene import Scene
from jaxik.collision.sphere_clouds import clearance_to_spheres
from jaxik.dynamics import bias_torque, forward_dynamics, gravity_torque, inverse_dynamics, mass_matrix
from jaxik.ik.whole_search import check_searchable, ik_search
from jaxik.kinematics import Robot, forward_kinematics, jacobian, manipulability
from jaxik.kinematics.robot import need_bodies
from jaxik.spmd import kernel

SPHERES = 4096  # that a scene of run time has at most; memory is read as far as there are any
TOLD = 150  # of them in a sample

Made = Callable[..., Any]


class Argument(NamedTuple):
    """An argument: its shape for a robot, `words` with its unit, and a `sample` of it for tests, of a generator and a robot. A
    batch has one for all where it is `shared`."""

    shape: Callable[[Robot], tuple[int, ...]]
    words: str
    sample: Callable[[np.random.Generator, Robot], Any]
    shared: bool = False
    kind: Any = np.float64


class RobotFunction(NamedTuple):
    """A function of a robot: what makes it, its arguments and results by name, `words`, and what a robot must have for it."""

    make: Callable[[Robot, Scene | None], Made]
    arguments: Sequence[str]
    results: Mapping[str, str]
    words: str
    check: Callable[[Robot], Any] = lambda robot: None
    double: bool = False  # whether it is computed in float64 alone


def _joints(robot: Robot) -> tuple[int, ...]:
    return (robot.num_joints,)


def _within(rng: np.random.Generator, robot: Robot) -> np.ndarray:
    """A posture within the limits."""
    low, high = (np.clip(np.asarray(limit, float), -np.pi, np.pi) for limit in (robot.lower, robot.upper))
    return rng.uniform(low, high)


def _normal(scale: float) -> Callable[[np.random.Generator, Robot], np.ndarray]:
    return lambda rng, robot: rng.normal(scale=scale, size=robot.num_joints)


def _reached(rng: np.random.Generator, robot: Robot) -> np.ndarray:
    """The pose of a posture within the limits."""
    return np.asarray(forward_kinematics(robot, _within(rng, robot)))


def _around(rng: np.random.Generator, robot: Robot) -> np.ndarray:
    """Spheres of 2 to 6 cm around the base."""
    found = np.zeros((SPHERES, 4))
    found[:TOLD, :3] = rng.uniform(-1.0, 1.0, (TOLD, 3))
    found[:TOLD, 3] = rng.uniform(0.02, 0.06, TOLD)
    return found


ARGUMENTS: dict[str, Argument] = {
    "pose": Argument(lambda robot: (4, 4), "base_T_tip, homogeneous: rotation, translation [m], and 0 0 0 1", _reached),
    "posture": Argument(_joints, "joint positions around which it looks [rad, m]", _within),
    "q": Argument(_joints, "joint positions [rad, m]", _within),
    "qdot": Argument(_joints, "joint velocities [rad/s, m/s]", _normal(1.0)),
    "qddot": Argument(_joints, "joint accelerations [rad/s2, m/s2]", _normal(1.0)),
    "torque": Argument(_joints, "torques of the drives [Nm, N]", _normal(10.0)),
    "spheres": Argument(
        lambda robot: (SPHERES, 4), "centres and radii [m] in the world; as many rows as there are spheres", _around, True
    ),
    "spheres_count": Argument(
        lambda robot: (), f"how many spheres there are, 0 to {SPHERES}", lambda rng, robot: TOLD, True, np.int32
    ),
}
_POSE = {"pose": "base_T_tip, homogeneous: rotation, translation [m], and 0 0 0 1"}
_JACOBIAN = {"jacobian": "linear rows, then angular, in base axes at the tip's origin [m/rad, 1]"}
_TORQUE = {"torque": "torques of the drives [Nm, N]"}
_CLEARANCE = {"clearance": "the smallest signed distance [m]; below 0 there is contact"}
_ANSWER = {
    "q": "joint positions [rad, m]: the answer, the freest posture that collides, or the nearest miss; NaN with 1 and 5",
    "reason": "0: solved; 1: proven out of reach; 3: what was found collides; 4: nothing was found; 5: the pose is none",
    "position_error": "how far the tip is from the pose [m]",
    "rotation_error": "how far it is turned [rad]",
    "clearance": "the smallest signed distance [m], NaN where none is looked at",
    "seed": "the number of the seed that led to it, -1 where none did",
}
_bodies = lambda robot: need_bodies("export", robot)


def _searchable(robot: Robot) -> None:
    robot.only_tip("export")
    check_searchable("export", robot)


def _pose_and_jacobian(robot: Robot) -> Made:
    return lambda q: (forward_kinematics(robot, q), jacobian(robot, q))


def _ik(robot: Robot, scene: Scene | None) -> Made:
    find = ik_search(robot, scene=scene)
    return lambda pose: find(pose)


def _ik_near(robot: Robot, scene: Scene | None) -> Made:
    find = ik_search(robot, scene=scene, seeds="near", choice="first", reference=np.zeros(robot.num_joints))
    return lambda pose, posture: find(pose, posture)


FUNCTIONS: dict[str, RobotFunction] = {
    "pose": RobotFunction(lambda r, _: lambda q: forward_kinematics(r, q), ("q",), _POSE, "the tip's pose in the base"),
    "jacobian": RobotFunction(lambda r, _: lambda q: jacobian(r, q), ("q",), _JACOBIAN, "the tip's Jacobian"),
    "pose_and_jacobian": RobotFunction(
        lambda r, _: _pose_and_jacobian(r), ("q",), _POSE | _JACOBIAN, "both, for little more than one of them"
    ),
    "manipulability": RobotFunction(
        lambda r, _: lambda q: manipulability(r, q),
        ("q",),
        {"manipulability": "sqrt det (J J'); 0 where a direction of motion is lost"},
        "how freely the tip moves",
    ),
    "clearance": RobotFunction(
        lambda r, scene: lambda q: clearance(r, scene, q),
        ("q",),
        _CLEARANCE,
        "the distance of the robot to itself and to the scene, which is folded in",
        check_geometry,
    ),
    "clearance_to_spheres": RobotFunction(
        lambda r, _: lambda q, spheres, spheres_count: clearance_to_spheres(r, spheres, q, count=spheres_count),
        ("q", "spheres", "spheres_count"),
        _CLEARANCE,
        "the distance of the robot to itself and to spheres that are told in the call",
        check_geometry,
    ),
    "inverse_dynamics": RobotFunction(
        lambda r, _: lambda q, qdot, qddot: inverse_dynamics(r, q, qdot, qddot),
        ("q", "qdot", "qddot"),
        _TORQUE,
        "the torques that a motion takes",
        _bodies,
    ),
    "gravity_torque": RobotFunction(
        lambda r, _: lambda q: gravity_torque(r, q), ("q",), _TORQUE, "the torques that hold the robot still", _bodies
    ),
    "bias_torque": RobotFunction(
        lambda r, _: lambda q, qdot: bias_torque(r, q, qdot),
        ("q", "qdot"),
        _TORQUE,
        "the torques of gravity and of the velocities",
        _bodies,
    ),
    "mass_matrix": RobotFunction(
        lambda r, _: lambda q: mass_matrix(r, q), ("q",), {"mass": "kg m2, kg; symmetric"}, "the mass matrix", _bodies
    ),
    "forward_dynamics": RobotFunction(
        lambda r, _: lambda q, qdot, torque: forward_dynamics(r, q, qdot, torque),
        ("q", "qdot", "torque"),
        {"qddot": "joint accelerations [rad/s2, m/s2]"},
        "the accelerations that torques cause",
        _bodies,
    ),
    "ik": RobotFunction(
        _ik, ("pose",), _ANSWER, "a posture for a pose, clear of the scene, which is folded in", _searchable, double=True
    ),
    "ik_near": RobotFunction(
        _ik_near, ("pose", "posture"), _ANSWER, "the same, by looking around a posture", _searchable, double=True
    ),
}
"""The functions of a robot that are exported by name, each as a `RobotFunction`."""


class Sampled(NamedTuple):
    """A function in machine code, and rows of arguments and results by which it is tested."""

    function: Function
    arguments: list[np.ndarray]
    results: list[np.ndarray]


def robot_function(
    robot: Robot, name: str, *, prefix: str, scene: Scene | None, target: str, double: bool, rows: int
) -> Sampled:
    """The function of that name, called `PREFIX_NAME`, with so many `rows` of a sample, computed on this machine. Raises
    `ValueError` for another name, and for a robot that lacks what it needs. Host."""
    if name not in FUNCTIONS:
        raise ValueError(f"export: a function {name!r} is not known; choose of {', '.join(FUNCTIONS)}")
    wanted = FUNCTIONS[name]
    wanted.check(robot)
    if wanted.double and not double:
        raise ValueError(f"export: {name} is computed in float64 alone; give double=True (--double)")
    own = f"{prefix}_{name}"
    taken = [ARGUMENTS[each] for each in wanted.arguments]
    with jax.enable_x64(double):
        made = wanted.make(robot, scene)
    exported = function_of(
        made,
        [jax.ShapeDtypeStruct(each.shape(robot), each.kind) for each in taken],
        name=own,
        target_name=target,
        double=double,
        results=list(wanted.results),
        words={**{a: ARGUMENTS[a].words for a in wanted.arguments}, **wanted.results, own: wanted.words},
        shared=[a for a in wanted.arguments if ARGUMENTS[a].shared],
    )
    return Sampled(exported, *_sample(robot, made, taken, exported, rows, double))


def _sample(
    robot: Robot, made: Made, taken: Sequence[Argument], exported: Function, rows: int, double: bool
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Arguments of so many rows, those that are shared once, and what the same kernel makes of them here."""
    rng, width = np.random.default_rng(0), np.float64 if double else np.float32
    dtype = lambda each: width if each.kind == np.float64 else each.kind
    draw = lambda each: np.asarray(
        each.sample(rng, robot) if each.shared else [each.sample(rng, robot) for _ in range(rows)], dtype(each)
    )
    arguments = [draw(each) for each in taken]
    with jax.enable_x64(double):
        many = jax.jit(jax.vmap(kernel(made), tuple(None if each.shared else 0 for each in taken)))
        found = [np.asarray(x) for x in jax.tree_util.tree_leaves(many(*arguments))]
    return arguments, found
