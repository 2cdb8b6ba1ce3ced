"""Ties in an MJCF, and what it lets pass, are refused or read, as MuJoCo means them."""

import itertools

import mujoco
import numpy as np
import pytest
from robot_files import refused, write

import jaxik

ARM = """<mujoco><compiler angle="radian"/><worldbody><site name="wall" pos="1 0 0"/>
<body name="a"><joint name="j1" axis="0 0 1" range="-3 3"/><geom name="ga" size=".05" contype="{a[0]}" conaffinity="{a[1]}"/>
<body name="b" pos=".4 0 0"><joint name="j2" axis="0 1 0" range="-3 3"/>
<geom name="gb" size=".05" contype="{b[0]}" conaffinity="{b[1]}"/>
<body name="c" pos=".4 0 0"><joint name="j3" axis="0 1 0" range="-3 3"/><site name="sc"/>
<geom name="gc" size=".05" contype="{c[0]}" conaffinity="{c[1]}"/>
<body name="d" pos=".4 0 0"><joint name="j4" axis="0 1 0" range="-3 3"/><geom name="gd" size=".05"/>
<body name="finger" pos="0 .1 0"><joint name="f1" axis="0 0 1"/><geom size=".01" contype="0" conaffinity="0"/></body>
<body name="thumb" pos="0 -.1 0"><joint name="f2" axis="0 0 1"/><geom size=".01" contype="0" conaffinity="0"/></body>
</body></body></body></body>
<body name="crate" pos="5 0 0"><freejoint/><geom size=".1" contype="0" conaffinity="0"/></body>
<body name="guide" mocap="true"/></worldbody>{more}</mujoco>"""
BITS = {"a": (1, 1), "b": (1, 1), "c": (1, 1)}


def arm(folder, more="", **bits):
    return write(folder, "arm.xml", ARM.format(more=more, **(BITS | bits)))


@pytest.mark.parametrize(
    "equality, words",
    [
        ('<connect body1="d" body2="a" anchor="0 0 0"/>', ("equality of 'd' and 'a'", "a connect closes a loop")),
        ('<connect body1="d" anchor="0 0 0"/>', ("'d' and 'world'", "a connect closes")),
        ('<connect site1="sc" site2="wall"/>', ("'c' and 'world'", "base=, tip= (--base, --tip)")),
        ('<weld body1="b" body2="d"/>', ("'b' and 'd'", "a weld closes a loop")),
        ('<tendon tendon1="joints"/>', ("'a' and 'd'", "a tendon closes a loop")),
        ('<tendon tendon1="cord" polycoef="1 0 0 0 0"/>', ("'world' and 'c'", "a tendon closes a loop")),
        ('<tendon tendon1="grip" tendon2="cord"/>', ("'world' and 'c'", "a tendon")),
    ],
)
def test_a_loop_on_the_robot_is_refused(tmp_path, equality, words):
    """MuJoCo's own constraint changes with what the robot takes for free joints."""
    tendons = '<tendon><fixed name="joints"><joint joint="j2" coef="1"/><joint joint="j4" coef="1"/></fixed>'
    tendons += '<fixed name="grip"><joint joint="f1" coef="1"/><joint joint="f2" coef="-1"/></fixed>'
    tendons += '<spatial name="cord"><site site="wall"/><site site="sc"/></spatial></tendon>'
    path = arm(tmp_path, f"{tendons}<equality>{equality}</equality>")
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    residuals = []
    for q in ((0.1, 0.2, 0.3, 0.4), (0.5, -0.9, 1.3, -0.2)):
        data.qpos[:4] = q
        mujoco.mj_forward(model, data)
        residuals.append(data.efc_pos[: data.ne].copy())
    assert np.abs(residuals[0] - residuals[1]).max() > 0.01
    refused(path, *words, tip="d")
    idle = equality.replace("/>", ' active="false"/>')
    assert jaxik.load(arm(tmp_path, f"{tendons}<equality>{idle}</equality>"), tip="d").num_joints == 4


def test_what_does_not_restrict_the_robot_is_let_pass(tmp_path):
    load = lambda equality: jaxik.load(arm(tmp_path, f"<equality>{equality}</equality>"), tip="d")
    assert load('<connect body1="finger" body2="thumb" anchor="0 0 0"/>').num_joints == 4  # a hand's own loop, held
    for body in ("crate", "guide"):
        with pytest.warns(UserWarning, match=f"arm: {body}: a weld ties the body to the robot; it flies freely"):
            load(f'<weld body1="d" body2="{body}"/>')


