"""Figures 6 to 8 of van Henten et al. (2003) anew: `python batch_eval/astar.py` writes `astar.json` and its pictures.

The paper prints no length of its two links, no stems, no start, no goal and no ties, so its 146 iterations forward and 117
backward are those of a scene that is lost. Here they are counted by its rule on a row of stems of ours, and a search through
scenes within its words (`papers/stem_scenes.py`) tells what the two numbers say. Then the six joints that were "prohibitively
slow", the seven that were expected, and what a surface costs in the collision test.
"""

from __future__ import annotations

import dataclasses
import json
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from papers.crossing_surfaces import box_faces, cross_in_a_loop, rounded_hull, surfaces_cross
from papers.grid_planner import plan_on_grid
from papers.grid_search import shortest
from papers.stem_scenes import GRID, RANGES, STEP, Posed, StemScene, bounds, posed, search, shortest_ways
from race import Entry, clocked, compiled, counted, machine, race

import jaxik

HERE = Path(__file__)
PRINTED = {
    "step_deg": 5.0,
    "forward_iterations": 146,
    "backward_iterations": 117,
    "reduction": 0.20,
    "surfaces": [600, 36],
    "surfaces_factor": 15.0,
    "cycle_s": 10.0,
    "six_joints": "prohibitively slow",
    "seven_joints": "expected",
}
REACH_M = 2.0  # of the two links
# Squares of 10 cm every 40 cm along a row; the fruit behind the stem at x = 0.4 m, in parts of the reach.
ROW = StemScene(0.5, 0.025, 0.05, 0.2, 0.5, 0.0, 0.125, 0.0, 1, 1)
PAPER = {"batch": 1, "euclidean": True, "judge": "reached"}
WAYS = {
    "as printed": PAPER,
    "as printed, farthest of ties": {**PAPER, "ties": "farthest"},
    "judged when expanded": {"batch": 1, "euclidean": True},
    "in batches": {"batch": 256},
}
SIX = {"degrees": 15.0, "slide_m": None}
SEVEN = {"degrees": 20.0, "slide_m": 0.1}
POSTS: dict[str, Any] = {"x": [0.0, 0.3, 0.6, 0.9, 1.2], "y": 0.55, "radius": 0.01, "height": 1.2}  # [m]
BEHIND = np.array([0.0, 0.07, 0.6])  # of the cucumber from the foot of its stem [m]


def two_links(scene: StemScene) -> tuple[jaxik.Robot, jaxik.Scene]:
    """The arm of jaxik's `planar2` with other links, and the stems, in metres."""
    lines, lengths = [], [REACH_M * scene.first_link, REACH_M * (1.0 - scene.first_link)]
    for i, length in enumerate(lengths, 1):
        lines += [
            f'[[joint]]\nname = "q{i}"\ntype = "revolute"\nlink = "link{i}"\na = {length!r}',
            "lower_deg = -180\nupper_deg = 180",
            f'[[shape]]\nlink = "link{i}"\nkind = "capsule"\npoints = [[{-length!r}, 0, 0], [0, 0, 0]]\n'
            f"radius = {REACH_M * scene.half_width!r}\n",
        ]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "two_links.toml")
        file.write_text("\n".join(['name = "two_links"', 'convention = "standard_dh"', *lines]))
        robot = jaxik.load(file)
    side = REACH_M * scene.stem
    return robot, jaxik.make_scene(boxes=[[*(REACH_M * middle), 0.0, side, side, 1.0] for middle in scene.stems])


