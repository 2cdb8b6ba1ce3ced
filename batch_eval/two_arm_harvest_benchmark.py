"""Two arms on one rail harvest a row at the same time, beside one arm: how long it takes, and whether they meet.

`python batch_eval/two_arm_harvest_benchmark.py` needs `pip install -e ".[test]"`; prints a line a plan and writes
`two_arm_harvest_benchmark.json`. One arm is `p6r`, two are `p6r_pair`, both with the same settings, one after the other in one
run. `judged` looks at a plan of two every millisecond by kinematics and distances that are not jaxik's: Pinocchio places the
links, Coal measures boxes and the fruits in the hands against each other; the scene is measured in NumPy (`harvest_motions`).
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import coal
import jax
import numpy as np
import pinocchio as pin
from harvest_motions import BLOCK, MARGIN, least
from race import machine

import jaxik
from jaxik.harvesting import HarvestPlan, make_row, plan_harvest

SETUPS: dict[str, dict[str, Any]] = {
    "hose or tray at the gripper": {},
    "no leaf in the way": {"leaves": "ignore"},
    "from one end to the other": {"order": "row"},
}
SEEDS = (3, 4, 5)  # of other rows, the first in which both robots stand free at 0
STEP, FAR = 1e-3, 0.2  # [s] between samples; [m] beyond which distances are not told
KINDS = {"prismatic": pin.JointModelPrismaticUnaligned, "revolute": pin.JointModelRevoluteUnaligned}


class Truth:
    """A plan's robot by Pinocchio and Coal: the boxes of each arm, and the fruit in each hand."""

    def __init__(self, plan: HarvestPlan):
        robot, self.plan, self.model, numbers = plan.robot, plan, pin.Model(), {}
        for row in robot.tree.order:
            parent = robot.tree.parents[row]
            frame = robot.parent_T_joint[row] if parent >= 0 else robot.world_T_base @ robot.parent_T_joint[row]
            joint = KINDS[robot.joint_types[row]](np.asarray(robot.axis[row]))
            numbers[row] = self.model.addJoint(numbers.get(parent, 0), joint, pin.SE3(np.array(frame)), robot.joint_names[row])
        self.data, self.numbers = self.model.createData(), numbers
        self.columns = [self.model.idx_qs[numbers[row]] for row in range(robot.num_joints)]
        rows = [set(arm.joints) for arm in plan.arms]
        self.boxes: list[list[tuple[Any, int, np.ndarray]]] = [[], []]  # a shape, the joint that moves it, its frame there
        for box in robot.boxes:
            row = robot.link_joint[box.link] - 1
            arm = next(i for i, own in enumerate(rows) if row in own)
            self.boxes[arm].append((coal.Box(*(2.0 * np.asarray(box.half))), numbers[row], np.asarray(box.joint_T_box)))
        self.tips = [numbers[robot.tips[i] - 1] for i in range(len(rows))]
        self.held = {stage.fruit: self._fruit(stage) for stage in plan.stages if stage.kind == "retreat"}

    def place(self, q: np.ndarray) -> None:
        """Moves all links."""
        moved = np.zeros(self.model.nq)
        moved[self.columns] = q
        pin.forwardKinematics(self.model, self.data, moved)

    def _fruit(self, stage: Any) -> tuple[Any, int, np.ndarray]:
        """A fruit as the hand holds it: a capsule, the joint that moves it, and its frame there."""
        scene, arms = self.plan.scene, [arm.name for arm in self.plan.arms]
        number = arms.index(stage.arm)
        q = np.array(self.plan.home, float)
        q[list(self.plan.arms[number].joints)] = stage.trajectory.at_times(np.zeros(1)).q[0]
        self.place(q)
        row = scene.owners[2].index(scene.object_names.index(stage.fruit))
        a, b = (np.asarray(x[row], float) for x in (scene.capsules.a, scene.capsules.b))
        frame = np.eye(4)
        frame[:3, :3] = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), (b - a) / np.linalg.norm(b - a)).matrix()
        frame[:3, 3] = (a + b) / 2.0
        shape = coal.Capsule(float(scene.capsules.radius[row]), float(np.linalg.norm(b - a)))
        joint = self.tips[number]
        return shape, joint, np.linalg.inv(self.data.oMi[joint].homogeneous) @ frame

    def apart(self, q: np.ndarray, held: list[str]) -> float:
        """The distance [m] of one arm, and what it holds, to the other; `FAR` beyond that."""
        self.place(q)
        placed = []
        for boxes, fruit in zip(self.boxes, held, strict=True):
            shapes = [*boxes, *([self.held[fruit]] if fruit else [])]
            frames = [(shape, self.data.oMi[joint].homogeneous @ frame) for shape, joint, frame in shapes]
            placed.append([(shape, frame, _radius(shape)) for shape, frame in frames])
        found, ask = FAR, coal.DistanceRequest()
        for shape, frame, radius in placed[0]:
            for other, there, around in placed[1]:
                if np.linalg.norm(frame[:3, 3] - there[:3, 3]) - radius - around < found:
                    poses = (coal.Transform3s(x[:3, :3], x[:3, 3]) for x in (frame, there))
                    first, second = poses
                    found = min(found, coal.distance(shape, first, other, second, ask, coal.DistanceResult()))
        return found


