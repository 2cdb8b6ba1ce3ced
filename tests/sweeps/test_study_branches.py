"""Studies of one branch of a tree: which it is, and where the others stand."""

import numpy as np
import pytest
from robot_files import HANDS, TWO, write

import jaxik
from jaxik import kinematics

TARGETS = {"kind": "grid", "x": [0.2, 0.6, 3], "y": [-0.1, 0.5, 3], "z": [0.6, 1.0, 3], "directions": "any"}


@pytest.fixture
def two(tmp_path):
    return jaxik.load(write(tmp_path, "two.urdf", TWO), tip=HANDS, held={"flex": 0.2})


def test_a_tip_chooses_a_branch_and_the_others_are_held(tmp_path, two):
    study = {"robot": two, "targets": TARGETS, "audited": 0}
    done = jaxik.sweep(study | {"tip": "left_hand", "posture": {"right_wrist": 0.4}}, tmp_path / "left.zarr")
    data = done.dataset()
    assert data.joint.values.tolist() == ["turn", "left_shoulder", "left_wrist"]
    assert data.attrs["held"] == {"two": {"right_shoulder": 0.0, "right_wrist": 0.4}}
    arm = kinematics.branch_to(two, "left_hand", q=[0.0, 0.0, 0.0, 0.0, 0.4])
    alone = jaxik.sweep(study | {"robot": arm}, tmp_path / "arm.zarr").dataset()
    assert np.array_equal(data.reason, alone.reason) and np.array_equal(data.q, alone.q, equal_nan=True)
    assert "held" not in alone.attrs
    with pytest.raises(ValueError, match="held"):  # another posture is another study
        jaxik.sweep(study | {"tip": "left_hand"}, tmp_path / "left.zarr")


def test_a_file_takes_the_studys_tip(tmp_path, two):
    files = {"robot": str(tmp_path / "two.urdf"), "targets": TARGETS, "audited": 0, "tip": "right_hand"}
    study = jaxik.sweeps.Study.of(files | {"posture": {"left_wrist": 0.1, "left_shoulder": 0, "flex": 0}})
    (variant,) = study.variants
    assert variant.robot.joint_names == ("turn", "right_shoulder", "right_wrist")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({}, "robot 1 has the tips left_hand, right_hand; choose one: tip = 'left_hand'"),
        ({"tip": "left_han"}, "no link 'left_han'; did you mean"),
        ({"tip": "base"}, "no joint of two moves 'base'"),
        ({"tip": "left_hand", "posture": {"wrist": 0.1}}, r"\[posture\] 'wrist'"),
    ],
)
def test_refusals(two, change, words):
    with pytest.raises(ValueError, match=words):
        jaxik.sweeps.Study.of({"robot": two, "targets": TARGETS} | change)
