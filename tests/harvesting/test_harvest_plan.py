"""A harvest in motion: free by distances of its own, within the limits, in the shortest order; what cannot be picked."""

import csv
import dataclasses
import itertools
import json

import numpy as np
import pytest
from harvest_motions import MARGIN, checked
from scipy.spatial.transform import Rotation

import jaxik
from jaxik.cli.harvest import write_harvest
from jaxik.collision import SceneBuilder
from jaxik.harvesting import tour
from jaxik.harvesting.arm_planner import Part, _wound
from jaxik.harvesting.picks import carrying
from jaxik.planning import time_path
from jaxik.reach.grasp import Grasp
from jaxik.view import Page, plot_harvest, plot_harvest_plan

CRATE = [0.3, -2.0, -0.3, -0.5, 0.0, -0.7, 1.57]


@pytest.fixture(scope="module")
def harvested():
    return jaxik.harvest(jaxik.load("p6r"), jaxik.load_scene("cucumber_row"), margin=0.005)


@pytest.fixture(scope="module")
def plan(harvested):
    return jaxik.harvesting.plan_harvest(harvested, place=CRATE, candidates=8, margin=MARGIN)


def test_motions_are_free_and_within_the_limits(plan):
    """Judged by distances in NumPy; what touches a fruit where it hangs is no obstacle to it until the end of its retreat."""
    found = checked(plan, 0.03)
    assert found["clearance"] > MARGIN - 1e-5 and found["samples"] > 400 and found["beyond"] <= 1e-9
    assert max(found["velocity"], found["acceleration"]) <= 1.0 + 1e-9


