"""Pictures of motions that look ahead: `python batch_eval/predictive_pictures.py FOLDER` draws figs. 5.1 to 5.8, 5.10 and 5.11
of Schuetz 2017 anew, and two animations, instantaneous beside predictive; the statistics from `predictive_statistics.json`.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, get_args

import jax
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from setups import pendulum
from setups import self_collision as case

import jaxik
from jaxik.optimise.descent import Direction, Search
from jaxik.view.solids import frames

GREY, BLUE, GREEN = "0.6", "tab:blue", "tab:green"


@dataclasses.dataclass(frozen=True)
class Shown:
    """A motion as it is drawn: its samples q and qdot (k, n), the sample time [s]."""

    name: str
    colour: str
    dt: float
    q: np.ndarray
    qdot: np.ndarray

    @property
    def time(self) -> np.ndarray:
        return self.dt * np.arange(len(self.q))

    @property
    def speed(self) -> np.ndarray:
        """The speed of the revolute joints, squared."""
        first = 1 if self.q.shape[1] == 9 else 0
        return np.sum(self.qdot[:, first:] ** 2, axis=1)


def pendulum_motions() -> list[Shown]:
    """The instantaneous one and the optimum."""
    arm = pendulum.arm()
    path, near = pendulum.path(arm), pendulum.position_cost(arm)
    now = jaxik.follow(arm, path, pendulum.DURATION, pendulum.START, cost=near, options=pendulum.INSTANTANEOUS)
    cost = jaxik.costs.quadratic_cost(position=near)
    ahead = jaxik.predict(arm, path, pendulum.DURATION, pendulum.START, cost, options=pendulum.horizon())
    return [
        Shown("instantaneous", GREY, pendulum.DT, now.q[:-1], now.velocity[:-1]),
        Shown("predictive", BLUE, pendulum.DT, np.asarray(ahead.q)[:-1], np.asarray(ahead.velocity)),
    ]


def nine_joint_motions(seconds: Sequence[float] = (0.15, 2.0), alpha: float = 1.0) -> list[Shown]:
    """The instantaneous one, and those under moving horizons."""
    robot = case.arm()
    path, colours = case.path(robot), plt.get_cmap("viridis")(np.linspace(0.3, 0.8, len(seconds)))
    now = case.instantaneous(robot, alpha)
    shown = [Shown("instantaneous", GREY, case.DT, now.q[:-1], now.velocity[:-1])]
    for horizon, colour in zip(seconds, colours, strict=True):
        moved = case.controller(robot, horizon).follow(path, case.DURATION, case.START)
        shown.append(Shown(f"horizon {horizon:g} s", colour, case.DT, moved.q, moved.velocity))
    return shown


def snapshots(motions: Sequence[Shown], times: Sequence[float] = (0.0, 2.0, 2.68, 3.0, 4.0)) -> Any:
    """Fig. 5.1: the pendulum at some moments, all motions in one."""
    figure, axes = plt.subplots(1, len(times), figsize=(2 * len(times), 3.9), sharey=True, layout="constrained")
    for axis, t in zip(axes, times, strict=True):
        _draw_pendulum(axis, motions, t)
        axis.set(title=f"after {t:g} s", xlabel="x [m]")
    axes[0].set_ylabel("y [m]")
    handles, names = axes[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper center", ncols=len(names), frameon=False)
    return figure


def _draw_pendulum(axis: Any, motions: Sequence[Shown], t: float) -> None:
    arm = pendulum.arm()
    path = pendulum.path(arm)
    ends = np.array([path.start[:2, 3], path.end[:2, 3]])
    axis.plot(*ends.T, color=GREEN, lw=1.5, label="path of the tip")
    axis.add_patch(plt.Circle(pendulum.OBSTACLE[:2], pendulum.ACTIVATION, fc="tab:orange", alpha=0.4, label="obstacle"))
    axis.plot(*pendulum.OBSTACLE[:2], "o", color="tab:orange", ms=5)
    for motion in motions:
        k = min(round(t / motion.dt), len(motion.q) - 1)
        axis.plot(*frames(arm, motion.q[k])[1:, :2, 3].T, "o-", color=motion.colour, lw=3, ms=4, label=motion.name)
    axis.set(xlim=(-1.1, 2.1), ylim=(-0.6, 4.2), aspect="equal")


def costs_over_time(motions: Sequence[Shown]) -> Any:
    """Fig. 5.2: speed and collision, with the sums over all samples."""
    near = jax.jit(jax.vmap(pendulum.position_cost(pendulum.arm())))
    figure, axes = plt.subplots(2, 1, figsize=(8, 5), sharex=True, layout="constrained")
    for motion in motions:
        collision = np.asarray(near(motion.q))
        for axis, values, what in zip(axes, (motion.speed, collision), ("speed", "collision"), strict=True):
            axis.plot(motion.time, values, color=motion.colour, lw=2, label=f"{motion.name}: {values.sum():.3g}")
            axis.set_ylabel(f"{what} cost")
            axis.legend(title="sum over the samples", fontsize=8)
    axes[1].set_xlabel("time [s]")
    return figure


def convergence(kind: str) -> Any:
    """Fig. 5.3 (`"direction"`, with a fixed step) or 5.4 (`"search"`, straight down): the cost and beta or alpha by iterations,
    in the text's own way, without restarts."""
    arm = pendulum.arm()
    path, cost = pendulum.path(arm), jaxik.costs.quadratic_cost(position=pendulum.position_cost(arm))
    solve = lambda how: jaxik.predict(arm, path, pendulum.DURATION, pendulum.START, cost, options=pendulum.horizon(how))
    best = float(solve(jaxik.optimise.QUASI_NEWTON).total) / pendulum.DT
    names = [n for n in get_args(Direction if kind == "direction" else Search) if n != "lbfgs"]
    fixed = {"direction": "steepest", "search": "fixed", "step": 0.01, "restart": None, "tolerance": 1e-4}
    figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    for name in names:
        options = fixed | {kind: name}
        if kind == "search" and name != "fixed":
            options["step"] = 0.05
        found = solve(jaxik.optimise.DescentOptions(**options))
        axes[0].plot(np.asarray(found.totals) / pendulum.DT, ".-", label=name.replace("_", " "))
        axes[1].plot(np.asarray(found.betas if kind == "direction" else found.alphas), ".-")
    axes[0].axhline(best, color="k", ls="--", lw=1, label="optimum (L-BFGS)")
    axes[0].set(xlabel="iteration", ylabel="cost, sum over the samples", yscale="log")
    axes[1].set(xlabel="iteration", ylabel="beta" if kind == "direction" else "alpha", ylim=(None, None))
    axes[0].legend(fontsize=8)
    return figure


