"""The search of inverse kinematics in machine code, beside Pinocchio and the same search as a kernel, to the last bit."""

import re
import shutil
import subprocess

import jax
import numpy as np
import pytest
from exported_calls import called, one_by_one
from robots import pinocchio

import jaxik
from jaxik import Reason
from jaxik.codegen.functions import function_of
from jaxik.codegen.robot_functions import ARGUMENTS, FUNCTIONS
from jaxik.ik import ik_search
from jaxik.spmd import HostKernel

pytestmark = pytest.mark.kernels(reason="machine code is made by llvmlite")
ROWS = 1000
BALLS = [[0.4, 0.2, 0.5, 0.1], [-0.3, 0.3, 0.4, 0.15], [0.5, -0.4, 0.2, 0.1]]


@pytest.fixture(scope="module")
def panda():
    return jaxik.load("panda", ignore=[("panda_link5", "panda_link7")])


@pytest.fixture(scope="module")
def goals(panda):
    """Postures and their poses, by Pinocchio."""
    q = np.random.default_rng(5).uniform(*panda.finite_limits, (ROWS, panda.num_joints))
    pose = pinocchio(panda)
    return q, np.stack([pose(row) for row in q])


def exported(robot, name, scene=None):
    wanted = FUNCTIONS[name]
    wanted.check(robot)
    with jax.enable_x64(True):
        made = wanted.make(robot, scene)
    shapes = [jax.ShapeDtypeStruct(ARGUMENTS[each].shape(robot), np.float64) for each in wanted.arguments]
    return function_of(made, shapes, name=f"arm_{name}", double=True, results=list(wanted.results))


def assert_like_the_kernel(made, find, *arrays):
    """The batch and rows alone are the kernel's, to the last bit; returned by name."""
    wanted = HostKernel(find, len(arrays)).run(*arrays, double=True)
    for found in (called(made, *arrays, rows=len(arrays[0])), one_by_one(made, *arrays)):
        for field, x, y in zip(made.results, found, wanted, strict=True):
            np.testing.assert_array_equal(x, y, err_msg=field.name)
    return dict(zip((f.name for f in made.results), wanted, strict=True))


def assert_there(robot, found, targets):
    """Answers have the poses, by Pinocchio, and are within the limits."""
    solved, pose = found["reason"] == Reason.SOLVED, pinocchio(robot)
    for q, target in zip(found["q"][solved], targets[solved], strict=True):
        np.testing.assert_allclose(pose(q), target, atol=1e-4)
    q = found["q"][solved]
    assert (q >= robot.lower - 1e-12).all() and (q <= robot.upper + 1e-12).all()
    return solved.mean()


def test_ik_is_the_kernels_and_small(panda, goals, tmp_path):
    made = exported(panda, "ik")
    found = assert_like_the_kernel(made, ik_search(panda), goals[1])
    assert assert_there(panda, found, goals[1]) > 0.95
    assert len(made.image) < 300_000
    assert not made.calls and not made.workspace
    _, reason, *_, seed = called(made, np.full((4, 4), np.nan))
    assert reason == Reason.INVALID and seed == -1
    away = np.eye(4) + 3.0 * np.eye(4, k=3)
    assert called(made, away)[1] == Reason.OUT_OF_REACH
    if shutil.which("nm"):
        (tmp_path / "ik.o").write_bytes(made.image)
        told = subprocess.run(["nm", str(tmp_path / "ik.o")], capture_output=True, text=True, check=True).stdout
        assert not re.findall(r"^ +U ", told, re.M)  # no malloc, nothing


def test_ik_near_a_posture_is_the_kernels(panda, goals):
    q, targets = goals
    near = np.clip(q + np.random.default_rng(6).normal(scale=0.02, size=q.shape), panda.lower, panda.upper)
    found = assert_like_the_kernel(exported(panda, "ik_near"), ik_search(panda, seeds="near"), targets, near)
    assert assert_there(panda, found, targets) > 0.9
    assert np.median(np.abs(found["q"] - near).max(axis=1)) < 0.1  # it stays where it was


def test_ik_in_a_scene(panda, goals):
    scene = jaxik.make_scene(spheres=BALLS)
    made = exported(panda, "ik_near", scene)
    found = assert_like_the_kernel(made, ik_search(panda, scene=scene, seeds="near"), goals[1][:200], goals[0][:200])
    solved = found["reason"] == Reason.SOLVED
    with jax.enable_x64(True):
        clear = jax.jit(jax.vmap(lambda q: jaxik.clearance(panda, scene, q)))(found["q"])
    assert solved.mean() > 0.5 and (np.asarray(clear)[solved] >= -1e-12).all()
    blocked = found["reason"] == Reason.COLLISION
    assert blocked.any() and (np.asarray(clear)[blocked] < 0.0).all() and (found["position_error"][blocked] < 1e-6).all()


def test_a_robot_of_several_tips_is_refused():
    with pytest.raises(ValueError, match="export: p6r_pair has a list of tips"):
        exported(jaxik.load("p6r_pair"), "ik")
