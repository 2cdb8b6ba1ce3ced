"""Where the band stands and how the arm begins, in the experiments of `touch.py`: drawn at random, since neither is printed.

Table 4.1 has the lines of the tip and the rest of the parameters [Schuetz 2017, sec. 4.3.4]. A scene is a posture at the lines'
beginning and a vertical wall of springs across the way of link 4's middle, where the motion without a reaction ends with 9 to
11 N on the first line.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxik
from jaxik.dynamics import material_point
from jaxik.motions import Line
from jaxik.touch import Encounter, Reaction, ReactionResult, SpringContact, StiffnessEstimator, TouchSensor, simulate_reaction

DT, WEIGHTS = 1e-3, (10.0, 1.0, 2.0, 2.0, 1.0, 1.0, 1.0, 1.5, 1.0)
BEGIN = [-0.30, 1.30, 1.1]
LINES = {"avoidable": ([0.40, 1.0, 1.1], 6.0, 15.0), "inevitable": ([0.75, 1.0, 1.1], 9.0, 25.0)}  # end, duration, measured
LINK, MIDDLE = 4, np.array([0.175, 0.0, -0.03])  # between revolute joints 4 and 5
STIFFNESS = 60.0  # [N/m]
NEAR = 0.05  # [m] activation of the self-collision term: table 6.1's, for chapter 4 prints none
PAIRS = ((1, 3), (1, 4), (2, 4), (4, 7))  # links that come within 0.15 m of each other on these motions; neighbours never part
FORCES, TURNS = (9.2, 11.0), (-0.5, -0.25, 0.0, 0.25, 0.5)  # [N], and the wall's turns [rad] from square across the way


@functools.cache
def model() -> jaxik.Robot:
    return jaxik.load("crops_v2")


@functools.cache
def cost(joint_limits: float, self_collision: float) -> Any:
    """The secondary objective (4.24), of (4.28) with table 4.1's soft limits and (4.31) with a maximum of 1."""
    robot = dataclasses.replace(model(), self_pairs=PAIRS)
    soft = np.r_[0.3, np.full(8, np.radians(30.0))]  # [m, rad] inside the limits

    def both(q: Any) -> Any:
        near = jaxik.costs.collision_cost(jaxik.clearance(robot, None, q), activation=NEAR)
        beyond = jnp.maximum(jnp.maximum(robot.lower + soft - q, q - robot.upper + soft), 0.0) / soft
        return joint_limits * jnp.sum(beyond**3) + self_collision * near

    return both


@functools.cache
def reaction(scheme: str, **changes: Any) -> Reaction:
    """The reaction of table 4.1, whose factors of joint limits and self-collision are 20 and 23 on the acceleration level."""
    how = {"stiffness": StiffnessEstimator(start=STIFFNESS), "cost": cost(*((20.0, 23.0) if scheme == "rac" else (5.0, 8.0)))}
    return Reaction(model(), scheme=scheme, weights=WEIGHTS, **(how | changes))


class Scenes(NamedTuple):
    """Postures (k, 9) at the beginning, and the walls' points and normals (k, 3)."""

    q: np.ndarray
    point: np.ndarray
    normal: np.ndarray


def simulated(how: Reaction, scenes: Scenes, line: str | list[str], steps: int, stiffness: float = STIFFNESS) -> ReactionResult:
    """The motions (k, steps) of all scenes, on one of the `LINES` or on one for each; thinned to every 20th sample."""
    names = [line] * len(scenes.q) if isinstance(line, str) else line
    start = jaxik.pose(BEGIN)
    ends = np.stack([np.asarray(jaxik.pose(LINES[name][0])) for name in names])
    durations = np.array([LINES[name][1] for name in names])

    def one(q: Any, point: Any, normal: Any, end: Any, duration: Any) -> ReactionResult:
        met = Encounter(SpringContact(point, normal, stiffness), LINK, MIDDLE)
        return simulate_reaction(how, Line(start, end), duration, q, met, steps=steps, sensor=TouchSensor())

    found = jax.jit(lambda *x: jax.tree_util.tree_map(lambda y: y[:, ::20], jax.vmap(one)(*x)))(*scenes, ends, durations)
    return jax.tree_util.tree_map(np.asarray, found)


