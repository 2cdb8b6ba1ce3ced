"""Inverse kinematics of the bare Panda by peers, each at its best documented setting: poses (N, 4, 4) to configurations (N, 7).

A contender is a function of the poses; what it returns is judged by Pinocchio, not by what it says of itself.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pinocchio as pin
from peers.arm import eaik_robot
from peers.panda import TIP
from scipy.spatial.transform import Rotation
from setups.problems import POSITION, ROTATION

from jaxik import Robot

Solver = Callable[[np.ndarray], np.ndarray]
RESTARTS, STEPS = 10, 100  # of solvers that follow one start at a time


def pyroki_solver(urdf: Path, hard_limits: bool) -> Solver:
    """PyRoki's basic example, `vmap`-ed: Levenberg-Marquardt on an analytic pose cost, limits as a constraint (its augmented
    Lagrangian) or as a cost (cheaper, and its answers are clipped to the limits)."""
    import jaxlie
    import jaxls
    import pyroki
    import yourdfpy

    peer = pyroki.Robot.from_urdf(yourdfpy.URDF.load(str(urdf), load_meshes=False, load_collision_meshes=False))
    tip, variable = jnp.asarray(peer.links.names.index(TIP)), peer.joint_var_cls(0)

    def solve(wxyz_xyz: Any) -> Any:
        target = jaxlie.SE3(wxyz_xyz)
        costs = [
            pyroki.costs.pose_cost_analytic_jac(peer, variable, target, tip, pos_weight=50.0, ori_weight=10.0),
            pyroki.costs.limit_constraint(peer, variable)
            if hard_limits
            else pyroki.costs.limit_cost(peer, variable, weight=100.0),
        ]
        problem = jaxls.LeastSquaresProblem(costs=costs, variables=[variable]).analyze()
        options = {
            "verbose": False,
            "linear_solver": "dense_cholesky",
            "trust_region": jaxls.TrustRegionConfig(lambda_initial=1.0),
        }
        q = problem.solve(**options)[variable]
        return q if hard_limits else jnp.clip(q, peer.joints.lower_limits, peer.joints.upper_limits)

    batch = jax.jit(jax.vmap(solve))

    def run(poses: np.ndarray) -> np.ndarray:
        quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat()[:, [3, 0, 1, 2]]
        return np.asarray(batch(jnp.asarray(np.concatenate([quaternions, poses[:, :3, 3]], axis=1), jnp.float32)))

    return run


def eaik_solver(robot: Robot) -> Solver:
    """EAIK on an arm of six joints whose geometry it knows: of all branches the one that leaves the limits least."""
    peer, tip_R = eaik_robot(robot)
    low, high = robot.finite_limits

    def run(poses: np.ndarray) -> np.ndarray:
        batch = poses.copy()
        batch[:, :3, :3] = batch[:, :3, :3] @ tip_R.T
        found = []
        for answer in peer.IK_batched(list(batch), 2):
            branches = np.array(answer.Q).reshape(-1, 6)
            past = np.maximum(low - branches, branches - high).max(axis=1)
            exact = ~np.array(answer.is_LS, bool)
            found.append(branches[np.argmin(np.where(exact, past, np.inf))] if exact.any() else np.full(6, np.nan))
        return np.array(found)

    return run


def torch_solver(urdf: Path) -> Solver:
    """pytorch-kinematics' damped pseudo-inverse with ten random starts a pose, its own refinement at the limits on."""
    import pytorch_kinematics as pk
    import torch

    robot = pk.build_serial_chain_from_urdf(urdf.read_bytes(), TIP).to(dtype=torch.float32)
    limits = torch.tensor(robot.get_joint_limits()).T
    torch.manual_seed(0)
    solver = pk.PseudoInverseIK(
        robot,
        pos_tolerance=POSITION,
        rot_tolerance=ROTATION,
        num_retries=RESTARTS,
        joint_limits=limits,
        max_iterations=STEPS,
        early_stopping_any_converged=True,
    )

    def run(poses: np.ndarray) -> np.ndarray:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = solver.solve(pk.Transform3d(matrix=torch.tensor(poses, dtype=torch.float32)))
        first = torch.argmax(found.converged.int(), dim=1)
        return found.solutions[torch.arange(len(poses)), first].detach().numpy()

    return run


