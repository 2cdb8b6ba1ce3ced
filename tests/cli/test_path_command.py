"""`jaxik path`: the tip is on the path by Pinocchio; where a path cannot be done a line says where and why."""

import csv

import numpy as np
import pytest
from peers.panda import pose_of

import jaxik
from jaxik import cli

HOME = np.array([0.0, -0.5, 0.0, -2.0, 0.0, 1.6, 0.8])


def call(monkeypatch, *words):
    monkeypatch.setattr("sys.argv", ["jaxik", "path", "panda", *map(str, words)])
    cli.main()


def path_file(folder, away):
    """A line of twelve poses along y from the tip at HOME, and so far away [m] at its end along x."""
    pose = np.asarray(jaxik.forward_kinematics(jaxik.load("panda"), HOME), float)
    w, x, y, z = jaxik.spatial.rotations.to_wxyz(pose[:3, :3])
    rows = [[*(pose[:3, 3] + s * np.array([away, 0.1, 0.0])), w, x, y, z] for s in np.linspace(0.0, 1.0, 12)]
    file = folder / "path.csv"
    file.write_text("x,y,z,qw,qx,qy,qz\n" + "\n".join(",".join(f"{value:.12g}" for value in row) for row in rows) + "\n")
    return file, np.array(rows)


def test_a_path_from_the_shell(tmp_path, monkeypatch, capsys):
    file, rows = path_file(tmp_path, 0.0)
    out, picture = tmp_path / "motion.csv", tmp_path / "path.png"
    call(monkeypatch, file, "--feed", 0.05, "--out", out, "--picture", picture)
    assert "along 0.1 m" in capsys.readouterr().out and picture.stat().st_size > 10_000
    motion = list(csv.DictReader(out.read_text().splitlines()))
    robot = jaxik.load("panda")
    tip = pose_of(robot)
    places = np.array([tip([float(row[f"q_{name}"]) for name in robot.joint_names])[:3, 3] for row in motion])
    along = rows[-1, :3] - rows[0, :3]
    share = (places - rows[0, :3]) @ along / (along @ along)
    assert np.linalg.norm(places - rows[0, :3] - share[:, None] * along, axis=1).max() < 1e-4
    assert share[0] == pytest.approx(0.0, abs=1e-4) and share[-1] == pytest.approx(1.0, abs=1e-4)
    assert np.linalg.norm(np.diff(places, axis=0), axis=1).max() <= 0.05 * 0.01 * 1.001


def test_a_path_that_cannot_be_done(tmp_path, monkeypatch, capsys):
    file, _ = path_file(tmp_path, 0.6)
    with pytest.raises(SystemExit) as ended:
        call(monkeypatch, file, "--no-mend", "--out", tmp_path / "motion.csv")
    told = capsys.readouterr()
    assert ended.value.code == 1 and not (tmp_path / "motion.csv").exists()
    assert "no motion in" in told.err + told.out and "poses" in told.err + told.out


def test_a_task_in_words_and_the_limits_of_the_tip(tmp_path, monkeypatch, capsys):
    file, rows = path_file(tmp_path, 0.0)
    out, robot = tmp_path / "motion.npz", jaxik.load("panda")
    call(monkeypatch, file, "--task", "pointing z within 5deg", "--tip-speed", 0.04, "--tip-turn", 0.5, "--out", out)
    assert "along 0.1 m" in capsys.readouterr().out
    motion = jaxik.planning.load_trajectory(out, robot=robot)
    tips = np.array([pose_of(robot)(row) for row in motion.q])
    wanted = jaxik.spatial.rotations.from_wxyz(rows[0, 3:])
    assert np.arccos(np.clip(tips[:, :3, 2] @ wanted[:, 2], -1.0, 1.0)).max() <= np.radians(5.1)
    assert np.linalg.norm(np.diff(tips[:, :3, 3], axis=0), axis=1).max() <= 0.04 * 0.01 * 1.001


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--task", "pose free yaw", "--free-axis", "z"), "--task says what --free-axis does; write --task 'pointing z'"),
        (("--task", "pose", "--task", "position"), "--task: 2 times"),
        (("--task", "pose weight 2"), "weight 2 makes it soft"),
        (("--task", "pose at 0,0,0"), "the path is its target; leave out Task.at"),
    ],
)
def test_tasks_that_are_none_of_a_path(words, told, tmp_path, monkeypatch, capsys):
    with pytest.raises(SystemExit):
        call(monkeypatch, path_file(tmp_path, 0.0)[0], *words)
    assert told in " ".join(capsys.readouterr().err.split())
