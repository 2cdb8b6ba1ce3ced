"""Forces and motion of real robots against Pinocchio and MuJoCo; identities, energies, loads, what is refused."""

import dataclasses
import pickle

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from peers.rigid_truth import changed, deviations, of_robot, of_urdf, states
from robot_files import refused, write
from robots import FOLDER, ROBOTS

import jaxik
from jaxik import dynamics, kinematics

DERIVATIVES = ("derivatives of inverse_dynamics", "derivatives of forward_dynamics")
FORCES = ("inverse_dynamics", "mass_matrix", "forward_dynamics", "bias_torque", "regressor")
ENERGIES = ("gravity_torque", "kinetic_energy", "potential_energy")
# continuous joints, a slide, and the thesis' robot; `changed` gives them rotors, and a base that leans
JUDGED = {"kinova": FORCES + ENERGIES, "tiago": FORCES, "crops_v2": FORCES[:3], "ur5": DERIVATIVES}


def _loaded(name):
    if name not in ROBOTS:
        return changed(jaxik.load(name)), None
    file, tip = ROBOTS[name]
    return changed(jaxik.load(FOLDER / file, tip=tip, posture={})), FOLDER / file


ARM = _loaded("ur5")[0]


@pytest.mark.usefixtures("only_kernels")
@pytest.mark.parametrize("name", JUDGED)
def test_against_pinocchio(name):
    robot, file = _loaded(name)
    found = deviations(robot, of_robot(robot) if file is None else of_urdf(file, robot), JUDGED[name])
    assert found.keys() == set(JUDGED[name]) and max(found.values()) <= 1e-10, found


MJCF = """<mujoco><compiler angle="radian"/>
<option><flag constraint="disable"/></option><worldbody><body name="post" pos="0 0 0.5" euler="0.3 0.2 0">
<joint name="lift" type="slide" axis="0 0.6 0.8" range="0 1" armature="1.5"/><geom type="box" size="0.1 0.2 0.3" mass="4"/>
<body name="arm" pos="0.2 0 0.1" euler="0 1.2 0"><joint name="swing" axis="0 1 0" range="-2 2" armature="0.2" pos="0.05 0 0"/>
<geom type="capsule" fromto="0 0 0 0.4 0.1 0" size="0.04" mass="2.5"/><body name="hand" pos="0.4 0.1 0">
<joint name="twist" axis="1 0 0"/><geom type="ellipsoid" pos="0.1 0.05 0" size="0.1 0.05 0.03" mass="0.7"/>
</body></body></body></worldbody></mujoco>"""


def test_against_mujoco(tmp_path):
    """Rotors are read with the rest."""
    robot, model = jaxik.load(write(tmp_path, "arm.xml", MJCF)), mujoco.MjModel.from_xml_string(MJCF)
    assert robot.armature.tolist() == [1.5, 0.2, 0.0]
    data, mass = mujoco.MjData(model), np.zeros((3, 3))
    inverse = jax.vmap(lambda *given: dynamics.inverse_dynamics(robot, *given))
    q, v, a, _, _ = given = states(dataclasses.replace(robot, upper=np.array([1.0, 2.0, 3.0]), lower=-np.ones(3)), 10)
    torques, matrices = inverse(*given[:3]), jax.vmap(lambda q: dynamics.mass_matrix(robot, q))(q)
    for i in range(10):
        data.qpos, data.qvel, data.qacc = q[i], v[i], a[i]
        mujoco.mj_inverse(model, data)
        mujoco.mj_fullM(model, data, mass)
        assert np.abs(torques[i] - data.qfrc_inverse).max() <= 1e-10 * np.abs(data.qfrc_inverse).max()
        assert np.abs(matrices[i] - mass).max() <= 1e-10 * np.abs(mass).max()


