"""Robots with several tips, mimic joints and bases that move, from every kind of file; and what is refused in one line."""

import dataclasses
import itertools

import jax
import mujoco
import numpy as np
import pinocchio as pin
import pytest
from peers.tree_truth import TreeTruth, tree_tips
from robot_files import HANDS, PARTS, TWO, URDF, joint, link, refused, write
from robots import FOLDER

import jaxik
from jaxik import dynamics, kinematics
from jaxik.files.tree_ways import AskedTips


@pytest.fixture
def two(tmp_path):
    return write(tmp_path, "two.urdf", TWO)


def near(a, b, tolerance=1e-12):
    np.testing.assert_allclose(a, b, rtol=0, atol=tolerance)


def test_joints_come_in_the_order_of_tips(two):
    robot = jaxik.load(two, tip=HANDS, held={})
    assert robot.joint_names == ("turn", "left_shoulder", "left_wrist", "right_shoulder", "right_wrist")
    assert robot.tip_names == ("left_hand", "right_hand") and not robot.mimics
    other = jaxik.load(two, tip=HANDS[::-1], held={})
    assert other.joint_names == ("turn", "right_shoulder", "right_wrist", "left_shoulder", "left_wrist")
    truth = TreeTruth(two, robot.joint_names)
    q = np.array([0.3, -0.4, 0.5, 0.6, -0.7])
    poses = kinematics.forward_kinematics(robot, q)
    near(poses, [truth.pose(q, name) for name in HANDS])
    near(kinematics.forward_kinematics(other, q[[0, 3, 4, 1, 2]]), poses[::-1])
    near(kinematics.forward_kinematics(robot.with_tips("left_hand"), q), poses[0])
    one = jaxik.load(two, tip="left_hand", held={})  # and a branch alone is a serial arm
    assert one.joint_names == robot.joint_names[:3] and not one.parents
    near(kinematics.forward_kinematics(one, q[:3]), poses[0])
    alone = kinematics.forward_kinematics(jaxik.load(two, tip=["left_hand"], held={}), q[:3])
    near(alone, poses[:1])


def test_mimic_joints_follow(two):
    tips = [*HANDS, "thumb"]
    robot = jaxik.load(two, tip=tips, held={})
    assert robot.num_joints == 6 and [(m.name, robot.joint_names[m.joint]) for m in robot.mimics] == [
        ("grip", "flex"),
        ("curl", "flex"),
    ]
    assert [(float(m.factor), float(m.offset)) for m in robot.mimics] == [(-0.5, 0.0), (-1.5, 0.1)]
    truth = TreeTruth(two, robot.joint_names)
    rng = np.random.default_rng(0)
    q, v, a = rng.normal(size=(3, 6))
    for name, frame in zip(robot.link_names, kinematics.link_frames(robot, q), strict=True):
        near(frame, truth.pose(q, name))
    near(kinematics.jacobian(robot.with_tips("nail"), q), truth.jacobian(q, "nail"))
    near(dynamics.inverse_dynamics(robot, q, v, a), truth.inverse_dynamics(q, v, a), 1e-11)
    near(dynamics.mass_matrix(robot, q), truth.mass_matrix(q))
    near(dynamics.forward_dynamics(robot, q, v, a), truth.forward_dynamics(q, v, a), 1e-9)
    slopes = jax.jacfwd(lambda *given: dynamics.inverse_dynamics(robot, *given), (0, 1, 2))(q, v, a)
    near(np.stack(slopes), truth.derivatives(q, v, a), 1e-9)