def skrobot_solver(urdf: Path, steps: int) -> Solver:
    """scikit-robot's batch solver on JAX, in float64 as its authors have it: damped least squares, 30 steps unless told, from
    ten random starts a pose, the best one taken. Its damping of 0.01 lands 68 % of Panda's poses in 30 steps, this 95 %."""
    from skrobot.kinematics import create_batch_ik_solver
    from skrobot.models.urdf import RobotModelFromURDF

    peer, x64 = RobotModelFromURDF(urdf_file=str(urdf)), jax.config.jax_enable_x64
    tip = peer.__dict__[TIP]
    links = [link for link in peer.link_lists(tip) if link.joint in peer.joint_list]  # the fixed tip has no joint to turn
    solve = create_batch_ik_solver(peer, links, tip, backend_name="jax", method="jacobian")
    jax.config.update("jax_enable_x64", x64)  # which it sets for all
    options = {
        "max_iterations": steps,
        "damping": 1e-4,
        "attempts_per_pose": RESTARTS,
        "retry_seed": "random",
        "random_initial_range": 0.7,
        "pos_threshold": POSITION,
        "rot_threshold": ROTATION,
    }

    def run(poses: np.ndarray) -> np.ndarray:
        np.random.seed(0)  # where its starts come from
        with jax.enable_x64(True):
            return np.asarray(solve(poses[:, :3, 3], poses[:, :3, :3], **options)[0])

    return run


def _restarted(step: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, bool]], low: np.ndarray, high: np.ndarray) -> Solver:
    """A solver that takes one step at a time, followed from up to `RESTARTS` random starts."""

    def run(poses: np.ndarray) -> np.ndarray:
        rng, found = np.random.default_rng(1), []  # not the targets' own
        for pose in poses:
            done = False
            for _ in range(RESTARTS):
                q = rng.uniform(low, high)
                for _ in range(STEPS):
                    q, done = step(q, pose)
                    if done:
                        break
                if done:
                    break
            found.append(q)
        return np.array(found)

    return run


def mink_solver(urdf: Path) -> Solver:
    """mink: a frame task and the configuration limit, its differential inverse kinematics integrated over unit steps."""
    import mink
    import mujoco

    spec = mujoco.MjSpec.from_file(str(urdf))
    spec.compiler.fusestatic = False
    model = spec.compile()
    configuration = mink.Configuration(model)
    task = mink.FrameTask(TIP, "body", position_cost=1.0, orientation_cost=1.0, lm_damping=1e-6)
    limits = [mink.ConfigurationLimit(model)]

    def step(q: np.ndarray, pose: np.ndarray) -> tuple[np.ndarray, bool]:
        configuration.update(q)
        task.set_target(mink.SE3.from_matrix(pose))
        error = task.compute_error(configuration)
        if np.linalg.norm(error[:3]) <= POSITION and np.linalg.norm(error[3:]) <= ROTATION:
            return q, True
        velocity = mink.solve_ik(configuration, [task], 1.0, "daqp", damping=1e-6, limits=limits)
        return configuration.integrate(velocity, 1.0), False

    return _restarted(step, *model.jnt_range.T)


def pink_solver(urdf: Path) -> Solver:
    """pink: the same on Pinocchio."""
    import pink

    model = pin.buildModelFromUrdf(str(urdf))
    data = model.createData()
    task = pink.FrameTask(TIP, position_cost=1.0, orientation_cost=1.0, lm_damping=1e-6)

    def step(q: np.ndarray, pose: np.ndarray) -> tuple[np.ndarray, bool]:
        configuration = pink.Configuration(model, data, np.clip(q, model.lowerPositionLimit, model.upperPositionLimit))
        task.set_target(pin.SE3(pose[:3, :3], pose[:3, 3]))
        error = task.compute_error(configuration)
        if np.linalg.norm(error[:3]) <= POSITION and np.linalg.norm(error[3:]) <= ROTATION:
            return q, True
        velocity = pink.solve_ik(configuration, [task], 1.0, solver="daqp", damping=1e-6, safety_break=False)
        return configuration.integrate(velocity, 1.0), False

    return _restarted(step, model.lowerPositionLimit, model.upperPositionLimit)
