"""The command: what it writes, how it refuses, and that nothing half-written stays."""

import csv
import json
import os
import subprocess
import sys

import numpy as np
import pyarrow.parquet
import pytest

import jaxik
from jaxik import cli

SCENE = """name = "bench"
point_radius = 0.01
[[object]]
name = "leaf_1"
points = [[0.55, 0.62, 0.4], [0.55, 0.62, 0.5]]
[[fruit]]
name = "near"
position = [0.5, 0.66, 0.6]
length = 0.3
radius = 0.02
[[fruit]]
name = "far"
position = [0.5, 9.0, 0.6]
"""


def call(monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["jaxik", *map(str, arguments)])
    cli.main()


def test_it_writes_table_picture_and_arrays(tmp_path):
    scene, out = tmp_path / "bench.toml", tmp_path / "out"
    scene.write_text(SCENE)
    command = ["harvest", "--scene", scene, "--out", out, "--angles", "24", "--slides", "9", "--weights.freedom", "1"]
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path / "cache"), "COLUMNS": "200"}
    code = "from jaxik.cli import main; main()"
    done = subprocess.run([sys.executable, "-c", code, *map(str, command)], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1].startswith("2 fruits: 1 out of reach, 1 solved; 3456 candidates in ")
    assert sorted(p.name for p in out.iterdir()) == ["harvest.png", "postures.csv", "postures.npz"]
    with np.load(out / "postures.npz", allow_pickle=False) as arrays:
        q = arrays["q"][list(arrays["fruit"]).index("near")]
        assert list(arrays["reason"]) == ["solved", "out of reach"] and np.all(np.isnan(arrays["q"][1]))
    rows = list(csv.DictReader((out / "postures.csv").read_text().splitlines()))
    chain = jaxik.load("p6r")
    assert np.allclose([float(rows[0][name]) for name in chain.joint_names], q)
    tip = chain.world_T_base @ np.asarray(jaxik.forward_kinematics(chain, q))
    assert np.allclose(tip[:3, 3], (0.5, 0.66, 0.6), atol=2e-6)
    assert (out / "harvest.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.parametrize(
    "arguments, words",
    [
        (("--scene", "broken.toml"), ("broken.toml", "malformed TOML")),
        (("--scene", "absent.toml"), ("absent.toml", "cannot be read")),
        (("--scene", "greenhouse"), ("no such shipped scene", "cucumber_row")),
        (("--robot", "crops_v2"), ("needs the closed form", "axes")),
        (("--angles", "0"), ("--angles 0", "at least 1")),
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


def test_a_failed_write_leaves_the_old_files(tmp_path, monkeypatch):
    scene = tmp_path / "bench.toml"
    scene.write_text(SCENE)
    result = jaxik.harvest(jaxik.load("p6r"), jaxik.load_scene(scene), angles=8, slides=5)
    out = tmp_path / "out"
    out.mkdir()
    (out / "postures.csv").write_text("old")

    def fails(*_):
        raise OSError("disk full")

    monkeypatch.setattr("jaxik.plot.plot_harvest", fails)
    with pytest.raises(OSError, match="disk full"):
        cli.write_harvest(result, out)
    assert [p.name for p in out.iterdir()] == ["postures.csv"] and (out / "postures.csv").read_text() == "old"


@pytest.mark.parametrize("option, words", [(("--weights.reach", "0"), "reach > 0"), (("--wieghts.reach", "1"), "wieghts")])
def test_a_mistake_in_an_option_names_it(monkeypatch, capsys, option, words):
    with pytest.raises(SystemExit) as exit:
        call(monkeypatch, "harvest", *option)
    assert exit.value.code == 2 and words in capsys.readouterr().err


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
    chain = jaxik.load("chembuly9")
    q = np.random.default_rng(0).uniform(chain.lower, chain.upper, (5, chain.num_joints))
    poses = [np.asarray(jaxik.forward_kinematics(chain, row)) for row in q]
    poses[3] = poses[3] + np.pad([[7.0]], ((0, 3), (3, 0)))  # seven metres away
    tables = []
    for ending in (".csv", ".npz", ".json"):
        out = tmp_path / f"answers{ending}.npz"
        call(monkeypatch, "ik", "chembuly9", targets_file(tmp_path / f"targets{ending}", poses), "--out", out)
        lines = capsys.readouterr().out.splitlines()
        assert lines[0] == "out of reach: 1" and lines[1].startswith("4 of 5 targets solved in ")
        with np.load(out, allow_pickle=False) as arrays:
            tables.append(dict(arrays))
        assert tuple(tables[-1]["joint_names"]) == chain.joint_names
        assert list(tables[-1]["reason"]) == ["solved"] * 3 + ["out of reach", "solved"]
    for i in (0, 1, 2, 4):
        np.testing.assert_allclose(jaxik.forward_kinematics(chain, tables[0]["q"][i]), poses[i], atol=2e-6)
    np.testing.assert_allclose(tables[1]["q"], tables[2]["q"], atol=1e-5)
    out = tmp_path / "positions.parquet"
    (tmp_path / "positions.csv").write_text("x,y,z\n" + "\n".join(",".join(map(str, p[:3, 3])) for p in poses))
    call(monkeypatch, "ik", "chembuly9", tmp_path / "positions.csv", "--out", out)
    table = pyarrow.parquet.read_table(out).to_pydict()
    assert table["reason"] == ["solved"] * 3 + ["out of reach", "solved"] and set(chain.joint_names) < set(table)


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
    assert ".npz, .parquet" in capsys.readouterr().err
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