def test_stages_follow_each_other(plan, harvested):
    assert [stage.kind for stage in plan.stages] == ["transfer", "approach", "retreat", "transport"] * len(plan.order) + [
        "home"
    ]
    states = [stage.trajectory.sample(0.01) for stage in plan.stages]
    for before, after in itertools.pairwise(states):
        np.testing.assert_allclose(before.q[-1], after.q[0], atol=1e-9)
    for state in states:
        np.testing.assert_allclose(state.velocity[[0, -1]], 0.0, atol=1e-9)
    np.testing.assert_array_equal(states[0].q[0], states[-1].q[-1].round(9))
    for row in plan:
        if row.stages:
            np.testing.assert_allclose(row.stages[-1].trajectory.sample(0.01).q[-1], CRATE, atol=1e-9)
            line = row.stages[1].trajectory.sample(0.01).q
            tips = np.array([jaxik.forward_kinematics(plan.robot, q) for q in line[[0, len(line) // 2, -1]]])
            along = tips[:, :3, 3] - tips[-1, :3, 3]
            np.testing.assert_allclose(np.cross(along, tips[-1, :3, 2]), 0.0, atol=2e-4)
            assert 0.0249 < np.linalg.norm(along[0]) < 0.1001
    assert plan.duration == pytest.approx(sum(float(stage.trajectory.duration) for stage in plan.stages))
    assert plan.cycle == pytest.approx(plan.duration / len(plan.order)) and len(plan.order) >= 8


def test_every_fruit_has_motions_or_a_reason(plan, harvested):
    for row, posture in zip(plan, harvested, strict=True):
        assert row.fruit == posture.fruit and bool(row.stages) == (row.reason == jaxik.Reason.SOLVED)
        assert row.stages or (row.where in ("posture", "approach", "retreat") and row.where in row.why)
    assert "retreat: collision (leaf_3_1)" in str(plan)


def test_rows_have_what_those_of_the_harvest_have(plan, harvested):
    """`success`, and the posture `q` in which the tip grasps the fruit; and a neighbour that is picked first opens the next."""
    assert [bool(row) for row in plan] == plan.success.tolist() and plan.q.shape == harvested.q.shape
    for row, fruit in zip(plan, plan.scene.marks, strict=True):
        if row.success:
            np.testing.assert_allclose(row.q, row.stages[1].trajectory.sample(0.01).q[-1], atol=1e-9)
            tip = plan.robot.world_T_base @ np.asarray(jaxik.forward_kinematics(plan.robot, row.q))
            np.testing.assert_allclose(tip[:3, 3], fruit.position, atol=1e-5)
        else:
            assert np.isnan(row.q).all() and row.q.shape == harvested[0].q.shape
    needs = {row.fruit: row.blockers.pick_first for row in harvested if row.blockers and not row.blockers.removal}
    assert needs == {"fruit_12": ("fruit_7",)}
    assert plan[11] and plan.order.index("fruit_7") < plan.order.index("fruit_12")


def test_the_shortest_order_is_shorter_than_the_rows(harvested):
    """Shorter by more than 15 %, of what was planned, than the best posture of each fruit from left to right."""
    row = jaxik.harvesting.plan_harvest(harvested, order="row", candidates=1, margin=MARGIN)
    shortest = jaxik.harvesting.plan_harvest(harvested, margin=MARGIN)
    places = {fruit.name: fruit.position[0] for fruit in harvested.scene.marks}
    assert np.sum(np.diff([places[name] for name in row.order]) < 0.0) <= 1  # but for what could not be picked at first
    assert set(row.order) == set(shortest.order) and shortest.duration < 0.85 * row.duration


def test_leaves_may_be_touched_where_there_is_no_other_way(harvested):
    plan = jaxik.harvesting.plan_harvest(harvested, leaves="brush", candidates=2, margin=MARGIN)
    assert plan.success.all() and plan.leaves and all(name.startswith("leaf") for name in plan.leaves)
    assert "leaf_3_1" in next(row.leaves for row in plan if row.fruit == "fruit_3")


def test_a_body_that_is_not_round_is_carried_as_it_is_grasped():
    robot, q = jaxik.load("p6r"), np.array([[0.3, 0.2, -0.5, -0.4, 0.3, 0.5, turn] for turn in (0.0, 1.0, 2.0)])
    tips = [robot.world_T_base @ np.asarray(jaxik.forward_kinematics(robot, each)) for each in q]
    top, down = tips[0][:3, 3], tips[0][:3, 0]
    for more, arms in (({"length": 0.3, "radius": 0.02}, 1), ({"spheres": [[*(top + 0.1), 0.05]]}, 3)):
        builder = SceneBuilder()
        builder.add_mark("fruit", top, axis=-down, **more)
        scene = builder.scene()
        found = list(carrying(robot, scene, scene.marks[0], q[:1] if arms == 1 else q, Grasp()))
        assert len(found) == arms and all(arm.link_names[-1] == "held" for arm, _ in found)


# --------------------------------------------------------------------------------------------------------------------
# The order


def test_tours_are_the_shortest(monkeypatch):
    """The shortest of all orders and members, by subsets and by search."""
    rng = np.random.default_rng(0)
    for _ in range(3):
        costs = rng.uniform(1.0, 2.0, (13, 13))
        costs[2, 5] = np.inf
        groups = [np.arange(1 + 3 * i, 4 + 3 * i) for i in range(4)]
        length = lambda nodes, costs=costs: costs[[0, *nodes], [*nodes, 0]].sum()
        best = {order: min(map(length, itertools.product(*order))) for order in itertools.permutations(map(tuple, groups))}
        ordered = tour.best_members(costs, groups)
        assert length(ordered) == best[tuple(map(tuple, groups))]
        monkeypatch.setattr(tour, "EXACT", 10)
        assert length(tour.shortest_tour(costs, groups)) == min(best.values())
        monkeypatch.setattr(tour, "EXACT", 0)
        assert length(tour.shortest_tour(costs, groups)) == pytest.approx(min(best.values()), rel=1e-3)


def test_no_groups_are_no_tour():
    assert tour.shortest_tour(np.zeros((1, 1)), []) == [] == tour.best_members(np.zeros((1, 1)), [])


# --------------------------------------------------------------------------------------------------------------------
# Words, files and pictures


@pytest.mark.parametrize(
    "given, words",
    [
        ({"place": [0.0, 1.0]}, r"place of shape \(2,\); allowed: \(7,\), \(p, 7\), or poses"),
        ({"home": np.zeros((2, 7))}, r"home of shape \(2, 7\); allowed: \(7,\)$"),
        ({"home": [9.0] * 7}, "home: .*; give home="),
        ({"place": np.eye(4) + np.outer([1, 0, 0, 0], [0, 0, 0, 9])}, "place: .*; give a pose that is within reach"),
        ({"order": ["fruit_99"]}, "no fruit 'fruit_99'"),
        ({"order": "fast"}, "order"),
        ({"order": 5}, "order is 5; allowed: shortest, row, or a list"),
        ({"leaves": "eat"}, "leaves"),
        ({"approach": 0.0}, "approach is 0.0; allowed: a finite number above 0"),
        ({"candidates": 0}, "candidates is 0"),
        ({"speed": 1}, "unknown option 'speed'"),
    ],
)
def test_bad_input_is_one_line(harvested, given, words):
    with pytest.raises(ValueError, match=words) as error:
        jaxik.harvesting.plan_harvest(harvested, **given)
    assert "\n" not in str(error.value)


def test_a_harvest_of_no_fruit_is_refused(harvested):
    with pytest.raises(ValueError, match="a harvest of no fruit; give one or several of its rows"):
        jaxik.harvesting.plan_harvest(harvested[:0])


def test_files_hold_all_stages(plan, harvested, tmp_path, monkeypatch):
    monkeypatch.setattr("jaxik.view.plot_harvest", lambda result, path: None)
    write_harvest(harvested, tmp_path / "out", plan, 0.02)
    out = tmp_path / "out"
    assert {"motions.csv", "motions.json", "motions.npz", "motions.png", "postures.csv"} <= {
        file.name for file in out.iterdir()
    }
    with np.load(out / "motions.npz") as arrays:
        time, q, fruit = (arrays[name] for name in ("time", "q", "fruit"))
    assert np.all(np.diff(time) > 0.0) and 0.0 <= time[-1] - plan.duration < 0.02 * len(plan.stages)
    assert list(dict.fromkeys(name for name in fruit if name)) == list(plan.order)
    with (out / "motions.csv").open() as file:
        rows = list(csv.DictReader(file))
    np.testing.assert_array_equal([float(row["q_theta3"]) for row in rows], q[:, 2])
    assert [row["stage"] for row in rows][-1] == "home"
    written = json.loads((out / "motions.json").read_text())
    assert [each["stage"] for each in written] == [stage.kind for stage in plan.stages]
    assert written[1]["joint_names"] == list(plan.robot.joint_names) and "positions" in written[1]["points"][0]


def test_some_of_the_rows_are_drawn(plan, harvested, tmp_path):
    """The scene has more fruits than these."""
    for rows in (0, slice(0, 2)):
        plot_harvest(harvested[rows], tmp_path / "harvest.png")
        plot_harvest_plan(plan[rows], tmp_path / "motions.png")
        assert all((tmp_path / f"{name}.png").read_bytes()[:4] == b"\x89PNG" for name in ("harvest", "motions"))


def test_the_page_moves_the_fruit_with_the_gripper(plan, harvested):
    page = Page(plan.robot, scene=plan.scene, harvest=harvested, port=0, plan=plan)
    player, name = page.player, plan.order[0]
    fruit = player.fruits[name]
    approach, retreat, transport = plan.stages[1:4]
    top = next(np.array(f.position) for f in plan.scene.marks if f.name == name)
    place = lambda: Rotation.from_quat(np.roll(fruit.wxyz, -1)).apply(top) + fruit.position
    player.show(approach.start + 0.03)
    np.testing.assert_allclose(place(), top, atol=1e-9)
    assert "Clear" in page.near.content and "approach of" in player.said.content
    for t in (retreat.start + 0.1, transport.start + 0.5):
        player.show(t)
        tip = plan.robot.world_T_base @ np.asarray(jaxik.forward_kinematics(plan.robot, page.q))
        np.testing.assert_allclose(place(), tip[:3, 3], atol=1e-4)
        assert "Clear" in page.near.content and "1 picked" in player.said.content
    let_go = place()
    player.show(plan.duration)
    assert fruit.visible and np.linalg.norm(place() - let_go) > 0.01
    player.play()
    player.pause()
    assert player.button.label == "Play"
    page.close()


def test_stages_of_joints_without_limits_go_on_from_the_turn_that_they_came_to():
    endless = {"lower": np.full(2, -np.inf), "upper": np.full(2, np.inf), "joint_types": ("continuous",) * 2}
    robot = dataclasses.replace(jaxik.load("planar2"), **endless)
    lines = [[[3.0, 0.1], [3.4, 0.1]], [[3.4 - 2.0 * np.pi, 0.1], [-2.0, 0.3]], [[-2.0 + 2.0 * np.pi, 0.3], [4.4, 0.3]]]
    parts = [Part("transfer", "", time_path(line, velocity=1.0, acceleration=2.0), None, frozenset()) for line in lines]
    found = _wound(robot, parts)
    for before, after in itertools.pairwise(found):
        np.testing.assert_allclose(before.trajectory.sample(0.01).q[-1], after.trajectory.sample(0.01).q[0], atol=1e-12)
    assert _wound(jaxik.load("planar2"), parts) == parts