def figure_7(one: Posed, ways: dict[str, dict[str, Any]] = WAYS, timed: bool = True) -> dict[str, Any]:
    """The counts and times of each search on a scene, planned by jaxik's own collision test."""
    robot, around = two_links(one.scene)
    collides = jax.jit(jax.vmap(lambda q: jaxik.collides(robot, around, q)))
    theirs = np.asarray(collides(GRID.configurations(np.arange(len(one.hits))).astype(np.float32)))
    least = bounds(one)
    result: dict[str, Any] = {
        "nodes": len(one.hits),
        "free": int((~one.hits).sum()),
        "other_verdicts_of_jaxik": int((theirs != one.hits).sum()),
        "dijkstra": STEP * float(shortest_ways(one.hits, [one.start])[0][one.goal]),
        "least_and_most": None if least is None else least.tolist(),
        "scene": {**dataclasses.asdict(one.scene), "goal_deg": np.degrees(one.scene.goal).tolist()},
    }
    for direction in ("forward", "backward", "both"):
        for name, how in ways.items():
            if direction == "both" and "as printed" in name:
                continue
            run = lambda how=how, direction=direction: plan_on_grid(
                robot, one.scene.start, one.scene.goal, scene=around, direction=direction, **how
            )
            if timed:
                run()
            found, seconds = clocked(run)
            row = {"expanded": found.expanded, "judged": found.judged, "length": found.length, "ms": 1e3 * seconds}
            result[f"{direction}, {name}"] = row
    counts = [result[f"{direction}, as printed"]["expanded"] for direction in ("forward", "backward")]
    return {**result, "reduction": 1.0 - counts[1] / counts[0]}


def found_scene(quick: bool, tell: Callable[[int, int], Any] | None) -> tuple[Posed, dict[str, Any]]:
    """The scene within the paper's words whose counts come nearest to the printed ones, and what scenes at random give."""
    found = search(*((25, 10) if quick else (600, 1400)), tell=tell)
    saved = 1.0 - found.fitting[:, 1] / found.fitting[:, 0]
    return found.best, {
        "varied": {name: list(ends) for name, ends in RANGES.items()},
        "seed": 0,
        "drawn": found.draws,
        "within_the_words": len(found.fitting),
        "looked_at": found.looked,
        "backward_is_shorter": float((saved > 0.0).mean()),
        "reduction_quartiles": np.quantile(saved, [0.25, 0.5, 0.75]).tolist(),
        "forward_quartiles": np.quantile(found.fitting[:, 0], [0.25, 0.5, 0.75]).tolist(),
    }


def taken(one: Posed, backward: bool) -> np.ndarray:
    """The configurations (m, 2) that are open or closed at the end of a search by the printed rule."""
    seen: list[np.ndarray] = []

    def free(q: np.ndarray) -> np.ndarray:
        good = ~one.hits[np.ravel_multi_index(tuple(np.round((q - GRID.origin) / STEP).astype(int).T), GRID.shape)]
        seen.extend(q[good])
        return good

    ends = (one.goal, one.start) if backward else (one.start, one.goal)
    shortest(GRID, free, *ends, euclidean=True, judge="reached")
    return np.array(seen)


def draw_figure_7(one: Posed, result: dict[str, Any]) -> plt.Figure:
    """The paper's six panels."""
    figure, axes = plt.subplots(2, 3, figsize=(13, 8.4), layout="constrained")
    robot, around = two_links(one.scene)
    found = plan_on_grid(robot, one.scene.start, one.scene.goal, scene=around, **PAPER)
    way = np.asarray(found.waypoints)
    six = way[np.linspace(0, len(way) - 1, 6).astype(int)]
    for ax, postures, title in (
        (axes[0, 0], six[[0, -1]], "(a) start and picking posture"),
        (axes[1, 1], six, "(e) six snapshots"),
    ):
        for middle in REACH_M * one.scene.stems:
            side = REACH_M * one.scene.stem
            ax.add_patch(plt.Rectangle(middle - side / 2.0, side, side, color="0.2"))
        for i, q in enumerate(postures):
            colour = plt.get_cmap("viridis")(i / len(postures))
            ax.plot(*(REACH_M * one.scene.joints(q)).T, "-o", color=colour, linewidth=3, markersize=4)
        ax.plot(*(REACH_M * one.scene.fruit), "s", color="tab:green", markersize=7)
        ax.set(aspect="equal", xlabel="x [m]", ylabel="y [m]", title=title, xlim=(-2.1, 2.1), ylim=(-1.1, 2.1))
    counts = [result[f"{direction}, as printed"]["expanded"] for direction in ("forward", "backward")]
    panels = (
        (axes[0, 1], None, False, "(b) configuration space"),
        (axes[0, 2], False, False, f"(c) forward: {counts[0]} iterations (printed 146)"),
        (axes[1, 0], None, True, "(d) the way, as short as Dijkstra's"),
        (axes[1, 2], True, False, f"(f) backward: {counts[1]} iterations (printed 117)"),
    )
    for ax, backward, with_way, title in panels:
        ax.imshow(one.hits.reshape(GRID.shape).T, origin="lower", extent=[-182.5, 182.5] * 2, cmap="gray_r")
        if backward is not None:
            ax.plot(*np.degrees(taken(one, backward).T), "*", color="tab:blue", markersize=3)
        if with_way:
            ax.plot(*np.degrees(way.T), color="tab:red", linewidth=2)
        for name, q in (("S", way[0]), ("G", way[-1])):
            white = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0}
            ax.annotate(
                name, np.degrees(q), xytext=(6, 6), textcoords="offset points", color="tab:red", weight="bold", bbox=white
            )
            ax.plot(*np.degrees(q), "o", color="tab:red", markersize=4)
        ax.set(xlabel="$\\theta_1$ [deg]", ylabel="$\\theta_2$ [deg]", title=title)
    return figure


