"""Pictures of a robot at work (matplotlib, no window needed): each fruit's posture, the tip's paths along the row, and what a
motion takes of the joints."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxik.harvesting.arms import arm_named
from jaxik.harvesting.driver import HarvestResult
from jaxik.harvesting.harvest_plan import HarvestPlan
from jaxik.kinematics.robot import Robot
from jaxik.reasons import Reason
from jaxik.view.palette import ARM, ARM_EDGE, BAD, CARRIED, COLOURS, GOOD, INK, LEAF, OBSTACLE, PATH, WORDS
from jaxik.view.solids import Solid, frames, scene_points, scene_solids, volume_solids

COLUMNS, MOST = 4, 120  # panels in a row, and at all
DOTS = 5_000  # points of a scene that a panel shows
SIDE, GAP, TITLE, HEAD, FOOT = 0.6, 0.12, 0.3, 0.8, 1.25  # [inches]


def draw_solids(axis: Any, solids: Iterable[Solid], i: int, j: int, **looks: Any) -> None:
    """Fills the outlines of solids, as seen along the third axis; `looks` are those of a `PolyCollection`."""
    from matplotlib.collections import PolyCollection

    axis.add_collection(PolyCollection([solid.outline(i, j) for solid in solids], **looks))


def marker(colour: str, shape: str, label: str, **looks: Any) -> Any:
    """A legend's entry of a marker without a line."""
    from matplotlib.lines import Line2D

    return Line2D([], [], color=colour, marker=shape, lw=0, label=label, **looks)


def inches(figure: Any, *lengths: float) -> Any:
    """Lengths across and up in turn [inches], as fractions of a figure's."""
    return tuple(length / figure.get_size_inches()[k % 2] for k, length in enumerate(lengths))


def write(figure: Any, left: float, low: float, words: str, **looks: Any) -> None:
    """Writes words at a place [inches]."""
    figure.text(*inches(figure, left, low), words, **{"color": INK, **looks})


def write_around(
    figure: Any, left: float, lines: Sequence[tuple[float, str]], low: float, entries: Sequence[Any], columns: int
) -> None:
    """Writes a title and a line below it, each so far from the top, and a legend so far from the bottom [inches]."""
    height = figure.get_size_inches()[1]
    for (below, words), size, weight in zip(lines, (15, 10), ("bold", "normal"), strict=True):
        write(figure, left, height - below, words, fontsize=size, weight=weight)
    place = inches(figure, left, low)
    figure.legend(handles=entries, loc="lower left", bbox_to_anchor=place, ncols=columns, fontsize=9, frameon=False)


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
            axis = figure.add_axes(inches(figure, x, low, w, scale * height))
            _draw(axis, result, crop, row, i)
            axis.tick_params(labelsize=8, labelbottom=last, labelleft=not (i or column))
            axis.set_xlabel("xy"[i] + " [m]" if last else "", fontsize=8)
            axis.set_ylabel("" if i or column else "z [m]", fontsize=8)
        mark, colour = ("✓", GOOD) if row.success else ("✗", BAD)
        above = low + scale * height + 0.06
        write(figure, left, above, mark, fontsize=11, weight="bold", color=colour)
        by = f", by {row.arm}" if row.arm and row.success else ""
        write(figure, left + 0.17, above, f"{row.fruit}: {fate(row)}{by}", fontsize=9)
    _write_harvest(figure, result, len(rows))
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
    """The posture of the arm that picks a fruit, or would once what is in the way were gone."""
    if row.success:
        return np.asarray(row.q)[list(arm_named(row.robot, row.arm).joints)]
    return None if row.blockers is None or row.blockers.row is None else np.asarray(row.scan.table.q[row.blockers.row])


