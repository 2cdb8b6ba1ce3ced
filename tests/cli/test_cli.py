"""The command: what it writes, how it refuses, and that nothing half-written stays."""

import csv
import dataclasses
import json
import os
import subprocess
import sys

import numpy as np
import pyarrow.parquet
import pytest
import trimesh
from robot_files import ARM, POST, write

import jaxik
from jaxik import cli
from jaxik.cli.harvest import _print_table, write_harvest
from jaxik.cli.results import print_table
from jaxik.harvesting import Blockers

GRID = {"kind": "grid", "x": [0, 1, 2], "y": [0.5, 0.8, 2], "z": [0.3, 0.5, 2]}
SCENE = """name = "bench"
point_radius = 0.01
[[object]]
name = "leaf_1"
points = [[0.55, 0.62, 0.4], [0.55, 0.62, 0.5]]
[[mark]]
name = "near"
position = [0.5, 0.66, 0.6]
length = 0.3
radius = 0.02
[[mark]]
name = "far"
position = [0.5, 9.0, 0.6]
"""


def call_unsolved(monkeypatch, *words):
    """A command that ends with 1: not all that was asked has an answer."""
    with pytest.raises(SystemExit) as left:
        call(monkeypatch, *words)
    assert left.value.code == 1


def call(monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["jaxik", *map(str, arguments)])
    cli.main()


def test_it_writes_table_picture_and_arrays(tmp_path):
    scene, out = tmp_path / "bench.toml", tmp_path / "out"
    scene.write_text(SCENE)
    command = ["harvest", "--scene", scene, "--out", out, "--angles", "24", "--slides", "9", "--freedom-weight", "1"]
    environment = {**os.environ, "COLUMNS": "200"}
    code = "from jaxik.cli import main; main()"
    done = subprocess.run([sys.executable, "-c", code, *map(str, command)], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1].startswith("2 fruits: 1 solved, 1 out of reach; 3456 candidates in ")
    assert sorted(p.name for p in out.iterdir()) == ["harvest.png", "postures.csv", "postures.npz"]
    with np.load(out / "postures.npz", allow_pickle=False) as arrays:
        q = arrays["q"][list(arrays["fruit"]).index("near")]
        assert list(arrays["reason"]) == ["solved", "out of reach"] and np.all(np.isnan(arrays["q"][1]))
    rows = list(csv.DictReader((out / "postures.csv").read_text().splitlines()))
    robot = jaxik.load("p6r")
    assert np.allclose([float(rows[0][name]) for name in robot.joint_names], q)
    tip = robot.world_T_base @ np.asarray(jaxik.forward_kinematics(robot, q))
    assert np.allclose(tip[:3, 3], (0.5, 0.66, 0.6), atol=2e-6)
    assert (out / "harvest.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.parametrize(
    "arguments, words",
    [
        (("--scene", "broken.toml"), ("broken.toml", "malformed TOML")),
        (("--scene", "absent.toml"), ("absent.toml", "cannot be read")),
        (("--scene", "greenhouse"), ("no such shipped scene", "cucumber_row")),
        (("--robot", "crops_v2"), ("needs the closed form", "given 3 values")),
        (("--angles", "0"), ("--angles 0", "at least 1")),
        (("--leaves", "brush", "--approach", "0.2"), ("--leaves, --approach: of motions; add --motions",)),
    ],
)
def test_a_mistake_is_one_line_and_exit_code_2(tmp_path, monkeypatch, capsys, arguments, words):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(cli, "compilation_cache", lambda: None)
    (tmp_path / "broken.toml").write_text("[broken")
    with pytest.raises(SystemExit) as exit:
        call(monkeypatch, "harvest", *arguments)
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("jaxik: ")]
    assert exit.value.code == 2 and len(lines) == 1 and all(w in lines[0] for w in words), lines
    assert sorted(p.name for p in tmp_path.iterdir()) == ["broken.toml"]


@pytest.fixture(scope="module")
def harvested(tmp_path_factory):
    scene = tmp_path_factory.mktemp("bench") / "bench.toml"
    scene.write_text(SCENE)
    return jaxik.harvest(jaxik.load("p6r"), jaxik.load_scene(scene), angles=8, slides=5)


def fails(*_):
    raise OSError("disk full")


