"""The command: what it writes, how it refuses, and that nothing half-written stays."""

import csv
import os
import subprocess
import sys

import numpy as np
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
    monkeypatch.setattr(cli, "_compilation_cache", lambda: None)
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
