"""Loaders: every refusal is one line that names file, element and mend; nothing but LoadError comes out of any bytes."""

import struct

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from robots import FOLDER, ROBOTS

import jaxik
from jaxik.collision import world_volumes
from jaxik.load.assemble import MAX_BYTES

URDF = """<robot name="arm"><link name="base"/><link name="upper"/><link name="tool"/>
<joint name="shoulder" type="revolute"><origin xyz="0 0 0.1"/><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" velocity="2" effort="1"/></joint>
<joint name="wrist" type="continuous"><origin xyz="0.3 0 0"/><parent link="upper"/><child link="tool"/><axis xyz="0 1 0"/>
</joint>
</robot>"""
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
SCENE = """name = "s"
[[object]]
name = "leaf"
points = [[0.1, 0.7, 0.5]]
[[fruit]]
name = "fruit_1"
position = [0.1, 0.7, 0.4]
"""
FILES = {"arm.urdf": URDF, "arm.toml": TOML, "arm.xml": MJCF}


def write(folder, name, content):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def refused(path, *words, reader=jaxik.load, **options):
    with pytest.raises(jaxik.LoadError) as error:
        reader(path, **options)
    line = str(error.value)
    assert "\n" not in line and path.name in line and all(w in line for w in words), line


@pytest.mark.parametrize("name", FILES)
def test_the_samples_are_good(tmp_path, name):
    chain = jaxik.load(write(tmp_path, name, FILES[name]))
    assert chain.num_joints == 2 and np.all(np.isfinite(jaxik.forward_kinematics(chain, np.zeros(2))))


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
        ('<axis xyz="0 1 0"/>', '<axis xyz="0 1 0"/><mimic joint="shoulder"/>', ("joint 'wrist'", "mimic")),
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
    refused(tmp_path / "absent.urdf", "cannot be read")
    refused(write(tmp_path, "arm.sdf", URDF), "ending '.sdf'", ".urdf")
    with pytest.raises(jaxik.LoadError, match="shipped: chembuly9"):
        jaxik.load("panda")


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
        ("[[shape]]", "[shape]", ("list of tables",)),
        ("[[joint]]", "[[joint", ("malformed TOML",)),
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
        ("</worldbody>", '</worldbody><equality><joint joint1="wrist" joint2="shoulder"/></equality>', ("'wrist'", "mimic")),
        ('geom size=".1"', 'geom type="mesh" mesh="m"', ("MuJoCo refuses",)),
        ("<worldbody>", '<asset><mesh name="m" file="../../etc/m.stl"/></asset><worldbody>', ("outside",)),
        ("<worldbody>", '<include file="/etc/hostname"/><worldbody>', ("outside",)),
        ("<mujoco>", f"{EXTERNAL.replace('robot', 'mujoco')}<mujoco>", ("entity",)),
        ("<worldbody>", "<world>", ("malformed XML",)),
    ],
)
def test_mjcf_refusals(tmp_path, old, new, words):
    text = MJCF.replace(old, new, 1)
    assert text != MJCF
    refused(write(tmp_path, "arm.xml", text), *words)
    refused(write(tmp_path, "good.xml", MJCF), "tip 'hand'", "bodies: world, upper, tool", tip="hand")


@pytest.mark.parametrize("name", ["../../secret.stl", "/etc/secret.stl", "package://pkg/../secret.stl", "http://host/m.stl"])
def test_meshes_outside_the_folder_are_refused(tmp_path, name):
    (tmp_path / "urdf").mkdir()
    mesh = f'<link name="tool"><collision><geometry><mesh filename="{name}"/></geometry></collision></link>'
    path = write(tmp_path / "urdf", "arm.urdf", URDF.replace('<link name="tool"/>', mesh))
    refused(path, "link 'tool'", "mesh")


def test_files_over_the_stated_size_are_refused(tmp_path):
    refused(write(tmp_path, "arm.urdf", b" " * (MAX_BYTES + 1)), str(MAX_BYTES))
    refused(write(tmp_path, "scene.csv", b"label,x,y,z\n" + b" " * MAX_BYTES), str(MAX_BYTES), reader=jaxik.load_scene)


