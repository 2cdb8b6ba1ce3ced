"""Touch: the thesis' experiments of section 4.3 again, figures 4.6 to 4.8 in kind, and ten thousand contacts anywhere.

`crops_v2` follows table 4.1's straight lines with the tip's position as its task; a vertical wall of springs, as stiff as the
thesis' latex band, stands in the way of link 4. Where the band stood and how the arm began is not printed. Both are ours: a
scene in which the text's course of every figure comes about, found in an earlier draw of the kind that
`setups/touch_scenes.py` makes; the study counts how rare such scenes are. The low pass, the sensor (1.3 to 20 N, a reading in
4 ms), thresholds, factors and gains are table 4.1's; the laws behind the estimator and the transitions are ours. The arm
follows its rates exactly.
"""

from __future__ import annotations

import functools
import json
import re
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from race import counted, machine, steps
from setups.touch_scenes import (
    BEGIN,
    DT,
    LINES,
    LINK,
    MIDDLE,
    STIFFNESS,
    WEIGHTS,
    Scenes,
    begin,
    fall,
    model,
    reaction,
    search,
    simulated,
)

import jaxik
from jaxik.dynamics import PointForce, material_point
from jaxik.motions import Line
from jaxik.spmd import ControlLoop
from jaxik.touch import Encounter, Reaction, ReactionResult, SpringContact, StiffnessEstimator, TouchSensor, simulate_reaction

POSTURE = np.array([0.66, 0.06, -0.87, -0.76, 0.78, 1.24, 0.93, -1.23, -1.07])  # near which the arm begins
POINT, NORMAL = np.array([0.117, 0.636, 0.918]), np.array([-0.97, 0.241, 0.0])
EVERY = 20  # samples between two that are kept
SEARCHED = 480  # postures of the search for scenes
DRAWN, CONTACTS, LANES, STEPS = 25_000, 10_000, 250, 3000
SCHEMES: dict[str, tuple[str, dict[str, Any]]] = {
    **{name: (name, {}) for name in ("baseline", "rmrc", "rac", "feedback", "multi", "task", "joint")},
    "rac, gradients times dt": ("rac", {"scale": DT}),  # (4.16) to the letter; the damping as (4.22) prints it
    "feedback, whole force": ("feedback", {"counted": "whole"}),  # (4.47) to the letter
    "feedback, whole force, nothing forgotten": ("feedback", {"counted": "whole", "fade_time": 1e3, "fade_distance": 1e3}),
}
FIGURES = {
    "fig. 4.6 in kind: avoidable": ("avoidable", ("baseline", "rmrc", "rac", "rac, gradients times dt")),
    "fig. 4.7 in kind: avoidable": (
        "avoidable",
        ("baseline", "rmrc", "feedback", "feedback, whole force", "feedback, whole force, nothing forgotten"),
    ),
    "fig. 4.8 in kind: inevitable": ("inevitable", ("baseline", "rmrc", "feedback", "multi")),
    "not in the thesis: inputs of (4.48)": ("avoidable", ("task", "joint", "multi")),
}
COLOURS = {"baseline": "0.6", "rmrc": "tab:blue", "rac": "tab:green", "feedback": "goldenrod", "multi": "tab:red"}
DASHED = {"multi": "tab:red", "rac, gradients times dt": "tab:olive", "feedback, whole force": "tab:brown"}
DASHED["feedback, whole force, nothing forgotten"] = "tab:purple"
PRINTED = {  # the text of section 4.3.4 in numbers, and table 4.1
    "fig_4_6_baseline_above_n": 9.0,
    "threshold_n": 1.3,
    "relaxation_n": 5.0,
    "self_collision_factors": [8.0, 23.0],
    "joint_limit_factors": [5.0, 20.0],
    "damping_per_s": 7.0,
}


@functools.cache
def start() -> np.ndarray:
    """The posture (9,) whose tip is at the lines' beginning, and in which the cost leaves the arm at rest."""
    return begin(POSTURE[None])[0]


def wall(stiffness: float = STIFFNESS, point: np.ndarray = POINT) -> SpringContact:
    return SpringContact(point, NORMAL, stiffness)


def path(scene: str) -> Line:
    return Line(jaxik.pose(BEGIN), jaxik.pose(LINES[scene][0]))


@functools.cache
def followed(name: str) -> ReactionResult:
    """Both scenes (2, t), one program; every 20th sample."""
    scheme, changes = SCHEMES[name]
    pair = Scenes(np.tile(start(), (2, 1)), np.tile(POINT, (2, 1)), np.tile(np.asarray(wall().normal), (2, 1)))
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*runs by XLA.*")  # so many samples are too many for a kernel
        return simulated(reaction(scheme, **changes), pair, list(LINES), round(LINES["inevitable"][2] / DT))


