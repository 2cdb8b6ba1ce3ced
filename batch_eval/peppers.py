"""79 sweet peppers around a stem, as Schuetz 2017, ch. 6 picks them: `python batch_eval/peppers.py [--ipopt K]`.

Needs `pip install -e ".[test,peers]"`. Prints, and writes `batch_eval/peppers.json` and a picture. The thesis' fruits were
measured in a greenhouse and are not printed: here they are spread around its stem by rule, and the arm is prototype 2
(`crops_v2`), whose numbers it prints, in place of prototype 1. The rest is table 6.1. Its two guesses are drawn again: a
heuristic path around the stem, and a straight line, both followed by the tip with automatic supervisory control. The same
programme, written in CasADi from the equations, is solved by IPOPT in the same run, for every K-th fruit; CasADi's distances
judge all motions.
"""

from __future__ import annotations

import argparse
import json
import warnings
from pathlib import Path
from typing import Any

import casadi as ca
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from peers import casadi_peer
from race import clocked, machine
from scipy.spatial.transform import Rotation, Slerp
from setups import self_collision

import jaxik
from jaxik.collision import link_clearances
from jaxik.costs import collision_cost, joint_limit_cost
from jaxik.motions import Curve, follow
from jaxik.planning import TrajectoryResult, optimise_trajectory

COUNT, DURATION, SPANS = 79, 10.0, 100
STEM, RADIUS = np.array([0.241, 0.81]), 0.015
HOME = np.array([0.5, 0.2, -1.9, -1.6, 1.7, 0.0, 1.3, -1.3, -1.3])
ACTIVATION, SELF_ACTIVATION, WEIGHT, MOST = 0.07, 0.05, 10.0, 5.0
FIRST, LAST = 0.5, 1.0  # weight of the dynamic cost
SPEED = 1.0  # [rad/s, m/s] not printed
PRINTED: dict[str, Any] = {
    **{"duration": DURATION, "spans": SPANS, "degree": 2, "velocity_cost": (FIRST, LAST)},
    **{"velocity": SPEED, "acceleration": np.inf},
    **{"collision_weight": WEIGHT, "collision_maximum": MOST, "activation": ACTIVATION, "self_activation": SELF_ACTIVATION},
}
AS_PRINTED = PRINTED | {"collision": "penalty", "rounds": 0, "iterations": 300}
CLOSELY = AS_PRINTED | {"tolerance": 1e-6, "iterations": 1000}
TIMED = 4  # every so many fruits are timed one by one
PAPER = {"converged": 0.94, "remaining": [0.36, 0.29], "heuristic": [60, 71.3, 3.44, 5.0], "straight": [81, 92.2, 4.78, 6.6]}
DT = 0.002  # [s] of the guesses' supervisory control
TOUCH = 1e-6  # [m] that is taken for contact by rounding


def scene() -> jaxik.Scene:
    return jaxik.make_scene(capsules=[[*STEM, 0.0, *STEM, 2.6, RADIUS]], name="stem")


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


def detour(start: np.ndarray, goal: np.ndarray, away: float = 0.25, back: float = 0.12, points: int = 12) -> np.ndarray:
    """Poses (k, 4, 4) around the stem by the shorter way, at least `away` from it, to `back` before the fruit, and to it."""
    before = goal.copy()
    before[:3, 3] -= back * goal[:3, 2]
    polar = lambda p: (np.arctan2(*(p[1::-1] - STEM[::-1])), np.hypot(*(p[:2] - STEM)))
    (angle, radius), (end_angle, end_radius) = polar(start[:3, 3]), polar(before[:3, 3])
    turn = (end_angle - angle + np.pi) % (2.0 * np.pi) - np.pi
    share = np.linspace(0.0, 1.0, points)
    bulge = np.maximum(0.0, away - np.minimum(radius, end_radius)) * np.sin(np.pi * share)
    reach = (1.0 - share) * radius + share * end_radius + bulge
    poses = np.tile(np.eye(4), (points + 1, 1, 1))
    poses[:-1, :2, 3] = STEM + reach[:, None] * np.array([out(angle + s * turn) for s in share])
    poses[:-1, 2, 3] = (1.0 - share) * start[2, 3] + share * before[2, 3]
    poses[:-1, :3, :3] = Slerp([0.0, 1.0], Rotation.from_matrix([start[:3, :3], before[:3, :3]]))(share).as_matrix()
    poses[-1] = goal
    return poses


