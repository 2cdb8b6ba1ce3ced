"""Bodies and friction from logs, against arms whose numbers are known."""

import dataclasses

import coal
import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxik
from jaxik.dynamics import Body, Drive, Friction, friction_torque, inverse_dynamics
from jaxik.identification import ExciteOptions, base_parameters, excite, identify
from jaxik.identification.excitation import ClearSpace, _Search
from jaxik.identification.least_squares import Bodies, pseudo_inertias
from jaxik.identification.regression import Curve, body_columns, joined, posed, side_by_side
from jaxik.kinematics import Motion, smooth
from jaxik.reasons import Reason

ARM = jaxik.load("crops_v2").part(0, 3)  # a slide, a vertical and a horizontal axis, with drives
TERMS = ("coulomb", "viscous", "breakaway", "load", "asymmetry")
torques = jax.jit(jax.vmap(inverse_dynamics, (None, 0, 0, 0)))
rubbed = jax.jit(jax.vmap(friction_torque, (None, 0, 0)))


def another(seed=0):
    """The arm as it may have been built."""
    rng = np.random.default_rng(seed)
    change = lambda b: (
        np.asarray(b.mass * rng.uniform(0.8, 1.25)),
        b.com + rng.normal(0, 0.01, 3),
        b.inertia * rng.uniform(0.8, 1.25),
    )
    return dataclasses.replace(ARM, bodies=tuple(Body(*change(body)) for body in ARM.bodies))


@pytest.fixture(scope="module")
def excitation():
    return excite(ARM, collision=False, terms=TERMS, velocity=2.0, period=20.0, steps=10)


@pytest.fixture(scope="module")
def motion(excitation):
    found = excitation.at(np.arange(0.0, 20.0, 0.05))
    return found.q, found.velocity, found.acceleration


def test_base_parameters_by_name():
    base = base_parameters(ARM)
    assert base.words[:3] == ("m(joint1) + m(joint2) + m(joint3)", "Izz(joint2) + Iyy(joint3)", "mx(joint3)")
    assert len(base) == 9 and "Izz(joint1)" in base.unseen and "mz(joint3)" in base.unseen
    planar = base_parameters(jaxik.load("planar2"), terms=("coulomb", "armature"))
    # links of 1 m in a plane across gravity, and a rotor that cannot be told from what it turns
    assert planar.words[:4] == ("Izz(q1) + m(q2) + armature(q1)", "mx(q2)", "my(q2)", "Izz(q2)")
    assert planar.words[4:] == ("coulomb(q1)", "coulomb(q2)", "armature(q2)")


def test_base_parameters_are_all_that_counts():
    rng, base = np.random.default_rng(3), base_parameters(ARM)
    columns, theta = body_columns(ARM, *rng.normal(size=(3, 7, 3))), rng.normal(size=30)
    np.testing.assert_allclose(columns[:, :, base.kept] @ (base.matrix @ theta), columns @ theta, rtol=1e-9, atol=1e-9)


def test_bodies_that_can_be():
    """All coordinates, and no others: positive mass, inertia definite and within the triangle inequality."""
    theta = np.asarray(ARM.parameters)
    pseudo = pseudo_inertias(theta)
    for body, p in zip(ARM.bodies, pseudo, strict=True):
        second = body.inertia + body.mass * (body.com @ body.com * np.eye(3) - np.outer(body.com, body.com))
        np.testing.assert_allclose(p[:3, :3], 0.5 * np.trace(second) * np.eye(3) - second, atol=1e-12)
        np.testing.assert_allclose(p[3], [*(body.mass * body.com), body.mass], atol=1e-14)
    around, x = Bodies(theta), np.random.default_rng(0).normal(size=(3, 10))
    np.testing.assert_allclose(around.at(np.zeros((3, 10)))[0].ravel(), theta, atol=1e-12)
    found, slope = around.at(x)
    for i in range(10):
        step = 1e-6 * np.eye(10)[i]
        numeric = (around.at(x + step)[0] - around.at(x - step)[0]) / 2e-6
        np.testing.assert_allclose(slope[:, :, i], numeric, rtol=1e-6, atol=1e-6 * np.abs(numeric).max())
    for row in found:
        mass, com = row[0], row[1:4] / row[0]
        tensor = row[np.array([[4, 5, 7], [5, 6, 8], [7, 8, 9]])] - mass * (com @ com * np.eye(3) - np.outer(com, com))
        moments = np.linalg.eigvalsh(tensor)
        assert mass > 0.0 and moments[0] > 0.0 and moments[0] + moments[1] > moments[2]
    heavy = theta.copy()
    heavy[6] = heavy[4] + heavy[9] + 1.0  # one moment beyond the sum of the others
    assert np.linalg.eigvalsh(pseudo_inertias(heavy))[0, 0] < 0.0


