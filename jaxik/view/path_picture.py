"""A picture of a tool's path (matplotlib, no window needed): coloured by what limits it, and the joints along it."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

import numpy as np

from jaxik.kinematics.robot import Robot
from jaxik.planning.tool_result import PathResult
from jaxik.reasons import Reason
from jaxik.view.palette import BAD, COLOURS, GOOD, INK, NEAR_LIMIT, WORDS

AXES = "xyz"
OTHERS = {Reason.SINGULAR: (BAD, "a joint would have to jump"), Reason.TOO_FAST: (BAD, "a joint is too slow for the feed")}


def plot_path(robot: Robot, poses: Any, result: PathResult, path: str | Path) -> None:
    """Draws the places of poses (N, 4, 4) across the two axes along which they go furthest, each coloured by what limits the
    tip there (`PathResult.limited`), or by the reason why that part cannot be done; and below the joints by the way along the
    path, if there are any. Host."""
    import matplotlib.pyplot as plt

    places = np.asarray(poses, float)[:, :3, 3]
    i, j = sorted(np.argsort(np.nan_to_num(np.ptp(places, axis=0)))[1:].tolist())
    known = bool(np.isfinite(result.q).any())
    size = {"figsize": (9.0, 9.0), "height_ratios": [3, 2]} if known else {"figsize": (9.0, 5.0)}
    figure, axes = plt.subplots(1 + known, 1, squeeze=False, layout="constrained", **size)
    above = axes[0, 0]
    figure.suptitle(textwrap.fill(str(result.why), 100), fontsize=10)
    above.margins(0.1)
    above.set(xlabel=f"{AXES[i]} [m]", ylabel=f"{AXES[j]} [m]", aspect="equal")
    above.plot(places[:, i], places[:, j], color=INK, lw=0.5)
    drawn = lambda some, **how: above.scatter(places[some, i], places[some, j], edgecolor=INK, **how)
    limited = np.array(result.limited)
    for name, colour, words in _limits(robot):
        if (some := limited == name).any():
            drawn(some, color=colour, lw=0.1, s=14, label=words, zorder=2)
    if not len(limited) and not result.success:
        above.plot(places[:, i], places[:, j], color=GOOD, lw=2.0, label="no fault was found here", zorder=1)
    for arc in result.arcs:
        colour, words = OTHERS.get(arc.reason, (COLOURS.get(arc.reason, BAD), WORDS.get(arc.reason, str(arc.reason))))
        drawn(slice(arc.first, arc.last + 1), color=colour, lw=0.3, s=20, label=words, zorder=3)
    if result.lifts:
        drawn(list(result.lifts), marker="^", color=BAD, label="lifts off before here", zorder=4)
    named = dict(zip(*above.get_legend_handles_labels()[::-1], strict=True))  # each once
    if named:
        head = "the tip is limited by" if len(limited) else "why it cannot be done"
        above.legend(named.values(), named.keys(), title=head, loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8)
    if known:
        _joints(axes[1, 0], robot, result)
    figure.savefig(path)
    plt.close(figure)


def _limits(robot: Robot) -> list[tuple[str, Any, str]]:
    """The names of what limits a tip, their colours, and their words."""
    import matplotlib

    joints = matplotlib.colormaps["tab20"]
    named = [(f"velocity of {name}", joints(k % 20), f"the velocity of {name}") for k, name in enumerate(robot.joint_names)]
    return [
        ("feed", GOOD, "the feed"),
        ("turn", NEAR_LIMIT, "the turn of the tip"),
        *named,
        ("tip_speed", "hotpink", "the limit of a tip's speed"),
        ("tip_turn", "gold", "the limit of a tip's turn"),
        ("acceleration", INK, "acceleration or jerk"),
    ]


def _joints(axis: Any, robot: Robot, result: PathResult) -> None:
    low, high = robot.finite_limits
    for k, name in enumerate(robot.joint_names):
        axis.plot(result.s, (result.q[:, k] - low[k]) / (high[k] - low[k]), label=name)
    axis.set(xlabel="way along the path [m]", ylabel="joint, from one limit to the other", ylim=(0.0, 1.0))
    axis.legend(fontsize=8, ncols=2)
