"""Sweeps: answers against EAIK over the same slides and Pinocchio, the store, resume after kill -9, refusals, a cluster."""

import dataclasses
import errno
import itertools
import json
import os
import pickle
import shutil
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import pytest
import xarray
from peers.arm import eaik_robot
from robots import bare, pinocchio, pose_errors
from scipy.spatial.transform import Rotation

import jaxik
from jaxik import Reason
from jaxik.files.documents import models_folder
from jaxik.kinematics.shapes import Surface
from jaxik.sweeps.driver import _on_worker, _piece
from jaxik.sweeps.store import StoreError
from jaxik.sweeps.study import _digest
from jaxik.sweeps.targets import directions

GRID = {
    "kind": "grid",
    "x": [-0.1, 1.1, 7],
    "y": [0.2, 0.8, 5],
    "z": [0.1, 0.8, 5],
    "directions": [[0, 1, 0], [0.5, 1, -0.5]],
    "roll_deg": [0, 90],
}
SMALL = {"robot": "p6r", "slides": 11, "chunk": 100, "audited": 0, "targets": GRID}
TWO = SMALL | {"base": {"y": [0.0, 0.1]}, "chunk": 22, "targets": GRID | {"x": [-0.1, 1.1, 3], "y": [0.3, 0.8, 3]}}
CROWDED = SMALL | {"collision": {"scene": "cucumber_row", "margin": 0.005}, "slides": 5, "chunk": 50}
BARE = dataclasses.replace(jaxik.load("p6r"), boxes=())
DATA = ("reachable", "reason", "proven", "between", "solutions", "q", "clearance", "limit_margin", "manipulability")


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """An uninterrupted sweep, for all that only look at it."""
    return jaxik.sweep(SMALL, tmp_path_factory.mktemp("small") / "s.zarr")


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    """The same of two variants, nine chunks each, the last a short one: shard 2/2 has other chunks of the second."""
    return jaxik.sweep(TWO, tmp_path_factory.mktemp("two") / "t.zarr")


def same(a, b):
    """Whether two stores hold the same numbers."""
    return all(np.array_equal(a[k].values, b[k].values, equal_nan=a[k].dtype.kind == "f") for k in DATA)


def bits(folder):
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


# --------------------------------------------------------------------------------------------------------------------
# Answers


def test_map_is_that_of_eaik_over_the_same_slides(small):
    """Reachable, the number of postures and how free the best is, EAIK looped over the slide and the limits applied to what it
    finds."""
    robot, data = small.study.variants[0].robot, small.dataset()
    peer, tip = eaik_robot(robot)
    poses = np.linalg.inv(robot.world_T_base) @ small.study.targets.poses_at(np.arange(len(small.study.targets)))
    slides = np.linspace(0.0, 1.0, 11)
    lower, upper = robot.lower[1:], robot.upper[1:]
    for i in range(0, len(poses), 7):
        count, freest = 0, 0.0
        for slide in slides:
            pose = poses[i].copy()
            pose[:3, 3] -= [0.0, 0.0, slide]  # the slide runs along the base's z
            pose[:3, :3] = pose[:3, :3] @ tip.T
            found = peer.IK(pose)
            q = np.array(found.Q)[~np.array(found.is_LS)].reshape(-1, 6)
            turned = q + np.round(((lower + upper) / 2.0 - q) / (2.0 * np.pi)) * 2.0 * np.pi
            count += int(np.sum(np.all((turned >= lower) & (turned <= upper), axis=1)))
            room = np.minimum(turned - lower, upper - turned) / ((upper - lower) / 2.0)
            freest = max(freest, np.max(np.min(room, axis=1), initial=0.0))
        grid = 0 if data.between.values[i] else int(data.solutions.values[i])
        assert grid == count, (i, poses[i])
        assert not grid or abs(float(data.limit_margin.values[i]) - freest) < 1e-5


def test_postures_have_their_targets_by_pinocchio(small):
    robot, data = small.study.variants[0].robot, small.dataset()
    reached = np.flatnonzero(data.reachable.values)
    assert 0.1 < len(reached) / len(data.target) < 0.95
    forward = pinocchio(robot)
    for i in reached[::9]:
        target = np.eye(4)
        w, x, y, z = data.quaternion.values[i]
        target[:3, :3] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
        target[:3, 3] = data.position.values[i]
        q = data.q.values[i]
        errors = pose_errors(robot.world_T_base @ forward(q), target)
        assert max(errors) < 1e-9 and np.all((q >= robot.lower) & (q <= robot.upper))
        assert abs(data.position_error.values[i] - errors[0]) < 1e-9
    assert np.isnan(data.q.values[~data.reachable.values]).all()


def test_nothing_is_missed_that_was_said_to_be_proven():
    """A grid 100 times denser finds no target that the coarse sweep calls proven, and the coarse one leaves few open."""
    few = SMALL | {"slides": 6, "audited": 0, "targets": GRID | {"x": [-0.3, 1.2, 12], "y": [0.1, 0.9, 9]}}
    coarse, dense = (sweep_values(few | changes) for changes in ({}, {"slides": 501, "refine": 0}))
    missed = dense["reachable"] & ~coarse["reachable"]
    assert not np.any(missed & coarse["proven"])
    assert coarse["between"].sum() >= 5, "the coarse grid misses some, or this shows nothing"
    assert (~coarse["proven"]).mean() < 0.03
    assert np.all(coarse["reachable"] | ~(dense["reachable"] & coarse["proven"]))
    alone = sweep_values(few | {"refine": 0})
    found = dense["reachable"] & ~(coarse["reachable"] & ~coarse["between"])
    assert np.all(found <= (coarse["between"] | ~coarse["proven"])) and np.all(alone["proven"] <= coarse["proven"])