def followed(found: ReactionResult) -> np.ndarray:
    """Whether the tip stayed within 2 mm of its line (k,)."""
    return np.linalg.norm(found.error, axis=2).max(axis=1) < 2e-3


def drawn(starts: int, seed: int = 1) -> Scenes:
    """All scenes of random postures: five walls each, where the link's middle moves by more than 0.15 m."""
    rng, robot = np.random.default_rng(seed), model()
    near = (robot.lower + robot.upper) / 2 + 0.45 * (robot.upper - robot.lower) * rng.uniform(-1.0, 1.0, (starts, 9))
    q = begin(near)
    no_walls = Scenes(q, np.zeros((len(q), 3)), np.tile([1.0, 0.0, 0.0], (len(q), 1)))
    free = simulated(reaction("baseline"), no_walls, "avoidable", 6100, stiffness=0.0)
    middle = np.asarray(jax.vmap(jax.vmap(lambda q: material_point(robot, q, LINK, MIDDLE)))(free.motion.q))
    found = []
    for k in np.flatnonzero(followed(free)):
        back = (middle[k, 0] - middle[k, -1]) * [1.0, 1.0, 0.0]
        if np.linalg.norm(back) < 0.15:
            continue
        for turn in TURNS:
            angle = np.arctan2(back[1], back[0]) + turn
            normal = np.array([np.cos(angle), np.sin(angle), 0.0])
            way = middle[k] @ normal
            wall = way.min() + rng.uniform(*FORCES) / STIFFNESS
            if way[0] > wall + 0.02:
                found.append((q[k], middle[k, -1] + (wall - way[-1]) * normal, normal))
    return Scenes(*(np.array(x) for x in zip(*found, strict=True)))


def begin(near: np.ndarray) -> np.ndarray:
    """The postures (k, 9) near others (k, 9) whose tips are at the lines' beginning."""
    ask = {"task": jaxik.Task.position(), "seeds": "near"}
    found = [jaxik.solve_ik(model(), jaxik.pose(BEGIN), reference=x, **ask) for x in near]
    return np.array([np.asarray(each.q) for each in found if each.success])


def fall(force: np.ndarray) -> tuple[float, float]:
    """The greatest fall [N] of a force (t,) from a peak that it comes above again: that peak, and the least before it does.
    Both are the last force where it never falls so."""
    tops = np.maximum.accumulate(force)
    peaks = np.flatnonzero((tops[1:] > force[1:]) & (tops[:-1] == force[:-1]))
    falls = [(force[-1], force[-1])]
    for k in peaks:
        above = np.flatnonzero(force[k:] > force[k] + 1e-3)
        if len(above):
            falls.append((force[k], force[k : k + above[0]].min()))
    return max(falls, key=lambda x: x[0] - x[1])


def search(starts: int) -> dict[str, Any]:
    """How often RMRC's force falls by 0.1 N or more before it rises on, on the second line, and how often it also comes below
    2 N on the first, while feedback alone comes above 5 N on the second: what the thesis tells of its one scene."""
    scenes = drawn(starts)
    far = simulated(reaction("rmrc"), scenes, "inevitable", 13_000)
    falls = np.array([np.subtract(*fall(each)) for each in far.force])
    kept = np.flatnonzero((falls > 0.1) & followed(far))
    some = Scenes(*(x[kept] for x in scenes))
    near = simulated(reaction("rmrc"), some, "avoidable", 13_000)
    alone = simulated(reaction("feedback"), some, "inevitable", 13_000)
    like = kept[(near.force[:, -1] < 2.0) & (alone.force.max(axis=1) > 5.0)]
    return {"starts": starts, "scenes": len(scenes.q), "rmrc_falls": len(kept), "all_told": len(like), "which": like.tolist()}
