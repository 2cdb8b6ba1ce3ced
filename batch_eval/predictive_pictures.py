"""Pictures of motions that look ahead: `python batch_eval/predictive_pictures.py FOLDER` draws figs. 5.1 to 5.11 of
Schuetz 2017 anew, and two animations, instantaneous beside predictive; what takes long from `predictive_statistics.json` and
`looking_ahead.json`.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import looking_ahead
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from setups import pendulum
from setups import self_collision as case

import jaxik
from jaxik.view.solids import frames

RESULTS = "predictive_statistics", "looking_ahead"
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
    """The instantaneous one, the optimum of the boundary value problem, and what `predict` finds."""
    now, ahead = (
        looking_ahead.instantaneous(),
        looking_ahead.predicted(pendulum.PRINTED, direction="fletcher_reeves", search="polynomial", guess="gradient"),
    )
    best = looking_ahead.at_samples(looking_ahead.tpbvp(pendulum.PRINTED))
    return [
        Shown("instantaneous", GREY, pendulum.DT, now.q[:-1], now.velocity[:-1]),
        Shown("boundary value problem", BLUE, pendulum.DT, *best),
        Shown("predictive", "tab:purple", pendulum.DT, np.asarray(ahead.q)[:-1], np.asarray(ahead.velocity)),
    ]


def nine_joint_motions(seconds: Sequence[float] = (0.15, 2.0), alpha: float = 0.01) -> list[Shown]:
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


def convergence(kind: str, found: dict[str, Any]) -> Any:
    """Fig. 5.3 (`"directions"`, with a fixed step) or 5.4 (`"searches"`, straight down): the cost and beta or alpha by
    iterations, a row for each zeta_coll."""
    zetas = found[kind]
    figure, axes = plt.subplots(len(zetas), 2, figsize=(10, 3.6 * len(zetas)), layout="constrained", squeeze=False)
    for (left, right), (zeta, rows), passing in zip(axes, zetas.items(), found["passing"], strict=True):
        for row in rows:
            left.plot(row["totals"], ".-", label=row["who"].replace("_", " "))
            right.plot(row["gains"], ".-")
        left.axhline(passing["tpbvp"]["total"], color="k", ls="--", lw=1, label="boundary value problem")
        left.set(xlabel="iteration", ylabel="cost, sum over the samples", title=f"zeta_coll {zeta} 1/m3")
        right.set(xlabel="iteration", ylabel="beta" if kind == "directions" else "alpha")
    axes[0, 0].legend(fontsize=8)
    return figure


def levels(found: dict[str, Any]) -> Any:
    """Fig. 5.9: the joints' velocities under a moving horizon, the input on the level of velocity and of acceleration."""
    figure, axes = plt.subplots(1, 2, figsize=(10, 3.6), sharey=True, layout="constrained")
    for axis, level in zip(axes, ("velocity", "acceleration"), strict=True):
        rate = np.array(found[level]["velocity_rad_s"])
        axis.step(pendulum.DT * np.arange(len(rate)), rate, where="post", lw=1.2)
        axis.set(xlabel="time [s]", title=f"input: {level} (jumps of {found[level]['jump_rad_s']:.2f} rad/s)")
    axes[0].set_ylabel("velocity of the joints [rad/s]")
    axes[0].legend([f"joint {i + 1}" for i in range(4)], fontsize=8)
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
    statistical, found = (json.loads(Path(__file__).with_name(f"{name}.json").read_text()) for name in RESULTS)
    save(statistics(statistical), "statistics")
    motions = pendulum_motions()
    save(snapshots(motions), "pendulum")
    save(costs_over_time(motions), "pendulum_costs")
    save(convergence("directions", found), "directions")
    save(convergence("searches", found), "searches")
    save(levels(found["levels"]), "levels")
    animate_pendulum(motions[:2], folder / "pendulum.gif")
    motions = nine_joint_motions((0.15, 0.5, 1.0, 2.0))
    save(speeds(motions), "speeds")
    few = [motions[0], motions[-1]]
    save(postures(few), "postures")
    animate_nine(few, folder / "nine_joints.gif")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
