"""The 9-DOF paper (IJE 2022) redone: `python batch_eval/nine_dof.py` writes `nine_dof.json` and its pictures.

Every target of its text is reached in a generated crop (`papers/trellises.py`; the paper's crops are not printed), position
only, since its orientations follow no convention that could be found. The moves of its figures 9 and 15 are planned through
their intermediate places and proven free, and the joints of figure 18 are drawn in the printed 0.01 s and in a time that limits
allow. The paper prints no limits of velocity: these are ours.
"""

from __future__ import annotations

import dataclasses
import itertools
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import matplotlib.pyplot as plt
import numpy as np
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from papers.baselines import global_search, newton_ik
from papers.crossing_surfaces import box_faces
from papers.harvest_costs import box_penalty, link_circles
from papers.image_mapping import fit_mapping
from papers.step_profile import risen
from papers.trellises import TRELLIS_TARGETS, trellis_crop
from peers.panda import pose_of
from race import counted, machine

import jaxik

HERE = Path(__file__)
PAPER_SECONDS = 54.0
PRINTED = {
    "errors_cm": [1.13e-07, 6.79e-08, 2.11e-07, 1.38e-07, 1.50e-07, 1.49e-07],  # table 4
    "seconds": PAPER_SECONDS,
    "ten_links_error": 0.0036,  # of its reference [35], without a unit
    "figure_18_s": 0.01,
    "mapping": {"coefficients": [0.0667, -24.664, 2546.5], "r_squared": 0.9995},  # (3)
    "table_2": {"image_pixel": [202, 214, 253, 280], "field_mm": [280, 330, 570, 870]},
    "figure_8_mm": [42, 36, 60],  # sec. 5.1; table 4 has its like in cm
}
VELOCITY, ACCELERATION = [0.1] + [1.0] * 8, [0.4] + [4.0] * 8  # [m/s, rad/s], [m/s2, rad/s2]
# Figure 9 goes through the places of table 4; those of figure 15 are not printed.
MOVES = {
    "figure_9": ("bitter_gourd", TRELLIS_TARGETS["bitter_gourd"][:6]),
    "figure_15": ("guava", ((49, 69, 62), (51, 35, 61), (53, 1, 61), (55, -33, 60), (57, -67, 60))),
}
TASK = jaxik.Task.position()
OPTIONS = jaxik.IKOptions(task=TASK, position_tolerance=1e-9, margin=0.005)
# Joint variables of table 4: slide [cm], then degrees
TABLE_4 = (
    (8.16, 44.57, 5.33, 50.95, 56.99, -35.41, 6.34, 221.30, 50.87),
    (8.12, 35.38, -4.73, 55.25, 66.34, -31.29, 1.50, -131.07, 43.13),
    (8.14, 27.85, -16.29, 58.61, 74.69, -24.68, 1.50, 30.30, 21.22),
    (8.15, 21.76, -9.88, 55.08, 67.54, -16.94, 1.50, -29.89, -33.31),
    (7.91, 15.60, -2.06, 50.47, 58.72, -11.41, 13.43, 13.45, 34.23),
    (7.84, -15.58, -1.90, 50.38, 58.62, 11.46, 11.76, 33.71, 23.54),
)


def boxes_of(scene: jaxik.Scene) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corners of the scene's (axis-parallel) boxes."""
    centre = np.asarray(scene.boxes.world_T_box)[:, :3, 3]
    return centre - scene.boxes.half, centre + scene.boxes.half


