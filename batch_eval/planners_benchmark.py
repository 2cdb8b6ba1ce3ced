"""Planners on the same problems in one run, jaxik, VAMP and OMPL: `python batch_eval/planners_benchmark.py --goals FOLDER`.

Needs `pip install -e ".[test,peers]"`, and `vamp-planner` and `ompl` for their lines; what is not there is left out. Prints,
and writes `batch_eval/planners_benchmark.json`. FOLDER holds a robot of VAMP's and its problems of MotionBenchMaker
(`setups/`). By turns; the least of some rounds counts, of VAMP and of jaxik alike. Lengths are of joints as they are [rad],
which VAMP makes short, and of joints weighted by how far their unit moves the robot at most [m], which jaxik makes short.
Motions are judged from outside: by coal, with at least 5,000 samples a motion and one a millimetre, and their time by toppra
along the same path.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import toppra
from peers.collision_peers import Coal
from peers.motion_judges import deepest, least_time
from peers.planner_peers import HAVE, KernelClock, Ompl, Planned, Vamp
from planning_benchmark import TOUCH, length
from race import clocked, machine
from setups import motionbenchmaker

import jaxik
from jaxik.planning import PlanResult, plan_motion

HIT = 1e-4  # [m] deeper than which a sample counts as a hit
OFTEN, SECONDS = 10, 0.1  # each so manyth problem is given so long for a shorter way
FEW, PATIENCE = 30, 5.0  # problems that OMPL is given, and how long for each [s]
KINDS = "search", "shortcuts", "samples", "proof", "timing"
Goals = list[motionbenchmaker.Goal]


def radians(way: Any) -> float:
    """The length of a way (k, n), joints as they are [rad]."""
    return float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())


class Pair:
    """The outcome of a problem: jaxik's motion and VAMP's way, each with the least times of all rounds."""

    def __init__(self) -> None:
        self.moved: PlanResult | None = None
        self.other: Planned | None = None
        self.kernels: dict[str, float] = dict.fromkeys(KINDS, np.inf)
        self.call = np.inf
        self.search, self.simplify = np.inf, np.inf

    def ours(self, moved: PlanResult, seconds: float, spent: dict[str, float]) -> None:
        self.moved, self.call = moved, min(self.call, seconds)
        self.kernels = {kind: min(least, spent.get(kind, 0.0)) for kind, least in self.kernels.items()}

    def theirs(self, found: Planned | None) -> None:
        self.other = found
        if found:
            self.search, self.simplify = min(self.search, found.search_us), min(self.simplify, found.simplify_us)


def timed(robot: jaxik.Robot, goals: Goals, rounds: int, vamp: Vamp | None) -> list[Pair]:
    """All problems, so often, by turns; the first time, which compiles, does not count."""
    pairs, clock = [Pair() for _ in goals], KernelClock(robot)
    around = [vamp.environment(goal.scene, goal.name) if vamp else None for goal in goals]
    for number in range(-1, rounds):
        for pair, goal, environment in zip(pairs, goals, around, strict=True):
            if vamp and number >= 0:
                pair.theirs(vamp.planned(goal.start, goal.q, environment))
            with clock.running() as spent:
                moved, seconds = clocked(lambda goal=goal: plan_motion(robot, goal.start, goal.q, scene=goal.scene))
            if number >= 0:
                pair.ours(moved, seconds, spent)
    return pairs


def improved(robot: jaxik.Robot, goals: Goals, pairs: list[Pair], vamp: Vamp) -> dict[str, Any]:
    """The lengths of ways with more time, to those without and to VAMP's, where no straight line is free."""
    measures: dict[str, Callable[[Any], float]] = {"rad": radians, "m": lambda way: length(robot, way)}
    rows, took = [], []
    for goal, pair in zip(goals, pairs, strict=True):
        if not (pair.moved and pair.other and pair.moved.rounds):
            continue
        found = vamp.improved(goal.start, goal.q, vamp.environment(goal.scene, goal.name), SECONDS)
        ours = plan_motion(robot, goal.start, goal.q, scene=goal.scene, improve=SECONDS)
        if found and ours:
            took.append(found[1])
            rows.append(
                {
                    name: (m(ours.waypoints), m(pair.moved.waypoints), m(found[0]), m(pair.other.way))
                    for name, m in measures.items()
                }
            )
    result: dict[str, Any] = {"motions": len(rows), "seconds": SECONDS, "vamp_took_s": float(np.mean(took))}
    for name in measures:
        ours, first, theirs, their_first = np.array([row[name] for row in rows]).T
        result[name] = {
            "jaxik": float(np.mean(ours)),
            "vamp": float(np.mean(theirs)),
            "jaxik_to_first": float(np.mean(ours / first)),
            "vamp_to_first": float(np.mean(theirs / their_first)),
            "to_vamp_mean": float(np.mean(ours / theirs)),
            "to_vamp_most": float(np.max(ours / theirs)),
        }
    return result


