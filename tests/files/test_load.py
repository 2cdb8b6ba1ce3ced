"""Loaders: every refusal is one line that names file, element and mend; nothing but LoadError comes out of any bytes."""

import io
import itertools
import json
import struct
import sys
import zipfile

import jax
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from robot_files import ARM, URDF, refused, tree_of_balls, write
from robots import FOLDER, ROBOTS
from scipy.spatial.transform import Rotation

import jaxik
from jaxik.files import targets as target_files
from jaxik.files import urdf
from jaxik.files.documents import MAX_BYTES
from jaxik.files.mesh import load_mesh
from jaxik.reasons import LoadError

TOML = """name = "arm"
convention = "frames"
[[joint]]
name = "lift"
type = "prismatic"
axis = [0, 0, 1]
lower = 0
upper_mm = 400
[[joint]]
name = "turn"
type = "revolute"
translation_mm = [300, 0, 0]
axis = [0, 1, 0]
lower_deg = -90
upper_deg = 90
[[shape]]
link = "turn_link"
kind = "box"
size = [0.1, 0.1, 0.2]
"""
MJCF = """<mujoco><worldbody><body name="upper"><joint name="shoulder" axis="0 0 1"/><geom size=".1"/>
<body name="tool" pos=".3 0 0"><joint name="wrist" type="slide" axis="0 1 0" range="0 .4"/><geom size=".05"/></body></body>
</worldbody></mujoco>"""
NESTED = '<replicate count="1000">' * 3 + '<geom size=".1"/>' + "</replicate>" * 3 + "<body"
SCENE = """name = "s"
[[object]]
name = "leaf"
points = [[0.1, 0.7, 0.5]]
[[mark]]
name = "fruit_1"
position = [0.1, 0.7, 0.4]
"""
BENT = 'polycoef="0 1 0.2 0 0"'
FILES = {"arm.urdf": URDF, "arm.toml": TOML, "arm.xml": MJCF}


@pytest.mark.parametrize("name", FILES)
def test_the_samples_are_good(tmp_path, name):
    robot = jaxik.load(write(tmp_path, name, FILES[name]))
    assert robot.num_joints == 2 and np.all(np.isfinite(jaxik.forward_kinematics(robot, np.zeros(2))))


BILLION = """<!DOCTYPE robot [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">]>"""
EXTERNAL = '<!DOCTYPE robot [<!ENTITY x SYSTEM "file:///etc/hostname">]>'


@pytest.mark.parametrize(
    "old, new, words",
    [
        ('axis xyz="0 0 1"', 'axis xyz="0 0 0"', ("joint 'shoulder'", "zero")),
        ('axis xyz="0 0 1"', 'axis xyz="0 0 3"', ("joint 'shoulder'", "length 3", "write 0 0 1")),
        ('axis xyz="0 0 1"', 'axis xyz="0 0 nan"', ("shoulder", "finite")),
        ('axis xyz="0 0 1"', 'axis xyz="0 0"', ("shoulder", "3 ")),
        ('lower="-1"', 'lower="2"', ("joint 'shoulder'", "lower limit 2 > upper 1", "swap")),
        ('lower="-1"', 'lower="many"', ("shoulder", "'lower' = 'many'")),
        ('xyz="0 0 0.1"', 'xyz="0 inf 0.1"', ("shoulder", "finite")),
        ('name="wrist"', 'name="shoulder"', ("joint 'shoulder'", "twice")),
        ('link name="tool"', 'link name="upper"', ("link 'upper'", "twice")),
        ('type="continuous"', 'type="floating"', ("joint 'wrist'", "floating", "allowed: revolute")),
        ('type="continuous"', 'type="planar"', ("joint 'wrist'", "not supported")),
        ('<axis xyz="0 1 0"/>', '<axis xyz="0 1 0"/><mimic joint="elbow"/>', ("joint 'wrist'", "mimic", "shoulder, wrist")),
        ('<parent link="base"/>', '<parent link="nowhere"/>', ("joint 'shoulder'", "'nowhere' is not defined")),
        ('<parent link="base"/>', "", ("shoulder", "<parent>", "missing")),
        ('<child link="upper"/>', '<child link="tool"/>', ("two parent",)),
        ("</robot>", "", ("malformed XML",)),
        ('<robot name="arm">', f'{BILLION}<robot name="arm">', ("entity",)),
        ('<robot name="arm">', f'{EXTERNAL}<robot name="arm">', ("entity",)),
        ('<robot name="arm">', '<?xml version="1.0" encoding="klingon"?><robot name="arm">', ("malformed XML",)),
        ("robot", "model", ("root is not <robot>",)),
    ],
)
def test_urdf_refusals(tmp_path, old, new, words):
    text = URDF.replace(old, new)
    assert text != URDF
    refused(write(tmp_path, "arm.urdf", text), *words)


PLANAR = URDF.replace('type="continuous"', 'type="planar"')
SHAPE = "<collision><geometry><sphere radius='.02'/></geometry></collision>"


@pytest.mark.parametrize(
    "text, words",
    [
        (URDF.replace("<robot", '<robot xmlns:xacro="http://ros.org/wiki/xacro"').replace("</robot>", "<xacro:arm/></robot>"),
         ("<arm>", "is xacro", "xacro arm.urdf > arm_expanded.urdf")),
        (URDF.replace("</robot>", "<xacro:arm/></robot>"), ("malformed XML", "expand it: xacro arm.urdf > arm_expanded.urdf")),
        (URDF.replace('xyz="0 0 0.1"', 'xyz="0 0 ${a}"'), ("<joint>", "is xacro", "expand it")),
        (PLANAR, ("joint 'wrist'", "planar", "pass base= (--base) to start below it")),
    ],
)  # fmt: skip
def test_what_is_to_be_made_of_it_first(tmp_path, text, words):
    refused(write(tmp_path, "arm.urdf", text), *words)
    refused(write(tmp_path, "arm.urdf.xacro", text), "ending '.xacro'", "xacro arm.urdf.xacro > arm.urdf")


@pytest.mark.parametrize(
    "text, words",
    [
        (URDF.replace('lower="-1" upper="1" ', ""), "arm: shoulder: has no lower and no upper in its <limit>, which locks"),
        (URDF.replace('lower="-1"', 'lower="-180"'), "arm: shoulder: has a limit beyond 12.6 rad; are these degrees?"),
        (
            PLANAR.replace('<link name="tool"/>', f'<link name="tool">{SHAPE}</link>'),
            r"joints .* wrist \(planar\) where it stands",
        ),
        (URDF.replace('lower="-1" upper="1"', 'lower="-1e9" upper="1e9"'), None),  # without end
    ],
)
def test_what_is_probably_a_slip_is_told(tmp_path, text, words):
    path = write(tmp_path, "arm.urdf", text)
    if words is None:
        assert jaxik.load(path, tip="upper").num_joints == 1
        return
    with pytest.warns(UserWarning, match=words):
        jaxik.load(path, tip="upper")


