"""Where to stand: gradient ascent of a smooth reach score against coarse grids. `python batch_eval/base_placement.py`

p6r beside the shipped row, its base anywhere in a box of shifts along y and z and turns about the vertical. The grids try
n x n x n bases of the box, each grid one sweep of the row's fruits; the ascents follow the gradient of the fruits' scores, from
the robot's own place in the middle and from corners of the box. All are judged by the same sweep: how many fruits have a
posture at any of 24 angles. Writes `base_placement.json` and `.png`.
"""

from __future__ import annotations

import itertools
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure
from race import machine

import jaxik

OUT = Path(__file__).with_suffix(".json")
ROBOT, SCENE = jaxik.load("p6r"), jaxik.load_scene("cucumber_row")
MARGIN = 0.005  # [m]
ANGLES = 24  # a fruit is picked at any of them
POSES = [jaxik.reach.Grasp().frames(fruit, ANGLES)[::2] for fruit in SCENE.marks]
AROUND = [SCENE.without([fruit.name]).geometry() for fruit in SCENE.marks]
BOX = np.array([0.5, 0.5, np.radians(40.0)])  # [m, m, rad] to either side
GRIDS = (2, 3, 4, 5, 6)
NAMES = "ascent from where it stands", "ascents from corners"
STEPS, STRIDE = 20, np.array([0.05, 0.05, 0.1])  # [m, m, rad]


def placed(base: Any) -> Any:
    """world_T_base at shifts along y, z [m] and a turn about the vertical [rad]."""
    y, z, yaw = base
    c, s, zero, one = jnp.cos(yaw), jnp.sin(yaw), jnp.zeros_like(y), jnp.ones_like(y)
    rows = [[c, -s, zero, zero], [s, c, zero, y], [zero, zero, one, z], [zero, zero, zero, one]]
    return jnp.stack([jnp.stack(row) for row in rows]) @ ROBOT.world_T_base


def picked(y: Any, z: Any, yaw: Any) -> np.ndarray:
    """Fruits with a posture from every base of a grid (ny, nz, nyaw), by one sweep of the row's fruits and angles."""
    study = {"robot": "p6r", "slides": 21, "audited": 0, "refine": 0, "chunk": 300, "collision": {"margin": MARGIN}}
    study |= {"targets": {"kind": "marks", "scenes": [SCENE], "angles": ANGLES}}
    study |= {"base": {k: np.atleast_1d(v).tolist() for k, v in (("y", y), ("z", z), ("yaw", yaw))}}
    with tempfile.TemporaryDirectory() as folder:
        reachable = jaxik.sweep(study, f"{folder}/s.zarr").dataset().reachable.values
    fruits = reachable.reshape(-1, len(SCENE.marks), ANGLES).any(axis=2).sum(axis=1)
    return fruits.reshape(*(np.size(v) for v in (y, z, yaw)))


@jax.jit
def score(base: Any, poses: Any, q: Any, scene: Any) -> Any:
    return jax.value_and_grad(lambda b: jaxik.reach.log_reach_score(ROBOT.mounted(placed(b)), scene, poses, q, margin=MARGIN))(
        base
    )


def ascend(base: np.ndarray) -> tuple[np.ndarray, list[Any]]:
    """Adam on the sum of the fruits' log scores, in which one that cannot be picked weighs most; the postures are looked for
    again in every step."""
    history, mean, square = [], np.zeros(3), np.zeros(3)
    best, best_value = base, -np.inf
    for i in range(1, STEPS + 1):
        robot = ROBOT.mounted(np.asarray(placed(jnp.asarray(base))))
        value, slope = 0.0, np.zeros(3)
        for poses, scene in zip(POSES, AROUND, strict=True):
            at, q = jaxik.reach.likely_postures(robot, scene, poses, slides=6, margin=MARGIN)
            v, g = score(jnp.asarray(base, jnp.float32), at.astype(np.float32), q, scene)
            value, slope = value + float(v), slope + np.asarray(g, float)
        history.append([*map(float, base), value])
        if value > best_value:
            best, best_value = base, value
        mean, square = 0.7 * mean + 0.3 * slope, 0.9 * square + 0.1 * slope**2
        step = mean / (1.0 - 0.7**i) / (np.sqrt(square / (1.0 - 0.9**i)) + 1e-6)
        base = np.clip(base + STRIDE * step * (1.0 - i / (STEPS + 1.0)), -BOX, BOX)
    return best, history


