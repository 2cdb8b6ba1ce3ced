"""The one base of options: what a caller gives is kept or refused in one line, and what is declared is told."""

from typing import Any, Literal

import numpy as np
import pytest

from jaxik.kinematics import Task
from jaxik.options import Options, anything, choice, count, fields, flag, instance, number, per_joint


class Plain(Options, who="search"):
    """How `search` searches."""

    margin: float = number(default=0.0, unit="m", words="least clearance")
    weight: float | None = number(default=None, above=0.0, most=2.0, optional=True, words="of what is added")
    rounds: int = count(default=500, most=1000, words="of the search")
    solutions: int | str = count(default=1, also=("all",), words="answers")
    kind: str | bool = choice(default="near", kinds=Literal["near", "far"], also=(False,), words="where it looks")
    still: bool = flag(default=False, words="whether it stands")
    velocity: Any = per_joint(unit="rad/s", words="the limit")
    task: Task | None = instance(default=None, kind=Task, optional=True, words="what is bound")
    locked: Any = anything(default={}, words="what stays")

    def check(self) -> None:
        if self.still and self.rounds > 900:
            raise ValueError("search: what stands takes 900 rounds at most")


def test_what_is_given_is_kept():
    options = Plain(margin=1, rounds=np.int32(3), solutions="all", kind=False, still=np.True_, velocity=[1, 2], locked={"a": 1})
    assert (options.margin, options.rounds, options.solutions, options.kind, options.still) == (1, 3, "all", False, True)
    assert type(options.rounds) is int and options.velocity == (1.0, 2.0) and Plain().locked == {}
    assert hash(Plain(locked=())) == hash(Plain(locked=())) and Plain(margin=1.0) == Plain(margin=1.0) != Plain()


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"margin": np.nan}, "search: margin is nan; it is a finite number"),
        ({"margin": True}, "search: margin is True"),
        ({"weight": 0.0}, "search: weight is 0.0; allowed: a finite number above 0"),
        ({"weight": 3}, "at most 2"),
        ({"rounds": 0}, "allowed: a count, which is an integer and at least 1"),
        ({"rounds": 1001}, "search: rounds is 1001; at most 1000"),
        ({"solutions": "some"}, 'or "all"'),
        ({"kind": "nowhere"}, "search: kind 'nowhere'; allowed: near, far"),
        ({"kind": None}, "search: kind 'None'"),
        ({"still": 1}, "search: still is 1; allowed: True, False"),
        ({"velocity": [1.0, -1.0]}, r"search: velocity \[rad/s\] is \[1.0, -1.0\]; allowed: one number, or one a joint"),
        ({"task": "pose"}, "search: task is pose; write a jaxik.Task"),
        ({"still": True, "rounds": 901}, "what stands takes 900"),
        ({"margins": 0.1}, r"search: unknown option 'margins'; did you mean 'margin'\? allowed: margin, weight"),
    ],
)
def test_what_is_refused_says_why(given, words):
    with pytest.raises(ValueError, match=words) as error:
        Plain.chosen(None, given)
    assert "\n" not in str(error.value)


def test_changes_go_into_what_is_given():
    assert Plain.chosen(Plain(rounds=7), {"margin": 0.1}) == Plain(rounds=7, margin=0.1)
    assert Plain.chosen(None, {}) == Plain()
    with pytest.raises(ValueError, match="search: options is near; write a"):
        Plain.chosen("near", {})


def test_what_is_declared_is_told():
    assert fields(Plain)["margin"].unit == "m"
    lines = Plain.__doc__.splitlines()
    assert lines[0] == "How `search` searches." and "margin [m]: least clearance (0 unless given)." in lines
