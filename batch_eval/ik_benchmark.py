"""How fast and how sure `solve_ik` is beside its peers, all in one run: `python batch_eval/ik_benchmark.py [--goals FOLDER]`.

Needs `pip install -e ".[test,peers]"`. Prints tables and writes `batch_eval/ik_benchmark.json`. FOLDER holds a robot and its
problems of MotionBenchMaker (`setups/`); without it that part is left out. All answers are judged by Pinocchio,
those among obstacles also by coal.
"""

from __future__ import annotations

import argparse
import functools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fresh
import jax
import numpy as np
from peers import ik_peers, panda
from peers.collision_peers import Coal
from peers.panda import pose_of
from race import clocked, from_scratch, machine, percentiles
from setups import motionbenchmaker, problems
from setups.problems import POSITION, ROTATION, targets

import jaxik

ROBOTS = {  # file under example-robot-data, tip; or a data sheet, or a shipped model
    "Panda": ("panda_description/urdf/panda.urdf", "panda_link8"),
    "UR5": ("ur_description/urdf/ur5_robot.urdf", "tool0"),
    "iiwa 14": None,
    "TIAGo, with its lift": ("tiago_description/robots/tiago_no_hand.urdf", "wrist_ft_tool_link"),
    "p6r": None,
    "crops_v2": None,
    "chembuly9": None,
}
CLOSED = ("UR5", "iiwa 14")  # of these also by search alone, and with all answers
ALL = 200  # targets of which all are asked for


def load_robot(name: str) -> jaxik.Robot:
    """One of `ROBOTS`."""
    place = ROBOTS[name]
    if place is None:
        return jaxik.load(problems.sheet(name) if name in problems.SHEETS else name)
    return jaxik.load(panda.bare_urdf(panda.ROBOTS / place[0], place[1]), tip=place[1])


def judge(robot: jaxik.Robot, q: np.ndarray, poses: np.ndarray, *tolerances: float) -> float:
    """The share of configurations inside the limits that have their poses, by Pinocchio."""
    pose = pose_of(robot)
    reached = np.stack([pose(row) if np.isfinite(row).all() else np.full((4, 4), np.nan) for row in q])
    return problems.solved(robot, q, reached, poses, *tolerances)


def timed(run: Callable[[], Any], rounds: int) -> tuple[Any, float, float]:
    """Returns what `run` returns, the time of its first call, and the median of the others [s]."""
    result, first = clocked(run)
    return result, first, float(np.median([clocked(run)[1] for _ in range(rounds)]))


def row(who: str, count: int, first: float, each: float, success: float) -> dict[str, Any]:
    """One line of the result, printed."""
    line = {"who": who, "targets": count, "us_each": 1e6 * each / count, "first_call_s": first, "success": success}
    print(
        f"{who:48s} {count:6d} targets {line['us_each']:12.1f} us each, first call {first:6.1f} s, solved {100 * success:.2f} %"
    )
    return line


def beside_peers() -> list[dict[str, Any]]:
    """The Panda, random reachable poses."""
    urdf = panda.urdf_file()
    robot = jaxik.load(urdf, tip=panda.TIP)
    poses, rows = targets(robot, 2000), []
    asked = {"position_tolerance": POSITION, "rotation_tolerance": ROTATION, "collision": False}  # as its peers
    ours = lambda poses: jaxik.solve_ik(robot, poses, **asked).q
    q, first, each = timed(lambda: ours(poses), 15)
    rows.append(row("Panda: jaxik", len(poses), first, each, judge(robot, q, poses)))
    (_, first), *alone = [clocked(lambda pose=pose: ours(pose)) for pose in poses[:201]]
    each, p95 = percentiles([spent for _, spent in alone])
    success = judge(robot, np.stack([q for q, _ in alone]), poses[1:201])
    rows.append(row("Panda: jaxik", 1, first, each, success) | {"p95_us_each": 1e6 * p95})
    for name, solver, count in (
        ("PyRoki, vmap, one start, hard limits", functools.partial(ik_peers.pyroki_solver, hard_limits=True), 200),
        ("PyRoki, vmap, one start, soft limits", functools.partial(ik_peers.pyroki_solver, hard_limits=False), 200),
        ("scikit-robot, 10 starts, 30 steps", functools.partial(ik_peers.skrobot_solver, steps=30), 1000),
        ("scikit-robot, 10 starts, 100 steps", functools.partial(ik_peers.skrobot_solver, steps=ik_peers.STEPS), 1000),
        ("pytorch-kinematics, 10 starts", ik_peers.torch_solver, 1000),
        ("mink, up to 10 starts", ik_peers.mink_solver, 100),
        ("pink, up to 10 starts", ik_peers.pink_solver, 100),
    ):
        run = solver(urdf)
        q, first, each = timed(lambda run=run, count=count: run(poses[:count]), 3)
        rows.append(row(f"Panda: {name}", count, first, each, judge(robot, q, poses[:count])))
    return rows


