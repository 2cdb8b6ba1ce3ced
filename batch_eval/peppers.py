"""79 sweet peppers around a stem, as Schuetz 2017, ch. 6 picks them: `python batch_eval/peppers.py`.

Needs `pip install -e ".[test,peers]"`. Writes `batch_eval/peppers.json` and three pictures. Table 6.1 is as printed. Ours, for
they are not printed, are: the fruits (measured in a greenhouse; here spread around the stem by rule), the arm (`crops_v2`, the
prototype 2 whose numbers the thesis prints, in place of prototype 1), its joints' limits, the start, and all of the guesses but
what they are: a heuristic path of the tip around the stem and a straight line to the fruit, by a quintic in time, both followed
by automatic supervisory control (sec. 6.3.1). The start and the way around were searched for such that the guesses reach.

One programme, (6.4) to (6.10), is solved for all fruits from both guesses twice: by `optimise_trajectory`, and by the thesis'
own solver, IPOPT with L-BFGS (by MUMPS in place of MA27), where CasADi has it from the equations. CasADi's distances judge all
motions, at most a millimetre apart.
"""

from __future__ import annotations

import contextlib
import json
import re
import tempfile
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import jax
import jax.numpy as jnp
import numpy as np
import peppers_pictures
from peers import casadi_peer
from race import clocked, counted, machine, steps
from scipy.spatial.transform import Rotation, Slerp
from setups import self_collision

import jaxik
from jaxik.collision import link_clearances
from jaxik.costs import collision_cost, joint_limit_cost
from jaxik.motions import Curve, follow
from jaxik.planning import TrajectoryResult, optimise_trajectory

COUNT, DURATION, SPANS = 79, 10.0, 100
STEP = DURATION / SPANS
STEM, RADIUS, TOP = np.array([0.241, 0.81]), 0.015, 2.6
ACTIVATION, SELF_ACTIVATION, WEIGHT, MOST = 0.07, 0.05, 10.0, 5.0
FIRST, LAST = 0.5, 1.0  # weight of the dynamic cost
ITERATIONS = 1000
TOLERANCE = 1e-4  # of both solvers, not printed; IPOPT's own 1e-8 has it count hundreds of iterations about kinks of distances
LOOSER = 1e-2, 1e-1  # other tolerances of IPOPT, on which its iterations hang
SPEED = 1.0  # [rad/s, m/s] not printed
AS_PRINTED: dict[str, Any] = {
    **{"duration": DURATION, "spans": SPANS, "degree": 2, "velocity_cost": (FIRST, LAST)},
    **{"velocity": SPEED, "acceleration": np.inf},
    **{"collision_weight": WEIGHT, "collision_maximum": MOST, "activation": ACTIVATION, "self_activation": SELF_ACTIVATION},
}
SOFT = AS_PRINTED | {"collision": "penalty", "rounds": 0, "iterations": ITERATIONS, "tolerance": TOLERANCE}

# of the guesses: not printed, and searched for such that they reach their fruit inside the joints' limits
HOME = np.array([0.23, -1.74, 0.52, -1.18, -1.35, 2.12, -0.68, -0.3, 1.4])
AWAY, BACK = 0.2, 0.07  # [m] from the stem that the way around it keeps, and before the fruit where it ends
GUESS: dict[str, Any] = {"dt": 0.01, "alpha": 0.2, "limits": True}
LIMITS, NEAR = 5.0, 5.0  # weights of the costs of limits and of collision

NAMES, SOLVERS = ("heuristic", "straight"), ("jaxik", "ipopt")
PAPER: dict[str, Any] = {
    "converged_share": 0.94,
    "remaining": {"median": 0.36, "mean": 0.29},
    "iterations": {"heuristic": {"median": 60, "mean": 71.3}, "straight": {"median": 81, "mean": 92.2}},
    "s": {"heuristic": {"median": 3.44, "mean": 5.0}, "straight": {"median": 4.78, "mean": 6.6}},
    "typical": {"iterations": {"heuristic": 76, "straight": 177}, "s": {"heuristic": 3.84, "straight": 7.57}, "saved": 0.22},
    "most_iterations": ITERATIONS,
}
REACHED = 1e-3  # [m] from the fruit
TOUCH = 1e-6  # [m] that is taken for contact by rounding
SAME = 1e-3  # difference of costs up to which two solvers are in the same optimum


