"""Meshes: faces of any number of corners, units, links and odd scales, against areas known by hand and trimesh."""

import os
import struct

import numpy as np
import pytest
import trimesh
from robot_files import URDF, refused, write
from scipy.spatial import ConvexHull

import jaxik
from jaxik.files import load_mesh

NOTCHED = ((0, 0), (2, 0), (2, 2), (1, 0.5), (0, 2))  # an area of 2.5; a fan from the first corner has 3.5
DART = ((0, 0), (2, 0), (0.5, 0.5), (0, 2))  # a reflex corner in a quad: 1, and 1 the other way
LONG = "a" * 5000 + ".stl"


def area(triangles):
    return np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1).sum() / 2.0


def in_space(corners):
    """On a slope, as a file rounds it."""
    return [(x, y, round(0.3 * x - 0.7 * y, 4)) for x, y in corners]


def obj(points, faces):
    """With textures behind the corners, lines that go on, and each second face counted back from its end."""
    lines = [f"v {x} {y} {z} 0.5 0.5 0.5 # grey" for x, y, z in points] + ["vt 0 0", "g part", "usemtl none"]
    for k, face in enumerate(faces):
        index = [i - len(points) if k % 2 else i + 1 for i in face]
        lines.append("f " + " ".join(f"{i}/1" for i in index[:2]) + " \\\n " + " ".join(f"{i}/1" for i in index[2:]))
    return "\n".join([*lines, "v 9 9 9"]).encode()  # and a corner of no face


def off(points, faces):
    rows = [f"{x} {y} {z} 255 0 0" for x, y, z in points] + [f"{len(f)} {' '.join(map(str, f))} 1 0 0" for f in faces]
    return "\n".join(["COFF # colours", f"{len(points)} {len(faces)} 0", *rows]).encode()


def ply(points, faces, order="<"):
    kind = "binary_little_endian" if order == "<" else "binary_big_endian"
    head = f"ply\nformat {kind} 1.0\ncomment x\nelement vertex {len(points)}\nproperty float x\nproperty float y\n"
    head += f"property float z\nproperty uchar red\nelement face {len(faces)}\nproperty uchar flag\n"
    head += "property list uchar int vertex_index\nproperty float area\nend_header\n"
    body = b"".join(struct.pack(f"{order}fffB", *p, 7) for p in points)
    return head.encode() + body + b"".join(struct.pack(f"{order}BB{len(f)}if", 1, len(f), *f, 0.5) for f in faces)


def dae(points, faces, unit='<unit name="m" meter="1"/>', node="", material=""):
    flat = lambda rows: " ".join(str(x) for row in rows for x in row)
    return f"""<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset>{unit}</asset>
<library_geometries><geometry id="g"><mesh><source id="p"><float_array id="a" count="{3 * len(points)}">{flat(points)}
</float_array><technique_common><accessor source="#a" count="{len(points)}" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices><polylist count="{len(faces)}" material="m">
<input semantic="VERTEX" source="#v" offset="0"/><vcount>{" ".join(str(len(f)) for f in faces)}</vcount><p>{flat(faces)}</p>
</polylist></mesh></geometry></library_geometries><library_visual_scenes><visual_scene id="s"><node>{node}
<instance_geometry url="#g">{material}</instance_geometry></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>""".encode()


WRITERS = {"m.obj": obj, "m.off": off, "m.ply": ply, "big.ply": lambda p, f: ply(p, f, ">"), "m.dae": dae}