def test_two_leading_joints_of_which_one_turns(tmp_path, only_kernels):
    """Kernels alone answer, those over 1,681 positions too."""
    turn = '[[joint]]\nname = "turn"\ntype = "revolute"\na = 0.2\nlower_deg = -60\nupper_deg = 60\n\n'
    text = (models_folder() / "p6r.toml").read_text()
    (tmp_path / "turned.toml").write_text(text.replace("[[joint]]", turn + "[[joint]]", 1))
    robot = jaxik.load(tmp_path / "turned.toml")
    few = {"x": [-0.3, 1.2, 6], "y": [0.1, 0.9, 5], "z": [0.1, 0.9, 4], "directions": [[0, 1, 0], [1, 1, 0]]}
    study = {"robot": robot, "slides": 4, "audited": 0, "targets": {"kind": "grid"} | few}
    coarse, dense = (sweep_values(study | changes) for changes in ({}, {"slides": 41, "refine": 0}))
    assert not np.any(dense["reachable"] & ~coarse["reachable"] & coarse["proven"])
    assert coarse["between"].any() and (~coarse["proven"]).mean() < 0.1
    forward, poses = (
        pinocchio(robot),
        np.linalg.inv(robot.world_T_base) @ jaxik.sweeps.Study.of(study).targets.poses_at(np.arange(240)),
    )
    for i in np.flatnonzero(coarse["reachable"])[::9]:
        q = coarse["q"][i]
        assert max(pose_errors(forward(q), poses[i])) < 1e-9 and np.all((q >= robot.lower) & (q <= robot.upper))


def sweep_values(study, rows=None):
    from jaxik.sweeps.evaluation import answer

    read = jaxik.sweeps.Study.of(study)
    return answer(read, read.variants[0], slice(0, len(read.targets)) if rows is None else rows)


def test_collisions_are_those_of_the_scan():
    """Against `scan`, a target at a time: the number of clear postures, and the clearance of the best."""
    found = sweep_values(CROWDED | {"refine": 0})
    study = jaxik.sweeps.Study.of(CROWDED)
    robot, scene = study.variants[0].robot, study.scene
    reached = np.flatnonzero(found["reachable"])
    assert {int(r) for r in Reason if r <= 3} <= {*found["reason"].tolist(), int(Reason.LIMITS)}
    for i in reached[::20]:
        assert abs(float(jaxik.clearance(robot, scene, found["q"][i])) - found["clearance"][i]) < 1e-5
        assert found["clearance"][i] >= study.margin - 1e-6
    blocked = np.flatnonzero(found["reason"] == Reason.COLLISION)
    poses = np.linalg.inv(robot.world_T_base) @ study.targets.poses_at(np.arange(len(study.targets)))
    for i in blocked[::20]:
        for slide in np.linspace(0.0, 1.0, 5):
            each = jaxik.closed_form(robot, poses[i], slide)
            for q in np.asarray(each.q)[np.asarray(each.within_limits)]:
                assert float(jaxik.clearance(robot, scene, q)) < study.margin + 1e-6


def test_search_answers_what_has_no_closed_form():
    file, tip = bare("panda")
    panda = jaxik.load(file, tip=tip)
    study = {
        "robot": panda,
        "chunk": 64,
        "targets": {"kind": "grid", "x": [0.2, 1.1, 4], "y": [-0.4, 0.4, 3], "z": [0.0, 0.8, 3], "directions": 2},
    }
    found = sweep_values(study)
    assert np.mean(found["reachable"]) > 0.3 and np.any(found["reason"] == Reason.OUT_OF_REACH)
    forward, read = pinocchio(panda), jaxik.sweeps.Study.of(study)
    poses = read.targets.poses_at(np.arange(len(read.targets)))
    for i in np.flatnonzero(found["reachable"])[::5]:
        assert max(pose_errors(forward(found["q"][i]), poses[i])) < 2e-6
    free = sweep_values(study | {"targets": study["targets"] | {"directions": "any"}})
    assert free["reachable"].sum() >= found["reachable"].reshape(-1, 2).any(axis=1).sum()
    assert np.isnan(free["quaternion"]).all() and np.isnan(free["rotation_error"]).all()


def test_a_closed_form_that_is_given_nothing_misses_nothing(tmp_path, monkeypatch):
    """More positions of no slide are no effort: nothing is asked again, and the picture has no panel of what was missed."""
    from jaxik.sweeps import driver
    from jaxik.view import sweep_picture

    monkeypatch.setattr(driver, "_again", lambda *_: pytest.fail("asked again"))
    targets = {"kind": "grid", "x": [0.3, 0.9, 3], "y": [0.0, 0.4, 3], "z": [0.2, 0.8, 3], "directions": [[0, 0, -1]]}
    done = jaxik.sweep({"robot": "ur5e", "targets": targets}, tmp_path / "u.zarr")
    known = done.dataset().attrs
    assert done.counts()["solved"] > 0 and known["false_negative_rate"] == 0.0
    assert known["audit"]["closed form"]["efforts"] == known["audit"]["closed form"]["rates"] == []
    monkeypatch.setattr(sweep_picture, "_draw_missed", lambda *_: pytest.fail("drawn"))
    sweep_picture.plot_sweep(tmp_path / "u.zarr", tmp_path / "u.png")
    assert sweep_picture._effort({"effort": "slides", "of": ["lift", "panda_joint7"]}) == "positions of lift and panda_joint7"