def timed(work: Any) -> tuple[Any, float]:
    start = time.perf_counter()
    found = work()
    return found, time.perf_counter() - start


def main() -> None:
    here = int(picked(0.0, 0.0, 0.0).item())
    ascend(np.zeros(3))  # compiles; the times are then those of the work
    ascents = []
    for share in [(0.0, 0.0, 0.0), *itertools.product((-0.6, 0.6), repeat=3)]:
        (best, history), seconds = timed(lambda share=share: ascend(BOX * share))
        count, more = timed(lambda best=best: int(picked(*best).item()))
        ascents.append({"start": list(BOX * share), "base": best.tolist(), "picked": count, "seconds": seconds + more})
        ascents[-1]["history"] = history
    grids = []
    for n in GRIDS:
        axes = [np.linspace(-side, side, n) for side in BOX]
        counts, seconds = timed(lambda axes=axes: picked(*axes))
        first = np.unravel_index(counts.argmax(), counts.shape)
        base = [float(axis[i]) for axis, i in zip(axes, first, strict=True)]
        grids.append({"bases": counts.size, "base": base, "picked": int(counts.max()), "seconds": seconds})
        grids[-1]["all"] = np.column_stack([*(x.ravel() for x in np.meshgrid(*axes, indexing="ij")), counts.ravel()]).tolist()
    result = {"machine": machine(), "fruits": len(SCENE.marks), "where_it_stands": here, "ascents": ascents, "grids": grids}
    OUT.write_text(json.dumps(result, indent=1) + "\n")
    print(f"of {len(SCENE.marks)} fruits {here} are picked from where it stands")
    for each in ascents:
        print(f"ascent from {np.round(each['start'], 2)}: {each['picked']} in {each['seconds']:.1f} s")
    for each in grids:
        print(f"grid of {each['bases']} bases: {each['picked']} in {each['seconds']:.1f} s")
    draw(result)


def draw(result: dict[str, Any]) -> None:
    figure = Figure(figsize=(13, 4.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    grid = np.array(result["grids"][-1]["all"])
    best = np.array([grid[(grid[:, 0] == y) & (grid[:, 1] == z)][:, 3].max() for y, z in grid[:, :2]])
    dots = left.scatter(grid[:, 0], grid[:, 1], c=best, s=140, cmap="viridis", vmin=0, vmax=result["fruits"])
    figure.colorbar(dots, ax=left, label="fruits picked (best turn of the grid)")
    for i, each in enumerate(result["ascents"]):
        path = np.array(each["history"])
        left.plot(path[:, 0], path[:, 1], "r.-" if i == 0 else "b.-", lw=1, ms=3, label=NAMES[i > 0])
        left.plot(*each["base"][:2], "r*" if i == 0 else "b*", ms=11)
    left.set(xlabel="shift along y [m]", ylabel="shift along z [m]", title="where to stand: ascents over the finest grid")
    left.legend(*map(lambda x: x[:2], left.get_legend_handles_labels()), loc="lower left")
    right.plot(*np.array([[g["seconds"], g["picked"]] for g in result["grids"]]).T, "ko-", label="best of a grid")
    for g in result["grids"]:
        right.annotate(f"{g['bases']}", (g["seconds"], g["picked"]), textcoords="offset points", xytext=(4, -12))
    for i, each in enumerate(result["ascents"]):
        label = NAMES[i > 0] if i < 2 else None
        right.plot(each["seconds"], each["picked"], "r*" if i == 0 else "b*", ms=13 if i == 0 else 8, label=label)
    right.axhline(result["where_it_stands"], color="0.6", ls=":", label="where it stands")
    title = {"ylabel": f"fruits picked, of {result['fruits']}", "title": "at what cost"}
    right.set(xlabel="seconds", ylim=(-0.5, result["fruits"] + 0.5), **title)
    right.legend(loc="lower right")
    figure.savefig(OUT.with_suffix(".png"), dpi=110)


if __name__ == "__main__":
    main()
