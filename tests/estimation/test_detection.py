"""Alarms: thresholds from logs without contact, blindness at rest, false alarms and delays counted."""

import numpy as np
import pytest

from jaxik.estimation import Detector, fit_detector

RATES = np.ones((1, 100, 2))
TWO = Detector(np.ones(2), np.zeros(2), np.zeros(2), 0)


def test_thresholds_are_the_largest_errors_or_a_quantile():
    errors = np.random.default_rng(0).normal(size=(3, 100, 2))
    rates = np.broadcast_to(RATES, errors.shape)
    np.testing.assert_allclose(fit_detector(errors, rates, factor=1.5).threshold, 1.5 * np.abs(errors).max(axis=(0, 1)))
    lower = fit_detector(errors, rates, quantile=0.9, factor=1.0)
    assert lower.detect(errors, rates).mean() == pytest.approx(0.1, abs=0.01)


def test_at_rest_the_band_is_added_and_what_is_seen_there_sets_no_threshold():
    errors, rates = np.full((100, 2), 0.5), np.ones((100, 2))
    errors[40:60], rates[40:50] = 4.0, 0.0  # the filter remembers for ten samples
    found = fit_detector(errors, rates, band=[5.0, 3.0], rest=0.1, memory=10, factor=2.0)
    np.testing.assert_allclose(found.threshold, 1.0)
    assert not found.detect(errors, rates)[:, 0].any()
    np.testing.assert_array_equal(np.flatnonzero(found.detect(errors + 0.1, rates)[:, 1]), np.arange(40, 60))


def test_a_loop_is_what_a_log_is():
    detector = Detector(np.array([1.0]), np.array([2.0]), np.array([0.1]), 3)
    external, rates = 4.0 * np.random.default_rng(1).normal(size=(2, 50, 1))
    rates[20:30] = 0.0
    since, alarms = detector.init(), []
    for each, rate in zip(external, rates, strict=True):
        since, alarm = detector.step(since, each, rate)
        alarms.append(alarm)
    np.testing.assert_array_equal(detector.detect(external, rates), alarms)
    for broken in ((np.nan, 0.5), (0.5, np.nan), (-np.inf, 0.5)):
        assert detector.step(detector.init(), *np.array(broken)[:, None])[1].all()


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: fit_detector(np.zeros((5, 2)), np.zeros((5, 3))), r"allowed: \(..., t, n\) both"),
        (lambda: fit_detector(np.zeros((5, 2)), np.zeros((5, 2)), rest=0.1), "joint 0, counted from 0, is never faster"),
        (lambda: fit_detector(np.ones((5, 1)), np.zeros((5, 1)), rest=0.1, joint_names=["elbow"]), "elbow is never faster"),
        (lambda: fit_detector(np.ones((5, 2)), np.ones((5, 2)), quantile=2.0), "quantile is 2; it is at most 1"),
        (lambda: fit_detector(np.ones((5, 2)), np.ones((5, 2)), band=[1.0, 2.0, 3.0]), "band is .* each of 2 joints"),
        (lambda: fit_detector(np.ones((5, 2)), np.ones((5, 2)), rest=np.nan), "rest is nan; allowed: one number"),
        (lambda: fit_detector(np.full((5, 2), np.nan), np.ones((5, 2))), "external holds nan"),
        (lambda: fit_detector(np.ones((5, 2)), np.full((5, 2), np.nan)), "fit_detector: velocity holds nan"),
        (lambda: TWO.detect(np.ones((5, 2)), np.full((5, 2), np.nan)), "detect: velocity holds nan"),  # in a loop it is at rest
        (lambda: TWO.detect(np.ones((5, 3)), np.ones((5, 3))), "detect: external of 3 joints, and a detector of 2"),
    ],
)
def test_refusals(call, says):
    with pytest.raises(ValueError, match=says) as refused:
        call()
    assert "\n" not in str(refused.value)
