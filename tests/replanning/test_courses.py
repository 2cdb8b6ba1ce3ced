"""Courses: what is proven of them, where they stop, and their files."""

import json

import numpy as np
import pytest
from panda_at_table import GOAL, MARGIN, RATE, START

import jaxik
from jaxik import fields
from jaxik.planning import plan_motion
from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.limits import JerkLimits
from jaxik.replanning import Course, Event, Run, load_log
from jaxik.replanning.proof import first_hit
from jaxik.replanning.records import decoded, difference, encoded, merged
from jaxik.replanning.stops import Stops


@pytest.fixture(scope="module")
def bent(panda, table):
    """A motion around a wall, with rounded corners."""
    wall = table.with_("wall", boxes=[[0.5, 0.0, 0.35, 0.1, 0.1, 0.7]])
    found = plan_motion(panda, START, GOAL, scene=wall, margin=MARGIN, velocity=2.0, acceleration=5.6, jerk=140.0)
    assert found.success and len(found.waypoints) > 2
    return found.trajectory


def test_the_proof_ends_before_what_coal_sees(panda, table, judge, bent):
    course, rng, hits = Course(START).then(bent, 2.0), np.random.default_rng(0), 0
    times = np.linspace(2.0, course.end, 1000)
    q = course.at(times).q
    tips = np.array([np.asarray(jaxik.forward_kinematics(panda, x))[:3, 3] for x in q[::100]])
    for _ in range(40):
        place = tips[rng.integers(len(tips))] + rng.normal(0.0, 0.15, 3)
        world = table.with_("ball", spheres=[[*place, rng.uniform(0.02, 0.1)]])
        space = CollisionChecker(panda, world, MARGIN)
        seen = np.flatnonzero(judge.clearance(world, q) < MARGIN)
        hit = first_hit(space, course, 2.0)
        if not len(seen):
            assert hit is None or judge.clearance(world, hit.q[None])[0] < MARGIN + 0.01
            continue
        hits += 1
        first = bent.places_at(times[seen[:1]] - 2.0)[0]
        assert hit is not None and hit.run == 0 and hit.place <= first + 1e-6
        assert first - hit.place < 0.05  # and not for nothing
        assert first_hit(space, course, times[seen[-1]] + 0.02) is None or len(seen) < seen[-1] - seen[0] + 1
    assert hits > 10


def test_a_course_stops_before_a_hit(panda, table, bent):
    course = Course(START).then(bent, 1.0)
    stops = Stops(JerkLimits(np.full(7, 2.0), np.full(7, 8.0), np.full(7, 200.0)), 0.3)
    tip = np.asarray(jaxik.forward_kinematics(panda, course.at(1.9).q))[:3, 3]
    space = CollisionChecker(panda, table.with_("ball", spheres=[[*tip, 0.02]]), MARGIN)
    hit = first_hit(space, course, 1.0)
    found = list(stops.before(course, hit, 1.1))
    assert len(found) == 2 and found[0].end > found[1].end == stops.at_once(course, 1.1).end
    for each in found:
        assert first_hit(space, each, 1.1) is None
        np.testing.assert_allclose(each.at(each.end).q, each.stop, atol=1e-12)
        np.testing.assert_array_equal(each.at(1.1).q, course.at(1.1).q)
    assert not list(stops.before(course, hit, 1.1 + float(bent.duration) * 0.4))  # which is too late
    assert stops.at_once(course, 0.5).runs == ()  # it has not begun
    assert stops.at_once(course, course.end - 1e-3).runs[0].brake is None  # it ends sooner than it brakes


def test_a_course_stands_before_between_and_behind_its_runs(bent):
    course = Course(START).then(bent, 1.0).then(bent, 9.0)
    assert course.runs[1].begin == 9.0 and course.end == 9.0 + float(bent.duration)
    found = course.at([0.0, 5.0, 20.0])
    np.testing.assert_array_equal(found.q, np.stack([START, course.runs[0].stop, course.stop]))
    assert not found.velocity.any() and not found.acceleration.any()
    times = np.array([1.1, 9.2, 1.3])
    np.testing.assert_allclose(course.at(times).q, bent.at_times([0.1, 0.2, 0.3]).q, atol=1e-12)
    assert course.at(1.1).q.shape == (7,) and len(course.since(5.0).runs) == 1
    with pytest.raises(ValueError, match=r"Course.at: times"):
        course.at("now")
    assert Run(bent, 1.0).own_time(0.0) == 0.0


