"""Sweeps of motions: each is what `plan_motion` finds alone, judged by coal, whatever it was computed with, stopped or sent."""

import itertools
import pickle
import re

import numpy as np
import pytest
from planning.conftest import URDF

import jaxik
from jaxik.files.robot_toml import read_toml
from jaxik.planning import plan_motion
from jaxik.reasons import Reason
from jaxik.sweeps.driver import _on_worker, _piece
from jaxik.sweeps.evaluation import answer
from jaxik.sweeps.store import StoreError

POLES = jaxik.make_scene(boxes=[[0.65, 0.0, 0.0, 0.3, 0.05, 0.5], [-0.5, 0.5, 0.0, 0.1, 0.3, 0.5]])
HOME = [-0.6, 0.2, 0.1]
PLACES = {"kind": "grid", "x": [0.1, 0.8, 4], "y": [-0.6, 0.6, 5], "z": [0.0, 0.0, 1]}
PLACES |= {"directions": [[0, 0, 1]], "roll_deg": [-150, 150]}
WAY = ("reason", "where", "q", "duration", "length", "rounds", "waypoint_count", "waypoints")


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    from peers.collision_peers import Coal

    file = tmp_path_factory.mktemp("flat") / "flat.urdf"
    file.write_text(URDF)
    return jaxik.load(file, tip="tip"), Coal(jaxik.load(file, tip="tip"), file, None)


@pytest.fixture(scope="module")
def studies(arm):
    """A study of poses, from two starts and two bases, and one of random postures."""
    robot, _ = arm
    top = {"robot": robot, "collision": {"scene": POLES}, "chunk": 20}
    starts = {"home": HOME, "beside": [1.4, 0.3, 0.0]}
    poses = {"motions": {"start": starts, "samples": 5}, "base": {"y": [0.0, 0.05]}, "targets": PLACES}
    return top | poses, top | {"motions": {}, "seed": 4, "targets": {"kind": "random", "count": 50}}


@pytest.fixture(scope="module")
def done(studies, tmp_path_factory):
    folder = tmp_path_factory.mktemp("moved")
    return [jaxik.sweep(study, folder / f"{i}.zarr") for i, study in enumerate(studies)]


def columns(result):
    return {name: np.asarray(values) for name, values in result.dataset().load().items() if name != "crc"}


def same(a, b):
    assert a.keys() == b.keys()
    for name, values in a.items():
        np.testing.assert_array_equal(values, b[name], err_msg=name)


def bits(folder):
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def is_as_planned(known, robot, start, goal, scene, seed):
    alone = plan_motion(robot, start, goal, scene=scene, seed=seed)
    where = ("", "start", "goal")[known["where"]]
    assert (known["reason"], where, known["rounds"]) == (alone.reason, alone.where, alone.rounds)
    if alone:
        count = known["waypoint_count"]
        assert count == len(alone.waypoints) and np.isnan(known["waypoints"][count:]).all()
        np.testing.assert_array_equal(known["waypoints"][:count], alone.waypoints)
        np.testing.assert_array_equal(known["q"], alone.waypoints[-1])
        assert (known["duration"], known["length"]) == (alone.trajectory.duration, alone.length)
        if "samples" in known:
            times = np.linspace(0.0, alone.trajectory.duration, len(known["samples"]))
            np.testing.assert_allclose(known["samples"], [alone.trajectory.at(t).q for t in times], atol=1e-5)
    else:
        assert all(np.isnan(known[name]).all() for name in ("q", "duration", "length", "waypoints"))