def _crop(result: HarvestResult) -> _Crop:
    (points, owners), solids = scene_points(result.scene), scene_solids(result.scene)
    some = np.random.default_rng(0).permutation(len(points))[:DOTS]
    reasons, arms = {row.fruit: row.reason for row in result}, {}
    for row in result:
        if (q := posture(row)) is not None:
            robot = row.scan.robot
            placed = frames(robot, q)
            arms[row.fruit] = placed, [s.moved(placed[robot.link_joint[link]]) for link, s in volume_solids(robot)]
    near = [s.span for s in solids if s.owner in reasons] + [s.span for _, arm in arms.values() for s in arm]
    places = [f.position for f in result.scene.marks] + [np.asarray(result.robot.world_T_base)[:3, 3]]
    held = np.concatenate([points, np.array(places), *near])
    box = np.array([held.min(axis=0) - 0.05, held.max(axis=0) + 0.05])  # stems and wires go on beyond
    return _Crop(solids, points[some], owners[some], reasons, arms, box)


def _draw(axis: Any, result: HarvestResult, crop: _Crop, row: HarvestResult, i: int) -> None:
    """One view of one fruit: from the front (i = 0, x and z) or from the side (i = 1, y and z)."""
    blocking = in_the_way(row)
    if row.fruit in crop.arms:
        placed, arm = crop.arms[row.fruit]
        fill = ARM if row.success else "w"
        draw_solids(axis, arm, i, 2, facecolor=fill, edgecolor=ARM_EDGE, linewidth=1.6, zorder=1)
        draw_solids(axis, arm, i, 2, facecolor=fill, edgecolor="none", zorder=1.1)  # leaves the outer edge
        axis.plot(*placed[1:, [i, 2], 3].T, ".-" if row.success else ".:", color=INK, lw=1.2, ms=4, zorder=4)
    known = {name: (COLOURS[why], 1.0 if name == row.fruit else 0.4) for name, why in crop.reasons.items()}  # others are paler
    known |= dict.fromkeys(blocking, (BAD, 1.0))
    colours = [known.get(s.owner, (OBSTACLE, 1.0)) for s in crop.solids]
    edges = [INK if s.owner == row.fruit else "0.6" if s.owner in crop.reasons else "none" for s in crop.solids]
    draw_solids(axis, crop.solids, i, 2, facecolor=colours, edgecolor=edges, linewidth=1.0, zorder=2)
    hit = np.isin(crop.owners, blocking)
    for mask, colour, dot in ((~hit, LEAF, 3), (hit, BAD, 9)):
        axis.scatter(*crop.points[mask][:, [i, 2]].T, s=dot, c=colour, lw=0, zorder=3)
    place = next(f for f in result.scene.marks if f.name == row.fruit).position
    axis.plot(place[i], place[2], "D", ms=6, color=COLOURS[row.reason], mec=INK, zorder=5)
    axis.set(xlim=crop.box[:, i], ylim=crop.box[:, 2], aspect="equal")
    axis.locator_params(nbins=4)