def other_robots() -> list[dict[str, Any]]:
    """Success and time on every robot; of arms whose closed form answers, beside the search that other arms have, and with all
    their answers; and EAIK's on the one whose six joints it knows a decomposition of."""
    rows = []
    for name in ROBOTS:
        robot = load_robot(name)
        poses = targets(robot, 2000)
        solve = lambda count=None, robot=robot, poses=poses, **options: jaxik.solve_ik(
            robot, poses[:count], position_tolerance=POSITION, rotation_tolerance=ROTATION, collision=False, **options
        )
        result, first, each = timed(solve, 15)
        rows.append(row(f"{name}, {robot.num_joints} joints: jaxik", len(poses), first, each, judge(robot, result.q, poses)))
        if name in CLOSED:
            searched, first, each = timed(functools.partial(solve, seeds="library"), 15)
            rows.append(row(f"{name}: jaxik, by search alone", len(poses), first, each, judge(robot, searched.q, poses)))
            rows.append(all_answers(name, robot, poses[:ALL], functools.partial(solve, ALL, solutions="all")))
        if name == "UR5":
            run = ik_peers.eaik_solver(robot)
            q, first, each = timed(lambda run=run, poses=poses: run(poses), 5)
            rows.append(row("UR5: EAIK", len(poses), first, each, judge(robot, q, poses)))
    return rows


def all_answers(name: str, robot: jaxik.Robot, poses: np.ndarray, solve: Callable[[], Any]) -> dict[str, Any]:
    """Every different answer of each target; the success is of all of them."""
    result, first, each = timed(solve, 3)
    owner, number = np.nonzero(np.isfinite(result.solutions[..., 0]))
    success = judge(robot, result.solutions[owner, number], poses[owner])
    line = row(f"{name}: jaxik, solutions='all'", len(poses), first, each, success)
    return line | {"solutions": float(np.mean(result.num_solutions))}


LOOSE = {"position_tolerance": 1e-4, "rotation_tolerance": 1e-3}  # of the goals among obstacles [m], [rad]
TOUCH = 1e-6  # [m] that float32 does not tell from contact
AROUND, SPREAD, EVERY = 100, 0.2, 10  # targets a batch, their joints' deviation from the goal's, and which scenes have one