ROTORS = """<robot name="rotors"><link name="base"/><link name="rotor"><inertial><origin xyz="0 0.1 0" rpy="0.3 0 0"/>
<mass value="0"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1.5"/></inertial></link>
<link name="arm"><inertial><origin xyz="0.3 0 0"/>
<mass value="1"/><inertia ixx=".5" ixy="0" ixz="0" iyy=".5" iyz="0" izz=".5"/></inertial></link>
<link name="wheel"><inertial><mass value="0"/><inertia ixx=".3" ixy="0" ixz="0" iyy=".3" iyz="0" izz=".4"/></inertial></link>
<joint name="turn" type="continuous"><parent link="base"/><child link="rotor"/><axis xyz="0 0 1"/></joint>
<joint name="bend" type="continuous"><parent link="rotor"/><child link="arm"/><origin xyz="0.4 0 0"/><axis xyz="0 1 0"/></joint>
<joint name="weld" type="fixed"><parent link="arm"/><child link="wheel"/><origin xyz="0 0.2 0" rpy="1 0 0"/></joint></robot>"""


def test_an_inertia_without_a_mass_counts(tmp_path):
    """Rotors that a file writes so: of a link that moves alone, and of one that is welded to another."""
    path = write(tmp_path, "rotors.urdf", ROTORS)
    robot = jaxik.load(path)
    assert max(deviations(robot, of_urdf(path, robot), FORCES[:3]).values()) <= 1e-12
    massless = write(tmp_path, "none.urdf", ROTORS.replace('mass value="1"', 'mass value="0"'))
    assert [float(body.mass) for body in jaxik.load(massless).bodies] == [0.0, 0.0]


def test_forward_undoes_inverse():
    q, v, a, _, w = states(ARM, 500, seed=1)
    inverse = jax.vmap(lambda *x: dynamics.inverse_dynamics(ARM, *x[:3], wrenches=x[3]))
    torque = inverse(q, v, a, w)
    back = jax.vmap(lambda *x: dynamics.forward_dynamics(ARM, *x[:3], wrenches=x[3]))(q, v, torque, w)
    assert np.abs(back - a).max() <= 1e-11
    matrices = np.asarray(jax.vmap(lambda q: dynamics.mass_matrix(ARM, q))(q))
    assert np.array_equal(matrices, matrices.swapaxes(1, 2)) and np.linalg.eigvalsh(matrices).min() > 0.0
    single = inverse(*(x.astype(np.float32) for x in (q, v, a, w)))
    assert single.dtype == jnp.float32 and np.abs(single - torque).max() <= 2e-5 * np.abs(torque).max()


def test_energy_of_a_roll_out():
    """The drives' work is the robot's gain of energy, by Runge and Kutta's fourth-order steps."""
    push = lambda t: jnp.sin(3.0 * t + jnp.arange(6.0)) * 5.0

    def slope(state, t):
        q, v, _ = state
        return v, dynamics.forward_dynamics(ARM, q, v, push(t)), v @ push(t)

    def step(state, t, dt=1e-3):
        on = lambda k, h: jax.tree_util.tree_map(lambda x, y: x + h * y, state, k)
        one = slope(state, t)
        two = slope(on(one, dt / 2), t + dt / 2)
        three = slope(on(two, dt / 2), t + dt / 2)
        four = slope(on(three, dt), t + dt)
        mean = jax.tree_util.tree_map(lambda a, b, c, d: (a + 2 * b + 2 * c + d) / 6, one, two, three, four)
        return on(mean, dt), None

    energy = lambda q, v: sum(dynamics.energy(ARM, q, v))
    start = jnp.array([0.3, -1.0, 0.8, 0.2, 0.5, 0.0]), jnp.zeros(6)
    (q, v, work), _ = jax.jit(lambda s: jax.lax.scan(step, s, jnp.arange(500) * 1e-3))((*start, jnp.zeros(())))
    assert abs(float(work)) > 0.5 and abs(float(energy(q, v) - energy(*start) - work)) <= 1e-9 * abs(float(work))


def test_energies_give_the_torques():
    (q, *_), (v, *_) = states(ARM, 1)[:2]
    slope = jax.grad(lambda q: dynamics.energy(ARM, q, v).potential)(q)
    momentum = jax.grad(lambda v: dynamics.energy(ARM, q, v).kinetic)(v)
    assert np.abs(slope - dynamics.gravity_torque(ARM, q)).max() <= 1e-12 * np.abs(slope).max()
    assert np.abs(momentum - dynamics.mass_matrix(ARM, q) @ v).max() <= 1e-12 * np.abs(momentum).max()