def _write_harvest(figure: Any, result: HarvestResult, shown: int) -> None:
    """The title above and the legend below, where no plant is."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    solved, count = int(np.sum(result.success)), len(result)
    title = f"{result.robot.name} can pick {solved} of {count} fruits of {result.scene.name}"
    how = "For each fruit the best posture, from the front (left) and from the side (right), and how far it stays from all else"
    how += f". The first {shown} are shown." if shown < count else "."
    fates = {r: "can be picked" if r == Reason.SOLVED else WORDS[r] for r in COLOURS if r in np.ravel(result.reason)}
    entries = [
        Patch(fc=ARM, ec=ARM_EDGE, label="the arm, as the volumes that are kept clear"),
        Line2D([], [], color=INK, marker=".", label="its joints, to the tip"),
        marker("w", "D", "where this fruit is grasped; others are pale", mec=INK),
        *(Patch(fc=COLOURS[reason], ec="0.6", label=f"fruit: {words}") for reason, words in fates.items()),
        *([marker(LEAF, "o", "leaves (points)", ms=4)] if result.scene.counts["points"] else []),
        Patch(color=OBSTACLE, label="stems and other obstacles"),
    ]
    if any(in_the_way(row) for row in result):
        entries.append(marker(BAD, "o", "what is in this fruit's way", ms=5))
        entries.append(Patch(fc="w", ec=ARM_EDGE, label="the arm, once that is gone"))
    write_around(figure, SIDE, ((0.35, title), (0.6, how)), 0.05, entries, 3)


PERIOD = 0.02  # [s] between points of a path
PLACES = {"transport": "s", "home": "^"}  # where these lead to
VIEWS = (2, "z", "from the robot"), (1, "y", "from above")
Paths = list[tuple[np.ndarray, bool]]  # each stage's places of the tip in the world (k, 3) [m], and whether it carries a fruit


def plot_harvest_plan(plan: HarvestPlan, path: str | Path) -> None:
    """Draws one picture (PNG) of the row from the robot and from above: how the tip moves, when each fruit is picked. Host."""
    from matplotlib.figure import Figure

    robots = {arm.name: arm.robot for arm in plan.arms}
    tips = lambda stage: np.array([frames(robots[stage.arm], q)[-1, :3, 3] for q in stage.trajectory.sample(PERIOD).q])
    paths = [(tips(stage), stage.carries) for stage in plan.stages]
    fruits = {fruit.name: fruit.position for fruit in plan.scene.marks}
    hanging = [s.span for s in scene_solids(plan.scene) if s.owner in fruits]
    held = np.concatenate([np.array([*fruits.values()]), *(way for way, _ in paths), *hanging])
    low, high = held.min(axis=0) - 0.08, held.max(axis=0) + 0.08
    width = 12.0
    scale = (width - 1.0) / (high[0] - low[0])  # [inches/m]
    heights = [scale * (high[k] - low[k]) for k, *_ in VIEWS]
    figure = Figure(figsize=(width, sum(heights) + 3.1))
    top = sum(heights) + 2.1
    for (k, name, words), height in zip(VIEWS, heights, strict=True):
        axis = figure.add_axes(inches(figure, 0.7, top - height, width - 1.0, height))
        top -= height + 0.45
        _draw_side(axis, plan, paths, k)
        axis.set(xlim=(low[0], high[0]), ylim=(low[k], high[k]), aspect="equal", ylabel=f"{name} [m], {words}")
    axis.set_xlabel("x [m], along the row")
    _write_plan(figure, plan)
    figure.savefig(path, dpi=110, format="png")


def _draw_side(axis: Any, plan: HarvestPlan, paths: Paths, k: int) -> None:
    """One view of the row, along x and axis k."""
    rows, number = {row.fruit: row for row in plan}, {name: i for i, name in enumerate(plan.order, 1)}
    solids = scene_solids(plan.scene)
    colours = [COLOURS[rows[s.owner].reason] if s.owner in rows else OBSTACLE for s in solids]
    alpha = [0.45 if s.owner in rows else 1.0 for s in solids]
    draw_solids(axis, solids, 0, k, facecolor=colours, edgecolor="none", alpha=alpha, zorder=1)
    axis.scatter(*scene_points(plan.scene)[0][:, [0, k]].T, s=5, c=LEAF, lw=0, zorder=2)
    lines = line_of_arm(plan)
    for stage, (way, carries) in zip(plan.stages, paths, strict=True):
        looks = {"color": CARRIED if carries else PATH, "lw": 2.4 if carries else 1.3, "ls": lines[stage.arm]}
        axis.plot(*way[:, [0, k]].T, zorder=4 if carries else 3, **looks)
    for stage, (way, _) in zip(plan.stages, paths, strict=True):
        if stage.kind in PLACES:
            axis.plot(*way[-1, [0, k]], PLACES[stage.kind], ms=9, color=INK, zorder=5)
    for fruit in (mark for mark in plan.scene.marks if mark.name in rows):
        words = str(number.get(fruit.name, "✗"))
        box = {"boxstyle": "circle,pad=0.25", "fc": "w", "ec": COLOURS[rows[fruit.name].reason], "lw": 1.6}
        looks = {"ha": "center", "va": "center", "fontsize": 10, "weight": "bold", "color": INK}
        axis.text(*fruit.position[[0, k]], words, bbox=box, zorder=6, **looks)


def line_of_arm(plan: HarvestPlan) -> dict[str, Any]:
    """The style of each arm's lines."""
    return dict(zip((arm.name for arm in plan.arms), ("-", (0, (4, 1.2))), strict=False))