def test_each_motion_to_a_pose_is_as_it_is_alone(done):
    data, study = done[0].dataset(), done[0].study
    assert data.reason.dims == ("base", "start", "target") and data.waypoints.dims[-2:] == ("waypoint", "joint")
    assert list(data.start.values) == ["home", "beside"]
    found = columns(done[0])
    assert {int(Reason.SOLVED), int(Reason.OUT_OF_REACH), int(Reason.COLLISION)} <= {*found["reason"].ravel().tolist()}
    assert (found["rounds"] > 0).any() and found["reachable"].sum() > 40
    poses = study.targets.poses_at(np.arange(len(study.targets)))
    for variant in study.variants:
        world_T_base = variant.robot.world_T_base
        home, scene = variant.robot.mounted(np.eye(4)), POLES.moved(np.linalg.inv(world_T_base))
        for i in range(0, len(poses), 5):
            known = {name: found[name][(*variant.index, i)] for name in (*WAY, "samples")}
            is_as_planned(known, home, variant.start, np.linalg.inv(world_T_base) @ poses[i], scene, 0)


def test_each_motion_between_random_postures_is_as_it_is_alone(done):
    robot, found = done[1].study.variants[0].robot, columns(done[1])
    assert (found["reason"] == Reason.SOLVED).mean() > 0.9 and len(np.unique(found["start_q"], axis=0)) == 50
    for i in range(0, 50, 3):
        is_as_planned({name: found[name][i] for name in WAY}, robot, found["start_q"][i], found["goal_q"][i], POLES, 4)


def test_coal_finds_the_lines_between_waypoints_free(arm, done):
    """All motions are looked at every 3 mm and less, random postures where they stand, and that each pose is met."""
    robot, coal = arm
    ways, sides = [], (done[0].study.variants, done[1].study.variants)
    for result, variants in zip(done, sides, strict=True):
        found = columns(result)
        for variant in variants:
            mine = {name: found[name][variant.index] for name in (*WAY, "reachable")}
            shift = variant.robot.world_T_base[:3, 3]
            for i in np.flatnonzero(mine["reachable"]):
                way = mine["waypoints"][i, : mine["waypoint_count"][i]]
                steps = [np.linspace(a, b, 2 + int(400 * np.abs(b - a).sum())) for a, b in itertools.pairwise(way)]
                ways.append((float(shift[1]), np.concatenate([*steps, way[-1:]])))
    assert len(ways) > 90
    for shift in (0.0, 0.05):
        moved = POLES.moved(np.array(jaxik.pose([0.0, -shift, 0.0])))
        q = np.concatenate([way for y, way in ways if y == shift])
        assert coal.clearance(moved, q).min() > -1e-5
    found = columns(done[1])
    assert coal.clearance(POLES, np.concatenate([found["start_q"], found["goal_q"]])).min() > 0.0
    data = done[0].dataset().isel(base=0, start=0).load()
    for i in np.flatnonzero(data.reachable.values):
        assert np.allclose(jaxik.forward_kinematics(robot, data.q.values[i])[:3, 3], data.position.values[i], atol=1e-5)


@pytest.mark.parametrize("which", [0, 1])
def test_the_same_bits_in_other_chunks_and_after_a_stop(studies, done, tmp_path, which):
    other = jaxik.sweep(studies[which] | {"chunk": 7}, tmp_path / "c.zarr")
    same(columns(other), columns(done[which]))
    calls = []
    stopped = jaxik.sweep(studies[which], tmp_path / "s.zarr", stop=lambda: calls.append(0) or True)
    assert not stopped.complete
    first = jaxik.sweep(studies[which], tmp_path / "s.zarr", shard="1/2")
    assert jaxik.sweep(studies[which], tmp_path / "s.zarr").complete and first.done <= first.total
    assert bits(tmp_path / "s.zarr") == bits(done[which].path)


@pytest.mark.parametrize("which", [0, 1])
def test_a_piece_for_a_worker_of_a_cluster(done, which):
    study, found = done[which].study, columns(done[which])
    number = len(study.variants) * study.chunks - 1
    variant, _, rows = study.work(number)
    _, piece = _on_worker(number, *pickle.loads(pickle.dumps(_piece(study, number))))
    for name, values in piece.items():
        if name in ("position", "quaternion"):  # coordinates
            continue
        np.testing.assert_array_equal(values, found[name][(*variant.index, rows)], err_msg=name)