def goals(folder: Path, tip: str | None = None) -> dict[str, Any]:
    """MotionBenchMaker's goals among obstacles, to 1e-4 m and 1e-3 rad: one call each, and batches of targets of a scene.

    Judged from outside: the pose by Pinocchio, free of collision by coal. A goal's own configuration may collide, too; those
    that do not are `own_free`, and all of them have an answer.
    """
    robot = motionbenchmaker.load_robot(folder, tip)
    problems = list(motionbenchmaker.goals(folder, robot))
    pose, coal = pose_of(robot), Coal(robot, *motionbenchmaker.files(folder), posture=motionbenchmaker.posture(folder, robot))
    wanted = [pose(goal.q) for goal in problems]
    for _ in range(2):  # the first round compiles
        each = [
            clocked(lambda goal=goal, target=target: jaxik.solve_ik(robot, target, scene=goal.scene, **LOOSE))
            for goal, target in zip(problems, wanted, strict=True)
        ]
    answers, times = zip(*each, strict=True)
    solved = np.array([bool(answer.success) for answer in answers])
    apart = []
    for goal, answer in zip(problems, answers, strict=True):
        apart.append(coal.clearance(goal.scene, np.stack([goal.q, answer.q])) >= -TOUCH)
        coal.scenes.clear()  # the pairs of 700 scenes are gigabytes
    own, free = np.transpose(apart)
    p50, p95 = percentiles(times)
    result = {
        "robot": robot.name,
        "elsewhere": sum(bool(goal.elsewhere) for goal in problems),
        "goals": len(problems),
        "solved": float(np.mean(solved)),
        "of_these_exact": judge(robot, np.stack([a.q for a in answers])[solved], np.stack(wanted)[solved], 1e-4, 1e-3),
        "free": int((solved & free).sum()),
        "own_free": int(own.sum()),
        "own_free_solved": int((own & solved).sum()),
        "p50_ms": 1e3 * p50,
        "p95_ms": 1e3 * p95,
        "mean_ms": 1e3 * float(np.mean(times)),
        "failed": {g.name: a.reason.text for g, a in zip(problems, answers, strict=True) if not a.success},
        "fresh": fresh.first_goals(folder, tip, np.stack(wanted)),
        "batch": goal_batches(robot, problems[::EVERY]),
    }
    print(json.dumps(result))
    return result


def goal_batches(robot: jaxik.Robot, problems: list[motionbenchmaker.Goal]) -> dict[str, float]:
    """Calls for many targets of one scene. The data set has one goal a scene; so a batch is the goal and the poses of random
    configurations around it that are free, `SPREAD` about each joint [rad, m] and less where there is no room: all of them have
    an answer. One call a scene, warm."""
    pose, rng = pose_of(robot), np.random.default_rng(0)
    measure = jax.jit(jax.vmap(lambda scene, q: jaxik.clearance(robot, scene, q), in_axes=(None, 0)))
    solved, times = [], []
    for goal in problems:
        free, spread = goal.q[None], SPREAD
        while len(free) < AROUND:
            near = np.clip(goal.q + spread * rng.normal(size=(512, robot.num_joints)), robot.lower, robot.upper)
            room = np.asarray(measure(goal.scene.geometry(), near.astype(np.float32))) > TOUCH
            free, spread = np.concatenate([free, near[room]])[:AROUND], spread / 2.0
        targets = np.stack([pose(q) for q in free])
        solve = lambda goal=goal, targets=targets: jaxik.solve_ik(robot, targets, scene=goal.scene, **LOOSE)
        solve()  # a new size of scene compiles
        answers, spent = clocked(solve)
        solved.append(judge(robot, answers.q, targets, 1e-4, 1e-3))
        times.append(spent / AROUND)
    p50, p95 = percentiles(times)
    figures = {"mean_ms": 1e3 * float(np.mean(times)), "p50_ms": 1e3 * p50, "p95_ms": 1e3 * p95}
    return {"scenes": len(problems), "each": AROUND, "solved": float(np.mean(solved))} | figures


def main() -> None:
    """Run all parts and write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--goals", type=Path, help="folder with a robot's MotionBenchMaker problems")
    parser.add_argument("--tip", help="its arm's last link, where its SRDF does not say it")
    parser.add_argument("--only-goals", action="store_true", help="neither peers nor other robots")
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    arguments = parser.parse_args()
    from_scratch()
    result: dict[str, Any] = {"machine": machine()}
    print(json.dumps(result["machine"]))
    result["cold_s"], result["second_process_s"] = fresh.first_call("solve_ik of ten targets")
    seconds = f"{result['cold_s']:.2f} s, with its kernels on disk {result['second_process_s']:.2f} s"
    print(f"first call in a fresh process, of ten targets: {seconds}")
    if not arguments.only_goals:
        result["panda"] = beside_peers()
        result["robots"] = other_robots()
    if arguments.goals:
        result["goals"] = goals(arguments.goals, arguments.tip)
    arguments.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