def by_ompl(robot: jaxik.Robot, goals: Goals, pairs: list[Pair], coal: Coal) -> tuple[dict[str, Any], list[Any]]:
    """OMPL on a few problems; and its ways."""
    some = np.linspace(0, len(goals) - 1, min(FEW, len(goals))).round().astype(int).tolist()
    planner, ways = Ompl(robot, coal), []
    for i in some:
        found = planner.planned(goals[i].start, goals[i].q, goals[i].scene, PATIENCE) if pairs[i].moved else None
        ways.append((i, found))
        coal.scenes.clear()
    solved = [(i, found) for i, found in ways if found]
    result = {
        "problems": sum(bool(pairs[i].moved) for i in some),
        "solved": len(solved),
        "patience_s": PATIENCE,
        "search_ms": percentiles([1e-3 * found.search_us for _, found in solved]),
        "simplify_ms": percentiles([1e-3 * found.simplify_us for _, found in solved]),
        "asked": percentiles([found.iterations for _, found in solved]),
        "jaxik_ms": percentiles([1e3 * pairs[i].call for i, _ in solved]),
        "length_to_jaxik_rad": float(np.mean([radians(found.way) / radians(pairs[i].moved.waypoints) for i, found in solved])),  # type: ignore[union-attr]
    }
    return result, [(i, found.way) for i, found in solved]


def percentiles(values: Any) -> dict[str, float]:
    """The mean, the median, what 95 % stay below, and the most."""
    p50, p95, most = (float(x) for x in np.percentile(values, [50, 95, 100]))
    return {"mean": float(np.mean(values)), "p50": p50, "p95": p95, "most": most}


def speeds(pairs: list[Pair]) -> dict[str, Any]:
    """Where the time goes, in microseconds: jaxik's kernels, what is left, and VAMP's own count."""
    solved = [pair for pair in pairs if pair.moved]
    kernels = {kind: percentiles([1e6 * pair.kernels[kind] for pair in solved]) for kind in KINDS}
    left = [1e6 * (pair.call - sum(pair.kernels.values())) for pair in solved]
    found: dict[str, Any] = {"call": percentiles([1e6 * pair.call for pair in solved]), "python": percentiles(left), **kernels}
    return {"jaxik_us": found, "looks": percentiles([pair.moved.rounds for pair in solved])}  # type: ignore[union-attr]


def beside(robot: jaxik.Robot, pairs: list[Pair]) -> dict[str, Any]:
    """jaxik's searches and ways beside VAMP's, of what both have solved, and searched where both did."""
    both = [pair for pair in pairs if pair.moved and pair.other]
    searched = [pair for pair in both if pair.moved.rounds and pair.other.iterations]  # type: ignore[union-attr]
    ours, theirs = (np.array(x) for x in zip(*((1e6 * p.kernels["search"], p.search) for p in searched), strict=True))
    looks, turns = (np.array(x) for x in zip(*((p.moved.rounds, p.other.iterations) for p in searched), strict=True))  # type: ignore[union-attr]
    found: dict[str, Any] = {
        "search": {
            "problems": len(searched),
            "jaxik_us": percentiles(ours),
            "jaxik_with_samples_us": percentiles([1e6 * (p.kernels["search"] + p.kernels["samples"]) for p in searched]),
            "vamp_us": percentiles(theirs),
            "ratio": percentiles(ours / theirs),
            "ratio_of_p50": float(np.median(ours) / np.median(theirs)),
            "ratio_of_sums": float(ours.sum() / theirs.sum()),
            "jaxik_looks": percentiles(looks),
            "vamp_iterations": percentiles(turns),
            "jaxik_us_a_look": float(ours.sum() / looks.sum()),
            "vamp_us_an_iteration": float(theirs.sum() / turns.sum()),
        },
        "vamp_solved": sum(bool(pair.other) for pair in pairs),
        "straight": {"jaxik": sum(not p.moved.rounds for p in both), "vamp": sum(not p.other.iterations for p in both)},  # type: ignore[union-attr]
        "vamp_simplify_us": percentiles([pair.simplify for pair in both]),
        "vamp_both_us": percentiles([pair.search + pair.simplify for pair in both]),
    }
    for name, measure in ("rad", radians), ("m", lambda way: length(robot, way)):
        mine, first, short = np.array([[measure(x) for x in (p.moved.waypoints, p.other.first, p.other.way)] for p in both]).T  # type: ignore[union-attr]
        found[f"length_{name}"] = {
            "jaxik": float(mine.mean()),
            "vamp_found": float(first.mean()),
            "vamp_simplified": float(short.mean()),
            "ratio": percentiles(mine / short),
            "ratio_of_sums": float(mine.sum() / short.sum()),
            "within_1_1": int(np.sum(mine <= 1.1 * short)),
        }
    return found


def hits(depths: list[tuple[float, int]]) -> dict[str, Any]:
    """How many motions hit, and by more than `HIT`; and the deepest hit [mm]."""
    deep = np.array([depth for depth, _ in depths])
    return {
        "motions": len(deep),
        "samples": int(sum(count for _, count in depths)),
        "hit": int(np.sum(deep > TOUCH)),
        "hit_by_0.1_mm": int(np.sum(deep > HIT)),
        "deepest_mm": 1e3 * float(deep.max(initial=0.0)),
    }