def test_a_tip_behind_a_mimic_joint(two):
    """Where what it follows is on the way, or held, it is right; else it is refused."""
    robot = jaxik.load(two, tip=["thumb", "nail"], held={})
    assert [m.name for m in robot.mimics] == ["grip", "curl"]
    held = jaxik.load(two, tip="nail", held={"flex": 0.4})
    q = np.array([0.1, 0.2, 0.3])
    near(
        kinematics.forward_kinematics(held, q),
        kinematics.forward_kinematics(robot.with_tips("nail"), np.append(q, 0.4)),
    )
    words = "joint 'grip'", "follows 'flex' (mimic), which is on no way to a tip", "held={'flex': 0.0}"
    refused(two, *words, tip="nail")
    bent = write(two.parent, "bent.urdf", TWO.replace('mimic joint="flex"', 'mimic joint="curl"'))
    refused(bent, "joint 'grip'", "mimics itself", tip="finger")


def test_what_is_held_is_no_joint(two):
    robot = jaxik.load(two, tip=HANDS, held={"turn": 0.3, "left_wrist": -0.2})
    whole = jaxik.load(two, tip=HANDS, held={})
    assert robot.joint_names == ("left_shoulder", "right_shoulder", "right_wrist")
    q = np.array([0.4, 0.5, -0.6])
    full = np.array([0.3, 0.4, -0.2, 0.5, -0.6])
    near(kinematics.forward_kinematics(robot, q), kinematics.forward_kinematics(whole, full))
    near(dynamics.mass_matrix(robot, q), np.asarray(dynamics.mass_matrix(whole, full))[np.ix_([1, 3, 4], [1, 3, 4])])
    refused(two, "held 'trun'", "did you mean 'turn'", tip=HANDS, held={"trun": 0.0})
    refused(two, "held 'turn'", "5 is outside", "-2 to 2", tip=HANDS, held={"turn": 5.0})
    refused(two, "held 'flex'", "is in posture=, too", tip=HANDS, held={"flex": 0.0}, posture={"flex": 0.0})
    refused(two, "posture 'turn'", "held={'turn': 0.1}", tip=HANDS, posture={"turn": 0.1})


def test_joints_that_are_held_later(two):
    """They leave the robot that a file gives with the same joints held; a branch is the arm that it gives for one tip."""
    whole, values = jaxik.load(two, tip=[*HANDS, "thumb"], held={}), {"turn": 0.3, "flex": -0.2}
    rng = np.random.default_rng(5)
    pairs = [(kinematics.hold_joints(whole, values), jaxik.load(two, tip=[*HANDS, "thumb"], held=values))]
    pairs.append((kinematics.branch_to(whole, "left_hand"), jaxik.load(two, tip="left_hand", held={})))
    pairs.append(
        (kinematics.hold_joints(whole, {"left_wrist": 0.4}), jaxik.load(two, tip=[*HANDS, "thumb"], held={"left_wrist": 0.4}))
    )
    for ours, theirs in pairs:
        assert ours.joint_names == theirs.joint_names and ours.parents == theirs.parents
        assert ours.link_names and len(ours.mimics) == len(theirs.mimics)
        q, v, a = rng.normal(size=(3, ours.num_joints))
        near(kinematics.forward_kinematics(ours, q), kinematics.forward_kinematics(theirs, q))
        near(kinematics.jacobian(ours, q), kinematics.jacobian(theirs, q))
        near(dynamics.inverse_dynamics(ours, q, v, a), dynamics.inverse_dynamics(theirs, q, v, a), 1e-11)
        index = {name: i for i, name in enumerate(theirs.link_names)}  # neighbours of before are neighbours still
        same = [[index[ours.link_names[i]] for i in pair] for pair in ours.self_pairs]
        alike = dataclasses.replace(theirs, self_pairs=tuple(sorted(tuple(sorted(pair)) for pair in same)))
        near(jaxik.clearance(ours, None, q), jaxik.clearance(alike, None, q), 1e-6)
        places = dict(zip(theirs.link_names, kinematics.link_frames(theirs, q), strict=True))
        for name, frame in zip(ours.link_names, kinematics.link_frames(ours, q), strict=True):
            near(frame, places[name])
    assert kinematics.branch_to(whole, "left_hand").tree.serial
    assert kinematics.hold_joints(whole, {}) is whole
    for call, words in (
        (lambda: kinematics.hold_joints(whole, {"trun": 0.0}), "no joint 'trun'; did you mean 'turn'"),
        (lambda: kinematics.hold_joints(whole, dict.fromkeys(whole.joint_names, 0.0)), "leave one that moves"),
        (lambda: kinematics.branch_to(whole, "base"), "no joint of two moves 'base'"),
    ):
        with pytest.raises(ValueError, match=words):
            call()