def test_excitation_keeps_the_limits(excitation):
    moved = excitation.at(np.linspace(0.0, 20.0, 5001))
    q, qdot, qddot = moved.q, moved.velocity, moved.acceleration
    assert repr(excitation).startswith(f"ExciteResult: solved; condition number {excitation.condition:.0f}, errors")
    np.testing.assert_allclose(excitation.motion.q, excitation.at(excitation.motion.time).q, rtol=1e-12)
    lower, upper = ARM.finite_limits
    assert np.all((q > lower) & (q < upper)) and np.abs(qdot).max() <= 2.001 and np.abs(qddot).max() <= 4.001
    assert excitation.gain > 1.0 and excitation.condition < 500.0
    np.testing.assert_allclose(np.gradient(q, 0.004, axis=0)[1:-1], qdot[1:-1], atol=1e-3)
    np.testing.assert_allclose(np.gradient(qdot, 0.004, axis=0)[1:-1], qddot[1:-1], atol=1e-3)


WALL = jaxik.make_scene(spheres=[[-0.3, 0.85, 1.1, 0.15]])  # within reach


def test_the_search_knows_its_slope():
    """The slope by coefficients and by shares is that of differences, nearness to the scene and to itself included."""
    space = ClearSpace(ARM, WALL, 0.02)
    search = _Search(ARM, space, np.array([0.5, 0.6, -0.4]), ExciteOptions(samples=40))
    x = np.vstack([np.random.default_rng(0).normal(size=(10, 3)), [[0.9, 0.7, 0.8]]]).ravel()
    _, slope = search(x)
    near = search.scaled(search.series, x.reshape(11, 3)[:-1])[0] * x[-3:]
    assert space.nearness(search.middle + near[0])[0] > 1.0
    for i in (0, 13, 29, 30, 31, 32):
        step = 1e-5 * np.eye(33)[i]
        numeric = (search(x + step)[0] - search(x - step)[0]) / 2e-5
        assert abs(slope[i] - numeric) <= 1e-3 * np.abs(slope).max()


def test_excitation_keeps_clear():
    """The motion keeps clear of a sphere and of itself, by coal's distances of the robot's volumes."""
    found = excite(ARM, scene=WALL, margin=0.02, velocity=2.0, starts=5, steps=10, samples=50)
    bold = excite(ARM, collision=False, velocity=2.0, starts=5, steps=10, samples=50)
    distances = [min(coals(q) for q in motion.at(np.linspace(0.0, 10.0, 101)).q) for motion in (found, bold)]
    assert distances[0] >= 0.02 - 1e-5 and distances[1] < 0.0
    assert found.condition < 100.0


def coals(q):
    """The least of coal's distances of the robot's capsules, one a link, to the sphere and to each other at q (n,)."""
    frames = np.asarray(jaxik.kinematics.link_frames(ARM, q))
    sphere = coal.Sphere(float(WALL.spheres.radius[0])), coal.Transform3s(np.eye(3), np.asarray(WALL.spheres.center[0]))
    capsules = []
    for frame, volume in zip(frames, ARM.volumes, strict=True):
        a, b = volume.corners @ frame[:3, :3].T + frame[:3, 3]
        turn = Rotation.align_vectors([b - a], [[0.0, 0.0, 1.0]])[0].as_matrix()
        shape = coal.Capsule(float(volume.radius), float(np.linalg.norm(b - a)))
        capsules.append((shape, coal.Transform3s(turn, 0.5 * (a + b))))
    pairs = [*((each, sphere) for each in capsules), *((capsules[a], capsules[b]) for a, b in ARM.self_pairs)]
    return min(coal.distance(*a, *b, coal.DistanceRequest(), coal.DistanceResult()) for a, b in pairs)


