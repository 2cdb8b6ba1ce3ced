"""The nearest posture to a pose that cannot be met."""

import itertools

import jax
import numpy as np
import pinocchio as pin
import pytest
from robot_files import HANDS, TWO, write
from robots import FOLDER
from scipy.optimize import least_squares, minimize

import jaxik
from jaxik import Reason, Task
from jaxik.ik.nearest import least_distances
from jaxik.ik.nearest_bounds import box_bound
from jaxik.ik.problem import Poses, Problem
from jaxik.ik.sqp_programs import batch
from jaxik.kinematics.tasks import Tasks
from jaxik.spmd.batch import in_blocks

METRIC = 0.2
FIVE = {  # a file of example-robot-data, and the frame at the tip
    "so100": ("so_arm_description/urdf/so100.urdf", "gripper"),
    "so101": ("so_arm_description/urdf/so101.urdf", "gripper_frame_link"),
    "flying_arm_5": ("hextilt_description/urdf/hextilt_flying_arm_5.urdf", "flying_arm_5__gripper"),
}


class Peer:
    """The arm as Pinocchio has it; joints behind the first five, a jaw, stay at 0."""

    def __init__(self, name):
        file, tip = FIVE[name]
        self.model = pin.buildModelFromUrdf(str(FOLDER / file))
        self.data = self.model.createData()
        self.frame = self.model.getFrameId(tip, pin.FrameType.BODY)
        self.low, self.high = self.model.lowerPositionLimit[:5], self.model.upperPositionLimit[:5]

    def tip(self, q):
        pin.framesForwardKinematics(self.model, self.data, np.append(q, np.zeros(self.model.nq - 5)))
        return self.data.oMf[self.frame].homogeneous

    def residual(self, q, target):
        there = self.tip(q)
        return np.concatenate([there[:3, 3] - target[:3, 3], METRIC * pin.log3(there[:3, :3] @ target[:3, :3].T)])

    def nearest(self, target, starts, seed):
        """The least distance that scipy finds from so many random starts."""
        draws = np.random.default_rng(seed).uniform(self.low, self.high, (starts, 5))
        found = [least_squares(self.residual, q, bounds=(self.low, self.high), args=(target,)).cost for q in draws]
        return np.sqrt(2.0 * min(found))


def arm(name):
    file, tip = FIVE[name]
    return jaxik.load(FOLDER / file, tip=tip, meshes=False) if name == "flying_arm_5" else jaxik.load(name)


def poses(count, reach, seed):
    """Poses around an arm, turned in any way: five joints meet none of them."""
    rng = np.random.default_rng(seed)
    return jaxik.pose(rng.uniform(-reach, reach, (count, 3)), wxyz=rng.normal(size=(count, 4)))


@pytest.mark.parametrize("name", ["so100", "so101"])
def test_five_joints_are_where_pinocchio_has_them(name):
    robot, peer = jaxik.load(name), Peer(name)
    np.testing.assert_array_equal([robot.lower, robot.upper], [peer.low, peer.high])
    np.testing.assert_array_equal([robot.velocity, robot.effort], [peer.model.velocityLimit[:5], peer.model.effortLimit[:5]])
    with jax.enable_x64(True):
        for q in np.random.default_rng(0).uniform(peer.low, peer.high, (20, 5)):
            np.testing.assert_allclose(jaxik.forward_kinematics(robot, q), peer.tip(q), atol=1e-12)


