"""Two arms on one rail: they do not meet by Pinocchio and Coal, share the fruits as well as can be, and wait as little."""

import csv
import itertools
import json

import numpy as np
import pytest
from harvest_motions import MARGIN
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import shortest_path
from two_arm_harvest_benchmark import judged

import jaxik
from jaxik import kinematics
from jaxik.cli.harvest import HarvestArguments, write_harvest
from jaxik.harvesting import plan_harvest
from jaxik.harvesting.arms import arms_of
from jaxik.harvesting.meeting import Meeting, Timeline, soonest
from jaxik.harvesting.sharing import Side, share
from jaxik.planning import time_path
from jaxik.view import Page

SOME = [1, 4, 6, 7, 11]  # fruits 2, 5, 7, 8, and 12, which hangs behind 7


@pytest.fixture(scope="module")
def pair():
    return jaxik.load("p6r_pair")


@pytest.fixture(scope="module")
def harvested(pair):
    scene = jaxik.load_scene("cucumber_row")
    return jaxik.harvest(pair, scene, margin=0.005, angles=36, slides=9)[SOME]


@pytest.fixture(scope="module")
def plan(harvested):
    return plan_harvest(harvested, candidates=2, margin=MARGIN)


def test_each_arm_is_the_one_that_it_is_made_of(pair):
    arm, q = jaxik.load("p6r"), np.random.default_rng(0).uniform(-0.5, 0.5, 14)
    poses = np.asarray(jaxik.forward_kinematics(pair, q))
    for k, (own, along) in enumerate(zip(arms_of(pair, "test"), (0.0, 0.5), strict=True)):
        alone = np.array(jaxik.forward_kinematics(arm, q[7 * k : 7 * k + 7]))
        alone[2, 3] += along  # the rail is base z
        np.testing.assert_allclose(poses[k], alone, atol=1e-12)
        assert own.robot.joint_names == tuple(f"{own.name[:-3]}{name}" for name in arm.joint_names)
        assert len(own.robot.boxes) == len(arm.boxes) and len(own.robot.self_pairs) == len(arm.self_pairs)


def test_a_fruit_is_that_of_the_better_arm(pair, harvested):
    assert harvested.q.shape == (len(SOME), 14) and set(harvested.arm) == {"left_tip", "right_tip"}
    for row in harvested:
        if row:
            assert float(row.score) == max(float(each.score) for each in row.each if each)
            tip = pair.world_T_base @ np.asarray(jaxik.forward_kinematics(pair.with_tips(row.arm), row.q))
            np.testing.assert_allclose(tip[:3, 3], row.scan.fruit.position, atol=1e-5)
    assert [len(each) for each in harvested.of_arms] == [len(SOME)] * 2


def test_two_arms_do_not_meet(plan):
    found = judged(plan, 0.004)
    assert found["arms_apart_m"] >= MARGIN and found["arms_hit"] == 0
    assert found["scene_apart_m"] > MARGIN - 1e-5 and found["beyond_limits"] <= 1e-9
    assert max(found["velocity"], found["acceleration"]) <= 1.0 + 1e-9
    assert len(plan.order) >= 4 and all(any(row.arm == arm.name for row in plan) for arm in plan.arms)


def test_each_arm_does_one_thing_after_another(plan):
    for arm, home in zip(plan.arms, np.array(plan.home).reshape(2, 7), strict=True):
        own = [stage for stage in plan.stages if stage.arm == arm.name]
        ends = [np.asarray(stage.trajectory.at_times([0.0, stage.end - stage.start]).q) for stage in own]
        np.testing.assert_allclose([ends[0][0], ends[-1][1]], [home, home], atol=1e-9)
        for (a, x), (b, y) in itertools.pairwise(zip(own, ends, strict=True)):
            assert b.start >= a.end
            np.testing.assert_allclose(x[1], y[0], atol=1e-9)
    assert plan.order.index("fruit_7") < plan.order.index("fruit_12")
    motion = plan.sample(0.01)
    assert np.abs(np.diff(motion.q, axis=0)).max() <= 0.01 * plan.robot.velocity.max() * (1.0 + 1e-9)


