"""Pictures of a harvest (matplotlib, no window needed): each fruit's posture, and the tip's paths along the row."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxik.harvesting.driver import HarvestResult
from jaxik.harvesting.harvest_plan import HarvestPlan
from jaxik.kinematics.robot import Robot
from jaxik.reasons import Reason
from jaxik.view.palette import ARM, ARM_EDGE, CARRIED, COLOURS, INK, LEAF, OBSTACLE, PATH, WORDS
from jaxik.view.solids import Solid, frames, scene_points, scene_solids, volume_solids

COLUMNS, MOST = 4, 120  # panels in a row, and at all
DOTS = 5_000  # points of a scene that a panel shows
SIDE, GAP, TITLE, HEAD, FOOT = 0.6, 0.12, 0.3, 0.8, 1.25  # [inches]


class _Crop(NamedTuple):
    """The crop in every panel, the frames and volumes of the arm in each, and the box (2, 3) [m] that all of them show."""

    solids: list[Solid]
    points: np.ndarray
    owners: np.ndarray
    reasons: dict[str, Reason]
    arms: dict[str, tuple[np.ndarray, list[Solid]]]
    box: np.ndarray


def plot_harvest(result: HarvestResult, path: str | Path) -> None:
    """Draws one picture (PNG) with two views for every fruit: the robot at its posture, or what is in the way. Host."""
    from matplotlib.figure import Figure

    crop, rows = _crop(result), list(result[:MOST])
    columns = min(COLUMNS, len(rows))
    width, depth, height = crop.box[1] - crop.box[0]
    scale = min((4.0 - GAP - 0.15) / (width + depth), 3.0 / height)  # [inches/m]: a pair of views is at most 4 inches wide
    cell = scale * (width + depth) + GAP + 0.15, scale * height + TITLE + GAP
    size = max(columns * cell[0] + SIDE, 11.0), -(-len(rows) // columns) * cell[1] + HEAD + FOOT
    figure = Figure(figsize=size)
    for k, row in enumerate(rows):
        line, column = divmod(k, columns)
        left, low = SIDE + column * cell[0], size[1] - HEAD - (line + 1) * cell[1] + GAP
        last = k + columns >= len(rows)
        for i, x, w in ((0, left, scale * width), (1, left + scale * width + GAP, scale * depth)):
            axis = figure.add_axes((x / size[0], low / size[1], w / size[0], scale * height / size[1]))
            _draw(axis, result, crop, row, i)
            axis.tick_params(labelsize=8, labelbottom=last, labelleft=not (i or column))
            axis.set_xlabel("xy"[i] + " [m]" if last else "", fontsize=8)
            axis.set_ylabel("" if i or column else "z [m]", fontsize=8)
        mark, colour = ("✓", COLOURS[Reason.SOLVED]) if row.success else ("✗", COLOURS[Reason.COLLISION])
        above = (low + scale * height + 0.06) / size[1]
        figure.text(left / size[0], above, mark, fontsize=11, weight="bold", color=colour)
        figure.text((left + 0.17) / size[0], above, f"{row.fruit}: {fate(row)}", fontsize=9, color=INK)
    _write_head(figure, size, result, len(rows))
    figure.savefig(path, dpi=110, format="png")


def fate(row: HarvestResult) -> str:
    """The fate of a fruit, in a grower's words."""
    if row.success:
        return f"{1000.0 * row.clearance:.0f} mm clear"
    if row.blockers is None:
        return WORDS[row.reason]
    if row.blockers.mend:
        return f"blocked; first {row.blockers.mend}"
    return f"hidden {row.blockers.words}" if row.blockers.names else "the arm would hit itself"


def in_the_way(row: HarvestResult) -> tuple[str, ...]:
    """The objects that keep the robot from a fruit."""
    return () if row.blockers is None else row.blockers.in_the_way


def posture(row: HarvestResult) -> np.ndarray | None:
    """The posture that picks a fruit, or would once what is in the way were gone."""
    if row.success:
        return row.q
    return None if row.blockers is None or row.blockers.row is None else np.asarray(row.scan.table.q[row.blockers.row])


def _crop(result: HarvestResult) -> _Crop:
    points, owners = scene_points(result.scene)
    some = np.random.default_rng(0).permutation(len(points))[:DOTS]
    solids = scene_solids(result.scene)
    reasons = {row.fruit: row.reason for row in result}
    arms = {row.fruit: _arm(result.robot, q) for row in result if (q := posture(row)) is not None}
    near = [s.span for s in solids if s.owner in reasons] + [s.span for _, arm in arms.values() for s in arm]
    places = [f.position for f in result.scene.marks] + [np.asarray(result.robot.world_T_base)[:3, 3]]
    held = np.concatenate([points, np.array(places), *near])
    box = np.array([held.min(axis=0) - 0.05, held.max(axis=0) + 0.05])  # stems and wires go on beyond
    return _Crop(solids, points[some], owners[some], reasons, arms, box)


def _arm(robot: Robot, q: np.ndarray) -> tuple[np.ndarray, list[Solid]]:
    placed = frames(robot, q)
    return placed, [solid.moved(placed[robot.link_joint[link]]) for link, solid in volume_solids(robot)]


