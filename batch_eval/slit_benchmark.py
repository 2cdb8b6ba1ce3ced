"""A slim arm through a slot of 20 mm: `python batch_eval/slit_benchmark.py [--seeds 20]`.

Needs `pip install -e ".[test,peers]"`. Prints, and writes `batch_eval/slit_benchmark.json`. Six joints, links of 12 mm and a
sphere of 16 or 18 mm at the tip; a plate, 10 or 50 mm thick, that the arm cannot reach around has one slot, 20 mm wide and
240 mm long, upright, level or oblique. From a random posture before the plate the tip is to reach a random point 40 to 120 mm
behind its middle. Each seed is a problem of its own and the search's seed. A motion is judged from outside, as those of
`planning_benchmark.py`.
"""

from __future__ import annotations

import argparse
import functools
import json
import tempfile
from pathlib import Path
from typing import Any

import jax
import numpy as np
from peers.collision_peers import Coal
from planning_benchmark import judged
from race import clocked, machine, percentiles

import jaxik
from jaxik.planning import plan_motion

HERE = Path(__file__).parent
SLOT, LONG, PLATE = 0.02, 0.24, 2.4  # [m] its width and length; the plate's edges
SPEED = 2.0  # [rad/s] of each joint
AT = np.array([0.45, 0.0, 0.4])  # [m] the slot's middle
TURNS = {"upright": 0.0, "oblique": 45.0, "level": 90.0, "slanting": 120.0}  # [deg] about the plate's normal
BEHIND, ASIDE = (0.04, 0.12), 0.08  # [m] of the plate, and along the slot from its middle: where goals are
WITHIN = 2.0  # [s] the time that is asked for
CASES = ((0.008, 0.01), (0.009, 0.01), (0.009, 0.05))  # [m] the radius of the tip, and how thick the plate is
LINK = '<body name="{0}" pos="0 0 {1}"><joint name="{0}" axis="{2}" range="{3} {4}"/>{5}'
ROD = '<geom type="capsule" size="0.006" fromto="0 0 0 0 0 {0}" mass="0.1"/>'


def arm(radius: float) -> str:
    """The arm as MJCF: a shoulder of two axes, an elbow, a wrist of three; 0.8 m from the shoulder to the tip, a sphere."""
    tip = f'<geom type="sphere" size="{radius}" pos="0 0 0.13" mass="0.05"/><site name="tip" pos="0 0 0.13"/>'
    links = [
        ("yaw", 0.25, "0 0 1", -3.1, 3.1, '<geom type="sphere" size="0.01" mass="1"/>'),
        ("shoulder", 0.0, "0 1 0", -2.0, 2.4, ROD.format(0.35)),
        ("elbow", 0.35, "0 1 0", -2.7, 2.7, ROD.format(0.06)),
        ("roll", 0.06, "0 0 1", -3.1, 3.1, ROD.format(0.2)),
        ("pitch", 0.2, "0 1 0", -2.2, 2.2, ROD.format(0.06)),
        ("turn", 0.06, "0 0 1", -3.1, 3.1, ROD.format(0.13) + tip),
    ]
    bodies = "".join(LINK.format(*link) for link in links) + "</body>" * len(links)
    return f'<mujoco model="slim"><compiler angle="radian"/><worldbody>{bodies}</worldbody></mujoco>'


def plate(thick: float, degrees: float) -> jaxik.Scene:
    """The plate with its slot, turned about its normal, as four boxes."""
    turn, middle = np.deg2rad(degrees), 0.25 * (PLATE + SLOT)
    world_T_slot = np.eye(4)
    world_T_slot[1:3, 1:3] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    world_T_slot[:3, 3] = AT
    end = 0.25 * (PLATE + LONG)
    places = [(0.0, middle, 0.0), (0.0, -middle, 0.0), (0.0, 0.0, end), (0.0, 0.0, -end)]
    beside, beyond = (thick, 0.5 * (PLATE - SLOT), PLATE), (thick, SLOT, 0.5 * (PLATE - LONG))
    frames = [world_T_slot @ _moved(place) for place in places]
    return jaxik.make_scene(boxes=list(zip(frames, [beside, beside, beyond, beyond], strict=True)))


def _moved(place: Any) -> np.ndarray:
    frame = np.eye(4)
    frame[:3, 3] = place
    return frame


def problem(robot: jaxik.Robot, scene: jaxik.Scene, degrees: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A posture before the plate, nothing of it in the slot, and one with the tip behind."""
    rng, turn = np.random.default_rng(seed), np.deg2rad(degrees)
    along = np.array([0.0, -np.sin(turn), np.cos(turn)])
    free = jax.vmap(lambda q: jaxik.clearance(robot, scene, q))
    q = rng.uniform(robot.lower, robot.upper, (4096, robot.num_joints))
    tips = np.asarray(jax.vmap(lambda q: jaxik.forward_kinematics(robot, q))(q))[:, 0, 3]
    before = (tips < AT[0]) & (np.asarray(free(q)) > SLOT)
    points = AT + rng.uniform(*BEHIND, (32, 1)) * [1.0, 0.0, 0.0] + rng.uniform(-ASIDE, ASIDE, (32, 1)) * along
    found = jaxik.solve_ik(robot, points, task=jaxik.Task.position(), scene=scene, seed=seed)
    return q[before][0], found.q[np.flatnonzero(found.success)[0]]


def run(radius: float, thick: float, seeds: int, timeout: float) -> dict[str, Any]:
    """All turns of the slot and all seeds, one call each, warm."""
    path = Path(tempfile.mkdtemp()) / "slim.xml"
    path.write_text(arm(radius))
    robot = jaxik.load(path, tip="tip")
    coal = Coal(robot, path, None, broad=True)
    found = {}
    for name, degrees in TURNS.items():
        scene, rows = plate(thick, degrees), []
        for seed in range(seeds):
            start, goal = problem(robot, scene, degrees, seed)
            asked = functools.partial(plan_motion, robot, start, goal, scene=scene, velocity=SPEED, seed=seed, timeout=timeout)
            if not rows:
                asked()  # compiles
            moved, seconds = clocked(asked)
            free = judged(robot, coal, scene, moved)["free"] if moved else None
            rows.append({"seed": seed, "solved": bool(moved), "s": seconds, "rounds": int(moved.rounds), "free": free})
        times = [row["s"] for row in rows]
        p50, p95 = percentiles(times)
        found[name] = {
            "solved": sum(row["solved"] for row in rows),
            "within": sum(row["solved"] and row["s"] < WITHIN for row in rows),
            "free": sum(bool(row["free"]) for row in rows),
            "p50_s": p50,
            "p95_s": p95,
            "slowest_s": max(times),
            "motions": rows,
        }
        print(radius, thick, name, {key: value for key, value in found[name].items() if key != "motions"}, flush=True)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--timeout", type=float, default=20.0, help="[s] of one search")
    wanted = parser.parse_args()
    slots = [
        {"tip_m": 2.0 * radius, "thick_m": thick, "slots": run(radius, thick, wanted.seeds, wanted.timeout)}
        for radius, thick in CASES
    ]
    result = {"machine": machine(), "slot_m": SLOT, "seeds": wanted.seeds, "within_s": WITHIN, "cases": slots}
    (HERE / "slit_benchmark.json").write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