@pytest.mark.usefixtures("untyped")
def test_what_holds_no_joints_is_told():
    robot = jaxik.load("p6r")
    for given, words in (((robot, ["slide"]), "held is .*; write {'joint': value}"), (("p6r", {}), "robot is p6r; write a ")):
        with pytest.raises(ValueError, match=words):
            kinematics.hold_joints(*given)


@pytest.mark.parametrize("base", ["planar", "floating"])
def test_a_base_that_moves(two, base):
    robot = jaxik.load(two, tip=HANDS, base=base, held={})
    moving = {
        "planar": ("base_x", "base_y", "base_heading"),
        "floating": ("base_x", "base_y", "base_z", "base_yaw", "base_pitch"),
    }
    moving["floating"] += ("base_roll",)
    assert robot.joint_names[: len(moving[base])] == moving[base] and robot.link_names[0] == "world"
    truth, rng = TreeTruth(two, robot.joint_names, base, {"curl": 0.1}), np.random.default_rng(1)  # as it follows a thumb at 0
    q, v, a = rng.normal(size=(3, robot.num_joints))
    for i, name in enumerate(HANDS):
        near(kinematics.forward_kinematics(robot, q)[i], truth.pose(q, name))
        near(kinematics.jacobian(robot, q)[i], truth.jacobian(q, name))
    near(dynamics.inverse_dynamics(robot, q, v, a), truth.inverse_dynamics(q, v, a), 1e-10)
    near(dynamics.centre_of_mass(robot, q), truth.centre(q)[0])
    if base == "floating":  # the turn of the root is URDF's rpy
        root = kinematics.forward_kinematics(robot.with_tips("base"), q)
        near(root[:3, :3], pin.rpy.rpyToMatrix(q[5], q[4], q[3]))
        near(root[:3, 3], q[:3])


def test_a_table_on_a_base_that_moves():
    robot, still = jaxik.load("ur5e", base="planar"), jaxik.load("ur5e")
    q = np.array([0.3, -0.2, 0.7, *np.linspace(-1.0, 1.0, 6)])
    stands = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, 0.7), np.array([0.3, -0.2, 0.0])).homogeneous
    near(kinematics.forward_kinematics(robot, q), stands @ kinematics.forward_kinematics(still, q[3:]))


def test_which_tip_is_meant(two):
    """The only leaf that is no finger; several are listed."""
    refused(two, "2 leaves", "one of, or a list: left_hand, right_hand")
    one_arm = TWO.replace(PARTS["right_hand"], "").replace(PARTS["right"], "").replace(link("right"), "")
    robot = jaxik.load(write(two.parent, "one.urdf", one_arm.replace(link("right_hand"), "")), held={})
    assert robot.joint_names == ("turn", "left_shoulder", "left_wrist")


@pytest.mark.parametrize(
    "tip, words",
    [
        (["left_hand", "hand"], ("tip 'hand'", "no such link", "did you mean")),
        (["left_hand", "left_hand"], ("tip 'left_hand'", "stands twice")),
        ([], ("tip", "is an empty list")),
        (["left_hand", "alone"], ("tip 'left_hand'", "has the root 'base', and tip 'alone' the root 'alone'")),
        (["base"], ("no movable joint",)),
    ],
)
def test_tips_that_are_none(two, tip, words):
    path = write(two.parent, "roots.urdf", TWO.replace("</robot>", f"{link('alone')}</robot>"))
    refused(path, *words, tip=tip)