def test_parameters_of_bodies():
    robot = jaxik.load("crops_v2").part(0, 3)
    given = [x[0] for x in states(robot, 1)[:3]]
    parameters = robot.parameters
    back = robot.with_parameters(parameters)
    assert np.abs(back.parameters - parameters).max() <= 1e-13
    for ours, theirs in zip(back.bodies, robot.bodies, strict=True):
        assert np.allclose(ours.inertia, theirs.inertia, atol=1e-13) and np.allclose(ours.com, theirs.com, atol=1e-14)
    bare = dataclasses.replace(robot, bodies=())
    matrix = dynamics.regressor(bare, *given)
    by_parameters = lambda p: dynamics.inverse_dynamics(bare.with_parameters(p), *given)
    slopes = jax.jacfwd(by_parameters)(jnp.asarray(parameters))
    assert np.abs(matrix @ parameters + robot.armature * given[2] - dynamics.inverse_dynamics(robot, *given)).max() <= 1e-10
    assert np.abs(slopes - matrix).max() <= 1e-10 * np.abs(matrix).max()


def test_a_load_is_a_wrench():
    """A load at rest pulls as a force at its centre of gravity does; and a mass away from it is an inertia, too."""
    q, tip = states(ARM, 1)[0][0], np.array([0.1, -0.05, 0.2])
    point = (kinematics.forward_kinematics(ARM, q) @ jnp.array([*tip, 1.0]))[:3]
    weight = ARM.world_T_base[:3, :3].T @ [0.0, 0.0, -9.81 * 3.0]
    pull = dynamics.wrench_on(ARM, q, "tool0", weight, point)
    heavy = dynamics.gravity_torque(ARM.with_load(3.0, com=tip), q)
    assert np.abs(heavy - dynamics.inverse_dynamics(ARM, q, 0 * q, 0 * q, wrenches=pull)).max() <= 1e-12 * np.abs(heavy).max()
    assert not np.any(dynamics.wrench_on(ARM, q, "base_link", weight, point))
    slope = jax.jvp(lambda mass: dynamics.gravity_torque(ARM.with_load(mass, com=tip), q), (3.0,), (1.0,))[1]
    assert np.abs(3.0 * slope - heavy + dynamics.gravity_torque(ARM, q)).max() <= 1e-12 * np.abs(heavy).max()
    apart = 2.0 * (tip @ tip * np.eye(3) - np.outer(tip, tip))
    two, one = ARM.with_load(1.0, com=tip).with_load(1.0, com=-tip), ARM.with_load(2.0, inertia=apart)
    assert np.allclose(dynamics.mass_matrix(two, q), dynamics.mass_matrix(one, q), atol=1e-12)


def test_rotors_stay_with_their_joints(tmp_path):
    robot = dataclasses.replace(ARM, name="with rotors")
    assert robot != dataclasses.replace(robot, armature=np.zeros(6))
    fields = {name: getattr(robot, name) for name in robot.__dataclass_fields__ if name != "armature"}
    assert not np.any(jaxik.Robot(**fields).armature) and jaxik.Robot(**fields).armature.shape == (6,)
    assert pickle.loads(pickle.dumps(robot)) == robot
    assert np.array_equal(robot.part(2, 5).armature, robot.armature[2:5])
    jaxik.files.save(robot, tmp_path / "arm.toml")
    assert jaxik.load(tmp_path / "arm.toml") == robot
    rows = """name = "a"\nconvention = "modified_dh"\n[[joint]]\nname = "j"\ntype = "revolute"\nlower = 0\nupper = 1\n"""
    assert jaxik.load(write(tmp_path, "row.toml", rows + "armature_gm2 = 250")).armature.tolist() == [0.25]
    refused(write(tmp_path, "bad.toml", rows + "armature = -1"), "joint 'j'", "'armature' is out of range")


def _with_last(**changes):
    """The arm, its last body another."""
    return dataclasses.replace(ARM, bodies=(*ARM.bodies[:-1], dataclasses.replace(ARM.bodies[-1], **changes)))


