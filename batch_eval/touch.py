"""Touch: the thesis' experiments of section 4.3 again, figures 4.6 to 4.8 in kind, and ten thousand contacts anywhere.

`crops_v2` follows table 4.1's straight lines with the tip's position as its task; a vertical wall of springs, as stiff as the
thesis' latex band, stands in the way of link 4. Where the band stood and how the arm began is not printed. Both are ours: a
posture, found among 128 random ones, in which the null space is enough for the first line and not for the second, and the wall
where the baseline comes to 9.6 N. The low pass, the sensor (1.3 to 20 N, a reading in 4 ms), thresholds and gains are table
4.1's; the laws behind the estimator and the transitions are ours. The cost is joint limits alone, with table 4.1's soft limits;
its self-collision term is left out, since neighbouring stand-in capsules of crops_v2 are 15 mm apart whatever it does. The arm
follows its rates exactly.
"""

from __future__ import annotations

import argparse
import functools
import json
import time
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from race import machine

import jaxik
from jaxik.dynamics import PointForce, material_point
from jaxik.motions import Line
from jaxik.spmd import ControlLoop
from jaxik.touch import (
    Encounter,
    Reaction,
    ReactionResult,
    SpringContact,
    StiffnessEstimator,
    TouchSensor,
    simulate_reaction,
)

DT, WEIGHTS = 1e-3, (10.0, 1.0, 2.0, 2.0, 1.0, 1.0, 1.0, 1.5, 1.0)
POSTURE = np.array([0.7, 0.3, 0.5, 0.4, -1.2, 0.1, 0.1, 0.0, 0.2])  # near which the arm begins
BEGIN = [-0.30, 1.30, 1.1]
SCENES = {"avoidable": ([0.40, 1.0, 1.1], 6.0, 15.0), "inevitable": ([0.75, 1.0, 1.1], 9.0, 25.0)}  # end, duration, measured
LINK, MIDDLE = 4, np.array([0.175, 0.0, -0.03])  # between revolute joints 4 and 5
STIFFNESS, REACHED = 60.0, 9.6  # [N/m], the baseline's force [N]
DRAWN, CONTACTS, LANES, STEPS = 25_000, 10_000, 250, 3000
FIGURES = {
    "fig. 4.6 in kind: avoidable": ("avoidable", ("baseline", "rmrc", "rac")),
    "fig. 4.7 in kind: avoidable": ("avoidable", ("baseline", "rmrc", "feedback")),
    "fig. 4.8 in kind: inevitable": ("inevitable", ("baseline", "rmrc", "feedback", "multi")),
    "not in the thesis: inputs of (4.48)": ("avoidable", ("task", "joint", "multi")),
}
COLOURS = {"baseline": "0.6", "rmrc": "tab:blue", "rac": "tab:green", "feedback": "goldenrod", "multi": "tab:red"}


@functools.cache
def model() -> jaxik.Robot:
    return jaxik.load("crops_v2")


@functools.cache
def reaction(scheme: str, **changes: Any) -> Reaction:
    """The reaction of table 4.1; 20 instead of 5 scales joint limits on the acceleration level."""
    soft = np.r_[0.3, np.full(8, np.radians(30.0))] / (model().upper - model().lower)
    alpha = 20.0 if scheme == "rac" else 5.0
    cost = lambda q: jaxik.costs.joint_limit_cost(model(), q, soft=soft)
    how = {"stiffness": StiffnessEstimator(start=STIFFNESS)} | changes
    return Reaction(model(), scheme=scheme, weights=WEIGHTS, cost=cost, alpha=alpha, **how)


@functools.cache
def begin() -> np.ndarray:
    """The posture (9,) whose tip is at the start."""
    found = jaxik.solve_ik(model(), jaxik.pose(BEGIN), task=jaxik.Task.position(), seeds="near", reference=POSTURE)
    assert found.success
    return np.asarray(found.q)


def path(scene: str) -> Line:
    return Line(jaxik.pose(BEGIN), jaxik.pose(SCENES[scene][0]))


@functools.cache
def followed(scene: str, scheme: str) -> ReactionResult:
    _, duration, seconds = SCENES[scene]
    met = Encounter(wall(), LINK, MIDDLE)
    run = lambda q: simulate_reaction(
        reaction(scheme), path(scene), duration, q, met, steps=round(seconds / DT), sensor=TouchSensor()
    )
    return jax.tree_util.tree_map(np.asarray, jax.jit(run)(begin()))


@functools.cache
def wall() -> SpringContact:
    """Across the way of the link's middle, in the horizontal plane, where the baseline ends `REACHED` deep."""
    nothing = Encounter(SpringContact([100.0, 0.0, 0.0], [-1.0, 0.0, 0.0], 0.0), LINK, MIDDLE)
    duration = SCENES["avoidable"][1]
    free = jax.jit(
        lambda q: simulate_reaction(reaction("baseline"), path("avoidable"), duration, q, nothing, steps=6000).motion.q
    )
    q = free(begin())
    first, last = (np.asarray(material_point(model(), q[k], LINK, MIDDLE)) for k in (0, -1))
    against = (first - last) * [1.0, 1.0, 0.0]
    normal = np.round(against / np.linalg.norm(against), 2)
    return SpringContact(np.round(last + REACHED / STIFFNESS * normal, 3), normal, STIFFNESS)