def test_postures_of_a_file_from_their_own_or_one_start(arm, tmp_path):
    robot, _ = arm
    rng = np.random.default_rng(0)
    starts, goals = rng.uniform(-2.0, 2.0, (2, 9, 3))
    starts[0], goals[1], goals[2, 0], goals[3] = [0.0, 0.0, 0.0], np.nan, 3.0, [0.0, 0.0, 0.0]
    np.savez(tmp_path / "own.npz", starts=starts, goals=goals)
    np.savez(tmp_path / "one.npz", goals=goals)
    limits = "velocity = [1.0, 2.0, 0.5]\njerk = 80\nwinding_deg = 360\n"
    table = "[motions]\n{}\nwaypoints = 0\n" + limits + "[targets]\nkind = 'postures'\npath = '{}.npz'\n"
    for name, start in (("own", ""), ("one", f"start = {HOME}")):
        (tmp_path / f"{name}.toml").write_text(table.format(start, name))
        content = read_toml(tmp_path / f"{name}.toml").content | {"robot": robot, "collision": {"scene": POLES}}
        content["targets"]["path"] = str(tmp_path / f"{name}.npz")
        found = columns(jaxik.sweep(content, tmp_path / f"{name}.zarr"))
        assert "waypoints" not in found and found["reason"][1] == Reason.INVALID and found["reason"][2] == Reason.LIMITS
        assert (found["reason"][3], found["where"][3]) == (Reason.COLLISION, 2) and found["proven"][1:4].all()
        begins = starts if name == "own" else np.tile(HOME, (9, 1))
        np.testing.assert_array_equal(found["start_q"], begins)
        assert (found["reason"][0] == Reason.COLLISION and found["where"][0] == 1) == (name == "own")
        for i in range(4, 9):
            alone = plan_motion(
                robot, begins[i], goals[i], scene=POLES, velocity=[1.0, 2.0, 0.5], jerk=80.0, winding=2.0 * np.pi
            )
            assert found["duration"][i] == alone.trajectory.duration if alone else np.isnan(found["duration"][i])


def test_random_postures_do_not_depend_on_what_is_asked_beside(arm):
    """Their number and seed alone decide; they spread evenly over the limits, by SciPy's test, and no two are alike."""
    from scipy.stats import kstest

    robot, _ = arm
    study = jaxik.sweeps.Study.of({"robot": robot, "motions": {}, "targets": {"kind": "random", "count": 2000}})
    ends = lambda rows, seed=0, targets=study.targets: targets.ends(robot, rows, None, seed, lambda q: np.ones(len(q), bool))
    starts, goals = ends(slice(0, 2000))
    low, high = robot.finite_limits
    for q in (starts, goals):
        assert all(kstest((q[:, j] - low[j]) / (high - low)[j], "uniform").pvalue > 0.01 for j in range(3))
    assert len(np.unique(np.concatenate([starts, goals]), axis=0)) == 4000
    assert abs(np.corrcoef(starts.T, goals.T)[:3, 3:]).max() < 0.08
    for rows in (slice(0, 1), slice(17, 400), slice(1999, 2000)):
        np.testing.assert_array_equal(ends(rows), [starts[rows], goals[rows]])
    strewn = np.array([1500, 3, 700])
    np.testing.assert_array_equal(ends(slice(0, 3), targets=study.targets.at(strewn)), [starts[strewn], goals[strewn]])
    assert not np.isin(ends(slice(0, 2000), seed=1), starts).any()


