"""The pictures of the documentation, drawn from the library itself: `python docs/pictures.py [name ...]`."""

from __future__ import annotations

import dataclasses
import itertools
import sys
import tempfile
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import matplotlib
import numpy as np

import jaxik
from jaxik.costs import quadratic_cost
from jaxik.motions import Line
from jaxik.reach import prove_reach

matplotlib.use("Agg")
import matplotlib.pyplot as plt

FOLDER = Path(__file__).parent / "pictures"
BLUE, ORANGE, GREEN, RED, GREY, PALE = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#7f7f7f", "#d9d9d9"  # Okabe and Ito's
plt.rcParams |= {"font.size": 10, "axes.spines.top": False, "axes.spines.right": False, "figure.constrained_layout.use": True}


def harvest() -> None:
    """The picture of `jaxik harvest`."""
    from jaxik.view import plot_harvest

    result = jaxik.harvest(jaxik.load("p6r"), jaxik.load_scene("cucumber_row"), margin=0.005)
    plot_harvest(result, FOLDER / "harvest.png")


def motions() -> None:
    """The picture of `jaxik harvest --motions`."""
    from jaxik.view import plot_harvest_plan

    result = jaxik.harvest(jaxik.load("p6r"), jaxik.load_scene("cucumber_row"), margin=0.005)
    plot_harvest_plan(jaxik.harvesting.plan_harvest(result, margin=0.002), FOLDER / "motions.png")


def two_arms() -> None:
    """The picture of `jaxik harvest --arms 2 --motions`."""
    from jaxik.view import plot_harvest_plan

    result = jaxik.harvest(jaxik.load("p6r_pair"), jaxik.load_scene("cucumber_row"), margin=0.005)
    plot_harvest_plan(jaxik.harvesting.plan_harvest(result, margin=0.002), FOLDER / "two_arms.png")


def reach() -> None:
    """The picture of `jaxik sweep --plot`, of the page's study on a finer grid."""
    from jaxik.view import plot_sweep

    grid = {"kind": "grid", "x": [-0.3, 1.3, 33], "y": [0.2, 0.9, 15], "z": [0.0, 1.0, 21]}
    study = {
        "name": "p6r beside the row",
        "robot": "p6r",
        "slides": 21,
        "targets": grid | {"directions": [[0, 1, 0], [1, 1, 0], [-1, 1, 0]]},
        "collision": {"scene": "cucumber_row", "margin": 0.005},
        "base": {"y": [0.0, 0.1]},
    }
    with tempfile.TemporaryDirectory() as folder:
        jaxik.sweep(study, f"{folder}/row.zarr")
        plot_sweep(f"{folder}/row.zarr", FOLDER / "reach.png")


def base_poses() -> None:
    """Where a TIAGo (of example-robot-data) must stand for the grasps of `batch_eval/base_poses_benchmark.py`."""
    sys.path.insert(0, str(Path(__file__).parents[1] / "batch_eval"))
    import base_poses_benchmark as of

    from jaxik.view import plot_base_poses

    robot, targets = of.loaded(), of.targets()
    region = {"x": (-1.5, 1.5, 30), "y": (-1.5, 1.5, 30), "headings": 12}
    found = jaxik.reach.base_poses(robot, targets, **region, scene=of.TABLE)
    plot_base_poses(found, targets, FOLDER / "base_poses.png", robot=robot, scene=of.TABLE)