@pytest.mark.parametrize("name", FIVE)
def test_none_is_nearer_by_scipy(name):
    """The nearest of random starts of `least_squares` within bounds, on Pinocchio's kinematics, is no nearer."""
    peer, targets = Peer(name), poses(4, 0.4, seed=1)
    result = jaxik.solve_ik(arm(name), targets, nearest=True, collision=False)
    assert result.counts() == {"nearest": 4} and not result.success.any() and result.num_solutions.sum() == 0
    for i, target in enumerate(targets):
        assert result.distance[i] <= peer.nearest(target, 25, seed=i) + 1e-7
        apart = peer.residual(result.q[i], target)
        np.testing.assert_allclose(result.distance[i], np.linalg.norm(apart), atol=1e-12)
        np.testing.assert_allclose(result.position_error[i], np.linalg.norm(apart[:3]), atol=1e-12)
        np.testing.assert_allclose(METRIC * result.rotation_error[i], np.linalg.norm(apart[3:]), atol=1e-12)
        assert ((result.q[i] >= peer.low) & (result.q[i] <= peer.high)).all()


@pytest.mark.parametrize("name", FIVE)
def test_poses_that_an_arm_has_are_met(name):
    robot = arm(name)
    q = np.random.default_rng(2).uniform(robot.lower, robot.upper, (200, 5))
    with jax.enable_x64(True):
        targets = np.asarray(jax.vmap(lambda q: jaxik.forward_kinematics(robot, q))(q))
    assert jaxik.solve_ik(robot, targets, nearest=True, collision=False).success.all()


def test_no_slope_is_left():
    """The gradient of half the distance squared, by finite differences, leads nowhere inside the limits."""
    peer, targets = Peer("so100"), poses(20, 0.4, seed=3)
    result = jaxik.solve_ik(jaxik.load("so100"), targets, nearest=True)
    for q, target in zip(result.q, targets, strict=True):
        half = lambda q, target=target: 0.5 * np.sum(peer.residual(q, target) ** 2)
        slope = np.array([half(q + e) - half(q - e) for e in 1e-5 * np.eye(5)]) / 2e-5
        assert np.abs(np.clip(q - slope, peer.low, peer.high) - q).max() < 1e-7


def test_what_is_solved_stays_the_same():
    """Targets that have an answer keep it bit for bit, whatever they are with; so do the others."""
    robot = jaxik.load("so101")
    q = np.random.default_rng(4).uniform(robot.lower, robot.upper, (10, 5))
    met = np.asarray(jax.vmap(lambda q: jaxik.forward_kinematics(robot, q))(q), np.float64)
    targets = np.concatenate([met, poses(10, 0.3, seed=5)])
    alone, with_nearest = jaxik.solve_ik(robot, targets), jaxik.solve_ik(robot, targets, nearest=True)
    assert with_nearest.success[:10].all() and np.array_equal(alone.success[:10], with_nearest.success[:10])
    for name in ("q", "position_error", "rotation_error", "seed", "iterations", "solutions", "reason"):
        assert np.array_equal(getattr(alone, name)[:10], getattr(with_nearest, name)[:10]), name
    single = jaxik.solve_ik(robot, targets[13], nearest=True)
    assert np.array_equal(single.q, with_nearest.q[13]) and single.distance == with_nearest.distance[13]


def test_without_it_nothing_is_said_of_distance():
    result = jaxik.solve_ik(jaxik.load("so100"), poses(1, 0.3, seed=6))
    assert np.isnan(result.distance).all() and not result.proven.any() and Reason.NEAREST not in result.reason


def test_position_first():
    """With 0 metres a radian the position is met where it can be, and the rotation is what that leaves: the limit of ever
    fewer metres a radian."""
    robot, targets = jaxik.load("so100"), poses(30, 0.25, seed=7)
    there = jaxik.solve_ik(robot, targets[:, :3, 3], task=Task.position()).success
    first = jaxik.solve_ik(robot, targets, nearest=True, metres_per_radian=0.0)
    assert there.sum() > 5 and first.position_error[there].max() < 1e-6
    np.testing.assert_array_equal(first.distance, first.position_error)
    few = jaxik.solve_ik(robot, targets, nearest=True, metres_per_radian=1e-3)
    np.testing.assert_allclose(first.rotation_error[there], few.rotation_error[there], atol=1e-3)
    assert (first.rotation_error[there] >= few.rotation_error[there] - 1e-6).all()


