"""A picture of the floor: how many targets a base sees from each cell, where none is, and which base is best."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from jaxik.checks.arrays import numbers
from jaxik.checks.options import check_kind
from jaxik.collision.scene import Scene
from jaxik.kinematics.robot import Robot
from jaxik.reach.mobile_base import BasePoses
from jaxik.reasons import Reason
from jaxik.view.palette import ARM, ARM_EDGE, BAD, COLOURS, GOOD, INK, OBSTACLE, SCALE
from jaxik.view.pictures import draw_solids, marker, write_around
from jaxik.view.solids import frames, scene_solids, volume_solids

ARROW = 0.06  # of the picture's width, how far a heading is drawn
SIZE, SIDES = 6.0, (0.8, 1.3)  # [inches] of the longer side of the floor, and of what is left and right of it
HEAD, FOOT = 0.9, 1.3


def plot_base_poses(
    found: BasePoses, targets: Any, path: str | Path, *, robot: Robot | None = None, scene: Scene | None = None
) -> None:
    """Draws one picture (PNG) of the floor from above: the most targets that a base in each cell sees, of all its headings;
    the targets (N, 4, 4) or (N, 3) [m], those that no base sees in red; and the stops of `found.stops()`, the first the best.
    The scene stands in it, and the robot's base on the best place. Host."""
    from matplotlib.figure import Figure

    check_kind("plot_base_poses", "found", found, BasePoses)
    targets = numbers("plot_base_poses: targets", targets, ("N", 4, 4), ("N", 3))
    places = targets[:, :3, 3] if targets.ndim == 3 else targets
    x, y, _ = found.floor
    span = np.array([x.high - x.low, y.high - y.low])
    wide, high = span * SIZE / span.max()
    width = max(wide + sum(SIDES), 8.0)
    figure = Figure(figsize=(width, high + HEAD + FOOT))
    figure.set_layout_engine("none")  # whatever matplotlib is set to
    axis = figure.add_axes((SIDES[0] / width, FOOT / (high + HEAD + FOOT), wide / width, high / (high + HEAD + FOOT)))
    shown = _draw_floor(figure, axis, found)
    solids = scene_solids(scene) if scene is not None else []
    draw_solids(axis, solids, 0, 1, facecolor=OBSTACLE, edgecolor=INK, alpha=0.35, linewidth=1.0, zorder=2)
    if robot is not None and found.count.any():
        _draw_base(axis, found, robot)
    seen = found.seen.any(axis=0)
    for which, colour in ((seen, GOOD), (~seen, BAD)):
        axis.plot(*places[which, :2].T, "D", ms=4, color=colour, mec="w", mew=0.6, lw=0, zorder=4)
    _draw_stops(axis, found, float(span.max()))
    axis.set(xlim=(x.low, x.high), ylim=(y.low, y.high), aspect="equal", xlabel="x [m]", ylabel="y [m]")
    words = (seen, GOOD, "target that some base sees"), (~seen, BAD, "target that none sees")
    entries = [*shown, *(marker(colour, "D", told, ms=4) for mask, colour, told in words if mask.any())]
    entries.append(marker(INK, "o", "stops from which all of these are seen, and their headings", ms=6))
    count, most = len(places), int(found.count.max(initial=0))
    lines = (0.35, f"The best base sees {most} of {count} targets"), (0.62, _told(found))
    write_around(figure, 0.3, lines, 0.02, entries, 2)
    figure.savefig(path, dpi=110, format="png")


def _draw_floor(figure: Any, axis: Any, found: BasePoses) -> list[Any]:
    """The cells; returns what the legend says of those that see nothing."""
    from matplotlib.patches import Patch

    x, y, _ = found.floor
    extent = x.low, x.high, y.low, y.high
    most, empty = found.on_floor(found.count), found.on_floor(found.empty, np.all)
    hits = found.on_floor(found.reason == Reason.COLLISION, np.any) & (most == 0)
    looks = {"origin": "lower", "extent": extent, "interpolation": "nearest"}
    kinds = (
        (empty, "proven: no target from anywhere in the cell", COLOURS[Reason.OUT_OF_REACH]),
        (hits, "base or arm hits something", COLOURS[Reason.COLLISION]),
        ((most == 0) & ~empty & ~hits, "no posture found", "#ffffff"),
    )
    image = axis.imshow(np.where(most > 0, most, np.nan).T, cmap=SCALE, vmin=0, **looks)
    for mask, _, colour in kinds:
        axis.imshow(np.where(mask, 0.0, np.nan).T, cmap=_flat(colour), **looks)
    figure.colorbar(image, ax=axis, label="targets that a base in the cell sees, by its best heading", shrink=0.85)
    return [Patch(fc=colour, ec="0.6", label=words) for mask, words, colour in kinds if mask.any()]


def _flat(colour: str) -> Any:
    from matplotlib.colors import ListedColormap

    return ListedColormap([colour])


def _draw_base(axis: Any, found: BasePoses, robot: Robot) -> None:
    """The links that no joint of the robot moves, on the best base."""
    best = found.world_T_base[found.best()[0]]
    placed = frames(robot.mounted(best @ robot.world_T_base), np.clip(0.0, robot.lower, robot.upper))[0]
    still = [solid.moved(placed) for link, solid in volume_solids(robot) if robot.link_joint[link] == 0]
    draw_solids(axis, still, 0, 1, facecolor=ARM, edgecolor=ARM_EDGE, alpha=0.8, linewidth=0.6, zorder=3)


def _draw_stops(axis: Any, found: BasePoses, span: float) -> None:
    looks = {"ha": "center", "va": "center", "fontsize": 8, "weight": "bold", "color": INK}
    for number, row in enumerate(found.stops(), 1):
        x, y, heading = found.bases[row]
        end = x + ARROW * span * np.cos(heading), y + ARROW * span * np.sin(heading)
        axis.annotate("", end, (x, y), arrowprops={"arrowstyle": "-|>", "color": INK, "lw": 1.6}, zorder=5)
        box = {"boxstyle": "circle,pad=0.2", "fc": "w", "ec": INK, "lw": 1.2}
        axis.text(x, y, str(number), bbox=box, zorder=6, **looks)


def _told(found: BasePoses) -> str:
    stops, seen = len(found.stops()), int(found.seen.any(axis=0).sum())
    empty = int(found.on_floor(found.empty, np.all).sum())
    cells = found.floor.x.cells * found.floor.y.cells
    return f"{stops} stops see {seen} of {found.reasons.shape[1]}; of {empty} of {cells} cells it is proven that none is seen"
