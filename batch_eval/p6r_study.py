"""The P6R paper redone [Van Henten et al. 2010, sec. 3 to 5]: `python batch_eval/p6r_study.py` writes its `.json` and `.png`.

Its search by evolution over J as printed, ten seeds, beside its mixed method (two scans) and `jaxik.harvesting.scan`, in two
artificial greenhouses (`setups/greenhouse.py`; the paper's own is not printed); then the shipped row, where the best angle
often has no posture, which the paper leaves open. The printed (4) names no unit: J is counted in millimetres, as (6) has its
distances, in metres, which the printed values of J speak for, and in centimetres, which are ours.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from papers.baselines import evolved, harvest_objective
from papers.evolution import differential, genetic
from papers.harvest_costs import harvest_orientation_cost
from papers.two_step_scan import approach_angles, hand_frames, hand_of, scan_two_step
from race import counted, machine
from setups.greenhouse import KINDS, greenhouse

import jaxik
from jaxik.spmd import HostKernel

Tell = Callable[[int, int], Any]

FOLDER = Path(__file__).parent
PRINTED = {
    "search": [
        {"figure": "5a", "J": 0.0001467, "generations": 170, "seconds_s": 750.0},
        {"figure": "5b", "J": 0.0099359, "generations": 1500, "seconds_s": 6500.0},
    ],
    "mixed_method_at_most_s": 1.0,
    "cycle_s": 65.2,
    "cycle_with_failures_s": 124.0,
    "picked_share": 0.744,
    "failures_of_motion_share": 0.049,
    "posture_and_motion_s": 12.5,
    "posture_and_motion_share": 0.19,
    "leaves_removed": {"C1": 2, "C2": "a lot of obstacles"},
}
UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}  # of (4)
METHODS = {"genetic": genetic, "differential": differential}
MARGIN_M = 0.005
SPREAD = {"best": np.min, "median": np.median, "worst": np.max}  # of the seeds
ANGLES, SLIDES = 72, 41
COLD = """
import sys, time
sys.path.insert(0, sys.argv[1])
import jaxik
from papers.two_step_scan import scan_two_step
from setups.greenhouse import greenhouse
robot, scene = jaxik.load("p6r"), greenhouse(sys.argv[3])
start = time.perf_counter()
if sys.argv[2] == "mixed":
    scan_two_step(robot, scene, scene.marks[0], margin=float(sys.argv[4]))
else:
    jaxik.harvesting.scan(robot, scene, scene.marks[0], margin=float(sys.argv[4]))
print(time.perf_counter() - start)
"""


# --------------------------------------------------------------------------------------------------------------------
# The search of section 3


def tip_errors(robot: jaxik.Robot, fruit: jaxik.collision.Mark, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The tip's distances from the fruit (b,) [m] and `J_ori` (b,) of postures (b, n)."""

    def errors(q: Any) -> Any:
        tip = robot.world_T_base.astype(q.dtype) @ jaxik.forward_kinematics(robot, q)
        return tip[:3, 3] - fruit.position.astype(q.dtype), harvest_orientation_cost(tip[:3, :3])

    off, turned = HostKernel(errors, 1)(q, double=True)
    return np.linalg.norm(off, axis=1), turned


def searched(
    robot: jaxik.Robot, scene: jaxik.Scene, unit: float, method: str, seeds: Sequence[int], generations: tuple[int, ...]
) -> dict[str, Any]:
    """One method's runs over J with positions in `unit` [m]: J after these generations, what is missed, and the time."""
    fruit = scene.marks[0]
    each, how = harvest_objective(robot, scene, fruit, unit), METHODS[method]
    evolved(how, each, robot, seeds, 1)  # compiles
    start = time.perf_counter()
    found = evolved(how, each, robot, seeds, generations[-1])
    seconds = (time.perf_counter() - start) / len(seeds)
    start = time.perf_counter()
    evolved(how, each, robot, seeds[:1], generations[0])
    alone = time.perf_counter() - start
    off, turned = tip_errors(robot, fruit, found.x)
    kept = np.unique(np.round(np.geomspace(1, generations[-1] + 1, 40)).astype(int)) - 1
    return {
        "J": {str(g): found.history[g].tolist() for g in generations},
        "position_error_m": off.tolist(),
        "J_orientation": turned.tolist(),
        "largest_position_error_m": float(off.max()),
        "upright": int(np.sum(turned < 0.01)),
        "evaluations": found.evaluations,
        "a_run_among_all_s": seconds,
        "a_run_alone_of_the_first_generations_s": alone,
        "q": np.round(found.x, 6).tolist(),
        "history": {
            "generation": kept.tolist(),
            **{name: f(found.history[kept], axis=1).tolist() for name, f in SPREAD.items()},
        },
    }


