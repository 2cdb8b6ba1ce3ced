"""The one base of results: rows, truth, reasons in words, and trees."""

from typing import Any, ClassVar

import jax
import numpy as np
import pytest

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
