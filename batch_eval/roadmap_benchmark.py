"""A roadmap of a cell: made, asked, and taken along as a box moves: `python batch_eval/roadmap_benchmark.py FOLDER`.

Needs `pip install -e ".[test,peers]"`. Prints, and writes `batch_eval/roadmap_benchmark.json`. FOLDER holds a robot and its
problems of MotionBenchMaker (`setups/`), of which one is the cell. Its box is put to random places and turns, one after the
other; each time lines and a way are judged from outside: free by coal, wherever no point of the robot has moved by more than
`APART`.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from peers.collision_peers import Coal
from race import clocked, machine, percentiles
from setups import motionbenchmaker

import jaxik
from jaxik.planning import Roadmap, build_roadmap, load_roadmap, plan_motion, save_roadmap

TOUCH = 1e-6  # [m] that float32 does not tell from contact
APART = 5e-3  # [m] that any point of the robot moves at most between samples that are judged
NODES, MOVES, ASKED = 5000, 1000, 300
AROUND = np.array([[0.2, -0.7, 0.0], [0.8, 0.7, 0.8]])  # [m] from the base, where the box is put


class Judge:
    """Coal's word on ways: how many configurations it was asked, and the least clearance of those that hit [m]."""

    def __init__(self, folder: Path, robot: jaxik.Robot):
        self.reach = jaxik.collision.continuous_collision.joint_reaches(robot)
        files, held = motionbenchmaker.files(folder), motionbenchmaker.posture(folder, robot)
        self.coal, self.asked, self.least = Coal(robot, *files, broad=True, posture=held), 0, np.inf

    def free(self, scene: jaxik.Scene, way: np.ndarray) -> bool:
        """Whether straight lines between waypoints (k, n) are free."""
        counts = np.ceil(np.abs(np.diff(way, axis=0)) @ self.reach / APART).astype(int) + 1
        pairs = zip(way[:-1], way[1:], counts, strict=True)
        q = np.concatenate([np.linspace(a, b, k) for a, b, k in pairs])
        self.asked += len(q)
        hit = np.flatnonzero(self.coal.collides(scene, q))
        if not len(hit):
            return True
        self.least = min(self.least, float(self.coal.clearance(scene, q[hit]).min()))
        return self.least >= -TOUCH


def milliseconds(times: list[float]) -> dict[str, float]:
    """The median, what 95 % stay below, and the most."""
    p50, p95 = percentiles(times)
    return {"p50_ms": 1e3 * p50, "p95_ms": 1e3 * p95, "most_ms": 1e3 * max(times)}


def made(robot: jaxik.Robot, scene: jaxik.Scene, nodes: int) -> tuple[Roadmap, dict[str, Any]]:
    """The roadmap, what it took, and what it takes to keep and to read it again."""
    build_roadmap(robot, scene=scene, nodes=64)  # compiles
    roadmap, seconds = clocked(lambda: build_roadmap(robot, scene=scene, nodes=nodes))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cell.npz"
        _, saved = clocked(lambda: save_roadmap(roadmap, path))
        size = path.stat().st_size
        again, loaded = clocked(lambda: load_roadmap(path, robot=robot, scene=scene))
    told = {"nodes": len(roadmap), "lines": len(roadmap.edges), "free": int(roadmap.free.sum()), "build_s": seconds}
    told |= {"connected": int((roadmap.components == 0).sum()), "save_s": saved, "load_s": loaded, "file_MB": size / 1e6}
    return roadmap, told | {"as_before": bool((again.free == roadmap.free).all() and again.checked == 0)}


def asked(roadmap: Roadmap, count: int) -> dict[str, Any]:
    """Questions between nodes and between other free postures, one call each; and the same of `plan_motion`."""
    rng = np.random.default_rng(1)
    pairs = roadmap.nodes[np.stack([rng.permutation(len(roadmap))[:count] for _ in range(2)], axis=1)]
    others = build_roadmap(roadmap.robot, scene=roadmap.scene, nodes=2 * count, neighbours=1, seed=9).nodes.reshape(
        count, 2, -1
    )

    def each(ask: Any, rows: np.ndarray) -> tuple[list[Any], list[float]]:
        ask(*rows[0][::-1])  # warm
        found, times = zip(*(clocked(lambda a=a, b=b: ask(a, b)) for a, b in rows), strict=True)
        return list(found), list(times)

    length = lambda ways: float(np.mean([length_of(roadmap, way.waypoints) for way in ways]))
    result: dict[str, Any] = {}
    for name, rows in {"nodes": pairs, "postures": others}.items():
        calls = {
            "ways": roadmap.way,
            "plans": roadmap.plan,
            "plan_motion": lambda a, b: plan_motion(roadmap.robot, a, b, scene=roadmap.scene),
        }
        answers = {}
        for what, ask in calls.items():
            answers[what], times = each(ask, rows)
            result[f"{name}_{what}"] = milliseconds(times) | {"solved": sum(map(bool, answers[what])), "asked": len(rows)}
        solved = [i for i in range(len(rows)) if all(found[i] for found in answers.values())]
        for what, found in answers.items():
            result[f"{name}_{what}"]["length_m"] = length([found[i] for i in solved])
            if found[solved[0]].trajectory is not None:
                result[f"{name}_{what}"]["duration_s"] = float(np.mean([found[i].trajectory.duration for i in solved]))
    return result


def length_of(roadmap: Roadmap, way: np.ndarray) -> float:
    """The length of a way, joints weighted by how far their unit moves the robot at most [m]."""
    reach = jaxik.collision.continuous_collision.joint_reaches(roadmap.robot)
    return float(np.linalg.norm(np.diff(way, axis=0) * reach, axis=1).sum())