# --------------------------------------------------------------------------------------------------------------------
# The scans of section 4


def warm(run: Callable[[], Any], rounds: int) -> tuple[Any, float]:
    """Returns what `run` returns and the median of its seconds."""
    times, found = [], run()
    for _ in range(rounds):
        start = time.perf_counter()
        found = run()
        times.append(time.perf_counter() - start)
    return found, float(np.median(times))


def first_calls(which: str, kind: str) -> dict[str, float]:
    """Seconds of a fresh process's first call, imports apart: compiling all, and with the kernels on disk; medians of three."""
    outside = {k: v for k, v in os.environ.items() if k not in ("JAXIK_CACHE", "JAX_COMPILATION_CACHE_DIR")}
    command = [sys.executable, "-c", COLD, str(FOLDER), which, kind, str(MARGIN_M)]
    run = lambda **more: float(subprocess.run(command, env=outside | more, capture_output=True, text=True, check=True).stdout)
    with tempfile.TemporaryDirectory() as folder:
        run(XDG_CACHE_HOME=folder)  # fills the cache
        caches = {"cold_s": {"JAXIK_CACHE": "off"}, "kernels_on_disk_s": {"XDG_CACHE_HOME": folder}}
        return {name: float(np.median([run(**more) for _ in range(3)])) for name, more in caches.items()}


def scanned(robot: jaxik.Robot, kind: str, quick: bool) -> dict[str, Any]:
    """The mixed method and the scan of everything on the greenhouse's fruit: J of the best posture, and the time. Its q has 32
    bits: where there is room, J in millimetres is their rounding, some tenths of a micrometre."""
    scene = greenhouse(kind)
    fruit, rows = scene.marks[0], {}
    runs = {
        "mixed": lambda: scan_two_step(robot, scene, fruit, ANGLES, SLIDES, MARGIN_M)[0],
        "scan": lambda: jaxik.harvesting.scan(robot, scene, fruit, angles=ANGLES, slides=SLIDES, margin=MARGIN_M),
    }
    objectives = {unit: harvest_objective(robot, scene, fruit, metres) for unit, metres in UNITS.items()}
    for which, run in runs.items():
        found, seconds = warm(run, 3 if quick else 21)
        best = found.table.best(MARGIN_M)
        values = {unit: each(found.table.q, double=True)[0] for unit, each in objectives.items()}
        off, _ = tip_errors(robot, fruit, found.table.q[best : best + 1])
        rows[which] = {
            "J": {unit: float(each[best]) for unit, each in values.items()},
            "J_least_of_table": {unit: float(each.min()) for unit, each in values.items()},
            "position_error_m": float(off[0]),
            "clearance_m": float(found.table.clearance[best]),
            "freedom": float(found.table.freedom[best]),
            "angle_rad": float(found.table.angle[best]),
            "candidates": int(found.status.size),
            "warm_s": seconds,
            "q": found.table.q[best].tolist(),
        }
        rows[which] |= {} if quick else first_calls(which, kind)
    return rows


def row_of_fruits(robot: jaxik.Robot, scene: jaxik.Scene) -> dict[str, Any]:
    """A row, fruit by fruit: the best angle alone, as printed; the next ones; the scan of everything; recovery."""
    harvested = jaxik.harvest(robot, scene, angles=ANGLES, slides=SLIDES, margin=MARGIN_M)
    rows = []
    for fruit, whole in zip(scene.marks, harvested, strict=True):
        steps, tried = scan_two_step(robot, scene, fruit, ANGLES, SLIDES, MARGIN_M)
        rows.append(
            {
                "fruit": fruit.name,
                "best_angle": bool(steps) and tried == 1,
                "next_angles": bool(steps),
                "angles_tried": tried,
                "scan": bool(whole.scan),
                "recovery": bool(whole.success),
                "found_by": whole.found_by,
                "has_to_go": list(whole.blockers.in_the_way) if whole.blockers is not None else [],
            }
        )
    counts = {key: sum(row[key] for row in rows) for key in ("best_angle", "next_angles", "scan", "recovery")}
    most = max((row["angles_tried"] for row in rows if row["next_angles"]), default=0)
    return {"fruits": len(rows), "picked": counts, "most_angles_tried_with_success": most, "rows": rows}


