"""Proofs that there is no way, beside a fine grid of configurations that coal judges."""

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

import jaxik
from jaxik.planning import plan_motion
from jaxik.planning.cells import _connected, separated
from jaxik.planning.collision_checker import CollisionChecker
from jaxik.reasons import Reason

LINK = '<link name="{0}"><collision><origin xyz="0.15 0 0"/><geometry><sphere radius="0.05"/></geometry></collision></link>'
URDF = """<robot name="two"><link name="base"/>{links}<link name="tip"/>
<joint name="one" type="{kind}"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
  <limit lower="-2.5" upper="2.5" effort="1" velocity="2"/></joint>
<joint name="two" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0.3 0 0"/><axis xyz="0 0 1"/>
  <limit lower="-2.0" upper="2.0" effort="1" velocity="2"/></joint>
<joint name="end" type="fixed"><parent link="b"/><child link="tip"/><origin xyz="0.3 0 0"/></joint></robot>"""


@pytest.fixture(scope="module", params=["revolute", "continuous"])
def two(request, tmp_path_factory):
    from peers.collision_peers import Coal

    file = tmp_path_factory.mktemp("two") / f"{request.param}.urdf"
    file.write_text(URDF.format(links="".join(map(LINK.format, "ab")), kind=request.param))
    robot = jaxik.load(file, tip="tip")
    return robot, Coal(robot, file, None)


def _grid_parts(robot, coal, scene, size=90):
    """The parts of free space, by coal on a grid, which joins neighbours by faces."""
    low, high = robot.finite_limits
    ring = bool(np.isinf(robot.lower[0]))
    values = [np.linspace(a, b, size, endpoint=not (ring and i == 0)) for i, (a, b) in enumerate(zip(low, high, strict=True))]
    q = np.stack(np.meshgrid(*values, indexing="ij"), axis=-1).reshape(-1, 2)
    parts = _parts(~coal.collides(scene, q).reshape(size, size), (ring, False))
    return q.reshape(size, size, 2), [np.argwhere(parts == k) for k in range(parts.max() + 1)]


def _parts(cells, ring):
    """The number of each cell's part, -1 of none, by the graph of all pairs that have a face in common."""
    number, pairs = np.arange(cells.size).reshape(cells.shape), []
    for axis, closed in enumerate(ring):
        both = np.stack([number, np.roll(number, -1, axis)], axis=-1)
        pairs.append((both if closed else both.take(range(cells.shape[axis] - 1), axis)).reshape(-1, 2))
    one, other = np.concatenate(pairs).T
    kept = cells.ravel()[one] & cells.ravel()[other]
    _, found = connected_components(coo_array((np.ones(kept.sum()), (one[kept], other[kept])), shape=(cells.size,) * 2), False)
    parts = np.full(cells.size, -1)
    parts[cells.ravel()] = np.unique(found[cells.ravel()], return_inverse=True)[1]
    return parts.reshape(cells.shape)