def solve(
    robot: jaxik.Robot, crops: tuple[str, ...] = tuple(TRELLIS_TARGETS), most: int = 9, times_each: int = 11
) -> list[dict[str, Any]]:
    """The targets of the text, so many a crop, each in its crop without the fruit itself."""
    pose, rows = pose_of(robot), []
    penalty = jax.jit(lambda q, low, high: box_penalty(link_circles(robot, q), low, high, 1.0))
    for crop in crops:
        scene, targets = trellis_crop(crop), TRELLIS_TARGETS[crop]
        for i, target in enumerate(np.array(targets[:most], np.float64) / 100.0):
            others = scene.without([scene.object_names.index(f"fruit_{i + 1}")])
            run = lambda others=others, target=target: jaxik.solve_ik(robot, target, scene=others, options=OPTIONS)
            run()  # compiles
            times = []
            for _ in range(times_each):
                start = time.perf_counter()
                result = run()
                times.append(time.perf_counter() - start)
            blind = jaxik.solve_ik(robot, target, task=TASK, position_tolerance=1e-9, collision=False)
            tip = robot.world_T_base @ pose(result.q) if result.success else np.full((4, 4), np.nan)
            low, high = boxes_of(others)
            rows.append(
                {
                    "crop": crop,
                    "target_cm": [float(x) for x in targets[i]],
                    "reason": result.reason.text,
                    "error_m": float(np.linalg.norm((np.linalg.inv(robot.world_T_base) @ tip)[:3, 3] - target)),
                    "limits_kept": bool(np.all((result.q >= robot.lower) & (result.q <= robot.upper))),
                    "clearance_m": float(result.clearance),
                    "boxes_hit_by_points": float(penalty(result.q, low, high)) if result.success else None,
                    "reachable_without_obstacles": bool(blind.success),
                    "ms": 1e3 * float(np.median(times)),
                    "faster_than_paper": PAPER_SECONDS / float(np.median(times)),
                }
            )
    return rows


def paper_rows(robot: jaxik.Robot) -> list[dict[str, Any]]:
    """Table 4's own joint variables: their positions, and which limits of (9) they break."""
    pose, rows = pose_of(robot), []
    for printed, target in zip(TABLE_4, TRELLIS_TARGETS["bitter_gourd"], strict=False):
        q = np.array([printed[0] / 100.0, *np.radians(printed[1:])])
        broken = [n for n, x, a, b in zip(robot.joint_names, q, robot.lower, robot.upper, strict=True) if not a <= x <= b]
        away = np.linalg.norm(pose(q)[:3, 3] - np.array(target) / 100.0)
        rows.append({"target_cm": list(target), "error_m": float(away), "limits_broken": broken})
    return rows


def baselines(robot: jaxik.Robot, starts: int = 100, most: int = 6, generations: int = 400) -> list[dict[str, Any]]:
    """The six rows by the textbook iterations from random starts, and by differential evolution
    with the paper's penalty, of no generations at all where that is 0."""
    rows = []
    scene = trellis_crop("bitter_gourd")
    with jax.enable_x64(True):
        q0 = np.random.default_rng(1).uniform(robot.lower, robot.upper, (starts, robot.num_joints))
        for i, target in enumerate(np.array(TRELLIS_TARGETS["bitter_gourd"][:most]) / 100.0):
            wanted = np.eye(4)
            wanted[:3, 3] = target
            for who, damping in (("Newton-Raphson", 0.0), ("damped least squares", 0.05)):
                run = jax.jit(jax.vmap(lambda q, w=wanted, d=damping: newton_ik(robot, w, q, d, TASK)))
                jax.block_until_ready(run(q0))
                start = time.perf_counter()
                root = jax.block_until_ready(run(q0))
                seconds = time.perf_counter() - start
                inside = np.all((root.x >= robot.lower) & (root.x <= robot.upper), axis=1)
                reached = np.asarray(root.residual) <= 1e-9
                rows.append(
                    {
                        "who": who,
                        "row": i + 1,
                        "reached": float(reached.mean()),
                        "and_limits": float((reached & inside).mean()),
                        "ms_each": 1e3 * seconds / starts,
                    }
                )
            if not generations:
                continue
            start = time.perf_counter()
            found = global_search(robot, wanted, boxes=boxes_of(scene), task=TASK, generations=generations)
            rows.append(
                {
                    "who": "differential evolution",
                    "row": i + 1,
                    "objective": found.objective,
                    "evaluations": found.evaluations,
                    "seconds": time.perf_counter() - start,
                }
            )
    return rows


def units(robot: jaxik.Robot) -> dict[str, Any]:
    """The place of figure 8 read in centimetres, as table 4 is, and in the millimetres that sec. 5.1 prints."""
    scene, place = trellis_crop("bitter_gourd"), np.array(PRINTED["figure_8_mm"], np.float64)
    others = scene.without([scene.object_names.index("fruit_7")])
    rows = {}
    for unit, metres in (("cm", place / 100.0), ("mm", place / 1000.0)):
        found = jaxik.solve_ik(robot, metres, scene=others, options=OPTIONS)
        rows[unit] = {"from_the_base_m": float(np.linalg.norm(metres)), "reason": found.reason.text}
    return rows