def motion_times() -> dict[str, Any]:
    """Seconds a fruit of motion and computing, from `harvest_motions.json`, with the fruit dropped at once or put into a crate:
    the paper's 12.5 s are of an arm whose speeds are not printed."""
    source = json.loads((FOLDER / "harvest_motions.json").read_text())
    rows = {}
    for setup in ("hose or tray at the gripper", "one crate"):
        plan = source["setups"][setup]["shortest"]
        computing = plan["planning_s"] / plan["picked"] + source["harvest_s"] / source["fruits"]
        total = plan["cycle_s"] + computing
        share = plan["cycle_s"] / total
        rows[setup] = {"motion_s": plan["cycle_s"], "computing_s": computing, "total_s": total, "motion_share": share}
    return rows


# --------------------------------------------------------------------------------------------------------------------


def study(quick: bool = False, tell: Tell | None = None) -> dict[str, Any]:
    """All figures; with `quick` two seeds and few generations. `tell(done, total)` is called as it goes."""
    tell = tell or (lambda done, total: None)
    seeds, generations = (range(2), (17, 60)) if quick else (range(10), (170, 1500))
    robot, total, done = jaxik.load("p6r"), len(KINDS) * (1 + len(UNITS) * len(METHODS)) + 1, 0
    result: dict[str, Any] = {"printed": PRINTED, "generations": list(generations), "seeds": len(seeds), "greenhouses": {}}
    for kind in KINDS:
        scene = greenhouse(kind)
        result["greenhouses"][kind] = scanned(robot, kind, quick) | {"search": {}}
        tell(done := done + 1, total)
        for unit, metres in UNITS.items():
            rows = result["greenhouses"][kind]["search"][unit] = {}
            for method in METHODS:
                rows[method] = searched(robot, scene, metres, method, seeds, generations)
                tell(done := done + 1, total)
    row = jaxik.harvesting.make_row(plants=2, leaves=2, fruits=2) if quick else jaxik.load_scene("cucumber_row")
    result["row"], result["harvest_cycle"] = row_of_fruits(robot, row), motion_times()
    tell(total, total)
    return result


# --------------------------------------------------------------------------------------------------------------------
# The figures

CORNERS = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(8, 3)
FACES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))
ARM, STAR, FRUIT, CARRIAGE = "#E69F00", "#0072B2", "#009E73", "#bbbbbb"