def _radius(shape: Any) -> float:
    if isinstance(shape, coal.Box):
        return float(np.linalg.norm(shape.halfSide))
    return float(shape.radius + shape.halfLength)


def judged(plan: HarvestPlan, step: float = STEP, ignored: bool = False) -> dict[str, float]:
    """The least distance between the arms and of each to the scene [m], how many of the samples, one a `step` [s], are below 0
    and below the margin, and the largest shares of the limits. Leaves may be `ignored`."""
    motion, truth = plan.sample(step), Truth(plan)
    stages = [[plan.stages[i] for i in row] for row in motion.stage]
    held = [[stage.fruit if stage.carries else "" for stage in row] for row in stages]
    apart = np.array([truth.apart(q, each) for q, each in zip(motion.q, held, strict=True)])
    around = plan.scene.without(np.flatnonzero(plan.scene.removable)) if ignored else plan.scene
    scene = min(_to_scene(plan, around, motion, k) for k in range(len(plan.arms)))
    robot = plan.robot
    return {
        "arms_apart_m": float(apart.min()),
        "arms_hit": int((apart < 0.0).sum()),
        "arms_below_margin": int((apart < MARGIN - 1e-5).sum()),
        "scene_apart_m": scene,
        "samples": len(apart),
        "velocity": float(np.max(np.abs(motion.velocity) / robot.velocity)),
        "acceleration": float(np.max(np.abs(motion.acceleration) / (4.0 * robot.velocity))),
        "beyond_limits": float(np.max([robot.lower - motion.q, motion.q - robot.upper])),
    }


