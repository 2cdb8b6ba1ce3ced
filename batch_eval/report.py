"""The tables of `docs/benchmarks.md` and the README, from the JSON files beside this one (`docs/benchmarks.py`)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from tables.changes import changes_markdown
from tables.clouds import clouds_markdown
from tables.collision import (
    collision_markdown,
    mesh_markdown,
    model_markdown,
    motions_markdown,
    plans_markdown,
    scaling_markdown,
    scenes_markdown,
)
from tables.constrained import constrained_markdown
from tables.depth import depth_markdown, fields_markdown
from tables.exports import export_markdown
from tables.five_joints import five_joints_markdown
from tables.forces import dynamics_markdown, identification_markdown, torque_markdown, touch_markdown
from tables.gpu import gpu_markdown
from tables.horizon import horizon_markdown
from tables.loops import loops_markdown
from tables.mobile_base import mobile_base_markdown
from tables.motions import (
    astar_markdown,
    ends_markdown,
    furniture_markdown,
    harvest_motions_markdown,
    jerk_markdown,
    peppers_markdown,
    planning_markdown,
    predictive_markdown,
    roadmap_markdown,
    slit_markdown,
    statistics_markdown,
    trajectory_markdown,
)
from tables.moving import moving_markdown
from tables.one_target import one_target_markdown
from tables.planners import planners_markdown
from tables.postures import (
    base_markdown,
    closed_forms_markdown,
    general_markdown,
    ik_markdown,
    kinematics_markdown,
    narrow_markdown,
    nine_dof_markdown,
    sweep_markdown,
)
from tables.programs import programs_markdown
from tables.replanning import replanning_markdown
from tables.teleoperation import teleoperation_markdown
from tables.tips import tips_markdown
from tables.tool_paths import tool_paths_markdown
from tables.trees import trees_markdown
from tables.two_arm_plans import two_arm_plans_markdown
from tables.two_arms import two_arms_markdown
from tables.words import duration
from tables.xla import xla_markdown

HERE = Path(__file__).parent
TABLES = {
    "astar.json": astar_markdown,
    "base_placement.json": base_markdown,
    "base_poses_benchmark.json": mobile_base_markdown,
    "benchmark.json": kinematics_markdown,
    "closed_forms.json": closed_forms_markdown,
    "change_benchmark.json": changes_markdown,
    "cloud_benchmark.json": clouds_markdown,
    "collision_benchmark.json": collision_markdown,
    "collision_models.json": model_markdown,
    "collision_plans.json": plans_markdown,
    "collision_scenes.json": scenes_markdown,
    "collision_scaling.json": scaling_markdown,
    "constrained_benchmark.json": constrained_markdown,
    "depth_benchmark.json": depth_markdown,
    "dynamics_benchmark.json": dynamics_markdown,
    "ends_benchmark.json": ends_markdown,
    "export_benchmark.json": export_markdown,
    "field_benchmark.json": fields_markdown,
    "five_joints_benchmark.json": five_joints_markdown,
    "furniture_benchmark.json": furniture_markdown,
    "general_arms.json": general_markdown,
    "gpu_benchmark.json": gpu_markdown,
    "harvest_motions.json": harvest_motions_markdown,
    "horizon_benchmark.json": horizon_markdown,
    "identification.json": identification_markdown,
    "ik_benchmark.json": ik_markdown,
    "jerk_benchmark.json": jerk_markdown,
    "loop_benchmark.json": loops_markdown,
    "mesh_benchmark.json": mesh_markdown,
    "motions.json": motions_markdown,
    "moving_benchmark.json": moving_markdown,
    "narrow_goals.json": narrow_markdown,
    "nine_dof.json": nine_dof_markdown,
    "one_target_benchmark.json": one_target_markdown,
    "peppers.json": peppers_markdown,
    "planners_benchmark.json": planners_markdown,
    "planning_benchmark.json": planning_markdown,
    "predictive_benchmark.json": predictive_markdown,
    "predictive_statistics.json": statistics_markdown,
    "random_programs.json": programs_markdown,
    "replan_benchmark.json": replanning_markdown,
    "roadmap_benchmark.json": roadmap_markdown,
    "slit_benchmark.json": slit_markdown,
    "sweep_benchmark.json": sweep_markdown,
    "teleoperation.json": teleoperation_markdown,
    "tool_paths_benchmark.json": tool_paths_markdown,
    "torque_estimation.json": torque_markdown,
    "touch.json": touch_markdown,
    "trajectory_benchmark.json": trajectory_markdown,
    "tree_benchmark.json": trees_markdown,
    "two_arm_harvest_benchmark.json": two_arms_markdown,
    "two_arm_planning_benchmark.json": two_arm_plans_markdown,
    "two_arms_benchmark.json": tips_markdown,
    "xla_benchmark.json": xla_markdown,
}


def table(name: str) -> str:
    """The table of a benchmark's JSON file and the machine that it ran on, or the "overview" of them all."""
    if name == "overview":
        return overview()
    result = _result(name)
    told = result.get("machine", result)
    where = f"Machine: {told['cpu']}, jax {told['jax']}." if "cpu" in told else ""
    return f"{TABLES[name](result)}\n\n{where}".rstrip()


