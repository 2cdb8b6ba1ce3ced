"""Planners of others on jaxik's problems, each as its own scripts set it, and the time that a call of jaxik is in kernels.

`Vamp` is C++ made for each robot [Thomason, Kingston, Kavraki 2024]: RRT-Connect with its range for this robot and Halton
samples from their beginning, then its simplification, as its evaluate_mbm.py has them; or AORRTC for some time. It counts its
own time, from when the scene is packed for its vectors. `Ompl` is RRT-Connect and its simplification as they come, samples of
an edge as far apart as VAMP's, each asked of coal from Python.
"""

from __future__ import annotations

import contextlib
import dataclasses
import importlib.util
import time
from collections import defaultdict
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from peers.collision_peers import Coal
from race import clocked
from scipy.spatial.transform import Rotation

import jaxik
from jaxik.planning import collision_checker, shortcuts, tree_search
from jaxik.spmd import HostKernel

HAVE = {name: importlib.util.find_spec(name) is not None for name in ("vamp", "ompl")}  # both are optional
BOXED = "box_"  # problems whose cylinders VAMP takes for boxes, since capsules would leave no room to grasp them
TOO_LONG = 1.1  # times its time that a search with time may take: its iterations are counted, not its time
TRIES = 12  # of numbers of iterations
APART = 1.0 / 32.0  # [rad] between samples of an edge, VAMP's resolution of a Panda


class Planned(NamedTuple):
    """A way (k, n), the one before it was simplified, the microseconds of both, and the search's iterations and nodes."""

    way: np.ndarray
    first: np.ndarray
    search_us: float
    simplify_us: float
    iterations: int
    nodes: int


class Vamp:
    """VAMP's code for a robot that it knows, by the robot's name."""

    def __init__(self, robot: jaxik.Robot):
        import vamp

        self.vamp, self.robot = vamp, getattr(vamp, robot.name)
        if tuple(self.robot.joint_names()) != robot.joint_names:
            raise ValueError(f"vamp.{robot.name} moves {', '.join(self.robot.joint_names())}")
        self.connect, self.shorten = vamp.configure_robot_and_planner_with_kwargs(robot.name, "rrtc")[2:]
        self.sampler = self.robot.halton()

    def environment(self, scene: jaxik.Scene, name: str) -> Any:
        """The scene of a problem as VAMP's `problem_dict_to_vamp` makes it: its cylinders are capsules, which are longer."""
        found = self.vamp.Environment()
        for center, radius in zip(np.reshape(scene.spheres.center, (-1, 3)), scene.spheres.radius, strict=True):
            found.add_sphere(self.vamp.Sphere(center.tolist(), float(radius)))
        for frame, half in zip(scene.boxes.world_T_box, scene.boxes.half, strict=True):
            found.add_cuboid(self.vamp.Cuboid(*_placed(frame), np.asarray(half, float).tolist()))
        for frame, radius, half in zip(
            *(getattr(scene.cylinders, k) for k in ("world_T_cylinder", "radius", "half")), strict=True
        ):
            r, h = float(radius), float(half)
            if name.startswith(BOXED):
                found.add_cuboid(self.vamp.Cuboid(*_placed(frame), [r, r, h]))
            else:
                found.add_capsule(self.vamp.Cylinder(*_placed(frame), r, 2.0 * h))
        return found

    def free(self, q: np.ndarray, environment: Any) -> bool:
        return bool(self.robot.validate(np.asarray(q, np.float32), environment))

    def unlike(self, robot: jaxik.Robot, coal: Coal, count: int = 100) -> float:
        """The most by which its spheres differ from those that coal judges, in place or radius, at random postures [m]."""
        most, geometry, data = 0.0, coal.robot, coal.robot.createData()
        postures = np.random.default_rng(0).uniform(*robot.finite_limits, (count, robot.num_joints))
        for q, whole in zip(postures, coal.whole(postures), strict=True):
            pin.updateGeometryPlacements(coal.model, coal.data, geometry, data, whole)
            balls = zip(data.oMg, geometry.geometryObjects, strict=True)
            judged = np.array([[*place.translation, ball.geometry.radius] for place, ball in balls])
            own = np.array([[s.x, s.y, s.z, s.r] for s in self.robot.fk(*_floats(q))])
            apart = np.abs(own[:, None] - judged).max(axis=-1)
            most = max(most, float(apart.min(axis=1).max()), float(apart.min(axis=0).max()))
        return most

    def planned(self, start: np.ndarray, goal: np.ndarray, environment: Any) -> Planned | None:
        """A way, simplified."""
        self.sampler.reset()
        found = self.robot.rrtc(*_floats(start, goal), environment, self.connect, self.sampler)
        if not found.solved:
            return None
        short = self.robot.simplify(found.path, environment, self.shorten, self.sampler)
        us = 1e-3 * found.nanoseconds, 1e-3 * short.nanoseconds
        return Planned(_way(short.path), _way(found.path), *us, int(found.iterations), int(sum(found.size)))

    def improved(self, start: np.ndarray, goal: np.ndarray, around: Any, seconds: float) -> tuple[np.ndarray, float] | None:
        """The way of AORRTC after so many seconds, and how long it took. It counts iterations, not time: as many as take so
        long, or at most `TOO_LONG` times it, are found by trying."""
        settings, best = self.vamp.AORRTCSettings(), None  # whose room for nodes is less, and sooner made
        settings.rrtc.range = self.connect.range
        count, least, most = 4000.0, 0.0, np.inf
        for _ in range(TRIES):
            settings.max_iterations = settings.max_internal_iterations = int(count)
            self.sampler.reset()
            found = self.robot.aorrtc(*_floats(start, goal), around, settings, self.sampler)
            took = 1e-9 * found.nanoseconds
            if found.solved and took <= TOO_LONG * seconds and (best is None or took > best[1]):
                best = _way(found.path), took
            if seconds <= took <= TOO_LONG * seconds or found.iterations < int(count):  # a straight line needs no more
                break
            least, most = (count, most) if took < seconds else (least, count)
            guess = 1.05 * seconds / took * count
            between = 0.5 * (least + most) if np.isfinite(most) else 4.0 * count
            count = guess if least < guess < min(most, between) else between
        return best