def test_that_there_is_no_way_is_proven_and_named(arm, tmp_path):
    """A box across the room; coal finds both ends free."""
    robot, coal = arm
    wall = jaxik.make_scene(boxes=[[0.6, 0.0, 0.0, 1.0, 0.05, 0.5]])
    ends = np.array([[-0.9, 0.2, 0.1], [0.9, -0.3, 0.2], [-1.2, 0.2, 0.1]])
    assert coal.clearance(wall, ends).min() > 0.0
    study = {"robot": robot, "collision": {"scene": wall}, "motions": {"start": ends[0].tolist(), "rounds": 2000}}
    data = jaxik.sweep(study | {"targets": {"goals": ends[1:].tolist()}}, tmp_path / "wall.zarr").dataset().load()
    names = dict(zip(data.reason.attrs["flag_values"], data.reason.attrs["flag_meanings"].split(), strict=True))
    assert [names[int(reason)] for reason in data.reason.values] == ["no_way", "solved"] and data.proven.values.all()
    assert data.attrs["reasons"]["no way"] == Reason.NO_WAY and data.reachable.values.tolist() == [False, True]


def test_what_more_rounds_would_have_found_is_measured(arm, tmp_path):
    robot, _ = arm
    goals = [[0.9, -0.3, 0.2], [1.2, -0.2, 0.0], [-0.7, 0.3, 0.0]]
    few = {"robot": robot, "collision": {"scene": POLES}, "motions": {"start": HOME, "rounds": 2}, "targets": {"goals": goals}}
    known = jaxik.sweep(few | {"audited": 3}, tmp_path / "a.zarr").dataset().attrs["audit"]["motion"]
    assert known["effort"] == "rounds" and known["efforts"] == [1, 1, 2, 8] and known["sample"] == 3
    assert "audit" not in jaxik.sweep(few, tmp_path / "b.zarr").dataset().attrs


def test_marks_are_reached_among_what_stands_beside_them(arm):
    robot, coal = arm
    builder = jaxik.collision.SceneBuilder("two")
    for name, x, y in (("left", 0.5, 0.4), ("right", 0.5, -0.4)):
        builder.add_mark(name, (x, y, 0.0), spheres=[[x, y, 0.0, 0.08]])
    scene = builder.scene()
    tool = {"up": [0.0, 0.0, 1.0], "approach": [1.0, 0.0, 0.0]}
    study = jaxik.sweeps.Study.of(
        {
            "robot": robot,
            "collision": {"scene": scene},
            "tool": tool,
            "motions": {"start": HOME},
            "targets": {"kind": "marks", "angles": 8},
        }
    )
    found = answer(study, study.variants[0], slice(0, 16))
    assert all(found["reachable"][study.targets.among == i].any() for i in range(2))
    for i in np.flatnonzero(found["reachable"]):
        own = study.targets.scenes[study.targets.among[i]]
        way = found["waypoints"][i, : found["waypoint_count"][i]]
        q = np.concatenate([np.linspace(a, b, 500) for a, b in itertools.pairwise(way)])
        assert coal.clearance(own, q).min() > -1e-5


def test_scenes_are_an_axis(arm, tmp_path):
    """Each motion is as it is alone in its scene, from a base and a start; random postures are free there."""
    robot, coal = arm
    ball = jaxik.make_scene(spheres=[[0.6, 0.1, 0.0, 0.15]])
    scenes = {"poles": POLES, "ball": ball, "free": jaxik.make_scene()}
    top = {"robot": robot, "collision": {"scenes": scenes}, "chunk": 7}
    poses = {"motions": {"start": {"home": HOME, "beside": [1.4, 0.3, 0.0]}}, "base": {"y": [0.0, 0.05]}, "targets": PLACES}
    done = jaxik.sweep(top | poses, tmp_path / "poses.zarr")
    assert done.dataset().reason.dims == ("base", "scene", "start", "target")
    assert list(done.dataset().scene.values) == ["poles", "ball", "free"]
    found, given = columns(done), done.study.targets.poses_at(np.arange(len(done.study.targets)))
    for variant in done.study.variants:
        base_T_world = np.linalg.inv(variant.robot.world_T_base)
        scene, home = list(scenes.values())[variant.index[1]].moved(base_T_world), variant.robot.mounted(np.eye(4))
        for i in range(variant.index[1], len(given), 13):
            known = {name: found[name][(*variant.index, i)] for name in WAY}
            is_as_planned(known, home, variant.start, base_T_world @ given[i], scene, 0)
    pairs = top | {"motions": {}, "targets": {"kind": "random", "count": 12}}
    done = jaxik.sweep(pairs, tmp_path / "pairs.zarr")
    found = columns(done)
    for k, scene in enumerate(scenes.values()):
        mine = {name: found[name][k] for name in (*WAY, "start_q", "goal_q")}
        assert not scene.object_names or coal.clearance(scene, np.concatenate([mine["start_q"], mine["goal_q"]])).min() > 0.0
        for i in range(0, 12, 5):
            is_as_planned({n: mine[n][i] for n in WAY}, robot, mine["start_q"][i], mine["goal_q"][i], scene, 0)
    again = pairs | {"collision": {"scenes": scenes | {"ball": POLES}}}
    with pytest.raises(StoreError, match=r"around\.ball was"):
        jaxik.sweep(again, tmp_path / "pairs.zarr")
    number = len(done.study.variants) * done.study.chunks - 1
    variant, _, rows = done.study.work(number)
    _, piece = _on_worker(number, *pickle.loads(pickle.dumps(_piece(done.study, number))))
    np.testing.assert_array_equal(piece["q"], found["q"][(*variant.index, rows)])