def judged(robot: jaxik.Robot, goals: Goals, pairs: list[Pair], coal: Coal, ways: list[Any]) -> dict[str, Any]:
    """The verdicts of coal and toppra on all motions."""
    depths: dict[str, list[tuple[float, int]]] = {"jaxik": [], "vamp": [], "ompl": []}
    longer, rounded, others = [], [], dict(ways)
    for i, (goal, pair) in enumerate(zip(goals, pairs, strict=True)):
        if pair.moved:
            state = pair.moved.trajectory.sample(1e-3)  # type: ignore[union-attr]
            depths["jaxik"].append(deepest(robot, coal, goal.scene, state.q))
            path, velocity = pair.moved.trajectory.path, np.asarray(robot.velocity)  # type: ignore[union-attr]
            longer.append(pair.moved.trajectory.duration / least_time(path, velocity, 4.0 * velocity))  # type: ignore[union-attr]
            rounded.append(radians(state.q) / radians(pair.moved.waypoints))
        if pair.other:
            depths["vamp"].append(deepest(robot, coal, goal.scene, pair.other.way))
        if i in others:
            depths["ompl"].append(deepest(robot, coal, goal.scene, others[i]))
        coal.scenes.clear()
    return {
        "hits": {name: hits(found) for name, found in depths.items() if found},
        "time_to_toppra": percentiles(longer),
        "rounded_to_waypoints_rad": float(np.mean(rounded)),
    }


def row(robot: jaxik.Robot, goal: motionbenchmaker.Goal, pair: Pair) -> dict[str, Any]:
    """A problem in numbers: times [us], lengths [rad, m], counts."""
    found: dict[str, Any] = {"name": goal.name}
    if pair.moved:
        way = pair.moved.waypoints
        found |= {"call": 1e6 * pair.call, **{kind: 1e6 * pair.kernels[kind] for kind in KINDS}}
        found |= {
            "rad": radians(way),
            "m": length(robot, way),
            "looks": int(pair.moved.rounds),
            "checked": int(pair.moved.checked),
        }
    if pair.other:
        one = pair.other
        found |= {
            "vamp_search": pair.search,
            "vamp_simplify": pair.simplify,
            "vamp_iterations": one.iterations,
            "vamp_nodes": one.nodes,
        }
        found |= {"vamp_found_rad": radians(one.first), "vamp_rad": radians(one.way), "vamp_m": length(robot, one.way)}
    return {key: float(f"{value:.5g}") if isinstance(value, float) else value for key, value in found.items()}


def run(folder: Path, tip: str | None, rounds: int) -> dict[str, Any]:
    """All of it; what takes time comes first, and then a line says so."""
    robot = motionbenchmaker.load_robot(folder, tip)
    goals = list(motionbenchmaker.goals(folder, robot))
    files = motionbenchmaker.files(folder)
    coal = Coal(robot, *files, broad=True, posture=motionbenchmaker.posture(folder, robot))
    vamp = Vamp(robot) if HAVE["vamp"] else None
    pairs = timed(robot, goals, rounds, vamp)
    ways: list[Any] = []
    result: dict[str, Any] = {"robot": robot.name, "problems": len(goals), "rounds": rounds, **speeds(pairs)}
    result["solved"] = sum(bool(pair.moved) for pair in pairs)
    if vamp:
        ends = [(vamp.environment(goal.scene, goal.name), goal) for goal in goals]
        result["vamp_free"] = sum(vamp.free(g.start, around) and vamp.free(g.q, around) for around, g in ends)
        result |= beside(robot, pairs)
        result["improved"] = improved(robot, goals[::OFTEN], pairs[::OFTEN], vamp)
        result["spheres_differ_m"] = vamp.unlike(robot, coal)
    if HAVE["ompl"]:
        result["ompl"], ways = by_ompl(robot, goals, pairs, coal)
    print(json.dumps(result), "timed; now judged", sep="\n", flush=True)
    result |= judged(robot, goals, pairs, coal, ways)
    result["each"] = [row(robot, goal, pair) for goal, pair in zip(goals, pairs, strict=True)]
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--goals", type=Path, required=True, help="a folder of MotionBenchMaker")
    parser.add_argument("--tip", help="the link that its goals are for, where the SRDF names no one end effector")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    wanted = parser.parse_args()
    toppra.setup_logging("ERROR")
    for name in (name for name, there in HAVE.items() if not there):
        print(f"{name} is not installed: its lines are left out")
    result = {"machine": machine(), **run(wanted.goals, wanted.tip, wanted.rounds)}
    each = result.pop("each")
    head = json.dumps(result, indent=1).removesuffix("\n}")
    wanted.out.write_text(head + ',\n "each": [\n  ' + ",\n  ".join(map(json.dumps, each)) + "\n ]\n}\n")
    print(json.dumps({key: result[key] for key in ("hits", "time_to_toppra")}))


if __name__ == "__main__":
    main()