def test_identification_from_noisy_logs(motion):
    """A number told to within 1 % is right to within 1 % (three standard errors), the rest is named, and all bodies can be."""
    true, rng = another(), np.random.default_rng(1)
    torque = np.asarray(torques(true, *motion))
    gain = np.array([float(d.ratio * d.torque_constant) for d in true.drives])
    springs = np.array([float(d.spring_force) for d in true.drives])
    motors = torque - rubbed(true, motion[1], torque) - springs
    motors += rng.normal(size=motors.shape) * 0.003 * motors.std(axis=0)
    half = len(motors) // 2
    logs = [
        Motion(*(x[:half] for x in motion), torque=motors[:half]),
        Motion(*(x[half:] for x in motion), current=motors[half:] / gain),
    ]
    told = []
    found = identify(ARM, logs, progress=lambda *each: told.append(each), terms=TERMS)
    assert told[0] == (0, 21) and told[-1] == (21, 21) and told == sorted(told)
    assert found.reason == Reason.SOLVED and found.success
    truth = found.base.matrix[:, :30] @ np.asarray(true.parameters)
    bodies = slice(0, 9)
    off, told = np.abs(found.value - truth)[bodies], (found.std <= 0.01 * np.abs(found.value))[bodies]
    assert (
        told.sum() >= 4 and np.all(off[told] <= 0.03 * np.abs(truth[bodies][told])) and np.all(off <= 4.0 * found.std[bodies])
    )
    assert set(found.unknown()) == {
        w for w, s, v in zip(found.base.words, found.std, found.value, strict=True) if s > 0.01 * abs(v)
    }
    assert np.linalg.eigvalsh(pseudo_inertias(np.asarray(found.robot.parameters))).min() > 0.0
    first, second = found.robot.drives[1].friction, found.robot.drives[2].friction
    assert abs(first.breakaway - (8.4 + 1.125)) <= 0.1 and abs(second.breakaway - (12.8 + 7.0)) <= 0.2  # tables 3.4 and 3.6
    assert abs(second.stribeck_velocity - 81.7 / 100) <= 0.05 and abs(first.load - 50 * 2.1e-3) <= 0.02
    lines = repr(found).splitlines()
    assert lines[0].startswith("IdentifyResult of crops_v2: solved; condition number ") and "joint3 0." in lines[-1]
    assert lines[1].split() == [*found.base.words[0].split(), f"{found.value[0]:.5g}", "+-", f"{found.std[0]:.2g}"]
    again = np.asarray(torques(found.robot, *motion))
    assert np.all(np.sqrt(np.mean((again - torque) ** 2, axis=0)) <= 0.01 * torque.std(axis=0))


def test_torque_without_friction_is_exact(motion):
    """Sensors behind the gears, and no noise; the robot's own numbers stay where nothing is told."""
    true = another().with_drives(())
    motion = [x[::2] for x in motion]
    found = identify(ARM.with_drives(()), Motion(*motion, torque=np.asarray(torques(true, *motion))), terms=())
    truth = found.base.matrix @ np.asarray(true.parameters)
    np.testing.assert_allclose(found.value, truth, rtol=1e-8, atol=1e-8)
    assert not found.unknown() and not found.robot.drives
    np.testing.assert_allclose(found.base.matrix @ np.asarray(found.robot.parameters), truth, rtol=1e-3, atol=1e-3)


