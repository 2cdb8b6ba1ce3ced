"""A Panda over a table, among things that drop in while it moves: `python batch_eval/replan_benchmark.py [--seeds N]`.

The arm goes to and fro between random free postures within Franka's limits, and a `jaxik.Replanner` is told the world 30 times
a second, which is another one each time. Twenty boxes, cylinders and balls appear at random times between two updates: a
quarter of them anywhere over the table, the others near the coming way of its tip, and only where the motion by which it would
stop at the next update keeps `FREE` from them, for what falls on the arm cannot be avoided, and where the goal does. The set
points, a thousand a second, are judged from outside: by coal, whether they hit, and by their finite differences, whether they
keep the limits. One run is killed, and its log replayed. Prints, and writes `batch_eval/replan_benchmark.json`. Needs
`pip install ".[test,peers]"`.
"""

from __future__ import annotations

import argparse
import gc
import json
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from jerk_benchmark import FRANKA
from peers.collision_peers import CoalOfVolumes
from race import machine

import jaxik
from jaxik.replanning import Command, Event

RATE, SAMPLE = 30.0, 1e-3  # updates [1/s]; set points [s]
LASTS, DROPS, THINGS = 10.0, 9.0, 20  # of a run [s], the part of it in which things appear, and how many do
MARGIN, FREE = 0.01, 0.03  # [m] that motions keep; that a thing keeps from the motion that stops the arm
LOW, HIGH = np.array([0.2, -0.7, 0.05]), np.array([0.8, 0.7, 0.9])  # of the places of things [m]
HOME = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.8, 0.8])
PATIENCE = 0.5  # [s] that the arm stands blocked before it is given another goal
ANYWHERE = 0.25  # share of things that may be anywhere over the table; the others are near the arm's coming way
MEASURED = 11  # set points of which one is measured, beside being asked whether it hits
SUMS = "hits", "set points", "things", "goals", "other goals", "late"
TRIES = 200  # places that are drawn for a thing, before it is left out


def table() -> jaxik.Scene:
    """The table, a ball far away that trembles, so that the world is another one in each update, and room for all things."""
    scene = jaxik.make_scene(boxes=[[0.6, 0.0, -0.06, 0.8, 1.6, 0.1]]).with_("far", spheres=[[0.0, 0.0, 0.0, 0.1]])
    return scene.with_room(boxes=THINGS + 1, cylinders=THINGS, spheres=THINGS + 1)


def trembling(scene: jaxik.Scene, number: int) -> jaxik.Scene:
    """The scene, its ball away from the arm, at another place in each update."""
    pose = np.eye(4)
    pose[:3, 3] = 3.0 + 0.01 * np.sin(number), 0.0, 0.5
    return scene.moved("far", pose)


def thing(rng: np.random.Generator, place: np.ndarray) -> dict[str, Any]:
    """A box, a cylinder or a ball, as `Scene.with_` takes it."""
    kind = rng.integers(3)
    if kind == 0:
        return {"boxes": [[*place, *rng.uniform(0.04, 0.12, 3)]]}
    if kind == 1:
        return {"cylinders": [[*place, rng.uniform(0.02, 0.05), rng.uniform(0.06, 0.2)]]}
    return {"spheres": [[*place, rng.uniform(0.02, 0.06)]]}