# --------------------------------------------------------------------------------------------------------------------
# Six joints and seven


def posts() -> tuple[jaxik.Scene, np.ndarray]:
    """Five stems alone, as in figure 8, and a cucumber behind the second one (3,) [m]: where they stand is ours."""
    scene = jaxik.make_scene(
        capsules=[[x, POSTS["y"], 0.0, x, POSTS["y"], POSTS["height"], POSTS["radius"]] for x in POSTS["x"]]
    )
    return scene, np.array([POSTS["x"][1], POSTS["y"], 0.0]) + BEHIND


def held(robot: jaxik.Robot, slide: float) -> jaxik.Robot:
    """The robot with its slide at a place."""
    hold = lambda limit: np.concatenate([[slide], limit[1:]])
    return dataclasses.replace(robot, lower=hold(robot.lower), upper=hold(robot.upper))


def steps(how: dict[str, Any]) -> np.ndarray:
    """The grid's steps of the P6R (7,)."""
    return np.concatenate([[how["slide_m"] or 1.0], np.full(6, np.radians(how["degrees"]))])


def figure_8(how: dict[str, Any]) -> dict[str, Any]:
    """The way from a posture in the path, the forearm along the row, to the cucumber behind a stem: with the slide held before
    that, or from the slide's end."""
    whole, (scene, cucumber) = jaxik.load("p6r"), posts()
    moves = how["slide_m"] is not None
    robot = whole if moves else held(whole, float(cucumber[0]))
    place = (np.linalg.inv(robot.world_T_base) @ [*cucumber, 1.0])[:3]
    goal = jaxik.solve_ik(robot, place, scene=scene, task=jaxik.Task.position(), margin=0.005, choice="clearance")
    start = np.array([robot.lower[0], np.pi / 2.0, -np.pi / 2.0, 0.0, 0.0, 0.0, 0.0])
    straight = jaxik.motion_clearance(robot, scene, start, goal.q)
    result = {**how, "cucumber_m": cucumber.tolist(), "straight_way_is_free": bool(straight.free)}
    for direction in ("forward", "backward"):
        plan = lambda d=direction: plan_on_grid(robot, start, goal.q, scene=scene, step=steps(how), direction=d, batch=8192)
        plan()
        found, seconds = clocked(plan)
        result[direction] = {"solved": bool(found), "expanded": found.expanded, "length": found.length, "s": seconds}
    result["joints_that_move"] = int((np.ptp(found.waypoints, axis=0) > 1e-9).sum())
    return {**result, "waypoints": np.round(found.waypoints, 6).tolist()}