def mapping() -> dict[str, Any]:
    """Table 2's fit (3)."""
    pairs = PRINTED["table_2"]
    fit = fit_mapping(pairs["image_pixel"], pairs["field_mm"])
    off = fit(pairs["image_pixel"]) - np.array(pairs["field_mm"])
    return {"coefficients": fit.coefficients.tolist(), "r_squared": fit.r_squared, "off_mm": off.tolist()}


def moves(robot: jaxik.Robot, names: tuple[str, ...] = tuple(MOVES), most: int | None = None) -> dict[str, Any]:
    """The moves of figures 9 and 15 from place to place, or the first few of them, each planned and proven free."""
    return {name: move(robot, MOVES[name][0], MOVES[name][1][:most]) for name in names}


def move(robot: jaxik.Robot, crop: str, places: tuple[tuple[float, ...], ...]) -> dict[str, Any]:
    """One move through places [cm], in its crop without the fruits that hang there; how each leg was judged."""
    whole = trellis_crop(crop)
    met = [i for i, target in enumerate(TRELLIS_TARGETS[crop]) if target in places]
    scene = whole.without([whole.object_names.index(f"fruit_{i + 1}") for i in met])
    q = [np.asarray(jaxik.solve_ik(robot, np.array(places[0]) / 100.0, scene=scene, options=OPTIONS).q)]
    for place in places[1:]:
        near = dataclasses.replace(OPTIONS, choice="closest", reference=q[-1])
        q.append(np.asarray(jaxik.solve_ik(robot, np.array(place) / 100.0, scene=scene, options=near).q))
    clearance = jax.jit(jax.vmap(lambda q: jaxik.clearance(robot, scene, q)))
    low, high = boxes_of(scene)
    inside = jax.jit(jax.vmap(lambda q: box_penalty(link_circles(robot, q), low, high, 1.0)))
    legs = []
    for a, b in itertools.pairwise(q):
        plan = lambda a=a, b=b: jaxik.plan_motion(
            robot, a, b, scene=scene, margin=0.005, velocity=VELOCITY, acceleration=ACCELERATION
        )
        plan()
        start = time.perf_counter()
        moved = plan()
        leg = {"reason": moved.reason.text, "plan_ms": 1e3 * (time.perf_counter() - start)}
        legs.append(leg)
        if not moved:
            continue
        straight = jaxik.motion_clearance(robot, scene, a, b, margin=0.005, enough=0.005, resolution=1e-5)
        samples = moved.trajectory.sample(0.01)
        leg |= {
            "duration_s": float(moved.trajectory.duration),
            "waypoints": np.round(moved.waypoints, 6).tolist(),
            "straight_is_free": bool(straight.free),
            "least_clearance_of_samples_m": float(clearance(samples.q).min()),
            "samples_in_boxes": float(inside(samples.q).max()),
            "peak_velocity_of_limit": float((np.abs(samples.velocity) / VELOCITY).max()),
        }
    return {
        "crop": crop,
        "places_cm": [list(map(float, place)) for place in places],
        "q": np.round(q, 6).tolist(),
        "legs": legs,
    }