def scene() -> jaxik.Scene:
    return jaxik.make_scene(capsules=[[*STEM, 0.0, *STEM, TOP, RADIUS]], name="stem")


def goals() -> np.ndarray:
    """(79, 4, 4): fruits 8 to 12 cm from the stem's axis, evenly around it and in height. The gripper is level, and points
    at the stem as far as that turns it by no more than 60 degrees from straight ahead."""
    rng = np.random.default_rng(COUNT)
    around, away, height = (rng.uniform(a, b, COUNT) for a, b in ((-np.pi, np.pi), (0.08, 0.12), (0.8, 1.6)))
    ahead = np.pi / 2.0
    inwards = (around + np.pi - ahead + np.pi) % (2.0 * np.pi) - np.pi
    headings = ahead + np.clip(inwards, -np.pi / 3.0, np.pi / 3.0)
    return np.array([posed([*STEM + r * out(a), z], b) for a, r, z, b in zip(around, away, height, headings, strict=True)])


def out(angle: float) -> np.ndarray:
    """The horizontal direction (2,) at an angle."""
    return np.array([np.cos(angle), np.sin(angle)])


def posed(position: Any, heading: float) -> np.ndarray:
    """The gripper's frame there, its z horizontal along the heading, its x down."""
    pose, z = np.eye(4), np.array([*out(heading), 0.0])
    pose[:3, :3] = np.stack([[0.0, 0.0, -1.0], np.cross(z, [0.0, 0.0, -1.0]), z], axis=1)
    pose[:3, 3] = position
    return pose


def detour(start: np.ndarray, goal: np.ndarray, points: int = 12) -> np.ndarray:
    """Poses (k, 4, 4) around the stem by the shorter way, at least `AWAY` from it, to `BACK` before the fruit, and to it."""
    before = goal.copy()
    before[:3, 3] -= BACK * goal[:3, 2]
    polar = lambda p: (np.arctan2(*(p[1::-1] - STEM[::-1])), np.hypot(*(p[:2] - STEM)))
    (angle, radius), (end_angle, end_radius) = polar(start[:3, 3]), polar(before[:3, 3])
    turn = (end_angle - angle + np.pi) % (2.0 * np.pi) - np.pi
    share = np.linspace(0.0, 1.0, points)
    bulge = np.maximum(0.0, AWAY - np.minimum(radius, end_radius)) * np.sin(np.pi * share)
    reach = (1.0 - share) * radius + share * end_radius + bulge
    poses = np.tile(np.eye(4), (points + 1, 1, 1))
    poses[:-1, :2, 3] = STEM + reach[:, None] * np.array([out(angle + s * turn) for s in share])
    poses[:-1, 2, 3] = (1.0 - share) * start[2, 3] + share * before[2, 3]
    poses[:-1, :3, :3] = Slerp([0.0, 1.0], Rotation.from_matrix([start[:3, :3], before[:3, :3]]))(share).as_matrix()
    poses[-1] = goal
    return poses


def hindrance(robot: jaxik.Robot) -> Callable[[Any], Any]:
    """The cost that the null space of the guesses goes down: of limits, of the robot itself, and of the stem."""
    around = scene()

    def cost(q: Any) -> Any:
        near = collision_cost(jnp.minimum(link_clearances(robot, around, q), 1.0), activation=ACTIVATION, maximum=MOST)
        return NEAR * jnp.sum(near) + LIMITS * joint_limit_cost(robot, q, soft=0.2)

    return cost