@pytest.mark.parametrize(
    "task", [Task.pose(("yaw",)), Task.pose(("x", "roll", "pitch")), Task.pose(within={"position": 0.03, "yaw": (-0.3, 0.1)})]
)
def test_free_components_do_not_count(task):
    """For each kind of task, random postures and small moves from the answer are no nearer."""
    robot, targets = jaxik.load("so100"), poses(10, 0.5, seed=8)
    result = jaxik.solve_ik(robot, targets, nearest=True, task=task)
    rng = np.random.default_rng(9)
    others = rng.uniform(robot.lower, robot.upper, (2000, 5))
    for i in np.flatnonzero(result.reason == Reason.NEAREST):
        near = np.clip(result.q[i] + rng.normal(size=(500, 5)) * 1e-3, robot.lower, robot.upper)
        q = np.concatenate([others, near])
        away, turned = jaxik.ik.sqp_programs.solve_errors(robot, task, q, np.broadcast_to(targets[i], (len(q), 4, 4)))
        assert np.hypot(away, METRIC * turned).min() >= result.distance[i] - 1e-9


def test_soft_tasks_are_refused_in_one_line():
    with pytest.raises(ValueError, match="weight= out"):
        jaxik.solve_ik(jaxik.load("so100"), np.eye(4), task=Task.pose(weight=1.0), nearest=True)


def test_who_counts_answers_takes_no_others():
    with pytest.raises(ValueError, match="base_poses: nearest=True is for solve_ik"):
        jaxik.reach.base_poses(jaxik.load("so100"), np.eye(4)[None], x=(0, 1, 2), y=(0, 1, 2), nearest=True)


def test_locked_joints_stay():
    robot = jaxik.load("ur5e")
    result = jaxik.solve_ik(robot, poses(10, 0.6, seed=10), nearest=True, locked={"wrist_3_joint": 0.3}, collision=False)
    assert (result.q[:, 5] == 0.3).all() and result.counts()["nearest"] == 10
    assert "wrist_3_joint" not in " ".join(result.why)


@pytest.mark.parametrize("name", ["planar2", "ur5e"])
def test_what_is_far_off_is_proven(name):
    """A position beyond a stretched arm: the nearest is known, and no nearer is possible."""
    robot = jaxik.load(name)
    result = jaxik.solve_ik(robot, np.array([5.0, 0.5, 0.0]), task=Task.position(), nearest=True, collision=False)
    assert result.reason == Reason.NEAREST and result.proven and "proven to be the nearest" in result.why
    bound = jaxik.kinematics.reach_bound.reach_bound(robot, False)
    np.testing.assert_allclose(result.distance, np.linalg.norm([5.0, 0.5, 0.0] - bound.origin) - bound.longest, atol=1e-6)


def test_the_bound_is_below_every_posture():
    """No posture is nearer than the bound says."""
    robot, targets = jaxik.load("ur5e"), poses(50, 2.0, seed=11)
    result = jaxik.solve_ik(robot, targets, nearest=True, collision=False)
    assert not (result.proven & (result.reason == Reason.NEAREST)).any() or result.distance[result.proven].min() >= 0.0
    options = jaxik.IKOptions(nearest=True)
    problem = Problem.of(robot, None, 0, options, Poses.of(targets, options.task))
    least = least_distances(problem)
    assert (least > 0.1).any() and (least <= result.distance + 1e-9).all()


@pytest.mark.parametrize("name", FIVE)
def test_the_nearest_of_all_is_found_and_proven(name):
    """Boxes of all configurations show that none is nearer; from a single start they lead to the same, and scipy to none
    nearer."""
    robot, peer, targets = arm(name), Peer(name), poses(3, 0.4, seed=19)
    known = jaxik.solve_ik(robot, targets, nearest=True, collision=False)
    result = jaxik.solve_ik(robot, targets, nearest=True, max_seeds=1, proof_boxes=3_000_000, collision=False)
    assert result.proven.all() and not known.proven.any() and "proven to be the nearest" in result.why[0]
    np.testing.assert_allclose(result.distance, known.distance, atol=1e-7)
    assert (result.distance - result.least_distance <= 1e-6).all()
    for i, target in enumerate(targets):
        assert result.least_distance[i] <= peer.nearest(target, 5, seed=i)