def test_a_task_in_words(tmp_path):
    """Tools are within the cone by Pinocchio; errors are those to the cone, and a place alone has none of turning."""
    targets = {"kind": "grid", "x": [0.3, 0.9, 2], "y": [0.0, 0.4, 2], "z": [0.2, 0.8, 2], "directions": [[0, 0, -1]]}
    asked = {"robot": "ur5e", "targets": targets}
    cone = jaxik.sweep(asked | {"ik": {"task": "pointing z within 20deg"}}, tmp_path / "c.zarr")
    place = jaxik.sweep(asked | {"ik": {"task": jaxik.Task.position()}}, tmp_path / "p.zarr").dataset()
    found, pose = cone.dataset(), pinocchio(cone.study.variants[0].robot)
    poses, q, solved = cone.study.targets.poses_at(np.arange(8)), found.q.values.reshape(8, 6), found.reachable.values.ravel()
    assert solved.sum() > 3 and cone.study.method(cone.study.variants[0].robot) == "search"
    for tip, target in zip(map(pose, q[solved]), poses[solved], strict=True):
        np.testing.assert_allclose(tip[:3, 3], target[:3, 3], atol=1e-6)
        assert tip[:3, 2] @ target[:3, 2] >= np.cos(np.radians(20.0) + 1e-6)
    assert np.nanmax(found.rotation_error) < 1e-6 and np.isnan(place.rotation_error).all()
    assert cone.study.describe()["task"] != jaxik.sweeps.Study.of(asked | {"ik": {"task": "line"}}).describe()["task"]
    assert "task" not in jaxik.sweeps.Study.of(asked).describe()


def test_what_is_missed_is_measured(tmp_path):
    """The audit's rates, against sweeps of the same targets with the same efforts; and its bound against SciPy's own test."""
    from scipy.stats import binomtest

    from jaxik.sweeps.driver import rate_bound

    study = SMALL | {"refine": 0, "slides": 4, "audited": 10**6, "chunk": 700}
    known = jaxik.sweep(study, tmp_path / "a.zarr").dataset().attrs
    efforts = known["audit"]["closed form"]
    assert efforts["efforts"] == [1, 2, 4, 16] and efforts["sample"] == 700
    reached = [sweep_values(study | {"slides": n})["reachable"] for n in efforts["efforts"]]
    truth = np.any(reached, axis=0)
    assert np.allclose(efforts["rates"], [np.mean(~r[truth]) for r in reached])
    assert known["false_negative_rate"] == efforts["rates"][2] > 0.0
    assert efforts["of"] == ["slide"] and known["audit"].keys() == {"closed form"}
    for missed, of in ((0, 100), (3, 50), (7, 7)):
        limit = rate_bound(missed, of)
        assert limit == 1.0 or abs(binomtest(missed, of, limit, "less").pvalue - 0.05) < 1e-6


def test_rows_do_not_depend_on_what_comes_with_them(small):
    """The same bits alone, in odd parts, and for chunks of another size."""
    whole = small.dataset().load()
    for rows in (slice(17, 18), slice(3, 90), slice(100, 333)):
        part = sweep_values(SMALL, rows)
        for name in DATA:
            assert np.array_equal(part[name], whole[name].values[rows], equal_nan=part[name].dtype.kind == "f"), name


def test_chunks_of_another_size(small, tmp_path):
    other = jaxik.sweep(SMALL | {"chunk": 333}, tmp_path / "o.zarr")
    assert other.total == 3 and same(small.dataset(), other.dataset())


# --------------------------------------------------------------------------------------------------------------------
# Studies


def test_axes_are_robots_bases_and_parameters(tmp_path):
    study = SMALL | {
        "robots": ["p6r", {"file": "p6r", "name": "twin"}],
        "base": {"y": [0.0, 0.1]},
        "parameters": {"slide.upper": [0.3, 1.0]},
        "targets": GRID | {"x": [0.0, 1.0, 3], "y": [0.4, 0.8, 2], "z": [0.2, 0.6, 2]},
    }
    del study["robot"]
    data = jaxik.sweep(study, tmp_path / "a.zarr").dataset()
    assert data.reachable.dims == ("robot", "base", "slide.upper", "target") and data.reachable.shape == (2, 2, 2, 48)
    assert data.q.dims[-1] == "joint" and list(data.robot.values) == ["p6r", "twin"]
    assert np.array_equal(data.reachable.sel(robot="p6r"), data.reachable.sel(robot="twin"))
    more, less = (data.reachable.isel(robot=0, base=0).sel({"slide.upper": x}).values for x in (1.0, 0.3))
    assert np.all(less <= more) and less.sum() < more.sum()
    assert np.nanmax(data.q.sel({"slide.upper": 0.3}).values[..., 0]) <= 0.3
    moved = data.q.isel(robot=0, base=1).sel({"slide.upper": 1.0}).values
    reached = np.flatnonzero(np.isfinite(moved[:, 0]))
    robot = jaxik.load("p6r")
    for i in reached[::5]:
        at = robot.world_T_base @ pinocchio(robot)(moved[i])
        assert np.allclose(at[:3, 3] + [0.0, 0.1, 0.0], data.position.values[i], atol=1e-9)


def test_robots_with_other_numbers_of_joints_share_a_store(tmp_path):
    """The one with fewer joints has NaN after them, in its pieces for a cluster too."""
    p6r, arm = jaxik.load("p6r"), dataclasses.replace(jaxik.load("p6r").part(1, 7), name="arm", boxes=())
    study = jaxik.sweeps.Study.of({"robots": [p6r, arm], **{k: v for k, v in SMALL.items() if k != "robot"}, "chunk": 20})
    done = jaxik.sweep(study, tmp_path / "m.zarr", shard=(1, 9)).dataset()
    assert done.q.sizes["joint"] == 7 and done.q.sizes["robot"] == 2
    number = study.chunks + 9
    number, columns = _on_worker(number, *pickle.loads(pickle.dumps(_piece(study, number))))
    reached = np.flatnonzero(columns["reachable"])
    assert len(reached) and np.isnan(columns["q"][:, 6]).all() and np.isfinite(columns["q"][reached, :6]).all()
    poses = study.targets.poses_at(np.arange(180, 200))
    for i in reached[:3]:
        assert max(pose_errors(arm.world_T_base @ pinocchio(arm)(columns["q"][i, :6]), poses[i])) < 1e-9