def kernels() -> None:
    """XLA's row of loops over a batch, and a kernel's one."""
    figure, axes = plt.subplots(1, 2, figsize=(10, 3.2))
    steps, columns = ("sines", "frames", "tip", "distance", "cost"), 16
    for axis, title in zip(
        axes, ("XLA: a row of loops over the batch", "a kernel: one loop, all steps in registers"), strict=True
    ):
        axis.set(title=title, xlim=(-2.4, columns + 0.3), ylim=(-0.7, len(steps) + 0.6), xticks=[], yticks=[])
        axis.spines[:].set_visible(False)
        for row, name in enumerate(reversed(steps)):
            axis.text(-0.3, row + 0.4, name, ha="right", va="center")
        axis.text(columns / 2, -0.5, "configurations of the batch", ha="center")
    for row in range(len(steps)):
        for column in range(columns):
            axes[0].add_patch(plt.Rectangle((column + 0.08, row + 0.08), 0.84, 0.64, color=PALE))
        axes[0].annotate("", (columns, row + 0.4), (0, row + 0.4), arrowprops={"arrowstyle": "->", "color": BLUE, "lw": 2})
    for row in range(1, len(steps)):
        axes[0].text(columns / 2, row - 0.12, "memory", ha="center", va="center", fontsize=7, color=RED)
    for start in range(0, columns, 4):
        axes[1].add_patch(plt.Rectangle((start + 0.08, 0.08), 3.84, len(steps) - 0.16, color=PALE))
        axes[1].annotate(
            "", (start + 2, 0.15), (start + 2, len(steps) - 0.15), arrowprops={"arrowstyle": "->", "color": BLUE, "lw": 2}
        )
    axes[1].text(2, len(steps) + 0.25, "a vector of lanes", ha="center", fontsize=8, color=BLUE)
    _save(figure, "kernels")


def inverse_kinematics() -> None:
    """Seeds of one target: where they start and end, and how their errors fall."""
    robot, steps = jaxik.load("pendulum4"), 16
    task = jaxik.Task.pose(("z", "roll", "pitch", "yaw"), axes="base")
    target = np.eye(4)
    target[:2, 3] = 1.4, 2.2
    seeds = np.random.default_rng(4).uniform(-np.pi, np.pi, (5, 4)).astype(np.float32)
    figure, axes = plt.subplots(1, 2, figsize=(10, 4), width_ratios=(1, 1.15))
    places = jax.vmap(lambda q: jaxik.kinematics.link_frames(robot, q)[:, :3, 3])
    tip = jax.vmap(lambda q: jaxik.forward_kinematics(robot, q)[:3, 3])
    solve = jax.vmap(lambda q: jaxik.ik.descend_ik(robot, jnp.asarray(target, jnp.float32), q, task=task, iterations=steps).q)
    for q, colour, label in ((seeds, "#b0b0b0", "seeds"), (np.asarray(solve(seeds)), BLUE, "after some steps")):
        for i, (arm, end) in enumerate(zip(np.asarray(places(q)), np.asarray(tip(q)), strict=True)):
            line = np.vstack([arm, end])
            axes[0].plot(line[:, 0], line[:, 1], "-o", color=colour, ms=4, lw=2, label=label if i == 0 else None)
    axes[0].plot(*target[:2, 3], "*", color=RED, ms=16, label="target", zorder=5)
    axes[0].set(xlabel="x [m]", ylabel="y [m]", aspect="equal", title="five seeds, one target, many answers")
    axes[0].set(xlim=(-2.2, 2.6), ylim=(-1.6, 3.8))
    axes[0].legend(fontsize=8, loc="lower right")

    robot = jaxik.load("p6r")
    q = jnp.array([0.3, 0.2, -0.5, -0.4, 0.3, 0.5, 0.1])
    pose = jaxik.forward_kinematics(robot, q)
    seeds = np.random.default_rng(0).uniform(robot.lower, robot.upper, (40, 7)).astype(np.float32)
    short = lambda q: jnp.linalg.norm(jaxik.forward_kinematics(robot, q) - pose)
    errors = np.array(
        [
            jax.vmap(lambda q, k=k: short(jaxik.ik.descend_ik(robot, pose, q, iterations=k).q if k else q))(seeds)
            for k in range(steps + 1)
        ]
    )
    landed = errors[-1] < 1e-4
    for mask, colour, label in ((~landed, ORANGE, "given up"), (landed, BLUE, "landed")):
        lines = axes[1].semilogy(np.maximum(errors[:, mask], 3e-7), color=colour, alpha=0.7, lw=1.2)
        lines[0].set_label(f"{label}: {int(mask.sum())} of {len(seeds)}")
    axes[1].set(xlabel="SQP steps", ylabel="distance to the pose", title="P6R, a pose, 40 random seeds, float32")
    axes[1].legend(fontsize=8)
    _save(figure, "inverse_kinematics")