def test_a_second_root_is_told(two):
    """Unless it is an empty link, which changes nothing, or a base is named."""
    more = link("table") + link("top") + joint("stand", "table", "top")
    path = write(two.parent, "two_roots.urdf", TWO.replace("</robot>", f"{more}</robot>"))
    with pytest.warns(
        UserWarning, match="'?table'?: no joint leads there, and what hangs on it is left out; join it by a fixed"
    ):
        found = jaxik.load(path, tip=HANDS, held={})
    assert (
        found.joint_names
        == jaxik.load(two, tip=HANDS, held={}).joint_names
        == jaxik.load(path, tip=HANDS, base="base", held={}).joint_names
    )
    ring = "".join(map(link, "xyz")) + joint("1", "x", "y") + joint("2", "y", "z") + joint("3", "z", "x")
    path = write(two.parent, "ring.urdf", f'<robot name="ring">{ring}</robot>')
    refused(path, "link 'x'", "the joints form a loop", "cut the joint between 'z' and it", tip="x")


def test_tips_are_names():
    for tip in (3, [1, 2], [None], [["left_hand"]]):
        with pytest.raises(ValueError, match=r"^load: tip is .*write \"link\", or a list"):
            AskedTips.of(tip)


def test_loops_are_refused_with_the_cut(two):
    bar = joint("bar", "right_hand", "left_hand")
    words = "link 'left_hand' has two parent joints", "cut the loop at this joint or at 'left_wrist'"
    refused(write(two.parent, "bar.urdf", TWO.replace("</robot>", f"{bar}</robot>")), "joint 'bar'", *words, tip=HANDS)
    four_bar = """<mujoco><worldbody><body name="a"><joint name="j" axis="0 0 1"/><geom size=".1"/>
      <body name="b" pos=".2 0 0"><joint name="k" axis="0 0 1"/><geom size=".1"/></body></body>
      <body name="c" pos="0 .2 0"><joint name="m" axis="0 0 1"/><geom size=".1"/></body></worldbody>
      <equality><connect body1="b" body2="c" anchor="0 0 0"/></equality></mujoco>"""
    refused(write(two.parent, "bar.xml", four_bar), "equality of 'b' and 'c'", "closes a loop", "cut it", tip=["b", "c"])


def test_a_saved_tree_is_the_same(two):
    for robot in (
        jaxik.load(two, tip=[*HANDS, "thumb"], base="planar", held={}),
        jaxik.load(two, tip="nail", held={"flex": 0.4}),
        jaxik.load(two, tip=["thumb", "nail"], held={}).with_tips("nail"),
    ):
        jaxik.save(robot, two.parent / "saved.toml")
        again = jaxik.load(two.parent / "saved.toml")
        assert again == robot and again.digest == robot.digest
    robot = jaxik.load(two, tip=[*HANDS, "thumb"], held={})
    jaxik.save(robot, two.parent / "saved.urdf")
    again = jaxik.load(two.parent / "saved.urdf", tip=["left_hand_tip", "right_hand_tip", "thumb_tip"], held={})
    assert again.joint_names == robot.joint_names and len(again.mimics) == 2
    q, v, a = np.random.default_rng(2).normal(size=(3, 6))
    near(kinematics.forward_kinematics(again, q), kinematics.forward_kinematics(robot, q))
    near(dynamics.inverse_dynamics(again, q, v, a), dynamics.inverse_dynamics(robot, q, v, a), 1e-11)


def test_a_changed_file_is_one_line(two):
    robot = jaxik.load(two, tip=[*HANDS, "thumb"], held={})
    jaxik.save(robot, two.parent / "saved.toml")
    text = (two.parent / "saved.toml").read_text()
    for old, new, words in (
        ('parent = "turn"', 'parent = "tune"', ("parent = tune",)),
        ('parent = ""', 'parent = "left_wrist"', ("hangs on itself",)),
        ("factor = -0.5", "factor = inf", ("mimic 'grip'", "factor")),
        ('joint = "flex"', 'joint = "grip"', ("mimic 'grip'", "joint = 'grip'")),
    ):
        assert old in text
        refused(write(two.parent, "changed.toml", text.replace(old, new, 1)), *words)


