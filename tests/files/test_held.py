"""Joints beside the chain are held: where their links are, what they weigh, what they hit, and what is said of it."""

import shutil
import warnings
from xml.etree import ElementTree

import coal
import jax
import mujoco
import numpy as np
import pinocchio as pin
import pytest
from robot_files import refused, write
from robots import FOLDER

import jaxik
from jaxik.cli.arguments import read_posture
from jaxik.kinematics import link_frames

DEEP = 0.003  # [m] that a model may be off
SHAPE = '<collision><geometry><sphere radius="0.05"/></geometry></collision>'
INERTIA = '<inertia ixx="0.1" iyy="0.2" izz="0.15" ixy="0" ixz="0" iyz="0"/>'
MASS = f'<inertial><origin xyz="0.1 0 0.02"/><mass value="2"/>{INERTIA}</inertial>'
BODY = f"{SHAPE}{MASS}"


def joint(name, kind, parent, child, xyz, axis="0 0 1", more=""):
    ends = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="{xyz}" rpy="0.1 0.2 0.3"/>'
    return f'<link name="{child}">{BODY}</link><joint name="{name}" type="{kind}">{ends}<axis xyz="{axis}"/>{more}</joint>'


def limit(lower, upper):
    return f'<limit lower="{lower}" upper="{upper}" effort="1" velocity="1"/>'


MIMIC = '<mimic joint="thumb" multiplier="-2" offset="0.1"/>'
ARM = f"""<robot name="arm"><link name="base">{BODY}</link>
{joint("lift", "prismatic", "base", "trunk", "0 0 0.2", more=limit(0, 0.4))}
{joint("turn", "revolute", "trunk", "upper", "0.2 0 0.1", more=limit(-2, 2))}
{joint("bend", "revolute", "upper", "hand", "0.4 0 0", "0 1 0", limit(-2, 2))}
{joint("neck", "revolute", "trunk", "head", "0 0 0.5", "0 0.6 0.8", limit(-1, 1))}
{joint("eye", "fixed", "head", "camera", "0.1 0 0")}
{joint("thumb", "prismatic", "hand", "left", "0.1 0 0", "0 1 0", limit(0.01, 0.04))}
{joint("index", "prismatic", "hand", "right", "0.1 0 0", "0 1 0", limit(-1, 1) + MIMIC)}
{joint("nail", "revolute", "right", "claw", "0.1 0 0", "0 1 0", limit(-1, 1) + '<mimic joint="bend" offset="0.3"/>')}
</robot>"""
POSTURE = {"neck": -0.7, "thumb": 0.03}
VALUES = POSTURE | {"index": 0.04, "nail": 0.3}


@pytest.fixture
def arm(tmp_path):
    return write(tmp_path, "arm.urdf", ARM)


def state(model, robot, q, held):
    """A configuration of Pinocchio's whole robot."""
    full = pin.neutral(model)
    for name, value in {**dict(zip(robot.joint_names, q, strict=True)), **held}.items():
        full[model.joints[model.getJointId(name)].idx_q] = value
    return full


def test_links_stand_where_their_joints_are_held(arm):
    robot = jaxik.load(arm, tip="hand", posture=POSTURE)
    model = pin.buildModelFromUrdf(str(arm))
    data = model.createData()
    for q in np.random.default_rng(0).uniform(robot.lower, robot.upper, (5, 3)):
        pin.framesForwardKinematics(model, data, state(model, robot, q, VALUES))
        for name, frame in zip(robot.link_names, np.asarray(link_frames(robot, q)), strict=True):
            np.testing.assert_allclose(frame, data.oMf[model.getFrameId(name)].homogeneous, atol=1e-12)
    assert set(robot.link_names) == {"base", "trunk", "upper", "hand", "head", "camera", "left", "right", "claw"}


def test_what_is_held_has_its_mass(arm):
    """The bodies are those of the robot that Pinocchio makes of it with the same joints locked."""
    robot = jaxik.load(arm, tip="hand", posture=POSTURE)
    model = pin.buildModelFromUrdf(str(arm))
    full = state(model, robot, np.zeros(3), VALUES)
    less = pin.buildReducedModel(model, [model.getJointId(name) for name in VALUES], full)
    for body, truth in zip(robot.bodies, list(less.inertias)[1:], strict=True):
        np.testing.assert_allclose(body.mass, truth.mass, atol=1e-12)
        np.testing.assert_allclose(body.com, truth.lever, atol=1e-12)
        np.testing.assert_allclose(body.inertia, truth.inertia, atol=1e-12)