def test_what_is_drawn_alone_is_told(tmp_path):
    """A URDF without collision shapes is hit by nothing, whatever it looks like."""
    drawn = SHAPE.replace("collision", "visual")
    path = write(tmp_path, "arm.urdf", URDF.replace('<link name="tool"/>', f'<link name="tool">{drawn}</link>'))
    with pytest.warns(UserWarning, match=r"arm: none of its links has a <collision>, and a <visual> is not read"):
        robot = jaxik.load(path, meshes=True)
    with pytest.raises(ValueError, match=r"no collision geometry; .* <collision> of a URDF"):
        jaxik.clearance(robot, jaxik.make_scene(), np.zeros(2))
    assert jaxik.load(path) == robot


def test_quaternions_and_namespaces_are_read_as_pinocchio_reads_them(tmp_path):
    """Origins of URDF 1.1; and a default namespace, which urdfdom does not look at."""
    turned = URDF.replace('<robot name="arm">', '<robot name="arm" version="1.1" xmlns="http://drake.mit.edu">').replace(
        'xyz="0.3 0 0"', 'xyz="0.3 0 0" quat_xyzw="0.1 -0.5 0.3 0.806"'
    )
    path, q = write(tmp_path, "arm.urdf", turned), np.array([0.4, 0.7])
    model = pin.buildModelFromUrdf(str(path))
    data, angle = model.createData(), np.array([q[0], np.cos(q[1]), np.sin(q[1])])
    pin.framesForwardKinematics(model, data, angle)
    wanted = data.oMf[model.getFrameId("tool")].homogeneous
    assert np.allclose(jaxik.forward_kinematics(jaxik.load(path), q), wanted, atol=1e-6)
    refused(write(tmp_path, "arm.urdf", turned.replace('version="1.1"', "")), "quat_xyzw", "version 1.0")
    refused(write(tmp_path, "arm.urdf", turned.replace(" quat_xyzw", ' rpy="0 0 0" quat_xyzw')), "'wrist'", "keep one")
    refused(write(tmp_path, "arm.urdf", turned.replace('0.806"', '8.06"')), "'wrist'", "not of length 1")


def test_base_and_tip_are_found_or_refused(tmp_path):
    path = write(tmp_path, "arm.urdf", URDF)
    assert jaxik.load(path, tip="upper").joint_names == ("shoulder",)
    assert jaxik.load(path, base="upper").joint_names == ("wrist",)
    refused(path, "tip 'hand'", "links: base, upper, tool", tip="hand")
    refused(path, "base 'root'", "no such link", base="root")
    refused(path, "tip 'base'", "is not below base 'tool'", tip="base", base="tool")
    refused(path, "no movable joint", tip="base")
    forked = URDF.replace("</robot>", '<link name="camera"/><joint name="c" type="fixed"><parent link="upper"/>'
                          '<child link="camera"/></joint></robot>')  # fmt: skip
    refused(write(tmp_path, "forked.urdf", forked), "2 leaves", "camera, tool")
    refused(write(tmp_path, "empty.urdf", '<robot name="empty"/>'), "has no links; name a robot's file")
    with pytest.raises(ValueError, match=r"load: unknown option 'tips'; did you mean 'tip'\?"):
        jaxik.load(tmp_path / "forked.urdf", tips="camera")
    refused(tmp_path / "absent.urdf", "cannot be read")
    refused(write(tmp_path, "arm.sdf", URDF), "ending '.sdf'", ".urdf")
    with pytest.raises(jaxik.LoadError, match="shipped: chembuly9"):
        jaxik.load("sawyer")


@pytest.mark.parametrize(
    "old, new, words",
    [
        ("axis = [0, 0, 1]", "axis = [0, 0, 0]", ("joint 'lift'", "zero")),
        ("lower = 0", "lower = 1", ("joint 'lift'", "lower limit 1 > upper 0.4")),
        ("lower = 0", "lower = nan", ("lift", "NaN")),
        ("lower = 0", "lower_deg = 0", ("lift", "'lower' is missing")),
        ("lower = 0", "lower = 0\nlower_mm = 0", ("say the same",)),
        ("lower = 0", "lower = true", ("lift", "not a number")),
        ('name = "turn"', 'name = "lift"', ("joint 'lift'", "twice")),
        ('type = "prismatic"', 'type = "screw"', ("lift", "allowed: revolute")),
        ('convention = "frames"', 'convention = "hayati"', ("convention", "allowed: modified_dh")),
        ("axis = [0, 1, 0]", "axis = [0, 1]", ("turn", "3 numbers")),
        ("axis = [0, 1, 0]", "axes = [0, 1, 0]", ("turn", "unknown key", "axes")),
        ("size = [0.1, 0.1, 0.2]", "size = [0.1, 0.1, 0]", ("shape 1", "not positive")),
        ('link = "turn_link"', 'link = "hand"', ("shape 1", "no such link 'hand'")),
        ('name = "arm"', "name = 3", ("'name'",)),
        ("size = [0.1, 0.1, 0.2]", "sizes = [0.1, 0.1, 0.2]", ("'size' is missing", "is it 'sizes'?")),
        ("[[shape]]", "[[shapes]]", ("unknown key 'shapes'", "did you mean 'shape'?")),
        ("[[shape]]", "[shape]", ("list of tables",)),
        ("[[joint]]", "[[joint", ("malformed TOML",)),
        ("upper_mm = 400", f"upper_mm = {'9' * 5000}", ("malformed TOML", "limit")),
        ("upper_mm = 400", "upper = 400", ("joint 'lift'", "upper holds 400 m, over 100 m", "write upper_mm")),
        ("translation_mm = [300", "translation = [300", ("joint 'turn'", "translation holds 300 m", "write translation_mm")),
        ("size = [0.1", "size = [120", ("shape 1", "size holds 120 m", "write size_mm")),
        ("lower_deg = -90", "lower = -90", ("joint 'turn'", "lower = -90 rad, over 12.57", "write lower_deg = -90")),
    ],
)
def test_toml_refusals(tmp_path, old, new, words):
    text = TOML.replace(old, new, 1)
    assert text != TOML
    refused(write(tmp_path, "arm.toml", text), *words)