def followed(robot: jaxik.Robot, poses: list[np.ndarray]) -> np.ndarray:
    """(79, 101, 9): the tip along each path, the null space down the costs of limits, itself and the stem."""
    around = scene()

    def cost(q: Any) -> Any:
        near = collision_cost(jnp.minimum(link_clearances(robot, around, q), 1.0), activation=ACTIVATION, maximum=MOST)
        return jnp.sum(near) + 5.0 * joint_limit_cost(robot, q, soft=0.2)

    paths = jax.tree_util.tree_map(lambda *x: np.stack(x), *(Curve(each) for each in poses))
    start = np.tile(HOME, (len(poses), 1))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = follow(robot, paths, DURATION, start, cost=cost, each=("path",), dt=DT, alpha=0.5, limits=False)
    return np.clip(found.q[:, :: round(DURATION / SPANS / DT)], robot.lower, robot.upper)


def dynamic_cost(q: np.ndarray) -> np.ndarray:
    """The dynamic cost (6.6) of guesses (b, 101, n), by differences."""
    step = DURATION / SPANS
    rate = np.gradient(q, step, axis=1)
    weight = FIRST + (LAST - FIRST) * np.linspace(0.0, 1.0, SPANS + 1) ** 2
    return np.trapezoid(weight * np.sum(rate**2, axis=2), dx=step, axis=1)


class Printed:
    """The programme in CasADi: (6.4) to (6.10) with table 6.1, from the robot's frames alone."""

    def __init__(self, robot: jaxik.Robot, iterations: int = 1000):
        n, count, step = robot.num_joints, SPANS + 1, DURATION / SPANS
        q = ca.SX.sym("q", n)
        frames = casadi_peer._frames(robot, q)
        near, least = self._collisions(robot, frames)
        self.clearance = ca.Function("clearance", [q], [least])
        cost, tip = ca.Function("cost", [q], [near]), ca.Function("tip", [q], [frames[-1] @ ca.DM(robot.joint_T_tip)])
        qs, us, goal = ca.MX.sym("q", n, count), ca.MX.sym("u", n, count), ca.MX.sym("goal", 4, 4)
        weight = np.full(count, step)
        weight[[0, -1]] *= 0.5
        zeta = FIRST + (LAST - FIRST) * (np.arange(count) / SPANS) ** 2
        total = ca.sum2(ca.DM((weight * zeta)[None]) * ca.sum1(us**2))
        total += WEIGHT * ca.sum2(ca.DM(weight[None]) * cost.map(count)(qs))
        end = tip(qs[:, -1])
        turn = end[:3, :3].T @ goal[:3, :3]
        skew = ca.vertcat(turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1])
        steps = qs[:, 1:] - qs[:, :-1] - step / 2.0 * (us[:, 1:] + us[:, :-1])
        zero = ca.vertcat(ca.vec(steps), qs[:, 0] - ca.DM(HOME), us[:, 0], us[:, -1], end[:3, 3] - goal[:3, 3], skew)
        self.limits = [
            np.concatenate([np.tile(x, count), np.full(n * count, s)]) for x, s in ((robot.lower, -SPEED), (robot.upper, SPEED))
        ]
        quiet = {"ipopt.print_level": 0, "print_time": 0, "ipopt.sb": "yes"}
        options = quiet | {"ipopt.max_iter": iterations, "ipopt.hessian_approximation": "limited-memory"}
        self.solver = ca.nlpsol("printed", "ipopt", {"x": ca.veccat(qs, us), "f": total, "g": zero, "p": ca.vec(goal)}, options)

    def _collisions(self, robot: jaxik.Robot, frames: list[Any]) -> tuple[Any, Any]:
        """The cost of links, each by its nearest, to the robot itself and the stem; and the least distance."""
        ends, radius = {}, {}
        for volume in robot.volumes:
            frame = frames[robot.link_joint[volume.link]] @ ca.DM(robot.link_offset[volume.link])
            ends[volume.link] = [(frame @ ca.DM([*corner, 1.0]))[:3] for corner in volume.corners]
            radius[volume.link] = float(volume.radius)
        stem, total, nearest = [ca.DM([*STEM, 0.0]), ca.DM([*STEM, 2.6])], 0, ca.SX(1e3)
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

    def solve(self, q: np.ndarray, rate: np.ndarray, goal: np.ndarray) -> tuple[np.ndarray, dict[str, Any]]:
        """Solves from samples (101, n): the solution, its cost, iterations, whether the solver says that it has converged."""
        low, high = self.limits
        call = lambda: self.solver(
            x0=np.concatenate([q.ravel(), rate.ravel()]), p=goal.T.ravel(), lbx=low, ubx=high, lbg=0.0, ubg=0.0
        )
        found, seconds = clocked(call)
        status = self.solver.stats()
        converged = status["return_status"] in ("Solve_Succeeded", "Solved_To_Acceptable_Level")
        said = {"cost": float(found["f"]), "iterations": status["iter_count"], "s": seconds, "converged": converged}
        return np.array(found["x"]).ravel()[: q.size].reshape(q.shape), said

    def free(self, robot: jaxik.Robot, q: np.ndarray) -> bool:
        """Whether samples (k, n) of a motion are free, and others between them, at most a millimetre apart."""
        reach = jaxik.collision.continuous_collision.joint_reaches(robot)
        way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(q, axis=0)) @ reach)])
        places = np.linspace(0.0, way[-1], int(way[-1] / 1e-3) + 2)
        rows = np.stack([np.interp(places, way, column) for column in q.T])
        return bool(np.min(self.clearance.map(rows.shape[1])(rows)) >= -TOUCH)


