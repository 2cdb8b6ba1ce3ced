"""A horizon that minds a cloud of points, another one again and again, judged by SciPy's tree of the points."""

import numpy as np
from scipy.spatial import cKDTree
from setups.pendulum import IN_PLANE, OBSTACLE, START, arm
from setups.pendulum import path as straight

import jaxik
from jaxik.collision.volumes import skeletons

ARM, RADIUS, WITHIN, THICK = arm(), 0.005, 0.2, 0.08  # [m]: of points, of the cost's reach, of the ball that they fill
DT, COUNT, DURATION = 0.04, 30, 4.0  # [s] of a sample, samples ahead, [s] of the motion


def ball(t, rng, count=1000):
    """Points in a ball that moves away from the arm's base, others each time."""
    way = rng.normal(size=(count, 3))
    way *= THICK * rng.random((count, 1)) ** (1.0 / 3.0) / np.linalg.norm(way, axis=1)[:, None]
    return (np.add(OBSTACLE, [0.02 * t, 0.0, 0.0]) + way).astype(np.float32)


def gap(q, points):
    """The least distance of places along the arm's lines to the points' balls [m]."""
    least, tree, share = np.inf, cKDTree(points), np.linspace(0.0, 1.0, 200)
    for skeleton in skeletons(ARM, q.tolist(), np.float64).values():
        corners = [np.stack(np.broadcast_arrays(*map(np.asarray, c)), axis=-1) for c in skeleton.corners]
        a, b, radii = corners[0], corners[-1], np.asarray(skeleton.radius)
        places = a[:, None] + share[:, None] * (b - a)[:, None]
        least = min(least, (tree.query(places)[0] - radii[:, None]).min())
    return least - RADIUS


def moved(minds):
    """How near the arm comes to the points [m], and how many programs its controller has."""
    rng, path, scene = np.random.default_rng(0), straight(ARM), jaxik.make_scene()

    def near(q, scene):
        return jaxik.costs.collision_cost(jaxik.clearance(ARM, scene, q, within=WITHIN), activation=WITHIN, maximum=20.0)

    cost = jaxik.costs.quadratic_cost(position=near if minds else lambda q, scene: 0.0)
    control = jaxik.motions.PredictiveController(ARM, cost, dt=DT, count=COUNT, task=IN_PLANE, gain=5.0)
    state, gaps = control.init(START), []
    for sample in range(round(DURATION / DT)):
        if sample % 4 == 0:
            points = ball(sample * DT, rng)
            scene = scene.with_cloud(points, RADIUS)
        state, now = control.step(state, path, DURATION, given=scene)
        gaps.append(gap(np.asarray(now.q), points))
    return min(gaps), control._program._cache_size(), float(np.abs(now.error).max())


def test_a_horizon_keeps_away_from_a_cloud_that_is_replaced_and_compiles_once():
    near, _, _ = moved(minds=False)
    away, programs, error = moved(minds=True)
    assert near < 0.0 < 0.02 < away, (near, away)  # the arm has no thickness: a hit is less than a radius deep
    assert programs == 1 and error < 5e-3