def followed(robot: jaxik.Robot, poses: list[np.ndarray], cost: Callable[[Any], Any] | None) -> np.ndarray:
    """(b, 1001, 9): the tip along each path, inside the joints' limits, the null space down a cost, or at rest without one."""
    paths = jax.tree_util.tree_map(lambda *x: np.stack(x), *(Curve(each) for each in poses))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = follow(robot, paths, DURATION, np.tile(HOME, (len(poses), 1)), cost=cost, each=("path",), **GUESS)
    return np.clip(found.q, robot.lower, robot.upper)


def guesses(robot: jaxik.Robot, aims: np.ndarray, cost: Callable[[Any], Any] | None) -> dict[str, np.ndarray]:
    """The motions along the heuristic's path and along the straight line to each fruit."""
    start = np.asarray(jaxik.forward_kinematics(robot, HOME), np.float64)
    lines = {"heuristic": [detour(start, goal) for goal in aims], "straight": [np.stack([start, goal]) for goal in aims]}
    return {name: followed(robot, poses, cost) for name, poses in lines.items()}


def knots(guess: np.ndarray) -> np.ndarray:
    """The samples (b, 101, n) of guesses at the ends of spans."""
    return guess[:, :: (guess.shape[1] - 1) // SPANS]


def weight() -> np.ndarray:
    """zeta (101,) of (6.6)."""
    return FIRST + (LAST - FIRST) * np.linspace(0.0, 1.0, SPANS + 1) ** 2


def dynamic_cost(rate: np.ndarray) -> np.ndarray:
    """The dynamic cost (6.6) of rates (b, 101, n), by the trapezoidal rule."""
    return np.trapezoid(weight() * np.sum(rate**2, axis=2), dx=STEP, axis=1)


def missed(robot: jaxik.Robot, q: np.ndarray, aims: np.ndarray) -> np.ndarray:
    """How far from each fruit a motion ends (b,) [m]."""
    ends = np.asarray(jax.vmap(lambda q: jaxik.forward_kinematics(robot, q))(q[:, -1]))
    return np.linalg.norm(ends[:, :3, 3] - aims[:, :3, 3], axis=1)


class Run(NamedTuple):
    """One solver's result for one fruit: a motion at knots, q and rate (101, n), its cost, iterations, seconds, whether it
    converged, and the cost and the greatest violation after each iteration, where it tells them."""

    q: np.ndarray
    rate: np.ndarray
    cost: float
    iterations: int
    s: float
    converged: bool
    course: tuple[np.ndarray, np.ndarray] | None = None

    @property
    def fine(self) -> np.ndarray:
        """Samples (1001, n): between knots rates are linear, as the trapezoidal rule has them."""
        since = STEP * np.linspace(0.0, 1.0, 10, endpoint=False)[:, None]
        first, change = self.rate[:-1, None], np.diff(self.rate, axis=0)[:, None]
        spans = self.q[:-1, None] + first * since + 0.5 * change * since**2 / STEP
        return np.concatenate([spans.reshape(-1, self.q.shape[1]), self.q[-1:]])


def constraints(tip: ca.Function, qs: Any, us: Any, goal: Any, step: float) -> Any:
    """The constraints that are to be zero: the trapezoidal rule (6.8), the start and the goal (6.9)."""
    end = tip(qs[:, -1])
    turn = end[:3, :3].T @ goal[:3, :3]
    skew = ca.vertcat(turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1])
    steps = qs[:, 1:] - qs[:, :-1] - step / 2.0 * (us[:, 1:] + us[:, :-1])
    return ca.vertcat(ca.vec(steps), qs[:, 0] - ca.DM(HOME), us[:, 0], us[:, -1], end[:3, 3] - goal[:3, 3], skew)