@pytest.mark.parametrize(
    "old, new, words",
    [
        ('axis="0 0 1"', 'axis="0 0 0"', ("MuJoCo refuses",)),
        ('type="slide"', 'type="ball"', ("joint 'wrist'", "ball")),
        (
            "</worldbody>",
            f'</worldbody><equality><joint joint1="wrist" joint2="shoulder" {BENT}/></equality>',
            ("'wrist'", "mimic"),
        ),
        ('geom size=".1"', 'geom type="mesh" mesh="m"', ("MuJoCo refuses",)),
        ("<worldbody>", '<compiler texturedir="/etc"/><worldbody>', ("texturedir", "outside")),
        ("<worldbody>", '<asset><hfield name="m" file="../../m.png"/></asset><worldbody>', ("hfield", "outside")),
        ("<worldbody>", '<asset><model name="m" file="../../m.xml"/></asset><worldbody>', ("model", "outside")),
        ("<worldbody>", '<deformable><skin name="m" file="/m.skn"/></deformable><worldbody>', ("skin", "outside")),
        *(
            ("<worldbody>", f'<asset><texture type="cube" {key}="../../m.png"/></asset><worldbody>', (key, "outside"))
            for key in ("file", "fileright", "fileleft", "fileup", "filedown", "filefront", "fileback")
        ),
        ("<worldbody>", '<asset><mesh name="m" file="../../etc/m.stl"/></asset><worldbody>', ("outside",)),
        ("<worldbody>", '<include file="/etc/hostname"/><worldbody>', ("outside",)),
        ("<mujoco>", f"{EXTERNAL.replace('robot', 'mujoco')}<mujoco>", ("entity",)),
        ("<worldbody>", "<world>", ("malformed XML",)),
        ("<body", '<replicate count="100000000"><geom size=".1"/></replicate><body', ("2e+08 elements", "at most 20000")),
        ("<body", NESTED, ("e+09 elements", "at most")),
        ("<body", '<body><flexcomp type="grid" count="999 999 999" name="f"/></body><body', ("9.97e+08", "lower count=")),
    ],
)
def test_mjcf_refusals(tmp_path, old, new, words):
    text = MJCF.replace(old, new, 1)
    assert text != MJCF
    refused(write(tmp_path, "arm.xml", text), *words)
    refused(write(tmp_path, "good.xml", MJCF), "tip 'hand'", "bodies: world, upper, tool", tip="hand")


def test_a_plane_of_an_mjcf_is_told(tmp_path):
    """The plane would be the robot's, without end; one that touches nothing is not told of."""
    floor = lambda bits: MJCF.replace("<worldbody>", f'<worldbody><geom name="floor" type="plane" size="1 1 1" {bits}/>', 1)
    with pytest.warns(UserWarning, match="arm: floor: a plane is left out"):
        robot = jaxik.load(write(tmp_path, "arm.xml", floor("")))
    assert not robot.boxes and {volume.link for volume in robot.volumes} == {*map(robot.link_names.index, ("upper", "tool"))}
    jaxik.load(write(tmp_path, "arm.xml", floor('contype="0" conaffinity="0"')))


def test_files_of_an_attached_model_stay_below_the_folder(tmp_path):
    """A file named in a model's assets is a model itself, with files beside it."""
    model, part = tmp_path / "model", tmp_path / "model" / "part"
    part.mkdir(parents=True)
    attached = '<asset><model name="m" file="part/hand.xml"/></asset><worldbody>'
    path = write(model, "arm.xml", MJCF.replace("<worldbody>", attached, 1))
    write(part, "hand.xml", MJCF)
    assert jaxik.load(path).num_joints == 2
    write(model, "more.xml", '<mujocoinclude><default><geom density="1"/></default></mujocoinclude>')
    write(part, "hand.xml", MJCF.replace("<worldbody>", '<include file="../more.xml"/><worldbody>', 1))
    jaxik.load(path)  # not below part/, and below the model's folder
    (tmp_path / "secret.stl").write_text("solid")
    secret = '<asset><mesh name="s" file="../../secret.stl"/></asset><worldbody>'
    for content in (MJCF.replace("<worldbody>", secret, 1), f"{EXTERNAL.replace('robot', 'mujoco')}{MJCF}", "<robot"):
        write(part, "hand.xml", content)
        with pytest.raises(jaxik.LoadError, match=r"outside|entity|malformed"):
            jaxik.load(path)


def test_copies_of_what_is_included_are_counted(tmp_path):
    """However the file is cut; what is copied often enough is small, or is refused."""
    inside = '<mujocoinclude><replicate count="{}" offset="1 0 0"><geom size=".1"/></replicate></mujocoinclude>'
    outside = '<replicate count="100" offset="0 1 0"><include file="more.xml"/></replicate>'
    path = write(tmp_path, "arm.xml", MJCF.replace("<worldbody>", f"<worldbody>{outside}", 1))
    write(tmp_path, "more.xml", inside.format(1000))
    refused(path, "2e+05 elements by copying", "<replicate>")
    write(tmp_path, "more.xml", inside.format(3))
    assert len(jaxik.load(path, tip="tool").volumes) == 302


def test_a_star_of_links_is_read_in_the_time_of_a_line_of_links(tmp_path):
    """Each joint is looked at a few times, however many hang on one link."""
    count, steps = 1000, 0
    joint = '<link name="l{0}"/><joint name="k{0}" type="fixed"><parent link="upper"/><child link="l{0}"/></joint>'
    star = "".join(joint.format(i) for i in range(count))
    path = write(tmp_path, "arm.urdf", URDF.replace("</robot>", f"{star}</robot>"))

    def step(frame, event, arg):
        nonlocal steps
        steps += 1
        return step if frame.f_code.co_filename == urdf.__file__ else None

    sys.settrace(step)
    try:
        robot = jaxik.load(path, tip="tool")
    finally:
        sys.settrace(None)
    assert len(robot.link_names) == count + 3 and steps < 1000 * count


def test_a_line_is_bounded_whatever_the_names(tmp_path):
    name = "n" * 5000
    many = "".join(f'<link name="{name}{i}"/>' for i in range(50))
    path = write(tmp_path, "arm.urdf", URDF.replace("</robot>", f"{many}</robot>"))
    for options in ({}, {"tip": name}, {"base": name}, {"tip": "tool", "ignore": [(name, "tool")]}):
        with pytest.raises(jaxik.LoadError) as error:
            jaxik.load(path, **options)
        assert len(str(error.value)) < 1500 + len(str(path))


def test_an_include_has_any_root(tmp_path):
    write(tmp_path, "more.xml", '<mujocoinclude><default><geom density="1"/></default></mujocoinclude>')
    path = write(tmp_path, "arm.xml", MJCF.replace("<worldbody>", '<include file="more.xml"/><worldbody>', 1))
    assert jaxik.load(path).num_joints == 2


def test_a_mesh_file_reads_no_other_file(tmp_path):
    """A material library outside of the folder, and an archive that grows, are left alone."""
    mesh = '<link name="tool"><collision><geometry><mesh filename="m.obj"/></geometry></collision></link>'
    path = write(tmp_path, "arm.urdf", URDF.replace('<link name="tool"/>', mesh))
    corners = "\n".join(f"v {x} {y} {z}" for x in (0, 1) for y in (0, 1) for z in (0, 1))
    write(tmp_path, "m.obj", f"mtllib ../secret.mtl\n{corners}\nf 1 2 3\nf 5 6 8\n")
    assert np.allclose(sorted(jaxik.load(path, meshes=True, fit=None).boxes[0].half), 0.5)
    with zipfile.ZipFile(tmp_path / "m.zip", "w") as archive:
        archive.write(tmp_path / "m.obj", "m.obj")
    path = write(tmp_path, "arm.urdf", path.read_text().replace("m.obj", "m.zip"))
    refused(path, "mesh 'm.zip'", "ending '.zip'", ".stl, .obj", meshes=True)