def draw_figure_8(result: dict[str, Any]) -> plt.Figure:
    """Six snapshots of the P6R's boxes among the stems."""
    robot, (scene, cucumber), way = jaxik.load("p6r"), posts(), np.array(result["waypoints"])
    frames = jax.jit(lambda q: robot.world_T_base @ jaxik.kinematics.link_frames(robot, q) @ np.linalg.inv(robot.link_offset))
    figure, axes = plt.subplots(2, 3, figsize=(12, 8), layout="constrained", subplot_kw={"projection": "3d"})
    feet, heads = np.asarray(scene.capsules.a), np.asarray(scene.capsules.b)
    for ax, i, letter in zip(axes.flat, np.linspace(0, len(way) - 1, 6).astype(int), "abcdef", strict=True):
        placed = np.asarray(frames(way[i]))
        for box in robot.boxes:
            faces = box_faces(placed[box.link] @ box.joint_T_box, 2.0 * np.asarray(box.half))
            ax.add_collection3d(Poly3DCollection(faces, facecolor="tab:orange", edgecolor="0.3", linewidth=0.5, alpha=0.85))
        for a, b in zip(feet, heads, strict=True):
            ax.plot(*np.stack([a, b]).T, color="k", linewidth=3)
        ax.plot(*(cucumber + np.outer([-0.15, 0.15], [0, 0, 1])).T, color="tab:green", linewidth=5)
        ax.set(xlim=(-0.3, 1.2), ylim=(-0.3, 1.2), zlim=(0.0, 1.2), title=f"({letter}) waypoint {i + 1} of {len(way)}")
        ax.set(
            xlabel="x [m]",
            ylabel="y [m]",
            zlabel="z [m]",
            xticks=[0.0, 0.5, 1.0],
            yticks=[0.0, 0.5, 1.0],
            zticks=[0.0, 0.5, 1.0],
        )
        ax.set_box_aspect((1.5, 1.5, 1.2))
        ax.view_init(25, -50)
    return figure


def six_joints() -> dict[str, Any]:
    """The P6R, its slide held, from a posture in the aisle to a fruit of the shipped row with its leaves."""
    whole, scene = jaxik.load("p6r"), jaxik.load_scene("cucumber_row")
    row = next(row for row in jaxik.harvest(whole, scene) if row and row.q[0] > 0.0)
    robot, around = held(whole, row.q[0]), scene.without(row.fruit)
    rng = np.random.default_rng(0)
    draws = (rng.uniform(robot.lower, robot.upper) for _ in range(1000))
    start = next(q for q in draws if not jaxik.collides(robot, around, q, margin=0.03))
    result: dict[str, Any] = {"fruit": row.fruit, "degrees": SIX["degrees"]}
    for direction in ("forward", "backward", "both"):
        found, seconds = clocked(
            lambda d=direction: plan_on_grid(robot, start, row.q, scene=around, step=steps(SIX), direction=d, batch=8192)
        )
        result[direction] = {"solved": bool(found), "expanded": found.expanded, "length": found.length, "s": seconds}
    return result


# --------------------------------------------------------------------------------------------------------------------
# Surfaces


def surfaces(rounds: int, count: int = 32, many: int = 2048) -> dict[str, Any]:
    """The test of edges against surfaces of the RV-E2's six links (p6r's, its slide apart) among five stems: by 600 triangles
    of rounded hulls, by six boxes, of 36 rectangles as in the paper, and by these as 72 triangles; as a kernel, and pair by
    pair in a loop of an interpreter, as MATLAB was."""
    robot = jaxik.load("p6r")
    links = [box for box in robot.boxes if box.link > 1]
    number, sizes = np.array([box.link for box in links]), [2.0 * np.asarray(box.half) for box in links]
    boxes = np.stack([box_faces(box.joint_T_box, size) for box, size in zip(links, sizes, strict=True)])
    fine = np.stack([rounded_hull(box.joint_T_box, size, 100) for box, size in zip(links, sizes, strict=True)])
    models = {"triangles": fine, "boxes": boxes, "boxes as triangles": boxes[:, :, [[0, 1, 2], [0, 2, 3]]].reshape(6, 12, 3, 3)}
    width, middle = 2.0 * POSTS["radius"], POSTS["height"] / 2.0
    stems = [(jaxik.pose([x, POSTS["y"], middle]), [width, width, POSTS["height"]]) for x in POSTS["x"]]
    world = np.concatenate([box_faces(*stem) for stem in stems])

    def placed(q: Any, model: np.ndarray) -> Any:
        joints = robot.world_T_base @ jaxik.kinematics.link_frames(robot, q) @ np.linalg.inv(robot.link_offset)
        turned = jnp.einsum("bij,bkcj->bkci", joints[number, :3, :3], model) + joints[number, None, None, :3, 3]
        return turned.reshape(-1, *model.shape[2:])

    q = np.random.default_rng(1).uniform(robot.lower, robot.upper, (many, robot.num_joints)).astype(np.float32)
    looped = 6 if rounds > 1 else 1  # surfaces of the stems, of thirty
    entries, loops, hits, rows = [], [], [], dict[str, Any]()
    for name, model in models.items():
        cross = lambda q, model=model: surfaces_cross(placed(q, model), world.astype(q.dtype))
        judged = compiled(lambda q, f=cross: jax.lax.map(f, q), q[:count])[0]
        entries.append(Entry(name, count, judged))
        still = np.asarray(placed(q[0], model))
        loops.append(Entry(name, 1, lambda still=still: cross_in_a_loop(still, world[:looped])))
        hits.append(np.asarray(judged() if many == count else jax.jit(lambda q, f=cross: jax.lax.map(f, q))(q)))
    race(entries, rounds, most=4.0)
    race(loops, rounds, most=4.0)
    for entry, slow, model, hit in zip(entries, loops, models.values(), hits, strict=True):
        each = model.shape[0] * model.shape[1]
        us, loop = 1e6 / entry.rate, 1e6 / slow.rate * len(world) / looped
        rows[entry.who] = {"surfaces": each, "corners": model.shape[2], "against": len(world), "us": us, "loop_us": loop}
        rows[entry.who] |= {"ns_a_pair": 1e3 * us / (each * len(world)), "collide": float(hit.mean())}
    factor = lambda what, other="boxes": rows["triangles"][what] / rows[other][what]
    return {
        "rows": rows,
        "fewer_surfaces": factor("surfaces"),
        "factor": factor("us"),
        "factor_in_a_loop": factor("loop_us"),
        "factor_as_triangles": factor("us", "boxes as triangles"),
        "boxes_hit_where_triangles_do_not": float((hits[1] & ~hits[0]).mean()),
        "triangles_hit_where_boxes_do_not": float((hits[0] & ~hits[1]).mean()),
        "panda": panda_surfaces(),
    }