def test_what_is_held_is_said_once(arm):
    with pytest.warns(UserWarning) as said:
        robot = jaxik.load(arm, tip="hand")
    (line,) = (str(each.message) for each in said)
    for words in (
        "thumb at 0.01, index at 0.08, neck at 0, nail at 0.3 (driven by bend)",
        "posture={'thumb': ...}",
        "posture={}",
    ):
        assert words in line
    assert jaxik.load(arm, tip="hand", posture={}) == robot
    for posture in (None, {}, POSTURE):  # the report tells all of them, and what each carries
        told = {row.joint: row for row in jaxik.files.fit_report(arm, tip="hand", posture=posture).held}
        expected = VALUES if posture else {"neck": 0.0, "thumb": 0.01, "index": 0.08, "nail": 0.3}
        assert {name: pytest.approx(row.value) for name, row in told.items()} == expected
        assert {name: row.driven for name, row in told.items()} == dict.fromkeys(expected, "") | {"nail": "bend"}
        assert told["neck"].links == ("head", "camera") and told["index"].links == ("right", "claw")
    named = {frozenset((robot.link_names[a], robot.link_names[b])) for a, b in robot.self_pairs}
    assert frozenset(("upper", "head")) in named  # one joint apart, and no neighbours
    assert not {frozenset(("base", "trunk")), frozenset(("trunk", "head")), frozenset(("hand", "left"))} & named


def test_no_geometry_and_no_word(tmp_path):
    """Kinematics alone, whatever the meshes are called: nothing is held that counts."""
    mesh = '<collision><geometry><mesh filename="package:///away/../x.stl"/></geometry></collision>'
    robot = jaxik.load(write(tmp_path, "arm.urdf", ARM.replace(SHAPE, mesh)), tip="hand")
    assert len(robot.unread_meshes) == 9
    jaxik.load(write(tmp_path, "bare.urdf", ARM.replace(SHAPE, "")), tip="hand")


@pytest.mark.parametrize(
    "posture, words",
    [
        ({"nek": 0.1}, ("posture 'nek'", "no such joint beside the chain", "did you mean 'neck'")),
        ({"neck": 2.0}, ("posture 'neck'", "2 is outside", "-1 to 1")),
        ({"turn": 0.0}, ("posture 'turn'", "a joint of the chain")),
        ({"index": 0.0}, ("posture 'index'", "follows 'thumb'")),
    ],
)
def test_a_wrong_posture_is_one_line(arm, posture, words):
    refused(arm, *words, tip="hand", posture=posture)


def test_a_posture_is_names_and_numbers(arm):
    for posture in ([0.1], {"neck": "up"}, {"neck": np.nan}, {1: 0.0}):
        with pytest.raises(ValueError, match=r"^load: posture"):
            jaxik.load(arm, tip="hand", posture=posture)
    assert read_posture(["neck=0.1", "thumb=0.02"]) == {"neck": 0.1, "thumb": 0.02} and read_posture([]) is None
    with pytest.raises(ValueError, match=r"^--posture neck: write joint=value"):
        read_posture(["neck"])


def test_joints_that_a_robot_cannot_have_may_stand_beside_it(tmp_path):
    """Without limits, afloat, about a sloppy axis; but nothing that follows itself."""
    loose = joint("neck", "revolute", "trunk", "head", "0 0 0.5", "0 0 3")
    afloat = joint("neck", "floating", "trunk", "head", "0 0 0.5")
    usual = joint("neck", "revolute", "trunk", "head", "0 0 0.5", "0 0.6 0.8", limit(-1, 1))
    for other in (loose, afloat):
        assert "head" in jaxik.load(write(tmp_path, "arm.urdf", ARM.replace(usual, other)), tip="hand", posture={}).link_names
    itself = write(tmp_path, "arm.urdf", ARM.replace('mimic joint="thumb"', 'mimic joint="index"'))
    refused(itself, "joint 'index'", "mimics itself", tip="hand")