@pytest.mark.parametrize("task", [Task.pose(), Task.position(), Task.pointing("x"), Task.pose(("y", "roll", "pitch", "yaw"))])
@pytest.mark.parametrize(("name", "metric"), [("so100", 0.2), ("crops_v2", 0.5), ("ur5e", 0.1)])
def test_no_posture_of_a_box_is_below_its_bound(name, metric, task):
    """Boxes large and small, at random and about postures whose pose is the target: postures in them are as far as JAX says."""
    robot, rng, count = jaxik.load(name), np.random.default_rng(20), 300
    n, tasks = robot.num_joints, Tasks.alone(task)
    draw = lambda k: rng.uniform(np.maximum(robot.lower, -3.0), np.minimum(robot.upper, 3.0), (k, n))
    c, h = draw(count), rng.uniform(0.0, 1.0, (count, n)) * 10.0 ** rng.uniform(-3.0, 0.0, (count, 1))
    near = c + rng.normal(size=(count, n)) * 10.0 ** rng.uniform(-3.0, 0.5, (count, 1))
    with jax.enable_x64(True):
        targets = np.asarray(jax.vmap(lambda q: jaxik.forward_kinematics(robot, q))(near))
        bound, middle, joint = in_blocks(batch(3, box_bound, robot, tasks), c, h, targets, fixed=(metric,), double=True)
        far = jax.jit(jax.vmap(lambda q, pose: distance(robot, task, metric, q, pose)))
        np.testing.assert_allclose(middle, far(c, targets), atol=1e-9)
        for k in range(40):
            share = rng.uniform(-1.0, 1.0, (count, n)) if k % 2 else rng.choice([-1.0, 1.0], (count, n))
            assert (far(c + share * h, targets) >= bound - 1e-9).all()
    assert (bound > 0.5 * middle).mean() > 0.2 and np.ptp(joint) > 0


def distance(robot, task, metric, q, pose):
    """The distance of a posture from a target [m], by JAX on arrays."""
    there = jaxik.forward_kinematics(robot, q)
    turn, away = there[:3, :3] @ pose[:3, :3].T, there[:3, 3] - pose[:3, 3]
    away = away[np.array(task.positions)] if task.axes == "base" else (pose[:3, :3].T @ away)[np.array(task.positions)]
    angle = 0.0
    if len(task.rotations) == 3:
        angle = jax.numpy.linalg.norm(jaxik.spatial.rotation_log(turn))
    elif len(task.rotations) == 2:
        free = next(i for i in range(3) if i not in task.rotations)
        one, other = there[:3, free], pose[:3, free]
        angle = jax.numpy.arctan2(jax.numpy.linalg.norm(jax.numpy.cross(one, other)), one @ other)
    return jax.numpy.sqrt((away**2).sum() + (metric * angle) ** 2)


def test_a_proof_that_is_cut_short_still_bounds():
    robot, targets = jaxik.load("so101"), poses(20, 0.4, seed=21)
    few, more = (jaxik.solve_ik(robot, targets, nearest=True, proof_boxes=boxes) for boxes in (500, 50_000))
    assert not few.proven.any() and (few.least_distance <= more.least_distance).all()
    assert (more.least_distance <= more.distance).all() and (more.least_distance > 0.02).any()