# --------------------------------------------------------------------------------------------------------------------
# MJCF

MJCF = """<mujoco><compiler angle="radian" autolimits="true"/><worldbody>
<body name="trunk" pos="0.1 0.2 0.4"><freejoint name="free"/><geom size="0.1" mass="3"/>
 <body name="left" pos="0 0.2 0"><joint name="l1" axis="0 1 0" range="-2 2" pos="0 0 0.1"/>
  <joint name="l2" type="slide" axis="1 0 0" range="-1 1"/><geom size="0.05" pos="0.1 0 0" mass="1"/>
  <body name="left_hand" pos="0.3 0 0"><joint name="l3" axis="1 0 0" range="-2 2" armature="0.2" damping="0.3"/>
   <geom size="0.04" pos="0 0.1 0" mass="0.5"/>
   <body name="thumb" pos="0.1 0 0"><joint name="l4" axis="0 0 1" range="-1 1" armature="0.1"/>
    <geom size="0.02" mass="0.1" pos="0.1 0 0"/></body>
   <body name="finger" pos="0.1 0.1 0"><joint name="l5" axis="0 0 1" armature="0.4"/>
    <geom size="0.02" mass="0.1" pos="0.1 0 0"/></body>
  </body></body>
 <body name="right" pos="0 -0.2 0" quat="0.9 0.1 0.3 0.2"><joint name="r1" axis="0 1 0" range="-2 2"/>
  <geom size="0.05" pos="0.1 0 0" mass="1"/><site name="grasp" pos="0.2 0 0.1" quat="0.6 0.8 0 0"/></body>
</body></worldbody>
<equality><joint joint1="l5" joint2="l4" polycoef="0.1 -2 0 0 0"/></equality></mujoco>"""


def test_a_tree_of_mjcf_is_mujocos(tmp_path):
    """Two joints of one body, a site as a tip, a joint that an equality couples, a free base."""
    path = write(tmp_path, "two.xml", MJCF)
    robot = jaxik.load(path, tip=["thumb", "finger", "grasp"], base="floating")
    assert robot.joint_names[6:] == ("l1", "l2", "l3", "l4", "r1") and [m.name for m in robot.mimics] == ["l5"]
    model = mujoco.MjModel.from_xml_string(MJCF)
    data, rng = mujoco.MjData(model), np.random.default_rng(3)
    q = rng.normal(size=robot.num_joints) * 0.5
    values = dict(zip(robot.joint_names, q, strict=True)) | {"l5": 0.1 - 2.0 * q[robot.joint_names.index("l4")]}
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, pin.rpy.rpyToMatrix(q[5], q[4], q[3]).ravel())
    data.qpos[:7] = [*q[:3], *quat]
    for name in ("l1", "l2", "l3", "l4", "l5", "r1"):
        data.joint(name).qpos = values[name]
    mujoco.mj_forward(model, data)
    poses = np.asarray(kinematics.forward_kinematics(robot, q))
    for pose, part in zip(poses, (data.body("thumb"), data.body("finger"), data.site("grasp")), strict=True):
        near(pose[:3, 3], part.xpos)
        near(pose[:3, :3], part.xmat.reshape(3, 3))
    near(dynamics.centre_of_mass(robot, q), data.subtree_com[0])
    # M = G' M' G, the rotor of what follows felt through its factor; the free joint's rates are not those of angles
    mass, own = np.zeros((model.nv, model.nv)), robot.joint_names[6:]
    mujoco.mj_fullM(model, data, mass)
    at = {name: model.joint(name).dofadr[0] for name in (*own, "l5")}
    change = np.zeros((model.nv, len(own)))
    for i, name in enumerate(own):
        change[at[name], i] = 1.0
    change[at["l5"], own.index("l4")] = -2.0
    near(np.asarray(dynamics.mass_matrix(robot, q))[6:, 6:], change.T @ mass @ change)
    assert robot.armature[robot.joint_names.index("l4")] == pytest.approx(0.1 + 4.0 * 0.4)