class Printed:
    """The programme in CasADi: (6.4) to (6.10) with table 6.1, from the robot's frames alone."""

    def __init__(self, robot: jaxik.Robot, compiled: bool = True, tolerance: float = TOLERANCE):
        n, count, step = robot.num_joints, SPANS + 1, STEP
        q = ca.SX.sym("q", n)
        frames = casadi_peer._frames(robot, q)
        near, least = self._collisions(robot, frames)
        self.clearance = ca.Function("clearance", [q], [least])
        cost, tip = ca.Function("cost", [q], [near]), ca.Function("tip", [q], [frames[-1] @ ca.DM(robot.joint_T_tip)])
        qs, us, goal = ca.MX.sym("q", n, count), ca.MX.sym("u", n, count), ca.MX.sym("goal", 4, 4)
        trapezoid = np.full(count, step)
        trapezoid[[0, -1]] *= 0.5
        total = ca.sum2(ca.DM((trapezoid * weight())[None]) * ca.sum1(us**2))
        total += WEIGHT * ca.sum2(ca.DM(trapezoid[None]) * cost.map(count)(qs))
        zero = constraints(tip, qs, us, goal, step)
        self.limits = [
            np.concatenate([np.tile(x, count), np.full(n * count, s)]) for x, s in ((robot.lower, -SPEED), (robot.upper, SPEED))
        ]
        options: dict[str, Any] = {"ipopt.print_level": 0, "print_time": 0, "ipopt.sb": "yes", "ipopt.tol": tolerance}
        options |= {"ipopt.max_iter": ITERATIONS, "ipopt.hessian_approximation": "limited-memory"}
        if compiled:
            options |= {"jit": True, "compiler": "shell", "jit_options": {"flags": ["-O2"], "cleanup": False}}
        problem = {"x": ca.veccat(qs, us), "f": total, "g": zero, "p": ca.vec(goal)}
        with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
            self.solver = ca.nlpsol("printed", "ipopt", problem, options)

    def _collisions(self, robot: jaxik.Robot, frames: list[Any]) -> tuple[Any, Any]:
        """The cost of links, each by its nearest, to the robot itself and the stem; and the least distance."""
        ends, radius = {}, {}
        for volume in robot.volumes:
            frame = frames[robot.link_joint[volume.link]] @ ca.DM(robot.link_offset[volume.link])
            ends[volume.link] = [(frame @ ca.DM([*corner, 1.0]))[:3] for corner in volume.corners]
            radius[volume.link] = float(volume.radius)
        stem, total, nearest = [ca.DM([*STEM, 0.0]), ca.DM([*STEM, TOP])], 0, ca.SX(1e3)
        for b in ends:
            own = [casadi_peer._between(ends[a], ends[b]) - radius[a] - radius[b] for a, c in robot.self_pairs if c == b]
            for gaps, activation in (
                (own, SELF_ACTIVATION),
                ([casadi_peer._between(ends[b], stem) - radius[b] - RADIUS], ACTIVATION),
            ):
                if gaps:
                    least = gaps[0]
                    for gap in gaps[1:]:
                        least = ca.fmin(least, gap)
                    nearest = ca.fmin(nearest, least)
                    total += MOST * (ca.fmax(activation - least, 0) / activation) ** 3
        return total, nearest

    def solve(self, q: np.ndarray, rate: np.ndarray, goal: np.ndarray) -> Run:
        """Solves from samples (101, n)."""
        low, high = self.limits
        call = lambda: self.solver(
            x0=np.concatenate([q.ravel(), rate.ravel()]), p=goal.T.ravel(), lbx=low, ubx=high, lbg=0.0, ubg=0.0
        )
        found, seconds = clocked(call)
        status = self.solver.stats()
        converged = status["return_status"] in ("Solve_Succeeded", "Solved_To_Acceptable_Level")
        course = np.array(status["iterations"]["obj"]), np.array(status["iterations"]["inf_pr"])
        there, moving = np.array(found["x"]).reshape(2, *q.shape)
        return Run(there, moving, float(found["f"]), status["iter_count"], seconds, converged, course)

    def free(self, robot: jaxik.Robot, q: np.ndarray) -> bool:
        """Whether samples (k, n) of a motion are free, and others between them, at most a millimetre apart."""
        reach = jaxik.collision.continuous_collision.joint_reaches(robot)
        way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(q, axis=0)) @ reach)])
        places = np.linspace(0.0, way[-1], int(way[-1] / 1e-3) + 2)
        rows = np.stack([np.interp(places, way, column) for column in q.T])
        return bool(np.array(self.clearance.map(rows.shape[1])(rows)).min() >= -TOUCH)