def test_nearly_unit_axes_are_made_unit(tmp_path):
    chain = jaxik.load(write(tmp_path, "arm.urdf", URDF.replace('axis xyz="0 0 1"', 'axis xyz="0.577 0.577 0.577"')))
    assert abs(np.linalg.norm(chain.axis[0]) - 1.0) <= 1e-15


# --------------------------------------------------------------------------------------------------------------------
# Fuzz


def _mutated(text):
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
    cut = st.tuples(st.integers(0, len(text)), st.integers(0, 30), piece)

    def apply(cuts):
        result = text
        for start, length, new in cuts:
            result = result[:start] + new + result[start + length :]
        return result.encode("utf-8", "surrogatepass")

    return st.lists(cut, min_size=1, max_size=4).map(apply)


FUZZ = settings(max_examples=150, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])


def _survives(reader, path):
    try:
        found = reader(path)
    except jaxik.LoadError as error:
        assert "\n" not in str(error)
        return
    numbers = found.parent_T_joint if isinstance(found, jaxik.Chain) else found.points.center
    assert np.all(np.isfinite(numbers))


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
        (jaxik.load_scene, "scene.csv", CSV),
        (jaxik.load_scene, "scene.ply", PLY.decode("latin-1")),
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
    assert np.allclose(scene.fruits[0].position, (0.1, 0.7, 0.3), atol=1e-7)


@pytest.mark.parametrize(
    "content, words",
    [
        ("a,b\n", ("line 1", "label,x,y,z")),
        ("label,x,y,z\nleaf,1,2\n", ("line 2",)),
        ("label,x,y,z\nleaf,1,2,nan\nfruit_1,0,0,0\n", ("'leaf'", "NaN")),
        ("label,x,y,z\nleaf,1,2,300\nfruit_1,0,0,0\n", ("'leaf'", "300 m, over 100 m", "millimetres")),
        ("label,x,y,z\n", ("neither an object nor a fruit",)),
    ],
)
def test_bad_points_are_one_line(tmp_path, content, words):
    refused(write(tmp_path, "scene.csv", content), *words, reader=jaxik.load_scene)


def test_srdf_disables_pairs(tmp_path):
    file, tip = ROBOTS["panda"]
    pairs = '<disable_collisions link1="panda_link1" link2="panda_link4" reason="Never"/>'
    srdf = write(tmp_path, "panda.srdf", f'<robot name="panda">{pairs}</robot>')
    named = lambda chain: {frozenset((chain.link_names[a], chain.link_names[b])) for a, b in chain.self_pairs}
    every, fewer = (named(jaxik.load(FOLDER / file, tip=tip, meshes=True, srdf=s)) for s in (None, srdf))
    assert every - fewer == {frozenset(("panda_link1", "panda_link4"))}
    refused(write(tmp_path, "bad.srdf", "<robot><disable_collisions link1='a'/></robot>"), "link2", reader=lambda p: jaxik.load(
        FOLDER / file, tip=tip, srdf=p))  # fmt: skip


def test_meshes_of_a_real_robot_lie_in_their_spheres():
    import trimesh

    file, tip = ROBOTS["panda"]
    with pytest.raises(ValueError, match="meshes=True"):
        world_volumes(jaxik.load(FOLDER / file, tip=tip), np.zeros(7))
    chain = jaxik.load(FOLDER / file, tip=tip, meshes=True)
    q = np.zeros(chain.num_joints)
    centres, radii = jaxik.link_spheres(chain, q)
    frames = dict(zip(chain.link_names, np.asarray(jaxik.link_frames(chain, q)), strict=True))
    for i in range(1, 8):
        mesh = trimesh.load(FOLDER / f"panda_description/meshes/collision/link{i}.stl", force="mesh")
        points = np.asarray(mesh.vertices) @ frames[f"panda_link{i}"][:3, :3].T + frames[f"panda_link{i}"][:3, 3]
        inside = np.linalg.norm(points[:, None] - centres, axis=-1) <= radii + 1e-6
        assert np.all(inside.any(axis=1))