@pytest.mark.parametrize("name", ["../../secret.stl", "/etc/secret.stl", "package://pkg/../secret.stl", "http://host/m.stl"])
def test_meshes_outside_the_folder_are_refused(tmp_path, name):
    (tmp_path / "urdf").mkdir()
    path = write(tmp_path / "urdf", "arm.urdf", with_mesh(name))
    refused(path, "link 'tool'", "mesh", meshes=True)
    assert jaxik.load(path).unread_meshes == ("tool",)  # kinematics need none of it


def with_mesh(name):
    mesh = f'<link name="tool"><collision><geometry><mesh filename="{name}"/></geometry></collision></link>'
    return URDF.replace('<link name="tool"/>', mesh)


def test_a_mesh_that_is_not_there_is_named_with_where_it_was_looked_for(tmp_path, monkeypatch):
    folder = tmp_path / "my_robot" / "urdf"
    folder.mkdir(parents=True)
    arm = lambda name: write(folder, "arm.urdf", with_mesh(name))
    refused(arm("package://elsewhere/a.stl"), "no folder above the file is called 'elsewhere'", "meshes=False", meshes=True)
    refused(arm("package://my_robot/meshes/a.stl"), f"put it at {folder.parent}/meshes/a.stl", meshes=True)
    refused(arm("../meshes/a.stl"), f"put it at {folder.parent}/meshes/a.stl", meshes=True)
    far = f"package://my_robot/{'long/' * 60}the_end.stl"
    refused(arm(far), "...", "the_end.stl' is not found", meshes=True)
    write(folder.parent, "a.dae", "<COLLADA/>")
    monkeypatch.setattr("jaxik.files.mesh.find_spec", lambda name: None)
    refused(arm("../a.dae"), "mesh '../a.dae': reading DAE needs pycollada", 'pip install "jaxik[dae]"', meshes=True)


def test_packages_are_found_as_ros_finds_them(tmp_path, monkeypatch):
    """Above the file, then in `packages`, then in the environment; the package itself, or what holds it, or its repository."""
    for variable in ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH"):
        monkeypatch.delenv(variable, raising=False)
    model = tmp_path / "model"
    model.mkdir()
    path = write(model, "arm.urdf", with_mesh("package://hand/m.obj"))
    edges = {"ws/repo/hand": 1.0, "prefix/share/hand": 2.0, "elsewhere/hand": 3.0, "model/hand": 4.0}
    for place, edge in edges.items():
        corners = "\n".join(f"v {x} {y} {z}" for x in (0, edge) for y in (0, edge) for z in (0, edge))
        (tmp_path / place).mkdir(parents=True)
        write(tmp_path / place, "m.obj", f"{corners}\nf 1 2 3\nf 5 6 8\n")
    size = lambda path, *packages: 2.0 * jaxik.load(path, meshes=True, fit=None, packages=packages).boxes[0].half[0]
    refused(path, "called 'hand'", "packages= (--packages)", "ROS_PACKAGE_PATH or AMENT_PREFIX_PATH", meshes=True)
    assert np.isclose(size(path, tmp_path / "elsewhere"), 3.0) and np.isclose(size(path, str(tmp_path / "elsewhere/hand")), 3.0)
    assert np.isclose(size(path, model, tmp_path / "elsewhere"), 4.0)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "prefix"))
    assert np.isclose(size(path), 2.0)
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"{tmp_path / 'absent'}:{tmp_path / 'ws'}")
    assert np.isclose(size(path), 1.0) and np.isclose(size(path, tmp_path / "elsewhere"), 3.0)
    assert np.isclose(size(write(model / "hand", "arm.urdf", path.read_text()), tmp_path / "elsewhere"), 4.0)
    refused(write(model, "away.urdf", with_mesh("package://hand/../m.obj")), "leaves its package", meshes=True)
    for wrong in ("absent", [tmp_path / "absent"], 3):
        with pytest.raises(ValueError, match=r"^load: packages: .* is no folder"):
            jaxik.load(path, packages=wrong)


def test_a_third_slash_is_no_fault(tmp_path):
    """`package:///name/...` is `package://name/...`, and no way out of the package."""
    folder = tmp_path / "my_robot" / "urdf"
    folder.mkdir(parents=True)
    corners = "\n".join(f"v {x} {y} {z}" for x in (0, 1) for y in (0, 1) for z in (0, 1))
    write(folder.parent, "m.obj", f"{corners}\nf 1 2 3\nf 5 6 8\n")
    path = write(folder, "arm.urdf", with_mesh("package:///my_robot/m.obj"))
    assert len(jaxik.load(path, meshes=True, fit=None).boxes) == 1
    refused(write(folder, "arm.urdf", with_mesh("package:///my_robot/../m.obj")), "leaves its package", meshes=True)
    refused(write(folder, "arm.urdf", with_mesh("package:////etc/m.obj")), "leaves its package", meshes=True)


def test_a_robot_and_a_scene_are_printed_in_a_few_lines():
    robot, scene = jaxik.load("p6r"), jaxik.load_scene("cucumber_row")
    assert len(repr(robot)) < 600 and "slide: prismatic 0 to 1 m" in repr(robot) and "8 links" in repr(robot)
    assert len(repr(scene)) < 300 and "12 marks" in repr(scene)
    seen = []
    jax.jit(lambda robot, scene: seen.append(f"{robot}{scene}"))(robot, scene)
    assert "slide: prismatic" in seen[0]  # traced, too


def test_files_over_the_stated_size_are_refused(tmp_path):
    refused(write(tmp_path, "arm.urdf", b" " * (MAX_BYTES + 1)), str(MAX_BYTES))
    refused(write(tmp_path, "scene.csv", b"label,x,y,z\n" + b" " * MAX_BYTES), str(MAX_BYTES), reader=jaxik.load_scene)


READERS = {".urdf": jaxik.load, ".xml": jaxik.load, ".toml": jaxik.load, ".ply": jaxik.load_scene}
READERS |= {ending: jaxik.load_targets for ending in (".csv", ".npz", ".json")}


@pytest.mark.parametrize("ending", READERS)
def test_a_file_that_is_not_there_is_said_to_be_that(tmp_path, ending):
    refused(tmp_path / f"absent{ending}", "cannot be read (No such file", "check the path", reader=READERS[ending])
    with pytest.raises(jaxik.LoadError, match=r"^((?!malformed).)*$"):
        READERS[ending](tmp_path / f"absent{ending}")
    (tmp_path / f"folder{ending}").mkdir()
    refused(tmp_path / f"folder{ending}", "cannot be read", "directory", reader=READERS[ending])
    refused(write(tmp_path, f"empty{ending}", ""), reader=READERS[ending])
    refused(tmp_path / f"{400 * 'a'}{ending}", "cannot be read", "too long", reader=READERS[ending])
    with pytest.raises(jaxik.LoadError, match="null"):
        READERS[ending](f"a\0{ending}")