class Run:
    """One arm, its world, and what is noted of it."""

    def __init__(self, robot: jaxik.Robot, seed: int, log: Path | None = None):
        self.robot, self.rng, self.scene, self.goal = robot, np.random.default_rng(seed), table(), HOME
        self.arm = jaxik.Replanner(robot, HOME, scene=trembling(self.scene, 0), seed=seed, log=log, margin=MARGIN, **FRANKA)
        gc.collect()
        gc.freeze()  # or a collection in the midst of the loop looks at all that JAX holds
        self.coal = CoalOfVolumes(robot, broad=True)
        self.due = np.sort(self.rng.uniform(0.0, DROPS, THINGS)).tolist()
        self.points: list[np.ndarray] = []
        self.worlds: list[jaxik.Scene] = []
        self.events: list[Command] = []
        self.seconds: dict[str, list[float]] = {"kept": [], "new": [], "tried": []}
        self.blocked, self.left_out, self.goals, self.others = 0, 0, 0, 0

    def step(self, number: int) -> Command:
        """One update, and the set points from it to the next."""
        now = number / RATE
        while self.due and self.due[0] <= now:
            self.drop(now - self.due.pop(0), now)
        told = trembling(self.scene, number)
        begin = time.perf_counter()
        command = self.arm.update(now, told)
        seconds = time.perf_counter() - begin
        kind = "kept" if command.event in (Event.KEPT, Event.ARRIVED) else "new" if self.is_new(command) else "tried"
        self.seconds[kind].append(seconds)
        self.events.append(command)
        first, last = (int(np.ceil(k / RATE / SAMPLE - 1e-9)) for k in (number, number + 1))
        self.points.append(self.arm.at(SAMPLE * np.arange(first, last)).q)
        self.worlds.append(told)
        self.ask(command)
        return command

    def is_new(self, command: Command) -> bool:
        """Whether a command has another motion than the one before."""
        return not self.events or command.course is not self.events[-1].course

    def ask(self, command: Command) -> None:
        """Gives another goal where the arm has arrived, or has stood blocked for a while."""
        self.blocked = self.blocked + 1 if command.event is Event.BLOCKED else 0
        arrived = command.event is Event.ARRIVED
        if arrived or self.blocked > PATIENCE * RATE:
            self.goals, self.others, self.blocked = self.goals + arrived, self.others + (not arrived), 0
            self.goal = self.posture()
            self.arm.go(self.goal)

    def posture(self) -> np.ndarray:
        """A random posture that is free."""
        while True:
            q = self.rng.uniform(self.robot.lower, self.robot.upper)
            if self.coal.clearance(self.worlds[-1], q[None])[0] > FREE:
                return q

    def drop(self, before: float, now: float) -> None:
        """Puts a thing into the world that appeared so long [s] before the update at `now`, where the arm can still stop."""
        stop = self.arm.stopping(now)
        lasts = max(stop.end - now, 0.0)
        times = now + np.arange(-before, lasts + 0.01, 0.01)
        path = np.concatenate([stop.at(np.maximum(times, max(now - before, 0.0))).q, self.goal[None]])
        for _ in range(TRIES):
            kind = thing(self.rng, self.place(now))
            alone = jaxik.make_scene(**kind)
            if self.coal.clearance(alone, path).min() > FREE:
                self.scene = self.scene.with_(f"thing {len(self.scene.object_names)}", **kind)
                return
        self.left_out += 1

    def place(self, now: float) -> np.ndarray:
        """A place over the table, or near the way of the arm's tip behind where it would stop."""
        last, first = self.events[-1].course.end, self.arm.stopping(now).end
        if self.rng.random() < ANYWHERE or last <= first:
            return self.rng.uniform(LOW, HIGH)
        q = self.arm.at(self.rng.uniform(first, last)).q
        near = np.asarray(jaxik.forward_kinematics(self.robot, q))[:3, 3]
        return near + self.rng.normal(0.0, 0.04, 3)


def grouped(run: Run) -> list[tuple[np.ndarray, jaxik.Scene]]:
    """The set points between two changes, and the world then; the ball far away does not count."""
    first = [i for i, world in enumerate(run.worlds) if not i or world.object_names != run.worlds[i - 1].object_names]
    ends = [*first[1:], len(run.worlds)]
    return [(np.concatenate(run.points[a:b]), run.worlds[a]) for a, b in zip(first, ends, strict=True)]


