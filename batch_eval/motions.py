"""Whether `motion_clearance` ever says free where a dense sampling hits, and how tight its bound is: random motions.

`python batch_eval/motions.py` prints a line a robot and writes `batch_eval/motions.json`. Half of the obstacles are thin: stems
of one to three millimetres, plates of two, bare points. A motion begins at a random free configuration and goes a random share
of the way to another. The truth is `clearance` in float64 at `SAMPLES` equal steps, and finer about the least of them; the
bound is in float32. Needs `pip install -e ".[test]"`; three of the robots are those of example-robot-data, with their collision
meshes.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from peers.panda import ROBOTS as FOLDER
from race import processor

import jaxik

COUNT = 100_000  # motions, over all robots
SAMPLES, FINER = 4000, 64  # of a motion, and between the least one's neighbours
BLOCK = 4096  # motions a call
RESOLUTION = 1e-3  # [m]
MARGINS = (0.0, 0.005)  # [m], in turn
CLUTTER = 5  # obstacles of each kind
ROBOTS = {  # file under example-robot-data and tip; or a shipped model
    "p6r": None,
    "chembuly9": None,
    "crops_v2": None,
    "pendulum4": None,
    "Panda": ("panda_description/urdf/panda.urdf", "panda_link8"),
    "UR10": ("ur_description/urdf/ur10_robot.urdf", "tool0"),
    "TIAGo": ("tiago_description/robots/tiago_no_hand.urdf", "wrist_ft_tool_link"),
}
# of the motions: the truth of capsules among boxes takes a hundred times that of spheres
SHARES = {"p6r": 0.6, "chembuly9": 0.1, "crops_v2": 0.0025, "pendulum4": 0.0025, "Panda": 0.19, "UR10": 0.1, "TIAGo": 0.005}


def load_robot(name: str) -> jaxik.Robot:
    """One of `ROBOTS`, with its collision geometry."""
    place = ROBOTS[name]
    return jaxik.load(name) if place is None else jaxik.load(FOLDER / place[0], tip=place[1], meshes=True, posture={})


def obstacles(robot: jaxik.Robot) -> jaxik.Scene:
    """Thin ones and thick ones about where the robot's parts come, by a fixed seed; none that is nearly always
    in the way."""
    rng, limits = np.random.default_rng(16), robot.finite_limits
    frames = jax.jit(jax.vmap(lambda q: jaxik.forward_kinematics(robot, q)))(rng.uniform(*limits, (500, robot.num_joints)))
    places = np.asarray(frames)[:, :3, 3] @ robot.world_T_base[:3, :3].T + robot.world_T_base[:3, 3]
    reach = float(np.linalg.norm(places - places.mean(axis=0), axis=1).max())

    def frame() -> np.ndarray:
        found = np.eye(4)
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        found[:3, :3], found[:3, 3] = turn * np.sign(np.linalg.det(turn)), somewhere()
        return found

    somewhere = lambda: rng.choice(places) + rng.normal(size=3) * 0.05 * reach
    size = lambda *shape: reach * rng.uniform(0.03, 0.1, shape)

    def stem() -> list[float]:
        middle, half = somewhere(), rng.normal(size=3)
        half *= 0.25 * reach / np.linalg.norm(half)
        return [*(middle - half), *(middle + half), rng.uniform(0.001, 0.003)]

    scene = jaxik.make_scene(
        points=[somewhere() for _ in range(CLUTTER)],
        spheres=[[*somewhere(), size()] for _ in range(CLUTTER)],
        capsules=[stem() for _ in range(2 * CLUTTER)],
        boxes=[(frame(), edges) for _ in range(CLUTTER) for edges in (size(3), [*size(2), 0.002])],
        cylinders=[(frame(), 0.002, size()) for _ in range(CLUTTER)],
    )
    apart = jax.jit(jax.vmap(lambda q: jaxik.collision.object_clearances(robot, scene, q)))(
        rng.uniform(*limits, (500, robot.num_joints))
    )
    often = np.mean(np.asarray(apart) < 0.01, axis=0) > 0.1
    return scene.without(np.flatnonzero(often).tolist())


def motions(robot: jaxik.Robot, scene: jaxik.Scene, count: int, seed: int = 17) -> tuple[np.ndarray, np.ndarray]:
    """`count` of them: (count, n) twice, in float32; the first ends are free."""
    rng, limits = np.random.default_rng(seed), robot.finite_limits
    measure = jax.jit(jax.vmap(lambda q: jaxik.clearance(robot, scene, q)))
    kept: list[np.ndarray] = []
    while sum(map(len, kept)) < count:
        q = rng.uniform(*limits, (BLOCK, robot.num_joints)).astype(np.float32)
        kept.append(q[np.asarray(measure(q)) > max(MARGINS) + 2.0 * RESOLUTION])
    q_from = np.concatenate(kept)[:count]
    share = rng.uniform(0.0, 0.5, (count, 1)) ** 2
    return q_from, (q_from + share * (rng.uniform(*limits, q_from.shape) - q_from)).astype(np.float32)


def dense(robot: jaxik.Robot, scene: jaxik.Scene | None, samples: int = SAMPLES) -> Any:
    """q_from, q_to, margin -> the least clearance of the samples, and the first fraction that does not keep the margin."""

    @jaxik.kernel
    def least(q_from: Any, q_to: Any, margin: Any) -> Any:
        def sample(low: Any, high: Any, count: int) -> Any:
            def one(i: Any, found: Any) -> Any:
                t = low + (high - low) * i / count
                apart = jaxik.clearance(robot, scene, q_from + t * (q_to - q_from))
                first = jnp.where((apart <= margin) & jnp.isinf(found[2]), t, found[2])
                return jnp.minimum(apart, found[0]), jnp.where(apart < found[0], t, found[1]), first

            return lax.fori_loop(0, count + 1, one, (jnp.inf, 0.0, jnp.inf))

        apart, at, first = sample(0.0, 1.0, samples)
        finer, _, _ = sample(jnp.maximum(at - 1.0 / samples, 0.0), jnp.minimum(at + 1.0 / samples, 1.0), FINER)
        return jnp.minimum(apart, finer), first

    return jax.jit(jax.vmap(least))


def judged(robot: jaxik.Robot, scene: jaxik.Scene | None, q_from: np.ndarray, q_to: np.ndarray, samples: int) -> dict[str, Any]:
    """Counts of what must not be, and the bound's slack."""
    margin = np.resize(np.float32(MARGINS), len(q_from))
    asked = lambda a, b, m, **enough: jaxik.motion_clearance(robot, scene, a, b, margin=m, resolution=RESOLUTION, **enough)
    bound = jax.jit(jax.vmap(asked))
    hits = jax.jit(jax.vmap(lambda a, b, m: ~asked(a, b, m, enough=m).free))
    truth = dense(robot, scene, samples)

    def timed(f: Any) -> tuple[Any, float]:
        blocks = [slice(i, i + BLOCK) for i in range(0, len(q_from), BLOCK)]
        jax.block_until_ready(f(q_from[:BLOCK], q_to[:BLOCK], margin[:BLOCK]))
        start = time.perf_counter()
        parts = [jax.tree_util.tree_map(np.asarray, f(q_from[b], q_to[b], margin[b])) for b in blocks]
        spent = time.perf_counter() - start
        return jax.tree_util.tree_map(lambda *x: np.concatenate(x), *parts), 1e6 * spent / len(q_from)

    (found, bound_us), (collides, collides_us) = timed(bound), timed(hits)
    (least, first), _ = timed(lambda a, b, m: truth(a.astype(np.float64), b.astype(np.float64), m.astype(np.float64)))
    free, slack = np.asarray(found.free), least - found.clearance
    hit = least <= margin
    return {
        "motions": len(q_from),
        "free": int(free.sum()),
        "dense sampling hits": int(hit.sum()),
        "free, but the dense sampling hits": int((free & hit).sum()),
        "does not collide, but the dense sampling hits": int((~collides & hit).sum()),
        "bound above the least": int((free & (slack < 0.0)).sum()),
        "contact after the first hit": int((found.contact > first).sum()),
        "not free with the resolution to spare": int((~free & (least > margin + RESOLUTION + 1e-4)).sum()),
        "collides with the resolution to spare": int((collides & (least > margin + RESOLUTION + 1e-4)).sum()),
        "slack_mm": {k: 1e3 * float(v) for k, v in zip(("mean", "95 %", "most"), _spread(slack[free]), strict=True)},
        "evaluations": {k: float(v) for k, v in zip(("mean", "95 %", "most"), _spread(found.evaluations[free]), strict=True)},
        "motion_clearance_us": bound_us,
        "enough_us": collides_us,
    }


def _spread(values: np.ndarray) -> tuple[Any, Any, Any]:
    return values.mean(), np.percentile(values, 95), values.max()


def main() -> None:
    """All robots; prints, and writes the JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=COUNT, help="motions over all robots")
    parser.add_argument("--samples", type=int, default=SAMPLES, help="of the dense sampling, a motion")
    parser.add_argument("--robots", nargs="+", choices=ROBOTS, default=list(ROBOTS))
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    result: dict[str, Any] = {"cpu": processor(), "jax": jax.__version__, "samples": arguments.samples, "robots": {}}
    if arguments.robots != list(ROBOTS) and arguments.out.exists():  # the others' rows stay
        result["robots"] = json.loads(arguments.out.read_text())["robots"]
    for name in arguments.robots:
        robot = load_robot(name)
        scene = obstacles(robot)
        q_from, q_to = motions(robot, scene, round(SHARES[name] * arguments.count))
        row = result["robots"][name] = judged(robot, scene, q_from, q_to, arguments.samples)
        print(f"{name:10s} {json.dumps(row)}", flush=True)
        arguments.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
