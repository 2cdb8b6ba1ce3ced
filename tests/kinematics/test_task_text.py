"""Tasks in words are those that the makers make; other words are refused in one line."""

import numpy as np
import pytest

import jaxik
from jaxik import Task
from jaxik.kinematics import read_task

TEN = np.radians(10.0)
SAID = {
    "pose": Task.pose(),
    "pose free yaw": Task.pose("yaw"),
    "pose free roll,pitch axes base": Task.pose(("roll", "pitch"), axes="base"),
    "pose free yaw within x=5cm,z=0..0.1,roll+pitch=10deg": Task.pose(
        "yaw", within={"x": 0.05, "z": (0.0, 0.1), ("roll", "pitch"): TEN}
    ),
    "position within z=0..inf": Task.position(within={"z": (0.0, np.inf)}),
    "position within position=3mm": Task.position(within={"position": 0.003}),
    "position at 0.4,0,30cm": Task.position().at(jaxik.pose([0.4, 0.0, 0.3])),
    "pose at 0,0,0,0,1,0,0": Task.pose().at(np.diag([1.0, -1.0, -1.0, 1.0])),
    "pointing x within 0.1rad weight 2": Task.pointing("x", within=0.1, weight=2.0),
    "upright": Task.upright(),
    "upright z within 10deg": Task.upright("z", within=TEN),
    "upright along z within 10deg": Task.upright("z", within=TEN),
    "looking y within 0.2 tip camera": Task.looking("y", within=0.2, tip="camera"),
    "distance 20..30cm": Task.distance((0.2, 0.3)),
    "distance 0.2 tip hand relative table": Task.distance(0.2, tip="hand", relative="table"),
    "cylinder 5cm": Task.cylinder(0.05),
    "cylinder 5cm height -1cm..0.1 axes base": Task.cylinder(0.05, (-0.01, 0.1), axes="base"),
    "line x": Task.line("x"),
    "plane z within 2mm": Task.plane("z", within=0.002),
}


@pytest.mark.parametrize("text", SAID)
def test_words_say_what_the_makers_make(text):
    found, wanted = read_task(text), SAID[text]
    assert [each[:1] for each in found.within] == [each[:1] for each in wanted.within]
    for one, other in zip(found.within, wanted.within, strict=True):
        np.testing.assert_allclose(one[1:], other[1:], rtol=1e-15)
    assert all(
        getattr(found, name) == getattr(wanted, name) for name in ("bound", "axes", "tip", "relative", "weight", "target")
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "upright z within 10deg"),
        (3, "upright z within 10deg"),
        ("uprihgt z", "did you mean 'upright'"),
        ("upright z wthin 3", "did you mean 'within'"),
        ("upright z within 10cm", "unit cm; allowed: deg, rad"),
        ("pose within x=5deg", "unit deg; allowed: mm, cm, m"),
        ("upright z within 4", "from 0 to pi"),
        ("upright z within nan", "from 0 to pi"),
        ("upright z within", "without a value"),
        ("upright z within 0.1 within 0.2", "twice"),
        ("upright w", "allowed: x, y, z"),
        ("distance", "needs its within"),
        ("distance 0.3..0.2", "low <= high"),
        ("pose within q=1", "roll, pitch, yaw"),
        ("pose within x=0.1,x=0.2", "names 'x' twice"),
        ("pose free yav", "allowed: x, y"),
        ("plane z within wide", "is no number"),
        ("position at 1,2", "x,y,z"),
        ("pose weight -1", "weight is -1"),
        ("own f", "in Python"),
    ],
)
def test_other_words_are_refused(text, words):
    with pytest.raises(ValueError, match=words) as error:
        read_task(text)
    assert "\n" not in str(error.value) and str(error.value).startswith("task")