def test_the_drives_found_rub_as_was_measured(motion):
    """A motor without a gear turns slowly, so that what is uneven grows with its speed: `friction_torque` says how."""
    uneven = Friction(coulomb=0.6, viscous=0.4, correction=(-0.3, 0.3), side="joint")
    true = ARM.with_drives([Drive(friction=uneven), Drive(friction=uneven), Drive(ratio=2.0, friction=uneven)])
    torque = np.asarray(torques(true, *motion))
    rub = np.asarray(rubbed(true, motion[1], torque))
    found = identify(true, Motion(*motion, torque=torque - rub), terms=("coulomb", "viscous", "asymmetry"))
    assert found.reason == Reason.SOLVED
    np.testing.assert_allclose(rubbed(found.robot, motion[1], torque), rub, atol=2e-3)


def test_rows_that_are_turned_say_the_same(motion):
    """Scalar products of all columns, joint by joint, are those of the rows as they were measured."""
    rng = np.random.default_rng(0)
    log = Motion(*motion, torque=rng.normal(size=motion[0].shape))
    problem = posed(ARM, log, TERMS, 0.05)
    curve = Curve(rng.normal(size=motion[0].shape), np.full(3, 0.3))
    columns, bend, torque, joint = problem.rows(curve)
    slope = (problem.friction(curve._replace(stribeck=0.3 * np.exp([1e-6] * 3))) - problem.friction(curve)) / 1e-6
    whole = side_by_side(problem.bodies, problem.friction(curve))
    for j, counts in enumerate(problem.counts.T):
        left = (problem.torque - problem.rotor)[counts, j]
        measured = np.column_stack([whole[counts, j], slope[TERMS.index("breakaway"), counts, j], left])
        turned = np.column_stack([columns, bend[:, j], torque])[joint == j]
        assert len(turned) <= 30 + len(TERMS) + 2 < len(measured)
        np.testing.assert_allclose(turned.T @ turned, measured.T @ measured, atol=1e-5 * np.abs(measured.T @ measured).max())


@pytest.mark.parametrize("share, reason", [(1.0, Reason.SOLVED), (-1.0, Reason.NOT_CONVERGED)])
def test_a_file_without_masses(motion, share, reason):
    """Bodies are found from none; torques of negative masses are no bodies', and the reason says so."""
    motion = [x[::2] for x in motion]
    torque = share * np.asarray(torques(dataclasses.replace(another(), drives=(), armature=np.zeros(3)), *motion))
    torque += np.random.default_rng(0).normal(size=torque.shape) * 0.003 * torque.std(axis=0)
    bare = dataclasses.replace(ARM.with_parameters(np.zeros(30)), drives=(), armature=np.zeros(3))
    found = identify(bare, Motion(*motion, torque=torque), terms=())
    assert found.reason == reason
    explained = np.all(np.abs(np.asarray(torques(found.robot, *motion)) - torque) <= 0.03 * torque.std(axis=0))
    assert explained == (reason == Reason.SOLVED)


def test_a_poor_log_is_told(motion):
    """With the third joint at rest some combinations cannot be known; they are named, and the reason says so."""
    still = [x[::2].copy() for x in motion]
    for x in still:
        x[:, 2] = 0.4 if x is still[0] else 0.0
    found = identify(ARM, Motion(*still, torque=np.asarray(torques(ARM, *still))), terms=())
    assert found.reason == Reason.UNEXCITED and found.why.startswith("unexcited; move more joints") and not found
    assert "Izz(joint3)" in found.unknown() and np.isinf(found.std).any() and found.condition > 1e6


FAULTS = [
    (dict(terms=("coulomb",)), r"joint1 is never faster than slowest=0.05"),
    (dict(terms=("stiction",)), "identify: terms 'stiction'; allowed: coulomb"),
    (dict(q=np.zeros((4, 2))), r"log 1: q of shape \(4, 2\); allowed: \(k, 3\)"),
    (dict(torque=np.full((4, 3), np.nan)), "log 1: torque holds nan in row 0, joint1"),
    (dict(q=np.full((4, 3), 20.0) * [0, 0, 1]), r"log 1: joint3 is 20 in row 0, .* \[rad\]; are these degrees\? If not, give"),
    (dict(torque=None), "log 1 has no torque and current; give one of them"),
    (dict(velocity=None), "log 1: velocity: NoneType that is no array of numbers"),
    (dict(q=0.0), r"log 1: q of shape \(\); allowed: \(k, 3\)"),
    (dict(terms="load"), "identify: terms is load; write a tuple of coulomb, breakaway"),
    (dict(terms=("load", "load")), "identify: terms has load 2 times; write it once"),
    (dict(logs=None), "log 1 is a NoneType; write a jaxik.kinematics.Motion"),
    (dict(robot=ARM.with_parameters(np.full(30, np.nan))), "identify: a body of crops_v2 holds NaN or infinity"),
    (dict(prior=0.0), "prior is 0.0; it is a finite number of at least 1e-06"),
    (dict(terms=()), "12 values for 9 unknowns; log a longer motion"),
]