def draws(_, path):
    path.write_bytes(b"a picture")


def contents(folder):
    return {p.name: p.read_bytes() for p in folder.iterdir()}


def test_a_failed_write_leaves_the_old_files(harvested, tmp_path, monkeypatch):
    out = tmp_path / "out"
    out.mkdir()
    (out / "postures.csv").write_text("old")
    monkeypatch.setattr("jaxik.view.plot_harvest", fails)
    with pytest.raises(OSError, match="disk full"):
        write_harvest(harvested, out)
    assert contents(out) == {"postures.csv": b"old"}
    with pytest.raises(OSError, match="disk full"):
        write_harvest(harvested, tmp_path / "new" / "out")
    assert [p.name for p in tmp_path.rglob("*") if p.name != "new"] == ["out", "postures.csv"]


@pytest.mark.parametrize("number", range(3))
def test_what_cannot_be_replaced_leaves_all_the_old_files(harvested, tmp_path, monkeypatch, number):
    """Whichever of the three it is; one that was not there is not there again, and what else lies in the folder stays."""
    monkeypatch.setattr("jaxik.view.plot_harvest", draws)
    out, replace, calls = tmp_path / "out", os.replace, []
    out.mkdir()
    for name in ("harvest.png", "postures.csv", "notes.txt"):
        (out / name).write_text(f"old {name}")
    before = contents(out)

    def once(source, target):
        if "postures" in str(target) or "harvest.png" in str(target):
            calls.append(target)
            if len(calls) == number + 1:
                raise PermissionError(f"{target}: no")
        replace(source, target)

    monkeypatch.setattr(os, "replace", once)
    with pytest.raises(PermissionError):
        write_harvest(harvested, out)
    assert contents(out) == before
    monkeypatch.setattr(os, "replace", replace)
    write_harvest(harvested, out)
    after = contents(out)
    assert set(after) == {*before, "postures.npz"} and after["notes.txt"] == b"old notes.txt"
    assert not any(after[name].startswith(b"old") for name in set(after) - {"notes.txt"})


def test_a_new_folder_has_the_mode_of_others(harvested, tmp_path, monkeypatch):
    monkeypatch.setattr("jaxik.view.plot_harvest", draws)
    (tmp_path / "other").mkdir()
    write_harvest(harvested, tmp_path / "deep" / "out")
    assert (tmp_path / "deep" / "out").stat().st_mode == (tmp_path / "other").stat().st_mode
    assert [p.name for p in (tmp_path / "deep").iterdir()] == ["out"]