def test_joints_after_the_tip_of_a_table_are_held():
    whole, wrist = jaxik.load("p6r"), jaxik.load("p6r", tip="wrist_roll", posture={"theta6": 0.3})
    q = np.array([0.3, 0.2, -0.5, -0.4, 0.3])
    assert wrist.joint_names == whole.joint_names[:5] and wrist.link_names == whole.link_names
    np.testing.assert_allclose(link_frames(wrist, q), link_frames(whole, np.array([*q, 0.3, 0.0])), atol=1e-12)


def test_a_saved_robot_stands_still(arm, tmp_path):
    robot = jaxik.load(arm, tip="hand", posture=POSTURE)
    jaxik.save(robot, tmp_path / "arm.toml")
    assert jaxik.load(tmp_path / "arm.toml") == robot
    refused(tmp_path / "arm.toml", "posture 'neck'", "saved robot", posture=POSTURE)


def test_a_study_says_where_joints_are_held(arm):
    robot = {"file": str(arm), "tip": "hand", "posture": POSTURE}
    targets = {"kind": "grid", "x": [0, 1, 2], "y": [0, 1, 2], "z": [0, 1, 2]}
    (variant,) = jaxik.sweeps.Study.of({"robots": [robot], "targets": targets}).variants
    assert variant.robot == jaxik.load(arm, tip="hand", posture=POSTURE)


MJCF = """<mujoco><compiler angle="radian"/><default><geom size=".05"/></default><worldbody>
<body name="crate" pos="2 0 0"><freejoint/><geom/></body><body name="post" pos="1 1 0"><geom/></body>
<body name="target" mocap="true" pos="0 2 0"><geom/></body>
<body name="upper"><joint name="turn" axis="0 0 1" range="-2 2" limited="true"/><geom/>
<body name="hand" pos=".4 0 0"><joint name="bend" axis="0 1 0" range="-2 2" limited="true"/><geom/>
<body name="left" pos=".1 0 0"><joint name="thumb" type="slide" axis="0 1 0" range=".01 .04" limited="true"/><geom/></body>
<body name="right" pos=".1 0 .1"><joint name="index" type="slide" axis="0 1 0" ref=".02"/>
<joint name="roll" axis="0 0 1" pos=".1 0 0"/><geom/>
<body name="ball" pos=".1 0 0"><joint type="ball"/><geom/></body></body></body></body></worldbody>
<equality><joint joint1="index" joint2="thumb" polycoef=".01 -1 2 0 0"/></equality></mujoco>"""


def test_mjcf_is_held_as_mujoco_poses_it(tmp_path):
    path = write(tmp_path, "arm.xml", MJCF)
    robot = jaxik.load(path, tip="hand", posture={"thumb": 0.03, "roll": 0.5})
    model = mujoco.MjModel.from_xml_path(str(path))
    data, q = mujoco.MjData(model), np.array([0.4, -0.9])
    values = {"turn": 0.4, "bend": -0.9, "thumb": 0.03, "index": 0.02 + 0.01 - 0.03 + 2 * 0.03**2, "roll": 0.5}
    for name, value in values.items():
        data.joint(name).qpos[0] = value
    mujoco.mj_kinematics(model, data)
    frames = dict(zip(robot.link_names, np.asarray(link_frames(robot, q)), strict=True))
    for name in ("post", "upper", "hand", "left", "right", "ball"):
        np.testing.assert_allclose(frames[name][:3, 3], data.body(name).xpos, atol=1e-12)
        np.testing.assert_allclose(frames[name][:3, :3].ravel(), data.body(name).xmat, atol=1e-12)
    assert "crate" not in frames and "target" not in frames
    with pytest.warns(UserWarning, match=r"thumb at 0\.01, index at 0\.0202, roll at 0, joint6 \(ball\) where it stands;"):
        jaxik.load(path, tip="hand")
    told = {row.joint: row for row in jaxik.files.fit_report(path, tip="hand", posture={"thumb": 0.03, "roll": 0.5}).held}
    assert [*told] == ["thumb", "index", "roll", "joint6"] and told["roll"].links == ("right", "ball")
    at = [told[name].value for name in ("thumb", "index", "roll")]
    np.testing.assert_allclose(at, [values[name] for name in ("thumb", "index", "roll")], atol=1e-12)
    assert np.isnan(told["joint6"].value) and told["joint6"].links == ("ball",)


