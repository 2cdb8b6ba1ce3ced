"""A whole harvest in motion, of the shipped row by P6R: how long it takes, and whether it is free.

`python batch_eval/harvest_motions.py` prints a line a plan and writes `harvest_motions.json` and `.png`. Set-ups: a hose or a
tray at the gripper, where a fruit is let go as soon as it is out of the plants; one crate behind the robot; three; one that
travels along the row. Orders: from left to right with the best posture of each fruit; the same order with the posture that
takes least; the shortest. All are sums of planned motions. `checked` judges the last by distances of its own (NumPy),
wherever no point has moved by more than a millimetre.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import jax
import numpy as np
from race import machine

import jaxik
from jaxik.harvesting import HarvestPlan, HarvestResult, plan_harvest

ORDERS = {
    "left to right, best postures": {"order": "row", "candidates": 1},
    "left to right, chosen postures": {"order": "row"},
    "shortest": {"order": "shortest"},
}
BLOCK = 256  # configurations
MARGIN = 0.002  # [m] of the motions; postures keep 5 mm


def crates(x: Any) -> np.ndarray:
    """Tip frames (k, 4, 4) in P6R's base: behind it, at these places along the row [m], the fruit hanging into the crate."""
    frames = np.tile(np.eye(4), (len(x), 1, 1))
    frames[:, :3, :3] = np.stack([(0.0, 0.0, -1.0), (1.0, 0.0, 0.0), (0.0, -1.0, 0.0)], axis=1)  # x down, z away from the row
    frames[:, :3, 3] = [(each, -0.45, 0.55) for each in x]
    return np.linalg.inv(jaxik.load("p6r").world_T_base) @ frames


SETUPS = {
    "hose or tray at the gripper": None,
    "one crate": crates([0.5]),
    "three crates": crates([0.1, 0.5, 0.9]),
    "a crate that travels along": crates(np.linspace(0.0, 1.0, 9)),
}


# --------------------------------------------------------------------------------------------------------------------
# Distances in NumPy: the robot's spheres, the fruit that it holds and the scene's points and capsules