def test_a_log_that_was_cut_off_replays_to_the_last_bit(make, table, tmp_path):
    path = tmp_path / "run.jsonl"
    arm, world = make(log=path, seed=3), table
    for k in range(45):
        if k in (0, 30):
            arm.go(GOAL if k == 0 else START)
        if k in (4, 12):
            world = world.with_(f"thing {k}", boxes=[[0.5, 0.04 * (k - 4), 0.35, 0.1, 0.1, 0.7]])
        arm.update(k / RATE, world)
    whole = load_log(path)
    assert [record.time for record in whole.records] == [k / RATE for k in range(45)]
    assert whole.records[3].scene == table and whole.records[-1].scene == world
    assert whole.records[-1].command.place.scene == world
    assert whole.records[4].command.event is Event.REPLANNED and "thing 4" in whole.records[4].command.why
    assert whole.seed == 3 and whole.options == arm.options and (whole.q == START).all()
    assert [k for k, record in enumerate(whole.records) if record.goal is not None] == [0, 30]
    text = path.read_bytes()
    path.write_bytes(text[: len(text) - len(text.splitlines()[-1]) // 2])  # killed while it wrote
    log, again = jaxik.Replanner.replay(path)
    assert len(again) == 44 and all(one == record.command for one, record in zip(again, log.records, strict=True))
    assert again[4] != again[5] and again[40] == whole.records[40].command
    np.testing.assert_array_equal(again[40].at(1.5).q, arm.at(1.5).q)
    with pytest.raises(ValueError, match=r"File exists; give the path of a new file"):
        make(log=path)


def test_scenes_of_all_kinds_are_written_to_the_last_bit(table):
    rng = np.random.default_rng(0)
    field = fields.DistanceField(np.ones((3, 4, 5)), np.eye(4), 0.1)
    scene = table.with_(
        "all", capsules=[[*rng.normal(size=6), 0.1]], points=rng.normal(size=(3, 3)), boxes=[rng.uniform(size=6)]
    )
    scene = scene.with_cloud(rng.normal(size=(50, 3)).astype(np.float32), 0.01).with_field(field)
    now = scene.moved("all", jaxik.pose([0.1, 0.2, 0.3]))
    before, after = (json.loads(json.dumps(encoded(each))) for each in (scene, now))
    change = difference(before, after)
    assert decoded(before) == scene and decoded(merged(before, change)) == now != scene
    assert len(json.dumps(change)) < 0.3 * len(json.dumps(after)) and difference(after, after) == {}
    assert decoded(merged(before, encoded(None))) is None
    with pytest.raises(TypeError, match=r"set has no form in a log"):
        encoded({1})


def test_a_log_that_cannot_be_written_keeps_no_command_from_the_robot(make, tmp_path):
    (tmp_path / "runs").mkdir()
    arm = make(log=tmp_path / "runs" / "one.jsonl")
    arm.go(GOAL)
    (tmp_path / "runs").rename(tmp_path / "gone")
    with pytest.warns(UserWarning, match=r"Replanner: log: .*No such file.*one.jsonl'; nothing is written from 0 s on"):
        assert arm.update(0.0).event is Event.REPLANNED
    arm.update(0.1)
    assert len(load_log(tmp_path / "gone" / "one.jsonl").records) == 0


def test_what_is_no_log_is_refused(tmp_path):
    path = tmp_path / "other.jsonl"
    path.write_text("cut")
    with pytest.raises(ValueError, match="no whole line, of which the first tells the robot"):
        load_log(path)
    for text in ("", "{}\n", "no\n", json.dumps({"form": 9}) + "\n", json.dumps({"form": 1, "robot": "x"}) + "\n"):
        path.write_text(text)
        with pytest.raises(ValueError, match=r"load_log: .*other.jsonl is no log"):
            load_log(path)
    with pytest.raises(ValueError, match=r"load_log: .*none.jsonl: No such file"):
        load_log(tmp_path / "none.jsonl")