@pytest.mark.usefixtures("untyped")
@pytest.mark.parametrize("change, line", FAULTS, ids=[str(i) for i in range(len(FAULTS))])
def test_faults_in_one_line(change, line):
    rows = {name: np.zeros((4, 3)) for name in ("q", "velocity", "acceleration", "torque")}
    rows |= {name: change[name] for name in rows if name in change}
    with pytest.raises(ValueError, match=line) as caught:
        given = {"robot": ARM, "logs": Motion(**rows)} | {name: x for name, x in change.items() if name not in rows}
        identify(**given)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "change, line",
    [
        (dict(samples=10), "excite: 10 samples of 5 harmonics; allowed: at least 4 for each"),
        (dict(share=1.5), "excite: share is 1.5; allowed: a finite number .*at most 1"),
        (dict(period=0.0), "excite: period is 0.0; allowed: a finite number above 0"),
        (dict(margin=0.3), "excite: margin=0.3, the middle has a clearance of .* m; give a posture as middle"),
        (dict(middle=[0.5, 3.0, 0.0]), "excite: the middle of joint2 is not within share=0.9 of its limits"),
        (
            dict(robot=dataclasses.replace(ARM, volumes=(), self_pairs=())),
            "no collision geometry; .*; or write collision=False",
        ),
        (dict(speed=1.0), "excite: unknown option 'speed'"),
        (dict(robot=dataclasses.replace(ARM, upper=ARM.lower)), "excite: joint1 cannot move: 0 to 0, velocity inf"),
    ],
)
def test_faults_of_excitations(change, line):
    with pytest.raises(ValueError, match=line):
        excite(**({"robot": ARM} | change))


SIX = jaxik.load("crops_v2").part(1, 7)  # six joints of many sizes


@pytest.fixture(scope="module")
def six():
    """Another arm of its kind, and 20 s of its motion at 100 Hz: times, joints and torques."""
    rng, time = np.random.default_rng(5), np.arange(0.0, 20.0, 0.01)
    low, high = np.maximum(SIX.lower, -1.5), np.minimum(SIX.upper, 1.5)
    hertz, phase = rng.uniform(0.1, 0.7, (4, 1, 6)), rng.uniform(0.0, 6.0, (4, 1, 6))
    w = 2.0 * np.pi * hertz
    wave = [
        np.mean(f, axis=0) * (high - low) / 2.0
        for f in (
            np.sin(w * time[:, None] + phase),
            w * np.cos(w * time[:, None] + phase),
            -(w**2) * np.sin(w * time[:, None] + phase),
        )
    ]
    wave[0] = wave[0] + (low + high) / 2.0
    heavier = dataclasses.replace(
        SIX, drives=(), bodies=tuple(Body(np.asarray(1.2 * b.mass), b.com + 0.01, 1.2 * b.inertia) for b in SIX.bodies)
    )
    return time, wave, np.asarray(torques(heavier, *wave)), heavier


def test_filtered_noise_is_counted_once(six):
    """Standard errors are those of the errors, of logs as they are and of those that a low pass has been over."""
    time, wave, torque, heavier = six
    base, known = base_parameters(SIX), dataclasses.replace(SIX, drives=())
    true, rng = base.matrix[:, : 10 * 6] @ np.asarray(heavier.parameters), np.random.default_rng(8)
    for filtered in (False, True):
        off = []
        for _ in range(4):
            noisy = torque + 0.1 * torque.std(axis=0) * rng.normal(size=torque.shape)
            noisy = smooth(Motion(wave[0], time=time, torque=noisy), cutoff=8.0).torque if filtered else noisy
            found = identify(known, Motion(*wave, torque=noisy), terms=())
            assert found.reason == Reason.SOLVED
            off.append((found.value - true) / found.std)
        assert 0.6 < np.sqrt(np.mean(np.square(off))) < 1.5 and np.mean(np.abs(off) < 2.0) > 0.85