def by_jaxik(robot: jaxik.Robot, guess: np.ndarray, goal: np.ndarray, iterations: int = ITERATIONS) -> Run:
    """The printed programme from a guess (101, n), by jaxik."""
    how = SOFT | {"iterations": iterations}
    found, seconds = clocked(lambda: optimise_trajectory(robot, HOME, goal, scene=scene(), guess=guess, **how))
    at = found.trajectory.at(jnp.linspace(0.0, DURATION, SPANS + 1))
    said = float(found.cost), int(found.iterations), seconds, bool(found.converged)
    return Run(np.asarray(at.q), np.asarray(at.velocity), *said)


class Study:
    """The robot, CasADi's programme, fruits and guesses, and what the solvers found from these: `runs` by guess and solver."""

    def __init__(self, fruits: Sequence[int], compiled: bool, told: Callable[[], Any]):
        self.robot = self_collision.arm()
        self.peer = Printed(self.robot, compiled)
        count, self.fruits = len(fruits), list(fruits)
        self.aims = goals()[self.fruits]
        self.full = guesses(self.robot, self.aims, hindrance(self.robot))
        self.guess = {name: knots(full) for name, full in self.full.items()}
        damped = knots(guesses(self.robot, self.aims, None)["heuristic"])
        self.damped = dynamic_cost(np.gradient(damped, STEP, axis=1))
        self.damped_reaches = missed(self.robot, damped, self.aims) < REACHED
        self.own = {name: dynamic_cost(np.gradient(q, STEP, axis=1)) for name, q in self.guess.items()}
        self.reaches = {name: missed(self.robot, q, self.aims) < REACHED for name, q in self.guess.items()}
        self.guess_free = {name: np.array([self.peer.free(self.robot, q) for q in full]) for name, full in self.full.items()}
        by_jaxik(self.robot, self.guess["heuristic"][0], self.aims[0])  # warm
        self.runs: dict[tuple[str, str], list[Run]] = {(name, who): [] for name in NAMES for who in SOLVERS}
        for i, name in ((i, name) for i in range(count) for name in NAMES):
            for who in SOLVERS:
                self.runs[name, who].append(self.solved(who, i, self.guess[name][i]))
            told()
        self.free = {key: np.array([self.peer.free(self.robot, run.fine) for run in runs]) for key, runs in self.runs.items()}

    def solved(self, who: str, i: int, guess: np.ndarray) -> Run:
        """The programme of fruit i from a guess (101, n), by one of the solvers."""
        if who == "jaxik":
            return by_jaxik(self.robot, guess, self.aims[i])
        return self.peer.solve(guess, np.gradient(guess, STEP, axis=0), self.aims[i])

    def column(self, name: str, who: str, what: str) -> np.ndarray:
        return np.array([getattr(run, what) for run in self.runs[name, who]])

    def dynamic(self, name: str, who: str) -> np.ndarray:
        """The dynamic costs (b,) of the solutions."""
        return dynamic_cost(np.stack([run.rate for run in self.runs[name, who]]))


def spread(values: np.ndarray) -> dict[str, float]:
    """Median, mean and quartiles."""
    if not len(values):
        return {}
    low, middle, high = np.percentile(values, (25, 50, 75))
    return {"median": float(middle), "mean": float(np.mean(values)), "q1": float(low), "q3": float(high)}


def left_over(cost: np.ndarray, before: np.ndarray) -> dict[str, float]:
    """The share of a guess' cost that is left: over fruits, and of medians and means, as the thesis may be read, too."""
    if not len(cost):
        return {}
    ratio = {"median": float(np.median(cost / before)), "mean": float(np.mean(cost / before))}
    both = {"of_medians": float(np.median(cost) / np.median(before)), "of_means": float(np.mean(cost) / np.mean(before))}
    return ratio | both