def test_a_proof_of_joints_that_turn_further_and_of_locked_ones():
    """Three joints of a UR5e, whose ranges are two turns wide; the least of a fine grid is no nearer."""
    robot, targets = jaxik.load("ur5e"), poses(5, 1.0, seed=22)
    locked = {name: 0.4 for name in robot.joint_names[3:]}
    result = jaxik.solve_ik(robot, targets, nearest=True, locked=locked, proof_boxes=1_000_000, collision=False)
    assert result.counts() == {"nearest": 5} and result.proven.all()
    turns = np.linspace(-np.pi, np.pi, 40)
    q = np.concatenate([np.stack(np.meshgrid(turns, turns, turns), axis=-1).reshape(-1, 3), np.full((40**3, 3), 0.4)], axis=1)
    with jax.enable_x64(True):
        for i, pose in enumerate(targets):
            far = jax.jit(jax.vmap(lambda q, pose=pose: distance(robot, Task.pose(), METRIC, q, pose)))(q)
            assert result.least_distance[i] <= far.min() < result.least_distance[i] + 0.1


def test_who_proves_asks_for_the_nearest():
    with pytest.raises(ValueError, match="nobody asks for the nearest; add nearest=True"):
        jaxik.solve_ik(jaxik.load("so100"), np.eye(4), proof_boxes=100)


def test_it_says_how_far_and_what_binds():
    robot = jaxik.load("so100")
    result = jaxik.solve_ik(robot, poses(30, 0.4, seed=12), nearest=True)
    for row in result:
        assert row.why.startswith(f"nearest: {1e3 * row.position_error:.4g} mm and ") and "not proven" in row.why
        at = [
            name for name, *each in zip(robot.joint_names, row.q, robot.lower, robot.upper, strict=True) if each[0] in each[1:]
        ]
        assert all(name in row.why for name in at) and ("no limit binds" in row.why) == (not at)
    assert "5 joints have not all of 6 components" in " ".join(result.why)


def test_several_tips(tmp_path):
    """Both hands count."""
    robot = jaxik.load(write(tmp_path, "two.urdf", TWO), tip=HANDS, posture={})
    targets = poses(6, 0.5, seed=13).reshape(3, 2, 4, 4)
    result = jaxik.solve_ik(robot, targets, nearest=True)
    far = result.reason == Reason.NEAREST
    assert far.any()
    errors = np.sqrt((result.position_error**2 + (METRIC * result.rotation_error) ** 2).sum(axis=1))
    np.testing.assert_allclose(result.distance[far], errors[far])


def least_clear(robot, scene, margin, pose, starts):
    """The least distance to a pose that SLSQP finds from some starts, with the clearance as a constraint."""
    low, high = (np.clip(end, -np.pi, np.pi) for end in (robot.lower, robot.upper))
    ends = []
    with jax.enable_x64(True):
        clear = jax.jit(jax.value_and_grad(lambda q: jaxik.clearance(robot, scene, q)))
        cost = jax.jit(jax.value_and_grad(lambda q: half_square(robot, q, pose)))
        for q in starts:
            kept = {"fun": lambda q: float(clear(q)[0]) - margin, "jac": lambda q: np.asarray(clear(q)[1])}
            both = lambda q: tuple(map(np.asarray, cost(q)))
            bounds = list(zip(low, high, strict=True))
            found = minimize(both, q, jac=True, method="SLSQP", bounds=bounds, constraints={"type": "ineq"} | kept)
            if clear(found.x)[0] >= margin - 1e-9:
                ends.append(np.sqrt(2.0 * found.fun))
    return min(ends)


def test_among_obstacles_it_is_clear_and_the_best_that_scipy_finds():
    """Postures clear of a scene, no further than what SLSQP finds from random starts with the clearance as a constraint."""
    robot, margin = jaxik.load("pendulum4"), 0.01
    reach = jaxik.kinematics.reach_bound.reach_bound(robot, False).length
    with jax.enable_x64(True):
        tip = np.asarray(jaxik.forward_kinematics(robot, np.array([0.4, 0.3, 0.2, 0.1])))
        scene = jaxik.make_scene(spheres=[[*(tip[:3, 3] * 0.9), 0.2 * reach]])
    rng = np.random.default_rng(14)
    targets = np.repeat(tip[None], 4, axis=0)
    targets[:, :3, 3] *= rng.uniform(0.7, 1.1, (4, 1))
    blind = jaxik.solve_ik(robot, targets, nearest=True, collision=False)
    result = jaxik.solve_ik(robot, targets, scene=scene, margin=margin, nearest=True)
    assert result.counts() == {"nearest": 4} and (result.clearance >= margin).all()
    assert (result.distance > blind.distance + 1e-3).all() and not result.proven.any()
    for far, pose in zip(result.distance, targets, strict=True):
        assert far <= least_clear(robot, scene, margin, pose, rng.uniform(-np.pi, np.pi, (12, 4))) + 1e-4


