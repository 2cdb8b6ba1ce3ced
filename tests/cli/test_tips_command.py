"""Several tips, from the shell: a tree where a command takes one, a line where it does not."""

import csv

import numpy as np
import pinocchio as pin
import pytest
from robot_files import HANDS, TWO, write

import jaxik
from jaxik import cli

TIPS = ("--tip", HANDS[0], "--tip", HANDS[1], "--held", "flex=0.2", "--no-meshes")


def call(monkeypatch, *words):
    monkeypatch.setattr("sys.argv", ["jaxik", *map(str, words)])
    cli.main()


def refused(monkeypatch, capsys, *words):
    capsys.readouterr()
    with pytest.raises(SystemExit) as ended:
        call(monkeypatch, *words)
    assert ended.value.code == 2
    return capsys.readouterr().err.splitlines()[-1]


def test_a_motion_of_two_arms_and_where_their_tips_are(tmp_path, monkeypatch, capsys):
    file, out, poses = write(tmp_path, "two.urdf", TWO), tmp_path / "motion.csv", tmp_path / "poses.csv"
    ends = "--start", *[0.0] * 5, "--goal", *[0.3] * 5
    call(monkeypatch, "plan", file, *TIPS, *ends, "--acceleration", 4, "--out", out, "--poses", poses)
    rows, motion = (list(csv.DictReader(path.read_text().splitlines())) for path in (poses, out))
    assert len(rows) == len(motion) > 5
    model = pin.buildModelFromUrdf(str(file))
    q = {name: float(motion[-1][f"q_{name}"]) for name in JOINTS}
    for hand in HANDS:
        found = np.array([float(rows[-1][f"{hand}_{k}"]) for k in POSE])
        assert np.allclose(jaxik.pose(found[:3], wxyz=found[3:]), placed(model, model.createData(), q, hand), atol=1e-9)
    torques = tmp_path / "torques.csv"
    call(monkeypatch, "dynamics", file, out, *TIPS[:-1], "--out", torques)
    assert "torque_right_wrist" in torques.read_text().splitlines()[0]
    line = refused(monkeypatch, capsys, "dynamics", file, out, *TIPS[:-1], "--load", 1)
    assert line == "jaxik: --load 1: hangs at one tip; name --tip once"
    call(
        monkeypatch,
        "plan",
        file,
        *TIPS[:2],
        *TIPS[4:],
        "--start",
        *[0.0] * 3,
        "--goal",
        *[0.2] * 3,
        "--out",
        out,
        "--poses",
        poses,
    )
    assert poses.read_text().splitlines()[0] == "time,x,y,z,qw,qx,qy,qz"


def placed(model, data, q, hand):
    """Where Pinocchio has a hand, of joints that are named."""
    values = pin.neutral(model)
    for name, value in q.items():
        values[model.joints[model.getJointId(name)].idx_q] = value
    pin.framesForwardKinematics(model, data, values)
    return data.oMf[model.getFrameId(hand)].homogeneous


JOINTS = ("turn", "left_shoulder", "left_wrist", "right_shoulder", "right_wrist")
POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")


def test_postures_of_several_tips(tmp_path, monkeypatch, capsys):
    """Both hands of each answer are where Pinocchio has the targets; who is out of reach, or no pose, is named."""
    file, targets, out = write(tmp_path, "two.urdf", TWO), tmp_path / "targets.csv", tmp_path / "ik.csv"
    model = pin.buildModelFromUrdf(str(file))
    data, rng = model.createData(), np.random.default_rng(0)
    columns = ",".join(f"{hand}_{name}" for hand in HANDS[::-1] for name in POSE)  # in any order
    lines, wanted = [f"time,{columns}"], []
    for _ in range(4):
        q = {name: rng.uniform(-0.25, 0.25) for name in JOINTS}
        wanted.append({hand: placed(model, data, q, hand).copy() for hand in HANDS})
        turned = {hand: pin.Quaternion(wanted[-1][hand][:3, :3]).coeffs()[[3, 0, 1, 2]] for hand in HANDS}
        row = [each for hand in HANDS[::-1] for each in (*wanted[-1][hand][:3, 3], *turned[hand])]
        lines.append(",".join(map(str, (0.0, *row))))
    right, left = lines[1].split(",")[1:8], lines[1].split(",")[8:]
    lines += [",".join(["0", *right, "9", *left[1:]]), ",".join(["0", "nan", *right[1:], *left])]
    targets.write_text("\n".join(lines))
    with pytest.raises(SystemExit, match="1"):
        call(monkeypatch, "ik", file, targets, *TIPS, "--solutions", 2, "--out", out)
    told = capsys.readouterr().out.splitlines()
    assert "out of reach: 1 (left_hand 1)" in told and "invalid: 1 (right_hand 1)" in told
    assert "target 6: right_hand: its position holds NaN or infinity" in told
    rows = list(csv.DictReader(out.read_text().splitlines()))
    assert [row["tip"] for row in rows[-2:]] == HANDS and {row["tip"] for row in rows[:-2]} == {""}
    for row in rows[:-2]:
        q = {name: float(row[name]) for name in JOINTS} | {"flex": 0.2}
        for hand in HANDS:
            assert float(row[f"{hand}_position_error [m]"]) < 1e-6 > float(row[f"{hand}_rotation_error [rad]"])
            assert np.allclose(placed(model, data, q, hand), wanted[int(row["target"]) - 1][hand], atol=1e-6)
    with pytest.raises(SystemExit, match="1"):
        call(monkeypatch, "ik", file, targets, *TIPS, "--out", tmp_path / "ik.npz")
    with np.load(tmp_path / "ik.npz", allow_pickle=False) as arrays:
        assert arrays["position_error"].shape == (6, 2) and [*arrays["tip_names"]] == HANDS == [*arrays["tip"][-2:]]


