"""Postures, limits and rates that the tests of replanners share."""

import numpy as np

START, GOAL = np.array([-0.9, 0.4, 0.0, -1.9, 0.0, 2.2, 0.8]), np.array([0.9, 0.4, 0.0, -1.9, 0.0, 2.2, 0.8])
LIMITS = {"velocity": 2.0, "acceleration": 8.0, "jerk": 200.0}
MARGIN, RATE = 0.01, 30.0  # [m]; updates [1/s]