def statistics(result: dict[str, Any]) -> Any:
    """Figs. 5.5 to 5.8: improvement, success, distance to the best, time."""
    rows = sorted(result["rows"], key=lambda row: row["success"])
    names = [row["who"].replace("_", " ").replace("tpbvp", "boundary value problem") for row in rows]
    place = np.arange(len(rows))
    figure, axes = plt.subplots(1, 3, figsize=(10, 7.5), sharey=True, layout="constrained", width_ratios=(1, 1.4, 1))
    reference = next(row for row in rows if row["who"] == "tpbvp")
    colours = [GREY if row is reference else "tab:red" if "restarts" in row["who"] else BLUE for row in rows]
    axes[0].barh(place, [100 * row["success"] for row in rows], color=colours)
    axes[0].axvline(100 * reference["success"], color="k", ls="--", lw=1)
    axes[0].set(xlabel="success [%]\n(dashed: boundary value problem)", xlim=(50, 100), yticks=place, yticklabels=names)
    boxes = [
        dict(zip(("whislo", "q1", "med", "q3", "whishi"), 100 * np.minimum(row["behind_best"], 1.0), strict=True))
        for row in rows
    ]
    axes[1].bxp(boxes, positions=place, orientation="horizontal", showfliers=False, manage_ticks=False)
    axes[1].axvspan(0, 5, color="0.9", zorder=0)
    axes[1].set(xlabel="short of the best method [points]:\n5, 25, 50, 75, 95 % of the settings", xlim=(-0.5, 20))
    axes[2].barh(place, [row["ms_alone"] for row in rows], color=colours)
    axes[2].set(xlabel="median time of one [ms]", xscale="log")
    spread = ", ".join(f"{round(100 * x)}" for x in result["improvements"])
    figure.suptitle(
        f"{result['judged']} random settings: the best improves the instantaneous motion by\n"
        f"{100 * result['improvement_of_best']:.0f} % on average ({spread} % at 5, 25, 50, 75, 95 %)"
    )
    return figure


def speeds(motions: Sequence[Shown]) -> Any:
    """Fig. 5.11: squared velocities of the revolute joints; and how far the arm stays from itself."""
    robot = case.arm()
    apart = jax.jit(jax.vmap(lambda q: jaxik.clearance(robot, None, q)))
    figure, axes = plt.subplots(2, 1, figsize=(8, 6), sharex=True, layout="constrained")
    for motion in motions:
        axes[0].plot(motion.time, motion.speed, color=motion.colour, lw=2, label=motion.name)
        axes[1].plot(motion.time, 1e3 * np.asarray(apart(motion.q)), color=motion.colour, lw=2)
    axes[0].set(ylabel="sum of squared velocities [rad2/s2]", yscale="log", ylim=(1e-3, None))
    axes[1].set(xlabel="time [s]", ylabel="clearance to itself [mm]")
    axes[1].axhline(0.0, color="tab:red", lw=1)
    axes[0].legend(fontsize=8)
    return figure