def tables() -> list[str]:
    """One a benchmark."""
    return [table(name) for name in TABLES]


def overview() -> str:
    """A row for each kind of work: how long one takes in a batch, and what the nearest others take."""
    rows = [*_of_arms(), *_of_postures(), *_of_motions(), *_of_live_worlds(), *_of_exports()]
    return "\n".join(["| work | jaxik | others |", "| --- | --- | --- |", *(f"| {' | '.join(row)} |" for row in rows)])


def _of_arms() -> list[tuple[str, str, str]]:
    work, forces, collision = map(_result, ("benchmark.json", "dynamics_benchmark.json", "collision_benchmark.json"))
    loop = "Pinocchio, Python loop"
    clear = "clearance, panda, 59 spheres, 700 scenes", "clearance of a Panda among obstacles"
    return [
        _ours(work, "forward kinematics, Panda, float32", "forward kinematics of a Panda", "PyRoki", loop),
        _ours(forces, "inverse dynamics, Panda, float32", "inverse dynamics of a Panda", loop, "frax, vmap"),
        _ours(collision, *clear, "coal and Pinocchio, Python loop", "PyRoki, vmap, cylinders as capsules"),
    ]


def _of_postures() -> list[tuple[str, str, str]]:
    ik, alone = _result("ik_benchmark.json")["panda"], _result("one_target_benchmark.json")
    other = min((row for row in ik if "jaxik" not in row["who"]), key=lambda row: row["us_each"])
    solved = lambda us, share: f"{duration(us)}, {100 * share:.0f} %"
    others = f"{other['who'].removeprefix('Panda: ')}: {solved(other['us_each'], other['success'])}"
    ours, peer = (next(r for r in alone["arms"]["Panda"]["calls"] if r["who"] == who) for who in ("solve_ik", "TRAC-IK"))
    goals = alone["goals"]
    found = f"{duration(1e3 * goals['solve_ik']['p50_ms'])}, {goals['solve_ik']['solved']} of {goals['goals']} solved"
    return [
        ("inverse kinematics of a Panda, 2,000 poses", f"{solved(ik[0]['us_each'], ik[0]['success'])} solved", others),
        (
            "the same, one pose a call",
            f"{solved(ours['p50_us'], ours['solved'])} solved",
            f"TRAC-IK: {solved(peer['p50_us'], peer['solved'])}",
        ),
        ("a Panda's goal among obstacles, one a call", found, "-"),
    ]


def _of_motions() -> list[tuple[str, str, str]]:
    planners, peers = _result("planners_benchmark.json"), _result("sweep_benchmark.json")["eaik"]
    ahead = _result("predictive_benchmark.json")["real_time"][1]
    planned = f"{1e-3 * planners['jaxik_us']['call']['p50']:.1f} ms, {planners['solved']} of {planners['problems']} solved"
    vamp = f"VAMP, an untimed way, not proven: {duration(planners['vamp_both_us']['p50'])}"
    target, eaik = duration(1e6 / peers["jaxik_refine_5"]["per_second"]), duration(peers["eaik_with_limits_us"])
    sample = f"a control sample, nine joints, {ahead['horizon_s']:g} s ahead"
    casadi = f"CasADi's generated C: {ahead['casadi_p50_ms']:.1f} ms"
    return [
        ("the same, a motion that is proven free and timed", planned, vamp),
        ("a target of a reach map over a slide, with proof", target, f"EAIK in a loop, no proof: {eaik}"),
        (sample, f"{ahead['p50_ms']:.1f} ms", casadi),
    ]


def _of_live_worlds() -> list[tuple[str, str, str]]:
    cloud = next(row for row in _result("cloud_benchmark.json")["clouds"] if row["points"] == 100_000)
    each = {who: duration(1e6 * cloud[who]["clearance_s"]) for who in ("jaxik", "scipy", "coal")}
    others = f"SciPy, a tree: {each['scipy']}; coal, an octree, from Python: {each['coal']}"
    return [("clearance of a Panda to a cloud of 100,000 points", each["jaxik"], others)]


def _of_exports() -> list[tuple[str, str, str]]:
    rows = _result("export_benchmark.json")["rows"]
    times = {row["who"]: row["ns"] for row in rows if (row["work"], row["kind"]) == ("pose_and_jacobian", "float")}
    other = min((who for who in times if who.startswith("CasADi")), key=lambda who: float(times[who]))
    told = lambda who: duration(1e-3 * times[who])
    return [("a Panda's pose and Jacobian in C, one a call", told("jaxik"), f"{other}: {told(other)}")]


def _ours(result: dict[str, Any], work: str, name: str, *others: str) -> tuple[str, str, str]:
    """The time of one in jaxik's batch, and in that of the `others`."""
    each = {row["who"]: duration(1e6 / row["per_second"]) for row in result["rows"] if row["work"] == work}
    return name, each["jaxik"], "; ".join(f"{who}: {each[who]}" for who in others)


def _result(name: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((HERE / name).read_text())
    return found


if __name__ == "__main__":
    print("\n\n".join(tables()))
