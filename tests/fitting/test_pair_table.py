"""Tables of pairs of links: bounds of coal's distance, and the same however the nearest pair is sought."""

import dataclasses
import itertools

import coal
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from motions import dense
from robot_files import refused, write

import jaxik
from jaxik.collision.clearances import link_clearances
from jaxik.collision.nearest_pair import Space
from jaxik.fitting.bodies import Body
from jaxik.fitting.link_distance_tables import table_of
from jaxik.spmd import kernel

BASE, BEAM, TIP = (0.2, 0.16, 0.3), (0.5, 0.05, 0.05), (0.3, 0.03, 0.03)
ARM = """<robot name="arm">
<link name="base"><collision><geometry><box size="0.2 0.16 0.3"/></geometry></collision></link>
<joint name="turn" type="continuous"><parent link="base"/><child link="hub"/><axis xyz="0 0 1"/></joint>
<link name="hub"/>
<joint name="lift" type="revolute"><parent link="hub"/><child link="beam"/><origin xyz="0 0 0.1"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="1.5"/></joint>
<link name="beam"><collision><origin xyz="0.25 0.15 0"/><geometry><box size="0.5 0.05 0.05"/></geometry></collision></link>
<joint name="twist" type="revolute"><parent link="beam"/><child link="tip"/><origin xyz="0.3 0.14 0"/><axis xyz="1 0 0"/>
<limit lower="-3" upper="3"/></joint>
<link name="tip"><collision><origin xyz="-0.15 0 0"/><geometry><box size="0.3 0.03 0.03"/></geometry></collision></link>
</robot>"""
SLIDING = ARM.replace('"lift" type="revolute"', '"lift" type="prismatic"').replace('axis xyz="0 1 0"', 'axis xyz="1 0 0"')
SLIDING = SLIDING.replace('lower="-2" upper="1.5"', 'lower="-0.6" upper="0.2"')
EXACT = 1e-5  # [m] to which coal finds depths, and GJK distances
PLACES = {"base": np.zeros(3), "beam": np.array([0.25, 0.15, 0.0]), "tip": np.array([-0.15, 0.0, 0.0])}
SIZES = {"base": BASE, "beam": BEAM, "tip": TIP}


def corners(name, sizes=SIZES, places=PLACES):
    half = np.array(sizes[name]) / 2.0
    return places[name] + half * np.array(list(itertools.product((-1.0, 1.0), repeat=3)))


def signed(robot, first, second, q, sizes=SIZES, places=PLACES):
    """How far two links' boxes are apart, by coal."""
    request, told = coal.DistanceRequest(), coal.DistanceResult()
    request.enable_signed_distance = True
    a, b = (coal.Box(*sizes[name]) for name in (first, second))
    frames = np.asarray(jax.vmap(lambda q: jaxik.kinematics.link_frames(robot, q))(q))
    index, found = [robot.link_names.index(name) for name in (first, second)], []
    for one, other in frames[:, index]:
        told.clear()
        at = [coal.Transform3s(f[:3, :3], f[:3, :3] @ places[n] + f[:3, 3]) for f, n in ((one, first), (other, second))]
        found.append(coal.distance(a, at[0], b, at[1], request, told))
    return np.array(found)


