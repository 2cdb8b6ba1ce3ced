"""Bases on the floor: what each sees against `solve_ik` one by one, and that no posture refutes a proof for a whole cell."""

import numpy as np
import pytest
from robots import pinocchio
from scipy.spatial.transform import Rotation

import jaxik
from jaxik.reach import Floor, base_frames, base_poses
from jaxik.reasons import Reason

UP = np.eye(4)
UP[:3, :3], UP[:3, 3] = Rotation.from_euler("z", 0.4).as_matrix(), [0.2, -0.1, 0.4]
ROBOT = jaxik.load("ur5e").mounted(UP)
REGION = {"x": (-1.0, 1.0, 4), "y": (-0.8, 1.2, 4), "headings": 3}
TABLE = jaxik.make_scene(boxes=[[0.0, 0.0, 0.45, 0.5, 0.4, 0.02]])


def grasps(count, seed=0):
    rng, found = np.random.default_rng(seed), np.tile(np.eye(4), (count, 1, 1))
    found[:, :3, 3] = rng.uniform([-0.3, -0.3, 0.5], [0.3, 0.3, 1.0], (count, 3))
    found[:, :3, :3] = Rotation.random(count, random_state=rng).as_matrix()
    return found


@pytest.mark.filterwarnings("ignore:.*in every configuration")  # where a base stands in the table
@pytest.mark.parametrize("scene", [None, TABLE], ids=["alone", "a table"])
def test_a_base_sees_what_solve_ik_reaches_from_there(scene):
    poses, margin = grasps(5), 0.01
    found = base_poses(ROBOT, poses, **REGION, scene=scene, margin=margin)
    for frame, seen in zip(found.world_T_base, found.seen, strict=True):
        base_T_world = np.linalg.inv(frame @ UP)
        around = None if scene is None else scene.moved(base_T_world)
        alone = jaxik.solve_ik(ROBOT.mounted(np.eye(4)), base_T_world @ poses, scene=around, margin=margin)
        assert np.array_equal(alone.success, seen)
    assert 20 < found.seen.sum() < found.seen.size - 20 and np.array_equal(found.count, found.seen.sum(axis=1))
    assert set(np.unique(found.reasons[found.proven])) == {Reason.OUT_OF_REACH}


@pytest.mark.parametrize("name", ["ur5e", "p6r", "panda"])
@pytest.mark.parametrize("rotation", [True, False])
def test_no_posture_from_anywhere_in_a_cell_refutes_a_proof(name, rotation):
    """Poses that Pinocchio knows to be reached, from random places in random cells; stretched ones among them."""
    robot, rng, count = jaxik.load(name).mounted(UP), np.random.default_rng(1), 300
    floor = Floor.of((-1.5, 1.5, 6), (-1.5, 1.5, 5), (-0.8, 2.0, 3))
    low, high = robot.finite_limits
    q = rng.uniform(low, high, (count, robot.num_joints))
    q[::3] = np.clip(0.02 * q[::3], low, high)
    half, cells, pose_of = np.array([axis.half for axis in floor]), floor.bases(), pinocchio(robot)
    cell = rng.integers(len(cells), size=count)
    base = cells[cell] + rng.uniform(-half, half, (count, 3))
    poses = np.array([frame @ UP @ pose_of(row) for frame, row in zip(base_frames(base), q, strict=True)])
    proven = floor.beyond(robot, cells, poses, rotation=rotation, slack=0.0)
    assert not proven[cell, np.arange(count)].any()
    assert 0.02 < proven.mean() < 0.98  # and others of the cells are


def test_a_proof_that_ends_at_the_reach_itself():
    """An arm's tip as far away as it gets, at the corner of a cell that is the farthest: proven for no less."""
    robot = jaxik.load("ur5e")
    bound = jaxik.kinematics.reach_bound.reach_bound(robot, False)
    floor = Floor.of((0.0, 0.2, 1), (0.0, 0.2, 1), 1)
    target = lambda more: (
        np.eye(4)[None] + np.pad((bound.longest + more) * np.array([[[0.0], [0.6], [0.8]]]), ((0, 0), (0, 1), (3, 0)))
    )
    for more, proven in ((0.0, False), (0.5, True)):
        assert floor.beyond(robot, floor.bases(), target(more), rotation=False, slack=0.0)[0, 0] == proven


