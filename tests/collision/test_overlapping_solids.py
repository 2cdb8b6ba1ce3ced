"""Solids that overlap or lie in each other: each is as deep as its own nearest way out, and the clearance is the least of them.

The oracle: how far a point is from each body by coal, and on which side by solid angles.
"""

import dataclasses

import coal
import jax
import numpy as np
import pytest
import trimesh
from peers.triangle_truth import in_coal, winding
from scipy.spatial.transform import Rotation

import jaxik
from jaxik.collision.bvh import grouped
from jaxik.collision.clearances import link_clearances, object_clearances

SLIDES = """name = "slides"
convention = "frames"
joint = [
  {{name = "x", type = "prismatic", axis = [1, 0, 0], lower = -2, upper = 2}},
  {{name = "y", type = "prismatic", axis = [0, 1, 0], lower = -2, upper = 2}},
  {{name = "z", type = "prismatic", axis = [0, 0, 1], lower = -2, upper = 2}},
]
shape = [{}]
"""
BALL = '{link = "z_link", kind = "sphere", points = [[0, 0, 0]], radius = 0.06}'
REST = """,
  {link = "y_link", kind = "capsule", points = [[0.1, 0, 0], [0.3, 0.1, 0]], radius = 0.02},
  {link = "z_link", kind = "triangle", points = [[0, 0.1, 0], [0.2, 0.2, 0], [0.1, 0, 0.1]], radius = 0.01},
"""
BODIES = [
    trimesh.creation.box((0.7, 0.5, 0.6)),
    trimesh.creation.icosphere(subdivisions=2, radius=0.35),
    trimesh.creation.annulus(0.15, 0.4, 0.3, sections=12),
    trimesh.creation.torus(0.3, 0.12, major_sections=12, minor_sections=8),
    trimesh.boolean.union(
        [
            trimesh.creation.box((0.7, 0.2, 0.3)),
            trimesh.creation.box((0.2, 0.8, 0.2), trimesh.transformations.translation_matrix((0.2, 0.2, 0.0))),
        ],
        engine="manifold",
    ),
]
MARGINS = np.linspace(-0.1, 0.1, 9)
SEEDS = range(6)


@pytest.fixture(scope="module")
def slides(tmp_path_factory):
    """A ball of 0.06 m on three slides."""
    file = tmp_path_factory.mktemp("slides") / "slides.toml"
    file.write_text(SLIDES.format(BALL))
    return jaxik.load(file)


@pytest.fixture(scope="module")
def many(tmp_path_factory):
    """Volumes of all kinds on three slides."""
    file = tmp_path_factory.mktemp("slides") / "slides.toml"
    file.write_text(SLIDES.format(BALL + REST))
    return jaxik.load(file)


def drawn(seed):
    """Two to four solids that overlap, triangles (k, 3, 3) each."""
    rng = np.random.default_rng(seed)
    for kind in rng.permutation(len(BODIES))[: 2 + seed % 3]:
        turn, size = Rotation.random(random_state=rng.integers(1000)), rng.uniform(0.5, 1.5)
        turned = np.array(BODIES[kind].triangles) @ turn.as_matrix().T
        yield size * turned + rng.uniform(-0.2, 0.2, 3)


def scene_of(bodies, one=False):
    """Each body an object, or all of them one."""
    builder = jaxik.collision.SceneBuilder()
    for i, triangles in enumerate([np.concatenate(bodies)] if one else bodies):
        builder.add(f"body{i}", triangles=triangles)
    return builder.scene()


def truth(bodies, q):
    """The signed distance of points (n, 3) to each body (n, bodies)."""
    still, found = coal.Transform3s.Identity(), []
    models = [(in_coal(triangles), triangles) for triangles in bodies]
    for point in q:
        at = in_coal(np.tile(point, (1, 3, 1)))
        for model, triangles in models:
            apart = coal.distance(at, still, model, still, coal.DistanceRequest(), coal.DistanceResult())
            found.append(-apart if winding(point, triangles) > 0.5 else apart)
    return np.reshape(found, (len(q), len(bodies)))


def batch(function):
    """A function of obstacles and one configuration, for many."""
    return jax.jit(jax.vmap(function, (None, 0)))


