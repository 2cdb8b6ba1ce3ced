"""Pictures of a harvest (matplotlib, no window needed)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from jaxik.collision.volumes import skeletons
from jaxik.harvesting.driver import Harvest, Posture
from jaxik.reasons import Reason
from jaxik.robot.chain import Chain
from jaxik.robot.kinematics import joint_frames
from jaxik.spatial.algebra import Frame

COLOURS = {
    Reason.SOLVED: "tab:green",
    Reason.OUT_OF_REACH: "silver",
    Reason.LIMITS: "tab:orange",
    Reason.COLLISION: "tab:red",
    Reason.NOT_CONVERGED: "tab:purple",
    Reason.INVALID: "black",
}


def plot_harvest(result: Harvest, path: Path, fruit: str | None = None) -> None:
    """One picture (PNG): the robot's spheres at `fruit`'s posture from two sides, every fruit's fate, the clearance map.

    Without `fruit` the solved one with the best score is shown, and where none is solved the first.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    row = _chosen(result, fruit)
    figure = Figure(figsize=(14, 9), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 2, width_ratios=(3, 2))
    for axis, (i, j), title in ((axes[0, 0], (0, 2), "front (x, z)"), (axes[0, 1], (1, 2), "side (y, z)")):
        _draw_scene(axis, result, row, i, j)
        if row.success:
            _draw_robot(axis, result.chain, row.q, i, j)
        axis.set(xlabel=f"{'xyz'[i]} [m]", ylabel=f"{'xyz'[j]} [m]", title=title, aspect="equal")
        axis.set_ylim(top=min(axis.get_ylim()[1], _height(result, row) + 0.5))  # stems and wires go on
    axes[0, 0].legend(fontsize=8, loc="upper right")
    _draw_map(figure, axes[1, 0], row, result.chain)
    _draw_fates(axes[1, 1], result)
    state = f"clearance {1000 * row.clearance:.0f} mm, freedom {row.freedom:.2f}" if row.success else row.reason.text
    solved = int(result.success.sum())
    figure.suptitle(
        f"{result.chain.name}, {result.scene.name}: {solved} of {len(result.rows)} fruits; shown: {row.fruit}, {state}"
    )
    figure.savefig(path, dpi=110, format="png")


def _height(result: Harvest, row: Posture) -> float:
    """The highest of leaf points, fruits and joints [m]."""
    joints = bones(result.chain, row.q)[:, 2] if row.success else ()
    return max(float(z) for z in (*result.scene.points.center[:, 2], *(f.position[2] for f in result.scene.fruits), *joints))


def bones(chain: Chain, q: np.ndarray) -> np.ndarray:
    """Where the joints and the tip are in the world, (n + 1, 3) [m]."""
    frames = joint_frames(chain, [float(x) for x in q], Frame.of(chain.world_T_base))
    return np.array([[float(x) for x in f.translation] for f in (*frames.joints, frames.tip)])


def _chosen(result: Harvest, fruit: str | None) -> Posture:
    if fruit is not None:
        return next(row for row in result.rows if row.fruit == fruit)
    solved = [row for row in result.rows if row.success]
    return max(solved, key=lambda row: row.score) if solved else result.rows[0]


def _draw_scene(axis: Any, result: Harvest, shown: Posture, i: int, j: int) -> None:
    scene = result.scene
    axis.scatter(*scene.points.center[:, [i, j]].T, s=6, c="olivedrab", alpha=0.6, label="leaf points")
    fruits = {row.fruit: row for row in result.rows}
    for k, owner in enumerate(scene.owners[2]):
        name = scene.object_names[owner]
        ends = np.stack([scene.capsules.a[k], scene.capsules.b[k]])
        colour = COLOURS.get(fruits[name].reason, "0.6") if name in fruits else "saddlebrown"
        wide = 6 if name == shown.fruit else 3 if name in fruits else 1.5
        axis.plot(ends[:, i], ends[:, j], color=colour, lw=wide, alpha=0.8, solid_capstyle="round")
    place = next(f for f in scene.fruits if f.name == shown.fruit).position
    axis.scatter(place[i], place[j], marker="*", s=120, c="gold", edgecolors="k", zorder=5, label=f"{shown.fruit}, grasp")


def _draw_robot(axis: Any, chain: Chain, q: np.ndarray, i: int, j: int) -> None:
    from matplotlib.patches import Circle

    columns = [np.array([x]) for x in q]
    for count, skeleton in skeletons(chain, columns, np.float64).items():
        corners = np.stack([np.stack([np.broadcast_to(x, skeleton.link.shape) for x in c], -1) for c in skeleton.corners], 1)
        for points, radius, link in zip(corners, skeleton.radius, skeleton.link, strict=True):
            colour = f"C{link % 10}"
            for point in points:
                axis.add_patch(Circle(point[[i, j]], radius, fc=colour, ec=colour, alpha=0.15 if count == 1 else 0.5))
            if count > 1:
                axis.plot(points[:, i], points[:, j], color=colour, lw=2)
    joints = bones(chain, q)
    axis.plot(joints[:, i], joints[:, j], "k.-", lw=1.5, ms=5, label="joints and tip")


def _draw_map(figure: Any, axis: Any, row: Posture, chain: Chain) -> None:
    """The best clearance over branches and further leading joints, for each approach angle and first leading joint."""
    found, table = row.scan, row.scan.table
    leads = found.leading.shape[1] > 0
    first = np.unique(found.leading[:, 0]) if leads else np.zeros(1)
    columns = np.searchsorted(first, table.leading[:, 0]) if leads else np.zeros(len(table.angle), int)
    best = np.full((len(found.angles), len(first)), np.nan)
    for a, s, distance in zip(np.searchsorted(found.angles, table.angle), columns, table.clearance, strict=True):
        best[a, s] = np.fmax(best[a, s], distance)
    sides = (float(first[0]), float(first[-1])) if len(first) > 1 else (0.0, 1.0)
    extent = (*sides, float(np.degrees(found.angles[0])), float(np.degrees(found.angles[-1])))
    span = max(float(np.nanmax(np.abs(best), initial=0.01)), 0.01) * 1000.0
    picture = axis.imshow(1000.0 * best, origin="lower", aspect="auto", extent=extent, cmap="RdYlGn", vmin=-span, vmax=span)
    figure.colorbar(picture, ax=axis, label="best clearance [mm]; blank: no posture inside the limits")
    if row.success and leads:
        axis.plot(row.q[0], np.degrees(row.angle), "k*", ms=12)
    lead = f"{chain.joint_names[0]} [{'m' if chain.is_prismatic[0] else 'rad'}]" if leads else "no leading joint"
    axis.set(xlabel=lead, ylabel="approach angle [deg]", title=f"{row.fruit}: clearance map")


def _draw_fates(axis: Any, result: Harvest) -> None:
    names = [row.fruit for row in result.rows]
    heights = [1000.0 * row.clearance if row.success else 0.0 for row in result.rows]
    axis.bar(names, heights, color="tab:green")
    for k, row in enumerate(result.rows):
        if not row.success:
            removal = row.blockers.removal if row.blockers else None
            text = row.reason.text + (f": remove {', '.join(removal)}" if removal else "")
            axis.text(k, 1.0, text, rotation=90, ha="center", va="bottom", fontsize=8, color=COLOURS.get(row.reason, "0.4"))
    axis.tick_params(axis="x", rotation=90)
    axis.set(ylabel="clearance [mm]", title="every fruit")
