"""Figure 7 of van Henten et al. (2003) drawn anew, and the six-joint case that was too slow: `python batch_eval/astar.py`.

Writes `astar.json` and `astar.png` beside itself. The paper prints neither link lengths nor stems, so its 146 nodes forward and
117 backward cannot be met; what can is held: every length is Dijkstra's, by SciPy, and backward expands fewer nodes where the
goal is enclosed. Stems stand here by a rule, squares of 10 cm every 40 cm along a row.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path
from typing import Any

import jax
import matplotlib.pyplot as plt
import numpy as np
from papers.grid_planner import plan_on_grid
from papers.grid_search import Grid, shortest
from race import clocked, machine
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

import jaxik

STEP = np.radians(5.0)  # the paper's
STEMS = [[0.4 * i - 1.6, 1.0, 0.0, 0.1, 0.1, 1.0] for i in range(9)]
START, FRUIT = np.zeros(2), np.array([0.4, 1.25])  # straight along the row; behind the stem at x = 0.4
SIX = {"degrees": 15.0, "slide": 0.3}


def planar() -> tuple[jaxik.Robot, jaxik.Scene, np.ndarray]:
    """Two links of 1 m, the row of stems, and the posture at the fruit that is free."""
    robot, scene = jaxik.load("planar2"), jaxik.make_scene(boxes=STEMS)
    pose = jaxik.pose([*FRUIT, 0.0])
    in_plane = jaxik.Task.pose(("z", "roll", "pitch", "yaw"), axes="base")
    return robot, scene, jaxik.solve_ik(robot, pose, scene=scene, task=in_plane, choice="clearance").q


def truth(nodes: np.ndarray, hits: np.ndarray, start: np.ndarray, goal: np.ndarray) -> float:
    """The length of the shortest way over a square grid of nodes (k, k, 2), by SciPy's Dijkstra."""
    k = len(nodes)
    number = np.arange(k * k).reshape(k, k)
    pairs = np.concatenate(
        [np.stack([number[1:].ravel(), number[:-1].ravel()]), np.stack([number[:, 1:].ravel(), number[:, :-1].ravel()])], 1
    )
    free = ~(hits.ravel()[pairs[0]] | hits.ravel()[pairs[1]])
    graph = csr_matrix((np.full(free.sum(), STEP), pairs[:, free]), (k * k, k * k))
    node = lambda q: int(np.argmin(np.linalg.norm(nodes.reshape(-1, 2) - q, axis=1) + 1e9 * hits.ravel()))
    return float(dijkstra(graph, directed=False, indices=node(start))[node(goal)])


def figure_7(file: Path) -> dict[str, Any]:
    """The counts, and the picture."""
    robot, scene, goal = planar()
    values = np.arange(-np.pi, np.pi + 1e-9, STEP)
    nodes = np.stack(np.meshgrid(values, values, indexing="ij"), axis=-1)
    collides = jax.jit(jax.vmap(lambda q: jaxik.collides(robot, scene, q)))
    hits = np.asarray(collides(nodes.reshape(-1, 2).astype(np.float32))).reshape(nodes.shape[:2])
    result: dict[str, Any] = {"nodes": hits.size, "free": int((~hits).sum()), "dijkstra": truth(nodes, hits, START, goal)}
    for direction in ("forward", "backward", "both"):
        for name, how in {"one by one": {"batch": 1, "euclidean": True}, "in batches": {"batch": 256}}.items():
            run = lambda how=how, direction=direction: plan_on_grid(robot, START, goal, scene=scene, direction=direction, **how)
            run()
            found, seconds = clocked(run)
            row = {"expanded": found.expanded, "judged": found.judged, "length": found.length, "ms": 1e3 * seconds}
            result[f"{direction}, {name}"] = row
            print(f"{direction:9s} {name:11s} {row}")
    draw(file, robot, hits, START, goal)
    return result