def figure_18(robot: jaxik.Robot) -> dict[str, Any]:
    """The joints from zero to the postures of table 4, as printed and as limits allow; and to ours for its first place."""
    rows = [np.array([row[0] / 100.0, *np.radians(row[1:])]) for row in TABLE_4]
    scene = trellis_crop("bitter_gourd")
    others = scene.without([scene.object_names.index("fruit_1")])
    ours = np.asarray(
        jaxik.solve_ik(robot, np.array(TRELLIS_TARGETS["bitter_gourd"][0]) / 100.0, scene=others, options=OPTIONS).q
    )
    zero = np.zeros(robot.num_joints)
    peaks = lambda motion: {
        "velocity_peak_rad_s": float(np.abs(motion.velocity[:, 1:]).max()),
        "acceleration_peak_rad_s2": float(np.abs(motion.acceleration[:, 1:]).max()),
        "slide_peak_m_s": float(np.abs(motion.velocity[:, 0]).max()),
    }
    result: dict[str, Any] = {"printed_s": PRINTED["figure_18_s"], "q": rows[0].tolist(), "ours_q": ours.tolist()}
    result["mean_velocity_rad_s"] = [float(np.abs(row[1:]).max() / PRINTED["figure_18_s"]) for row in rows]
    result["as_the_text_reads"] = peaks(risen(rows[0], PRINTED["figure_18_s"]))
    free = {"velocity": np.inf, "acceleration": 1e9}
    in_time = jaxik.planning.time_path([zero, rows[0]], profile="quintic", duration=PRINTED["figure_18_s"], **free)
    result["rest_to_rest"] = peaks(in_time.sample(5e-5))
    for name, goal in (("printed_posture", rows[0]), ("our_posture", ours)):
        moved = timed(goal)
        straight = jaxik.motion_clearance(robot, others, zero, goal, enough=0.0, resolution=1e-5)
        result[name] = {
            "duration_s": float(moved.duration),
            **peaks(moved.sample(0.01)),
            "inside_limits": bool(np.all((goal >= robot.lower) & (goal <= robot.upper))),
            "straight_is_free_in_our_crop": bool(straight.free),
        }
    planned = jaxik.plan_motion(robot, zero, ours, scene=others, margin=0.005, velocity=VELOCITY, acceleration=ACCELERATION)
    result["our_posture"]["planned"] = planned.reason.text
    if planned:
        result["our_posture"]["planned_s"] = float(planned.trajectory.duration)
    return {**result, "velocity_limits": VELOCITY, "acceleration_limits": ACCELERATION}


def timed(goal: np.ndarray) -> jaxik.planning.Trajectory:
    """The motion from zero to a posture, from rest to rest, in the least time of a quintic within our limits."""
    ends = [np.zeros(len(goal)), goal]
    return jaxik.planning.time_path(ends, profile="quintic", velocity=VELOCITY, acceleration=ACCELERATION)


# --------------------------------------------------------------------------------------------------------------------
# Pictures


def draw_mapping(found: dict[str, Any]) -> plt.Figure:
    """Figure 2: the pairs of table 2 and the parabola."""
    pairs, paper = PRINTED["table_2"], PRINTED["mapping"]
    figure, ax = plt.subplots(figsize=(6, 4), layout="constrained")
    x = np.linspace(195, 290, 100)
    ours = [f"{c:.{n}f}" for c, n in zip(found["coefficients"], (4, 3, 1), strict=True)]
    ax.plot(x, np.polyval(found["coefficients"], x), label=f"{ours[0]} x² {ours[1]} x + {ours[2]}, R² {found['r_squared']:.4f}")
    a, b, c = paper["coefficients"]
    ax.plot(x, np.polyval([a, b, c], x), "k--", linewidth=1, label=f"printed: {a} x² {b} x + {c}, R² {paper['r_squared']}")
    ax.plot(pairs["image_pixel"], pairs["field_mm"], "o", color="tab:red", label="table 2")
    ax.set(xlabel="image [pixel]", ylabel="field [mm]", title="Figure 2: image mapping")
    ax.legend()
    return figure


