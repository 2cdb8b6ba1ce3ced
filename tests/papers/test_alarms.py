"""The measure of alarms, by hand, and what it refuses."""

import numpy as np
import pytest
from papers.alarms import judge_alarms


def test_alarms_are_judged():
    alarms, contact = np.zeros((2, 20), bool)
    contact[5:10] = contact[15:18] = True
    alarms[[0, 1, 3, 7, 8, 10]] = True  # two false ones, one after 0.2 s and still on just behind its contact, a miss
    found = judge_alarms(alarms, contact, 0.1, after=0.2)
    assert found.false_alarms == 2 and found.free_time == pytest.approx(0.1 * (20 - 8 - 4))
    np.testing.assert_allclose(found.delay, [0.2, np.nan])


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: judge_alarms(np.zeros(3), np.zeros(4), 0.1), r"alarms of shape \(3,\)"),
        (lambda: judge_alarms(np.zeros(3), np.zeros(3), 0.0), "judge_alarms: dt is 0 s"),
        (lambda: judge_alarms(np.zeros(3), np.zeros(3), 0.1, after=np.inf), "after is inf s"),
    ],
)
def test_refusals(call, says):
    with pytest.raises(ValueError, match=says):
        call()