def met(model):
    """The pairs of bodies between which MuJoCo finds a contact where all geoms are at one point."""
    model.body_pos[:] = 0.0
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return {frozenset(model.body(int(model.geom_bodyid[g])).name for g in c.geom) for c in data.contact}


@pytest.mark.parametrize(
    "more, bits",
    [
        ("", {}),
        ('<contact><exclude body1="a" body2="c"/></contact>', {}),
        ("", {"a": (1, 0), "c": (1, 0)}),
        ("", {"a": (2, 4), "b": (4, 1), "c": (1, 2)}),
        ('<contact><pair geom1="ga" geom2="gd"/></contact>', {"a": (0, 0), "b": (1, 0), "c": (1, 0)}),
        ('<contact><pair geom1="ga" geom2="gc"/><exclude body1="a" body2="c"/></contact>', {}),
    ],
)
@pytest.mark.filterwarnings("ignore:.*contype and conaffinity say")
def test_pairs_are_checked_as_mujoco_does(tmp_path, more, bits):
    path = arm(tmp_path, more, **bits)
    robot = jaxik.load(path, tip="d", posture={})
    solid = {robot.link_names[v.link] for v in robot.volumes}
    checked = {frozenset(robot.link_names[i] for i in pair) for pair in robot.self_pairs}
    theirs = met(mujoco.MjModel.from_xml_path(str(path)))
    apart = lambda pair: abs(ord(pair[0]) - ord(pair[1])) > 1  # neighbours are checked by neither
    ours = {frozenset(pair) for pair in itertools.combinations("abcd", 2) if apart(pair)}
    assert checked == theirs & ours
    assert solid == {name for name in "abcd" if any(bits.get(name, (1, 1))) or f'geom1="g{name}"' in more}


def test_bits_that_never_meet_are_told(tmp_path):
    with pytest.warns(UserWarning, match=r"arm: links are not checked .* contype and conaffinity say: a and c; give"):
        jaxik.load(arm(tmp_path, a=(1, 0), c=(1, 0)), tip="d", posture={})


def test_a_robot_that_nothing_touches_is_told(tmp_path):
    path = arm(tmp_path, a=(0, 0), b=(0, 0), c=(0, 0))
    path = write(tmp_path, "arm.xml", path.read_text().replace('name="gd"', 'name="gd" contype="0" conaffinity="0"'))
    with pytest.warns(UserWarning, match="arm: none of its geoms touches anything"):
        robot = jaxik.load(path, tip="d", meshes=True, posture={})
    assert not robot.volumes and jaxik.load(path, tip="d", posture={}) == robot


MESHED = """<mujoco><compiler meshdir="assets"/><asset><mesh name="m" file="gone.stl"/><mesh file="n.obj"/>
<texture name="t" type="2d" file="gone.png"/><material name="red" texture="t"/></asset><worldbody>
<body name="a"><joint name="j1" axis="0 0 1"/><inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/>
<geom type="mesh" mesh="m" material="red"/><geom size=".1" material="red"/>
<body name="b" pos="1 0 0"><joint name="j2" axis="0 0 1"/><geom type="mesh" mesh="n"/></body></body></worldbody></mujoco>"""


def test_kinematics_need_no_meshes(tmp_path):
    path = write(tmp_path, "arm.xml", MESHED)
    with pytest.warns(UserWarning, match="arm: b: a mesh is missing, and the mass that"):
        robot = jaxik.load(path)
    tip = jaxik.forward_kinematics(robot, np.array([0.3, 0.4]))
    np.testing.assert_allclose(tip[:2, 3], [np.cos(0.3), np.sin(0.3)], atol=1e-6)
    assert robot.unread_meshes == ("a", "b") and robot.bodies[0].mass == 2.0
    refused(path, "gone.stl", "MuJoCo refuses", meshes=True)
    refused(write(tmp_path, "bad.xml", MESHED.replace('type="mesh"', 'type="mush"')), "MuJoCo refuses")
    weightless = "<mujoco><worldbody><body><joint/></body></worldbody></mujoco>"
    refused(write(tmp_path, "light.xml", weightless), "MuJoCo refuses", "mass and inertia")