def test_a_link_s_length(tmp_path):
    changed = jaxik.sweeps.Study.of(SMALL | {"parameters": {"theta4": {"length": [0.25, 0.35]}}})
    short, long = (v.robot for v in changed.variants)
    assert np.allclose(np.linalg.norm(long.parent_T_joint[3][:3, 3]), 0.35) and np.allclose(
        short.parent_T_joint, jaxik.load("p6r").parent_T_joint
    )
    q = np.array([0.3, 0.2, -0.5, -0.4, 0.3, 0.5, 0.1])
    assert not np.allclose(pinocchio(long)(q), pinocchio(short)(q))
    link = short.link_joint.index(3)
    for old, new in zip(short.boxes, long.boxes, strict=True):
        grown = np.max(new.half) - np.max(old.half)
        assert (grown > 0.01) == (old.link == link)


def test_kinds_of_targets(tmp_path):
    voxels = jaxik.sweeps.Study.of({"robot": "planar2", "targets": {"kind": "voxels", "size": 0.5}}).targets
    assert voxels.free_rotation and all(len(a) >= 4 for a in voxels.axes)
    assert np.allclose(voxels.poses_at(np.arange(1))[0, :3, 3], [a[0] for a in voxels.axes])
    rows = [jaxik.harvesting.make_row(seed=seed) for seed in range(2)]
    crop = jaxik.sweeps.Study.of({"robot": "p6r", "targets": {"kind": "marks", "scenes": rows, "angles": 6}}).targets
    assert len(crop) == 2 * 12 * 6 and crop.among.max() == 23
    (tmp_path / "t.csv").write_text("x,y,z,qw,qx,qy,qz\n0.5,0.6,0.4,1,0,0,0\n0.5,0.6,0.4,0,0,0,0\n")
    (tmp_path / "s.toml").write_text('robot = "p6r"\nslides = 11\naudited = 0\n[targets]\nkind = "file"\npath = "t.csv"\n')
    done = jaxik.sweep(tmp_path / "s.toml", tmp_path / "s.zarr")
    assert done.path == tmp_path / "s.zarr" and done.counts().get("invalid") == 1 and done and "invalid" in repr(done)
    rng = np.random.default_rng(5)
    rows = np.concatenate([rng.uniform(-1.0, 1.0, (9, 3)), rng.normal(size=(9, 4))], axis=1)
    np.savez(tmp_path / "t.npz", positions=rows[:, :3], wxyz=rows[:, 3:])
    of = lambda **given: jaxik.sweeps.Study.of({"robot": "p6r", "targets": {"kind": "file", **given}}).targets
    for targets in (of(path=str(tmp_path / "t.npz")), of(poses=rows)):  # seven numbers each, until a chunk asks
        frames, turned = targets.poses_at(np.arange(2, 9)), Rotation.from_quat(rows[2:, [4, 5, 6, 3]])
        assert targets.poses.shape == (9, 7) and np.allclose(frames[:, :3, :3], turned.as_matrix(), atol=1e-14)
        assert np.allclose(frames[:, :3, 3], rows[2:, :3]) and np.all(frames[:, 3] == [0.0, 0.0, 0.0, 1.0])
        assert np.allclose(targets.wxyz_at(np.arange(2, 9)), turned.as_quat(canonical=True)[:, [3, 0, 1, 2]])
    base, some = np.linalg.inv(jaxik.load("p6r").world_T_base), np.array([700, 3, 3, 250])
    for targets in (jaxik.sweeps.Study.of(SMALL).targets, crop, of(poses=rows[:, :3], directions=4)):
        chosen = some % len(targets)
        assert np.allclose(targets.poses_at(chosen, base), base @ targets.poses_at(chosen), atol=1e-15)
        assert np.array_equal(targets.poses_at(chosen), targets.poses_at(np.arange(len(targets)))[chosen])
        assert np.array_equal(targets.positions_at(chosen), targets.poses_at(chosen)[:, :3, 3])
    unit = directions(50)
    assert np.allclose(np.linalg.norm(unit, axis=1), 1.0) and np.linalg.norm(unit.mean(axis=0)) < 0.01