@pytest.mark.parametrize("one", [False, True])
def test_a_ball_is_as_deep_as_in_the_deepest_solid(slides, one):
    """Values, slopes and margins, also in float32, where the solids are objects each, or one object all together."""
    told = batch(jax.value_and_grad(lambda around, q: jaxik.clearance(slides, around, q), argnums=1))
    by_link = batch(lambda around, q: link_clearances(slides, around, q))
    hits = jax.jit(
        jax.vmap(jax.vmap(lambda around, q, m: jaxik.collides(slides, around, q, margin=m), (None, None, 0)), (None, 0, None))
    )
    deep = shallow = 0
    for seed in SEEDS:
        bodies, q = list(drawn(seed)), np.random.default_rng(seed).uniform(-0.4, 0.4, (200, 3))
        around, gaps = grouped(scene_of(bodies, one), slides), truth(bodies, q) - 0.06
        true = gaps.min(axis=1)
        distance, slope = told(around, q)
        np.testing.assert_allclose(distance, true, atol=1e-9)
        np.testing.assert_allclose(by_link(around, q)[:, -1], true, atol=1e-9)
        with jax.enable_x64(False):
            np.testing.assert_allclose(told(around, q.astype(np.float32))[0], true, atol=2e-6)
        kept = np.abs(true[:, None] - MARGINS) > 1e-9
        np.testing.assert_array_equal(np.asarray(hits(around, q, MARGINS))[kept], (true[:, None] < MARGINS)[kept])
        sides = np.stack([[told(around, q + s * e)[0] for e in 1e-6 * np.eye(3)] for s in (1.0, -1.0)])
        even = np.abs(sides.sum(axis=0).T - 2.0 * np.asarray(distance)[:, None]).max(axis=1) < 1e-10
        np.testing.assert_allclose(slope[even], (sides[0] - sides[1]).T[even] / 2e-6, atol=1e-6)
        deep += np.sum(even & (np.sum(gaps < -0.06, axis=1) > 1))
        shallow += np.sum(even & (true > 0.0))
    assert deep > 100 and shallow > 100


def test_a_small_solid_in_a_large_one_hides_no_depth(slides):
    """0.5 m to the side of the large one, beside the radius; and so it is where the scene is traced, or moved."""
    bodies = [np.asarray(trimesh.creation.box((edge,) * 3).triangles) for edge in (1.0, 0.4)]
    q = np.array([0.0, 0.01, 0.02])
    for one in (False, True):
        scene = scene_of(bodies, one)
        assert np.isclose(jaxik.clearance(slides, scene, q), -0.54)
        traced = jax.jit(lambda scene, q: (jaxik.clearance(slides, scene, q), link_clearances(slides, scene, q)[-1]))
        np.testing.assert_allclose(traced(scene, q), -0.54)
        np.testing.assert_allclose(traced(scene.padded(), q), -0.54)
        shifted = lambda x, scene=scene: jax.tree_util.tree_map(lambda a: a + x if a.ndim == 2 else a, scene)
        by_place = jax.value_and_grad(lambda x, shifted=shifted: jaxik.clearance(slides, shifted(x), q))
        value, slope = by_place(np.zeros(3))
        assert np.isclose(value, -0.54) and np.allclose(slope, [0.0, 0.0, -1.0])
        for told in (jaxik.explain(slides, scene, q).contacts, object_clearances(slides, scene, q)):
            assert np.isclose(min(getattr(each, "distance", each) for each in told), -0.54)
    for told in (object_clearances, jax.jit(object_clearances, static_argnums=0)):
        np.testing.assert_allclose(told(slides, scene_of(bodies), q), [-0.54, -0.24])
    assert np.isclose(jaxik.clearance(slides, scene_of(bodies).without("body0"), q), -0.24)
    assert np.isclose(jaxik.clearance(slides, scene_of(bodies).without("body1"), q), -0.54)


def test_the_least_of_all_objects_is_the_clearance(many):
    """Lines and triangles are measured, too; `explain` says the same of each object."""
    for seed in SEEDS:
        scene, q = scene_of(list(drawn(seed))), np.random.default_rng(seed).uniform(-0.5, 0.5, (100, 3))
        around = grouped(scene, many)
        least = np.asarray(batch(lambda around, q: jaxik.clearance(many, around, q))(around, q))
        every = np.asarray(jax.vmap(lambda q, s=scene: object_clearances(many, s, q))(q))
        np.testing.assert_allclose(least, every.min(axis=1), atol=1e-12)
        for i in range(5):
            told = [c for c in jaxik.explain(many, scene, q[i], count=99).contacts if c.other.startswith("body")]
            for name, apart in zip(scene.object_names, every[i], strict=True):
                assert np.isclose(min(c.distance for c in told if c.other == name), apart, atol=1e-12)


def test_what_a_link_ignores_hides_nothing(slides):
    """A link that ignores one of two solids is as deep in the other as if it were alone."""
    bodies = list(drawn(0))[:2]
    q = np.random.default_rng(3).uniform(-0.3, 0.3, (100, 3))
    true, scene = truth(bodies, q) - 0.06, scene_of(bodies)
    link = slides.link_names.index("z_link")
    for other, name in enumerate(reversed(scene.object_names)):
        robot = dataclasses.replace(slides, ignored=((link, name),))
        found = batch(lambda around, q, robot=robot: jaxik.clearance(robot, around, q))(grouped(scene, robot), q)
        np.testing.assert_allclose(found, true[:, other], atol=1e-9)
        traced = batch(lambda scene, q, robot=robot: jaxik.clearance(robot, scene, q))(scene, q[:20])
        np.testing.assert_allclose(traced, true[:20, other], atol=1e-9)