def test_two_arms_take_less_time_than_one(plan):
    alone = jaxik.harvest(jaxik.load("p6r"), plan.scene, margin=0.005, angles=36, slides=9)[SOME]
    one = plan_harvest(alone, candidates=2, margin=MARGIN)
    assert set(one.order) <= set(plan.order) and plan.duration < 0.75 * one.duration


def test_files_and_the_page_tell_the_arm(plan, harvested, tmp_path):
    write_harvest(harvested, tmp_path / "out", plan, 0.05)
    with (tmp_path / "out/postures.csv").open() as file:
        assert [row["arm"] for row in csv.DictReader(file)] == list(harvested.arm)
    with (tmp_path / "out/motions.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {row["fruit_left_tip"] for row in rows} | {row["fruit_right_tip"] for row in rows} == {*plan.order, ""}
    stages = json.loads((tmp_path / "out/motions.json").read_text())
    assert [(s["arm"], s["start"]) for s in stages] == [(s.arm, s.start) for s in plan.stages]
    assert all(s["joint_names"][0] == f"{s['arm'][:-3]}slide" for s in stages)
    page = Page(harvested.robot, scene=plan.scene, harvest=harvested, plan=plan, port=8137)
    try:
        for t in (0.0, plan.duration / 2, plan.duration):
            page.player.show(t)
        np.testing.assert_allclose(page.q, plan.home, atol=1e-9)
    finally:
        page.close()


# --------------------------------------------------------------------------------------------------------------------


def test_carriages_on_one_rail_do_not_pass(pair):
    arms = arms_of(pair, "test")
    meeting = Meeting(pair, arms, [4.0 * arm.robot.velocity for arm in arms], 0.0)
    home, there = np.zeros(7), np.eye(7)[0]
    out = time_path(np.stack([home, there]), robot=arms[0].robot)
    back = time_path(np.stack([there, home]), robot=arms[0].robot)
    away = time_path(np.stack([home, there]), robot=arms[1].robot)
    lines = lambda *motions: [Timeline.of(own, [0] * len(own), home) for own in motions]
    for other, passes in (([], False), ([away], True)):  # where the right one stands in the way, and where it drives ahead
        both = lines([out, back], other)
        found = soonest(meeting.free(both), [line.rest for line in both])
        assert (found is not None) == passes


def test_the_soonest_way_is_the_shortest_path():
    rng = np.random.default_rng(0)
    for _ in range(30):
        m, k = rng.integers(1, 9, 2)
        free = rng.random((m, k)) < 0.7
        rest = [np.unique([0, n, *rng.integers(0, n + 1, 2)]) for n in (m, k)]
        number, edges = lambda i, j, width=k + 1: i * width + j, []
        there = lambda i, j, cells=free: 0 <= i < cells.shape[0] and 0 <= j < cells.shape[1] and cells[i, j]
        for i, j in np.ndindex(m + 1, k + 1):
            if there(i, j):
                edges.append((number(i, j), number(i + 1, j + 1)))
            if i < m and j in rest[1] and (there(i, j - 1) or there(i, j)):
                edges.append((number(i, j), number(i + 1, j)))
            if j < k and i in rest[0] and (there(i - 1, j) or there(i, j)):
                edges.append((number(i, j), number(i, j + 1)))
        size = (m + 1) * (k + 1)
        rows, columns = np.array(edges or [(0, 0)]).T
        graph = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(size, size)).tocsr()
        graph.data[:] = 1.0
        least, way = shortest_path(graph, indices=0)[-1], soonest(free, rest)
        assert (way is None) == np.isinf(least)
        if way is not None:
            steps = np.diff(np.stack(way), axis=1)
            assert len(way[0]) - 1 == least and steps.min() >= 0 and steps.max() <= 1