def least(scene: jaxik.Scene, gone: set[str], balls: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """The least distance (..., objects) [m] of balls (..., a, 3), one radius a column, to each object left in the scene."""
    left, each = scene.without(list(gone)), np.full((*balls.shape[:-2], len(scene.object_names)), np.inf)
    balls = balls.astype(np.float32)
    points, start, end = (np.asarray(x, np.float32) for x in (left.points.center, left.capsules.a, left.capsules.b))
    along = end - start
    squares = np.sum(balls**2, axis=-1)[..., None] + np.sum(points**2, axis=-1) - 2.0 * balls @ points.T
    to_points = np.sqrt(squares.clip(0.0)) - radius[:, None] - left.points.radius
    away = balls[..., None, :] - start
    share = np.clip(np.sum(away * along, axis=-1) / np.sum(along**2, axis=-1).clip(1e-12), 0.0, 1.0)
    to_lines = np.linalg.norm(away - share[..., None] * along, axis=-1) - radius[:, None] - left.capsules.radius
    for owners, distance in ((scene.owners[0], to_points), (scene.owners[2], to_lines)):
        nearest = distance.min(axis=-2)  # of all balls
        for i, owner in enumerate(owners):
            each[..., owner] = np.minimum(each[..., owner], nearest[..., i])
    return each


def between(balls: np.ndarray, radius: np.ndarray, others: np.ndarray, other_radius: np.ndarray, pairs: np.ndarray) -> float:
    """The least distance of balls (k, a, 3) to others (k, b, 3), of those pairs (a, b) that count."""
    apart = np.linalg.norm(balls[:, :, None] - others[:, None], axis=-1) - radius[:, None] - other_radius
    return float(np.where(pairs, apart, np.inf).min())


def checked(plan: HarvestPlan, step: float = 1e-3) -> dict[str, float]:
    """The least clearance of a plan [m], the largest shares of the limits, and how many configurations were looked at, between
    which no ball moves by more than `step` [m]. The robot must be boxes alone, and the fruits capsules.

    Balls nearer than the margin to a fruit where it hangs do not count for it until the end of its retreat."""
    robot, scene = plan.robot, plan.scene
    one = lambda q: (*jaxik.collision.robot_spheres(robot, q), robot.world_T_base @ jaxik.forward_kinematics(robot, q))
    each = jax.jit(jax.vmap(one))
    links = np.repeat(sorted(box.link for box in robot.boxes), robot.spheres_per_box)
    pairs = np.array([[(a, b) in robot.self_pairs for b in links] for a in links])
    others = np.array([[robot.link_joint[link] < robot.num_joints for link in links]])
    gone, found = set(), {"clearance": np.inf, "velocity": 0.0, "acceleration": 0.0, "beyond": 0.0, "samples": 0}
    for stage in plan.stages:
        if stage.kind == "retreat":
            row = scene.owners[2].index(scene.object_names.index(stage.fruit))
            body = np.linspace(scene.capsules.a[row], scene.capsules.b[row], 61)
            thick = np.full(len(body), float(scene.capsules.radius[row]))
            gone.add(stage.fruit)
            touching = least(scene, gone, body, thick) < MARGIN

        def placed(count: int, stage: Any = stage) -> Any:
            state = stage.trajectory.sample(float(stage.trajectory.duration) / count)
            blocks = np.resize(state.q, (-(-len(state.q) // BLOCK), BLOCK, robot.num_joints))  # of one size: it compiles once
            parts = [[np.asarray(x) for x in each(block)] for block in blocks]
            return state, *(np.concatenate(x)[: len(state.q)] for x in zip(*parts, strict=True))

        state, centres, radii, frames = placed(32)
        moved = np.linalg.norm(np.diff(centres, axis=0), axis=-1).max()
        if stage.kind == "retreat":
            held = (body - frames[0, :3, 3]) @ frames[0, :3, :3]
        swept = lambda frames: held @ np.swapaxes(frames[:, :3, :3], 1, 2) + frames[:, None, :3, 3]  # noqa: B023
        if stage.carries:
            moved = max(moved, np.linalg.norm(np.diff(swept(frames), axis=0), axis=-1).max())
        state, centres, radii, frames = placed(int(np.ceil(32 * 1.1 * moved / step)) + 1)
        here = gone | {stage.fruit} if stage.kind == "approach" else gone
        clear = [least(scene, here, centres, radii[0]).min(), between(centres, radii[0], centres, radii[0], pairs)]
        if stage.carries:
            distance = least(scene, gone, swept(frames), thick)
            if stage.kind == "retreat":
                distance[:-1, touching] = np.inf
            clear += [distance.min(), between(swept(frames), thick, centres, radii[0], others)]
        found["clearance"] = min(found["clearance"], *map(float, clear))
        found["velocity"] = max(found["velocity"], float(np.max(np.abs(state.velocity) / robot.velocity)))
        found["acceleration"] = max(found["acceleration"], float(np.max(np.abs(state.acceleration) / (4.0 * robot.velocity))))
        found["beyond"] = max(found["beyond"], float(np.max([robot.lower - state.q, state.q - robot.upper])))
        found["samples"] += len(state.q)
    return found


# --------------------------------------------------------------------------------------------------------------------


def planned(harvested: HarvestResult, judged: bool = False, **how: Any) -> dict[str, Any]:
    """A plan's figures, and what the check says if it is asked."""
    plans = [plan_harvest(harvested, margin=MARGIN, **how) for _ in range(4)]  # the first one compiles
    plan, seconds = plans[-1], min(plan.seconds for plan in plans)
    kinds = ("transfer", "approach", "retreat", "transport", "home")
    by_kind = {kind: sum(stage.end - stage.start for stage in plan.stages if stage.kind == kind) for kind in kinds}
    rows = {row.fruit: row.duration if row.stages else row.why for row in plan}
    result = {"picked": len(plan.order), "order": plan.order, "fruits": rows, "total_s": plan.duration, "cycle_s": plan.cycle}
    result |= {"by_kind_s": by_kind, "leaves": len(plan.leaves), "planning_s": seconds}
    return result | ({"checked": checked(plan)} if judged else {})


def draw(result: dict[str, Any], path: Path) -> None:
    """Draws the seconds of each plan, by kind of motion."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 4.6), layout="constrained")
    axis, colours = figure.add_subplot(), ("#0072B2", "#009E73", "#7fcdb4", "#E69F00", "#bbbbbb")
    places = []
    for i, (setup, plans) in enumerate(result["setups"].items()):
        for k, (order, row) in enumerate(plans.items()):
            left = 0.0
            places.append((4 * i + k, f"{setup}: {order}" if k == 0 else order))
            for (kind, seconds), colour in zip(row["by_kind_s"].items(), colours, strict=True):
                axis.barh(4 * i + k, seconds, left=left, color=colour, label=kind if len(places) == 1 else None)
                left += seconds
            axis.text(left + 0.2, 4 * i + k, f"{row['cycle_s']:.2f} s a fruit", va="center", fontsize=8)
    axis.set_yticks(*zip(*places, strict=True), fontsize=8)
    axis.invert_yaxis()
    axis.set_xlabel("motions of the whole row [s]")
    axis.set_xlim(0, 1.12 * axis.get_xlim()[1])
    axis.spines[["top", "right"]].set_visible(False)
    axis.legend(fontsize=8, frameon=False)
    figure.savefig(path, dpi=110)


def main() -> None:
    """Plans all; prints, and writes JSON and picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    out = parser.parse_args().out
    harvested = jaxik.harvest(jaxik.load("p6r"), jaxik.load_scene("cucumber_row"), margin=0.005)
    result: dict[str, Any] = {"machine": machine(), "fruits": len(harvested), "postures": int(harvested.success.sum())}
    result |= {"harvest_s": harvested.seconds, "setups": {}, "leaves": {}}
    for setup, place in SETUPS.items():
        for order, how in ORDERS.items():
            row = planned(harvested, order == "shortest", place=place, **how)
            result["setups"].setdefault(setup, {})[order] = row
            print(f"{setup}, {order}: {_took(row)}", row.get("checked", ""))
    for leaves in ("brush", "ignore"):
        row = result["leaves"][leaves] = planned(harvested, leaves=leaves)
        print(f"{leaves}: {_took(row)}, {row['leaves']} leaves")
    out.write_text(json.dumps(result, indent=1) + "\n")
    draw(result, out.with_suffix(".png"))


def _took(row: dict[str, Any]) -> str:
    return f"{row['picked']} in {row['total_s']:.2f} s, planned in {row['planning_s']:.1f} s"


if __name__ == "__main__":
    main()