def of_scene(name: str, scene: str) -> ReactionResult:
    """The motion of a scene, as long as the thesis measured it."""
    k, count = list(LINES).index(scene), round(LINES[scene][2] / DT / EVERY)
    return jax.tree_util.tree_map(lambda x: x[k, :count], followed(name))


def experiments(tell: Callable[[], Any]) -> list[dict[str, Any]]:
    """The figures in numbers."""
    rows = []
    for scene, name in dict.fromkeys((scene, name) for scene, names in FIGURES.values() for name in names):
        found = of_scene(name, scene)
        tell()
        hit, soon = int(np.argmax(found.force > 0.0)), round(1.5 / DT / EVERY)
        peak = hit + int(np.argmax(found.force[hit : hit + soon]))
        after = slice(peak, peak + soon)
        peaks = fall(found.force)
        rows.append(
            {
                "scene": scene,
                "scheme": name,
                "peak_n": float(found.force.max()),
                "end_n": float(found.force[-1]),
                "first_peak_n": float(found.force[peak]),
                "dip_after_n": float(found.force[after].min()),
                "felt_dip_after_n": float(found.felt[after].min()),
                "falls_from_n": float(peaks[0]),
                "falls_to_n": float(peaks[1]),
                "below_2_n_after_s": _settled(found.force[hit:] < 2.0),
                "half_its_peak_after_s": _settled(found.force[peak:] < 0.5 * found.force[peak]),
                "peak_rate": float(np.linalg.norm(found.motion.velocity[hit:], axis=1).max()),
                "task_error_mm": float(1e3 * np.linalg.norm(found.error, axis=1).max()),
                "clearance_m": apart(found.motion.q),
                "stiffness_n_m": float(found.stiffness[-1]),
            }
        )
        print({k: round(v, 3) if isinstance(v, float) else v for k, v in rows[-1].items()})
    return rows


@functools.cache
def _clearances() -> tuple[Any, Any]:
    """The clearance of postures (k, 9) to the arm itself, without the pairs that are always nearer than the cost reaches."""
    from setups.self_collision import arm

    robot = arm()
    return robot, jax.jit(jax.vmap(lambda q: jaxik.clearance(robot, None, q)))


def courses() -> dict[str, Any]:
    """The courses that the thesis draws, a sample every 40 ms: the wall's force, what the sensor shows of it after the low
    pass, and the root of the pseudo-energy."""
    found: dict[str, Any] = {"dt_s": 2 * EVERY * DT}
    for scene, name in dict.fromkeys((scene, name) for scene, names in list(FIGURES.values())[:3] for name in names):
        of = jax.tree_util.tree_map(lambda x: x[::2], of_scene(name, scene))
        speed = np.linalg.norm(of.motion.velocity, axis=1)
        rows = {"force_n": of.force, "felt_n": of.felt, "speed_per_s": speed}
        found.setdefault(scene, {})[name] = {key: x.round(3).tolist() for key, x in rows.items()}
    return found


def apart(q: np.ndarray) -> float:
    """The least clearance [m] of a motion to itself, of all pairs of links that can part; every fifth posture of it."""
    return float(_clearances()[1](q[::5]).min())


def _settled(inside: np.ndarray) -> float | None:
    """[s] until it stays so."""
    outside = np.flatnonzero(~inside)
    last = int(outside[-1]) + 1 if len(outside) else 0
    return None if last == len(inside) else last * DT * EVERY


def analytic(quick: bool = False) -> dict[str, float]:
    """How far feedback linearisation is from F'' + 2 F' + 4 F = 0, a share of the first force: with the stiffness known, twice
    and half as large as believed, and estimated. A contact of 6 N where the line begins, without sensor, threshold, filter."""
    steps = 200 if quick else 600
    t = DT * np.arange(steps)
    exact = np.exp(-t) * (np.cos(np.sqrt(3.0) * t) - np.sin(np.sqrt(3.0) * t) / np.sqrt(3.0))
    point = np.asarray(material_point(model(), start(), LINK, MIDDLE))
    found = {}
    known, estimated = {"stiffness": STIFFNESS}, {"stiffness": StiffnessEstimator(start=STIFFNESS)}
    for name, how, true in (
        ("known", known, 60.0),
        ("twice as stiff, not known", known, 120.0),
        ("half as stiff, not known", known, 30.0),
        ("twice as stiff, estimated", estimated, 120.0),
        ("half as stiff, estimated", estimated, 30.0),
    )[: 1 if quick else 5]:
        bare = Reaction(model(), scheme="feedback", weights=WEIGHTS, threshold=0.0, cutoff=None, **how)
        stiff = wall(true, point + 6.0 / true * np.asarray(wall().normal))
        given = bare, path("avoidable"), LINES["avoidable"][1], start(), Encounter(stiff, LINK, MIDDLE)
        force = np.asarray(simulate_reaction(*given, steps=steps).force)
        found[name] = float(np.abs(force / force[0] - exact)[: round(0.6 / DT)].max())
    print(found)
    return found


