"""How the time of a clearance grows with obstacles, spheres and cores: `python batch_eval/collision_scaling.py`.

Needs `pip install -e ".[test]"`. P6R among 10 to 10,000 random points or capsules in a crop's space, with 56 spheres; and with
7 to 3,584 spheres at 150 leaf points and itself. Each number of cores is a process of its own. Writes the JSON and the picture
beside this file; prints a line a point.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
from peers import arm
from race import Entry, clocked, compiled, cores, machine, on_cores, race

import jaxik
from jaxik.collision.bvh import grouped

mpl.use("Agg")
import matplotlib.pyplot as plt

OBSTACLES = tuple(round(10 ** (i / 2)) for i in range(2, 9))  # 10 to 10,000
LEVELS = (1, 8, 64, 512)  # spheres a box, of which P6R has seven
PLACE = (np.array([-0.5, 0.4, 0.0]), np.array([1.5, 1.0, 1.5]))  # where leaves are, corner and corner [m]
THICK, LONG = 0.005, 0.1  # of points and capsules, of capsules [m]
SECONDS = 0.3  # that a call may take: the batch is chosen by it


def crowd(kind: str, count: int) -> jaxik.Scene:
    """Random points or capsules, the same ones first."""
    rng = np.random.default_rng(0)
    center = rng.uniform(*PLACE, (max(OBSTACLES), 3))[:count]
    if kind == "points":
        return jaxik.make_scene(points=center, point_radius=THICK)
    along = rng.normal(size=(max(OBSTACLES), 3))[:count]
    half = LONG / 2.0 * along / np.linalg.norm(along, axis=1, keepdims=True)
    return jaxik.make_scene(capsules=np.concatenate([center - half, center + half, np.full((count, 1), THICK)], axis=1))


def measured(robot: jaxik.Robot, scene: jaxik.Scene, function: Callable[..., Any], rounds: int) -> float:
    """Nanoseconds a configuration, in the largest batch of 16,384 and less that takes `SECONDS`."""
    q = np.random.default_rng(0).uniform(robot.lower, robot.upper, (16_384, robot.num_joints)).astype(np.float32)
    placed = jax.device_put(grouped(scene, robot))  # an operand: no compilation for another scene
    batch = jax.vmap(lambda around, q: function(robot, around, q), in_axes=(None, 0))
    few, _ = compiled(batch, placed, jnp.asarray(q[:64]))
    few()
    each = min(clocked(few)[1] for _ in range(3)) / 64
    count = 2 ** int(np.clip(np.log2(SECONDS / each), 6, 14))
    run, _ = compiled(batch, placed, jnp.asarray(q[:count]))
    return 1e9 / race([Entry("jaxik", count, run)], rounds, most=5.0)[0].rate


def series(rounds: int) -> list[dict[str, Any]]:
    """Every point of every line, for the cores of this process."""
    works = {"clearance": jaxik.clearance, "collides": jaxik.collides}
    p6r, rows = jaxik.load("p6r"), []
    cases = [(kind, count, p6r, crowd(kind, count)) for kind in ("points", "capsules") for count in OBSTACLES]
    cases += [("spheres", 7 * level, p6r.with_spheres(level), arm.crop()) for level in LEVELS]
    for what, count, robot, scene in cases:
        for work, function in works.items():
            each = measured(robot, scene, function, rounds)
            rows.append({"what": what, "count": count, "work": work, "cores": len(cores()), "ns": each})
            print(f"{work:10s} {count:6d} {what:9s} {len(cores())} cores {each:14.1f} ns a configuration", flush=True)
    return rows


def alone(count: int, rounds: int) -> list[dict[str, Any]]:
    """`series` of a process that has so many cores."""
    with tempfile.TemporaryDirectory() as place:
        out = Path(place) / "rows.json"
        on_cores(count, sys.executable, __file__, "--series", str(out), "--rounds", str(rounds))
        return json.loads(out.read_text())


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Time by number, obstacles and spheres side by side; a line each for what, work and cores."""
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.5), sharey=True, constrained_layout=True)
    colours = {"points": "tab:green", "capsules": "tab:orange", "spheres": "tab:blue"}
    for axis, kinds, title in (
        (axes[0], ("points", "capsules"), "P6R's 56 spheres among obstacles"),
        (axes[1], ("spheres",), "P6R's spheres among 150 points, and itself"),
    ):
        for what, work, number in dict.fromkeys((row["what"], row["work"], row["cores"]) for row in rows):
            line = [row for row in rows if (row["what"], row["work"], row["cores"]) == (what, work, number)]
            if what in kinds:
                axis.loglog(
                    [row["count"] for row in line],
                    [row["ns"] / 1e3 for row in line],
                    color=colours[what],
                    linestyle="-" if work == "clearance" else ":",
                    marker="o" if number == 1 else "s",
                    fillstyle="none" if number == 1 else "full",
                    label=f"{work}, {what}, {number} core{'s' if number > 1 else ''}",
                )
        axis.set(xlabel=f"number of {' or '.join(kinds)}", title=title)
        axis.grid(which="major", alpha=0.4)
        axis.legend(fontsize=8)
    axes[0].set_ylabel("time a configuration [us]")
    figure.savefig(path, dpi=110)


def main() -> None:
    """All lines, the JSON and the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--series", type=Path, help="only this process' own lines, to this file")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    arguments = parser.parse_args()
    if arguments.series:
        arguments.series.write_text(json.dumps(series(arguments.rounds)))
        return
    rows = [row for count in sorted({1, min(2, len(cores()))}) for row in alone(count, arguments.rounds)]
    draw(rows, arguments.out.with_suffix(".png"))
    arguments.out.write_text(json.dumps({"machine": machine(), "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
