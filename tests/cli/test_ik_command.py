"""Several answers of each target, from the shell."""

import csv
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from robots import pinocchio

import jaxik
from jaxik.cli.ik import IKArguments
from jaxik.cli.plan import PlanArguments


@pytest.mark.parametrize("solutions", [3, "all"])
def test_several_answers(tmp_path, monkeypatch, capsys, solutions):
    monkeypatch.chdir(tmp_path)
    robot = jaxik.load("irb120")
    q = np.random.default_rng(1).uniform(robot.lower, robot.upper, (3, 6))
    poses = np.stack([np.asarray(jaxik.forward_kinematics(robot, row)) for row in q])
    poses[1, 0, 3] += 9.0
    np.savez("targets.npz", poses=poses)
    for out in ("ik.csv", "ik.npz", "ik.csv"):
        with pytest.raises(SystemExit, match="1"):
            IKArguments(robot="irb120", targets="targets.npz", solutions=solutions, out=tmp_path / out).run()
    assert "ik.csv, over the old one" in capsys.readouterr().out.splitlines()[-1]
    with pytest.raises(SystemExit, match="1"):
        IKArguments(robot="irb120", targets="targets.npz", solutions=solutions, out=tmp_path / "ik.npz").run()
    rows = list(csv.DictReader((tmp_path / "ik.csv").read_text().splitlines()))
    with np.load("ik.npz", allow_pickle=False) as arrays:
        counts, answers = arrays["num_solutions"], arrays["solutions"]
    assert counts[1] == 0 and min(counts[[0, 2]]) > 1 and (solutions == "all" or max(counts) <= 3)
    assert [(row["target"], row["solution"]) for row in rows if row["target"] == "2"] == [("2", "0")]
    assert f"{sum(counts)} answers" in capsys.readouterr().out
    for i in (0, 2):
        of_it = [row for row in rows if row["target"] == str(i + 1)]
        assert [row["solution"] for row in of_it] == [str(k + 1) for k in range(counts[i])]
        written = np.array([[float(row[name]) for name in robot.joint_names] for row in of_it])
        assert np.array_equal(written, answers[i, : counts[i]])
        assert [float(row["position_error [m]"]) < 1e-6 and float(row["clearance [m]"]) >= 0.0 for row in of_it]
        for row in written:
            np.testing.assert_allclose(jaxik.forward_kinematics(robot, row), poses[i], atol=1e-9)