def test_an_out_that_is_a_file_is_told_first(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(jaxik, "harvest", lambda *_, **__: pytest.fail("computed"))
    monkeypatch.setattr(jaxik, "solve_ik", lambda *_, **__: pytest.fail("computed"))
    monkeypatch.setattr(cli, "compilation_cache", lambda: None)
    (tmp_path / "file").write_text("")
    (tmp_path / "ik.csv").mkdir()
    assert "is a file" in refused(monkeypatch, capsys, "harvest", "--out", tmp_path / "file")
    assert "is a folder" in refused(monkeypatch, capsys, "ik", "p6r", "absent.csv", "--out", tmp_path / "ik.csv")


def test_what_hides_a_fruit_is_named():
    found = Blockers(("stem_1", "wire", "leaf_1", "leaf_2"), (0.9, 0.3, 0.2, 0.1), None, None)
    assert found.words == "behind stem_1, wire, leaf_1" and found.in_the_way == ("stem_1", "wire", "leaf_1")
    assert found._replace(removal=("leaf_1",)).words == "take away leaf_1"
    both = found._replace(removal=("leaf_1", "leaf_2"), pick_first=("fruit_1", "fruit_2", "fruit_3"))
    assert both.words == "pick fruit_1, fruit_2 and fruit_3, take away leaf_1 and leaf_2"
    assert found._replace(names=(), share=()).words == "the robot hits itself"


def test_units_are_said(harvested, tmp_path, monkeypatch, capsys):
    """The table, which once took brackets for a style, and the header say them; the arrays keep their names."""
    monkeypatch.setenv("COLUMNS", "240")
    monkeypatch.setattr("jaxik.view.plot_harvest", draws)
    _print_table(dataclasses.replace(harvested, scene=dataclasses.replace(harvested.scene, name="bench [red]")))
    printed = " ".join(capsys.readouterr().out.split())
    assert "clearance [mm]" in printed and "bench [red]" in printed
    write_harvest(harvested, tmp_path / "out")
    header = next(csv.reader((tmp_path / "out" / "postures.csv").read_text().splitlines()))
    assert {"fruit", "reason", "angle [rad]", "clearance [m]", "position_error [m]", "rotation_error [rad]"} < set(header)
    with np.load(tmp_path / "out" / "postures.npz", allow_pickle=False) as arrays:
        assert {"fruit", "reason", "angle", "clearance", "position_error", "rotation_error", "q"} < set(arrays)


def test_names_and_numbers_of_a_wide_table_are_not_cut(monkeypatch, capsys):
    """An arm of eight joints with long names fits: the leaves to take away are what the table is for."""
    monkeypatch.setenv("COLUMNS", "80")
    headings = (
        "fruit",
        "result",
        "lift",
        *(f"panda_joint{i}" for i in range(1, 8)),
        "clearance [mm]",
        "freedom",
        "found by, or remove",
    )
    rows = [["fruit_11", "solved", "0.020", *["-120.4"] * 7, "21", "0.42", "grid"]]
    rows.append(["fruit_12", "collision", *[""] * 10, "leaf_12_2, leaf_11_10"])
    print_table("panda_lift in row [1]", headings, rows)
    printed = capsys.readouterr().out
    assert "…" not in printed and printed.count("-120.4") == 7
    assert all(word in printed for word in ("fruit_11", "collision", "leaf_12_2,", "leaf_11_10", "freedom"))
    assert all(line[-1] in "┓┃┩│┘" for line in printed.splitlines()[1:])  # no line is cut


@pytest.mark.parametrize("option, words", [(("--reach", "0"), "reach is 0"), (("--raech", "1"), "raech")])
def test_a_mistake_in_an_option_names_it(monkeypatch, capsys, option, words):
    with pytest.raises(SystemExit) as exit:
        call(monkeypatch, "harvest", *option)
    assert exit.value.code == 2 and words in capsys.readouterr().err


def refused(monkeypatch, capsys, *arguments):
    """The one line of a call that is refused."""
    with pytest.raises(SystemExit) as exit:
        call(monkeypatch, *arguments)
    printed = capsys.readouterr().err.splitlines()  # a progress bar among them
    lines = [line for line in printed if line.startswith("jaxik: ")]
    assert exit.value.code == 2 and len(lines) == 1 and printed[-1] == lines[0], printed
    return lines[0]


def stopped(*_, **__):
    raise ValueError("far enough")


MESHES = """<robot name="arm"><link name="base"><collision><geometry><mesh filename="box.stl"/></geometry></collision></link>
<link name="upper"><collision><origin xyz="0.4 0 0"/><geometry><mesh filename="box.stl"/></geometry></collision></link>
<link name="finger"><collision><origin xyz="0.7 0 0"/><geometry><mesh filename="box.stl"/></geometry></collision></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1"/></joint>
<joint name="slide" type="prismatic"><parent link="upper"/><child link="finger"/><axis xyz="1 0 0"/>
<limit lower="0" upper="0.1"/></joint></robot>"""


def test_meshes_are_asked_for(tmp_path, monkeypatch, capsys):
    """A scene's need of meshes is said before anything compiles, and they can be given."""
    monkeypatch.setattr(cli, "compilation_cache", lambda: None)
    file, targets = write(tmp_path, "arm.urdf", MESHES), write(tmp_path, "targets.csv", "x,y,z\n0.4,0.1,0.4\n")
    trimesh.creation.box((0.1, 0.1, 0.1)).export(tmp_path / "box.stl")
    words = ("ik", file, targets, "--tip", "upper", "--scene", "cucumber_row", "--out", tmp_path / "ik.csv")
    monkeypatch.setattr("jaxik.ik.solve.search", stopped)
    line = refused(monkeypatch, capsys, *words)
    assert "far enough" in line  # they are read unless one asks not to
    line = refused(monkeypatch, capsys, *words, "--no-meshes")
    assert "meshes of base" in line and "--no-meshes" in line
    seen = []
    monkeypatch.setattr(jaxik, "solve_ik", lambda robot, *_, **__: stopped(seen.append(robot)))
    read = "--posture", "slide=0.03"
    assert "far enough" in refused(monkeypatch, capsys, *words, *read) and seen[0].volumes and not seen[0].unread_meshes
    monkeypatch.setattr(jaxik, "harvest", lambda robot, *_, **__: stopped(seen.append(robot)))
    line = refused(monkeypatch, capsys, "harvest", "--robot", file, "--tip", "upper", *read)
    assert "far enough" in line and seen[1].volumes


def test_drivers_say_what_is_missing_before_they_compile(monkeypatch):
    bare, scene = dataclasses.replace(jaxik.load("p6r"), boxes=()), jaxik.load_scene("cucumber_row")
    half = dataclasses.replace(jaxik.load("p6r"), unread_meshes=("upper_arm_link",))
    for place in (
        "jaxik.ik.solve.search",
        "jaxik.harvesting.scanning._candidates",
        "jaxik.reach.scoring.closed_forms",
        "jaxik.analytic.solutions.closed_forms",
    ):
        module, _, name = place.rpartition(".")
        monkeypatch.setattr(sys.modules[module], name, lambda *_, **__: pytest.fail("compiled"))
    for robot, words in ((bare, "no collision geometry"), (half, "meshes of upper_arm_link")):
        study = {"robot": robot, "collision": {"scene": scene}, "targets": {"kind": "crop"}}
        for driver in (
            lambda robot: jaxik.solve_ik(robot, np.eye(4), scene=scene),
            lambda robot: jaxik.harvesting.scan(robot, scene, scene.marks[0]),
            lambda robot: jaxik.harvest(robot, scene),
            lambda robot: jaxik.reach.likely_postures(robot, scene, np.eye(4)[None]),
            lambda robot, study=study: jaxik.sweeps.Study.of(study | {"targets": GRID}),
        ):
            with pytest.raises(ValueError, match=words) as error:
                driver(robot)
            assert "\n" not in str(error.value)


def test_a_cell_without_a_fruit(tmp_path, monkeypatch, capsys):
    """The cell is in the way of inverse kinematics and of a sweep; only a harvest needs fruits."""
    monkeypatch.setattr(cli, "compilation_cache", lambda: None)
    cell, targets = tmp_path / "cell.toml", tmp_path / "targets.csv"
    cell.write_text('name = "cell"\n[[object]]\nname = "table"\nboxes = [[0.5, 0, -0.1, 1, 1, 0.1]]\n')
    targets.write_text("x,y,z\n0.5,0.6,0.4\n")
    seen = []
    monkeypatch.setattr(jaxik, "solve_ik", lambda robot, poses, *, scene, **__: stopped(seen.append(scene)))
    assert "far enough" in refused(monkeypatch, capsys, "ik", "p6r", targets, "--scene", cell)
    assert seen[0].object_names == ("table",)
    study = jaxik.sweeps.Study.of({"robot": "p6r", "collision": {"scene": str(cell)}, "targets": GRID})
    assert study.scene.counts["boxes"] == 1
    line = refused(monkeypatch, capsys, "harvest", "--scene", cell, "--out", tmp_path / "out")
    assert "scene 'cell' has no fruit" in line
    monkeypatch.setattr("jaxik.view.Page", lambda *_, **__: stopped())
    assert "far enough" in refused(monkeypatch, capsys, "view", "p6r", "--scene", cell)
    assert "no fruit" in refused(monkeypatch, capsys, "view", "p6r", "--scene", cell, "--harvest")


@pytest.mark.parametrize(
    "targets, words",
    [
        ({"kind": "grid", "x": [-800, 800, 5], "y": [-800, 800, 5], "z": [0, 900, 5]}, "p6r, which reaches .* millimetres?"),
        ({"kind": "grid", "x": [300, 800, 5], "y": [600, 600, 1], "z": [400, 400, 1], "frame": "base"}, "millimetres?"),
        ({"kind": "file", "poses": [[500.0, 600.0, 400.0]]}, "millimetres?"),
        ({"kind": "voxels", "size": 50}, "millimetres?"),
    ],
)
def test_a_study_in_millimetres(targets, words):
    with pytest.raises(ValueError, match=words) as error:
        jaxik.sweeps.Study.of({"robot": "p6r", "targets": targets})
    assert "\n" not in str(error.value) and "targets: " in str(error.value)


def test_a_study_that_is_far_away_or_says_its_unit():
    far = {"kind": "grid", "x": [4.0, 5.0, 3], "y": [0.2, 0.9, 3], "z": [0.0, 1.0, 3]}
    assert len(jaxik.sweeps.Study.of({"robot": "p6r", "targets": far}).targets) == 27
    small = {"kind": "grid", "x_mm": [-300, 1300, 17], "y_cm": [20, 90, 8], "z": [0, 1, 11]}
    axes = jaxik.sweeps.Study.of({"robot": "p6r", "targets": small}).targets.axes
    assert [len(a) for a in axes] == [17, 8, 11] and np.allclose([a[[0, -1]] for a in axes[:2]], [[-0.3, 1.3], [0.2, 0.9]])


@pytest.mark.parametrize("typo, words", [("target", "did you mean 'targets'"), ("colision", "did you mean 'collision'")])
def test_a_misspelt_table_of_a_study_is_named(typo, words):
    for study in ({"robot": "p6r", typo: GRID}, {"robot": "absent", typo: GRID}, {typo: GRID, "targets": GRID}):
        with pytest.raises(ValueError, match=f"unknown key '{typo}'.*{words}"):
            jaxik.sweeps.Study.of(study)


def test_version(monkeypatch, capsys):
    call(monkeypatch, "--version")
    assert capsys.readouterr().out == f"jaxik {jaxik.__version__}\n"


def test_about(monkeypatch, capsys):
    call(monkeypatch, "about")
    assert capsys.readouterr().out == f"jaxik {jaxik.__version__}\n"


def wxyz(rotation):
    import pinocchio as pin

    x, y, z, w = pin.Quaternion(rotation).coeffs()
    return w, x, y, z


def targets_file(path, poses):
    """The same poses in the format of the ending."""
    rows = [(*pose[:3, 3], *wxyz(pose[:3, :3])) for pose in poses]
    if path.suffix == ".csv":
        lines = ["name,x,y,z,qw,qx,qy,qz", *(",".join(["target", *map(repr, map(float, row))]) for row in rows)]
        path.write_text("\n".join(lines))
    elif path.suffix == ".json":
        path.write_text(json.dumps([{"position": list(row[:3]), "wxyz": list(row[3:])} for row in rows]))
    else:
        np.savez(path, poses=np.array(poses))
    return path


def test_ik_writes_the_answers_of_any_file(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(cli, "compilation_cache", lambda: None)
    robot = jaxik.load("chembuly9")
    q = np.random.default_rng(0).uniform(robot.lower, robot.upper, (5, robot.num_joints))
    poses = [np.asarray(jaxik.forward_kinematics(robot, row)) for row in q]
    poses[3] = poses[3] + np.pad([[7.0]], ((0, 3), (3, 0)))  # seven metres away
    tables = []
    for ending in (".csv", ".npz", ".json"):
        out = tmp_path / f"answers{ending}.{'NPZ' if ending == '.json' else 'npz'}"  # by any letters
        call_unsolved(monkeypatch, "ik", "chembuly9", targets_file(tmp_path / f"targets{ending}", poses), "--out", out)
        lines = capsys.readouterr().out.splitlines()
        assert lines[0] == "out of reach: 1" and lines[1].startswith("4 of 5 targets solved in ")
        with np.load(out, allow_pickle=False) as arrays:
            tables.append(dict(arrays))
        assert tuple(tables[-1]["joint_names"]) == robot.joint_names
        assert list(tables[-1]["reason"]) == ["solved"] * 3 + ["out of reach", "solved"]
    for i in (0, 1, 2, 4):
        np.testing.assert_allclose(jaxik.forward_kinematics(robot, tables[0]["q"][i]), poses[i], atol=2e-6)
    np.testing.assert_allclose(tables[1]["q"], tables[2]["q"], atol=1e-5)
    out = tmp_path / "table.csv"
    call_unsolved(monkeypatch, "ik", "chembuly9", tmp_path / "targets.csv", "--out", out)
    rows = list(csv.DictReader(out.read_text().splitlines()))
    assert [row["reason"] for row in rows] == list(tables[0]["reason"])
    assert np.array_equal([[float(row[name]) for name in robot.joint_names] for row in rows], tables[0]["q"], equal_nan=True)
    for name, unit in (("position_error", "m"), ("rotation_error", "rad"), ("clearance", "m")):
        assert np.array_equal([float(row[f"{name} [{unit}]"]) for row in rows], tables[0][name], equal_nan=True)
    millimetres = [np.vstack([np.column_stack([p[:3, :3], 1000.0 * p[:3, 3]]), p[3:]]) for p in poses]
    call_unsolved(monkeypatch, "ik", "chembuly9", targets_file(tmp_path / "mm.json", millimetres), "--out", out)
    printed = capsys.readouterr()
    assert "out of reach: 5" in printed.out.splitlines()
    assert "warning: solve_ik: targets lie" in printed.err and "chembuly9, which reaches" in printed.err
    out = tmp_path / "positions.parquet"
    (tmp_path / "positions.csv").write_text("x,y,z\n" + "\n".join(",".join(map(str, p[:3, 3])) for p in poses))
    call_unsolved(monkeypatch, "ik", "chembuly9", tmp_path / "positions.csv", "--out", out)
    assert capsys.readouterr().out.splitlines()[0].startswith("position only: ")
    table = pyarrow.parquet.read_table(out).to_pydict()
    assert table["reason"] == ["solved"] * 3 + ["out of reach", "solved"] and set(robot.joint_names) < set(table)


@pytest.mark.parametrize(
    "content, ending, words",
    [
        ("x,y\n1,2\n", ".csv", ("header", "lacks z")),
        ("x,y,z,qw\n1,2,3,1\n", ".csv", ("header", "qx, qy, qz")),
        ("x,y,z\n1,2,three\n", ".csv", ("line 2", "'z'", "three")),
        ("x,y,z\n1,2\n", ".csv", ("line 2", "'z'")),
        ("[{]", ".json", ("malformed JSON",)),
        ("{}", ".json", ("list of objects",)),
        ('[{"place": 1}]', ".json", ("position", "wxyz")),
        ('[{"position": [1, 2]}]', ".json", ("target 1", "'position'")),
        ('[{"position": [1, 2, 3]}, {"pose": 1}]', ".json", ("all alike",)),
        ("no zip", ".npz", ("no NPZ",)),
        ("", ".txt", ("'.txt'", ".csv, .npz, .json")),
    ],
)
def test_targets_are_refused_in_one_line(tmp_path, monkeypatch, capsys, content, ending, words):
    path = tmp_path / f"targets{ending}"
    path.write_text(content)
    with pytest.raises(SystemExit) as caught:
        call(monkeypatch, "ik", "planar2", path, "--out", tmp_path / "ik.npz")
    line = capsys.readouterr().err.strip()
    assert caught.value.code == 2 and "\n" not in line and all(w in line for w in (path.name, *words)), line
    assert not (tmp_path / "ik.npz").exists()


def test_ik_refuses_an_ending_that_it_cannot_write(tmp_path, monkeypatch, capsys):
    with pytest.raises(SystemExit):
        call(monkeypatch, "ik", "planar2", "absent.csv", "--out", tmp_path / "ik.xlsx")
    assert ".npz, .csv, .parquet" in capsys.readouterr().err
    np.savez(tmp_path / "wrong.npz", poses=np.zeros((2, 3, 3)))
    np.savez_compressed(tmp_path / "cut.npz", poses=np.random.default_rng(0).normal(size=(50, 4, 4)))
    content = bytearray((tmp_path / "cut.npz").read_bytes())
    content[200:400] = bytes(200)
    (tmp_path / "cut.npz").write_bytes(content)
    with open(tmp_path / "one.npz", "wb") as file:
        np.save(file, np.zeros(3))  # an NPY by its content
    cases = ("wrong.npz", "(2, 3, 3)"), ("cut.npz", "no NPZ"), ("one.npz", "no NPZ"), ("absent.csv", "cannot be read")
    for file, words in cases:
        with pytest.raises(SystemExit):
            call(monkeypatch, "ik", "planar2", tmp_path / file)
        assert words in capsys.readouterr().err


def test_a_fit_is_told_and_written(tmp_path, monkeypatch, capsys):
    """A row a mesh, and a file that holds what was fitted."""
    monkeypatch.setattr("jaxik.spmd.cache.cache_folder", lambda: tmp_path / "made")  # here, and once
    (tmp_path / "arm.urdf").write_text(ARM)
    for name in ("model.toml", "model.urdf"):
        call(monkeypatch, "fit", tmp_path / "arm.urdf", "--accuracy", 15, "--to", tmp_path / name)
        *table, counts, wrote = capsys.readouterr().out.splitlines()
        robot = jaxik.load(tmp_path / "arm.urdf", meshes=True, fit=jaxik.FitOptions(accuracy=0.015))
        parts, volumes = len(robot.convex_parts), len(robot.volumes)
        assert counts.startswith(f"{parts} convex parts, {volumes} volumes, 1 pairs of links to check, ")
        rows = [[word.strip() for word in line.split("\u2502")[1:-1]] for line in table if line.startswith("\u2502")]
        links, pairs = rows[:2], rows[2:]
        assert [row[:5:2] for row in links] == [["base", "1", "yes"], ["arm", "1", "yes"]]
        assert sum(int(row[3]) for row in links) == len(robot.volumes) - 1 and {row[5] for row in links} == {"100.0%"}
        assert {(*row[:2], row[2]) for row in pairs} == {
            ("base", "arm", "yes"),
            ("base", "tip", "no: never touch"),
            ("arm", "tip", "no: never touch"),
        }
        assert str(tmp_path / name) in wrote and ("spheres up to" in wrote) == (name == "model.urdf")
        assert (f"has to disable 2 pairs of links: {tmp_path / 'model.srdf'}" in wrote) == (name == "model.urdf")
    call(monkeypatch, "fit", tmp_path / "arm.urdf", "--tip", "arm", "--posture", "twist=0.5")
    told = capsys.readouterr().out
    (row,) = ([word.strip() for word in line.split("\u2502")[1:-1]] for line in told.splitlines() if "twist" in line)
    assert row == ["twist", "-", "0.5", "tip"] and "--posture JOINT=VALUE" in told and "held" not in "".join(table)
    assert jaxik.load(tmp_path / "model.toml") == robot
    assert len(jaxik.load(tmp_path / "model.urdf", tip="tool").volumes) > len(robot.volumes)
    assert "allowed: .toml, .urdf" in refused(monkeypatch, capsys, "fit", tmp_path / "arm.urdf", "--to", "model.txt")


def test_pairs_are_ignored_by_the_command_and_by_a_study(tmp_path, monkeypatch, capsys):
    """A foot in the floor: told before, named after, and ignored."""
    monkeypatch.setattr(cli, "compilation_cache", lambda: None)
    (tmp_path / "post.urdf").write_text(POST)
    cell, targets, out = tmp_path / "cell.toml", tmp_path / "targets.csv", tmp_path / "ik.csv"
    cell.write_text('name = "cell"\n[[object]]\nname = "floor"\nboxes = [[0, 0, -0.05, 2, 2, 0.1]]\n')
    targets.write_text("x,y,z,qw,qx,qy,qz\n0,0,0.5,1,0,0,0\n0,0,0.5,0,0,0,0\n")
    command = ("ik", tmp_path / "post.urdf", targets, "--scene", cell, "--out", out)
    call_unsolved(monkeypatch, *command)
    printed, told = capsys.readouterr()
    assert "warning: solve_ik: foot and floor collide by 20.0 mm in every configuration" in told
    assert "of 1 that collide: 1 by foot and floor" in printed
    assert "target 2: its rotation is 0, as of a quaternion of length 0" in printed
    call_unsolved(monkeypatch, *command, "--ignore", "foot:floor", "arm")
    assert "1 of 2 targets solved" in capsys.readouterr().out
    assert "--ignore a:b:c: write LINK" in refused(monkeypatch, capsys, *command, "--ignore", "a:b:c")
    robot = f'[robot]\nfile = "post.urdf"\ntool = {np.eye(4).tolist()}\n'
    study = tmp_path / "study.toml"
    rest = '[collision]\nscene = "cell.toml"\nmargin = 0.0\n[targets]\nkind = "file"\npath = "targets.csv"\n'
    study.write_text(robot + rest)
    call(monkeypatch, "sweep", study, "--out", tmp_path / "a.zarr")
    printed, told = capsys.readouterr()
    assert "warning: sweep: foot and floor" in told and "of 1 that collide: 1 by foot and floor" in printed
    study.write_text(robot + 'ignore = [["foot", "floor"]]\n' + rest)
    call(monkeypatch, "sweep", study, "--out", tmp_path / "b.zarr")
    assert "1 solved" in capsys.readouterr().out
    with pytest.raises(ValueError, match="fit"):
        jaxik.sweeps.Study.of({"robot": {"file": "p6r", "fit": {"accuracy_mm": 12}}, "targets": GRID})


def test_a_motion_is_planned_and_written(tmp_path, monkeypatch, capsys):
    out, ends = tmp_path / "motion.json", ("--start", 0, 0.3, "--goal", 1.5, -0.3)
    call(monkeypatch, "plan", "planar2", *ends, "--velocity", 1, "--acceleration", 4, "--out", out)
    assert "planned in" in capsys.readouterr().out
    message = json.loads(out.read_text())
    assert message["joint_names"] == ["q1", "q2"] and message["points"][-1]["positions"] == pytest.approx([1.5, -0.3])
    for more, words in (
        (("--goal", 9, 0), "no motion in 0.0 s: goal: limits; q1 is 5.858 rad beyond its limits"),
        (("--goal", 1), "--goal: 1 numbers; planar2 has 2: q1, q2"),
        (("--dt", 0), "--dt 0: it is above zero [s]"),
        (("--out", "motion.txt"), "ending '.txt'; allowed: .csv, .npz, .json"),
        (("--without", "crate"), "--without crate: there is no scene to leave it out of; give --scene"),
        (("--dt", 1e-9), "dt is 1e-09 s, and the motion lasts"),
    ):
        with pytest.raises(SystemExit) as left:
            call(monkeypatch, "plan", "planar2", *ends, "--velocity", 1, *more)
        line = capsys.readouterr().err.strip().splitlines()[-1]
        assert left.value.code == (1 if "no motion" in words else 2) and words in line


def test_the_torques_of_a_motion(tmp_path, monkeypatch, capsys):
    robot, time = jaxik.load("crops_v2"), np.linspace(0.0, 1.0, 21)
    way = 0.3 * np.sin(time[:, None] * np.arange(1, 10))  # positions alone: the rest is a spline's
    header = ",".join(["time", *(f"q_{name}" for name in reversed(robot.joint_names))])
    np.savetxt(tmp_path / "log.csv", np.column_stack([time, way[:, ::-1]]), header=header, comments="", delimiter=",")
    monkeypatch.chdir(tmp_path)
    call(monkeypatch, "dynamics", "crops_v2", "log.csv", "--load", 2, "--plot", "torques.png")
    printed = capsys.readouterr().out
    assert "21 samples, 1.00 s" in printed and "wrote torques.csv" in printed
    assert "accelerations are second derivatives of positions, of measured ones mostly noise: --smooth HZ" in printed
    assert printed.count(", friction ") == 9 and printed.count(" A\n") == 9  # it has drives
    assert (tmp_path / "torques.png").stat().st_size > 10000
    table = np.genfromtxt("torques.csv", delimiter=",", names=True)
    lifted = (sum(float(body.mass) for body in robot.bodies) + 2.0) * 9.81
    np.testing.assert_allclose(table["gravity_joint1"], lifted, rtol=1e-9)
    np.testing.assert_allclose(table["power_joint1"], table["torque_joint1"] * 0.3 * np.cos(time), atol=0.05)
    for given, words in (
        (["motion.txt"], "motion.txt; allowed endings: .csv, .npz, .json"),
        (["log.csv"], "no column q_q1; write the columns time [s], q_<joint>"),
        (["log.csv", "--plot", "torques.txt"], "--plot torques.txt: ending '.txt'; allowed: .png, .pdf, .svg"),
        (["log.csv", "--gravity", 0, 0, "nan"], "--gravity 0.0 0.0 nan: finite numbers"),
    ):
        assert words in refused(monkeypatch, capsys, "dynamics", "planar2", *given)