def table(study: Study, name: str, who: str) -> dict[str, Any]:
    """A column of table 6.2. Costs are over the motions that converged and are free, from guesses that reach."""
    converged, free = study.column(name, who, "converged"), study.free[name, who]
    good, dynamic = converged & free & study.reaches[name], study.dynamic(name, who)
    heuristic = good & study.reaches["heuristic"]
    return {
        "converged": int(converged.sum()),
        "converged_and_free": int((converged & free).sum()),
        "share": float(np.mean(converged & free)),
        "failed": {"not_converged": int((~converged).sum()), "collision": int((converged & ~free).sum())},
        "iterations": spread(study.column(name, who, "iterations")),
        "s": spread(study.column(name, who, "s")),
        "dynamic_cost": spread(dynamic[good]),
        "remaining": left_over(dynamic[heuristic], study.own["heuristic"][heuristic]),
        "remaining_of_own_guess": left_over(dynamic[good], study.own[name][good]),
        "remaining_of_damped": left_over(*(x[good & study.damped_reaches] for x in (dynamic, study.damped))),
    }


def of_guess(study: Study, name: str) -> dict[str, Any]:
    """The worth of a guess before it is optimised."""
    reaches, free = study.reaches[name], study.guess_free[name]
    counts = {"reaches": int(reaches.sum()), "free": int(free.sum()), "reaches_and_free": int((reaches & free).sum())}
    return counts | {"dynamic_cost": spread(study.own[name][reaches])}


def each_fruit(study: Study) -> dict[str, Any]:
    """Figures 6.8 and 6.9 fruit by fruit."""
    rows: dict[str, Any] = {}
    for name in NAMES:
        rows[name] = {"guess_dynamic_cost": study.own[name], "reaches": study.reaches[name].astype(int)}
        for who in SOLVERS:
            good = study.column(name, who, "converged") & study.free[name, who]
            numbers = {what: study.column(name, who, what) for what in ("cost", "iterations", "s")}
            rows[name][who] = numbers | {"dynamic_cost": study.dynamic(name, who), "good": good.astype(int)}
    return rows


def apart(study: Study, restarted: np.ndarray) -> dict[str, Any]:
    """Where two solvers go from the same guess: how often to the same cost; where not, what is found from several postures
    (`restarted`), and what IPOPT makes of jaxik's motion."""
    found: dict[str, Any] = {"same": 0, "jaxik_less": 0, "ipopt_less": 0, "of": 0, "rows": []}
    for name in NAMES:
        for i, (ours, theirs) in enumerate(zip(study.runs[name, "jaxik"], study.runs[name, "ipopt"], strict=True)):
            if not (ours.converged and theirs.converged):
                continue
            ratio = ours.cost / theirs.cost
            which = "same" if abs(ratio - 1.0) <= SAME else "jaxik_less" if ratio < 1.0 else "ipopt_less"
            found[which] += 1
            found["of"] += 1
            if which != "same":
                again = study.peer.solve(ours.q, ours.rate, study.aims[i])
                row = {
                    "fruit": study.fruits[i],
                    "guess": name,
                    "jaxik": ours.cost,
                    "ipopt": theirs.cost,
                    "restarted": float(restarted[i]),
                }
                found["rows"].append(row | {"ipopt_from_jaxik": again.cost, "its_convergence": again.converged})
    return found