class Draws(NamedTuple):
    """Contacts anywhere, each with an axis of its own: how the arm begins, its line, and what of it meets what."""

    q: Any
    first: Any
    last: Any
    joint: Any
    local: Any
    wall: Any = None


def anywhere(seed: int = 0) -> tuple[Draws, np.ndarray]:
    """Random postures, lines of 0.1 to 0.4 m in 2 s, and walls of 20 to 500 N/m across the way of a point on links 3 to 6,
    which comes 0.02 to 0.2 m deep unless it reacts; and the force [N] that this would be. Kept are the first
    10,000 of 25,000 that the arm can follow to 1 mm, with less than 2 rad/s, and whose point moves by more than 0.03 m."""
    rng, robot = np.random.default_rng(seed), model()
    middle, half = (robot.upper + robot.lower) / 2, (robot.upper - robot.lower) / 2
    q = middle + 0.5 * half * rng.uniform(-1.0, 1.0, (DRAWN, 9))
    poses = np.asarray(jax.jit(jax.vmap(lambda q: jaxik.forward_kinematics(robot, q)))(q))
    way, ends = rng.normal(size=(DRAWN, 3)), poses.copy()
    ends[:, :3, 3] += rng.uniform(0.1, 0.4, (DRAWN, 1)) * way / np.linalg.norm(way, axis=1, keepdims=True)
    joint = rng.integers(3, 7, DRAWN)
    lengths = np.array([0.35, 0.35, 0.18, 0.15])[joint - 3]
    local = np.outer(rng.uniform(0.0, 1.0, DRAWN) * lengths, [1.0, 0.0, 0.0])
    depth, stiffness = rng.uniform(0.02, 0.2, DRAWN), np.exp(rng.uniform(np.log(20.0), np.log(500.0), DRAWN))
    of = jax.jit(jax.vmap(SpringContact))
    far = of(np.full((DRAWN, 3), 1e3), np.tile([1.0, 0.0, 0.0], (DRAWN, 1)), np.zeros(DRAWN))
    found = many(reaction("baseline"), Draws(q, poses, ends, joint, local, far))
    place = jax.jit(jax.vmap(lambda *x: material_point(robot, *x)))
    begins, stops = np.asarray(place(q, joint, local)), np.asarray(place(found["q"], joint, local))
    travel = np.linalg.norm(stops - begins, axis=1)
    fit = np.flatnonzero((found["error"] < 1e-3) & (found["rate"] < 2.0) & (travel > 0.03))[:CONTACTS]
    assert len(fit) == CONTACTS, len(fit)
    normal = (begins - stops) / np.maximum(travel, 1e-9)[:, None]
    depth = np.minimum(depth, 0.9 * travel)
    walls = of(stops + depth[:, None] * normal, normal, stiffness)
    draws = Draws(q, poses, ends, joint, local, walls)
    return jax.tree_util.tree_map(lambda x: np.asarray(x)[fit], draws), (stiffness * depth)[fit]


def many(how: Reaction, draws: Draws) -> dict[str, np.ndarray]:
    """Simulates all contacts, `LANES` a call."""

    @jax.jit
    @jax.vmap
    def run(each: Draws) -> dict[str, Any]:
        met = Encounter(each.wall, each.joint, each.local)
        found = simulate_reaction(how, Line(each.first, each.last), 2.0, each.q, met, steps=STEPS, sensor=TouchSensor())
        error = jnp.linalg.norm(found.error, axis=1)
        summed = {"peak": jnp.max(found.force), "end": found.force[-1], "above": DT * jnp.sum(found.force > 5.0)}
        return summed | {"error": jnp.max(error), "rate": jnp.max(jnp.abs(found.motion.velocity)), "q": found.motion.q[-1]}

    parts = [run(jax.tree_util.tree_map(lambda x: x[k : k + LANES], draws)) for k in range(0, len(draws.q), LANES)]  # noqa: B023
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def random_contacts(tell: Callable[[], Any]) -> dict[str, Any]:
    """The outcome of ten thousand contacts, by scheme, for those that come above 5 N unless the arm reacts."""
    draws, unopposed = anywhere()
    pushed, rows = unopposed > 5.0, []
    hows = {scheme: reaction(scheme) for scheme in ("baseline", "rmrc", "rac", "feedback", "multi")}
    hows["multi, low pass at 50 Hz"] = reaction("multi", cutoff=50.0)
    for name, how in hows.items():
        begun = time.perf_counter()
        found = many(how, draws)
        tell()
        seconds = time.perf_counter() - begun
        peak, end, above, error, rate = (found[x][pushed] for x in ("peak", "end", "above", "error", "rate"))
        rows.append(
            {
                "scheme": name,
                "kept_below_5_n": float(np.mean(peak <= 5.0)),
                "ends_below_5_n": float(np.mean(end <= 5.05)),
                "peak_50_n": float(np.median(peak)),
                "peak_95_n": float(np.percentile(peak, 95)),
                "above_5_n_s": float(np.mean(above)),
                "error_50_mm": float(1e3 * np.median(error)),
                "error_95_mm": float(1e3 * np.percentile(error, 95)),
                "rate_95": float(np.percentile(rate, 95)),
                "seconds": seconds,
            }
        )
        print({k: round(v, 3) if isinstance(v, float) else v for k, v in rows[-1].items()})
    return {"contacts": CONTACTS, "pushed": int(pushed.sum()), "seconds_each": STEPS * DT, "rows": rows}