def test_positions_of_several_tips(tmp_path, monkeypatch, capsys):
    file, targets = write(tmp_path, "two.urdf", TWO), tmp_path / "targets.csv"
    robot = jaxik.load(file, tip=HANDS, held={"flex": 0.2})
    places = np.asarray(jaxik.forward_kinematics(robot, np.full(5, 0.2)))[:, :3, 3]
    head = ",".join(f"{hand}_{name}" for hand in HANDS for name in "xyz")
    targets.write_text(f"{head}\n{','.join(map(str, places.ravel()))}\n")
    call(monkeypatch, "ik", file, targets, *TIPS, "--out", tmp_path / "ik.csv")
    assert capsys.readouterr().out.startswith("position only: ")
    row = next(csv.DictReader((tmp_path / "ik.csv").read_text().splitlines()))
    found = jaxik.forward_kinematics(robot, np.array([float(row[name]) for name in robot.joint_names]))
    assert np.allclose(found[:, :3, 3], places, atol=1e-5)
    targets.write_text("x,y,z\n0,0,0\n")
    line = refused(monkeypatch, capsys, "ik", file, targets, *TIPS)
    assert "'x,y,z' lacks left_hand_x, left_hand_y, left_hand_z; " in line and "(left_hand_x, right_hand_x)" in line


def test_commands_of_one_tip_say_so(tmp_path, monkeypatch, capsys):
    file = write(tmp_path, "two.urdf", TWO)
    line = "jaxik: --tip left_hand --tip right_hand: this command moves one tip; name --tip once"
    assert refused(monkeypatch, capsys, "base", file, "t.csv", "--x", 0, 1, 2, "--y", 0, 1, 2, *TIPS) == line
    assert refused(monkeypatch, capsys, "view", file, *TIPS, "--teleop") == "jaxik: --teleop: steers one tip; name --tip once"


def test_where_a_base_must_stand(tmp_path, monkeypatch, capsys):
    targets, out = tmp_path / "targets.csv", tmp_path / "bases.csv"
    targets.write_text("x,y,z\n0.5,0.1,0.5\n0.4,-0.2,0.4\n0.1,0.1,30\n")
    region = "--x", -0.5, 0.5, 2, "--y", -0.5, 0.5, 2, "--headings", 2
    call(monkeypatch, "base", "ur5e", targets, *region, "--no-collision", "--out", out, "--plot", tmp_path / "floor.png")
    told = capsys.readouterr().out.splitlines()
    assert told[0].startswith("  2 targets from x ") and told[-2].startswith("2 of 3 targets from 1 stops; 8 bases, 0 proven")
    rows = list(csv.DictReader(out.read_text().splitlines()))
    assert len(rows) == 8 and max(int(row["targets"]) for row in rows) == 2 and rows[0]["x [m]"] == "-0.25"
    assert (tmp_path / "floor.png").exists()
    call(monkeypatch, "base", "ur5e", targets, *region, "--no-collision", "--out", tmp_path / "bases.npz")
    with np.load(tmp_path / "bases.npz", allow_pickle=False) as arrays:
        assert arrays["seen"].shape == (8, 3) and not arrays["seen"][:, 2].any() and arrays["proven"][:, 2].all()
    with pytest.raises(SystemExit, match="1"):
        call(monkeypatch, "base", "ur5e", targets, "--x", 8, 9, 2, *region[4:], "--out", out)
    assert "no base of the region sees a target: out of reach" in capsys.readouterr().err
    assert "write (from, to, count)" in refused(monkeypatch, capsys, "base", "ur5e", targets, "--x", 1, 0, 2, *region[4:])
