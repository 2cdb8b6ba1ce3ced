"""The picture of a harvest in motion (matplotlib, no window needed): the tip's paths along the row, and the order."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from jaxik.harvesting.harvest_plan import HarvestPlan
from jaxik.reasons import Reason
from jaxik.view.palette import CARRIED, COLOURS, INK, LEAF, OBSTACLE, PATH, WORDS
from jaxik.view.solids import frames, scene_points, scene_solids

PERIOD = 0.02  # [s] between points of a path
PLACES = {"transport": "s", "home": "^"}  # where these lead to
VIEWS = (2, "z", "from the robot"), (1, "y", "from above")


def plot_harvest_plan(plan: HarvestPlan, path: Path) -> None:
    """One picture (PNG) of the row from the robot and from above: how the tip moves, and which fruit is picked when."""
    from matplotlib.figure import Figure

    paths = _paths(plan)
    fruits = np.array([fruit.position for fruit in plan.scene.marks])
    points, solids = scene_points(plan.scene)[0], scene_solids(plan.scene)
    hanging = [s.span for s in solids if s.owner in {f.name for f in plan.scene.marks}]
    held = np.concatenate([fruits, *(way for way, _ in paths), *hanging])
    low, high = held.min(axis=0) - 0.08, held.max(axis=0) + 0.08
    width = 12.0
    scale = (width - 1.0) / (high[0] - low[0])  # [inches/m]
    heights = [scale * (high[k] - low[k]) for k, *_ in VIEWS]
    size = width, sum(heights) + 3.1
    figure = Figure(figsize=size)
    top = size[1] - 1.0
    for (k, name, words), height in zip(VIEWS, heights, strict=True):
        axis = figure.add_axes((0.7 / width, (top - height) / size[1], (width - 1.0) / width, height / size[1]))
        top -= height + 0.45
        _draw(axis, plan, paths, points, solids, k)
        axis.set(xlim=(low[0], high[0]), ylim=(low[k], high[k]), aspect="equal", ylabel=f"{name} [m], {words}")
    axis.set_xlabel("x [m], along the row")
    _write(figure, plan, size)
    figure.savefig(path, dpi=110, format="png")


def _paths(plan: HarvestPlan) -> list[tuple[np.ndarray, bool]]:
    """Each stage's places of the tip in the world (k, 3) [m], and whether it carries a fruit."""
    tip = lambda q: frames(plan.robot, q)[-1, :3, 3]
    return [(np.array([tip(q) for q in stage.trajectory.sample(PERIOD).q]), stage.carries) for stage in plan.stages]


def _draw(axis: Any, plan: HarvestPlan, paths: list[tuple[np.ndarray, bool]], points: np.ndarray, solids: Any, k: int) -> None:
    from matplotlib.collections import PolyCollection

    rows, number = {row.fruit: row for row in plan}, {name: i for i, name in enumerate(plan.order, 1)}
    colours = [COLOURS[rows[s.owner].reason] if s.owner in rows else OBSTACLE for s in solids]
    shapes = [s.outline(0, k) for s in solids]
    alpha = [0.45 if s.owner in rows else 1.0 for s in solids]
    axis.add_collection(PolyCollection(shapes, facecolor=colours, edgecolor="none", alpha=alpha, zorder=1))
    axis.scatter(*points[:, [0, k]].T, s=5, c=LEAF, lw=0, zorder=2)
    for way, carries in paths:
        axis.plot(*way[:, [0, k]].T, color=CARRIED if carries else PATH, lw=2.4 if carries else 1.3, zorder=4 if carries else 3)
    for stage, (way, _) in zip(plan.stages, paths, strict=True):
        if stage.kind in PLACES:
            axis.plot(*way[-1, [0, k]], PLACES[stage.kind], ms=9, color=INK, zorder=5)
    for fruit in plan.scene.marks:
        x, y = fruit.position[[0, k]]
        words = str(number.get(fruit.name, "✗"))
        colour = COLOURS[rows[fruit.name].reason]
        box = {"boxstyle": "circle,pad=0.25", "fc": "w", "ec": colour, "lw": 1.6}
        axis.text(x, y, words, ha="center", va="center", fontsize=10, weight="bold", color=INK, bbox=box, zorder=6)


def _write(figure: Any, plan: HarvestPlan, size: tuple[float, float]) -> None:
    """The title above, what is drawn and what is not picked below."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    left, count = 0.7 / size[0], len(plan.order)
    title = f"{plan.robot.name} picks {count} of {len(plan)} fruits of {plan.scene.name} in {plan.duration:.1f} s"
    figure.text(left, 1.0 - 0.4 / size[1], title, fontsize=15, weight="bold", color=INK)
    each = f"{plan.cycle:.2f} s a fruit, of motions alone; " if count else ""
    figure.text(left, 1.0 - 0.68 / size[1], f"{each}the numbers are their order, ✗ is not picked", fontsize=10, color=INK)
    there, kinds = sorted({row.reason for row in plan}), {stage.kind for stage in plan.stages}
    marks = {"transport": "where fruits are let go", "home": "where it begins and ends"}
    entries = [
        Line2D([], [], color=PATH, lw=1.3, label="the tip, empty"),
        Line2D([], [], color=CARRIED, lw=2.4, label="the tip, with a fruit"),
        *(Patch(fc=COLOURS[r], alpha=0.45, label=f"fruit: {'picked' if r == Reason.SOLVED else WORDS[r]}") for r in there),
        *(Line2D([], [], color=INK, marker=PLACES[k], lw=0, label=words) for k, words in marks.items() if k in kinds),
        Line2D([], [], color=LEAF, marker="o", lw=0, ms=4, label="leaves (points)"),
        Patch(color=OBSTACLE, label="stems and other obstacles"),
    ]
    place = (left, 0.35 / size[1])
    figure.legend(handles=entries, loc="lower left", bbox_to_anchor=place, ncols=4, fontsize=9, frameon=False)
    failed = "; ".join(f"{row.fruit}: {row.why}" for row in plan if not row.stages)
    figure.text(left, 0.15 / size[1], failed, fontsize=9, color=INK)