def by_tolerance(study: Study, tolerance: float, told: Callable[[], Any]) -> dict[str, Any]:
    """Table 6.2 by IPOPT with another tolerance, and the median of its costs beside those of jaxik's motions."""
    peer, found = Printed(study.robot, tolerance=tolerance), {"tolerance": tolerance}
    for name in NAMES:
        runs = []
        for guess, aim in zip(study.guess[name], study.aims, strict=True):
            runs.append(peer.solve(guess, np.gradient(guess, STEP, axis=0), aim))
            told()
        converged = np.array([run.converged for run in runs])
        good = converged & [study.peer.free(study.robot, run.fine) for run in runs]
        dearer = np.array([run.cost for run in runs]) / study.column(name, "jaxik", "cost")
        found[name] = {
            "converged": int(converged.sum()),
            "share": float(np.mean(good)),
            "iterations": spread(np.array([run.iterations for run in runs])),
            "s": spread(np.array([run.s for run in runs])),
            "cost_of_jaxiks": float(np.median(dearer[good])),
        }
    return found


def several(study: Study, how: dict[str, Any]) -> tuple[dict[str, Any], TrajectoryResult]:
    """All fruits in one batch without a guess: from straight lines to several postures."""
    call = lambda: optimise_trajectory(study.robot, HOME, study.aims, scene=scene(), **how)
    call()
    found, seconds = clocked(call)
    curves = jax.vmap(lambda motion: motion.at(jnp.linspace(0.0, motion.duration, 1001)).q)(found.trajectory)
    free = np.array([np.isfinite(q).all() and study.peer.free(study.robot, q) for q in np.asarray(curves)])
    good = free & found.converged & study.reaches["heuristic"]
    least = np.min([study.column(name, who, "cost") for name in NAMES for who in SOLVERS], axis=0)
    result = {
        "solved": int(np.sum(found.success)),
        "converged": int(found.converged.sum()),
        "free": int(free.sum()),
        "iterations": spread(found.iterations),
        "remaining": left_over(found.parts[good, 0], study.own["heuristic"][good]),
        "no_dearer_than_all": int(np.sum(found.cost <= (1.0 + SAME) * least)),
        "together_s": seconds,
    }
    return result, found


def typical(study: Study) -> dict[str, Any]:
    """Figures 6.5 to 6.7: the fruit behind the stem whose share saved comes nearest to the printed one. Its guess is free, the
    straight line is not, and both solvers make a free motion of both. Fruits whose goal is too near to the stem are left out,
    since we saw that their optimum waits and rushes there in the last sample: most of the cost must be of speed."""
    saved = 1.0 - study.dynamic("heuristic", "ipopt") / study.own["heuristic"]
    fits = study.guess_free["heuristic"] & ~study.guess_free["straight"] & study.reaches["heuristic"]
    for name, who in study.runs:
        fast = study.dynamic(name, who) > 0.5 * study.column(name, who, "cost")
        fits = fits & study.free[name, who] & study.column(name, who, "converged") & fast
    if not fits.any():
        return {}
    i = int(np.argmin(np.where(fits, np.abs(saved - PAPER["typical"]["saved"]), np.inf)))
    tip = jax.vmap(lambda q: jaxik.forward_kinematics(study.robot, q)[:3, 3])
    density = lambda rate: weight() * np.sum(rate**2, axis=1)
    found: dict[str, Any] = {"fruit": study.fruits[i], "candidates": int(fits.sum()), "position_m": study.aims[i][:3, 3]}
    found["guess"] = {}
    for name in NAMES:
        q = study.guess[name][i]
        found["guess"][name] = {"tip_m": np.asarray(tip(q)), "density": density(np.gradient(q, STEP, axis=0))}
        for who in SOLVERS:
            run = study.runs[name, who][i]
            row = {"iterations": run.iterations, "s": run.s, "cost": run.cost, "dynamic_cost": study.dynamic(name, who)[i]}
            row["saved"] = 1.0 - row["dynamic_cost"] / study.own["heuristic"][i]
            row |= {"tip_m": np.asarray(tip(run.q)), "density": density(run.rate), "velocity": run.rate}
            found.setdefault(who, {})[name] = row | course(study, name, who, i)
    found["guess"]["heuristic"]["velocity"] = np.gradient(study.guess["heuristic"][i], STEP, axis=0)
    found["joint_names"] = list(study.robot.joint_names)
    return found


