"""Roadmaps: lines judged by coal, shortest ways by another algorithm, changed scenes by proving all anew; and files."""

import dataclasses
import itertools

import coal
import jax
import numpy as np
import pytest
from scipy.sparse.csgraph import connected_components, floyd_warshall

import jaxik
from jaxik.planning import build_roadmap, load_roadmap, plan_motion, save_roadmap
from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.roadmap import _proven
from jaxik.planning.roadmap_reach import bodies
from jaxik.reasons import Reason

POLES = jaxik.make_scene(boxes=[[0.65, 0.0, 0.0, 0.3, 0.05, 0.5], [-0.5, 0.5, 0.0, 0.1, 0.3, 0.5]])
STATIONS = np.array([[-0.6, 0.2, 0.1], [0.9, -0.3, 0.2], [0.5, 0.3, 3.0], [0.5, 0.3, -3.0]])
START, GOAL = STATIONS[:2]
MARGIN = 0.01


@pytest.fixture(scope="module")
def roadmap(arm):
    return build_roadmap(arm[0], scene=POLES, stations=STATIONS, nodes=150, neighbours=8, margin=MARGIN, seed=2)


def _with_box(x, y, scene=POLES):
    """The second box of the scene put elsewhere."""
    frames = np.array(scene.boxes.world_T_box)
    frames[1, :2, 3] = x, y
    return dataclasses.replace(scene, boxes=dataclasses.replace(scene.boxes, world_T_box=frames))


def _least(roadmap, judge, scene, rows, apart=0.01):
    """Coal's least clearance along lines of a roadmap (k,), at samples so far apart, and between them at least."""
    start, end = roadmap.graph.lines(roadmap.edges[rows])
    found = []
    for a, b in zip(start, end, strict=True):
        count = int(np.ceil(np.abs(b - a) @ roadmap._space.weights / apart)) + 1
        found.append(judge.clearance(scene, np.linspace(a, b, count)).min())
    return np.array(found)


def test_lines_are_free_and_what_is_not_is_near_to_something(arm, roadmap):
    robot, judge = arm
    np.testing.assert_array_equal(roadmap.nodes[:4], STATIONS)
    assert len(roadmap) == 150 and roadmap.stations == 4 and roadmap.checked == len(roadmap.edges)
    assert judge.clearance(POLES, roadmap.nodes).min() > MARGIN
    free, blocked = np.flatnonzero(roadmap.free), np.flatnonzero(~roadmap.free)
    assert len(free) > 200 and len(blocked) > 20
    assert _least(roadmap, judge, POLES, free[::4]).min() > MARGIN - 1e-5
    assert _least(roadmap, judge, POLES, blocked[::2], 0.002).max() < MARGIN + 0.003
    again = build_roadmap(robot, scene=POLES, stations=STATIONS, nodes=150, neighbours=8, margin=MARGIN, seed=2)
    np.testing.assert_array_equal(again.nodes, roadmap.nodes)
    np.testing.assert_array_equal(again.free, roadmap.free)


def test_edges_are_those_of_the_nearest_and_the_seam_is_none(arm, roadmap):
    moved = roadmap.nodes[:, None] - roadmap.nodes
    moved[..., 2] = (moved[..., 2] + np.pi) % (2.0 * np.pi) - np.pi
    apart = np.linalg.norm(moved * roadmap._space.weights, axis=-1)
    near = np.argsort(apart, axis=1)[:, 1:9]
    wanted = {tuple(sorted((i, j))) for i, row in enumerate(near.tolist()) for j in row}
    assert {tuple(edge) for edge in roadmap.edges.tolist()} == wanted
    np.testing.assert_allclose(roadmap.lengths, apart[tuple(roadmap.edges.T)], atol=1e-12)
    assert (np.abs(np.diff(roadmap.nodes[roadmap.edges][..., 2], axis=1)) > np.pi).sum() > 20


