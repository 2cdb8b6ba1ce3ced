"""A picture of a tool's path (matplotlib, no window needed): coloured by what limits it, and the joints along it."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

import numpy as np

from jaxik.kinematics.robot import Robot
from jaxik.planning.tool_result import PathResult
from jaxik.reasons import Reason
from jaxik.view.palette import BAD, COLOURS, INK, SCALE, WORDS

AXES = "xyz"
OTHERS = {Reason.SINGULAR: (BAD, "a joint would have to jump"), Reason.TOO_FAST: (BAD, "a joint is too slow for the feed")}


def plot_path(robot: Robot, poses: Any, result: PathResult, path: str | Path) -> None:
    """Draws the places of poses (N, 4, 4) across the two axes along which they go furthest, each coloured by the share of its
    velocity limit that the fastest joint takes there, or by the reason why that part cannot be done; and below the joints by
    the way along the path. Host."""
    import matplotlib.pyplot as plt

    places = np.asarray(poses, float)[:, :3, 3]
    i, j = sorted(np.argsort(np.nan_to_num(np.ptp(places, axis=0)))[1:].tolist())
    figure, (above, below) = plt.subplots(2, 1, figsize=(8.0, 9.0), height_ratios=[3, 2], layout="constrained")
    above.margins(0.1)
    above.set(xlabel=f"{AXES[i]} [m]", ylabel=f"{AXES[j]} [m]", title=textwrap.fill(str(result.why), 90), aspect="equal")
    above.plot(places[:, i], places[:, j], color=INK, lw=0.5)
    if result.success:
        state = result.trajectory.at_times(np.asarray(result.at))
        share = np.max(np.abs(state.velocity) / robot.velocity, axis=1)
        drawn = above.scatter(places[:, i], places[:, j], c=share, cmap=SCALE, vmin=0.0, vmax=1.0, s=12, zorder=2)
        figure.colorbar(drawn, ax=above, label="velocity of the fastest joint, as a share of its limit")
    for arc in result.arcs:
        some = slice(arc.first, arc.last + 1)
        colour, words = OTHERS.get(arc.reason, (COLOURS.get(arc.reason, BAD), WORDS.get(arc.reason, str(arc.reason))))
        above.scatter(places[some, i], places[some, j], color=colour, edgecolor=INK, lw=0.3, s=20, label=words, zorder=3)
    if result.lifts:
        lifts = list(result.lifts)
        above.scatter(places[lifts, i], places[lifts, j], marker="^", color=BAD, label="lifts off", zorder=4)
    if result.arcs or result.lifts:
        above.legend()
    if np.isfinite(result.q).any():
        _joints(below, robot, result)
    else:
        below.set_axis_off()
    figure.savefig(path)
    plt.close(figure)


def _joints(axis: Any, robot: Robot, result: PathResult) -> None:
    low, high = robot.finite_limits
    for k, name in enumerate(robot.joint_names):
        axis.plot(result.s, (result.q[:, k] - low[k]) / (high[k] - low[k]), label=name)
    axis.set(xlabel="way along the path [m]", ylabel="joint, from one limit to the other", ylim=(0.0, 1.0))
    axis.legend(fontsize=8, ncols=2)
