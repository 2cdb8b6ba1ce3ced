"""How fast and how right clearances are beside their peers, all in one run: `python batch_eval/collision_benchmark.py FOLDER`.

Needs `pip install -e ".[test,peers]"`. FOLDER holds a robot of spheres and its problems (`setups/`). Each scene
has its own random configurations inside the limits: `OURS` of them for jaxik, fewer, the first of them, for the peers. Prints
tables and writes `batch_eval/collision_benchmark.json`. `collision_scaling.py` draws how the time grows.
"""

from __future__ import annotations

import argparse
import functools
import json
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from benchmark import show
from peers import arm
from peers.collision_peers import Batched, Coal, MuJoCo, Peer, PyRoki, ScikitRobot
from race import Entry, from_scratch, machine, on_cores, race
from setups import motionbenchmaker

import jaxik

OURS, ARRAYS, LOOPS = 1024, 128, 8  # configurations a scene for jaxik, for peers on JAX, for Python loops
MARGIN = 0.1  # [m] that MuJoCo looks beyond contact for its distances
SEEN = 1e-6  # [m] of clearance that float32 tells from contact


class Work:
    """A robot, its scenes, and random configurations inside its limits for each."""

    def __init__(self, folder: Path, tip: str | None = None):
        self.robot = motionbenchmaker.load_robot(folder, tip)
        self.files = motionbenchmaker.files(folder)
        self.posture = motionbenchmaker.posture(folder, self.robot)
        self.scenes = [goal.scene for goal in motionbenchmaker.goals(folder, self.robot)]
        shape = (len(self.scenes), OURS, self.robot.num_joints)
        self.q = np.random.default_rng(0).uniform(*self.robot.finite_limits, shape).astype(np.float32)
        self.padded = [jax.device_put(scene.geometry()) for scene in self.scenes]

    @functools.cached_property
    def coal(self) -> Coal:
        """The judge."""
        return Coal(self.robot, *self.files, posture=self.posture)

    @functools.cached_property
    def truth(self) -> np.ndarray:
        """The judge's distances of the first configurations in each scene, (scenes, `LOOPS`) [m]."""
        return self.told(self.coal)

    def told(self, peer: Peer) -> np.ndarray:
        """A peer's."""
        return np.stack([peer.clearance(scene, q[:LOOPS]) for scene, q in zip(self.scenes, self.q, strict=True)])

    def ours(self, who: str, function: Callable[..., Any]) -> Entry:
        """`function(robot, scene, q)`, traced, over all scenes and configurations; a program for each size of scene. Scenes are
        put in order before the clock starts, as peers' are made."""
        batch = jax.jit(jax.vmap(lambda scene, q: function(self.robot, scene, q), in_axes=(None, 0)))
        q = [jnp.asarray(rows) for rows in self.q]
        scenes = [jaxik.collision.bvh.grouped(s, self.robot) for s in self.scenes]
        run = lambda: [batch(scene, rows) for scene, rows in zip(scenes, q, strict=True)]
        start = time.perf_counter()
        jax.block_until_ready(run())
        return Entry(who, len(self.scenes) * OURS, run, time.perf_counter() - start)

    def peer(self, who: str, peer: Peer, what: str) -> Entry:
        """A peer's answers, and the largest deviation of its distances, or the share of its answers that agrees."""
        each = ARRAYS if isinstance(peer, Batched) else LOOPS
        rows = [q[:each].astype(np.float64) if each == LOOPS else jnp.asarray(q[:each]) for q in self.q]
        run = lambda: [getattr(peer, what)(scene, q) for scene, q in zip(self.scenes, rows, strict=True)]
        start = time.perf_counter()
        found = np.stack([np.asarray(answer)[:LOOPS] for answer in jax.block_until_ready(run())])
        seconds = time.perf_counter() - start
        if what == "collides":
            return Entry(who, found.size * each // LOOPS, run, seconds, success=float(np.mean(found == (self.truth < 0.0))))
        apart = (self.truth > SEEN) & np.isfinite(found)
        off = float(np.abs(found - self.truth)[apart].max(initial=0.0))
        return Entry(who, found.size * each // LOOPS, run, seconds, off)


def clearances(work: Work) -> list[Entry]:
    """jaxik's first, then its peers', whose errors are those where coal says that nothing touches."""
    ours = [work.ours("jaxik", jaxik.clearance)]
    for entry in ours:
        found = np.stack([np.asarray(rows[:LOOPS]) for rows in entry.run()])
        entry.error = float(np.abs(found - work.truth)[work.truth > SEEN].max(initial=0.0))
    peers = {
        "coal and Pinocchio, Python loop": work.coal,
        f"MuJoCo, contacts within {MARGIN:g} m, Python loop": MuJoCo(work.robot, *work.files, margin=MARGIN),
        "PyRoki, vmap, cylinders as capsules": PyRoki(work.robot, *work.files),
        "scikit-robot on JAX, vmap, cylinders as capsules": ScikitRobot(work.robot, *work.files),
    }
    return [*ours, *(work.peer(who, peer, "clearance") for who, peer in peers.items())]


def collisions(work: Work) -> list[Entry]:
    """Yes or no; `success` is the share of answers that are coal's."""
    ours = work.ours("jaxik", jaxik.collides)
    ours.success = float(np.mean(np.stack([np.asarray(rows[:LOOPS]) for rows in ours.run()]) == (work.truth < 0.0)))
    peers = {
        "coal and Pinocchio, to the first hit, Python loop": work.coal,
        "coal and Pinocchio, broad phase, Python loop": Coal(work.robot, *work.files, broad=True, posture=work.posture),
        "MuJoCo, Python loop": MuJoCo(work.robot, *work.files),
    }
    return [ours, *(work.peer(who, peer, "collides") for who, peer in peers.items())]


def agreement(work: Work) -> dict[str, Any]:
    """jaxik's clearances beside coal's and MuJoCo's [m]. A sphere whose centre is inside a cylinder is measured to the nearest
    way out by jaxik and MuJoCo, along the radius by coal; so depths are held against MuJoCo's."""
    measure = jax.jit(jax.vmap(lambda scene, q: jaxik.clearance(work.robot, scene, q), in_axes=(None, 0)))
    ours = np.stack([np.asarray(measure(scene, q[:LOOPS]), np.float64) for scene, q in zip(work.padded, work.q, strict=True)])
    judges = {"coal": work.truth, "mujoco": work.told(MuJoCo(work.robot, *work.files, margin=MARGIN))}
    found: dict[str, Any] = {"configurations": ours.size, "free": float(np.mean(ours >= 0.0))}
    for who, theirs in judges.items():
        told, off = np.isfinite(theirs), np.abs(ours - theirs)
        found[who] = {
            "apart_m": float(off[told & (theirs > SEEN)].max(initial=0.0)),
            "inside_m": float(off[told & (theirs < -SEEN)].max(initial=0.0)),
            "other_sign": int(np.sum((ours < 0.0) != (theirs < 0.0))),
            "beyond_margin": int(np.sum(~told)),
        }
    print(json.dumps(found))
    return found


def one_core(folder: Path, tip: str | None, rounds: int) -> list[dict[str, Any]]:
    """jaxik's own rows of a process that has one core."""
    with tempfile.TemporaryDirectory() as place:
        out = Path(place) / "rows.json"
        command = [sys.executable, __file__, str(folder), "--ours", "--rounds", str(rounds), "--out", str(out)]
        on_cores(1, *command, *(["--tip", tip] if tip else []))
        return json.loads(out.read_text())["rows"]


def main() -> None:
    """All rows and the JSON; with `--ours` only jaxik's."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="a robot and its MotionBenchMaker problems")
    parser.add_argument("--tip", help="the arm's last link, where its SRDF does not say it")
    parser.add_argument("--ours", action="store_true", help="no peers")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    arguments = parser.parse_args()
    from_scratch()
    work = Work(arguments.folder, arguments.tip)
    spheres, name = sum(len(v.corners) == 1 for v in work.robot.volumes), work.robot.name
    among = f"{name}, {spheres} spheres, {len(work.scenes)} scenes"
    result: dict[str, Any] = {"machine": machine(), "scenes": len(work.scenes), "rows": []}
    print(json.dumps(result["machine"]))
    races: dict[str, Callable[[], list[Entry]]] = {
        "clearance, P6R, 56 spheres to 150 points and to itself": lambda: [arm.clearance_entry(65_536)],
        f"clearance, {among}": lambda: [work.ours("jaxik", jaxik.clearance)] if arguments.ours else clearances(work),
        f"collides, {among}": lambda: collisions(work)[:1] if arguments.ours else collisions(work),
    }
    for title, entries in races.items():
        result["rows"] += show(title, race(entries(), arguments.rounds))
    if not arguments.ours:
        result["agreement"] = agreement(work)
        result["one_core"] = one_core(arguments.folder, arguments.tip, arguments.rounds)
    arguments.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