@pytest.mark.parametrize("name", WRITERS)
def test_a_face_that_is_not_convex_is_cut_inside_of_it(tmp_path, name):
    """Together with a triangle, both ways around, warped by rounding; a corner that no face has is left out."""
    points = [*in_space(NOTCHED), *((x, y, z + 1.0) for x, y, z in in_space(DART))]
    slope = float(np.linalg.norm((0.3, 0.7, 1.0)))
    for faces, flat in (
        ([[0, 1, 2, 3, 4]], 2.5),
        ([[4, 3, 2, 1, 0], [0, 1, 3]], 3.0),
        ([[5, 6, 7, 8], [3, 4, 0, 1, 2], [1, 0, 3]], 4.0),
        ([[8, 7, 6, 5]], 1.0),
    ):
        found = load_mesh(write(tmp_path, name, WRITERS[name](points, faces)))
        assert np.isclose(area(found), slope * flat, rtol=1e-3), faces
        assert len(found) == sum(len(face) - 2 for face in faces) and np.abs(found).max() < 3.0
        normal = np.cross(found[:, 1] - found[:, 0], found[:, 2] - found[:, 0])[:, 2]
        given = np.array(points)[np.array(faces[0])]  # Newell's: all triangles of a face are seen from where it is
        side = np.cross(given, np.roll(given, -1, axis=0)).sum(axis=0)[2]
        assert np.all(normal[: len(faces[0]) - 2] * side > 0.0)


def test_random_stars_have_their_area(tmp_path):
    """Star-shaped polygons of up to 40 corners; the shoelace formula is the oracle."""
    rng = np.random.default_rng(0)
    for n in rng.integers(4, 40, 40):
        turn = np.sort(rng.uniform(0.0, 2.0 * np.pi, n))
        if np.diff(turn, append=turn[0] + 2.0 * np.pi).max() > 3.0:
            continue
        flat = rng.uniform(0.2, 1.0, n)[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        x, y = flat.T
        true = abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) / 2.0
        points = [(*each, 0.0) for each in flat.tolist()]
        found = load_mesh(write(tmp_path, "m.obj", obj(points, [range(n)])))
        assert np.isclose(area(found), true, rtol=1e-9) and len(found) == n - 2


@pytest.mark.parametrize("kind", ["obj", "off", "ply", "dae"])
def test_is_read_as_trimesh_reads_it(tmp_path, kind):
    """Triangles alone, as trimesh writes them."""
    mesh = trimesh.creation.icosphere(2)
    mesh.export(tmp_path / f"m.{kind}")
    found = load_mesh(tmp_path / f"m.{kind}")
    assert np.allclose(found, mesh.triangles, atol=1e-6)


BOX = trimesh.creation.box((1.0, 2.0, 3.0))
MIRROR = "<scale>-1 1 1</scale>"


@pytest.mark.parametrize(
    "unit, factor", [("", 1.0), ('<unit meter="0.001"/>', 1e-3), ('<unit name="inch" meter="0.0254"/>', 0.0254)]
)
@pytest.mark.parametrize("node", ["", "<translate>1 0 0</translate>", MIRROR])
def test_the_unit_of_a_dae_counts(tmp_path, unit, factor, node):
    """The unit scales what nodes do, too; a mirror turns no surface inside out, and a missing material takes none away."""
    paint = '<bind_material><technique_common><instance_material symbol="m" target="#no"/></technique_common></bind_material>'
    path = write(tmp_path, "m.dae", dae(BOX.vertices.tolist(), BOX.faces.tolist(), unit, node, paint))
    found = load_mesh(path)
    assert np.allclose(np.ptp(found, axis=(0, 1)), factor * np.array([1.0, 2.0, 3.0]), rtol=1e-6)
    assert np.allclose(found.mean(axis=(0, 1)), factor * np.array([1.0 if "translate" in node else 0.0, 0.0, 0.0]), atol=1e-6)
    volume = np.einsum("ki,ki->", found[:, 0], np.cross(found[:, 1], found[:, 2])) / 6.0
    assert np.isclose(volume, 6.0 * factor**3, rtol=1e-5)
    for wrong in ("0", "-1", "nan"):
        write(tmp_path, "m.dae", dae(BOX.vertices.tolist(), BOX.faces.tolist(), f'<unit meter="{wrong}"/>'))
        refused(path, "cannot be read", reader=load_mesh)


def with_mesh(name, scale="1 1 1"):
    mesh = f'<link name="tool"><collision><geometry><mesh filename="{name}" scale="{scale}"/></geometry></collision></link>'
    return URDF.replace('<link name="tool"/>', mesh)