def test_a_base_that_hits_something_sees_nothing():
    robot = jaxik.load("ur5e")
    wall = jaxik.make_scene(boxes=[[0.5, 0.0, 0.0, 1.0, 4.0, 0.3]])  # about the base link from x = 0 on
    found = base_poses(robot, grasps(4), **REGION, scene=wall)
    inside = found.bases[:, 0] > 0.1
    assert inside.any() and not found.seen[inside].any() and found.seen[~inside].any()
    assert np.isin(found.reasons[inside], (Reason.COLLISION, Reason.OUT_OF_REACH)).all()


def test_joints_of_a_planar_base_are_left_out():
    from peers.panda import ROBOTS

    load = lambda **how: jaxik.load(ROBOTS / "tiago_description/robots/tiago_no_hand.urdf", tip="arm_tool_link", held={}, **how)
    region, poses = {"x": (-1.0, 1.0, 3), "y": (-1.0, 1.0, 3), "headings": 2}, grasps(6)
    one, other = (base_poses(robot, poses, **region, collision=False) for robot in (load(base="planar"), load()))
    assert np.array_equal(one.reasons, other.reasons) and np.array_equal(one.proven, other.proven) and one.seen.any()


def test_what_is_asked_of_the_bases():
    poses = grasps(6)
    poses[2] = np.nan
    done = []
    found = base_poses(ROBOT, poses, **REGION, collision=False, progress=lambda *each: done.append(each))
    assert done[-1][0] == done[-1][1] and (found.reasons[:, 2] == Reason.INVALID).all()
    assert found.on_floor(found.count).shape == (4, 4) and len(found) == 48
    best, stops = found.best(48), found.stops()
    assert found.count[best[0]] == found.count.max() and (np.diff(found.count[best]) <= 0).all() and stops[0] == best[0]
    assert np.array_equal(found.seen[stops].any(axis=0), found.seen.any(axis=0))
    assert (
        found[int(best[0])] and "6 targets" in repr(found[int(best[0])]) and f"the best {found.count.max()} of 6" in repr(found)
    )
    again = base_poses(ROBOT, poses[[0, 1, 3, 4, 5]], **REGION, collision=False)
    assert np.array_equal(again.reasons, found.reasons[:, [0, 1, 3, 4, 5]])
    far = base_poses(ROBOT, poses, **REGION | {"x": (4.0, 5.0, 2)}, collision=False)
    assert far.empty.all() and not len(far.stops())


def test_free_positions_prove_nothing_and_positions_do():
    poses = grasps(3)
    free = base_poses(ROBOT, poses, **REGION, task=jaxik.Task.pose(("x",)), collision=False)
    places = base_poses(ROBOT, poses[:, :3, 3], **REGION, task=jaxik.Task.position(), collision=False)
    assert not free.proven.any() and places.seen.sum() > 0 and (free.seen | ~places.seen).sum() > 0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"x": (1.0, 0.0, 3)}, r"base_poses: x is \(1.0, 0.0, 3\); write \(from, to, count\)"),
        ({"y": 3.0}, "base_poses: y is 3.0; write"),
        ({"headings": 0}, r"headings.*count >= 1"),
        ({"headings": "all"}, "base_poses: headings is all; write a count"),
        ({"position_tolerance": [1e-6, 1e-6]}, "position_tolerance of one a target"),
        ({"reference": np.zeros((2, 6))}, "reference of one a target"),
    ],
)
def test_refusals(change, words):
    with pytest.raises(ValueError, match=words):
        base_poses(ROBOT, grasps(2), **REGION | change)


def test_a_picture(tmp_path):
    from jaxik.view import plot_base_poses

    poses = grasps(4)
    found = base_poses(ROBOT, poses, **REGION, scene=TABLE)
    plot_base_poses(found, poses, tmp_path / "floor.png", robot=ROBOT, scene=TABLE)
    assert (tmp_path / "floor.png").read_bytes()[:4] == b"\x89PNG"