SRDF = '<robot name="arm">{}</robot>'
ALONE = '<disable_default_collisions link="{}"/>'
PAIR = '<{}_collisions link1="{}" link2="{}"/>'


@pytest.mark.parametrize(
    "content, checked",
    [
        ("", {"base arm", "base tip"}),
        (PAIR.format("disable", "tip", "base"), {"base arm"}),
        (ALONE.format("base"), set()),
        (ALONE.format("base") + PAIR.format("enable", "base", "arm"), {"base arm"}),
        (ALONE.format("tip") + PAIR.format("enable", "base", "tip") + PAIR.format("disable", "base", "tip"), {"base arm"}),
    ],
)
def test_an_srdf_says_which_pairs_are_checked(tmp_path, content, checked):
    """Pairs are checked as MoveIt reads them: a disabled one stays so even if it is enabled, too."""
    path, srdf = write(tmp_path, "arm.urdf", ARM), write(tmp_path, "arm.srdf", SRDF.format(content))
    robot = jaxik.load(path, srdf=srdf)
    assert {" ".join(robot.link_names[i] for i in pair) for pair in robot.self_pairs} == checked


def test_links_of_an_srdf_that_are_not_there(tmp_path):
    """Links of a larger robot, or misspelt, are told; a file that has no link of the robot is another's."""
    path, pair = write(tmp_path, "arm.urdf", ARM), PAIR.format("disable", "tip", "bse")
    with pytest.warns(UserWarning, match=r"bse: a\.srdf \('arm'\) names these links, .* has not; did you mean 'base'"):
        jaxik.load(path, srdf=write(tmp_path, "a.srdf", SRDF.format(pair)))
    alien = write(tmp_path, "b.srdf", SRDF.format(PAIR.format("disable", "l1", "l2")).replace("arm", "zzz"))
    with pytest.raises(jaxik.LoadError, match=r"b\.srdf: robot 'zzz': none of its links is in this robot; .*links: base, hub"):
        jaxik.load(path, srdf=alien)
    beyond = write(tmp_path, "c.srdf", SRDF.format(PAIR.format("disable", "base", "tip")))
    assert jaxik.load(path, base="hub", srdf=beyond).link_names == ("hub", "arm", "tip")  # the base is the robot's, too


def test_siblings_of_a_robot_file_that_are_not_there(tmp_path):
    arm = write(tmp_path, "arm.urdf", URDF)
    with pytest.raises(jaxik.LoadError, match=r"absent.srdf: file: cannot be read"):
        jaxik.load(arm, srdf=tmp_path / "absent.srdf")
    for reader in (jaxik.load, jaxik.load_scene):
        with pytest.raises(jaxik.LoadError, match="ending ''"):
            reader(tmp_path)
        with pytest.raises(jaxik.LoadError, match="no such shipped"):
            reader("absent")
    with pytest.raises(jaxik.LoadError, match="did you mean 'ur5e'"):
        jaxik.load("UR5e")


def test_nearly_unit_axes_are_made_unit(tmp_path):
    robot = jaxik.load(write(tmp_path, "arm.urdf", URDF.replace('axis xyz="0 0 1"', 'axis xyz="0.577 0.577 0.577"')))
    assert abs(np.linalg.norm(robot.axis[0]) - 1.0) <= 1e-15


# --------------------------------------------------------------------------------------------------------------------
# Targets

LOST = (
    *("w,i,j,k", "roll,pitch,yaw", "Roll,Pitch,Yaw", "rx,ry,rz", "RX,RY,RZ", "a,b,c,d", "A,B,C", "yaw", "yaw_deg", "yaw [rad]"),
    *("rotx,roty,rotz", "rot_x,rot_y,rot_z", "rotation_x,rotation_y,rotation_z", "q0,q1,q2,q3", "q1,q2,q3,q4", "ow,ox,oy,oz"),
    *("q_w,q_x,q_y,q_z", "quat_w,quat_x,quat_y,quat_z", "orientation.w,orientation.x"),
    *(
        "pose.orientation.x",
        "phi,theta,psi",
        "alpha,beta,gamma",
        "r11,r12,r13,r21,r22,r23,r31,r32,r33",
        "euler_x",
        "axis_x,angle",
    ),
    *("w,p,r", "rvec_x,rvec_y,rvec_z", "heading", "wxyz", "tcp_rz_deg", "qi,qj,qk,qr", "nx,ny,nz", "W,P,R"),
)
SPARE = ("i", "name,label,id", "weight", "k,time", "w", "a,b", "rotation_error,position_error", "q1,q2,q3,q4,q5,q6", "ok,row")


@pytest.mark.parametrize("columns", LOST)
def test_a_rotation_by_other_names_is_not_lost(tmp_path, columns):
    count = len(columns.split(","))
    path = write(tmp_path, "targets.csv", f"x,y,z,{columns}\n1,2,3{',0' * count}\n")
    refused(path, "header", columns.split(",")[0], "qw, qx, qy, qz", "position", reader=jaxik.load_targets)


@pytest.mark.parametrize("columns", SPARE)
def test_other_columns_are_not_read(tmp_path, columns):
    count = len(columns.split(","))
    path = write(tmp_path, "targets.csv", f"x,y,z,{columns}\n1,2,3{',0' * count}\n")
    assert np.array_equal(jaxik.load_targets(path), [[1.0, 2.0, 3.0]])
    path = write(tmp_path, "targets.csv", f"x,y,z,{columns},qw,qx,qy,qz,roll\n1,2,3{',0' * count},1,0,0,0,9\n")
    assert jaxik.load_targets(path).shape == (1, 4, 4)  # the rotation is there


@pytest.mark.parametrize(
    "row, words",
    [
        ({"position": [1, 2, 3], "quaternion": [1, 0, 0, 0]}, ("'quaternion'", "wxyz")),
        ({"position": [1, 2, 3], "xyzw": [0, 0, 0, 1]}, ("'xyzw'", "wxyz")),
        ({"position": [1, 2, 3], "rpy": [0, 0, 0]}, ("'rpy'", "wxyz")),
        ({"position": [1, 2, 3], "orientation": {}}, ("'orientation'", "wxyz")),
        ({"position": [[1], [2], [3]]}, ("target 1", "'position' is not 3 numbers")),
        ({"pose": list(range(16))}, ("target 1", "'pose' is not 4 rows of 4 numbers")),
        ({"pose": [list(range(8))] * 2}, ("target 1", "'pose' is not 4 rows of 4 numbers")),
        ({"position": ["1", "2", "3"]}, ("target 1", "'position' is not 3 numbers")),
        ({"position": [True, 2, 3]}, ("target 1", "'position' is not 3 numbers")),
        ({"position": [10**400, 2, 3]}, ("target 1", "'position'")),
        ({"position": {}}, ("target 1", "'position'")),
    ],
)
def test_targets_in_json_are_not_reshaped(tmp_path, row, words):
    refused(write(tmp_path, "targets.json", json.dumps([row])), *words, reader=jaxik.load_targets)