def put(scene: jaxik.Scene, box: int, frame: Any) -> jaxik.Scene:
    """The scene with one of its boxes put elsewhere."""
    frames = np.array(scene.boxes.world_T_box)
    frames[box] = frame
    return dataclasses.replace(scene, boxes=dataclasses.replace(scene.boxes, world_T_box=frames))


def moved(roadmap: Roadmap, judge: Judge, box: int, after: int, moves: int, seconds: float) -> dict[str, Any]:
    """Random moves of a box, `after` so many others and as many as `seconds` allow: what is looked at again, and whether a way
    between random nodes, a line that has become free, and one that has stayed so, are."""
    rng, base = np.random.default_rng([2, after]), np.asarray(roadmap.robot.world_T_base)
    now, times, looked, changed, fault = roadmap, [], [], [], {"ways": 0, "gained": 0, "kept": 0}
    ways, judged = 0, dict.fromkeys(fault, 0)
    scenes = []
    for _ in range(moves):
        frame = base @ np.asarray(jaxik.pose(rng.uniform(*AROUND), rpy=rng.uniform(-np.pi, np.pi, 3)))
        scenes.append(put(roadmap.scene, box, frame))
    for scene in scenes[:2]:
        roadmap.updated(scene)  # compiles
    end = time.monotonic() + seconds
    for scene in scenes:
        if time.monotonic() > end:
            break
        before = now
        now, spent = clocked(lambda scene=scene, before=before: before.updated(scene))
        times.append(spent)
        looked.append(now.checked)
        changed.append(int((now.free != before.free).sum()))
        start, goal = now.nodes[rng.integers(0, len(now), 2)]
        found = now.way(start, goal)
        ways += bool(found)
        some = {"ways": [found.waypoints] if found else []}
        for name, rows in {"gained": now.free & ~before.free, "kept": now.free & before.free}.items():
            picked = rng.permutation(np.flatnonzero(rows))[:1]
            some[name] = [now.nodes[now.edges[row]] for row in picked]
        for name, each in some.items():
            judged[name] += len(each)
            fault[name] += sum(not judge.free(scene, way) for way in each)
        judge.coal.scenes.clear()
    back = now.updated(roadmap.scene)
    return {
        "after": after,
        "moves": len(times),
        "update": milliseconds(times),
        "lines": len(roadmap.edges),
        "looked_at_mean": float(np.mean(looked)),
        "changed_mean": float(np.mean(changed)),
        "ways": ways,
        "judged": judged,
        "hit": fault,
        "samples": judge.asked,
        "back_as_before": bool((back.free == roadmap.free).all()),
    }


def others(robot: jaxik.Robot, goals: list[Any], judge: Judge, roadmap: Roadmap) -> dict[str, Any]:
    """Other problems of the same kind of cell, in which all things stand elsewhere: the roadmap, taken there, beside
    `plan_motion`."""
    found = []
    for goal in goals:
        there, seconds = clocked(lambda goal=goal: roadmap.updated(goal.scene))
        ours, asks = clocked(lambda there=there, goal=goal: there.plan(goal.start, goal.q, rounds=50_000))
        theirs, plans = clocked(lambda goal=goal: plan_motion(robot, goal.start, goal.q, scene=goal.scene))
        free = judge.free(goal.scene, ours.waypoints) if ours else True
        judge.coal.scenes.clear()
        found.append((bool(ours), bool(theirs), free, not ours.rounds, seconds, asks, plans, there.checked / len(there.edges)))
    solved, theirs_solved, free, alone, *times, share = map(list, zip(*found, strict=True))
    names = ("update", "plan", "plan_motion")
    told = {name: milliseconds(each) for name, each in zip(names, times, strict=True)}
    told |= {"problems": len(goals), "solved": sum(solved), "plan_motion_solved": sum(theirs_solved)}
    return told | {"free": all(free), "without_search": sum(alone), "looked_at": float(np.mean(share))}


def main() -> None:
    """All of it; prints, and writes the JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("goals", type=Path, help="a folder of MotionBenchMaker")
    parser.add_argument("--cell", default="table_pick", help="of the first problem whose name has this")
    parser.add_argument("--box", type=int, default=0, help="the number of the box that moves")
    parser.add_argument("--nodes", type=int, default=NODES)
    parser.add_argument("--moves", type=int, default=MOVES)
    parser.add_argument("--seconds", type=float, default=1e6, help="for moves")
    parser.add_argument("--more", action="store_true", help="go on with the moves of an earlier run")
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    arguments = parser.parse_args()
    robot = motionbenchmaker.load_robot(arguments.goals)
    goals = [goal for goal in motionbenchmaker.goals(arguments.goals, robot) if arguments.cell in goal.name]
    judge = Judge(arguments.goals, robot)
    roadmap, result = made(robot, goals[0].scene, arguments.nodes)
    if arguments.more:
        result = json.loads(arguments.out.read_text())
    else:
        result = {"machine": machine(), "cell": goals[0].name, "roadmap": result, "asked": asked(roadmap, ASKED)}
        result |= {"others": others(robot, goals[1:100:5], judge, roadmap), "moved": []}
    judge.asked, before = 0, sum(part["moves"] for part in result["moved"])
    left = arguments.moves - before
    result["moved"].append(moved(roadmap, judge, arguments.box, before, left, arguments.seconds))
    print(json.dumps(result), flush=True)
    arguments.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