class Ompl:
    """OMPL's RRT-Connect and simplification for one robot; coal says what is free."""

    def __init__(self, robot: jaxik.Robot, coal: Coal):
        from ompl import base, geometric, util

        util.setLogLevel(util.LOG_ERROR)
        self.base, self.geometric, self.coal, self.n = base, geometric, coal, robot.num_joints
        bounds = base.RealVectorBounds(self.n)
        for i, (low, high) in enumerate(zip(*robot.finite_limits, strict=True)):
            bounds.setLow(i, float(low))
            bounds.setHigh(i, float(high))
        self.space = base.RealVectorStateSpace(self.n)
        self.space.setBounds(bounds)

    def planned(self, start: np.ndarray, goal: np.ndarray, scene: jaxik.Scene, seconds: float) -> Planned | None:
        """A way, simplified, if one is found in so many seconds."""
        setup, asked = self.geometric.SimpleSetup(self.space), 0

        def free(state: Any) -> bool:
            nonlocal asked
            asked += 1
            return not self.coal.collides(scene, np.array([state[0 : self.n]]))[0]

        setup.setStateValidityChecker(free)
        info = setup.getSpaceInformation()
        info.setStateValidityCheckingResolution(APART / self.space.getMaximumExtent())
        setup.setPlanner(self.geometric.RRTConnect(info))
        setup.setStartAndGoalStates(self._state(start), self._state(goal))
        _, search = clocked(lambda: setup.solve(seconds))
        if not setup.haveExactSolutionPath():
            return None
        first, searched = self._way(setup.getSolutionPath()), asked
        _, simplify = clocked(setup.simplifySolution)
        return Planned(self._way(setup.getSolutionPath()), first, 1e6 * search, 1e6 * simplify, searched, 0)

    def _state(self, q: np.ndarray) -> Any:
        state = self.space.allocState()
        state[0 : self.n] = [float(x) for x in q]
        return state

    def _way(self, path: Any) -> np.ndarray:
        return np.array([state[0 : self.n] for state in path.getStates()])


class KernelClock:
    """The time that calls spend in kernels, without Python, by what these are for [s]."""

    def __init__(self, robot: jaxik.Robot):
        bare = collision_checker.CollisionChecker(robot, None, 0.0).robot
        known = {
            "search": tree_search.searched,
            "shortcuts": shortcuts.shortest,
            "samples": collision_checker._hits,
            "proof": collision_checker._moves,
        }
        self.names = {id(kernels(bare, False)): name for name, kernels in known.items()}

    @contextlib.contextmanager
    def running(self) -> Iterator[dict[str, float]]:
        """The seconds of each kind of kernel while this runs; of one thread."""
        spent: dict[str, float] = defaultdict(float)
        prepared = HostKernel._prepared

        def clocking(kernel: HostKernel, *args: Any) -> Any:
            made, *rest = prepared(kernel, *args)
            name = self.names.get(id(kernel), "timing")

            def work(address: int) -> None:
                begin = time.perf_counter()
                made.work(address)
                spent[name] += time.perf_counter() - begin

            return dataclasses.replace(made, work=work), *rest

        HostKernel._prepared = clocking  # type: ignore[method-assign]
        try:
            yield spent
        finally:
            HostKernel._prepared = prepared  # type: ignore[method-assign]


def _placed(frame: Any) -> tuple[list[float], list[float]]:
    """A place, and turns about the fixed x, y and z."""
    frame = np.asarray(frame, float)
    return frame[:3, 3].tolist(), Rotation.from_matrix(frame[:3, :3]).as_euler("xyz").tolist()


def _floats(*rows: np.ndarray) -> tuple[np.ndarray, ...]:
    return tuple(np.asarray(q, np.float32) for q in rows)


def _way(path: Any) -> np.ndarray:
    return np.array(path.numpy(), float)