def test_many_ways_lead_around_obstacles():
    """An arm of six joints among balls over a floor, where the way from the nearest posture of all ends too early."""
    robot, margin, rng = jaxik.load("ur5e"), 0.01, np.random.default_rng(5)
    balls = [[0.5, 0.0, 0.4, 0.2], [-0.3, 0.4, 0.5, 0.2], [0.0, -0.5, 0.3, 0.15]]
    scene = jaxik.make_scene(spheres=balls, boxes=[[0.0, 0.0, -0.15, 2.0, 2.0, 0.2]])
    places = rng.uniform([-1.2, -1.2, -0.1], [1.2, 1.2, 1.2], (40, 3))
    targets = jaxik.pose(places, wxyz=rng.normal(size=(40, 4)))[[1, 7]]
    result = jaxik.solve_ik(robot, targets, scene=scene, margin=margin, nearest=True)
    assert result.counts() == {"nearest": 2} and (result.clearance >= margin).all()
    for far, pose in zip(result.distance, targets, strict=True):
        assert far <= least_clear(robot, scene, margin, pose, rng.uniform(-np.pi, np.pi, (6, 6))) + 1e-4


def half_square(robot, q, pose):
    """Half the distance squared, by JAX."""
    there = jaxik.forward_kinematics(robot, q)
    turn = METRIC * jaxik.spatial.rotation_log(there[:3, :3] @ pose[:3, :3].T)
    return 0.5 * (((there[:3, 3] - pose[:3, 3]) ** 2).sum() + (turn**2).sum())


def test_where_every_posture_collides_the_reason_stays():
    robot = jaxik.load("pendulum4")
    scene = jaxik.make_scene(spheres=[[0.0, 0.0, 0.0, 100.0]])
    result = jaxik.solve_ik(robot, poses(2, 0.5, seed=15), scene=scene, nearest=True)
    assert Reason.NEAREST not in result.reason and not result.success.any()


@pytest.mark.parametrize("change", [{"metres_per_radian": -1.0}, {"metres_per_radian": np.nan}, {"nearest": "yes"}])
def test_options_are_checked(change):
    with pytest.raises(ValueError, match=next(iter(change))):
        jaxik.solve_ik(jaxik.load("so100"), np.eye(4), **{"nearest": True} | change)


def test_what_is_no_pose_stays_invalid():
    targets = poses(3, 0.3, seed=16)
    targets[1, 0, 0] = np.nan
    result = jaxik.solve_ik(jaxik.load("so100"), targets, nearest=True)
    assert result.reason.tolist() == [Reason.NEAREST, Reason.INVALID, Reason.NEAREST] and np.isnan(result.q[1]).all()


def test_wide_ranges_and_ties():
    """A turn by 2 pi is as near, and the one nearest to the middle is taken; batches of any order agree."""
    robot, targets = jaxik.load("ur5e"), poses(12, 1.5, seed=17)
    result = jaxik.solve_ik(robot, targets, nearest=True)
    far = result.reason == Reason.NEAREST
    assert far.any() and (np.abs(result.q[far]) <= np.pi + 1e-9).all()
    for some in itertools.islice(np.array_split(np.random.default_rng(18).permutation(12), 4), 2):
        assert np.array_equal(jaxik.solve_ik(robot, targets[some], nearest=True).q, result.q[some], equal_nan=True)