REFUSED = {
    "has no bodies; write mass": lambda q: dynamics.mass_matrix(jaxik.load("p6r"), np.zeros(7)),
    "mass of -1 kg": lambda q: dynamics.inverse_dynamics(_with_last(mass=np.array(-1.0)), q, q, q),
    "'wrist_3_joint' of ur5 moves has no mass, nor": lambda q: dynamics.forward_dynamics(
        dataclasses.replace(_with_last(mass=np.zeros(()), inertia=np.zeros((3, 3))), armature=np.zeros(6)), q, q, q
    ),
    "the armature of joint 'elbow_joint' is -1; allowed": lambda q: dynamics.mass_matrix(
        dataclasses.replace(ARM, armature=np.array([0, 0, -1.0, 0, 0, 0])), q
    ),
    "holds NaN": lambda q: dynamics.bias_torque(_with_last(com=np.array([0.0, np.nan, 0.0])), q, q),
    "not symmetric": lambda q: dynamics.energy(_with_last(inertia=np.tri(3)), q, q),
    "principal moments of -1, 1, 1 kg m2; allowed: none below 0": lambda q: dynamics.energy(
        _with_last(inertia=np.diag([1.0, -1.0, 1.0])), q, q
    ),
    "principal moments of 1, 1, 3 kg m2; the largest": lambda q: dynamics.mass_matrix(
        _with_last(inertia=np.diag([1, 3, 1.0])), q
    ),
    "gravity has the shape (); allowed: (3,)": lambda q: dynamics.gravity_torque(ARM, q, gravity=-9.81),
    "p6r has no bodies; write mass, com": lambda q: jaxik.load("p6r").parameters,
    "wrench_on: no link 'hook'; allowed: world": lambda q: dynamics.wrench_on(ARM, q, "hook", q[:3], q[:3]),
    "parameters has the shape (6,); allowed: (60,)": lambda q: ARM.with_parameters(q),
    "p6r has no bodies, which a load": lambda q: jaxik.load("p6r").with_load(1.0),
    "the load has a mass of -2 kg; write a mass >= 0": lambda q: ARM.with_load(-2.0),
    "com has the shape (2,); allowed: (3,)": lambda q: ARM.with_load(2.0, com=(0.1, 0.2)),
    "5 bodies; ur5 has 6 joints, write one": lambda q: dynamics.mass_matrix(dataclasses.replace(ARM, bodies=ARM.bodies[1:]), q),
    "armature has the shape (2,); allowed: (6,)": lambda q: dynamics.mass_matrix(
        dataclasses.replace(ARM, armature=np.zeros(2)), q
    ),
    "inertia has the shape (6,); allowed: (3, 3)": lambda q: dynamics.Body(np.ones(()), np.zeros(3), np.zeros(6)),
    "'shoulder_pan_joint' moves a mass of 0 kg with": lambda q: ARM.with_parameters(np.eye(60)[1]),
    "joint 'wrist_3_joint' of ur5 turns nothing; give its bodies an inertia": lambda q: dynamics.forward_dynamics(
        dataclasses.replace(_with_last(com=np.zeros(3), inertia=np.zeros((3, 3))), armature=np.zeros(6)), q, q, q
    ),
}


@pytest.mark.usefixtures("untyped")
@pytest.mark.parametrize("words", REFUSED)
def test_refused(words):
    with pytest.raises(ValueError) as error:
        REFUSED[words](np.zeros(6))
    assert "\n" not in str(error.value) and words in str(error.value)


def test_no_joints():
    none = np.zeros(0)
    assert dynamics.regressor(ARM.part(0, 0), none, none, none).shape == (0, 0)


def test_massless_links_and_point_masses():
    """Joints in between may move nothing, as those of a human's model; the sums are as they should be."""
    first, last = ARM.bodies[0], dataclasses.replace(ARM.bodies[-1], inertia=np.zeros((3, 3)))
    none = dataclasses.replace(first, mass=np.zeros(()), inertia=np.zeros((3, 3)))
    sparse = dataclasses.replace(ARM, bodies=(none, *ARM.bodies[1:-1], last))
    assert max(deviations(sparse, of_robot(sparse), FORCES[:1]).values()) <= 1e-10