def test_what_is_proven_is_apart_on_a_fine_grid(two):
    robot, coal = two
    rng, proven, apart = np.random.default_rng(1), 0, 0
    for _ in range(12):
        centers = rng.uniform(0.15, 0.5, 4)[:, None] * np.stack([np.cos(t := rng.uniform(-3, 3, 4)), np.sin(t), 0 * t], 1)
        scene = jaxik.make_scene(spheres=np.c_[centers, rng.uniform(0.05, 0.09, 4)])
        space = CollisionChecker(robot, scene, 0.0)
        q, parts = _grid_parts(robot, coal, scene)
        large = [part for part in parts if len(part) > 60]
        for one in large[:3]:
            for other in large[:3]:
                start, goal = (q[tuple(part[len(part) // 2])] for part in (one, other))
                told = separated(space, robot, scene, start, goal[None])
                assert not (told and one is other)  # a way on the grid is none between its points alone: but for slits, below
                proven, apart = proven + told, apart + (one is not other)
    assert 0 < 0.9 * apart <= proven <= apart


@pytest.mark.parametrize(("radius", "way"), [(0.039, True), (0.041, False)])
def test_a_millimetre_decides(two, radius, way):
    """A ball beside which the second link's passes on its outermost circle alone, or not; what is endless goes around."""
    robot, coal = two
    scene, start, goal = jaxik.make_scene(spheres=[[0.36, 0.0, 0.0, radius]]), np.array([-1.2, 0.0]), np.array([1.2, 0.0])
    bent = np.linspace(-2.0, 2.0, 401)
    passing = np.stack([-np.arctan2(0.15 * np.sin(bent), 0.3 + 0.15 * np.cos(bent)), bent], axis=1)  # straight below the ball
    assert coal.clearance(scene, passing).max() == pytest.approx(0.04 - radius, abs=1e-5)
    endless = bool(np.isinf(robot.lower[0]))
    assert separated(CollisionChecker(robot, scene, 0.0), robot, scene, start, goal[None]) is not (way or endless)
    moved = plan_motion(robot, start, goal, scene=scene)
    assert bool(moved) is (way or endless) and moved.reason == (Reason.SOLVED if way or endless else Reason.NO_WAY)
    assert not moved or moved.turns.tolist() == [-1 if endless and not way else 0, 0]
    if endless and not way:  # around the back, as far as it may wind
        least = 2.0 * np.pi - 1.2
        assert [plan_motion(robot, start, goal, scene=scene, winding=least + by).success for by in (-0.1, 0.1)] == [False, True]


@pytest.mark.parametrize("ring", [[True, False], [False, True], [True, True], [False, False]])
def test_cells_are_connected_across_the_seam_of_a_ring(ring):
    rng = np.random.default_rng(3)
    for _ in range(10):
        cells = rng.uniform(size=(7, 9)) < 0.5
        found, parts = _connected(cells, np.array(ring)), _parts(cells, ring)
        assert (found[~cells] == 0).all() and (found[cells] > 0).all()
        together = np.unique(np.stack([found[cells], parts[cells]]), axis=1)  # one number for another
        assert together.shape[1] == len(np.unique(parts[cells])) == len(np.unique(found[cells]))


def test_a_batch_tells_which_has_no_way(two):
    robot, _ = two
    wall = jaxik.make_scene(spheres=[[0.05, y, 0.0, 0.14] for y in (-0.45, -0.2, 0.2, 0.45)])
    moved = plan_motion(robot, np.zeros((3, 2)), [[2.45, 0.0], [0.1, 0.3], [0.0, 0.0]], scene=wall, rounds=2000)
    assert moved.reason.tolist() == [Reason.NO_WAY, Reason.SOLVED, Reason.SOLVED]
    assert moved.counts() == {"solved": 2, "no way": 1} and moved.why[0].startswith("no way; after ")
    assert moved[0].offenders and moved[0].gap > 0.0 and np.isnan(moved[1].gap)
    np.testing.assert_array_equal(moved.gap, [each.gap for each in moved])
    assert plan_motion(robot, np.zeros((0, 2)), np.zeros((0, 2))).gap.shape == (0,)
    late = plan_motion(robot, [0.0, 0.0], [2.45, 0.0], scene=wall, timeout=0.0)
    assert late.reason == Reason.NOT_CONVERGED


def test_none_is_proven_of_some_postures_or_of_one_way_out(two):
    """The soonest posture of a place is beyond the ball, the other one is not; a start in the ball is led to either side."""
    robot, coal = two
    scene = jaxik.make_scene(spheres=[[0.36, 0.0, 0.0, 0.041]])
    start, beyond, beside = np.array([-0.35, -1.9]), np.array([0.85, -1.6]), np.array([-0.75, 1.6])
    if np.isinf(robot.lower[0]):  # it goes around the back
        assert plan_motion(robot, start, beyond, scene=scene).success
        return
    tip = np.array([0.6 * np.cos(0.8) * np.cos(0.05), 0.6 * np.cos(0.8) * np.sin(0.05), 0.0])
    asked = {"scene": scene, "task": jaxik.Task.position(), "rounds": 2000}
    assert plan_motion(robot, start, beyond, scene=scene, rounds=2000).reason == Reason.NO_WAY
    found = [plan_motion(robot, start, jaxik.pose(tip), postures=count, **asked) for count in (1, 2)]
    assert found[0].reason == Reason.NOT_CONVERGED and found[1].success
    np.testing.assert_allclose(found[1].waypoints[-1], beside, atol=1e-4)
    wide = jaxik.make_scene(spheres=[[0.36, 0.0, 0.0, 0.05]])
    led = [plan_motion(robot, [at, 0.0], [1.2, 0.0], scene=wide, rounds=2000, escape=True) for at in (-0.1, 0.1)]
    assert coal.clearance(wide, np.array([[-0.1, 0.0], [0.1, 0.0]])).max() < 0.0
    assert [each.reason for each in led] == [Reason.NOT_CONVERGED, Reason.SOLVED]


def test_the_first_joints_of_an_arm_tell(two, tmp_path):
    """An arm of five joints has no way where its first two, which coal judges alone, have none; and none is told elsewhere."""
    robot, coal = two
    hand = "".join(
        f'<link name="{name}"><collision><geometry><sphere radius="0.01"/></geometry></collision></link>'
        f'<joint name="{name}" type="revolute"><parent link="{before}"/><child link="{name}"/><origin xyz="{x} 0 0"/>'
        f'<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="1" velocity="2"/></joint>'
        for before, name, x in (("b", "c", 0.25), ("c", "d", 0.05), ("d", "e", 0.05))
    )
    kind = "continuous" if np.isinf(robot.lower[0]) else "revolute"
    file = tmp_path / "five.urdf"
    arm = URDF.format(links="".join(map(LINK.format, "ab")), kind=kind).replace('<parent link="b"/><child link="tip"/>', "{}")
    file.write_text(arm.replace("{}", '<parent link="e"/><child link="tip"/>').replace("</robot>", f"{hand}</robot>"))
    five = jaxik.load(file, tip="tip")
    wall = jaxik.make_scene(spheres=[[0.05, y, 0.0, 0.14] for y in (-0.45, -0.2, 0.2, 0.45)])
    q, parts = _grid_parts(robot, coal, wall)
    part = lambda at: next(i for i, cells in enumerate(parts) if np.abs(q[tuple(cells.T)] - at).max(axis=1).min() < 0.05)
    for first in ([2.45, 0.0], [0.1, 0.3]):
        moved = plan_motion(five, np.zeros(5), [*first, 0.5, -0.4, 0.2], scene=wall, rounds=2000)
        assert moved.reason == (Reason.SOLVED if part(first) == part([0.0, 0.0]) else Reason.NO_WAY)
    assert part([2.45, 0.0]) != part([0.0, 0.0]) == part([0.1, 0.3])
    assert not separated(CollisionChecker(five, wall, 0.0), five, wall, np.zeros(5), np.array([[0.1, 0.3, 0.5, 0.0, 0.0]]))