def test_where_a_body_stands_that_a_base_moves(tmp_path):
    """One that is bolted to the world as in its file; a free one at its height, or where the six joints say."""
    bolted = MJCF.replace('<freejoint name="free"/>', "").replace('pos="0.1 0.2 0.4"', 'pos="0.1 0.2 0.4" quat="0 1 0 0"')
    for text, base, place, turn in (
        (MJCF, "planar", [0.0, 0.0, 0.4], 1.0),
        (MJCF, "floating", [0.0, 0.0, 0.0], 1.0),
        (bolted, "planar", [0.1, 0.2, 0.4], -1.0),
    ):
        robot = jaxik.load(write(tmp_path, "two.xml", text), tip=["left", "right"], base=base, held={})
        trunk = kinematics.forward_kinematics(robot.with_tips("trunk"), np.zeros(robot.num_joints))
        near(trunk[:3, 3], place)
        near(trunk[2, 2], turn)


def test_mjcf_and_urdf_are_the_same_tree(tmp_path, two):
    """The MJCF that MuJoCo makes of the URDF."""
    urdf = TWO.replace("<robot", "<robot").replace("</robot>", '<mujoco><compiler fusestatic="false"/></mujoco></robot>')
    model = mujoco.MjModel.from_xml_string(urdf)
    mujoco.mj_saveLastXML(str(tmp_path / "two.xml"), model)
    ours, theirs = (jaxik.load(path, tip=HANDS, held={}) for path in (two, tmp_path / "two.xml"))
    assert ours.joint_names == theirs.joint_names and ours.parents == theirs.parents
    for q in np.random.default_rng(4).normal(size=(3, 5)):
        near(kinematics.forward_kinematics(ours, q), kinematics.forward_kinematics(theirs, q), 1e-5)  # as many digits it writes


def test_what_the_world_holds_cannot_float(tmp_path):
    bolted = write(
        tmp_path, "two.xml", MJCF.replace('<freejoint name="free"/>', '<joint name="rail" type="slide" axis="1 0 0"/>')
    )
    refused(bolted, "base 'floating'", "body 'trunk' has joints of its own", "rail", tip=["left", "right"], base="floating")
    refused(write(tmp_path, "free.xml", MJCF), "joint 'free'", 'base="floating"', tip="left_hand")


# --------------------------------------------------------------------------------------------------------------------
# Arms


def test_a_serial_arm_is_the_same_however_it_is_made(two):
    for path, tip in ((two, "left_hand"), (FOLDER / "ur_description/urdf/ur5_robot.urdf", "tool0")):
        robot = jaxik.load(path, tip=tip, held={})
        assert robot.parents == () and robot.tip_joints == () and robot.tree.serial
        rows = range(robot.num_joints)
        again = type(robot)(**{**vars_of(robot), "parents": tuple(i - 1 for i in rows), "tip_joints": (robot.num_joints,)})
        assert again == robot and again.digest == robot.digest


def vars_of(robot):
    return {name: getattr(robot, name) for name in type(robot).__dataclass_fields__}


