"""The tables of `docs/benchmarks.md` and the README, from the JSON files beside this one (`docs/benchmarks.py`)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from tables_collision import collision_markdown, mesh_markdown, model_markdown, motions_markdown, scaling_markdown
from tables_forces import dynamics_markdown, identification_markdown, torque_markdown, touch_markdown
from tables_motions import (
    astar_markdown,
    harvest_motions_markdown,
    peppers_markdown,
    planning_markdown,
    predictive_markdown,
    statistics_markdown,
)
from tables_postures import base_markdown, ik_markdown, kinematics_markdown, narrow_markdown, nine_dof_markdown, sweep_markdown
from tables_teleoperation import teleoperation_markdown
from tables_words import duration

HERE = Path(__file__).parent
TABLES = {
    "astar.json": astar_markdown,
    "base_placement.json": base_markdown,
    "benchmark.json": kinematics_markdown,
    "collision_benchmark.json": collision_markdown,
    "collision_models.json": model_markdown,
    "collision_scaling.json": scaling_markdown,
    "dynamics_benchmark.json": dynamics_markdown,
    "harvest_motions.json": harvest_motions_markdown,
    "identification.json": identification_markdown,
    "ik_benchmark.json": ik_markdown,
    "mesh_benchmark.json": mesh_markdown,
    "motions.json": motions_markdown,
    "narrow_goals.json": narrow_markdown,
    "nine_dof.json": nine_dof_markdown,
    "peppers.json": peppers_markdown,
    "planning_benchmark.json": planning_markdown,
    "predictive_benchmark.json": predictive_markdown,
    "predictive_statistics.json": statistics_markdown,
    "sweep_benchmark.json": sweep_markdown,
    "teleoperation.json": teleoperation_markdown,
    "torque_estimation.json": torque_markdown,
    "touch.json": touch_markdown,
}


def table(name: str) -> str:
    """That of a benchmark's JSON file, or the "overview" of them all."""
    return overview() if name == "overview" else TABLES[name](_result(name))


def tables() -> list[str]:
    """One a benchmark."""
    return [table(name) for name in TABLES]


def overview() -> str:
    """A row for each kind of work: how long one takes in a batch, and what the nearest others take."""
    names = ("", "dynamics_", "ik_", "collision_", "planning_", "sweep_", "predictive_")
    work, forces, ik, collision, planning, sweep, ahead = (_result(f"{name}benchmark.json") for name in names)
    alone = next(row for row in ik["panda"] if row["who"] == "Panda: jaxik" and row["targets"] == 1)
    fastest = lambda rows: min((row for row in rows if "jaxik" not in row["who"]), key=lambda row: row["us_each"])
    other, horizon, goals = fastest(ik["panda"]), ahead["real_time"][1], ik["goals"]
    motions, timing = planning["problems"], planning["timing"]
    rows = [
        _ours(work, "forward kinematics, Panda, float32", "forward kinematics of a Panda", "PyRoki", "Pinocchio, Python loop"),
        _ours(
            forces, "inverse dynamics, Panda, float32", "inverse dynamics of a Panda", "Pinocchio, Python loop", "frax, vmap"
        ),
        _ours(work, "closed form, P6R, all 8 branches, float32", "closed form, all 8 branches", "EAIK, 2 threads"),
        _ours(
            collision,
            "clearance, panda, 59 spheres, 700 scenes",
            "clearance of a Panda among obstacles",
            "coal and Pinocchio, Python loop",
            "PyRoki, vmap, cylinders as capsules",
        ),
        (
            "inverse kinematics of a Panda, 2,000 poses",
            f"{duration(ik['panda'][0]['us_each'])}, {100 * ik['panda'][0]['success']:.0f} % solved",
            f"{other['who'].removeprefix('Panda: ')}: {duration(other['us_each'])}, {100 * other['success']:.0f} %",
        ),
        ("the same, one pose a call", duration(alone["us_each"]), "-"),
        (
            "a Panda's goal among obstacles, one a call",
            f"{goals['p50_ms']:.1f} ms, {round(goals['goals'] * goals['solved'])} of {goals['goals']} solved",
            "-",
        ),
        (
            "the same, a motion that is proven free and timed",
            f"{motions['p50_ms']:.0f} ms, {motions['solved']} of {motions['problems']} solved",
            "-",
        ),
        (
            "the fastest timing of a path of seven joints",
            duration(timing["us_each"]),
            f"TOPP-RA: {duration(timing['toppra_us_each'])}",
        ),
        (
            "a target of a reach map over a slide, with proof",
            duration(1e6 / sweep["eaik"]["jaxik_refine_5"]["per_second"]),
            f"EAIK in a loop, no proof: {duration(sweep['eaik']['eaik_with_limits_us'])}",
        ),
        (
            f"a control sample, nine joints, {horizon['horizon_s']:g} s ahead",
            f"{horizon['p50_ms']:.1f} ms",
            f"CasADi's generated C: {horizon['casadi_p50_ms']:.1f} ms",
        ),
    ]
    return "\n".join(["| work | jaxik | others |", "| --- | --- | --- |", *(f"| {' | '.join(row)} |" for row in rows)])


def _ours(result: dict[str, Any], work: str, name: str, *others: str) -> tuple[str, str, str]:
    """The time of one in jaxik's batch, and in that of the `others`."""
    each = {row["who"]: duration(1e6 / row["per_second"]) for row in result["rows"] if row["work"] == work}
    return name, each["jaxik"], "; ".join(f"{who}: {each[who]}" for who in others)


def _result(name: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((HERE / name).read_text())
    return found


if __name__ == "__main__":
    print("\n\n".join(tables()))