def collision() -> None:
    """The nearest pair of a posture, and how a whole motion is proven free."""
    robot, scene = jaxik.load("p6r"), jaxik.load_scene("cucumber_row")
    q = jnp.array([0.3, 0.2, -0.5, -0.4, 0.3, 0.5, 0.1]).at[1].add(0.25)
    figure, axes = plt.subplots(1, 2, figsize=(10, 4.2), width_ratios=(1, 1.25))
    centres, radii = (np.asarray(x) for x in jaxik.collision.robot_spheres(robot, q))
    for centre, radius in zip(centres, radii, strict=True):
        axes[0].add_patch(plt.Circle(centre[[0, 2]], radius, color=BLUE, alpha=0.15, lw=0))
    points = np.asarray(scene.points.center)
    axes[0].scatter(points[:, 0], points[:, 2], s=5, color=GREEN, label="leaves: points")
    for a, b in zip(np.asarray(scene.capsules.a), np.asarray(scene.capsules.b), strict=True):
        axes[0].plot([a[0], b[0]], [a[2], b[2]], color=GREY, lw=2, alpha=0.6)
    nearest = jaxik.explain(robot, scene, q, count=1).contacts[0]
    pair = np.array([nearest.point, nearest.other_point])
    axes[0].plot(pair[:, 0], pair[:, 2], "-o", color=RED, ms=4, lw=2, label=f"nearest pair: {1e3 * nearest.distance:.0f} mm")
    axes[0].set(xlim=(-0.25, 0.95), ylim=(-0.05, 1.1), aspect="equal", xlabel="x [m]", ylabel="z [m]")
    axes[0].set_title("P6R as spheres, seen from the front")
    axes[0].legend(fontsize=8, loc="upper right")

    after = q + jnp.array([0.24, 0.35, -0.38, 0.05, 0.28, -0.09, -0.01])
    distance = jax.jit(jax.vmap(lambda t: jaxik.clearance(robot, scene, q + t * (after - q))))
    t = np.linspace(0.0, 1.0, 801)
    gap = 1e3 * np.asarray(distance(t))
    assert gap.min() > 1.0
    fastest = 1.6 * np.abs(np.gradient(gap, t)).max()  # of the picture; the library's bound is each link's own
    axes[1].plot(t, gap, color=BLUE, lw=2, label="clearance, unknown to the search")
    at, count = 0.0, 0
    while at < 1.0:
        here = float(np.interp(at, t, gap))
        reach = np.linspace(at, min(1.0, at + here / fastest), 2)
        axes[1].fill_between(reach, here - fastest * (reach - at), 0.0, color=ORANGE, alpha=0.25, lw=0)
        axes[1].plot(
            reach, here - fastest * (reach - at), color=ORANGE, lw=1.2, label="cannot fall faster" if not count else None
        )
        axes[1].plot(at, here, "o", color=RED, ms=4, label="measured" if not count else None)
        at, count = at + max(here / fastest, 1e-3), count + 1
    axes[1].axhline(0.0, color="black", lw=0.8)
    axes[1].set(
        xlabel="fraction of the motion",
        ylabel="clearance [mm]",
        title=f"a whole motion is free: proven by {count} configurations",
    )
    axes[1].legend(fontsize=8, loc="upper right")
    _save(figure, "collision")


