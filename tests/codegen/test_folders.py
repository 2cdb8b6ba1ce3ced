"""Exported folders as their user has them: compiled by a C compiler without Python, or called by a Python without JAX."""

import dataclasses
import json
import os
import re
import shutil
import subprocess
import sys

import jax.numpy as jnp
import numpy as np
import pytest
from peers.panda import TIP, urdf_file

import jaxik
from jaxik.cli.export import ExportArguments
from jaxik.codegen import export_robot
from jaxik.codegen.archive import Member, archive

pytestmark = pytest.mark.kernels(reason="machine code is made by llvmlite")
BARE = {"PATH": "/usr/bin:/bin"}
compiled = pytest.mark.skipif(shutil.which("gcc", path=BARE["PATH"]) is None, reason="a C compiler")
DYNAMICS = ["pose", "jacobian", "inverse_dynamics", "mass_matrix", "forward_dynamics"]


def shell(folder, *command, **more):
    ran = subprocess.run(command, cwd=folder, capture_output=True, text=True, **more)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    return ran.stdout


@compiled
@pytest.mark.parametrize("double", [False, True])
def test_a_folder_passes_its_own_test_without_python(double, tmp_path):
    names = DYNAMICS[:3] if double else DYNAMICS
    made = export_robot(jaxik.load(str(urdf_file()), tip=TIP), names, tmp_path, name="panda", double=double)
    strict = ["-std=c11", "-O1", "-Wall", "-Wextra", "-Wno-unused-function", "-pedantic", "-Werror"]
    for program in ("main", "test"):
        shell(tmp_path, "gcc", *strict, f"{program}.c", "libpanda.a", "-o", program, env=BARE)
    told = shell(tmp_path, "./test", env=BARE)
    assert told.count(" 0 ulp apart") == len(names) and "all as computed" in told
    assert "panda_pose: pose =" in shell(tmp_path, "./main", env=BARE)
    header = tmp_path / "cxx.cpp"
    header.write_text('#include "panda.h"\nint main() { return sizeof(&panda_pose) == 0; }\n')
    shell(tmp_path, "gcc", "-Wall", "-Wextra", "-pedantic", "-Werror", "-c", "cxx.cpp", env=BARE)
    symbols = shell(tmp_path, "nm", "libpanda.a", env=BARE)
    assert not re.findall(r"^ +U .*$", symbols, re.M)  # no malloc, no C library, nothing
    assert not re.findall(r"^\S+ [dDbBC] ", symbols, re.M)  # no globals but constants
    assert len(re.findall(r"^\S+ T ", symbols, re.M)) == 2 * len(made.functions)


@compiled
def test_a_wrong_number_fails_the_test(tmp_path):
    export_robot(jaxik.load("planar2"), ["pose"], tmp_path)
    text = (tmp_path / "test.c").read_text()
    number = re.search(r"planar2_pose_pose\[\d+\] = {([^,]+),", text).group(1)
    (tmp_path / "test.c").write_text(text.replace(f"= {{{number},", "= {0x1.8p-3f,", 1))
    shell(tmp_path, "gcc", "test.c", "libplanar2.a", "-o", "test")
    assert subprocess.run(["./test"], cwd=tmp_path, capture_output=True).returncode == 1


@compiled
def test_python_without_jax(tmp_path):
    cloud = np.linspace(-1, 1, 60).reshape(20, 3)
    nearest = lambda x, points: (jnp.min(jnp.linalg.norm(points - x, axis=1)), jnp.mean(points, axis=0))
    told = {"x": "a place [m]", "nearest": "distances"}
    jaxik.export(
        nearest,
        (np.zeros(3), cloud),
        tmp_path,
        name="nearest",
        shared=["points"],
        results=["distance", "middle"],
        words=told,
        python=True,
    )
    program = """
import json, sys
import numpy as np
import nearest
cloud, x = np.linspace(-1, 1, 60).reshape(20, 3), np.random.default_rng(0).normal(size=(9, 3))
one, many = nearest.nearest(x[4], cloud), nearest.nearest(x.tolist(), cloud)
try:
    nearest.nearest(np.zeros(2), cloud)
except ValueError as error:
    refused = str(error)
print(json.dumps({
    "modules": [m for m in ("jax", "jaxik", "jaxlib", "scipy") if m in sys.modules],
    "one": [x.tolist() for x in one], "many": [x.tolist() for x in many], "types": [str(x.dtype) for x in many],
    "refused": refused, "doc": nearest.nearest.__doc__,
}))
"""
    bare = BARE | {"LD_LIBRARY_PATH": os.environ.get("LD_LIBRARY_PATH", "")}
    found = json.loads(shell(tmp_path, sys.executable, "-c", program, env=bare))
    x = np.random.default_rng(0).normal(size=(9, 3))
    wanted = np.linalg.norm(cloud[None] - x[:, None], axis=2).min(axis=1)
    np.testing.assert_allclose(found["many"][0], wanted, rtol=1e-6)
    np.testing.assert_allclose(found["many"][1], np.tile(cloud.mean(axis=0), (9, 1)), atol=1e-7)
    assert found["one"][0] == found["many"][0][4] and found["one"][1] == found["many"][1][4]
    assert found["types"] == ["float32", "float32"] and not found["modules"]
    assert "x has shape (2,); write (3,)" in found["refused"]
    assert "a place [m]" in found["doc"]


