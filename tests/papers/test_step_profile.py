"""The motion that the 9-DOF paper describes: SciPy's integrals of it, and its words."""

import numpy as np
from papers.step_profile import risen
from scipy.integrate import cumulative_simpson

GOAL = np.array([0.08, 0.8, -3.9])


def test_a_motion_as_the_words_say():
    motion = risen(GOAL, 0.01, rise=0.4, count=2001)
    for above, below in ((motion.q, motion.velocity), (motion.velocity, motion.acceleration)):
        whole = cumulative_simpson(below, x=motion.time, axis=0, initial=0.0)
        np.testing.assert_allclose(above, whole, atol=1e-8 * np.abs(above).max())
    np.testing.assert_allclose(motion.q[[0, -1]], [0.0 * GOAL, GOAL], atol=1e-15)
    assert (np.diff(motion.q * np.sign(GOAL), axis=0) >= 0.0).all()  # "uniformly increasing"
    late = motion.time >= 0.004 - 1e-12
    np.testing.assert_allclose(motion.velocity[late], np.broadcast_to(GOAL / 0.008, (late.sum(), 3)), rtol=1e-12)
    assert not motion.acceleration[0].any() and np.abs(motion.acceleration[late]).max() < 1e-6