# --------------------------------------------------------------------------------------------------------------------
# Coal's distances of the hulls, where Pinocchio puts them


def cut(folder, file, solid):
    """A robot's file, its meshes beside it, with the collision geometry of the `solid` links alone."""
    tree = ElementTree.parse(FOLDER / file)
    for link in tree.getroot().iter("link"):
        for kind in ("visual", "collision"):
            for part in link.findall(kind):
                if kind == "visual" or link.get("name") not in solid:
                    link.remove(part)
        for mesh in link.iter("mesh"):
            name = mesh.get("filename").rpartition("robots/")[2].removeprefix("package://")
            mesh.set("filename", name.rpartition("/")[2])
            shutil.copy(FOLDER / name, folder / name.rpartition("/")[2])
    tree.write(folder / "robot.urdf")
    return folder / "robot.urdf"


def hulls(path, robot, q, held):
    """The signed distance of the hulls of every two solid links, at each configuration [m]."""
    model = pin.buildModelFromUrdf(str(path))
    shapes = pin.buildGeomFromUrdf(model, str(path), pin.COLLISION, package_dirs=[str(path.parent)])
    for shape in shapes.geometryObjects:
        if not isinstance(shape.geometry, coal.BVHModelBase):
            continue
        shape.geometry.buildConvexHull(True, "Qt")
        shape.geometry = shape.geometry.convex
    shapes.addAllCollisionPairs()
    data, found = model.createData(), pin.GeometryData(shapes)
    name = lambda i: model.frames[shapes.geometryObjects[i].parentFrame].name
    pairs = [frozenset((name(pair.first), name(pair.second))) for pair in shapes.collisionPairs]
    rows = []
    for each in q:
        pin.computeDistances(model, data, shapes, found, state(model, robot, each, held))
        rows.append([result.min_distance for result in found.distanceResults])
    return pairs, np.array(rows)


PANDA = [f"panda_{name}" for name in ("link0", "link1", "link2", "link3", "leftfinger", "rightfinger")]
TIAGO = ["head_1_link", "head_2_link", "arm_3_link", "arm_4_link", "arm_5_link"]
HELD = {"panda_leftfinger", "panda_rightfinger", "head_1_link", "head_2_link"}
CASES = {
    "Panda's fingers": ("panda_description/urdf/panda.urdf", "panda_hand_tcp", PANDA, {"panda_finger_joint1": 0.04}),
    "TIAGo's head": ("tiago_description/robots/tiago.urdf", "hand_tool_link", TIAGO, {"head_1_joint": 0.4}),
}


@pytest.mark.parametrize("name", CASES)
def test_what_is_held_is_hit(tmp_path, name):
    """No configuration is called clear by more than 3 mm in which coal finds hulls that overlap by more, and none of the pairs
    of what is held is left out that does so."""
    file, tip, solid, posture = CASES[name]
    path = cut(tmp_path, file, solid)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # pairs that touch in the default pose: they are left out below, too
        robot = jaxik.load(path, tip=tip, meshes=True, fit=jaxik.FitOptions(accuracy=0.03, most=4), posture=posture)
    q = np.random.default_rng(3).uniform(*robot.finite_limits, (1500, robot.num_joints))
    joint = dict(zip(robot.link_names, robot.link_joint, strict=True))
    home = np.where((robot.lower <= 0.0) & (robot.upper >= 0.0), 0.0, (robot.lower + robot.upper) / 2.0)
    follow = {"panda_finger_joint2": 0.04} if "panda_hand" in joint else {}
    pairs, gaps = hulls(path, robot, np.vstack([home, q]), posture | follow)
    fixed = lambda pair: len({joint[link] for link in pair}) == 1
    beside = lambda pair: max(joint[link] for link in pair) - min(joint[link] for link in pair) == 1 and not pair & HELD
    judged = [i for i, pair in enumerate(pairs) if not fixed(pair) and not beside(pair) and gaps[0, i] > 0.0]
    truth = gaps[1:, judged].min(axis=1)
    told = np.asarray(jax.jit(jax.vmap(lambda q: jaxik.clearance(robot, None, q)))(q))
    held = gaps[1:, [i for i in judged if pairs[i] & HELD]].min(axis=1)
    assert np.sum(held < -DEEP) > 5  # the joints held do matter
    assert not np.any((told > DEEP) & (truth < -DEEP))