def _to_scene(plan: HarvestPlan, scene: jaxik.Scene, motion: Any, k: int) -> float:
    """The least distance [m] of an arm, by balls around its boxes, and of its fruit, to what stands and hangs at that time."""
    arm, names = plan.arms[k], scene.object_names
    picked = [(stage.start, stage.fruit) for stage in plan.stages if stage.kind == "retreat"]
    gone = np.zeros((len(motion.time), len(names)), bool)
    for start, fruit in picked:
        gone[:, names.index(fruit)] = motion.time >= start
    own = [plan.stages[i] for i in motion.stage[:, k]]
    each = jax.jit(jax.vmap(lambda q: jaxik.collision.robot_spheres(arm.robot, q)))
    tips = jax.jit(jax.vmap(lambda q: arm.robot.world_T_base @ jaxik.forward_kinematics(arm.robot, q)))
    bodies, touching = {}, {}
    for stage in (stage for stage in plan.stages if stage.kind == "retreat" and stage.arm == arm.name):
        row = scene.owners[2].index(names.index(stage.fruit))
        body = np.linspace(scene.capsules.a[row], scene.capsules.b[row], 61)
        at = np.asarray(tips(stage.trajectory.at_times(np.zeros(1)).q))[0]
        thick = np.full(len(body), float(scene.capsules.radius[row]))
        bodies[stage.fruit] = (body - at[:3, 3]) @ at[:3, :3], thick
        touching[stage.fruit] = least(scene, {stage.fruit}, body, thick) < MARGIN
    found = np.inf
    for first in range(0, len(motion.q), BLOCK):
        rows = np.arange(first, min(first + BLOCK, len(motion.q)))
        q = motion.q[np.resize(rows, BLOCK)][:, list(arm.joints)]  # of one size: it compiles once
        centres, radii = (np.asarray(x)[: len(rows)] for x in each(q))
        frames = np.asarray(tips(q))[: len(rows)]
        distance = np.where(gone[rows], np.inf, least(scene, set(), centres, radii[0]))
        for i, row in enumerate(rows):
            stage = own[row]
            if stage.kind == "approach":
                distance[i, names.index(stage.fruit)] = np.inf
            if stage.carries:
                body, thick = bodies[stage.fruit]
                swept = body @ frames[i, :3, :3].T + frames[i, :3, 3]
                beside = np.where(gone[row], np.inf, least(scene, set(), swept, thick))
                if stage.kind == "retreat" and motion.time[row] < stage.end:
                    beside[touching[stage.fruit]] = np.inf
                distance[i] = np.minimum(distance[i], beside)
        found = min(found, float(distance.min()))
    return found


# --------------------------------------------------------------------------------------------------------------------


def both(scene: jaxik.Scene, **how: Any) -> dict[str, Any]:
    """One arm and two in a scene: what they pick, how long it takes, and what the judge says of two."""
    found = {}
    for name in ("p6r", "p6r_pair"):
        harvest = jaxik.harvest(jaxik.load(name), scene, margin=0.005)
        plans = [plan_harvest(harvest, margin=MARGIN, **how) for _ in range(2)]  # the first one compiles
        plan = plans[-1]
        by = {arm.name: sum(row.arm == arm.name for row in plan) for arm in plan.arms} if len(plan.arms) > 1 else {}
        found[name] = {"picked": len(plan.order), "order": plan.order, "s": plan.duration, "cycle_s": plan.cycle}
        found[name] |= {"fruits": {row.fruit: row.arm or row.why for row in plan}, "by": by, "planning_s": plan.seconds}
        if by:
            own = [[stage for stage in plan.stages if stage.arm == arm.name] for arm in plan.arms]
            busy = [sum(stage.end - stage.start for stage in each) for each in own]
            found[name] |= {"busy_s": busy}
            found[name] |= {"judged": judged(plan, ignored=how.get("leaves") == "ignore")}
    one, two = found.values()
    return found | {"ratio": two["s"] / one["s"], "ratio_a_fruit": two["cycle_s"] / one["cycle_s"]}


def main() -> None:
    """Plans all; prints, and writes JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    out = parser.parse_args().out
    result: dict[str, Any] = {"machine": machine(), "margin_m": MARGIN, "step_s": STEP, "setups": {}, "rows": {}}
    asked = [("setups", name, jaxik.load_scene("cucumber_row"), how) for name, how in SETUPS.items()]
    asked += [("rows", seed, make_row(seed=seed), {}) for seed in SEEDS]
    for kind, name, scene, how in asked:
        row = result[kind][name] = both(scene, **how)
        print(f"{name}: {_told(row)}", flush=True)
        out.write_text(json.dumps(result, indent=1) + "\n")


def _told(row: dict[str, Any]) -> str:
    one, two = row["p6r"], row["p6r_pair"]
    words = [f"{each['picked']} in {each['s']:.2f} s, planned in {each['planning_s']:.1f} s" for each in (one, two)]
    return f"{' | '.join(words)} | {row['ratio']:.3f}, a fruit {row['ratio_a_fruit']:.3f} {two['judged']}"


if __name__ == "__main__":
    main()