def _draw(axis: Any, result: HarvestResult, crop: _Crop, row: HarvestResult, i: int) -> None:
    """One view of one fruit: from the front (i = 0, x and z) or from the side (i = 1, y and z)."""
    from matplotlib.collections import PolyCollection

    blocking = in_the_way(row)
    if row.fruit in crop.arms:
        placed, volumes = crop.arms[row.fruit]
        arm = [volume.outline(i, 2) for volume in volumes]
        fill = ARM if row.success else "w"
        axis.add_collection(PolyCollection(arm, facecolor=fill, edgecolor=ARM_EDGE, linewidth=1.6, zorder=1))
        axis.add_collection(PolyCollection(arm, facecolor=fill, edgecolor="none", zorder=1.1))  # leaves the outer edge
        axis.plot(*placed[1:, [i, 2], 3].T, ".-" if row.success else ".:", color=INK, lw=1.2, ms=4, zorder=4)
    colours = [_colour(s.owner, crop, row.fruit, blocking) for s in crop.solids]
    edges = [INK if s.owner == row.fruit else "0.6" if s.owner in crop.reasons else "none" for s in crop.solids]
    shapes = [s.outline(i, 2) for s in crop.solids]
    axis.add_collection(PolyCollection(shapes, facecolor=colours, edgecolor=edges, linewidth=1.0, zorder=2))
    hit = np.isin(crop.owners, blocking)
    for mask, colour, dot in ((~hit, LEAF, 3), (hit, COLOURS[Reason.COLLISION], 9)):
        axis.scatter(*crop.points[mask][:, [i, 2]].T, s=dot, c=colour, lw=0, zorder=3)
    place = next(f for f in result.scene.marks if f.name == row.fruit).position
    axis.plot(place[i], place[2], "D", ms=6, color=COLOURS[row.reason], mec=INK, zorder=5)
    axis.set(xlim=crop.box[:, i], ylim=crop.box[:, 2], aspect="equal")
    axis.locator_params(nbins=4)


def _colour(owner: str, crop: _Crop, fruit: str, blocking: tuple[str, ...]) -> Any:
    """The colour of an object in a fruit's panel; other fruits are paler."""
    if owner in blocking:
        return COLOURS[Reason.COLLISION], 1.0
    return (COLOURS[crop.reasons[owner]], 1.0 if owner == fruit else 0.4) if owner in crop.reasons else (OBSTACLE, 1.0)


def _write_head(figure: Any, size: tuple[float, float], result: HarvestResult, shown: int) -> None:
    """The title above and the legend below, where no plant is."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    solved, count = int(result.success.sum()), len(result)
    title = f"{result.robot.name} can pick {solved} of {count} fruits of {result.scene.name}"
    figure.text(SIDE / size[0], 1.0 - 0.35 / size[1], title, fontsize=15, weight="bold", color=INK)
    how = "For each fruit the best posture, from the front (left) and from the side (right), and how far it stays from all else"
    how += f". The first {shown} are shown." if shown < count else "."
    figure.text(SIDE / size[0], 1.0 - 0.6 / size[1], how, fontsize=10, color=INK)
    marker = lambda colour, shape, label, **how: Line2D([], [], color=colour, marker=shape, lw=0, label=label, **how)
    fates = {r: "can be picked" if r == Reason.SOLVED else WORDS[r] for r in COLOURS if r in result.reason}
    entries = [
        Patch(fc=ARM, ec=ARM_EDGE, label="the arm, as the volumes that are kept clear"),
        Line2D([], [], color=INK, marker=".", label="its joints, to the tip"),
        marker("w", "D", "where this fruit is grasped; others are pale", mec=INK),
        *(Patch(fc=COLOURS[reason], ec="0.6", label=f"fruit: {words}") for reason, words in fates.items()),
        *([marker(LEAF, "o", "leaves (points)", ms=4)] if result.scene.counts["points"] else []),
        Patch(color=OBSTACLE, label="stems and other obstacles"),
    ]
    if any(in_the_way(row) for row in result):
        entries.append(marker(COLOURS[Reason.COLLISION], "o", "what is in this fruit's way", ms=5))
        entries.append(Patch(fc="w", ec=ARM_EDGE, label="the arm, once that is gone"))
    place = (SIDE / size[0], 0.05 / size[1])
    figure.legend(handles=entries, loc="lower left", bbox_to_anchor=place, ncols=3, fontsize=9, frameon=False)


PERIOD = 0.02  # [s] between points of a path
PLACES = {"transport": "s", "home": "^"}  # where these lead to
VIEWS = (2, "z", "from the robot"), (1, "y", "from above")


def plot_harvest_plan(plan: HarvestPlan, path: str | Path) -> None:
    """Draws one picture (PNG) of the row from the robot and from above: how the tip moves, when each fruit is picked. Host."""
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
        _draw_side(axis, plan, paths, points, solids, k)
        axis.set(xlim=(low[0], high[0]), ylim=(low[k], high[k]), aspect="equal", ylabel=f"{name} [m], {words}")
    axis.set_xlabel("x [m], along the row")
    _write(figure, plan, size)
    figure.savefig(path, dpi=110, format="png")


def _paths(plan: HarvestPlan) -> list[tuple[np.ndarray, bool]]:
    """Each stage's places of the tip in the world (k, 3) [m], and whether it carries a fruit."""
    tip = lambda q: frames(plan.robot, q)[-1, :3, 3]
    return [(np.array([tip(q) for q in stage.trajectory.sample(PERIOD).q]), stage.carries) for stage in plan.stages]


def _draw_side(
    axis: Any, plan: HarvestPlan, paths: list[tuple[np.ndarray, bool]], points: np.ndarray, solids: Any, k: int
) -> None:
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