def postures(motions: Sequence[Shown], times: Sequence[float] = (0.0, 1.5, 2.2, 2.8, 3.9)) -> Any:
    """Fig. 5.10: the nine joints at some moments, a row of pictures for each motion."""
    size = 2.0 * len(times) + 0.4, 3.2 * len(motions) + 0.6
    figure = plt.figure(figsize=size)
    for i, motion in enumerate(motions):
        figure.text(0.02, 1.0 - (2.3 + 3.2 * i) / size[1], motion.name, rotation=90, va="center", fontsize=12)
        for j, t in enumerate(times):
            corner = 2.0 * j - 0.5, size[1] - 0.6 - 3.2 * (i + 1) - 0.3
            # square, as Matplotlib wants them, and wider than their column, where there is nothing to see
            axis = figure.add_axes((corner[0] / size[0], corner[1] / size[1], 3.8 / size[0], 3.8 / size[1]), projection="3d")
            axis.patch.set_alpha(0.0)
            _draw_nine(axis, motion, t)
            axis.set_axis_off()
    for j, t in enumerate(times):
        figure.text((2.0 * j + 1.3) / size[0], 1.0 - 0.55 / size[1], f"after {t:g} s", ha="center", fontsize=12)
    title = "Thin: the path of the tip. Dark grey: the carriage that the arm must not hit."
    figure.text(0.5, 1.0 - 0.2 / size[1], title, ha="center", fontsize=11)
    return figure


def _draw_nine(axis: Any, motion: Shown, t: float) -> None:
    robot = case.arm()
    k = min(round(t / motion.dt), len(motion.q) - 1)
    frames = np.asarray(_frames(robot, motion.q[k]))
    for volume in robot.volumes:
        ends = volume.corners @ frames[volume.link][:3, :3].T + frames[volume.link][:3, 3]
        colour = "0.4" if volume.link == robot.volumes[0].link else motion.colour
        axis.plot(*ends.T, color=colour, lw=110 * float(volume.radius), solid_capstyle="round", alpha=0.8)
    line = case.path(robot)
    axis.plot(*np.array([line.start[:3, 3], line.end[:3, 3]]).T, color=GREEN, lw=1.5)
    axis.set(xlim=(-0.4, 0.5), ylim=(0.0, 0.8), zlim=(0.4, 1.9))
    axis.set_box_aspect((0.9, 0.8, 1.5))
    axis.view_init(elev=15, azim=-60)
    axis.tick_params(labelsize=6)


_frames = jax.jit(jaxik.kinematics.link_frames, static_argnums=0)


def animate(figure: Any, draw: Any, duration: float, path: Path, every: float = 0.08) -> None:
    """A GIF of `draw(t)`, half as fast as the motion."""
    times = np.arange(0.0, duration, every)
    FuncAnimation(figure, lambda i: draw(times[i]), len(times)).save(path, PillowWriter(fps=round(0.5 / every)))


def animate_pendulum(motions: Sequence[Shown], path: Path) -> None:
    figure, axes = plt.subplots(1, 2, figsize=(7, 5), sharey=True, layout="constrained")

    def draw(t: float) -> None:
        for axis, motion in zip(axes, motions, strict=True):
            axis.clear()
            _draw_pendulum(axis, [motion], t)
            axis.set_title(f"{motion.name}, {t:.2f} s")

    animate(figure, draw, pendulum.DURATION, path)


def animate_nine(motions: Sequence[Shown], path: Path) -> None:
    figure = plt.figure(figsize=(4 * len(motions), 5), layout="constrained")
    axes = [figure.add_subplot(1, len(motions), 1 + i, projection="3d") for i in range(len(motions))]

    def draw(t: float) -> None:
        for axis, motion in zip(axes, motions, strict=True):
            axis.clear()
            _draw_nine(axis, motion, t)
            axis.set_title(f"{motion.name}, {t:.2f} s", fontsize=9)

    animate(figure, draw, case.DURATION, path)


def main(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    save = lambda figure, name: figure.savefig(folder / f"{name}.png", dpi=90)
    found = json.loads((Path(__file__).parent / "predictive_statistics.json").read_text())
    save(statistics(found), "statistics")
    motions = pendulum_motions()
    save(snapshots(motions), "pendulum")
    save(costs_over_time(motions), "pendulum_costs")
    save(convergence("direction"), "directions")
    save(convergence("search"), "searches")
    animate_pendulum(motions, folder / "pendulum.gif")
    motions = nine_joint_motions((0.15, 0.5, 1.0, 2.0))
    save(speeds(motions), "speeds")
    few = [motions[0], motions[-1]]
    save(postures(few), "postures")
    animate_nine(few, folder / "nine_joints.gif")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