def panda_surfaces() -> dict[str, float]:
    """The same two models of the Panda as `mesh_benchmark.py` measured them: its hulls have few triangles, its boxes many."""
    rows = {row["who"]: row for row in json.loads(HERE.with_name("mesh_benchmark.json").read_text())["surfaces"]}
    hulls, boxes = (rows[f"edges against surfaces, {name}"] for name in ("hulls", "boxes"))
    return {"fewer_surfaces": hulls["surfaces"] / boxes["surfaces"], "factor": hulls["us"] / boxes["us"]}


def study(quick: bool = False, tell: Callable[[int, int], Any] | None = None) -> dict[str, Any]:
    """All figures beside the printed ones; with `quick` few scenes are searched, and six joints and the row are left out."""
    parts = 6
    told = tell or (lambda done, total: None)
    row = posed(ROW)
    assert row is not None  # it is free at both ends, and reached
    result: dict[str, Any] = {"printed": PRINTED}
    result["figure_7"] = figure_7(row, dict(list(WAYS.items())[:2]) if quick else WAYS, not quick)
    told(1, parts)
    one, result["search"] = found_scene(quick, None)
    told(2, parts)
    result["found"] = figure_7(one, dict(list(WAYS.items())[:2]), not quick)
    told(3, parts)
    if not quick:
        result["six_joints"] = six_joints()
        result["figure_8"] = {"six": figure_8(SIX), "seven": figure_8(SEVEN)}
    told(5, parts)
    result["surfaces"] = surfaces(*((1, 4, 4) if quick else (7, 32, 2048)))
    told(6, parts)
    return result


def scene_of(result: dict[str, Any]) -> Posed:
    """The scene of a result's "figure_7" or "found"."""
    values = {field.name: result["scene"][field.name] for field in dataclasses.fields(StemScene)}
    one = posed(StemScene(**values))
    assert one is not None  # it was, when it was found
    return one


def pictures(result: dict[str, Any]) -> dict[str, plt.Figure]:
    """The figures by their file names' ends."""
    drawn = {"": draw_figure_7(scene_of(result["found"]), result["found"])}
    if "figure_8" in result:
        drawn |= {f"_{name}_joints": draw_figure_8(each) for name, each in result["figure_8"].items()}
    return drawn


def main() -> None:
    """Writes JSON and pictures."""
    out = HERE.with_suffix(".json")
    result = {"machine": machine(), **study(tell=counted)}
    out.write_text(json.dumps(result, indent=1) + "\n")
    for end, figure in pictures(result).items():
        figure.savefig(out.with_name(f"{out.stem}{end}.png"), dpi=100)


if __name__ == "__main__":
    main()