def test_crops_keep_clear_of_their_own_scene():
    study = {"robot": "p6r", "slides": 5, "collision": {"margin": 0.005}}
    study["targets"] = {"kind": "marks", "scenes": ["cucumber_row"], "angles": 4}
    found, read = sweep_values(study), jaxik.sweeps.Study.of(study)
    reached = np.flatnonzero(found["reachable"])
    assert len(reached) and np.any(found["reason"] == Reason.COLLISION)
    for i in reached[:5]:
        scene = read.targets.scenes[read.targets.among[i]]
        assert abs(float(jaxik.clearance(read.variants[0].robot, scene, found["q"][i])) - found["clearance"][i]) < 1e-5


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"robot": None}, "no robot"),
        ({"slide": 3}, "unknown key 'slide'"),
        ({"chunk": 0}, "chunk = 0"),
        ({"targets": GRID | {"x": [0, 1]}}, "'x' is not 3 numbers, from, to, count"),
        ({"targets": GRID | {"kind": "ball"}}, "allowed: grid, voxels, file, marks"),
        ({"targets": GRID | {"directions": [[0, 0, 0]]}}, "a direction has no length"),
        ({"parameters": {"slide.width": [1]}}, "allowed: JOINT.lower"),
        ({"parameters": {"elbow.length": [1]}}, "has no joint 'elbow'"),
        ({"parameters": {"slide.upper": [-1]}}, "crosses the other limit"),
        ({"parameters": {"a.x": [1], "b.x": [1], "c.x": [1]}}, "vary at most two"),
        ({"collision": {"margins": 1}}, "unknown key 'margins'"),
        ({"robot": BARE, "collision": {"scene": "cucumber_row"}}, "no collision geometry"),
        ({"ik": {"choice": "best"}}, "choice 'best'"),
        ({"ik": {"task": "uprigt z"}}, "did you mean 'upright'"),
        ({"ik": {"task": ["position", "line"]}}, "write one task"),
        ({"ik": {"task": []}}, "an empty list"),
        ({"ik": {"task": "position weight 1"}}, "weight 1 makes it soft"),
        ({"ik": {"task": "position tip hand"}}, "own tip is meant"),
        ({"ik": {"task": jaxik.Task.own(lambda tip, target: tip[:3, 3])}}, "write one in words"),
        ({"ik": {"task": "pose"}, "targets": GRID | {"directions": "any", "roll_deg": None}}, "these are positions"),
        ({"robots": ["p6r", "p6r"], "robot": None}, "two robots of one name"),
        ({"out": "a.zarr"}, "unknown key 'out'"),
        ({"robot": {"file": "p6r", "meshes": "no"}}, "meshes = 'no'"),
        ({"tool": {"up": [1, 0, 0]}, "targets": GRID | {"directions": "any", "roll_deg": None}}, "no target has a direction"),
        ({"targets": GRID | {"directions": "any"}}, "'roll' without directions"),
        ({"targets": GRID | {"directions": "all"}}, "directions = 'all'; write \"any\", a count, or a list"),
        ({"targets": GRID | {"roll_deg": []}}, "'roll' holds no number"),
        ({"targets": {"kind": "marks", "frame": "base"}}, "marks stand in the world"),
        ({"targets": {"kind": "marks"}}, "no target; give at least one"),
        ({"targets": {"kind": "marks", "scenes": "cucumber_row"}}, "'scenes' is not a list of scenes or files"),
        ({"targets": {"kind": "marks", "scenes": [3]}}, "a scene is int"),
        ({"targets": {"kind": "marks", "scenes": [jaxik.make_scene(name="bare")]}}, "scene 'bare' has no mark"),
        (
            {"collision": {"scene": "cucumber_row"}, "targets": {"kind": "marks", "scenes": ["cucumber_row"]}},
            "scenes and [collision] scene both say",
        ),
        ({"targets": {"poses": [[0, 1, 0]], "path": "a.csv"}}, "path and poses say the same"),
        ({"targets": {"poses": [[0, 1, 0], [0, 1]]}}, "poses: list that is no array of numbers"),
        ({"base": {"y": []}}, "'y' holds no number"),
        ({"base": {"y": [0.0, float("inf")]}}, "'y' holds inf"),
        ({"parameters": {"slide.upper": []}}, "slide.upper holds no number"),
        ({"collision": {"margin": float("inf")}}, "'margin' holds inf"),
        ({"collision": {"reach": float("inf")}}, "'reach' holds inf"),
        ({"ik": {"position_tolerance": 0.0}}, "position_tolerance = 0"),
        ({"ik": {"rotation_tolerance": float("inf")}}, "'rotation_tolerance' holds inf"),
        ({"chunk": float("inf")}, "chunk = inf"),
        ({"targets": GRID | {"x": [0.0, 1.0, float("inf")]}}, r"x = [0, 1, inf]"),
    ],
)
def test_a_study_that_cannot_be_read(change, words):
    study = {k: v for k, v in (SMALL | change).items() if v is not None}
    study["targets"] = {k: v for k, v in study["targets"].items() if v is not None}
    with pytest.raises(ValueError, match=words.replace("[", r"\[")) as error:
        jaxik.sweeps.Study.of(study)
    assert "\n" not in str(error.value)


def test_an_empty_collision_table_keeps_the_margin_in_a_search_too():
    """The robot from itself, by the margin that the store names, whichever way its targets are answered."""
    for given, margin in (({}, 0.0), ({"margin_mm": 5}, 0.005)):
        study = jaxik.sweeps.Study.of({"robot": "crops_v2", "collision": given, "targets": {"poses": [[0.5, 0.5, 0.5]]}})
        assert study.collision and study.ik.margin == study.margin == margin and study.ik.collision


def test_marks_of_the_scene_that_is_in_the_way():
    """Unless others are listed; what stands at a mark is no obstacle to it."""
    targets = {"kind": "marks", "angles": 4}
    own = jaxik.sweeps.Study.of({"robot": "p6r", "collision": {"scene": "cucumber_row"}, "targets": targets})
    listed = jaxik.sweeps.Study.of({"robot": "p6r", "collision": {}, "targets": targets | {"scenes": ["cucumber_row"]}})
    assert own.describe() == listed.describe() and own.scene is None and len(own.targets) == 48
    bare = jaxik.collision.SceneBuilder("bare")
    bare.add_mark("place", (0.5, 0.6, 0.5), axis=(0.0, 0.0, 1.0))
    alone = jaxik.sweeps.Study.of({"robot": "p6r", "targets": targets | {"scenes": [bare.scene()]}})
    assert len(alone.targets) == 4 and np.allclose(alone.targets.positions_at(np.arange(4)), [0.5, 0.6, 0.5])


# --------------------------------------------------------------------------------------------------------------------
# The store


def test_store_is_read_by_xarray_and_says_what_it_holds(small):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        data = xarray.open_zarr(small.path).load()
    assert data.q.dims == ("target", "joint") and list(data.joint.values) == list(small.study.variants[0].robot.joint_names)
    known = data.attrs
    assert known["quaternion_order"] == "wxyz" and known["complete"] and known["versions"]["jaxik"] == jaxik.__version__
    assert small.study.variants[0].robot.digest[:16] in known["models"]["only"] and known["seed"] == 0
    assert data.clearance.attrs["units"] == "m" and "limits" in data.reason.attrs["flag_meanings"]
    assert known["undecided"] == int((~data.proven).sum()) and sum(known["counts"].values()) == len(data.target)
    assert not any(b"pickle" in content for content in bits(small.path).values())


KILLED = """
import sys, time, json, jaxik
jaxik.sweep(json.loads(sys.argv[1]), sys.argv[2], progress=lambda done, total: print(done, flush=True) or time.sleep(0.02))
"""