def step_time(count: int = 20_000) -> dict[str, float]:
    """How long a sample of the control loop takes [us]: numbers in, command out."""
    loop, q = ControlLoop(reaction("multi", most=20.0)), start()
    asked = path("avoidable").at(2.0, 6.0)
    asked = asked._replace(**{name: np.asarray(x) for name, x in asked._asdict().items()})
    felt = PointForce(np.array(LINK), np.asarray(material_point(model(), q, LINK, MIDDLE)), 6.0 * np.asarray(wall().normal))
    state, rate, times = loop.start(q), np.zeros(9), []
    for _ in range(count):
        begun = time.perf_counter()
        state, _ = loop.step(state, q, rate, asked, felt)
        times.append(1e6 * (time.perf_counter() - begun))
    return {"p50_us": float(np.median(times)), "p99_us": float(np.percentile(times, 99))}


def draw(file: Path) -> None:
    """The figures, redrawn."""
    figure, axes = plt.subplots(2, len(FIGURES), figsize=(22, 9), layout="constrained", sharex="col")
    for (title, (scene, names)), (above, below) in zip(FIGURES.items(), axes.T, strict=True):
        for name in names:
            found = of_scene(name, scene)
            t, colour = DT * EVERY * np.arange(len(found.force)), DASHED.get(name, COLOURS.get(name))
            style = {"color": colour, "linestyle": "--" if name in DASHED else "-", "label": name}
            above.plot(t, found.force, **style)
            below.plot(t, np.linalg.norm(found.motion.velocity, axis=1), **style)
            if "4.7" in title and name == "feedback":
                below.plot([], [], color=colour, linestyle=":", label="feedback, as measured and filtered")
                above.plot(t, found.felt, color=colour, linestyle=":")
        for level, word in ((PRINTED["threshold_n"], "$F_{th}$ 1.3 N"), (PRINTED["relaxation_n"], "$F_{min}$ 5 N")):
            above.axhline(level, color="0.4", linestyle=":", linewidth=1)
            above.annotate(word, (0.0, level), color="0.4", fontsize=9, va="bottom")
        if "4.6" in title:
            above.axhline(PRINTED["fig_4_6_baseline_above_n"], color="k", linestyle="--", linewidth=1)
            above.annotate("printed: above 9 N", (0.0, 9.0), fontsize=9, va="bottom")
        above.set(title=title, ylabel="contact force [N]", ylim=(-0.2, None))
        below.set(xlabel="time [s]", ylabel=r"$\sqrt{\dot q^T \dot q}$ [1/s]", ylim=(0.0, None))
        below.legend(fontsize=9)
    figure.savefig(file, dpi=80)


def study(quick: bool = False, tell: Callable[[int, int], Any] | None = None) -> dict[str, Any]:
    """All figures; `quick`, the beginning of the analytic course alone. After each simulation it calls `tell(done, total)`."""
    told = steps(tell, 1 if quick else 3 + len(SCHEMES) + 6)
    result: dict[str, Any] = {"printed": PRINTED, "analytic": analytic(quick)}
    told()
    if quick:
        return result
    result |= {
        "begin": start().round(4).tolist(),
        "wall": {"point": POINT.tolist(), "normal": np.asarray(wall().normal).tolist(), "stiffness": STIFFNESS},
        "experiments": experiments(told),
        "courses": courses(),
        "random": random_contacts(told),
        "search": search(SEARCHED),
    }
    told()
    return result | {"step": step_time()}


def main() -> None:
    """All of them; prints, and writes JSON and picture."""
    out = Path(__file__).with_suffix(".json")
    jax.config.update("jax_enable_x64", True)
    result = {"machine": machine()} | study(tell=counted)
    draw(out.with_suffix(".png"))
    text = re.sub(r"\[[-+.e,\s\d]+\]", lambda found: " ".join(found.group().split()), json.dumps(result, indent=1))
    out.write_text(text + "\n")


if __name__ == "__main__":
    main()