@pytest.mark.parametrize("header", ["x,y,z,{}", "Z,{},Y,X", "y_mm,X_mm,{},z_MM", " {} , z,x,Y"])
def test_columns_stand_in_any_order_and_case(tmp_path, header):
    """Columns of targets do, and those of scenes."""
    names = header.format("i").split(",")
    axes = [name.strip().lower()[0] for name in names]
    row = ",".join({"x": "0.5", "y": "0.25", "z": "2", "i": "leaf"}[axis] for axis in axes)
    factor = 1e-3 if "mm" in header else 1.0
    for label in ("label", "LABEL"):
        scene = jaxik.load_scene(write(tmp_path, "s.csv", f"{header.format(label)}\n{row}\n"))
        assert scene.object_names == ("leaf",) and np.allclose(scene.points.center, factor * np.array([[0.5, 0.25, 2.0]]))
    targets = write(tmp_path, "t.csv", f"{header.format('Qw,QX,qy,Qz')}\n{row.replace('leaf', '0,0,0,1')}\n")
    pose = jaxik.load_targets(targets)[0]
    assert np.allclose(pose[:3, 3], factor * np.array([0.5, 0.25, 2.0])) and np.allclose(np.diag(pose), [-1, -1, 1, 1])


def test_a_number_of_5000_digits_is_the_files_fault(tmp_path):
    for name, reader in (("a.toml", jaxik.load), ("s.toml", jaxik.load_scene)):
        refused(write(tmp_path, name, f'name = "a"\nx = {"9" * 5000}\n'), "document", "5000 digits", reader=reader)


def test_a_target_left_out_in_json(tmp_path):
    assert np.isnan(jaxik.load_targets(write(tmp_path, "t.json", '[{"position": [null, 0, 1]}]'))[0, 0])


@pytest.mark.parametrize(
    "content, words",
    [
        ("x,y,z,x\n1,2,3,4\n", ("column 'x'", "twice")),
        ("x,y,z\n0,5,0,6,0,7\n", ("line 2", "6 fields for 3 columns")),
        ("x;y;z\n0;5;0\n", ("header", "'x;y;z' lacks x, y, z", "separated by commas")),
        ("X,Y,x\n0,5,0\n", ("header", "'X,Y,x' lacks z", "in metres")),
        ("X,y,Z,x\n1,2,3,4\n", ("column 'x'", "twice")),
        ("x_mm,y,z\n0,5,0\n", ("header", "lacks y_mm, z_mm")),
        ("x,y,z,x_mm\n0,5,0,1\n", ("header", "x and x_mm say the same")),
    ],
)
def test_rows_of_another_length(tmp_path, content, words):
    refused(write(tmp_path, "targets.csv", content), *words, reader=jaxik.load_targets)
    assert jaxik.load_targets(write(tmp_path, "good.csv", "x,y,z\n1,2,3,\n")).shape == (1, 3)  # a comma at the end is none


def npy(shape, content=b"", dtype="<f8"):
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": dtype, "fortran_order": False, "shape": shape})
    return head.getvalue() + content


def npz(path, **members):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(f"{name}.npy", content)
    return path


def test_an_npz_is_bounded_by_what_it_holds(tmp_path, monkeypatch):
    """The sizes in the archive and the arrays' headers bound it, before anything is unpacked."""
    monkeypatch.setattr(target_files, "MOST", 2**16)
    bomb = npz(tmp_path / "bomb.npz", positions=npy((100_000, 3), bytes(24 * 100_000)))
    assert bomb.stat().st_size < 2**14
    refused(bomb, "'positions'", "2400128 bytes", "at most 65536", reader=jaxik.load_targets)
    small = npz(tmp_path / "wide.npz", positions=npy((10_000, 3), bytes(30_000), "|i1"))  # eight times that as numbers
    refused(small, "'positions'", "240000 bytes", "at most 65536", reader=jaxik.load_targets)
    liar = npz(tmp_path / "liar.npz", positions=npy((10**12, 3), bytes(24)))
    refused(liar, "'positions'", "at most 65536", reader=jaxik.load_targets)
    short = npz(tmp_path / "short.npz", positions=npy((20, 3), bytes(24)))
    refused(short, "no NPZ of numbers", reader=jaxik.load_targets)
    good = npz(tmp_path / "good.npz", positions=npy((2, 3), bytes(48)), others=npy((100_000, 3), bytes(24 * 100_000)))
    assert jaxik.load_targets(good).shape == (2, 3)  # others are not read


@pytest.mark.parametrize(
    "arrays, words",
    [
        ({"positions": np.zeros((2, 3), complex)}, ("'positions'", "complex128")),
        ({"positions": np.array([["1", "2", "3"]])}, ("'positions'", "<U1")),
        ({"positions": np.zeros((2, 3), bool)}, ("'positions'", "bool")),
        ({"positions": np.zeros((2, 3)), "quaternions": np.zeros((2, 4))}, ("'quaternions'", "wxyz")),
        ({"positions": np.zeros((2, 3)), "rotations": np.zeros((2, 3, 3))}, ("'rotations'", "wxyz")),
        ({"positions": np.array(1.0)}, ("shape ()", "(N, 3)")),
    ],
)
def test_arrays_of_targets(tmp_path, arrays, words):
    np.savez(tmp_path / "t.npz", **arrays)
    refused(tmp_path / "t.npz", *words, reader=jaxik.load_targets)


HANDS = ("left", "right")
OBJECT = {"position": [1, 2, 3], "wxyz": [1, 0, 0, 0]}


def test_targets_of_several_tips(tmp_path):
    """Columns, arrays and objects of each tip are the same targets, in the order of `tips`."""
    wxyz = np.array([[[1.0, 0.0, 0.0, 0.0], [0.6, 0.8, 0.0, 0.0]], [[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 0.0]]])
    places = np.arange(12.0).reshape(2, 2, 3)
    head = "Right_z,right_y,RIGHT_X,left_x_mm,left_y_mm,left_z_mm"
    head += "".join(f",{hand}_{name}" for hand in HANDS for name in ("qw", "qx", "qy", "qz"))
    rows = [[*place[1, ::-1], *1e3 * place[0], *turn.ravel()] for place, turn in zip(places, wxyz, strict=True)]
    table = "\n".join([head, *(",".join(map(str, row)) for row in rows)])
    objects = [
        {hand: {"position": [*place[i]], "wxyz": [*turn[i]]} for i, hand in enumerate(HANDS)}
        for place, turn in zip(places, wxyz, strict=True)
    ]
    np.savez(tmp_path / "t.npz", positions=places, wxyz=wxyz)
    files = write(tmp_path, "t.csv", table), tmp_path / "t.npz", write(tmp_path, "t.json", json.dumps(objects))
    for file in files:
        poses = jaxik.load_targets(file, tips=HANDS)
        assert poses.shape == (2, 2, 4, 4) and np.allclose(poses[..., :3, 3], places)
        turned = Rotation.from_quat(wxyz[[0, 0, 1], [0, 1, 0]], scalar_first=True).as_matrix()
        assert np.allclose(poses[[0, 0, 1], [0, 1, 0], :3, :3], turned) and not poses[1, 1, :3, :3].any()
    np.savez(tmp_path / "p.npz", positions=places)
    assert np.array_equal(jaxik.load_targets(tmp_path / "p.npz", tips=HANDS), places)