def draw(file: Path, robot: jaxik.Robot, hits: np.ndarray, start: np.ndarray, goal: np.ndarray) -> None:
    """The row from above with the motion, and the space of the joints with what each search looked at."""
    scene = jaxik.make_scene(boxes=STEMS)
    figure, axes = plt.subplots(1, 3, figsize=(13, 4.3), layout="constrained")
    how = {"scene": scene, "batch": 1, "euclidean": True}
    found = {d: plan_on_grid(robot, start, goal, direction=d, **how) for d in ("forward", "backward")}
    for box in STEMS:
        axes[0].add_patch(plt.Rectangle((box[0] - 0.05, box[1] - 0.05), 0.1, 0.1, color="0.35"))
    way = found["forward"].waypoints
    for i, q in enumerate(way[np.linspace(0, len(way) - 1, 6).astype(int)]):
        joints = np.cumsum([[0.0, 0.0], *[[np.cos(a), np.sin(a)] for a in np.cumsum(q)]], axis=0)
        axes[0].plot(*joints.T, "-o", color=plt.get_cmap("viridis")(i / 6), markersize=4)
    axes[0].plot(*FRUIT, "*", color="tab:red", markersize=12)
    axes[0].set(aspect="equal", xlabel="x [m]", ylabel="y [m]", title="a motion from above, stems, a fruit")
    extent = [-182.5, 182.5] * 2
    for ax, (direction, one) in zip(axes[1:], found.items(), strict=True):
        ax.imshow(hits.T, origin="lower", extent=extent, cmap="gray_r", alpha=0.7)
        seen = visited(hits, *((start, goal) if direction == "forward" else (goal, start)))
        ax.plot(*np.degrees(seen.T), ".", color="tab:blue", markersize=3)
        ax.plot(*np.degrees(one.waypoints.T), color="tab:red")
        for name, q in (("S", start), ("G", goal)):
            ax.annotate(name, np.degrees(q), color="tab:red", weight="bold")
        ax.set(
            xlabel="first joint [deg]",
            ylabel="second joint [deg]",
            title=f"{direction}: {one.expanded} nodes (blue); dark collides",
        )
    figure.savefig(file, dpi=110)


def visited(hits: np.ndarray, start: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """The configurations that a search judges, one by one (m, 2)."""
    grid, seen = Grid(np.full(2, -np.pi), np.full(2, STEP), hits.shape), []

    def free(q: np.ndarray) -> np.ndarray:
        seen.extend(q)
        return ~hits[tuple(np.round((q - grid.origin) / STEP).astype(int).T)]

    ends = [next(node for node in grid.nearest(q) if not hits.ravel()[node]) for q in (start, goal)]
    shortest(grid, free, *ends, euclidean=True)
    return np.array(seen)


def six_joints() -> dict[str, Any]:
    """The P6R, its slide held, from a posture in the aisle to a fruit of the shipped row; the paper's case was "prohibitively
    slow"."""
    whole, scene = jaxik.load("p6r"), jaxik.load_scene("cucumber_row")
    row = next(row for row in jaxik.harvest(whole, scene) if row and row.q[0] > 0.0)
    hold = lambda limit: np.concatenate([row.q[:1], limit[1:]])
    robot, around = dataclasses.replace(whole, lower=hold(whole.lower), upper=hold(whole.upper)), scene.without(row.fruit)
    rng = np.random.default_rng(0)
    draws = (rng.uniform(robot.lower, robot.upper) for _ in range(1000))
    start = next(q for q in draws if not jaxik.collides(robot, around, q, margin=0.03))
    result: dict[str, Any] = {"fruit": row.fruit, "degrees": SIX["degrees"]}
    step = np.concatenate([[1.0], np.full(6, np.radians(SIX["degrees"]))])
    for direction in ("forward", "backward", "both"):
        found, seconds = clocked(
            lambda d=direction: plan_on_grid(robot, start, row.q, scene=around, step=step, direction=d, batch=8192)
        )
        result[direction] = {"solved": bool(found), "expanded": found.expanded, "length": found.length, "s": seconds}
        print(direction, result[direction])
    return result


def main() -> None:
    """Both; prints, and writes JSON and picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    out = parser.parse_args().out
    result = {"machine": machine(), "paper": {"forward": 146, "backward": 117}}
    result |= {"figure_7": figure_7(out.with_suffix(".png")), "six_joints": six_joints()}
    out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
