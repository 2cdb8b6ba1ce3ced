"""The shipped arms against their makers' figures, and against Pinocchio and coal on descriptions that nobody here wrote."""

import jax
import jax.numpy as jnp
import numpy as np
import pinocchio as pin
import pytest
from robots import FOLDER

import jaxik
from jaxik.collision.self_collision_pairs import self_collisions

UR, PANDA = "ur_description/urdf/{}_robot.urdf", "panda_description/urdf/panda.urdf"
DESCRIBED = {  # the file, the frames of its base and of its tip
    "ur3": (UR.format("ur3"), "base", "tool0"),
    "ur5": (UR.format("ur5"), "base", "tool0"),
    "ur10": (UR.format("ur10"), "base", "tool0"),
    "panda": (PANDA, "panda_link0", "panda_link8"),
    "fr3": (PANDA, "panda_link0", "panda_link8"),  # the same lengths, other limits
}
DRAWN = {  # joints [deg], the tip [mm], where the maker prints it
    "iiwa7": ([0, 0, 0, 0, 0, 0, 0], (0, 0, 1266), "figure 4-1"),
    "iiwa14": ([0, 0, 0, 0, 0, 0, 0], (0, 0, 1306), "figure 4-4"),
    "kr6_r900": ([0, -90, 90, 0, 0, 0], (25 + 420 + 80, 0, 400 + 455 + 35), "working envelope, upright"),
    "irb120": ([0, 0, 0, 0, 0, 0], (302 + 72, 0, 290 + 270 + 70), "dimensions, the calibration pose"),
    "gen3": ([0, 0, 0, 0, 0, 0, 0], (0, -11.8 - 12.8, 284.8 + 420.8 + 314.3 + 167.4), "table 94 and its figure, upright"),
}
WRIST_REACH = {  # from the second axis to the wrist's centre, or from the first: [mm], by data sheets
    "iiwa7": (1, 800),
    "iiwa14": (1, 820),
    "irb120": (1, 580),
    "kr6_r900": (0, 901.5),
}
ARMS = sorted({*DESCRIBED, *DRAWN, "ur3e", "ur5e", "ur10e", "ur16e", "ur20"})


def described(name):
    """Pinocchio's model of a robot's file, and a configuration of it with some of its joints set."""
    file, base, tip = DESCRIBED[name]
    model = pin.buildModelFromUrdf(str(FOLDER / file))

    def full(q):
        return np.concatenate([q, pin.neutral(model)[len(q) :]])

    return model, full, base, tip


@pytest.mark.parametrize("name", DESCRIBED)
def test_tips_are_where_pinocchio_has_them(name):
    robot, (model, full, base, tip) = jaxik.load(name), described(name)
    data = model.createData()
    with jax.enable_x64(True):
        forward = jax.jit(lambda q: jaxik.forward_kinematics(robot, q))
        for q in np.random.default_rng(0).uniform(-2.8, 2.8, (20, robot.num_joints)):
            pin.framesForwardKinematics(model, data, full(q))
            there = data.oMf[model.getFrameId(base)].actInv(data.oMf[model.getFrameId(tip)]).homogeneous
            assert np.allclose(forward(q), there, atol=1e-9)


@pytest.mark.parametrize("name", DRAWN)
def test_tips_are_where_the_maker_draws_them(name):
    degrees, tip, _ = DRAWN[name]
    pose = jaxik.forward_kinematics(jaxik.load(name), np.radians(np.array(degrees, float)))
    assert np.allclose(1e3 * pose[:3, 3], tip, atol=1e-3)


@pytest.mark.parametrize("name", WRIST_REACH)
def test_reach_is_the_data_sheets(name):
    """The wrist's centre is the origin of the last joint but one; stretched, it is as far away as the lengths allow."""
    robot, (axis, reach) = jaxik.load(name), WRIST_REACH[name]
    lengths = np.linalg.norm(robot.parent_T_joint[:, :3, 3], axis=1)
    elbow = {"kr6_r900": np.hypot(420, 35), "irb120": np.hypot(302, 70)}.get(name)
    upper = 1e3 * lengths[axis + 1 : 3 if elbow else -1].sum()
    assert abs(upper + (elbow or 0.0) - reach) <= 0.05


def test_the_panda_is_longest_where_its_maker_says():
    """The elbow, offset on both sides, is straight at the angle that Franka prints as q_elbow-flip."""
    robot = jaxik.load("panda", tip="panda_link6", posture={})
    with jax.enable_x64(True):
        poses = jax.vmap(lambda elbow: jaxik.forward_kinematics(robot, jnp.zeros(6).at[3].set(elbow)))
        short, most, too = np.linalg.norm(
            poses(-0.467002423653011 + jnp.array([1e-4, 0.0, -1e-4]))[:, :3, 3] - np.array([0.0, 0.0, 0.333]), axis=1
        )
    assert most > max(short, too) and abs(short - too) <= 1e-14


@pytest.mark.parametrize("name", ARMS)
def test_arms_stand_clear_and_can_move(name):
    """Each joint has a speed, the default pose is free (the Panda's folds its flange against its forearm: coal says so, too),
    and most random postures are."""
    robot = jaxik.load(name)
    assert np.all(np.isfinite(robot.velocity)) and np.all(robot.lower < robot.upper) and robot.self_pairs
    found = self_collisions(robot)
    assert (not found.at_home or name == "panda") and found.share <= 0.4


@pytest.mark.parametrize("name", ["ur5", "panda"])
def test_postures_collide_where_meshes_do(name):
    """The capsules are stand-ins: against coal on the meshes few postures are refused wrongly, and hardly one is let pass."""
    robot, (model, full, *_) = jaxik.load(name), described(name)
    meshes = pin.buildGeomFromUrdf(
        model, str(FOLDER / DESCRIBED[name][0]), pin.GeometryType.COLLISION, package_dirs=[str(FOLDER.parents[1])]
    )
    arm = [g for g in meshes.geometryObjects if not any(word in g.name for word in ("hand", "finger", "ee_link"))]
    for one in arm:
        for other in arm:
            if other.parentJoint - one.parentJoint >= 2:
                meshes.addCollisionPair(pin.CollisionPair(meshes.getGeometryId(one.name), meshes.getGeometryId(other.name)))
    data, seen = model.createData(), meshes.createData()
    q = np.random.default_rng(1).uniform(*robot.finite_limits, (300, robot.num_joints))
    truth = np.array([pin.computeCollisions(model, data, meshes, seen, full(row), True) for row in q])
    told = np.asarray(jax.jit(jax.vmap(lambda q: jaxik.clearance(robot, None, q)))(q)) <= 0.0
    assert np.mean(told & ~truth) <= 0.08 and np.mean(truth & ~told) <= 0.03 and truth.any()