def test_killed_at_any_moment_it_ends_with_the_same_bits(two, tmp_path):
    """kill -9 after one of its chunks and a random while; then a rerun to the end. Finished chunks are not touched again."""
    rng, path = np.random.default_rng(0), tmp_path / "k.zarr"
    for turn in range(3):
        command = [sys.executable, "-c", KILLED, json.dumps(TWO), str(path)]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        first = int(next(process.stdout))
        assert int(next(process.stdout)) > first
        time.sleep(rng.uniform(0.0, 0.05))
        process.send_signal(signal.SIGKILL)
        assert process.wait() == -signal.SIGKILL
        process.stdout.close()
        chunks = {p: p.stat().st_mtime_ns for p in path.glob("crc/c/*/*")}
        assert turn + 1 <= len(chunks) < two.total
    jaxik.sweep(TWO, path)
    assert all(p.stat().st_mtime_ns == t for p, t in chunks.items())
    assert bits(path) == bits(two.path)


def test_shards_fill_one_store(two, tmp_path):
    path = tmp_path / "s.zarr"
    first = jaxik.sweep(TWO, path, shard="1/2")
    assert not first.complete and first.done == 9 and "complete" not in first.dataset().attrs
    second = jaxik.sweep(TWO, path, shard=(2, 2))
    assert second.complete and bits(path) == bits(two.path)
    for shard in ("0/2", "3/2", "half", 2, (1,), (1.0, 2.0), ("1", "2")):
        with pytest.raises(ValueError, match="write i/n"):
            jaxik.sweep(TWO, path, shard=shard)


@pytest.mark.parametrize("order", [("2/2", "2/2"), ("2/2", "1/1"), ("3/3", "2/3", "3/3", "1/3"), ("2/2", "3/4", "2/3", "1/2")])
def test_shards_come_in_any_order_and_again(two, tmp_path, order):
    """Each leaves whole rows: whatever variant a piece is of, its targets' positions stand beside its answers."""
    for shard in order:
        done = jaxik.sweep(TWO, tmp_path / "s.zarr", shard=shard)
        data = done.dataset()
        known = (data.reason >= 0).any("base").values
        assert np.array_equal(np.isfinite(data.position.values).all(axis=1), known) and known.any()
    assert jaxik.sweep(TWO, tmp_path / "s.zarr").complete and bits(tmp_path / "s.zarr") == bits(two.path)


def test_a_store_begun_before_every_piece_wrote_its_targets_goes_on(two, tmp_path):
    """Only those of the first variant did; one was killed between the two columns."""
    path = tmp_path / "s.zarr"
    jaxik.sweep(TWO, path, shard="2/2")
    for chunk in (0, 2, 4, 6, 8):
        for name in ("position", "quaternion"):
            if (chunk, name) != (2, "position"):
                (path / name / "c" / str(chunk) / "0").unlink()
    assert jaxik.sweep(TWO, path, shard="2/2").done == 9
    assert jaxik.sweep(TWO, path).complete and bits(path) == bits(two.path)


def test_nothing_collides_where_nothing_is_done_or_looked_at(small, tmp_path):
    targets = {"kind": "marks", "scenes": ["cucumber_row"], "angles": 1}
    none = jaxik.sweep({"robot": "p6r", "slides": 2, "targets": targets}, tmp_path / "m.zarr", shard="2/2")
    assert none.done == 0 and len(none.colliding(2)) == 0 == len(small.colliding(2))


def test_stop_and_go_on(two, tmp_path):
    """Stopped in the first variant, where its last chunk is the second's first to come, and in the second."""
    path, done = tmp_path / "s.zarr", 0
    for count in (3, 6, 4):
        seen = []
        stopped = jaxik.sweep(TWO, path, progress=lambda d, t, seen=seen: seen.append(d), stop=lambda: len(seen) >= count)  # noqa: B023
        assert done < stopped.done < stopped.total
        done = stopped.done
    assert jaxik.sweep(TWO, path).complete and bits(path) == bits(two.path)


def test_another_study_is_refused_and_named(small):
    changed = SMALL | {"slides": 12, "targets": GRID | {"z": [0.1, 0.8, 6]}}
    with pytest.raises(StoreError, match=r"slides was 11 and is 12; targets.axis_z was .* 5. and is .* 6.; targets.count"):
        jaxik.sweep(changed, small.path)
    with pytest.raises(StoreError, match=r"models.only was .*p6r"):
        jaxik.sweep(SMALL | {"robot": jaxik.load("p6r").with_spheres(64)}, small.path)


def spoil(file):
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)


def test_files_are_those_that_zarr_writes(two, tmp_path, monkeypatch):
    """Bit by bit, the short last chunk and columns of nothing among them."""
    monkeypatch.setattr(sys.modules[StoreError.__module__], "_put", lambda *_: False)
    assert bits(jaxik.sweep(TWO, tmp_path / "z.zarr").path) == bits(two.path)


def test_damage_is_found_named_and_mended(two, tmp_path):
    """Damage in both variants; that of a target's position in whichever shard finds it."""
    path = tmp_path / "d.zarr"
    jaxik.sweep(TWO, path)
    spoil(path / "q" / "c" / "1" / "2" / "0")
    with pytest.raises(StoreError, match=r"chunk 11, targets 44 to 65: 'q' is damaged .* repair"):
        jaxik.sweep(TWO, path)
    (path / "reason" / "c" / "0" / "4").unlink()
    jaxik.sweep(TWO, path, repair=True)
    assert bits(path) == bits(two.path)
    spoil(path / "position" / "c" / "8" / "0")
    for shard in ("2/2", "1/2"):
        with pytest.raises(StoreError, match="'position' is damaged"):
            jaxik.sweep(TWO, path, shard=shard)
    for repair in (True, False):
        assert jaxik.sweep(TWO, path, shard="2/2", repair=repair).complete
    (path / "quaternion" / "c" / "2" / "0").unlink()
    jaxik.sweep(TWO, path, repair=True)
    assert bits(path) == bits(two.path)
    (tmp_path / "other").mkdir()
    with pytest.raises(StoreError, match="is no store of a sweep"):
        jaxik.sweep(TWO, tmp_path / "other")