def samples(found: TrajectoryResult, count: int = 1001) -> np.ndarray:
    """(b, count, n) at equal times."""
    at = lambda motion: motion.at(jnp.linspace(0.0, motion.duration, count)).q
    return np.asarray(jax.vmap(at)(found.trajectory))


def judged(robot: jaxik.Robot, peer: Printed, found: TrajectoryResult) -> np.ndarray:
    """Whether each motion converged and is free, by CasADi's distances."""
    good = np.isfinite(found.cost)
    for i, q in enumerate(samples(found)):
        good[i] = good[i] and peer.free(robot, q)
    return good


def missed(robot: jaxik.Robot, guess: np.ndarray) -> np.ndarray:
    """How far from each fruit a guess ends (79,) [m]."""
    ends = np.asarray(jax.vmap(lambda q: jaxik.forward_kinematics(robot, q))(guess[:, -1]))
    return np.linalg.norm(ends[:, :3, 3] - goals()[:, :3, 3], axis=1)


def table(values: np.ndarray) -> list[float]:
    return [float(np.median(values)), float(np.mean(values))]


def redrawn(robot: jaxik.Robot, peer: Printed, guesses: dict[str, np.ndarray]) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Table 6.2: the printed problem from both guesses, each fruit by itself, and all at once."""
    aims, result, drawn = goals(), {}, {}
    reference = dynamic_cost(guesses["heuristic"])
    for name, guess in guesses.items():
        call = lambda rows, guess=guess: optimise_trajectory(
            robot, HOME, aims[rows], scene=scene(), guess=guess[rows], **AS_PRINTED
        )
        call(slice(0, 2))
        each = [clocked(lambda i=i, call=call: call(slice(i, i + 1))) for i in range(0, COUNT, TIMED)]
        seconds = np.array([s for _, s in each])
        found, together = clocked(lambda call=call: call(slice(0, COUNT)))
        good = judged(robot, peer, found) & found.converged
        remaining, sound = found.parts[:, 0] / reference, missed(robot, guesses["heuristic"]) < 1e-3
        result[name] = {
            "guess_free": sum(peer.free(robot, q) for q in guess),
            "guess_reaches": int(np.sum(missed(robot, guess) < 1e-3)),
            "converged": int(found.converged.sum()),
            "converged_and_free": int(good.sum()),
            "remaining": table(remaining[good & sound]),
            "iterations": table(found.iterations),
            "s": table(seconds),
            "together_s": together,
        }
        drawn |= {f"{name}: cost": remaining[good & sound], f"{name}: iterations": found.iterations, f"{name}: s": seconds}
        print(name, result[name], flush=True)
    return result, drawn


def best(
    robot: jaxik.Robot, peer: Printed, guess: np.ndarray, reference: np.ndarray
) -> tuple[dict[str, Any], TrajectoryResult]:
    """All 79 in one batch, several postures each, the margin kept between samples."""
    call = lambda: optimise_trajectory(robot, HOME, goals(), scene=scene(), **PRINTED)
    first = clocked(call)[1]
    times = [clocked(call) for _ in range(5)]
    found, seconds = times[0][0], float(np.median([s for _, s in times]))
    solved = np.asarray(found.success)
    one = lambda i: optimise_trajectory(robot, HOME, goals()[i], scene=scene(), **PRINTED)
    alone = np.array([clocked(lambda i=i: one(i))[1] for i in range(0, COUNT, TIMED)])
    sound = solved & (missed(robot, guess) < 1e-3)
    result = {
        "solved": int(solved.sum()),
        "free": int(judged(robot, peer, found)[solved].sum()),
        "converged": int(found.converged.sum()),
        "remaining": table((found.parts[:, 0] / reference)[sound]),
        "of": int(sound.sum()),
        "iterations": table(found.iterations[solved]),
        "together_s": seconds,
        "first_call_s": first,
        "alone_s": table(alone),
    }
    print("best", result, flush=True)
    return result, found


def beside_ipopt(robot: jaxik.Robot, peer: Printed, guess: np.ndarray, every: int) -> list[dict[str, Any]]:
    """The printed problem from the heuristic guess, by both; and IPOPT again from where jaxik ended."""
    rows, step = [], DURATION / SPANS
    for i in range(0, COUNT, every):
        goal = goals()[i]
        call = lambda i=i, goal=goal: optimise_trajectory(robot, HOME, goal, scene=scene(), guess=guess[i], **CLOSELY)
        ours, seconds = clocked(call)
        q = samples(jax.tree_util.tree_map(lambda x: np.asarray(x)[None], ours), SPANS + 1)[0]
        rate = np.asarray(ours.trajectory.at(jnp.linspace(0.0, DURATION, SPANS + 1)).velocity)
        _, theirs = peer.solve(guess[i], np.gradient(guess[i], step, axis=0), goal)
        _, again = peer.solve(q, rate, goal)
        row = {"fruit": i, "cost": float(ours.cost), "s": seconds, "iterations": int(ours.iterations)}
        rows.append(row | {"ipopt": theirs, "ipopt_from_ours": again})
        print(rows[-1], flush=True)
    return rows


def draw(file: Path, drawn: dict[str, np.ndarray], result: dict[str, Any]) -> None:
    """Figures 6.8 and 6.9 again."""
    figure, axes = plt.subplots(1, 3, figsize=(11, 3.6), layout="constrained")
    panels = (
        ("cost", "remaining dynamic cost", PAPER["remaining"][0]),
        ("iterations", "iterations", 60),
        ("s", "time [s]", 3.44),
    )
    for axis, (what, label, paper) in zip(axes, panels, strict=True):
        names = [name for name in drawn if name.endswith(f": {what}")]
        axis.boxplot([drawn[name] for name in names], showmeans=True, whis=(5, 95))
        axis.set_xticks(range(1, len(names) + 1), [name.split(":")[0] for name in names])
        axis.axhline(paper, color="tab:red", linestyle="--", label="thesis, heuristic guess, median")
        axis.set_ylabel(label)
        if what != "cost":
            axis.set_yscale("log")
    axes[0].legend(fontsize=8)
    figure.suptitle(
        "79 sweet peppers: guesses by a heuristic path and by a straight line; jaxik's optimum from several postures"
    )
    figure.savefig(file, dpi=110)


def main() -> None:
    """All of it; prints, and writes JSON and picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--ipopt", type=int, default=8, help="every so many fruits")
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    arguments = parser.parse_args()
    robot = self_collision.arm()
    peer = Printed(robot)
    start = np.asarray(jaxik.forward_kinematics(robot, HOME), np.float64)
    guesses = {
        "heuristic": followed(robot, [detour(start, goal) for goal in goals()]),
        "straight": followed(robot, [np.stack([start, goal]) for goal in goals()]),
    }
    result: dict[str, Any] = {"machine": machine(), "paper": PAPER}
    result["printed"], drawn = redrawn(robot, peer, guesses)
    reference = dynamic_cost(guesses["heuristic"])
    result["best"], found = best(robot, peer, guesses["heuristic"], reference)
    sound = missed(robot, guesses["heuristic"]) < 1e-3
    drawn |= {"jaxik: cost": (found.parts[:, 0] / reference)[sound], "jaxik: iterations": found.iterations}
    result["ipopt"] = beside_ipopt(robot, peer, guesses["heuristic"], arguments.ipopt)
    arguments.out.write_text(json.dumps(result, indent=1) + "\n")
    draw(arguments.out.with_suffix(".png"), drawn, result)


if __name__ == "__main__":
    main()