def test_ways_are_the_shortest(roadmap):
    graph = np.zeros((150, 150))
    graph[tuple(roadmap.edges[roadmap.free].T)] = roadmap.lengths[roadmap.free]
    least, label = floyd_warshall(graph, directed=False), connected_components(graph, directed=False)[1]
    np.testing.assert_array_equal(roadmap.components[:, None] == roadmap.components, label[:, None] == label)
    assert np.bincount(roadmap.components).argmax() == 0
    lines = {tuple(edge) for edge in roadmap.edges[roadmap.free].tolist()}
    number = {q.tobytes(): i for i, q in enumerate(roadmap.nodes)}
    for a, b in np.random.default_rng(0).integers(0, 150, (60, 2)).tolist():
        found = roadmap.way(roadmap.nodes[a], roadmap.nodes[b])
        assert found.success == (np.isfinite(least[a, b]) or a == b)
        if found and a != b:
            way = found.waypoints
            assert roadmap._space.length(np.diff(way, axis=0)).sum() == pytest.approx(least[a, b], abs=1e-5)
            assert np.abs(np.diff(way[:, 2])).max() <= np.pi + 1e-9
            turned = np.where(np.abs(way) > np.pi, way - 2.0 * np.pi * np.round(way / (2.0 * np.pi)), way)
            known = [np.abs(roadmap.nodes - q).sum(axis=1).argmin() for q in turned]
            assert all(tuple(sorted(each)) in lines for each in itertools.pairwise(known))
    assert len(number) == 150


def test_a_joint_without_limits_takes_the_shorter_turn(arm, roadmap):
    """And a start that has turned on before goes on from there."""
    for turns in (0.0, 2.0 * np.pi * 7):
        start, goal = STATIONS[2] + [0.0, 0.0, turns], STATIONS[3] + [1e-3, 0.0, 0.0]
        found = roadmap.way(start, goal)
        assert found and found.waypoints[0, 2] == start[2]
        assert found.waypoints[-1, 2] == pytest.approx(turns + 2.0 * np.pi - 3.0)