@pytest.mark.parametrize(
    "name, content, words",
    [
        ("t.csv", "x,y,z\n1,2,3\n", ("lacks left_x, left_y, left_z", "(left_x, right_x)")),
        ("t.csv", "left_x,left_y,left_z,right_x,right_y\n1,2,3,1,2\n", ("lacks right_z",)),
        ("t.csv", "left_x,left_y,left_z,left_qw,left_qx,left_qy,left_qz,right_x,right_y,right_z\n", ("lacks right_qw",)),
        ("t.csv", "left_x,left_y,left_z,right_x,right_y,right_z,right_roll\n", ("'right_roll' looks like", "right_qw")),
        ("t.csv", "left_x,left_y,left_z,right_x,right_y,right_z\n1,2,3,4,5,a\n", ("line 2, column 'right_z'", "'a'")),
        ("t.csv", "left_x,left_x_mm,left_y,left_z\n1,2,3,4\n", ("left_x and left_x_mm say the same",)),
        ("t.json", json.dumps([OBJECT]), ("target 1: has no object 'left'", '"right": {"position"')),
        ("t.json", json.dumps([{"left": OBJECT, "right": {"position": [1, 2, 3]}}]), ("other keys for one tip", "all alike")),
        ("t.json", json.dumps([{"left": OBJECT, "right": OBJECT | {"wxyz": [1]}}]), ("target 1, right: 'wxyz'",)),
    ],
)
def test_targets_that_are_not_those_of_the_tips(tmp_path, name, content, words):
    refused(write(tmp_path, name, content), *words, reader=lambda path: jaxik.load_targets(path, tips=HANDS))


def test_arrays_of_other_tips(tmp_path):
    np.savez(tmp_path / "t.npz", positions=np.zeros((5, 3)))
    with pytest.raises(jaxik.LoadError, match=r"positions: has shape \(5, 3\); allowed: \(N, 2, 3\), for left, right"):
        jaxik.load_targets(tmp_path / "t.npz", tips=HANDS)


# --------------------------------------------------------------------------------------------------------------------
# Fuzz


def _mutated(sample):
    """Files near a good one: pieces cut out, doubled, replaced by bytes, numbers and words that mean something elsewhere."""
    words = [
        "nan",
        "inf",
        "-1e400",
        "0",
        "",
        "<",
        ">",
        '"',
        "[",
        "]]",
        "=",
        "\x00",
        "../",
        "\ud7ff",
        "9" * 400,
        "true",
        "#",
        "&lt;",
    ]
    piece = st.one_of(st.sampled_from(words), st.binary(max_size=6).map(lambda b: b.decode("latin-1")))
    binary = isinstance(sample, bytes)  # a character a byte, there and back
    text = sample.decode("latin-1") if binary else sample
    cut = st.tuples(st.integers(0, len(text)), st.integers(0, 30), piece)

    def apply(cuts):
        result = text
        for start, length, new in cuts:
            result = result[:start] + new + result[start + length :]
        return result.encode("latin-1", "replace") if binary else result.encode("utf-8", "surrogatepass")

    return st.lists(cut, min_size=1, max_size=4).map(apply)


FUZZ = settings(max_examples=150, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])


def _survives(reader, path):
    try:
        found = reader(path)
    except jaxik.LoadError as error:
        assert "\n" not in str(error)
        return
    if isinstance(found, np.ndarray):
        assert found.shape[1:] in ((3,), (4, 4))
        return
    leaves = jax.tree_util.tree_leaves(found) if isinstance(found, jaxik.Scene) else [found.parent_T_joint]
    assert all(np.all(np.isfinite(x)) for x in leaves)


def packed(**arrays):
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    return file.getvalue()


NPZ = packed(positions=np.ones((2, 3)), wxyz=np.ones((2, 4)))
CELL = """name = "cell"
[[object]]
name = "a"
boxes = [[0.5, 0, -0.1, 1, 1, 0.1]]
cylinders = [[0.5, 0, 0, 0.1, 1]]
rotations = [[[1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, -1, 0], [1, 0, 0], [0, 0, 1]]]
[[mark]]
name = "b"
position = [0, 0, 0]
spheres = [[0, 0, 0, 0.1]]
"""
CSV = "label,x,y,z\nleaf_1,0.1,0.7,0.5\nfruit_1,0.1,0.7,0.4\nfruit_1,0.1,0.7,0.2\n"


def ply(rows, names):
    header = ["ply", "format binary_little_endian 1.0", *(f"comment label {i} {n}" for i, n in names.items())]
    header += [f"element vertex {len(rows)}", "property float x", "property float y", "property float z"]
    head = "\n".join([*header, "property int label", "end_header"]) + "\n"
    return head.encode() + b"".join(struct.pack("<fffi", *row) for row in rows)


PLY = ply([(0.1, 0.7, 0.5, 1), (0.1, 0.7, 0.4, 2), (0.1, 0.7, 0.2, 2)], {1: "leaf_1", 2: "fruit_1"})


@pytest.mark.parametrize(
    "reader, name, sample",
    [
        *((jaxik.load, name, sample) for name, sample in FILES.items()),
        (jaxik.load_scene, "scene.toml", SCENE),
        (jaxik.load_scene, "cell.toml", CELL),
        (jaxik.load_targets, "targets.csv", "x,y,z,qw,qx,qy,qz\n0.1,0.2,0.3,1,0,0,0\n0.2,0.2,0.3,0,1,0,0\n"),
        (jaxik.load_targets, "targets.json", '[{"position": [1, 2.5, null], "wxyz": [1, 0, 0, 0]}]'),
        (jaxik.load_targets, "targets.npz", NPZ),
        (jaxik.load_scene, "scene.csv", CSV),
        (jaxik.load_scene, "scene.ply", PLY),
    ],
)
@FUZZ
@given(data=st.data())
def test_fuzz(tmp_path, reader, name, sample, data):
    _survives(reader, write(tmp_path, name, data.draw(st.one_of(_mutated(sample), st.binary(max_size=200)))))


# --------------------------------------------------------------------------------------------------------------------
# What good files give


@pytest.mark.parametrize("name, content", [("scene.csv", CSV), ("scene.ply", PLY)])
def test_labelled_points(tmp_path, name, content):
    scene = jaxik.load_scene(write(tmp_path, name, content))
    assert scene.object_names == ("leaf_1", "fruit_1") and scene.removable == (True, False)
    assert np.allclose(scene.points.center, [[0.1, 0.7, 0.5]], atol=1e-7)
    assert np.allclose(scene.marks[0].position, (0.1, 0.7, 0.3), atol=1e-7)