def test_one_answer_has_the_columns_of_many(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.savez("targets.npz", poses=np.asarray(jaxik.forward_kinematics(jaxik.load("irb120"), np.full(6, 0.3)))[None])
    heads = []
    for solutions in (1, 2):
        IKArguments(robot="irb120", targets="targets.npz", solutions=solutions, out=tmp_path / "ik.csv").run()
        heads.append((tmp_path / "ik.csv").read_text().splitlines()[0])
    assert heads[0] == heads[1] and heads[0].startswith("target,solution,reason,position_error [m],")


def test_the_nearest_of_what_cannot_be_had(tmp_path, monkeypatch, capsys):
    """The distance is a column more, and the command does not fail."""
    monkeypatch.chdir(tmp_path)
    robot = jaxik.load("so100")
    poses = np.stack([np.asarray(jaxik.forward_kinematics(robot, np.array([0.1, 1.0, -1.0, 0.2, 0.3]))), np.eye(4)])
    np.savez("targets.npz", poses=poses)
    IKArguments(robot="so100", targets="targets.npz", nearest=True, out=tmp_path / "ik.csv").run()
    said = capsys.readouterr().out
    IKArguments(robot="so100", targets="targets.npz", nearest=True, out=tmp_path / "ik.npz").run()
    rows = list(csv.DictReader((tmp_path / "ik.csv").read_text().splitlines()))
    result = jaxik.solve_ik(robot, poses, nearest=True)
    assert "nearest: 1" in said and "proven to be the nearest: 0" in said and [row["solution"] for row in rows] == ["1", "0"]
    assert [row["reason"] for row in rows] == ["solved", "nearest"] and rows[1]["proven"] == "False"
    np.testing.assert_array_equal([float(row["distance [m]"]) for row in rows], result.distance)
    with np.load("ik.npz", allow_pickle=False) as arrays:
        np.testing.assert_array_equal(arrays["distance"], result.distance)


SLOW = """
import sys, time
import jaxik, jaxik.cli.ik
from jaxik import cli
solve = jaxik.solve_ik
jaxik.cli.ik.AT_ONCE = 4
def slowly(*given, **named):
    found = solve(*given, **named)
    print("solved", flush=True)
    time.sleep(1.0)
    return found
jaxik.solve_ik = slowly
sys.argv = ["jaxik", *sys.argv[1:]]
cli.main()
"""


@pytest.mark.parametrize("times", [1, 2])
def test_ctrl_c_keeps_what_is_done(tmp_path, times):
    """Once: what is solved so far is written; twice: it ends at once. No traceback."""
    poses = np.tile(np.asarray(jaxik.forward_kinematics(jaxik.load("irb120"), np.full(6, 0.3))), (40, 1, 1))
    np.savez(tmp_path / "targets.npz", poses=poses)
    words = [sys.executable, "-c", SLOW, "ik", "irb120", str(tmp_path / "targets.npz"), "--out", str(tmp_path / "ik.npz")]
    command = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert command.stdout.readline() == "solved\n"
    for _ in range(times):
        command.send_signal(signal.SIGINT)
        time.sleep(0.3)
    out, told = command.communicate(timeout=60)
    assert command.returncode == 130 and "Traceback" not in told
    if times == 2:
        assert told.splitlines()[-1] == "jaxik: stopped" and not (tmp_path / "ik.npz").exists()
    else:
        assert told.splitlines()[-1] == "stopped; targets 5 to 40 were not tried" and "4 of 4 targets solved" in out
        assert len(np.load(tmp_path / "ik.npz")["q"]) == 4


def test_tasks_in_words(tmp_path, monkeypatch, capsys):
    """The places of a file, and a tool that points down within a cone: as SciPy measures it."""
    monkeypatch.chdir(tmp_path)
    places, turned = np.array([[0.4, 0.1, 0.4], [0.5, 0.1, 0.3]]), "0,0,0,0,1,0,0"
    np.savez("targets.npz", positions=places)
    asked = {"robot": "ur5e", "targets": "targets.npz", "collision": False, "out": tmp_path / "ik.npz"}
    IKArguments(task=("position", f"upright z within 10deg at {turned}"), **asked).run()
    IKArguments(task=("position", f"upright z within 10deg at {turned}"), **asked | {"out": tmp_path / "ik.csv"}).run()
    assert "2 of 2 targets solved" in capsys.readouterr().out
    pose = pinocchio(jaxik.load("ur5e"))
    with np.load("ik.npz", allow_pickle=False) as found:
        for q, place in zip(found["q"], places, strict=True):
            tip = pose(q)
            np.testing.assert_allclose(tip[:3, 3], place, atol=1e-6)
            assert -tip[2, 2] >= np.cos(np.radians(10.0) + 1e-6)
    with pytest.raises(SystemExit):
        IKArguments(
            task=("position", *(f"upright z within 10deg at 0,0,0,{turn}" for turn in ("1,0,0,0", "0,1,0,0"))), **asked
        ).run()
    assert "target 1: tip (roll pitch within 0.174533) and tip (roll pitch within 0.174533), 160 deg" in capsys.readouterr().out
    for wrong, words in (
        ({"task": ("uprigt z",)}, "did you mean 'upright'"),
        ({"task": ("position",), "free": ("yaw",)}, "write --task"),
        ({"task": ("position at 0.4,0,0.4",)}, "leave 'at' out"),
        ({"task": ("position tip wrist_3_jont_axis",)}, "did you mean 'wrist_3_joint_axis'"),
    ):
        with pytest.raises(ValueError, match=words) as error:
            IKArguments(**asked | wrong).run()
        assert "\n" not in str(error.value)


def test_a_task_all_the_way_in_words(tmp_path, capsys):
    start, goal = (0.3, -1.2, 1.4, -0.6, 0.9, 0.2), (0.7, -1.2, 1.4, -0.6, 0.9, 0.2)
    PlanArguments(robot="ur5e", start=start, goal=goal, along=("plane z within 1cm axes base",), out=tmp_path / "m.npz").run()
    pose = pinocchio(jaxik.load("ur5e"))
    with np.load(tmp_path / "m.npz", allow_pickle=False) as moved:
        tips = np.array([pose(q) for q in moved["q" if "q" in moved else "positions"]])
    assert np.abs(tips[:, 2, 3] - pose(np.array(start))[2, 3]).max() <= 0.01 + 1e-4