def _write_plan(figure: Any, plan: HarvestPlan) -> None:
    """The title above, what is drawn and what is not picked below."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    count, there, kinds = len(plan.order), sorted({row.reason for row in plan}), {stage.kind for stage in plan.stages}
    title = f"{plan.robot.name} picks {count} of {len(plan)} fruits of {plan.scene.name} in {plan.duration:.1f} s"
    each = f"{plan.cycle:.2f} s a fruit, of motions alone; " if count else ""
    marks = {"transport": "where fruits are let go", "home": "where it begins and ends"}
    entries = [
        Line2D([], [], color=PATH, lw=1.3, label="the tip, empty"),
        Line2D([], [], color=CARRIED, lw=2.4, label="the tip, with a fruit"),
        *(Line2D([], [], color=INK, ls=line, label=name) for name, line in line_of_arm(plan).items() if name),
        *(Patch(fc=COLOURS[r], alpha=0.45, label=f"fruit: {'picked' if r == Reason.SOLVED else WORDS[r]}") for r in there),
        *(marker(INK, PLACES[k], words) for k, words in marks.items() if k in kinds),
        marker(LEAF, "o", "leaves (points)", ms=4),
        Patch(color=OBSTACLE, label="stems and other obstacles"),
    ]
    lines = (0.4, title), (0.68, f"{each}the numbers are their order, ✗ is not picked")
    write_around(figure, 0.7, lines, 0.35, entries, 4)
    failed = "; ".join(f"{row.fruit}: {row.why}" for row in plan if not row.stages)
    write(figure, 0.7, 0.15, failed, fontsize=9)


NEAR = 0.25  # of its limit, from which on a torque is drawn beside it


def plot_torques(
    robot: Robot, time: np.ndarray, torque: np.ndarray, holding: np.ndarray, path: str | Path, *, title: str = ""
) -> None:
    """Draws a row a joint: its torque (i, n) [Nm, N] over `time` (i,) [s], what would hold the arm at rest there (i, n), and
    its limit `robot.effort`, as a line where it is near. Host."""
    from matplotlib.figure import Figure

    n = robot.num_joints
    figure = Figure(figsize=(8.0, 0.6 + 1.1 * n), layout="constrained")
    axes = figure.subplots(n, 1, sharex=True, squeeze=False)[:, 0]
    for i, (name, slides, axis) in enumerate(zip(robot.joint_names, robot.is_prismatic, axes, strict=True)):
        axis.axhline(0.0, color="0.8", linewidth=0.8)
        axis.plot(time, holding[:, i], color="0.55", linewidth=1.0, linestyle="--", label="holding the arm at rest")
        axis.plot(time, torque[:, i], color="tab:blue", linewidth=1.4, label="in motion")
        unit, limit = "N" if slides else "Nm", float(robot.effort[i])
        for side in (-1.0, 1.0):
            if (side * torque[:, i]).max() > NEAR * limit:  # else it would leave no room for the curves
                axis.axhline(side * limit, color="tab:red", linewidth=1.0, label="limit")
        axis.set_title(name if np.isinf(limit) else f"{name}, limit {limit:g} {unit}", loc="left", fontsize=8, pad=2.0)
        axis.set_ylabel(f"[{unit}]", fontsize=8)
        axis.tick_params(labelsize=8)
    axes[-1].set_xlabel("time [s]")
    labels = {label: line for axis in axes for line, label in zip(*axis.get_legend_handles_labels(), strict=True)}
    figure.suptitle(title, fontsize=11)
    figure.legend(labels.values(), labels.keys(), loc="outside lower right", ncols=3, frameon=False, fontsize=9)
    figure.savefig(path, dpi=120)