def test_what_takes_arms_alone_says_so(two):
    robot = jaxik.load(two, tip=HANDS, held={})
    targets = np.eye(4)
    for call in (
        lambda: robot.part(0, 2),
        lambda: jaxik.closed_form(robot, targets),
        lambda: jaxik.homotopy.all_postures(robot, targets),
        lambda: robot.with_load(1.0),
        lambda: jaxik.harvest(robot, jaxik.load_scene("cucumber_row")),
        lambda: jaxik.teleoperation.reflect(robot, np.zeros(5), dynamics.PointForce(1, np.zeros(3), np.ones(3))),
        lambda: jaxik.follow(robot, jaxik.motions.Line(np.eye(4), np.eye(4)), 1.0, np.zeros(5)),
        lambda: jaxik.identification.base_parameters(robot),
        lambda: kinematics.manipulability(robot, np.zeros(5)),
    ):
        with pytest.raises(ValueError, match=r"two|tips") as error:
            call()
        assert "\n" not in str(error.value)


def test_every_file_gives_all_of_its_joints():
    """The whole tree of each URDF of example-robot-data, or one line."""
    for file in itertools.islice(sorted(FOLDER.rglob("*.urdf")), 0, None, 9):
        if "<link" not in file.read_text():
            continue
        try:
            tips = tree_tips(file)
            robot = jaxik.load(file, tip=tips, held={}) if tips else None
        except jaxik.LoadError as error:
            assert "\n" not in str(error)
        else:
            assert robot is None or robot.tips


def test_the_arm_of_the_other_tests_follows(tmp_path):
    follows = URDF.replace('<axis xyz="0 1 0"/>', '<axis xyz="0 1 0"/><mimic joint="shoulder" multiplier="2"/>')
    robot, free = (jaxik.load(write(tmp_path, f"{i}.urdf", text)) for i, text in enumerate((follows, URDF)))
    assert robot.joint_names == ("shoulder",)
    near(kinematics.forward_kinematics(robot, np.array([0.3])), kinematics.forward_kinematics(free, np.array([0.3, 0.6])))


# --------------------------------------------------------------------------------------------------------------------
# SRDF

SRDF = """<robot name="two">
<group name="left_arm"><chain base_link="torso" tip_link="left_hand"/></group>
<group name="right_arm"><joint name="right_shoulder"/><link name="right_hand"/></group>
<group name="both"><group name="left_arm"/><group name="right_arm"/><joint name="unknown"/></group>
<group_state name="home" group="left_arm"><joint name="left_shoulder" value="0.5"/>
 <joint name="left_wrist" value="-0.3"/></group_state>
<group_state name="home" group="right_arm"><joint name="right_wrist" value="0.7"/></group_state>
<group_state name="other" group="right_arm"><joint name="right_wrist" value="0.2"/><joint name="flex" value="1"/></group_state>
<end_effector name="gripper" parent_link="right_hand" group="hand"/>
<disable_collisions link1="left" link2="right" reason="Never"/></robot>"""


def test_groups_states_and_end_effectors(two):
    srdf = write(two.parent, "two.srdf", SRDF)
    robot = jaxik.load(two, tip=["left_arm", "gripper"], srdf=srdf, held={})
    assert robot.tip_names == ("left_arm", "gripper")
    q = np.array([0.1, 0.2, 0.3, 0.4, 0.5])
    plain = jaxik.load(two, tip=HANDS, held={})
    near(kinematics.forward_kinematics(robot, q), kinematics.forward_kinematics(plain, q))
    names = {group.name: group.joints for group in robot.groups}
    assert names == {
        "left_arm": ("left_shoulder", "left_wrist"),
        "right_arm": ("right_shoulder", "right_wrist"),
        "both": ("left_shoulder", "left_wrist", "right_shoulder", "right_wrist"),
    }
    assert robot.group("right_arm").tolist() == [3, 4]
    model = pin.buildModelFromUrdf(str(two))
    pin.loadReferenceConfigurations(model, str(srdf))
    theirs = model.referenceConfigurations["other"]
    assert robot.state("other", q=q).tolist() == [
        0.1,
        0.2,
        0.3,
        0.4,
        theirs[model.joints[model.getJointId("right_wrist")].idx_q],
    ]
    assert robot.state("home").tolist() == [0.0, 0.5, -0.3, 0.0, 0.7]
    assert robot.state("home", group="right_arm").tolist() == [0.0, 0.0, 0.0, 0.0, 0.7]
    for call, words in (
        (lambda: robot.group("left"), "no group 'left'; did you mean 'left_arm'"),
        (lambda: robot.state("hone"), "no state 'hone'; did you mean 'home'"),
    ):
        with pytest.raises(ValueError, match=words):
            call()
    jaxik.save(robot, two.parent / "named.toml")
    assert jaxik.load(two.parent / "named.toml") == robot
    part = jaxik.load(two, tip="left_arm", srdf=srdf, held={}).part(1, 3)
    assert part.state("home").tolist() == [0.5, -0.3] and part.group("both").tolist() == [0, 1]