@pytest.mark.parametrize("name", ["reason", "proven"])
def test_damage_in_another_shard_s_chunk(two, tmp_path, name):
    """The counts at the end are of all: a chunk that cannot be is named, and with repair it is open to its own shard."""
    path = tmp_path / "d.zarr"
    jaxik.sweep(TWO, path, shard="1/2")
    spoil(path / name / "c" / "0" / "2")
    with pytest.raises(StoreError, match=f"chunk 2, targets 44 to 65: '{name}' is damaged .* repair"):
        jaxik.sweep(TWO, path, shard="2/2")
    (path / "reason" / "c" / "0" / "4").unlink()
    with pytest.raises(StoreError, match=r"chunk [24], .* (missing|damaged).* repair"):
        jaxik.sweep(TWO, path, shard="2/2")
    assert jaxik.sweep(TWO, path, shard="2/2", repair=True).done == 16
    assert jaxik.sweep(TWO, path).complete and bits(path) == bits(two.path)


def test_a_store_is_not_complete_while_chunks_are_mended(two, tmp_path):
    path = tmp_path / "d.zarr"
    shutil.copytree(two.path, path)
    for chunk in range(9):
        spoil(path / "reason" / "c" / "1" / str(chunk))
    stopped = jaxik.sweep(TWO, path, repair=True, stop=lambda: True)
    assert not stopped.complete and stopped.dataset().attrs["complete"] is False
    killed, other = (
        path / "q" / "c" / "0" / "3.ab.partial",
        path / "zarr.ab.partial",
    )  # half a chunk; another shard's, that ends too
    killed.touch(), other.touch()
    jaxik.sweep(TWO, path)
    assert not killed.exists() and other.exists()
    other.unlink()
    assert jaxik.sweep(TWO, path).complete and bits(path) == bits(two.path)


def test_shards_on_other_machines_with_the_same_number_of_process(tmp_path):
    """Each makes the store aside; the first that is ready renames it, and none takes another's away."""
    other = tmp_path / f".{os.getpid()}-s.zarr"
    other.mkdir()
    (other / "zarr.json").write_text("{")
    assert jaxik.sweep(TWO, tmp_path / "s.zarr", shard=(1, 18)).done == 1
    assert sorted(p.name for p in tmp_path.iterdir()) == [other.name, "s.zarr"] and (other / "zarr.json").exists()


def test_a_disk_that_is_full_loses_nothing(two, tmp_path, monkeypatch):
    """The system's own refusal, from the third chunk on; then there is room again."""
    from jaxik.sweeps.store import Store

    write, calls = Store.write, itertools.count()

    def full(self, number, columns):
        if next(calls) >= 2:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        write(self, number, columns)

    monkeypatch.setattr(Store, "write", full)
    with pytest.raises(OSError, match=r"chunk 2 could not be written \(No space left on device\); mend that and run again"):
        jaxik.sweep(TWO, tmp_path / "f.zarr")
    monkeypatch.undo()
    assert jaxik.sweep(TWO, tmp_path / "f.zarr").complete and bits(tmp_path / "f.zarr") == bits(two.path)
    with pytest.raises(OSError):
        jaxik.sweep(TWO, Path(os.devnull) / "nowhere.zarr")


HELD = """
import signal, time
from jaxik.sweeps.store import Store
write = Store.write
def held(*given):  # the first chunk is on disk, and no other until Ctrl-C was heard: its second would end the command
    write(*given)
    while "Patience" in repr(signal.getsignal(signal.SIGINT)):
        time.sleep(0.01)
Store.write = held
"""


