"""Motions that others wrote: what is taken, and the line that says what is not."""

import json

import numpy as np
import pytest
from robot_files import write

from jaxik.planning import load_trajectory

PLAIN = "time,a,b\n0,0.5,-0.5\n0.1,0.6,-0.4\n0.3,0.7,-0.2\n"


@pytest.mark.parametrize(
    "text",
    [
        PLAIN,
        "\ufeff" + PLAIN,  # as spreadsheets write it
        PLAIN.replace(",", " , ").replace("\n", "\r\n"),
        PLAIN.replace(",", ";").replace(".", ","),
        PLAIN.replace(",", "\t") + "\n\n",
        "# " + PLAIN,
        PLAIN.replace("time,a,b", "time [s], q_a [rad], q_b [m]"),
        '"q_b","time","q_a"\n-0.5,0,0.5\n-0.4,0.1,0.6\n-0.2,0.3,0.7',
    ],
)
def test_tables_of_others(tmp_path, text):
    state = load_trajectory(write(tmp_path, "mine.csv", text), robot=["b", "a"])
    np.testing.assert_array_equal(state.time, [0.0, 0.1, 0.3])
    np.testing.assert_array_equal(state.q, [[-0.5, 0.5], [-0.4, 0.6], [-0.2, 0.7]])
    np.testing.assert_allclose(state.velocity[:, 0], 1.0)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (
            PLAIN.replace("a,", "shoulder,"),
            "mine.csv: no column q_a; write the columns time [s], q_<joint> [rad, m], perhaps velocity_<joint>, "
            "acceleration_<joint>; yours are time, shoulder, b",
        ),
        (PLAIN.replace("time", "time [ms]"), "mine.csv: no column time; .*yours are time [ms], a, b"),
        (PLAIN.replace("a,", "a [deg],"), "mine.csv: no column q_a; .*yours are time, a [deg], b"),
        (PLAIN.replace("a,b", "a,a"), "mine.csv: column a stands twice"),
        (PLAIN.replace("time,a,b", "time,q_a,q_b,velocity_a").replace("\n0", ",1\n0"), "mine.csv: no column velocity_b"),
        (PLAIN.replace("0.6,-0.4", "0.6"), "mine.csv, line 3: 2 cells; the header has 3"),
        (PLAIN.replace("0.6", "high"), "mine.csv, line 3: a is 'high'; write a finite number"),
        (PLAIN.replace("0.6", ""), "mine.csv, line 3: a is ''; write a finite number"),
        (PLAIN.replace("-0.2", "nan"), "mine.csv, line 4: q of b is nan; write a finite number"),
        (PLAIN.replace("\n0.3", "\n\n0.1"), "mine.csv, line 5: time is 0.1 after 0.1; it grows [s]"),
        (PLAIN[:20], "mine.csv: 1 samples; a motion has two or more"),
        ("", "mine.csv: no column time; .*yours are none"),
    ],
)
def test_what_is_wrong_in_a_table_is_named(tmp_path, text, line):
    with pytest.raises(ValueError) as error:
        load_trajectory(write(tmp_path, "mine.csv", text), robot=["a", "b"])
    parts = line.split(".*")
    assert "\n" not in str(error.value) and str(error.value).removeprefix(f"{tmp_path}/").startswith(parts[0])
    assert all(part in str(error.value) for part in parts)


def test_what_is_wrong_in_arrays_is_named(tmp_path):
    time, q, names = np.arange(3.0), np.ones((3, 2)), ["a", "b"]
    for arrays, said in (
        ({"time": time, "q": q}, "no joint_names; write time .*; yours has time, q"),
        ({"time": time, "joint_names": names}, "no q; "),
        ({"time": time, "q": q, "joint_names": ["a", "c"]}, "no joint 'b'; .*its joint_names: a, c"),
        ({"time": time, "q": q[:2], "joint_names": names}, r"q of shape \(2, 2\), not \(3, 2\)"),
        ({"time": 1.0, "q": q, "joint_names": names}, r"time of shape \(\), not \(1,\)"),
        ({"time": time, "q": np.array([None, 1]), "joint_names": names}, "cannot be read"),
        ({"time": time, "q": q * [1.0, np.nan], "joint_names": names}, "sample 0: q of b is nan"),
        ({"time": time, "q": q + 1j, "joint_names": names}, "q is no array of numbers; write time"),
        ({"time": time, "q": q, "joint_names": ["b", "b"]}, "joint_names: 'b' stands twice"),
        ({"time": time, "q": q, "joint_names": [1, 2]}, "joint_names is .1, 2.; write one name"),
        ({"time": [0.0, 2.0, 1.0], "q": q, "joint_names": names}, "sample 2: time is 1 after 2"),
    ):
        np.savez(tmp_path / "x.npz", **arrays)
        with pytest.raises(ValueError, match=f"x.npz.*{said}"):
            load_trajectory(tmp_path / "x.npz", robot=names)
    for content in (b"PK\x03\x04 no archive", b"text", b""):
        with pytest.raises(ValueError, match=r"x\.npz: cannot be read"):
            load_trajectory(write(tmp_path, "x.npz", content), robot=names)


def test_what_is_wrong_in_a_message_is_named(tmp_path):
    points = [{"positions": [k, 2.0 * k], "velocities": [], "time_from_start": {"sec": k, "nanosec": 0}} for k in range(3)]
    message = {"joint_names": ["a", "b"], "points": points}
    state = load_trajectory(write(tmp_path, "x.json", json.dumps(message)), robot=["a", "b"])  # no velocities, as ROS says it
    np.testing.assert_allclose(state.velocity, [[1.0, 2.0]] * 3)
    for old, new, said in (
        ('"joint_names"', '"names"', "no joint_names; write joint_names, and points with"),
        ('"nanosec"', '"nsecs"', "no nanosec; "),
        ("[1, 2.0]", "[1]", "q is no array of numbers"),
        ('["a", "b"]', '["a"]', "no joint 'b'"),
        ('["a", "b"]', '["a", "b", "a"]', "joint_names: 'a' stands twice"),
        ('["a", "b"]', '"ab"', "joint_names is ab; write one name"),
        ('["a", "b"]', "[1, 2]", "joint_names is .1, 2.; write one name"),
        ("{", "", "cannot be read"),
        ('"points": [', '"points": [], "more": [', "cannot be read .it has no points"),
    ):
        with pytest.raises(ValueError, match=f"x.json: {said}"):
            load_trajectory(write(tmp_path, "x.json", json.dumps(message).replace(old, new, 1)), robot=["a", "b"])