def test_the_command_writes_a_folder(tmp_path, capsys):
    ExportArguments(robot="planar2", functions="pose, jacobian", out=tmp_path, target="aarch64").run()
    told = capsys.readouterr().out
    assert "planar2_jacobian" in told and "CMakeLists.txt" in told
    assert {p.name for p in tmp_path.iterdir()} == {
        *("README.md", "CMakeLists.txt", "main.c", "test.c", "planar2.h", "planar2_robot.h", "libplanar2.a")
    }
    assert "aarch64" in (tmp_path / "README.md").read_text()
    with pytest.raises(ValueError, match="--functions poses: choose of pose, jacobian, "):
        ExportArguments(robot="planar2", functions="pose,poses", out=tmp_path).run()


def test_a_robot_in_a_scene(tmp_path):
    ExportArguments(
        robot="crops_v2", functions="clearance,clearance_to_spheres,mass_matrix", scene="cucumber_row", out=tmp_path
    ).run()
    header = (tmp_path / "crops_v2.h").read_text()
    for name in ("clearance", "clearance_to_spheres", "mass_matrix"):
        assert f"void crops_v2_{name}(" in header
    assert "in spheres: [4096][4], centres and radii [m] in the world" in header


@compiled
def test_an_archive_is_ars(tmp_path):
    contents = {"a_name_that_is_longer_than_sixteen.o": b"one", "b.o": b"twelve bytes", "c.o": b""}
    (tmp_path / "x.a").write_bytes(archive([Member(name, data, [name[:-2]]) for name, data in contents.items()]))
    assert shell(tmp_path, "ar", "t", "x.a").split() == list(contents)
    for name, data in contents.items():
        assert shell(tmp_path, "ar", "p", "x.a", name).encode() == data


def test_somebody_elses_text_is_left_as_it_is(tmp_path):
    (tmp_path / "README.md").write_text("mine")
    with pytest.raises(ValueError, match=r"README.md is there, and is none of jaxik's; give another folder") as told:
        export_robot(jaxik.load("planar2"), ["pose"], tmp_path)
    assert "\n" not in str(told.value) and [p.name for p in tmp_path.iterdir()] == ["README.md"]
    assert (tmp_path / "README.md").read_text() == "mine"


def test_an_export_takes_the_place_of_the_one_before(tmp_path):
    """A program may have the library open, which is another file from then on."""
    for functions in (["pose"], ["pose", "jacobian"]):
        before = (tmp_path / "libplanar2.a").stat().st_ino if functions[1:] else None
        export_robot(jaxik.load("planar2"), functions, tmp_path)
    assert (tmp_path / "libplanar2.a").stat().st_ino != before and "jacobian" in (tmp_path / "test.c").read_text()
    assert not [p for p in tmp_path.iterdir() if p.name.startswith(".")]


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_names_of_any_letters(tmp_path):
    robot = dataclasses.replace(jaxik.load("planar2"), name='a*/ /*"b"\\N ü😀', joint_names=('"q\\1', "ü😀?"))
    export_robot(robot, ["pose"], tmp_path, name="REALBITS", python=True)
    asked = ["cc", "-std=c11", "-Wall", "-Wextra", "-pedantic", "-Werror", "main.c", "libREALBITS.a", "-o", "main"]
    assert not subprocess.run(asked, cwd=tmp_path, capture_output=True, text=True).stderr
    told = '#include <stdio.h>\n#include "REALBITS_robot.h"\nint main(void) { puts(REALBITS_joint_names[0]); '
    (tmp_path / "told.c").write_text(told + "puts(REALBITS_joint_names[1]); return 0; }\n")
    subprocess.run(["cc", "told.c", "-o", "told"], cwd=tmp_path, check=True)
    assert subprocess.run(["./told"], cwd=tmp_path, capture_output=True).stdout.decode().split() == list(robot.joint_names)
    compile((tmp_path / "REALBITS.py").read_text(), "REALBITS.py", "exec")