def experiments() -> list[dict[str, Any]]:
    """The figures in numbers."""
    rows = []
    for scene, scheme in dict.fromkeys((scene, scheme) for scene, schemes in FIGURES.values() for scheme in schemes):
        found = followed(scene, scheme)
        hit = int(np.argmax(found.force > 0.0))
        peak = hit + int(np.argmax(found.force[hit : hit + round(1.5 / DT)]))
        rows.append(
            {
                "scene": scene,
                "scheme": scheme,
                "peak_n": float(found.force.max()),
                "end_n": float(found.force[-1]),
                "first_peak_n": float(found.force[peak]),
                "dip_after_n": float(found.force[peak : peak + round(1.5 / DT)].min()),
                "below_2_n_after_s": _settled(found.force[hit:] < 2.0),
                "peak_rate": float(np.linalg.norm(found.motion.velocity[hit:], axis=1).max()),
                "task_error_mm": float(1e3 * np.linalg.norm(found.error, axis=1).max()),
                "stiffness_n_m": float(found.stiffness[-1]),
            }
        )
        print({k: round(v, 3) if isinstance(v, float) else v for k, v in rows[-1].items()})
    return rows


def _settled(inside: np.ndarray) -> float | None:
    """[s] until it stays so."""
    outside = np.flatnonzero(~inside)
    last = int(outside[-1]) + 1 if len(outside) else 0
    return None if last == len(inside) else last * DT


def analytic() -> dict[str, float]:
    """How far feedback linearisation is from F'' + 2 F' + 4 F = 0, a share of the first force: with the stiffness known, twice
    and half as large as believed, and estimated. A contact of 6 N where the line begins, without sensor, threshold, filter."""
    steps, t = 600, DT * np.arange(600)
    exact = np.exp(-t) * (np.cos(np.sqrt(3.0) * t) - np.sin(np.sqrt(3.0) * t) / np.sqrt(3.0))
    point = np.asarray(material_point(model(), begin(), LINK, MIDDLE))
    found = {}
    known, estimated = {"stiffness": STIFFNESS}, {"stiffness": StiffnessEstimator(start=STIFFNESS)}
    for name, how, true in (
        ("known", known, 60.0),
        ("twice as stiff, not known", known, 120.0),
        ("half as stiff, not known", known, 30.0),
        ("twice as stiff, estimated", estimated, 120.0),
        ("half as stiff, estimated", estimated, 30.0),
    ):
        bare = Reaction(model(), scheme="feedback", weights=WEIGHTS, threshold=0.0, cutoff=None, **how)
        stiff = SpringContact(point + 6.0 / true * np.asarray(wall().normal), wall().normal, true)
        given = bare, path("avoidable"), SCENES["avoidable"][1], begin(), Encounter(stiff, LINK, MIDDLE)
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


def random_contacts() -> dict[str, Any]:
    """The outcome of ten thousand contacts, by scheme, for those that come above 5 N unless the arm reacts."""
    draws, unopposed = anywhere()
    pushed, rows = unopposed > 5.0, []
    hows = {scheme: reaction(scheme) for scheme in ("baseline", "rmrc", "rac", "feedback", "multi")}
    hows["multi, low pass at 50 Hz"] = reaction("multi", cutoff=50.0)
    for name, how in hows.items():
        begun = time.perf_counter()
        found = many(how, draws)
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
    loop, q = ControlLoop(reaction("multi", most=20.0)), begin()
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
    figure, axes = plt.subplots(2, len(FIGURES), figsize=(20, 8.5), layout="constrained", sharex="col")
    for (title, (scene, schemes)), (above, below) in zip(FIGURES.items(), axes.T, strict=True):
        for scheme in schemes:
            found = followed(scene, scheme)
            t, colour = DT * np.arange(len(found.force)), COLOURS.get(scheme)
            style = {"color": colour, "linestyle": "--" if scheme == "multi" else "-", "label": scheme}
            above.plot(t, found.force, **style)
            below.plot(t, np.linalg.norm(found.motion.velocity, axis=1), **style)
        for level, name in ((1.3, "$F_{th}$"), (5.0, "$F_{min}$")):
            above.axhline(level, color="0.4", linestyle=":", linewidth=1)
            above.annotate(name, (0.0, level), color="0.4", fontsize=9, va="bottom")
        above.set(title=title, ylabel="contact force [N]")
        below.set(xlabel="time [s]", ylabel=r"$\sqrt{\dot q^T \dot q}$ [1/s]", ylim=(0.0, None))
        above.legend(fontsize=9)
    figure.savefig(file, dpi=80)


def main() -> None:
    """All of them; prints, and writes JSON and picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    out = parser.parse_args().out
    jax.config.update("jax_enable_x64", True)
    result = {
        "machine": machine(),
        "begin": begin().round(4).tolist(),
        "wall": {"point": wall().point.tolist(), "normal": wall().normal.tolist(), "stiffness": STIFFNESS},
        "analytic": analytic(),
        "experiments": experiments(),
    }
    draw(out.with_suffix(".png"))
    result |= {"random": random_contacts(), "step": step_time()}
    out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