def course(study: Study, name: str, who: str, i: int) -> dict[str, Any]:
    """The cost over iterations. IPOPT tells it, with the violation; jaxik is stopped after more and more iterations with all
    spans, before which it needs some with few."""
    told = study.runs[name, who][i].course
    if told is not None:
        return {"cost_at": np.arange(len(told[0])), "cost_course": told[0], "violation_course": told[1]}
    numbers: dict[int, float] = {}
    for most in [*range(1, 21), 25, 30, 40, 50, 70, 100, 150, 200]:
        run = by_jaxik(study.robot, study.guess[name][i], study.aims[i], most)
        numbers[run.iterations] = run.cost
        if run.converged:
            break
    return {"cost_at": list(numbers), "cost_course": list(numbers.values())}


def plain(value: Any) -> Any:
    """The same for JSON, to six digits."""
    if isinstance(value, dict):
        return {key: plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [plain(each) for each in value]
    if isinstance(value, np.generic):
        value = value.item()
    return float(f"{value:.6g}") if isinstance(value, float) else value


def study(quick: bool = False, tell: Callable[[int, int], Any] | None = None) -> dict[str, Any]:
    """Table 6.2 and figures 6.2 to 6.9, of both solvers from both guesses, and of jaxik without one."""
    fruits, looser = ([48], ()) if quick else (range(COUNT), LOOSER)
    told = steps(tell, len(NAMES) * len(fruits) * (1 + len(looser)))
    made = Study(fruits, not quick, told)
    kept, _ = several(made, AS_PRINTED)
    restarted, found = several(made, SOFT)
    result: dict[str, Any] = {
        "printed": PAPER,
        "fruits": len(made.aims),
        "ours": {
            "home": HOME,
            "away_m": AWAY,
            "back_m": BACK,
            "alpha": GUESS["alpha"],
            "velocity_limit": SPEED,
            "tolerance": TOLERANCE,
        },
        "damped": {"reaches": int(made.damped_reaches.sum()), "dynamic_cost": spread(made.damped[made.damped_reaches])},
    }
    for name in NAMES:
        result[name] = {"guess": of_guess(made, name)} | {who: table(made, name, who) for who in SOLVERS}
    result |= {"several_postures": restarted, "several_postures_and_a_margin": kept, "apart": apart(made, found.cost)}
    result["ipopt_looser"] = [by_tolerance(made, tolerance, told) for tolerance in looser]
    result |= {"typical": typical(made), "each_fruit": each_fruit(made), "positions_m": made.aims[:, :3, 3]}
    result["sparsity"] = small_sparsity(made.robot)
    return plain(result)


def small_sparsity(robot: jaxik.Robot, spans: int = 6) -> dict[str, Any]:
    """Figure 6.3: where the constraints' Jacobian has entries, with six steps."""
    n, q = robot.num_joints, ca.SX.sym("q", robot.num_joints)
    tip = ca.Function("tip", [q], [casadi_peer._frames(robot, q)[-1] @ ca.DM(robot.joint_T_tip)])
    qs, us = ca.MX.sym("q", n, spans + 1), ca.MX.sym("u", n, spans + 1)
    zero = constraints(tip, qs, us, ca.DM.eye(4), DURATION / spans)
    rows, columns = ca.jacobian_sparsity(zero, ca.veccat(qs, us)).get_triplet()
    return {"rows": rows, "columns": columns, "shape": [zero.numel(), 2 * qs.numel()], "workspace_rows": 6}


def main() -> None:
    """All of it; writes JSON and pictures."""
    out = Path(__file__).with_suffix(".json")
    result = {"machine": machine()} | study(tell=counted)
    text = re.sub(r"\[[-+.,\s\de]+\]", lambda found: " ".join(found.group().split()), json.dumps(result, indent=1))
    out.write_text(text + "\n")
    peppers_pictures.draw(result, out)


if __name__ == "__main__":
    main()