def judged(run: Run) -> dict[str, Any]:
    """The hits of a run's set points, by coal, and the greatest shares of the limits, by finite differences."""
    hits, least = 0, np.inf
    for points, world in grouped(run):
        moving = np.r_[True, (np.diff(points, axis=0) != 0.0).any(axis=1)]
        hits += int(run.coal.collides(world, points[moving]).sum())
        least = min(least, float(run.coal.clearance(world, points[moving][::MEASURED]).min(initial=np.inf)))
    q = np.concatenate(run.points)
    shares = {
        name: float(np.max(np.abs(np.diff(q, order, axis=0)) / SAMPLE**order / np.asarray(FRANKA[name])))
        for order, name in enumerate(("velocity", "acceleration", "jerk"), 1)
    }
    return {"hits": hits, "least distance": least, "set points": len(q), **shares}


def row(run: Run) -> dict[str, Any]:
    """The findings of a run."""
    kinds = [each.event for each in run.events]
    counts = {event.value: kinds.count(event) for event in Event}
    late = sum(each.late for each in run.events)
    refused = Counter(
        f"{each.refusal.where or 'way'}: {jaxik.Reason(each.refusal.reason).text}" for each in run.events if each.refusal
    )
    things = len(run.scene.object_names) - 2
    found = judged(run) | {"things": things, "goals": run.goals, "other goals": run.others, "late": late}
    return found | {"events": counts, "refused": dict(refused)}


def simulated(robot: jaxik.Robot, seed: int, log: Path | None = None) -> Run:
    """A whole run."""
    run = Run(robot, seed, log)
    for number in range(int(LASTS * RATE)):
        run.step(number)
    return run


def killed(folder: Path) -> dict[str, Any]:
    """Kills a run in another process in its midst, and replays its log."""
    log = folder / "killed.jsonl"
    child = subprocess.Popen([sys.executable, __file__, "--child", str(log)])
    while not log.exists() or len(log.read_bytes().splitlines()) < 200:
        time.sleep(0.05)
        if child.poll() is not None:
            raise RuntimeError("the run ended before it was killed")
    child.send_signal(signal.SIGKILL)
    child.wait()
    told, again = jaxik.Replanner.replay(log)
    same = sum(one == record.command for one, record in zip(again, told.records, strict=True))
    return {"updates": len(told.records), "same": same, "bytes": log.stat().st_size}


def quantiles(seconds: list[float]) -> dict[str, float]:
    """Quantiles of times [ms], and how many there are."""
    p50, p99, slowest = (1e3 * np.quantile(seconds, (0.5, 0.99, 1.0))).tolist()
    return {"count": len(seconds), "p50": p50, "p99": p99, "slowest": slowest}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    parser.add_argument("--child", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    robot = jaxik.load("panda")
    if given.child is not None:
        simulated(robot, 0, given.child)
        return
    rows: list[dict[str, Any]] = []
    seconds: dict[str, list[float]] = {"kept": [], "new": [], "tried": []}
    for seed in range(given.seeds):
        run = simulated(robot, seed)
        rows.append(row(run))
        for kind, some in run.seconds.items():
            seconds[kind] += some
        print(
            seed, {name: round(value, 3) if isinstance(value, float) else value for name, value in rows[-1].items()}, flush=True
        )
    total = {
        name: sum(each[name] for each in rows) for name in ("hits", "set points", "things", "goals", "other goals", "late")
    }
    total |= {name: max(each[name] for each in rows) for name in ("velocity", "acceleration", "jerk")}
    total |= {"least distance": min(each["least distance"] for each in rows)}
    total |= {"refused": dict(sum((Counter(each["refused"]) for each in rows), Counter()))}
    total |= {"events": {event.value: sum(each["events"][event.value] for each in rows) for event in Event}}
    with tempfile.TemporaryDirectory() as folder:
        replayed = killed(Path(folder))
    found = {"machine": machine(), "seeds": given.seeds, "seconds": LASTS, **total, "replayed": replayed}
    found |= {"times [ms]": {kind: quantiles(some) for kind, some in seconds.items() if some}}
    print(json.dumps(found, indent=2))
    given.out.write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