def draw_boxes(axis: Any, robot: jaxik.Robot, q: Any, **looks: Any) -> None:
    """The robot's boxes, where `q` puts them, as faces in 3-D axes."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    frames = np.asarray(robot.world_T_base) @ np.asarray(jaxik.kinematics.link_frames(robot, np.asarray(q, float)))
    faces = []
    for box in robot.boxes:
        placed = frames[box.link] @ np.linalg.inv(robot.link_offset[box.link]) @ box.joint_T_box
        corners = (CORNERS * box.half) @ placed[:3, :3].T + placed[:3, 3]
        faces += [corners[list(face)] for face in FACES]
    axis.add_collection3d(Poly3DCollection(faces, **{"facecolor": ARM, "edgecolor": "0.3", "linewidth": 0.3} | looks))


def draw_crop(axis: Any, scene: jaxik.Scene, title: str, near: bool = False) -> None:
    """The leaves as stars and the fruit in 3-D axes: the whole scene, or what is `near` the fruit."""
    centre, fruit = np.asarray(scene.points.center), scene.marks[0].position
    axis.plot(*centre.T, "*", color=STAR, ms=3, mew=0, alpha=0.7)
    axis.plot(*np.stack([fruit, fruit - [0.0, 0.0, 0.3]]).T, color=FRUIT, lw=5, solid_capstyle="round")
    limits = ((0.2, 0.8), (0.25, 0.95), (0.3, 0.9)) if near else ((0.0, 1.0), (-0.2, 1.0), (0.0, 1.2))
    axis.set(xlim=limits[0], ylim=limits[1], zlim=limits[2], xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    axis.zaxis.set_rotate_label(False)
    axis.zaxis.label.set_rotation(90)
    axis.set_box_aspect([high - low for low, high in limits], zoom=0.95)
    axis.view_init(elev=25, azim=-50)
    axis.zaxis.set_ticks_position("lower")  # on the left
    axis.zaxis.set_label_position("lower")
    axis.tick_params(labelsize=7, pad=-1)
    axis.locator_params(nbins=4)
    axis.set_title(title, fontsize=9)


def draw_posture(axis: Any, scene: jaxik.Scene, q: Any, title: str) -> None:
    """The arm at a posture in the greenhouse [figs. 4, 5, 9]."""
    draw_boxes(axis, jaxik.load("p6r"), q)
    draw_crop(axis, scene, title)


def draw_fan(axis: Any, scene: jaxik.Scene, title: str, shown: int = 24, best: bool = False) -> None:
    """The last three links at some of the angles, coloured by their clearance [fig. 6], or at the `best` one [fig. 7]."""
    from matplotlib import colormaps

    robot, fruit = jaxik.load("p6r"), scene.marks[0]
    order, clear = approach_angles(robot, scene, fruit, ANGLES)
    rank = range(1) if best else np.argsort(order)[:: ANGLES // shown]
    span = max(np.abs(clear).max(), 1e-9)
    for i in rank:
        frame = hand_frames(robot, fruit, order[i : i + 1])[0]
        colour = colormaps["RdYlGn"](0.5 + 0.5 * clear[i] / span)
        draw_boxes(axis, hand_of(robot).mounted(frame), np.zeros(3), facecolor=colour, alpha=1.0 if best else 0.35)
    draw_crop(axis, scene, title, near=True)


def draw_clearances(axis: Any, scenes: dict[str, jaxik.Scene]) -> None:
    """The last three links' clearance over the angle [fig. 6 in numbers]."""
    robot = jaxik.load("p6r")
    for (kind, scene), colour in zip(scenes.items(), (FRUIT, ARM), strict=False):
        order, clear = approach_angles(robot, scene, scene.marks[0], ANGLES)
        at = np.argsort(order)
        axis.plot(np.degrees(order[at]), 1e3 * clear[at], color=colour, label=kind)
        axis.plot(np.degrees(order[0]), 1e3 * clear[0], "*", color=colour, mec="k", ms=11)
    axis.axhline(0.0, color="0.5", lw=0.8)
    axis.set(xlabel="approach angle [deg]", ylabel="clearance of the last three links [mm]", xlim=(-180, 180))
    axis.set_title("fig. 6 in numbers; star: best angle (fig. 7)", fontsize=9)
    axis.legend(fontsize=8)


def draw_slides(axis: Any, scene: jaxik.Scene) -> None:
    """Step two: clearance and freedom over the slide at the angle that step one leads to [fig. 8 in numbers]."""
    found, _ = scan_two_step(jaxik.load("p6r"), scene, scene.marks[0], ANGLES, SLIDES, MARGIN_M)
    table, best = found.table, found.table.best(MARGIN_M)
    axis.plot(table.leading[:, 0], 1e3 * table.clearance, ".", color=STAR, label="clearance [mm]")
    axis.plot(table.leading[:, 0], 100.0 * table.freedom, ".", color=ARM, label="freedom of the joints [%]")
    axis.axvline(table.leading[best, 0], color="k", ls=":", label="best of both (fig. 9)")
    axis.set(xlabel="slide [m]", xlim=(0.0, 1.0), ylim=(-20.0, 80.0))
    axis.set_title("fig. 8 in numbers, dense greenhouse, all branches", fontsize=9)
    axis.legend(fontsize=8, loc="upper right")


def draw_slide_postures(axis: Any, scene: jaxik.Scene, title: str, shown: int = 5) -> None:
    """Some postures of the slide's scan, over one another [fig. 8]."""
    found, _ = scan_two_step(jaxik.load("p6r"), scene, scene.marks[0], ANGLES, SLIDES, MARGIN_M)
    along = np.argsort(found.table.leading[:, 0], kind="stable")
    for i in along[np.linspace(0, len(along) - 1, shown).astype(int)]:
        colour = FRUIT if found.table.clearance[i] >= MARGIN_M else "#D55E00"
        draw_boxes(axis, jaxik.load("p6r"), found.table.q[i], facecolor=colour, alpha=0.3)
    draw_crop(axis, scene, title)


