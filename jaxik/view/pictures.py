"""What all pictures share (matplotlib, no window needed), and the picture of what a motion takes of the joints."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from jaxik.kinematics.robot import Robot
from jaxik.view.palette import INK
from jaxik.view.solids import Solid

NEAR = 0.25  # of its limit, from which on a torque is drawn beside it


def draw_solids(axis: Any, solids: Iterable[Solid], i: int, j: int, **looks: Any) -> None:
    """Fills the outlines of solids, as seen along the third axis; `looks` are those of a `PolyCollection`."""
    axis.add_collection(PolyCollection([solid.outline(i, j) for solid in solids], **looks))


def marker(colour: str, shape: str, label: str, **looks: Any) -> Line2D:
    """A legend's entry of a marker without a line."""
    return Line2D([], [], color=colour, marker=shape, lw=0, label=label, **looks)


def inches(figure: Figure, *lengths: float) -> list[float]:
    """Lengths across and up in turn [inches], as fractions of a figure's."""
    return [length / figure.get_size_inches()[k % 2] for k, length in enumerate(lengths)]


def write_around(
    figure: Figure, left: float, lines: Sequence[tuple[float, str]], low: float, entries: Sequence[Any], columns: int
) -> None:
    """Writes a title and a line below it, each so far from the top, and a legend so far from the bottom [inches]."""
    height = figure.get_size_inches()[1]
    for (below, words), looks in zip(lines, ({"fontsize": 15, "weight": "bold"}, {"fontsize": 10}), strict=True):
        figure.text(*inches(figure, left, height - below), words, color=INK, **looks)
    place = inches(figure, left, low)
    figure.legend(handles=entries, loc="lower left", bbox_to_anchor=place, ncols=columns, fontsize=9, frameon=False)


def plot_torques(
    robot: Robot, time: np.ndarray, torque: np.ndarray, holding: np.ndarray, path: str | Path, *, title: str = ""
) -> None:
    """Draws a row a joint: its torque (i, n) [Nm, N] over `time` (i,) [s], what would hold the arm at rest there (i, n), and
    its limit `robot.effort`, as a line where it is near. Host."""
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