@pytest.fixture(scope="module")
def kinematics(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arms")
    arms = {"turning": ARM, "sliding": SLIDING}
    return {name: jaxik.load(write(folder, f"{name}.urdf", text), tip="tip") for name, text in arms.items()}


@pytest.mark.parametrize("kind", ["turning", "sliding"])
@pytest.mark.parametrize("other", ["beam", "tip"])
def test_a_table_bounds_coals_distance(kinematics, kind, other):
    """Inside the limits, beyond them and turns away; of the tip, which turns between, for all that it sweeps."""
    robot, rng = kinematics[kind], np.random.default_rng(0)
    links = {name: robot.link_names.index(name) for name in ("base", other)}
    bodies = {links[name]: [Body(corners(name))] for name in links}
    limits = robot.finite_limits
    inside = rng.uniform(*limits, (3000, 3))
    true = signed(robot, "base", other, inside)
    free = (true > 0.0) & (true < 0.01)
    table = table_of(robot, tuple(links.values()), bodies, limits, inside[free], 128)
    assert table.joints == (0, 1) and table.turns == (True, False) and free.sum() > 50
    assert np.abs(true).min() < 1e-4 and (true < 0.0).mean() > 0.02
    assert (table(inside) - true).max() < EXACT
    if other == "beam":  # what sweeps nothing
        short = (true - table(inside))[(true > 0.0) & (true < 0.02)]
        assert np.median(short) < 3e-4
    beyond = rng.uniform(limits[0] - 4.0, limits[1] + 4.0, (1000, 3))
    assert (table(beyond) - signed(robot, "base", other, beyond)).max() < EXACT
    assert np.mean(table(inside[free]) > 0.0) > (0.8 if other == "beam" else 0.3)
    moved = rng.normal(size=inside.shape) * 0.02  # over the ends of a whole turn, too
    moved = np.clip(inside + moved, *limits) - inside
    for least in (-np.inf, 0.0):
        changed = np.abs(np.maximum(table(inside + moved), least) - np.maximum(table(inside), least))
        most = np.abs(moved[:, :2]) @ table.slopes(least)
        assert np.all(changed <= most + 1e-12) and np.max(changed / most) > 0.3


@pytest.mark.parametrize("kind", ["turning", "sliding"])
def test_nothing_slips_between_the_nodes(kinematics, kind):
    """Plates of 4 mm pass through each other 60 cm from the axis, where a cell of the table is 3 cm."""
    robot, rng = kinematics[kind], np.random.default_rng(3)
    sizes = {"base": (0.3, 0.004, 0.3), "beam": (0.2, 0.004, 0.2)}
    places = {"base": np.array([0.6, 0.0, 0.1]), "beam": np.array([0.6, 0.0, 0.0])}
    links = {name: robot.link_names.index(name) for name in sizes}
    bodies = {links[name]: [Body(corners(name, sizes, places))] for name in sizes}
    limits = robot.finite_limits
    inside = rng.uniform(*limits, (3000, 3))
    inside[:2000, 0] = rng.choice([0.0, np.pi, -np.pi], 2000) + 0.01 * rng.normal(size=2000)
    true = signed(robot, "base", "beam", inside, sizes, places)
    table = table_of(robot, tuple(links.values()), bodies, limits, inside[true > 0.1], 128)
    assert ((true < 0.0) & (true > -0.004)).sum() > 50 and (table(inside) - true).max() < EXACT
    assert table(inside[true > 0.1]).min() > 0.03


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """One that its tables and volumes alone know, without its convex parts."""
    arm = jaxik.load(write(tmp_path_factory.mktemp("arm"), "arm.urdf", ARM), tip="tip", meshes=True)
    return dataclasses.replace(arm, convex_parts=())


@pytest.fixture(scope="module")
def postures(arm):
    return np.random.default_rng(1).uniform(*arm.finite_limits, (2000, 3))


def test_a_fitted_robot_is_as_free_as_its_links(arm, postures):
    """None missed; without its tables the robot collides falsely."""
    assert {tuple(arm.link_names[i] for i in t.links) for t in arm.pair_tables} >= {("base", "beam")}
    true = np.minimum(signed(arm, "base", "beam", postures), signed(arm, "base", "tip", postures))
    share = lambda robot: np.asarray(jax.vmap(lambda q: jaxik.clearance(robot, None, q))(postures)) <= 0.0
    known, bare = share(arm), share(dataclasses.replace(arm, pair_tables=()))
    assert np.all(bare | ~known) and not np.any(~known & (true < -EXACT))
    known, bare = np.mean(known & (true > 0.0)), np.mean(bare & (true > 0.0))
    assert known < 0.08 and bare > 5.0 * known


@pytest.mark.kernels(reason="the same bits of two programs are a promise of kernels alone")
def test_the_search_skips_and_stops_as_without(arm, postures):
    """Flat and hierarchical distances are equal to the last bit, by links, too; so are the answers of `collides`."""

    class Flat(Space):
        def _if(self, near, inside, found):
            return inside(found)

    flat = kernel(lambda q: Flat(arm, (), q).all().distance)
    found = np.asarray(jax.vmap(lambda q: jaxik.clearance(arm, None, q))(postures))
    assert np.array_equal(np.asarray(jax.vmap(flat)(postures)), found)
    assert np.array_equal(np.asarray(jax.vmap(lambda q: link_clearances(arm, None, q))(postures)).min(axis=1), found)
    for margin in (0.0, 0.004):
        assert np.array_equal(
            np.asarray(jax.vmap(lambda q, m=margin: jaxik.collides(arm, None, q, margin=m))(postures)), found < margin
        )
    for q, apart in zip(postures[:20], found, strict=False):
        assert jaxik.explain(arm, None, q).contacts[0].distance == pytest.approx(float(apart), abs=1e-12)


def test_gradients_are_differences(arm, postures):
    """Where the table decides, whether q moves alone or the scene with it."""
    scene = jaxik.make_scene(spheres=[[3.0, 0.0, 0.0, 0.1]])
    apart = lambda q: jaxik.clearance(arm, None, q)
    beside = lambda q, x: jaxik.clearance(
        arm, dataclasses.replace(scene, spheres=dataclasses.replace(scene.spheres, radius=x)), q
    )
    slopes = np.asarray(jax.vmap(jax.grad(apart))(postures))
    step = 1e-7 * np.eye(3)
    change = np.stack([np.asarray(jax.vmap(apart)(postures + e) - jax.vmap(apart)(postures - e)) for e in step], axis=1) / 2e-7
    off = np.abs(slopes - change).max(axis=1)
    assert np.quantile(off, 0.95) < 1e-6  # all but those at a node's line or an edge
    both = jax.vmap(jax.grad(beside, (0, 1)), (0, None))(postures[:200], scene.spheres.radius)
    np.testing.assert_allclose(both[0], slopes[:200], atol=1e-12)
    assert not np.any(both[1])


def test_motions_are_proven_with_tables(arm, postures):
    q_from, q_to = postures[:150], postures[150:300]
    found = jax.vmap(lambda a, b: jaxik.motion_clearance(arm, None, a, b))(q_from, q_to)
    margin = np.zeros(len(q_from))
    least = np.asarray(dense(arm, None, 2000)(q_from, q_to, margin)[0])
    free = np.asarray(found.free)
    assert 0.05 < free.mean() < 0.95
    assert np.all(found.clearance[free] <= least[free] + 1e-9) and np.all(least[free] <= found.clearance[free] + 2e-3)
    assert np.all(least[~free] < 3e-3)


def test_room_for_what_is_held_leaves_the_tables_of_other_links(arm, postures):
    scene = jaxik.make_scene(spheres=[[3.0, 0.0, 0.0, 0.1]])
    apart = lambda robot: np.asarray(jax.vmap(lambda q: jaxik.clearance(robot, scene, q))(postures[:200]))
    with_room = jaxik.collision.with_room(arm, spheres=2)
    np.testing.assert_allclose(apart(with_room), apart(arm), atol=1e-6)
    near = jaxik.prepare(jaxik.clearance, with_room, scene)
    np.testing.assert_allclose([near(q) for q in postures[:200]], apart(arm), atol=1e-6)
    assert np.ptp(apart(dataclasses.replace(arm, pair_tables=())) - apart(arm)) > 1e-3


def test_a_table_is_of_the_links_that_were_measured(arm, postures):
    """The table says nothing of others: a link made thicker, moved, or differentiated by."""
    apart = lambda robot: np.asarray(jax.vmap(lambda q: jaxik.clearance(robot, None, q))(postures[:200]))
    bare = lambda robot: dataclasses.replace(robot, pair_tables=())
    thick = dataclasses.replace(
        arm, volumes=tuple(dataclasses.replace(v, radius=np.asarray(v.radius + 0.02)) for v in arm.volumes)
    )
    frames = np.array(arm.parent_T_joint)
    frames[1, 2, 3] += 0.05
    for other in (thick, dataclasses.replace(arm, parent_T_joint=frames)):
        assert np.array_equal(apart(other), apart(bare(other)))
    assert np.any(apart(arm) != apart(bare(arm)))
    assert np.array_equal(apart(arm.mounted(jnp.eye(4))), apart(arm))
    rail = dict(link_joint=tuple(j + 1 for j in arm.link_joint))  # the tables' joints are others now
    for name in ("joint_names", "joint_types"):
        rail[name] = (getattr(arm, name)[0] + "_" * (name == "joint_names"), *getattr(arm, name))
    for name in ("parent_T_joint", "axis", "lower", "upper", "velocity", "effort", "armature"):
        rail[name] = np.concatenate([getattr(arm, name)[:1], getattr(arm, name)])
    led = dataclasses.replace(arm, bodies=(), **rail)
    before = lambda robot: np.asarray(jax.vmap(lambda q: jaxik.clearance(robot, None, jnp.append(0.0, q)))(postures[:200]))
    assert np.array_equal(before(led), apart(bare(arm)))
    assert np.array_equal(apart(arm.mounted(np.diag([1.0, -1.0, -1.0, 1.0]))), apart(arm))
    part = arm.part(0, 3)
    assert part.pair_tables == ()  # its base is none of a part's links
    grown = lambda x: jaxik.clearance(dataclasses.replace(arm, parent_T_joint=frames * x), None, postures[0])
    assert np.isfinite(jax.grad(grown)(1.0))


def test_tables_are_written_and_read(arm, tmp_path):
    jaxik.save(arm, tmp_path / "arm.toml")
    text = (tmp_path / "arm.toml").read_text()
    assert jaxik.load(tmp_path / "arm.toml") == arm and len(text) < 80_000
    for old, new, words in [
        ('bounds = "', 'bounds = "!', "bounds cannot be read"),
        ("turns = [true, false]", "turns = [true]", "turns"),
        ('joints = ["turn", "lift"]', 'joints = ["turn", "yaw"]', "joints holds"),
        ('joints = ["turn", "lift"]', 'joints = ["turn", "turn"]', "successive"),
        ('joints = ["turn", "lift"]', 'joints = ["lift", "twist"]', "successive"),
        ("geometry = ", "geometri = ", "geometri"),
    ]:
        assert old in text
        refused(write(tmp_path, "bad.toml", text.replace(old, new)), words)
