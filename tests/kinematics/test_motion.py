"""The container of joints over time: what it holds is counted, iterated and picked along its first axis."""

import numpy as np
import pytest

from jaxik.kinematics import Motion


@pytest.mark.parametrize("shape", [(5, 2), (4, 5, 2), (0, 2)])
def test_a_motion_is_as_long_as_what_it_yields(shape):
    q = np.random.default_rng(0).normal(size=shape)
    motion = Motion(q, velocity=2.0 * q, time=np.zeros(shape[:-1]))
    each = list(motion)
    assert len(motion) == len(each) == shape[0] and motion
    for k, one in enumerate(each):
        np.testing.assert_array_equal(one.q, q[k])
        np.testing.assert_array_equal(motion[k].velocity, 2.0 * q[k])


def test_a_single_moment_has_no_length():
    """A moment is true all the same; who asks for its samples is told."""
    moment = Motion(np.zeros(3))
    assert moment
    for ask in (len, iter, lambda motion: motion[0]):
        with pytest.raises(TypeError, match="a single moment of a motion has no samples"):
            ask(moment)