CHAINS = """<robot name="two">
<group name="hands"><chain base_link="left_hand" tip_link="right"/></group>
<group name="up"><chain base_link="left_hand" tip_link="torso"/></group>
<group name="absent"><chain base_link="world" tip_link="left_hand"/><joint name="turn"/></group>
<group name="led"><link name="left"/></group></robot>"""
THEIRS = {  # of a chain those that move one of its two links against the other
    "hands": ("left_shoulder", "left_wrist", "right_shoulder"),
    "up": ("left_shoulder", "left_wrist"),
    "absent": ("turn",),
    "led": ("left_shoulder",),
}


@pytest.mark.parametrize("kind", ["urdf", "toml", "saved"])
def test_a_group_between_two_links(two, kind, tmp_path):
    """A saved robot's links are those that its joints move, and its file has no others."""
    srdf, robot = write(two.parent, "chains.srdf", CHAINS), jaxik.load(two, tip=HANDS, held={})
    path, options = two, {"tip": HANDS, "held": {}}
    if kind == "saved":
        path, options = tmp_path / "two.toml", {}
        jaxik.save(robot, path)
    elif kind == "toml":
        on = {"torso": "base", "left": "torso", "left_hand": "left", "right": "torso", "right_hand": "right"}
        rows = [f'[[joint]]\nname = "{each}"\ntype = "revolute"\nlink = "{link}"\non = "{on[link]}"\nlower = -1\nupper = 1'
                for each, link in zip(robot.joint_names, on, strict=True)]  # fmt: skip
        head = ['name = "two"', 'description = "two arms"', 'convention = "frames"']
        path = write(tmp_path, "rows.toml", "\n".join([*head, *rows]))
    with pytest.warns(UserWarning, match=r"world: group 'absent' of chains\.srdf names these links, which the file has not"):
        robot = jaxik.load(path, srdf=srdf, **options)
    assert {group.name: group.joints for group in robot.groups} == THEIRS


def test_a_state_of_no_group(two):
    """The file of Kinova's arm in example-robot-data has such ones."""
    srdf = write(two.parent, "free.srdf", SRDF.replace('name="other" group="right_arm"', 'name="other"'))
    robot = jaxik.load(two, tip=HANDS, srdf=srdf, held={})
    assert robot.state("other").tolist() == [0.0, 0.0, 0.0, 0.0, 0.2]
    jaxik.save(robot, two.parent / "free.toml")
    assert jaxik.load(two.parent / "free.toml") == robot


@pytest.mark.parametrize(
    "old, new, words",
    [
        ('<group name="right_arm"/>', '<group name="both"/>', ("group 'both'", "holds itself")),
        ('<group name="right_arm"/>', '<group name="arms"/>', ("group 'both'", "no such group 'arms'")),
        ('value="0.7"', 'value="home"', ("group_state 'home'", "'right_wrist' has the value 'home'")),
    ],
)
def test_an_srdf_that_is_wrong(two, old, new, words):
    assert old in SRDF
    path = write(two.parent, "wrong.srdf", SRDF.replace(old, new))
    refused(path, *words, reader=lambda path: jaxik.load(two, tip=HANDS, srdf=path, held={}))
