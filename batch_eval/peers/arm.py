"""P6R: the closed form beside EAIK, the clearance, the harvest scan."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from eaik.IK_HP import HPRobot
from race import PLAIN, Entry, compiled, single

import jaxik


def eaik_robot(robot: jaxik.Robot, last: int = 6, **options: Any) -> tuple[HPRobot, np.ndarray]:
    """The `last` joints for EAIK, the leading ones at 0, and its tip's rotation (3, 3), which it does not carry."""
    frame, axes, points = np.eye(4), [], []
    for parent_T_joint, axis in zip(robot.parent_T_joint, robot.axis, strict=True):
        frame = frame @ parent_T_joint
        axes.append(frame[:3, :3] @ axis)
        points.append(frame[:3, 3])
    tip = frame @ robot.joint_T_tip
    offsets = np.diff(np.array([np.zeros(3), *points[-last:], tip[:3, 3]]), axis=0)
    return HPRobot(np.array(axes[-last:]), offsets, **options), tip[:3, :3]


def closed_form_entries(dtype: Any, count: int = 50_000) -> list[Entry]:
    """All eight branches, validity and limits, of random reachable poses at their slide positions.

    EAIK has neither slide nor limits: it gets the same arm poses with the slide at 0. Its wish for a list of matrices is met
    before the clock starts. jaxik's error is the worst pose of a branch that it calls valid.
    """
    with jax.enable_x64(True):
        robot = jaxik.load("p6r")
        q = np.random.default_rng(0).uniform(robot.lower, robot.upper, (count, 7))
        pose = jax.jit(jax.vmap(lambda q: jaxik.forward_kinematics(robot, q)))
        poses = np.asarray(pose(q))
        arm_poses = np.array(pose(q * (np.arange(7) > 0)))
    with jax.enable_x64(dtype == np.float64):
        batch = jnp.asarray(poses, dtype), jnp.asarray(q[:, 0], dtype)
        run, seconds = compiled(jax.vmap(functools.partial(jaxik.closed_form, robot)), *batch)
        plain = Entry(PLAIN, count, *compiled(jax.vmap(functools.partial(jaxik.closed_form.__wrapped__, robot)), *batch))
        found = run()
    with jax.enable_x64(True):
        back = np.asarray(pose(np.asarray(found.q, np.float64).reshape(-1, 7))).reshape(count, 8, 4, 4)
    error = np.max(np.abs(back - poses[:, None]), axis=(2, 3))
    valid = np.asarray(found.valid)
    worst, success = float(np.max(error, where=valid, initial=0.0)), float(valid.any(axis=1).mean())
    ours = Entry("jaxik", count, run, seconds, worst, success)
    peer, tip = eaik_robot(robot)
    arm_poses[:, :3, :3] = arm_poses[:, :3, :3] @ tip.T
    matrices = list(arm_poses)
    theirs = [Entry(f"EAIK, {n} threads", count, lambda n=n: peer.IK_batched(matrices, n) and None) for n in (2, 4)]
    return [ours, plain, *theirs]


def single_calls() -> dict[str, dict[str, Callable[[], Any]]]:
    """One pose: all eight branches by calls that wait for their results."""
    robot = jaxik.load("p6r")
    q = np.random.default_rng(0).uniform(robot.lower, robot.upper)
    pose = jaxik.forward_kinematics(robot, jnp.asarray(q * (np.arange(7) > 0)))  # the slide at 0, as EAIK has none
    solve = functools.partial(jaxik.closed_form, robot)
    works = single(solve, functools.partial(jaxik.closed_form.__wrapped__, robot), pose, jnp.zeros(()))
    peer, tip = eaik_robot(robot)
    matrix = np.array(pose, np.float64)
    matrix[:3, :3] = matrix[:3, :3] @ tip.T
    return {"closed form, P6R, all 8 branches": works | {"EAIK, from Python": lambda: peer.IK(matrix)}}


def crop(points: int = 150) -> jaxik.Scene:
    """One fruit among 150 leaf points, ten leaves of fifteen, as in Van Henten et al. 2010, sec. 5."""
    rng = np.random.default_rng(0)
    builder = jaxik.collision.SceneBuilder("crop", point_radius=0.01)
    builder.add_mark("fruit_1", (0.5, 0.66, 0.6), length=0.3, radius=0.02)
    for i in range(points // 15):
        middle = np.array([0.5, 0.75, 0.65]) + rng.uniform(-1.0, 1.0, 3) * np.array([0.4, 0.1, 0.4])
        builder.add(f"leaf_{i + 1}", points=middle + rng.normal(0.0, 0.04, (15, 3)))
    return builder.scene()


def clearance_entry(count: int = 10_000) -> Entry:
    """Distances of 56 spheres to 150 points and to each other."""
    robot, scene = jaxik.load("p6r"), crop()
    q = np.random.default_rng(0).uniform(robot.lower, robot.upper, (count, 7)).astype(np.float32)
    run, seconds = compiled(jax.vmap(lambda q: jaxik.clearance(robot, scene, q)), jnp.asarray(q))
    return Entry("jaxik", count, run, seconds)


def scan_entry(angles: int = 144, slides: int = 82) -> Entry:
    """Every candidate (angle x slide x branch) of a fruit, with limits, clearance to 150 points and itself, and rank.

    The seconds to compile are those of the first scan.
    """
    robot, scene = jaxik.load("p6r"), crop()
    run = lambda: jaxik.harvesting.scan(robot, scene, scene.marks[0], angles=angles, slides=slides) and None
    start = time.perf_counter()
    solved = bool(jaxik.harvesting.scan(robot, scene, scene.marks[0], angles=angles, slides=slides))
    return Entry("jaxik", angles * slides * 8, run, time.perf_counter() - start, success=float(solved))