def draw_moves(robot: jaxik.Robot, found: dict[str, Any]) -> plt.Figure:
    """Figures 9 and 15: the arm at its places, and the way of its tip, in the crops."""
    frames = jax.jit(jax.vmap(lambda q: robot.world_T_base @ jaxik.kinematics.link_frames(robot, q)))
    points = lambda q: np.asarray(frames(np.atleast_2d(q)))[:, :, :3, 3]
    figure = plt.figure(figsize=(13, 6), layout="constrained")
    for i, (name, one) in enumerate(found.items()):
        ax, scene = figure.add_subplot(1, 2, i + 1, projection="3d"), trellis_crop(one["crop"])
        for frame, half in zip(np.asarray(scene.boxes.world_T_box), np.asarray(scene.boxes.half), strict=True):
            faces = box_faces(frame, 2.0 * half)
            ax.add_collection3d(Poly3DCollection(faces, facecolor="tab:green", edgecolor="0.4", linewidth=0.2, alpha=0.25))
        for k, q in enumerate(one["q"]):
            colour = plt.get_cmap("viridis")(k / len(one["q"]))
            ax.plot(*points(np.array(q))[0].T, "-o", color=colour, linewidth=2.5, markersize=3)
        for leg in one["legs"]:
            if "waypoints" in leg:
                way = np.array(leg["waypoints"])
                dense = np.concatenate([np.linspace(a, b, 20) for a, b in itertools.pairwise(way)])
                ax.plot(*points(dense)[:, -1].T, color="tab:red", linewidth=1.5)
        ax.plot(*(np.array(one["places_cm"]).T / 100.0), "s", color="tab:red", markersize=5)
        ends = (", ".join(f"{x:g}" for x in one["places_cm"][k]) for k in (0, -1))
        ax.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]", xlim=(-0.1, 1.1), ylim=(-0.8, 0.8), zlim=(0.0, 1.1))
        ax.set_title(f"{name.replace('_', ' ')}: ({') to ('.join(ends)}) cm, {one['crop'].replace('_', ' ')}")
        ax.set_box_aspect((1.2, 1.6, 1.1))
        ax.view_init(22, -115)
    return figure


def draw_figure_18(robot: jaxik.Robot, found: dict[str, Any]) -> plt.Figure:
    """Position, velocity and acceleration of the nine joints: as printed, and within limits."""
    goal, ours = np.array(found["q"]), np.array(found["ours_q"])
    columns = {
        "table 4, row 1, in the printed 0.01 s": risen(goal, PRINTED["figure_18_s"]),
        "the same from rest to rest, within our limits": timed(goal).sample(0.01),
        "our posture for that place": timed(ours).sample(0.01),
    }
    words = ("(a) position", "(b) velocity", "(c) acceleration")
    figure, axes = plt.subplots(3, 3, figsize=(13, 8), layout="constrained", sharex="col")
    for column, (title, motion) in zip(axes.T, columns.items(), strict=True):
        column[0].set_title(title)
        for ax, values, word, unit in zip(
            column, (motion.q, motion.velocity, motion.acceleration), words, ("", "/s", "/s²"), strict=True
        ):
            ax.plot(motion.time, values, linewidth=1.4)
            ax.set_ylabel(f"{word} [rad{unit}, m{unit}]")
        column[-1].set_xlabel("time [s]")
    axes[0, 0].legend(axes[0, 0].lines, robot.joint_names, ncols=3, fontsize=8)
    return figure


def pictures(robot: jaxik.Robot, result: dict[str, Any]) -> dict[str, plt.Figure]:
    """The figures by their file names' ends."""
    return {
        "_mapping": draw_mapping(result["mapping"]),
        "_moves": draw_moves(robot, result["moves"]),
        "_joints": draw_figure_18(robot, result["figure_18"]),
    }


def study(quick: bool = False, tell: Callable[[int, int], Any] | None = None) -> dict[str, Any]:
    """All figures beside the printed ones; with `quick` one target and one leg, and no differential evolution."""
    robot, told = jaxik.load("chembuly9"), tell or (lambda done, total: None)
    parts: dict[str, Callable[[], Any]] = {
        "paper": lambda: paper_rows(robot),
        "ours": lambda: solve(robot, *((("bitter_gourd",), 1, 1) if quick else ())),
        "baselines": lambda: baselines(robot, *((10, 1, 0) if quick else (100, 6, 400))),
        "units": lambda: units(robot),
        "mapping": mapping,
        "moves": lambda: moves(robot, *((("figure_9",), 2) if quick else ())),
        "figure_18": lambda: figure_18(robot),
    }
    result: dict[str, Any] = {"printed": PRINTED, "options": {k: str(v) for k, v in dataclasses.asdict(OPTIONS).items()}}
    for done, (name, part) in enumerate(parts.items(), 1):
        result[name] = part()
        told(done, len(parts))
    return result


def main() -> None:
    """Writes JSON and pictures."""
    result = {"machine": machine(), **study(tell=counted)}
    HERE.with_suffix(".json").write_text(json.dumps(result, indent=1) + "\n")
    for end, figure in pictures(jaxik.load("chembuly9"), result).items():
        figure.savefig(HERE.with_name(f"{HERE.stem}{end}.png"), dpi=100)


if __name__ == "__main__":
    main()