def draw_convergence(axis: Any, rows: dict[str, Any], title: str) -> None:
    """J over the generations: the best, the median and the worst seed of each method, and what is printed."""
    for (method, row), colour in zip(rows.items(), (STAR, FRUIT), strict=True):
        history = row["history"]
        at = np.array(history["generation"]) + 1
        axis.fill_between(at, history["best"], history["worst"], color=colour, alpha=0.15, lw=0)
        axis.plot(at, history["median"], color=colour, label=f"{method}, median and range")
    for row in PRINTED["search"]:
        axis.axhline(row["J"], color="k", ls="--", lw=0.8)
        axis.plot(row["generations"], row["J"], "kD", ms=5)
        axis.annotate(f"printed, fig. {row['figure']}", (1.2, row["J"]), xytext=(0, 2), textcoords="offset points", fontsize=8)
    axis.set(xscale="log", yscale="log", xlabel="generation", ylabel="J", ylim=(1e-8, 30.0))
    axis.set_title(title, fontsize=9)
    axis.legend(fontsize=8, loc="lower left")


def draw(result: dict[str, Any]) -> Any:
    """Returns the figure with figs. 5 to 9 redrawn, and what they are in numbers."""
    from matplotlib.figure import Figure

    scenes, (first, last) = {kind: greenhouse(kind) for kind in KINDS}, PRINTED["search"]
    genetic_runs = result["greenhouses"]["open"]["search"]["m"]["genetic"]
    final = np.array(genetic_runs["J"][str(result["generations"][-1])])
    figure = Figure(figsize=(15.0, 13.0), layout="constrained")
    solid = lambda place: figure.add_subplot(3, 4, place, projection="3d")
    order = np.argsort(final)
    for place, run, row, which in ((1, order[0], first, "best"), (2, order[len(final) // 2], last, "median")):
        words = f"fig. {row['figure']}: genetic, {which} of {len(final)} seeds, {result['generations'][-1]} generations\n"
        words += f"J = {final[run]:.2g} (printed {row['J']:.2g}, {row['generations']} generations)"
        draw_posture(solid(place), scenes["open"], genetic_runs["q"][run], words)
    for place, unit in ((3, "m"), (4, "mm")):
        draw_convergence(
            figure.add_subplot(3, 4, place),
            result["greenhouses"]["open"]["search"][unit],
            f"open, (4) in {unit}: J of {result['seeds']} seeds",
        )
    draw_fan(solid(5), scenes["dense"], "fig. 6: angles of the last three links\n(green: clear, red: collides)")
    draw_clearances(figure.add_subplot(3, 4, 6), scenes)
    draw_fan(solid(7), scenes["dense"], "fig. 7: the best angle, dense", best=True)
    draw_slide_postures(solid(8), scenes["dense"], "fig. 8: the slide's scan at that angle\n(red: collides)")
    draw_slides(figure.add_subplot(3, 4, 9), scenes["dense"])
    for place, kind in ((10, "dense"), (11, "open")):
        mixed = result["greenhouses"][kind]["mixed"]
        words = f"fig. 9: mixed method, {kind}\nJ = {mixed['J']['m']:.2g}, {1e3 * mixed['warm_s']:.1f} ms (printed: within 1 s)"
        draw_posture(solid(place), scenes[kind], mixed["q"], words)
    draw_row(figure.add_subplot(3, 4, 12), result["row"])
    return figure


def draw_row(axis: Any, row: dict[str, Any]) -> None:
    """How many fruits of the shipped row each method picks: the open problem of section 4.3."""
    words = {"best_angle": "best angle,\nas printed", "next_angles": "next\nangles", "scan": "whole\nscan"}
    words |= {"recovery": "with\nrecovery"}
    bars = axis.bar(list(words.values()), [row["picked"][key] for key in words], color=["0.6", STAR, STAR, FRUIT])
    axis.bar_label(bars)
    axis.axhline(row["fruits"], color="k", ls=":", lw=0.8)
    axis.set(ylabel=f"fruits of {row['fruits']} with a posture", ylim=(0, row["fruits"] + 1))
    axis.tick_params(axis="x", labelsize=7)
    axis.set_title("sec. 4.3's open problem, on the shipped row", fontsize=9)


def main() -> None:
    """Everything, the JSON and the picture."""
    result = {"machine": machine()} | study(tell=counted)
    path = Path(__file__).with_suffix(".json")
    path.write_text(json.dumps(result, indent=1) + "\n")
    draw(result).savefig(path.with_suffix(".png"), dpi=90)


if __name__ == "__main__":
    main()