def test_command(tmp_path, two):
    """A sweep of a TOML file by the command; Ctrl-C ends after the running chunk, and the same command goes on."""
    grid = "\n".join(f"{k} = {json.dumps(v)}" for k, v in TWO["targets"].items())
    top = "\n".join(f"{k} = {json.dumps(v)}" for k, v in TWO.items() if k not in ("targets", "base"))
    (tmp_path / "two.toml").write_text(f"{top}\n[base]\ny = [0.0, 0.1]\n[targets]\n{grid}\n")
    main, sweep = "from jaxik.cli import main; main()", ("sweep", "two.toml")
    run = {"cwd": tmp_path, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    process = subprocess.Popen([sys.executable, "-c", HELD + main, *sweep], **run)
    while not list(tmp_path.glob("two.zarr/crc/c/*/*")) and process.poll() is None:
        time.sleep(0.005)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130 and "of 18 chunks in" in out and "goes on" in err, (out, err)
    assert 1 <= len(list(tmp_path.glob("two.zarr/crc/c/*/*"))) < 18
    command = [sys.executable, "-c", main, *sweep]
    again = subprocess.run(command, **run)
    assert again.returncode == 0 and "18 of 18 chunks" in again.stdout
    kept = ("q", "reason", "crc")  # the study's name differs, and only that
    assert {k: v for k, v in bits(tmp_path / "two.zarr").items() if k.split("/")[0] in kept} == {
        k: v for k, v in bits(two.path).items() if k.split("/")[0] in kept
    }
    (tmp_path / "bad.toml").write_text('robot = "p6r"\n[targets]\nkind = "grid"\n')
    bad = subprocess.run([*command[:-1], "bad.toml"], **run)
    assert bad.returncode == 2 and "targets: 'x' is missing" in bad.stderr and "Traceback" not in bad.stderr


# --------------------------------------------------------------------------------------------------------------------
# A cluster


def dask(*words, folder):
    command = [sys.executable, "-m", "dask", *words, "--scheduler-file", str(folder / "scheduler.json")]
    return subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def test_a_cluster_makes_the_same_store_though_a_worker_dies(two, tmp_path):
    """A scheduler and two workers on loopback; one worker is killed once the first chunk is there."""
    local = ("--host", "127.0.0.1", "--no-dashboard")
    running = [dask("scheduler", *local, "--port", "0", folder=tmp_path)]
    try:
        while not (tmp_path / "scheduler.json").exists():
            time.sleep(0.05)
        address = json.loads((tmp_path / "scheduler.json").read_text())["address"]
        workers = [dask("worker", *local, "--nthreads", "1", "--no-nanny", folder=tmp_path) for _ in range(2)]
        running += workers
        from distributed import Client

        with Client(address, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=60)

        def progress(done, total):
            if done > 0:
                workers[0].kill()

        done = jaxik.sweep(TWO, tmp_path / "c.zarr", cluster=address, progress=progress)
        assert done.complete and workers[0].wait() == -signal.SIGKILL and workers[1].poll() is None
        assert bits(tmp_path / "c.zarr") == bits(two.path)
    finally:
        for process in running:
            process.kill()
            process.wait()
    with pytest.raises(ValueError, match="no scheduler answers"):
        jaxik.sweep(TWO, tmp_path / "d.zarr", cluster="tcp://127.0.0.1:9")


def test_a_lengthened_link_takes_its_triangles_along():
    """They stayed where they were, and what lay beyond them was not seen."""
    robot = jaxik.load("planar2")
    link = robot.link_joint.index(1)
    corners = np.array([[[0.0, 0.0, -0.02], [1.0, 0.0, -0.02], [1.0, 0.0, 0.02]]])
    skin = Surface(link, corners, np.zeros(1), np.zeros(1, bool), np.zeros(1, int))
    asked = SMALL | {"robot": dataclasses.replace(robot, surfaces=(skin,)), "parameters": {"q2.length": [1.0, 1.5]}}
    asked["targets"] = {"kind": "voxels", "size": 0.5}
    short, long = (v.robot for v in jaxik.sweeps.Study.of(asked).variants)
    np.testing.assert_array_equal(short.surfaces[0].corners, corners)
    np.testing.assert_allclose(long.surfaces[0].corners, corners * [1.5, 1.0, 1.0])
    np.testing.assert_allclose(long.volumes[0].corners, robot.volumes[0].corners * [1.5, 1.0, 1.0])


@pytest.mark.parametrize("values", [{"length": [1.2]}, {"x": [1.1]}, {"y": [-0.3]}])
def test_a_link_s_geometry_goes_with_its_offset(values, tmp_path):
    """The offset is oblique to the box, and what is inside of the link comes to be inside of its new box."""
    text = """name = "arm"
convention = "frames"
joint = [{name = "turn", type = "revolute", lower = -3, upper = 3},
  {name = "bend", type = "revolute", axis = [0, 1, 0], translation = [0.4, 0.4, 0], lower = -3, upper = 3}]
shape = [{link = "turn_link", kind = "box", center = [0.25, 0, 0], size = [0.5, 0.05, 0.05]},
  {link = "turn_link", kind = "capsule", points = [[0, 0, 0], [0.4, 0.4, 0]], radius = 0.02}]
"""
    file = tmp_path / "arm.toml"
    file.write_text(text)
    study = jaxik.sweeps.Study.of(
        {"robot": str(file), "targets": {"kind": "voxels", "size": 0.5}, "parameters": {"bend": values}}
    )
    before, (after,) = jaxik.load(file), (v.robot for v in study.variants)
    old, new = before.parent_T_joint[1][:3, 3], after.parent_T_joint[1][:3, 3]
    np.testing.assert_allclose(after.volumes[0].corners, [np.zeros(3), new], atol=1e-12)
    local = np.random.default_rng(0).uniform(-1, 1, (1000, 3)) * before.boxes[0].half
    points = local @ before.boxes[0].joint_T_box[:3, :3].T + before.boxes[0].joint_T_box[:3, 3]
    points += ((points @ old) / (old @ old))[:, None] * (new - old)  # as much further as it is along the offset
    inside = (points - after.boxes[0].joint_T_box[:3, 3]) @ after.boxes[0].joint_T_box[:3, :3]
    assert np.all(np.abs(inside) <= after.boxes[0].half + 1e-12)


def test_a_tip_moves_no_joint_that_follows(tmp_path):
    file = tmp_path / "follows.urdf"
    links = "".join(f'<link name="l{i}"/>' for i in range(4))
    limit, mimic = '<limit lower="-1" upper="1" velocity="1" effort="1"/>', '<mimic joint="j1"/>'
    joint = '<joint name="j{0}" type="revolute"><parent link="l{1}"/><child link="l{0}"/><origin xyz="{2} 0 0"/>{3}</joint>'
    rows = ((1, 0.0, limit), (2, 0.2, limit + mimic), (3, 0.25, limit))
    hand = (
        '<link name="hand"/><joint name="h" type="fixed"><parent link="l3"/><child link="hand"/><origin xyz="0.1 0 0"/></joint>'
    )
    joints = "".join(joint.format(i, i - 1, x, more) for i, x, more in rows)
    file.write_text(f'<robot name="follows">{links}{joints}{hand}</robot>')
    asked = SMALL | {"robot": str(file), "parameters": {"tip.length": [0.1, 0.3]}}
    asked["targets"] = {"kind": "voxels", "size": 0.5}
    found = [v.robot for v in jaxik.sweeps.Study.of(asked).variants]
    at = [float(jaxik.forward_kinematics(robot, np.zeros(2))[0, 3]) for robot in found]
    np.testing.assert_allclose(at, [0.55, 0.75], atol=1e-6)


def test_a_scene_is_known_by_its_names_too():
    """Links ignore objects by name, and a store of the scene before was taken for complete."""
    of = lambda name: _digest(jaxik.make_scene().with_(name, boxes=[[0.0, 0.0, 0.0, 1.0, 1.0, 0.1]]))
    assert of("floor") == of("floor") != of("ground")