def test_a_label_of_two_words(tmp_path):
    content = ply([(0.1, 0.7, 0.5, 1), (0.1, 0.7, 0.4, 2)], {1: "old leaf ", 2: "fruit_1"})
    assert jaxik.load_scene(write(tmp_path, "scene.ply", content)).object_names == ("old leaf", "fruit_1")


@pytest.mark.parametrize(
    "content, words",
    [
        ("a,b\n", ("line 1", "label,x,y,z")),
        ("label,x,y,z\nleaf,1,2\n", ("line 2",)),
        ("label,x,y,z\nleaf,1,2,3,4\n", ("line 2",)),
        ("label,x,y,z\n ,1,2,3\n", ("line 2",)),
        ("label,x,y,z,radius\nleaf,1,2,3,4\n", ("line 1", "column 'radius' is not read")),
        ("label,x,y,z,X\nleaf,1,2,3,4\n", ("line 1", "column 'x' stands twice")),
        ("label,x,y,z\nleaf,1,2,nan\nfruit_1,0,0,0\n", ("'leaf'", "NaN")),
        ("label,x,y,z\nleaf,1,2,300\nfruit_1,0,0,0\n", ("'leaf'", "300 m, over 100 m", "millimetres")),
        ("label,x,y,z\n", ("neither an object nor a mark",)),
    ],
)
def test_bad_points_are_one_line(tmp_path, content, words):
    refused(write(tmp_path, "scene.csv", content), *words, reader=jaxik.load_scene)


@pytest.mark.filterwarnings("ignore:panda. these pairs of links are not checked")  # `test_fit` holds that it is said
def test_srdf_disables_pairs(tmp_path):
    file, tip = ROBOTS["panda"]
    hand = ["panda_hand", "panda_leftfinger", "panda_rightfinger"]
    pairs = list(map(frozenset, itertools.combinations([*(f"panda_link{i}" for i in range(9)), *hand], 2)))
    left, out = frozenset(("panda_link0", "panda_link6")), frozenset(("panda_link1", "panda_link5"))

    def checked(name, kept):
        entries = ['<disable_collisions link1="{}" link2="{}" reason="Never"/>'.format(*p) for p in pairs if p not in kept]
        srdf = write(tmp_path, name, f'<robot name="panda">{"".join(entries)}</robot>')
        robot = jaxik.load(
            FOLDER / file, tip=tip, meshes=True, fit=jaxik.FitOptions(accuracy=0.1, most=2), srdf=srdf, posture={}
        )
        return {frozenset((robot.link_names[a], robot.link_names[b])) for a, b in robot.self_pairs}

    assert checked("two.srdf", (left, out)) == {left, out} and checked("one.srdf", (left,)) == {left}
    refused(write(tmp_path, "bad.srdf", "<robot><disable_collisions link1='a'/></robot>"), "link2", reader=lambda p: jaxik.load(
        FOLDER / file, tip=tip, srdf=p))  # fmt: skip


@pytest.mark.filterwarnings("ignore:panda. its boxes touch")  # `test_fit` holds that it is said
def test_meshes_of_a_real_robot_lie_in_their_spheres():
    import trimesh

    file, tip = ROBOTS["panda"]
    with pytest.raises(ValueError, match="meshes=True"):
        jaxik.clearance(jaxik.load(FOLDER / file, tip=tip), None, np.zeros(7))
    robot = jaxik.load(FOLDER / file, tip=tip, meshes=True, fit=None, posture={})
    q = np.zeros(robot.num_joints)
    centres, radii = jaxik.collision.robot_spheres(robot, q)
    frames = dict(zip(robot.link_names, np.asarray(jaxik.kinematics.link_frames(robot, q)), strict=True))
    for i in range(1, 8):
        mesh = trimesh.load(FOLDER / f"panda_description/meshes/collision/link{i}.stl", force="mesh")
        points = np.asarray(mesh.vertices) @ frames[f"panda_link{i}"][:3, :3].T + frames[f"panda_link{i}"][:3, 3]
        inside = np.linalg.norm(points[:, None] - centres, axis=-1) <= radii + 1e-6
        assert np.all(inside.any(axis=1))


def test_targets_in_millimetres(tmp_path):
    """A unit stands in the key, as in the other files."""
    (tmp_path / "mm.csv").write_text("x_mm,y_mm,z_mm,qw,qx,qy,qz\n500,-250,0,1,0,0,0\n")
    (pose,) = jaxik.load_targets(tmp_path / "mm.csv")
    assert np.array_equal(pose[:3, 3], [0.5, -0.25, 0.0]) and np.array_equal(pose[:3, :3], np.eye(3))


PLY = """ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
0 0 0
{} 0 0
0 1 0
3 0 1 {}
"""


@pytest.mark.parametrize(
    "corner, last, why", [(1, 99999999, "cannot be read"), (1, -1, "cannot be read"), ("1e38", 2, "100 m")]
)
def test_a_mesh_that_is_no_surface_is_refused_in_one_line(tmp_path, corner, last, why):
    (file := tmp_path / "part.ply").write_text(PLY.format(corner, last))
    with pytest.raises(LoadError, match=why) as told:
        load_mesh(file)
    assert "\n" not in str(told.value)


def test_pairs_are_checked_in_any_case_without_a_fit_too(tmp_path):
    """They were read, and forgotten."""
    joints = [("j1", "revolute", "base", "a", "0.3 0 0", "0 0 1", ""), ("j2", "revolute", "a", "b", "0.3 0 0", "0 0 1", "")]
    path = write(tmp_path, "balls.urdf", tree_of_balls("balls", ["base", "a", "b"], joints, 0.05, 0.1))
    names = lambda robot: {frozenset(robot.link_names[i] for i in pair) for pair in robot.self_pairs}
    asked, every = frozenset(("base", "a")), {frozenset(pair) for pair in itertools.combinations(("base", "a", "b"), 2)}
    plain = jaxik.load(path, meshes=True)
    jaxik.save(plain, tmp_path / "balls.toml")
    for file, more in ((path, {}), (path, {"fit": None}), (tmp_path / "balls.toml", {})):
        found = lambda pairs, file=file, more=more: names(jaxik.load(file, meshes=True, pairs=pairs, **more))
        assert found([("base", "a")]) == names(plain) | {asked} > names(plain)
        assert found("all") == every


def test_a_continuous_joint_is_held_anywhere(tmp_path):
    """URDF files give it a <limit>, of velocity and effort alone, whose ends are none."""
    limit = '<limit velocity="2" effort="3"/></joint>\n</robot>'
    path = write(tmp_path, "arm.urdf", URDF.replace("</joint>\n</robot>", limit))
    robot = jaxik.load(path, held={"wrist": 5.0})
    assert robot.joint_names == ("shoulder",)
    assert jaxik.load(path).velocity.tolist() == [2.0, 2.0] and np.isinf(jaxik.load(path).upper[1])