def between() -> None:
    """A target that the grid of the slide misses: found between its positions, and the rest proven to be empty."""
    jax.config.update("jax_enable_x64", True)
    robot, slides, depth = jaxik.load("p6r"), 11, 5
    rng = np.random.default_rng(1)
    q = rng.uniform(robot.lower, robot.upper, (20_000, 7))
    poses = np.asarray(jax.jit(jax.vmap(lambda q: jaxik.forward_kinematics(robot, q)))(q))
    fine = np.linspace(robot.lower[0], robot.upper[0], 2001)
    branches = jax.jit(
        lambda pose: jax.vmap(
            lambda slide: _freedom(robot, jaxik.closed_form(robot, pose, slide)),
        )(fine)
    )
    every = (len(fine) - 1) // (slides - 1)
    for pose in poses:
        freedom = np.asarray(branches(pose))
        best = np.nanmax(np.nan_to_num(freedom, nan=-9.0), axis=1)
        if best.max() > 0.01 and best[:: every // 4].max() < 0.0 and np.isfinite(freedom).any(axis=1).mean() > 0.4:
            break
    else:
        raise SystemExit("no such target among these")
    figure, axes = plt.subplots(2, 1, figsize=(8, 5), sharex=True, height_ratios=(1.2, 1))
    axes[0].plot(fine, freedom, color=BLUE, lw=1.2)
    axes[0].axhline(0.0, color="black", lw=0.8)
    axes[0].plot(
        fine[::every],
        np.maximum(best[::every], -0.97),
        "o",
        color=ORANGE,
        label="the grid: past a limit, or no branch at all (-1)",
    )
    inside = np.where(best > 0.0, best, np.nan)
    axes[0].plot(fine, inside, color=GREEN, lw=4, label="inside the limits")
    axes[0].set(ylim=(-1.0, max(0.2, 1.4 * best.max())), ylabel="freedom of each branch\n(< 0: past a limit)")
    axes[0].legend(fontsize=8, loc="center left")
    axes[0].set_title("one target, all positions of the slide")
    _cells(axes[1], robot, pose, slides, depth)
    _save(figure, "between")


def _freedom(robot: jaxik.Robot, found: jaxik.analytic.ClosedForm) -> Any:
    """The freedom (8,) of the branches, past a limit below 0, NaN where they do not have the pose."""
    low, high = np.asarray(robot.lower)[1:], np.asarray(robot.upper)[1:]
    middle, half = (low + high) / 2.0, (high - low) / 2.0
    away = found.q[:, 1:] - middle
    away = jnp.abs(away - 2.0 * jnp.pi * jnp.round(away / (2.0 * jnp.pi)))
    return jnp.where(found.valid, jnp.min(1.0 - away / half, axis=1), jnp.nan)


def _cells(axis: Any, robot: jaxik.Robot, pose: np.ndarray, slides: int, depth: int) -> None:
    """The intervals of the slide that `between` looks at, halved where they stay possible."""
    edges = np.linspace(robot.lower[0], robot.upper[0], slides)
    cells = list(itertools.pairwise(edges))
    shown: set[str] = set()
    for level in range(depth + 1):
        left = []
        for low, high in cells:
            lower, upper = np.array(robot.lower), np.array(robot.upper)
            lower[0], upper[0] = low, high
            here = prove_reach(dataclasses.replace(robot, lower=lower, upper=upper), pose[None], slides=2, refine=0)
            kind = {"solved": "found in its middle", "not converged": "still possible"}.get(str(here[0].reason), "proven empty")
            colour = {"found in its middle": GREEN, "still possible": ORANGE, "proven empty": PALE}[kind]
            label = None if kind in shown else kind
            shown.add(kind)
            axis.add_patch(plt.Rectangle((low, level + 0.1), high - low, 0.8, fc=colour, ec="white", lw=0.5, label=label))
            if kind == "still possible":
                left += [(low, (low + high) / 2), ((low + high) / 2, high)]
        cells = left
        if kind_found := "found in its middle" in shown:
            break
    axis.set(
        ylim=(level + 1.1, -0.1), xlabel="position of the slide [m]", ylabel="times halved", yticks=np.arange(level + 1) + 0.5
    )
    axis.set_yticklabels(range(level + 1))
    axis.legend(fontsize=8, loc="lower left")
    assert kind_found


def predictive() -> None:
    """The pendulum that passes an obstacle: moment by moment, and ahead of time."""
    jax.config.update("jax_enable_x64", True)
    arm = jaxik.load("pendulum4")
    q = np.radians([30.0, -30.0, -30.0, -60.0])
    start = np.asarray(jaxik.forward_kinematics(arm, q))
    end = start.copy()
    end[:2, 3] = 0.5, 0.0
    path, task = Line(start, end), jaxik.Task.pose(("z", "roll", "pitch", "yaw"), axes="base")
    scene = jaxik.make_scene(points=[[1.0, 1.1, 0.0]])
    near = lambda q: 500.0 / 3.0 * jnp.maximum(0.2 - jaxik.clearance(arm, scene, q), 0.0) ** 3
    now = jaxik.follow(arm, path, 4.0, q, cost=near, dt=0.01, alpha=0.1, task=task)
    best = jaxik.optimise.QUASI_NEWTON
    ahead = jaxik.predict(arm, path, 4.0, q, quadratic_cost(position=near), dt=0.01, count=400, task=task, descend=best)
    figure, axes = plt.subplots(1, 3, figsize=(11, 4), width_ratios=(1, 1, 1.3))
    places = jax.vmap(lambda q: jaxik.kinematics.link_frames(arm, q)[:, :3, 3])
    tip = jax.vmap(lambda q: jaxik.forward_kinematics(arm, q)[:3, 3])
    for axis, motion, colour, title in (
        (axes[0], now, GREY, "moment by moment (follow)"),
        (axes[1], ahead, BLUE, "ahead of time (predict)"),
    ):
        some = np.asarray(motion.q)[:400:57]
        for k, (arms, ends) in enumerate(zip(np.asarray(places(some)), np.asarray(tip(some)), strict=True)):
            line = np.vstack([arms, ends])
            axis.plot(line[:, 0], line[:, 1], "-o", color=colour, ms=3, lw=1.5, alpha=0.25 + 0.75 * k / len(some))
        axis.add_patch(plt.Circle((1.0, 1.1), 0.2, color=RED, alpha=0.2, lw=0))
        axis.plot(1.0, 1.1, "x", color=RED)
        axis.plot([start[0, 3], end[0, 3]], [start[1, 3], end[1, 3]], "--", color="black", lw=1)
        axis.set(title=title, xlabel="x [m]", ylabel="y [m]", aspect="equal", xlim=(-1.2, 1.8), ylim=(-0.3, 4.0))
    for motion, colour, style, label in ((now, GREY, "--", "moment by moment"), (ahead, BLUE, "-", "ahead of time")):
        speed = np.linalg.norm(np.asarray(motion.velocity)[:400], axis=1)
        axes[2].plot(0.01 * np.arange(len(speed)), speed, style, color=colour, lw=2, label=label)
    axes[2].set(xlabel="time [s]", ylabel="speed of the joints [rad/s]", title="no late dodging")
    axes[2].legend(fontsize=8)
    _save(figure, "predictive")


def replanned() -> None:
    """A robot over a table in whose way two things appear: where its hand was going and went, and how fast the joints are."""
    cell = jaxik.make_scene(boxes=[[0.6, 0.0, -0.06, 0.8, 1.6, 0.1]]).with_room(boxes=8)
    start, goal = np.array([[side * 0.9, 0.4, 0.0, -1.9, 0.0, 2.2, 0.8] for side in (-1.0, 1.0)])
    robot = jaxik.load("panda")
    arm = jaxik.Replanner(robot, start, scene=cell, margin=0.01, acceleration=8.0, jerk=200.0)
    arm.go(goal)
    things = {4: ("box", [0.5, 0.0, 0.35, 0.1, 0.1, 0.7]), 33: ("post", [0.56, 0.33, 0.3, 0.06, 0.06, 0.6])}
    hand = jax.vmap(lambda q: jaxik.forward_kinematics(robot, q)[:2, 3])
    figure, (above, beside) = plt.subplots(1, 2, figsize=(9, 4.4), width_ratios=(1, 1.4))
    colours, updates = iter((GREY, ORANGE, GREEN)), 1.0 / 30.0 * np.arange(120)
    done: list[Any] = []
    for k, time in enumerate(updates):
        if k in things:
            name, box = things[k]
            cell = cell.with_(name, boxes=[box])
            above.add_patch(
                plt.Rectangle(np.subtract(box[:2], np.divide(box[3:5], 2.0)), *box[3:5], color=RED, alpha=0.3, lw=0)
            )
            above.text(box[0] - 0.08, box[1], f"{name}, from\n{time:.1f} s on", fontsize=8, ha="right", va="center")
            beside.axvline(time, color=RED, lw=1)
        command = arm.update(time, cell)
        if command.event == "replanned":
            colour = next(colours)
            to_come = command.at(time + np.linspace(0.0, 4.0, 400))
            above.plot(*np.asarray(hand(to_come.q)).T, "--", lw=1.5, color=colour, label=f"planned at {time:.1f} s")
        done.append(command.at(time))
    above.plot(*np.asarray(hand(np.stack([each.q for each in done]))).T, color=BLUE, lw=2, zorder=0, label="done")
    beside.plot(updates, np.abs([each.velocity for each in done]).max(axis=1), color=BLUE, lw=2)
    above.set(title="the hand from above", xlabel="x [m]", ylabel="y [m]", aspect="equal", xlim=(0.1, 1.1))
    above.legend(fontsize=8, frameon=False, loc="center right")
    beside.set(title="it brakes, and goes on another way", xlabel="time [s]", ylabel="fastest joint [rad/s]")
    _save(figure, "replanned")


def external_torque() -> None:
    """The estimate of a push on an arm whose friction is known to a tenth, and the band within which no motor current tells."""
    from jaxik import estimation

    model, joint = jaxik.load("crops_v2"), 1
    rubs = [dataclasses.replace(d.friction, coulomb=1.1 * d.friction.coulomb) for d in model.drives]
    arm = model.with_drives(dataclasses.replace(d, friction=f) for d, f in zip(model.drives, rubs, strict=True))
    middle, away = np.array([0.5, 0, 0, 0, 0.3, 0.1, 0.4, 0.2, 0.1]), np.array([0, 0.3, 0.2, 0.2, 0.1, 0.1, 0.1, 0.1, 0.1])
    motion = jaxik.planning.time_path([middle - away, middle + away], profile="quintic", velocity=0.4, acceleration=2.0)
    push = estimation.Push("body4", [0.16, 0.0, -0.03], force=[20.0, 0.0, 0.0], start=1.0, end=1.5)
    sensors = estimation.PlayOptions(current_noise=0.05, current_step=0.01, rest=(0.2, 0.2))
    log = estimation.play(arm, motion, pushes=[push], model=model, options=sensors).asked
    estimator = estimation.TorqueEstimator(model, estimation.TorqueFilter.of_drives(model, 0.05, 0.05), width=0.005)
    found = estimation.estimate(estimator, log)[:, joint]
    band = float(jaxik.dynamics.friction_band(model, jaxik.dynamics.gravity_torque(model, middle))[joint])
    figure, (above, below) = plt.subplots(2, 1, figsize=(8, 4.4), sharex=True, height_ratios=(3, 1))
    slow = np.abs(log.velocity[:, joint]) < 0.02
    above.fill_between(
        log.time, -band, band, where=slow, color=PALE, lw=0, label="friction's band, where the joint nearly rests"
    )
    above.plot(log.time, log.external[:, joint], color=GREY, lw=1.5, label="what the push does to the joint")
    above.plot(log.time, found, color=BLUE, lw=1.5, label="the estimate, from the motor's current")
    above.set(ylabel=f"torque of {model.joint_names[joint]} [Nm]")
    above.legend(fontsize=8, frameon=False)
    below.plot(log.time, log.velocity[:, joint], color=ORANGE, lw=1.5)
    below.set(xlabel="time [s]", ylabel="speed [rad/s]")
    _save(figure, "external_torque")


def _save(figure: Any, name: str) -> None:
    figure.savefig(FOLDER / f"{name}.png", dpi=110)
    plt.close(figure)


ALL = (
    harvest,
    motions,
    two_arms,
    reach,
    base_poses,
    kernels,
    inverse_kinematics,
    collision,
    between,
    predictive,
    replanned,
    external_torque,
)

if __name__ == "__main__":
    wanted = sys.argv[1:] or [draw.__name__ for draw in ALL]
    for draw in ALL:
        if draw.__name__ in wanted:
            print(draw.__name__)
            draw()
