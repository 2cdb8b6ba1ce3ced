"""The one base of results: rows, truth, reasons in words, and trees."""

import dataclasses
from typing import Any, ClassVar

import jax
import numpy as np
import pytest

import jaxik
from jaxik.pytree import static
from jaxik.reasons import Reason
from jaxik.results import Result, by_row


class Found(Result):
    """A result for these tests."""

    q: Any
    reason: Any
    where: Any = by_row(default="")
    ways: Any = None
    robot: str = static(default="arm")
    HELP: ClassVar = {Reason.LIMITS: "widen them"}


ONE = Found(np.zeros(2), Reason.LIMITS, "start", None)
OTHER = Found(np.ones(2), Reason.SOLVED, "", np.zeros((3, 2)))
BATCH = Found.stacked([ONE, OTHER, ONE])


def test_a_single_result_is_true_if_it_is_solved():
    assert not ONE and OTHER and len(ONE) == 1 and ONE[0] is ONE and [*ONE] == [ONE]
    assert ONE.why == "start: limits; widen them" and OTHER.why == "solved" and ONE.counts() == {"limits": 1}
    with pytest.raises(IndexError):
        ONE[1]
    assert len(ONE[:]) == 1 and not ONE[:].single
    for none in (slice(0), [], np.array([False])):  # as of a batch, whose rows are filtered
        assert len(ONE[none]) == 0 and ONE[none].q.shape == (0, 2) and ONE[none].where == ()
    assert ONE[[0, 0]].where == ("start", "start")


def test_a_batch_has_rows_and_no_truth():
    assert len(BATCH) == 3 and BATCH.success.tolist() == [False, True, False] and BATCH.counts() == {"solved": 1, "limits": 2}
    with pytest.raises(ValueError, match=r"the truth of 3 results is not one answer; ask success.all\(\) or success.any\(\)"):
        bool(BATCH)
    row = BATCH[1]
    assert row and row.reason is Reason.SOLVED and row.where == "" and row.ways.shape == (3, 2) and row.robot == "arm"
    assert [bool(each) for each in BATCH] == [False, True, False] and BATCH[-1].where == "start"
    for rows in (slice(1, None), [1, 2], np.array([False, True, True])):
        assert BATCH[rows].where == ("", "start") and BATCH[rows].q.shape == (2, 2) and len(BATCH[rows].ways) == 2
    assert BATCH.why.tolist() == ["start: limits; widen them", "solved", "start: limits; widen them"]
    assert len(BATCH[:0]) == 0 and BATCH[:0].why.shape == (0,) and BATCH[:0].counts() == {}


def test_it_is_a_tree():
    plain = Found(np.zeros((2, 3)), np.array([0, 2]), ("", "goal"))
    doubled = jax.tree_util.tree_map(lambda x: np.concatenate([x, x]), plain)
    assert len(doubled) == 4 and doubled.where == ("", "goal")


def test_it_prints_what_a_person_asks_first():
    assert repr(BATCH).splitlines()[0] == "Found: 1 of 3 solved, 2 limits" and repr(ONE).startswith(
        "Found: start: limits; widen them\n"
    )
    assert "  q: [0. 0.]" in repr(ONE) and "robot" not in repr(ONE)
    assert "float64[20, 2]" in repr(Found(np.zeros((20, 2)), np.zeros(20, int)))


SMALL = jaxik.load("planar2")
SCENE = jaxik.make_scene(spheres=[[0.5, 0.1, 0.4, 0.1]])
PATH = jaxik.planning.JointPath.polyline(np.eye(2))
FIELDS = {  # what is static in a result, and what more than an array it holds
    "robot": SMALL,
    "scene": SCENE,
    "solved_in": (SMALL, SCENE, 0.0),
    "blockers": (jaxik.harvesting.Blockers(("leaf",), (1.0,), ("leaf",), 0),),
    "stages": (jaxik.harvesting.Stage("home", "", 0.0, jaxik.planning.time_path(PATH, velocity=1.0, acceleration=1.0)),),
    "base": jaxik.identification.base_parameters(SMALL),
    "reason": np.zeros(1, int),
}
SCAN = jaxik.harvesting.ScanResult
OTHERS = jaxik.motions, jaxik.touch, jaxik.teleoperation  # packages that have results, too, once they are imported


def _example(kind):
    """A result with one row, whose arrays are of no use: made past the constructor, which would ask for their shapes."""
    made = object.__new__(kind)
    for field in dataclasses.fields(kind):
        usual = ("a",) if field.metadata.get("by_row") else 0.0 if field.metadata.get("static") else np.ones(1)
        vars(made)[field.name] = (_example(SCAN),) if field.name == "scan" else FIELDS.get(field.name, usual)
    if "options" in vars(made):  # made anew, so that their values are compared
        vars(made)["options"] = jaxik.harvesting.HarvestOptions(angles=np.linspace(0.0, 1.0, 3), slides=[[0.1], [0.2]])
    return made


def _kinds(kind):
    return [kind, *(each for below in kind.__subclasses__() for each in _kinds(below))]


@pytest.mark.parametrize("kind", [each for each in _kinds(Result)[1:] if each is not Found], ids=lambda kind: kind.__name__)
def test_every_result_goes_through_jit(kind):
    traces = []
    through = jax.jit(lambda result: traces.append(0) or result)
    for _ in range(2):
        assert through(_example(kind)) == _example(kind)
    assert len(traces) == 1 and isinstance(hash(_example(kind)), int)