def test_scenes_of_files_have_their_names(arm, tmp_path):
    for name in ("left", "right"):
        (tmp_path / f"{name}.toml").write_text('name = "cell"\n[[object]]\nname = "b"\nspheres = [[0.5, 0, 0, 0.1]]\n')
    (tmp_path / "flat.urdf").write_text(URDF)
    top = 'robot = {file = "flat.urdf", tip = "tip"}\n[motions]\n[targets]\nkind = "random"\n[collision]\n'
    for given, labels in (
        ('scenes = ["left.toml", "right.toml"]', ("scene 1", "scene 2")),
        ('scenes = {a = "left.toml", b = "right.toml"}', ("a", "b")),
        ('scenes = ["left.toml"]', None),
    ):
        (tmp_path / "study.toml").write_text(top + given + "\n")
        study = jaxik.sweeps.Study.of(tmp_path / "study.toml")
        assert dict(study.axes).get("scene") == labels and study.scene_of(study.variants[-1]).object_names == ("b",)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"collision": {"scenes": [POLES, POLES]}}, "scenes are an axis of motions; write [motions]"),
        ({"motions": {"start": HOME}, "collision": {"scenes": []}}, "scenes is no list or table of scenes"),
        ({"motions": {"start": HOME}, "collision": {"scenes": [1.0]}}, "scenes is no list or table of scenes"),
        ({"motions": {"start": HOME}, "collision": {"scene": POLES, "scenes": [POLES]}}, "keep one"),
        ({"motions": {}}, "motions: no start; write start ="),
        ({"motions": {"start": [0.0, 1.0]}}, "start 1 has 2 numbers; flat has 3: one, two, three"),
        ({"motions": {"start": [0.0, 3.0, 0.0]}}, "start 1 is 0.2 rad or m beyond a joint's limit"),
        ({"motions": {"start": [[0.0, 1.0, 0.0], [0.0]]}}, "'start' is not k rows of k numbers"),
        ({"motions": {"start": HOME, "waypoint": 3}}, "unknown key 'waypoint'"),
        ({"motions": {"start": HOME, "timeout": 3.0}}, "unknown key 'timeout'"),
        ({"motions": {"start": HOME, "samples": 1}}, "one point is no motion"),
        ({"motions": {"start": HOME, "velocity": [1.0, 2.0]}}, "velocity"),
        ({"motions": {"start": HOME, "velocity": -1.0}}, "velocity"),
        ({"motions": {"start": HOME, "jerk": [1.0, 2.0]}}, "jerk"),
        ({"motions": {"start": HOME, "winding": 0.0}}, "winding"),
        ({"motions": {"start": HOME}, "slides": 3}, "'slides' is of a search for postures"),
        ({"motions": {"start": HOME}, "ik": {"max_seeds": 3}}, "'ik' is of a search for postures"),
        ({"motions": {"start": HOME}, "collision": {"reach": 0.1}}, "reach tells which posture is the best"),
        ({"motions": {"start": HOME}, "targets": {"goals": [[0.0]]}}, "goals have 1 numbers; flat has 3"),
        ({"motions": {"start": HOME}, "targets": {"kind": "postures"}}, "no goals; allowed: goals (N, n)"),
        ({"motions": {"start": HOME}, "targets": {"goals": [HOME], "starts": [HOME]}}, "start, and the targets have starts"),
        ({"motions": {}, "targets": {"goals": [HOME], "starts": [HOME, HOME]}}, "goals (1, 3), starts (2, 3); allowed"),
        ({"motions": {}, "targets": {"goals": [["a"]]}}, "no array of numbers"),
        ({"motions": {}, "targets": {"kind": "postures", "path": "no.npz"}}, "is not there"),
        ({"motions": {}, "targets": {"kind": "postures", "path": "no.csv"}}, "allowed: .npz"),
        ({"motions": {}, "targets": {"kind": "random", "count": 0}}, "count = 0"),
        ({"targets": {"kind": "random"}}, "postures are goals of motions; write [motions]"),
        ({"targets": {"goals": [HOME]}}, "postures are goals of motions; write [motions]"),
    ],
)
def test_a_study_of_motions_that_cannot_be_read(arm, change, words):
    with pytest.raises(ValueError, match=re.escape(words)) as error:
        jaxik.sweeps.Study.of({"robot": arm[0], "targets": PLACES} | change)
    assert "\n" not in str(error.value)