def test_a_moved_box_asks_for_its_lines_alone(arm, roadmap):
    """Each time the lines are those that proving all anew finds, by far not all are looked at, and coal finds them free."""
    _, judge = arm
    rng, now, asked = np.random.default_rng(4), roadmap, []
    for turn in range(12):
        angle, away = rng.uniform(-np.pi, np.pi), rng.uniform(0.75, 1.1)
        scene = _with_box(away * np.cos(angle), away * np.sin(angle))
        before, now = now, now.updated(scene)
        space = CollisionChecker(roadmap.robot, scene, MARGIN)
        np.testing.assert_array_equal(now.free, _proven(space, now.graph, now.edges, now.stations))
        asked.append(now.checked)
        assert (before.free & ~now.free).sum() <= now.checked
        if turn % 4 == 0:
            gained, kept = np.flatnonzero(now.free & ~before.free), np.flatnonzero(now.free & before.free)
            assert _least(roadmap, judge, scene, np.r_[gained, kept[:: 1 + len(kept) // 20]]).min() > MARGIN - 1e-5
    assert 0 < np.mean(asked) < 0.6 * len(roadmap.edges)
    back = now.updated(POLES)
    np.testing.assert_array_equal(back.free, roadmap.free)
    assert back.updated(POLES).checked == 0 and (back.free & ~now.free).any()


def test_what_comes_and_goes(arm, roadmap):
    """An empty cell, the same obstacles in another order, under other names, and another kind of them."""
    alone = roadmap.updated(None)
    space = CollisionChecker(roadmap.robot, None, MARGIN)
    np.testing.assert_array_equal(alone.free, _proven(space, alone.graph, alone.edges, alone.stations))
    np.testing.assert_array_equal(alone.updated(POLES).free, roadmap.free)
    turned = jaxik.make_scene(boxes=[[-0.5, 0.5, 0.0, 0.1, 0.3, 0.5], [0.65, 0.0, 0.0, 0.3, 0.05, 0.5]])
    np.testing.assert_array_equal(roadmap.updated(turned).free, roadmap.free)
    assert roadmap.updated(POLES.padded()).checked == 0
    ball = jaxik.make_scene(spheres=[[0.4, -0.5, 0.0, 0.1]])
    space = CollisionChecker(roadmap.robot, ball, MARGIN)
    np.testing.assert_array_equal(roadmap.updated(ball).free, _proven(space, roadmap.graph, roadmap.edges, roadmap.stations))


def test_what_blocks_a_line_is_known_once_it_came(arm, roadmap):
    """Boxes that come and go together and one by one, at random; and of one that comes and goes nothing is to be proven."""
    boxes = jaxik.make_scene(
        boxes=[[0.65, 0.0, 0.0, 0.3, 0.05, 0.5], [0.1, 0.6, 0.0, 0.3, 0.1, 0.5], [-0.7, -0.2, 0.0, 0.1, 0.3, 0.5]]
    )
    now, rng = roadmap.updated(boxes.without([0, 1, 2])), np.random.default_rng(8)
    for _ in range(25):
        away = np.flatnonzero(rng.random(3) < 0.5)
        now = now.updated(boxes.without(away.tolist()))
        space = CollisionChecker(roadmap.robot, now.scene, MARGIN)
        np.testing.assert_array_equal(now.free, _proven(space, now.graph, now.edges, now.stations))
    there = roadmap.updated(_with_box(0.6, 0.5)).updated(_with_box(0.1, 0.6))
    back = there.updated(_with_box(5.0, 0.0))
    assert there.checked > 0 and back.checked <= (~roadmap.free).sum()  # of which it is not known
    assert (back.free & ~there.free).sum() > back.checked


def test_lines_stay_in_their_boxes(arm, roadmap):
    """Spheres of the links, placed by Pinocchio, on lines and between looks."""
    import pinocchio as pin

    _, judge = arm
    boxes, rng = roadmap.swept, np.random.default_rng(0)
    start, end = roadmap.graph.lines(roadmap.edges)
    geometry, data = judge.robot, judge.robot.createData()
    seen = np.full((2, 3), np.inf)
    for row in rng.integers(0, len(start), 200):
        for q in start[row] + rng.random((20, 1)) * (end - start)[row]:
            pin.updateGeometryPlacements(judge.model, judge.data, geometry, data, judge.whole(q[None])[0])
            centers = np.array([place.translation for place in data.oMg]).reshape(3, 2, 3)  # two a link
            least, most = boxes.low[:, ::-1, row].T, boxes.high[:, ::-1, row].T  # the last link first
            seen = np.minimum(
                seen, [(centers.min(axis=1) - 0.04 - least).min(axis=0), (most - centers.max(axis=1) - 0.04).min(axis=0)]
            )
    assert seen.min() > 0.0 and seen[:, :2].max() < 0.05


@pytest.mark.parametrize("kind", ["boxes", "cylinders", "spheres", "capsules"])
def test_obstacles_fill_their_boxes(kind):
    """Shapes that are turned are as far from planes on all sides as coal says."""
    rng = np.random.default_rng(1)
    frame = np.asarray(jaxik.pose(rng.uniform(-1, 1, 3), rpy=rng.uniform(-1, 1, 3)))
    shapes = {"boxes": coal.Box(0.2, 0.4, 0.6), "spheres": coal.Sphere(0.3), "capsules": coal.Capsule(0.1, 0.8)}
    shape, placed = (shapes | {"cylinders": coal.Cylinder(0.2, 0.8)})[kind], coal.Transform3s(frame[:3, :3], frame[:3, 3])
    (ours,) = bodies(_scene(kind, frame)).values()
    for axis, side in itertools.product(range(3), (-1.0, 1.0)):
        plane = coal.Halfspace(-side * np.eye(3)[axis], -5.0)  # all beyond 5 m on this side
        apart = coal.distance(shape, placed, plane, coal.Transform3s(), coal.DistanceRequest(), coal.DistanceResult())
        assert side * ours.box[int(side > 0.0), axis] == pytest.approx(5.0 - apart, abs=1e-6)


def _scene(kind, frame):
    at, along = frame[:3, 3], 0.4 * frame[:3, 2]
    rows = {"spheres": [*at, 0.3], "capsules": [*(at - along), *(at + along), 0.1]}
    if kind in rows:
        return jaxik.make_scene(**{kind: [rows[kind]]})
    sizes = {"half": np.array([[0.1, 0.2, 0.3]])} if kind == "boxes" else {"radius": np.array([0.2]), "half": np.array([0.4])}
    some = jaxik.make_scene(boxes=[[0.0, 0.0, 0.0, 1.0, 1.0, 1.0]], cylinders=[[0.0, 0.0, 0.0, 0.1, 1.0]])
    one = {f"world_T_{kind[:-1] if kind == 'cylinders' else 'box'}": np.asarray(frame)[None], **sizes}
    other = "cylinders" if kind == "boxes" else "boxes"
    return dataclasses.replace(some, **{kind: dataclasses.replace(getattr(some, kind), **one)}).without(f"{other}_1")


def test_a_plan_is_timed_and_free(arm, roadmap):
    _, judge = arm
    moved = roadmap.plan(START, GOAL)
    assert moved and len(moved.waypoints) > 2
    q = moved.trajectory.sample(0.0005).q
    assert judge.clearance(POLES, q).min() > MARGIN - 1e-5
    np.testing.assert_allclose(q[[0, -1]], [START, GOAL], atol=1e-12)
    state = moved.trajectory.sample(0.004)
    assert np.abs(state.velocity).max() <= 2.0 + 1e-9 and np.abs(state.acceleration).max() <= 8.0 + 1e-9
    length = lambda way: roadmap._space.length(np.diff(way, axis=0)).sum()
    assert length(moved.waypoints) <= length(roadmap.way(START, GOAL).waypoints)
    slower = roadmap.plan(START, GOAL, velocity=1.0)
    assert slower.trajectory.duration > moved.trajectory.duration
    alone = jaxik.plan_motion(roadmap._space.robot, START, GOAL, scene=POLES)
    assert moved.least_duration == alone.least_duration < moved.trajectory.duration
    assert np.isnan(roadmap.way(START, GOAL).least_duration)
    still = roadmap.plan(START, START)
    assert still and still.trajectory.duration == 0.0


def test_goals_are_several_or_poses(arm, roadmap):
    robot, _ = arm
    goal = GOAL + np.array([0.02, -0.03, 0.05])
    hit, far = np.zeros(3), np.array([2.0, 1.0, 1.0])
    found = roadmap.way(START, [hit, far, START + 0.1])
    np.testing.assert_array_equal(found.waypoints, [START, START + 0.1])
    pose = np.asarray(jaxik.forward_kinematics(robot, goal))
    by_pose = roadmap.plan(START, pose)
    assert by_pose
    np.testing.assert_allclose(jaxik.forward_kinematics(robot, by_pose.waypoints[-1]), pose, atol=1e-5)


def test_the_nearest_of_several_goals_by_the_roadmap(roadmap):
    """Nodes as goals, where no straight line is looked at; another algorithm says which, and how far."""
    graph = np.zeros((150, 150))
    graph[tuple(roadmap.edges[roadmap.free].T)] = roadmap.lengths[roadmap.free]
    least, rng = floyd_warshall(graph, directed=False), np.random.default_rng(3)
    picked = np.stack([rng.permutation(150)[:5] for _ in range(20)])
    starts, goals = roadmap.nodes[picked[:, 0]], roadmap.nodes[picked[:, 1:]]
    for found, numbers, aims in zip(roadmap.way(starts, goals), picked, goals, strict=True):
        far = least[numbers[0], numbers[1:]]
        assert roadmap._space.length(np.diff(found.waypoints, axis=0)).sum() == pytest.approx(far.min(), abs=1e-5)
        np.testing.assert_allclose(found.waypoints[-1, :2], aims[far.argmin(), :2])


def test_the_search_is_that_of_plain_xla(roadmap):
    """The kernel's rules for lanes that work together, and JAX's."""
    from jaxik.planning.roadmap_graph import SEARCHED, Joined

    graph, one = roadmap.graph, lambda i: Joined(np.array([i]), np.zeros(1))
    asked = graph.in_order(roadmap.free), [one(5), one(6)], [one(70), one(80)], [roadmap.nodes[[70]], roadmap.nodes[[80]]]
    by_kernel, kernel = graph.ways(*asked), SEARCHED.run
    assert by_kernel[0][0] == 5 and by_kernel[1][-1] == 80
    with jax.enable_x64(False), pytest.MonkeyPatch.context() as patch:
        patch.setattr(SEARCHED, "run", lambda *args, **how: [np.asarray(x) for x in SEARCHED.by_xla(*args)])
        assert graph.ways(*asked) == by_kernel
    assert SEARCHED.run == kernel


def test_many_are_as_each_is_alone(arm, roadmap):
    free = START + np.array([0.05, 0.0, 0.1])
    starts = [START, free, START, [0.0, 0.0, 0.0], START, START, START]
    goals = [GOAL, GOAL, free, GOAL, [0.0, 0.0, 0.0], [np.nan, 0.0, 0.0], [0.0, 3.0, 0.0]]
    for ask in (roadmap.way, roadmap.plan):
        many = ask(starts, goals)
        told = [why.split(";")[0] for why in many.why]
        assert told == ["solved"] * 3 + ["start: collision", "goal: collision", "goal: invalid", "goal: limits"]
        for each, start, goal in zip(many, starts, goals, strict=True):
            alone = ask(np.array(start), np.array(goal))
            assert (alone.why, alone.rounds, alone.checked) == (each.why, each.rounds, each.checked)
            if each:
                np.testing.assert_array_equal(alone.waypoints, each.waypoints)
                assert alone.length == each.length >= each.bound - 1e-9 and alone.bound == each.bound
    assert len(roadmap.way([], np.empty((0, 3)))) == 0


def test_what_the_roadmap_does_not_know_may_be_searched_for(arm):
    robot, judge = arm
    few = build_roadmap(robot, scene=POLES, nodes=4, neighbours=1, seed=1)
    assert roadmap_says(few, START, GOAL) == "not converged"
    found = few.plan(START, GOAL, rounds=5000)
    assert found and found.rounds > 0
    assert judge.clearance(POLES, found.trajectory.sample(0.0005).q).min() > -1e-5


def test_a_search_of_a_batch_finds_one_way_and_not_another(arm):
    """One goal is beside a pole, the other behind a wall; coal finds all ends free."""
    robot, judge = arm
    scene = jaxik.make_scene(boxes=[[0.6, 0.0, 0.0, 1.0, 0.05, 0.5], [-0.25, -0.6, 0.0, 0.1, 0.1, 0.5]])
    start, goals = np.array([-0.9, 0.2, 0.1]), np.array([[-2.6, -0.2, 0.1], [0.9, -0.3, 0.2]])
    assert judge.clearance(scene, np.array([start, *goals])).min() > 0.0
    few = build_roadmap(robot, scene=scene, nodes=4, neighbours=1, seed=1)
    found = few.way([start, start], goals, rounds=2000)
    assert found.success.tolist() == [True, False] and found.rounds.min() > 0 and found.reason[1] == Reason.NOT_CONVERGED
    assert np.isnan(found.gap[0]) and found.gap[1] > 0.0 and np.isfinite(found.stuck[1]).all()
    for each, goal in zip(found, goals, strict=True):
        alone = few.way(start, goal, rounds=2000)
        assert (alone.why, alone.rounds) == (each.why, each.rounds)
        np.testing.assert_array_equal(alone.gap, each.gap)
        np.testing.assert_array_equal(alone.waypoints, each.waypoints)


def roadmap_says(roadmap, start, goal):
    return roadmap.way(start, goal).why.split(";")[0]


def test_movable_objects_leave_their_places_to_nodes(arm):
    robot, judge = arm
    given = {"scene": POLES, "nodes": 150, "neighbours": 8, "seed": 2}
    kept = build_roadmap(robot, movable=["boxes_2"], **given)
    inside = judge.clearance(POLES, kept.nodes) < 0.0
    assert inside.any() and judge.clearance(POLES.without("boxes_2"), kept.nodes).min() > 0.0
    assert not kept.free[inside[kept.edges].any(axis=1)].any()
    gone = kept.updated(POLES.without("boxes_2"))
    assert gone.free[inside[kept.edges].any(axis=1)].any()
    assert roadmap_says(kept, kept.nodes[inside][0], START) == "start: collision"


def test_files_hold_it_to_the_last_bit(arm, roadmap, tmp_path):
    robot, _ = arm
    path = save_roadmap(roadmap, tmp_path / "cell.npz")
    again = load_roadmap(path, robot=robot, scene=POLES, margin=0.005)
    assert again.checked == 0 and again.margin == MARGIN and again.stations == 4
    for name in ("nodes", "edges", "free", "lengths"):
        np.testing.assert_array_equal(getattr(again, name), getattr(roadmap, name))
    np.testing.assert_array_equal(again.way(START, GOAL).waypoints, roadmap.way(START, GOAL).waypoints)
    other = _with_box(0.6, 0.6)
    changed = load_roadmap(path, robot=robot, scene=other)
    np.testing.assert_array_equal(changed.free, roadmap.updated(other).free)
    assert 0 < changed.checked < len(roadmap.edges)
    with pytest.raises(jaxik.LoadError, match=r"cell.npz: margin: 0.01 m; asked for 0.02 m; build the roadmap anew"):
        load_roadmap(path, robot=robot, scene=POLES, margin=0.02)
    with pytest.raises(jaxik.LoadError, match=r"robot: of 'flat', hash .*; asked for 'flat', .*; load the robot as it was"):
        load_roadmap(path, robot=robot.with_tool(jaxik.pose([0.1, 0.0, 0.0])), scene=POLES)
    whole = path.read_bytes()
    for damage in (b"", b"nothing", whole[:-300], whole[:2000] + bytes(200) + whole[2200:]):
        path.write_bytes(damage)
        with pytest.raises(jaxik.LoadError, match=r"roadmap: is damaged or none \(.*\); save it anew"):
            load_roadmap(path, robot=robot, scene=POLES)
    np.savez(path, format=1, nodes=np.zeros(3))
    with pytest.raises(jaxik.LoadError, match="is damaged or none"):
        load_roadmap(path, robot=robot)
    with pytest.raises(ValueError, match=r"save_roadmap: cell.zip; allowed ending: .npz"):
        save_roadmap(roadmap, tmp_path / "cell.zip")


def test_a_slide_and_a_robot_that_stands_elsewhere():
    """Seven joints, the first a slide, on a slope; a ball goes from where one node has the tip to where others have it."""
    robot = jaxik.load("p6r").mounted(jaxik.pose([0.2, -0.1, 0.5], rpy=[0.3, 0.0, 1.0]))
    made = build_roadmap(robot, nodes=60, neighbours=6)
    tips = [robot.world_T_base @ np.asarray(jaxik.forward_kinematics(robot, q)) for q in made.nodes[:3]]
    for scene in (*(jaxik.make_scene(spheres=[[*tip[:3, 3], 0.1]]) for tip in tips), None):
        before, made = made, made.updated(scene)
        space = CollisionChecker(made.robot, scene, 0.0)
        np.testing.assert_array_equal(made.free, _proven(space, made.graph, made.edges, 0))
        assert (made.free != before.free).any() and made.checked < len(made.edges)


def test_progress_counts_lines(arm):
    told = []
    made = build_roadmap(arm[0], nodes=20, neighbours=3, progress=lambda *x: told.append(x))
    assert told == [(len(made.edges), len(made.edges))] and "20 nodes" in repr(made)


def test_a_roadmap_is_as_good_as_a_search(arm, roadmap):
    """Wherever `plan_motion` finds a way between free postures, so does the roadmap; its ways are not much longer."""
    rng = np.random.default_rng(5)
    q = rng.uniform(-2.5, 2.5, (60, 3))
    starts, goals = q[~roadmap._space.hits(q, 0.005)][:40].reshape(2, 20, 3)
    searched, found = plan_motion(arm[0], starts, goals, scene=POLES, margin=MARGIN), roadmap.plan(starts, goals)
    assert searched.success.sum() > 15 and found.success[searched.success].all()
    both = [(roadmap._space.length(np.diff(a, axis=0)).sum(), roadmap._space.length(np.diff(b, axis=0)).sum()) for a, b in
            zip(found.waypoints, searched.waypoints, strict=True) if a is not None and b is not None]  # fmt: skip
    ours, theirs = np.sum(both, axis=0)
    assert ours < 1.25 * theirs


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"scene": "poles"}, "build_roadmap: scene is poles; write a jaxik.Scene"),
        ({"nodes": 1}, "build_roadmap: nodes is 1"),
        ({"node": 9}, "build_roadmap: unknown option 'node'"),
        ({"margin": np.nan}, "build_roadmap: margin is nan"),
        ({"seed": -1}, "seed"),
        ({"stations": np.zeros((2, 4))}, r"build_roadmap: stations"),
        ({"stations": [START, np.zeros(3)]}, r"build_roadmap: station 1 is .*: collision; jaxik.explain tells"),
        ({"stations": [[3.0, 0.0, 0.0]]}, r"build_roadmap: station 0 is .*: limits; give values inside the limits"),
        ({"movable": ["crate"]}, r"scene 'scene': .*crate"),
        ({"margin": 5.0}, r"build_roadmap: 0 of \d+ postures are free, for 20 nodes; a smaller margin"),
    ],
)
def test_mistakes_are_named(arm, change, said):
    with pytest.raises(ValueError, match=said):
        build_roadmap(arm[0], **({"scene": POLES, "nodes": 20} | change))


def test_mistaken_questions_are_named(arm, roadmap):
    with pytest.raises(ValueError, match=r"Roadmap.way: start of shape \(2,\)"):
        roadmap.way([0.0, 0.0], GOAL)
    with pytest.raises(ValueError, match=r"Roadmap: unknown option 'nere'"):
        roadmap.way(START, GOAL, nere=3)
    with pytest.raises(ValueError, match=r"Roadmap.updated: scene is 3"):
        roadmap.updated(3)
    with jax.enable_x64(True):  # whatever JAX is set to
        np.testing.assert_array_equal(roadmap.updated(POLES).free, roadmap.free)