def test_fruits_are_shared_in_the_best_way():
    rng = np.random.default_rng(1)
    for _ in range(3):
        names = [f"fruit_{i}" for i in range(5)]
        costs = [rng.uniform(1.0, 2.0, (11, 11)) for _ in range(2)]
        groups = {name: np.array([1 + 2 * i, 2 + 2 * i]) for i, name in enumerate(names)}
        sides = [
            Side(costs[0], groups, 0.0, {"fruit_0": frozenset({"fruit_1"})}),
            Side(costs[1], {n: groups[n] for n in names[1:]}, 0.5),
        ]

        def best(side, own):
            tours = [
                nodes
                for order in itertools.permutations(own)
                if {"fruit_0", "fruit_1"} - set(order) or order.index("fruit_1") < order.index("fruit_0")
                for nodes in itertools.product(*(side.groups[name] for name in order))
            ]
            return min(map(side.length, tours))

        every = [set(some) for count in range(5) for some in itertools.combinations(names[1:], count)]
        ends = [[best(sides[0], set(names) - some), best(sides[1], some)] for some in every]
        tours = share(sides, {name: i for i, name in enumerate(names)}, True, 0)
        assert max(map(Side.length, sides, tours)) == pytest.approx(min(map(max, ends)), rel=1e-2)
        inverse = share(sides, {name: i for i, name in enumerate(names)}, True, 0, {tuple(map(tuple, tours)): np.inf})
        assert inverse != tours


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({"home": np.zeros(7)}, r"home of shape \(7,\); allowed: \(14,\), of both arms"),
        ({"home": np.eye(14)[0] * 0.45}, "the arms touch each other"),
        ({"place": np.zeros((2, 3))}, r"place of shape \(2, 3\)"),
    ],
)
def test_what_two_arms_cannot_do_is_said(harvested, how, words):
    with pytest.raises(ValueError, match=words):
        plan_harvest(harvested, **how)


def test_arms_that_share_a_joint_are_refused(tmp_path):
    file = tmp_path / "torso.toml"
    arm = '[[joint]]\nname = "{0}"\ntype = "model"\nmodel = "ur5e"\nprefix = "{0}_"\non = "column"\n'
    lift = '[[joint]]\nname = "lift"\ntype = "prismatic"\nlink = "column"\nlower = 0\nupper = 1\nvelocity = 1\n'
    head = 'name = "torso"\nconvention = "frames"\ntips = ["a_tip", "b_tip"]\n'
    file.write_text(head + lift + arm.format("a") + arm.format("b"))
    robot, scene = jaxik.load(file), jaxik.load_scene("cucumber_row")
    with pytest.raises(ValueError, match=r"both arms of torso hang on joint 'lift'.*held=\{'lift': 0.0\}"):
        jaxik.harvest(robot, scene)
    assert len(arms_of(jaxik.load(file, held={"lift": 0.3}), "test")) == 2
    assert jaxik.load(file, tip="a_tip", posture={}).num_joints == 7 and kinematics.branch_to(robot, "b_tip").num_joints == 7
    file.write_text(head + lift + arm.format("a").replace("column", "colum") + arm.format("b"))
    with pytest.raises(ValueError, match=r"on = 'colum': no such link before it; did you mean|allowed: column"):
        jaxik.load(file)


def test_the_shell_takes_arms():
    assert HarvestArguments(arms=2).load().name == "p6r_pair" and HarvestArguments().load().name == "p6r"
    assert HarvestArguments(robot="p6r_pair").load().num_joints == 14
    for given, words in (({"arms": 3}, "--arms 3: allowed: 1 to 2"), ({"arms": 2, "robot": "ur10e_rail"}, "has 1 arm; give")):
        with pytest.raises(ValueError, match=words):
            HarvestArguments(**given).load()