def test_another_study_is_refused_and_named(studies, done):
    changed = studies[0] | {"motions": studies[0]["motions"] | {"rounds": 9}}
    with pytest.raises(StoreError, match=r"motions\.rounds was 100000 and is 9"):
        jaxik.sweep(changed, done[0].path)
    with pytest.raises(ValueError, match="the targets are postures"):
        done[1].colliding(3)


def test_command_and_picture(arm, done, tmp_path, monkeypatch, capsys):
    """The command ends with the counts, says what a start that hits is hit by, and draws poses, not postures."""
    from jaxik.cli import main
    from jaxik.view import plot_sweep

    (tmp_path / "flat.urdf").write_text(URDF)
    (tmp_path / "cell.toml").write_text('name = "cell"\n[[object]]\nname = "pole"\nboxes = [[0.65, 0, 0, 0.3, 0.05, 0.5]]\n')
    text = 'robot = {{file = "flat.urdf", tip = "tip"}}\n[collision]\nscene = "cell.toml"\n[motions]\n{}\n[targets]\n{}\n'
    grid = "x = [0.3, 0.6, 2]\ny = [0.3, 0.5, 2]\nz = [0, 0, 1]"
    for name, start, targets in (
        ("hit", "start = [0, 0, 0]", grid),
        ("good", f"start = {HOME}", grid),
        ("pairs", "", 'kind = "random"\ncount = 3'),
    ):
        (tmp_path / f"{name}.toml").write_text(text.format(start, targets))

    def call(*words):
        monkeypatch.setattr("sys.argv", ["jaxik", "sweep", *map(str, words)])
        main()
        return capsys.readouterr()

    told = call(tmp_path / "hit.toml").out
    assert "4 collision; 1 of 1 chunks" in told and "start: b and pole collide by" in told
    told = call(tmp_path / "good.toml", "--plot").out
    assert "solved" in told and (tmp_path / "good.png").stat().st_size > 10_000
    with pytest.raises(SystemExit):
        call(tmp_path / "pairs.toml", "--plot")
    assert "--plot: a picture shows places" in capsys.readouterr().err
    plot_sweep(done[0].path, tmp_path / "two.png", scene=POLES)
    with pytest.raises(ValueError, match="its targets are postures"):
        plot_sweep(done[1].path, tmp_path / "no.png")