STRANGE = {
    "the order of another program": lambda t, rng: t[:, [2, 1, 0, 3, 4, 5]],
    "backward": lambda t, rng: t[:, ::-1],
    "rows shuffled": lambda t, rng: rng.permutation(t),
    "pure noise": lambda t, rng: rng.normal(size=t.shape) * t.std(axis=0),
    "Nmm": lambda t, rng: 1000.0 * t,
}


@pytest.mark.parametrize("name", STRANGE)
def test_a_log_that_nothing_explains_says_so(name, six):
    _, wave, torque, _ = six
    rng = np.random.default_rng(2)
    known, noisy = dataclasses.replace(SIX, drives=()), torque + rng.normal(0.0, 0.1, torque.shape)
    assert identify(known, Motion(*wave, torque=noisy), terms=()).reason == Reason.SOLVED
    found = identify(known, Motion(*wave, torque=STRANGE[name](noisy, rng)), terms=())
    assert found.reason == Reason.UNEXPLAINED and "unexplained" in repr(found)


@pytest.mark.parametrize("cutoff", [None, 8.0, 3.0])
def test_a_joint_that_drowns_in_noise_is_not_strange(cutoff, six):
    """A last joint has little to carry: its sensor's noise is most of what it shows, and the log is right all the same."""
    time, wave, torque, _ = six
    noisy = torque + 3.0 * torque[:, -1].std() * np.random.default_rng(4).normal(size=torque.shape)
    noisy = smooth(Motion(wave[0], time=time, torque=noisy), cutoff=cutoff).torque if cutoff else noisy
    known = dataclasses.replace(SIX, drives=())
    found = identify(known, Motion(*wave, torque=noisy), terms=())
    assert found.reason == Reason.SOLVED
    assert found.residual[-1] > (0.4 if cutoff else 0.9) * np.sqrt(np.mean(noisy[:, -1] ** 2))
    exchanged = noisy[:, [0, 2, 1, 3, 4, 5]]
    assert identify(known, Motion(*wave, torque=exchanged), terms=()).reason == Reason.UNEXPLAINED


@pytest.mark.parametrize("dead", [slice(0, 6), slice(2, 3)])
def test_a_dead_channel_is_named(dead, six):
    _, wave, torque, _ = six
    silent = torque.copy()
    silent[:, dead] = 0.0
    with pytest.raises(ValueError, match=f"the torque of {SIX.joint_names[dead.start]} is 0 in all rows; a dead channel"):
        identify(SIX, Motion(*wave, torque=silent), terms=())
    sprung = SIX.with_drives([Drive(spring_force=5.0)] * len(SIX.joint_names))  # what springs give is no measurement
    with pytest.raises(ValueError, match="a dead channel tells nothing"):
        identify(sprung, Motion(*wave, torque=silent), terms=())


def test_a_log_says_the_order_of_its_joints():
    robot, rng = jaxik.load("planar2"), np.random.default_rng(5)
    q, velocity, acceleration, torque = rng.normal(size=(4, 40, 2))
    turned = Motion(q[:, ::-1], velocity[:, ::-1], acceleration[:, ::-1], torque=torque[:, ::-1], joint_names=("q2", "q1"))
    straight = Motion(q, velocity, acceleration, torque=torque)
    for one, other in zip(joined(robot, turned), joined(robot, straight), strict=True):
        np.testing.assert_array_equal(one, other)
    with pytest.raises(ValueError, match="identify: log 1: joints a, b; allowed: q1, q2, in any order, or no joint_names"):
        joined(robot, dataclasses.replace(straight, joint_names=("a", "b")))