def test_names_of_any_length_are_refused_in_one_line(tmp_path):
    (tmp_path / "pkg").mkdir()
    for name in (LONG, f"package://pkg/{LONG}", f"package://{LONG}/a.stl"):
        refused(write(tmp_path / "pkg", "arm.urdf", with_mesh(name)), "is not found", meshes=True)
    scene = f'name = "s"\n[[object]]\nname = "a"\nmeshes = [{{file = "{LONG}"}}]\n'
    refused(write(tmp_path, "scene.toml", scene), "is not found", reader=jaxik.load_scene)
    with pytest.raises(jaxik.LoadError, match="is not found"):
        load_mesh(LONG)
    mjcf = f'<mujoco><asset><mesh name="m" file="{LONG}"/></asset><worldbody><body name="b"><joint/><geom size=".1"/></body>'
    path = write(tmp_path, "arm.xml", f"{mjcf}</worldbody></mujoco>")
    refused(path, "MuJoCo refuses", meshes=True)
    assert jaxik.load(path).num_joints == 1


def test_links_of_a_package_are_followed(tmp_path):
    """Links are followed as `colcon build --symlink-install` makes them; elsewhere their ends lie outside."""
    (folder := tmp_path / "pkg").mkdir()
    BOX.export(tmp_path / "away.stl")
    os.symlink(tmp_path / "away.stl", folder / "here.stl")
    found = jaxik.load(write(folder, "arm.urdf", with_mesh("package://pkg/here.stl")), meshes=True, fit=None)
    assert np.allclose(sorted(found.boxes[0].half), [0.5, 1.0, 1.5])
    for name in ("here.stl", f"file://{folder}/here.stl", "../away.stl", "package://pkg/../away.stl", f"{tmp_path}/away.stl"):
        refused(write(folder, "arm.urdf", with_mesh(name)), name.rpartition("/")[2], meshes=True)


@pytest.mark.parametrize(
    "scale, words",
    [
        ("1 0 1", ("scale '1 0 1' makes it flat", "other than 0")),
        ("1e300 0 -1", ("scale '1e+300 0 -1' makes it flat",)),
        ("1e300 1e300 1e300", ("reaches", "100 m")),
        ("1e38 1 1", ("reaches 5e+37 m",)),
        ("1 nan 1", ("'scale'", "3 finite")),
    ],
)
def test_scales_that_make_no_mesh(tmp_path, scale, words):
    BOX.export(tmp_path / "box.stl")
    refused(write(tmp_path, "arm.urdf", with_mesh("box.stl", scale)), "link 'tool'", *words, meshes=True)


def test_a_mirrored_mesh_is_a_mesh(tmp_path):
    """A negative scale, as one mesh for both hands has it."""
    mesh = trimesh.convex.convex_hull(np.random.default_rng(0).normal(size=(20, 3)) * 0.05)
    mesh.export(tmp_path / "hand.stl")
    robot = jaxik.load(write(tmp_path, "arm.urdf", with_mesh("hand.stl", "1 -1 1")), meshes=True)
    hull = ConvexHull(mesh.vertices * (1.0, -1.0, 1.0))
    deepest = max(float((hull.equations[:, :3] @ c + hull.equations[:, 3]).max()) for v in robot.volumes for c in v.corners)
    assert len(robot.volumes) and deepest < 0.02  # the capsules' axes lie in the mirrored hull


def test_a_mirrored_mesh_is_not_inside_out(tmp_path):
    trimesh.creation.box((0.1, 0.2, 0.3)).export(tmp_path / "box.stl")
    shape = '<collision><geometry><mesh filename="box.stl" scale="{}"/></geometry></collision>'
    for scale in ("1 1 1", "1 -1 1", "-1 -1 -1"):
        path = write(
            tmp_path, "arm.urdf", URDF.replace('<link name="tool"/>', f'<link name="tool">{shape.format(scale)}</link>')
        )
        (surface,) = jaxik.load(path, meshes=True, exact=True).surfaces
        first, second, third = np.moveaxis(surface.corners, 1, 0)
        volume = np.sum(first * np.cross(second, third)) / 6.0
        assert volume == pytest.approx(0.006, rel=1e-6)
