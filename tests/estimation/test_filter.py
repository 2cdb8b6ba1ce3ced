"""The torque filter: its step response, its sensors, its refusals."""

import dataclasses

import jax
import numpy as np
import pytest
from torque_filters import JOINTS, a_filter


def test_step_response_is_of_first_order():
    known = a_filter()
    external = np.zeros(JOINTS)
    for k in range(50):
        external = known.step(external, -2.0 * known.current_per_torque, -2.0 * known.torsion_per_torque, 0.0)
        np.testing.assert_allclose(external, 2.0 * (1.0 - (1.0 - known.gain) ** (k + 1)), rtol=1e-12)


def test_one_sensor_alone():
    by_current = a_filter(torsion_noise=[np.inf] * JOINTS)
    np.testing.assert_allclose(by_current.residual(by_current.current_per_torque, 7.0, 3.0), 2.0)
    stiff = a_filter(torsion_per_torque=[0.0] * JOINTS)
    np.testing.assert_allclose(stiff.gain, by_current.gain)
    assert np.all(by_current.gain < a_filter().gain)


def test_a_sweep_is_one_vmap():
    known, noise = a_filter(), np.geomspace(1e-3, 1.0, 5)[:, None] * np.ones(JOINTS)
    swept = jax.vmap(lambda noise: dataclasses.replace(known, current_noise=noise).gain)(noise)
    np.testing.assert_allclose(swept, [dataclasses.replace(known, current_noise=each).gain for each in noise], rtol=1e-12)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"process": [1.0, np.nan, 1.0]}, r"process is \[ 1\. nan  1\.\]; allowed: finite numbers above zero"),
        ({"process": [1.0, np.inf, 1.0]}, "process is .* above zero"),
        ({"current_noise": [1.0, -1.0, 1.0]}, "current_noise is .* or infinite without that sensor"),
        ({"torsion_per_torque": [1.0, -1.0, 1.0]}, "torsion_per_torque is .* or 0 without that sensor"),
        ({"process": [1.0, 1.0]}, r"process \(2,\).*one number a joint"),
        ({"process": 1.0}, r"process \(\).*one number a joint"),
        ({"process": "much"}, "process: str that is no array of numbers"),
        ({"torsion_noise": [np.inf] * 3, "current_noise": [1.0, np.inf, 1.0]}, "joint 1 has no sensor"),
    ],
)
def test_refusals(changes, says):
    with pytest.raises(ValueError, match=says) as refused:
        a_filter(**changes)
    assert "\n" not in str(refused.value)
