"""A small plant: MuJoCo moves the arm, made of the robot's own numbers, and shows what a robot's sensors would.

    M(q) qddot + h(q, qdot) = N k current + spring + friction + J'f                                     (3.11)

The bodies, joints and rotors are MuJoCo's, so that the arm that is simulated shares no line with the dynamics that estimators
use. Friction is MuJoCo's dry friction, which sticks, with the size that the drive's law gives at each step, none where a law
would drive the joint. The gears' torsion is read off what they carry; they do not swing. A controller asks for a current: what
a model of the arm says of the trajectory, and proportional and derivative feedback of the joints.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxik.checks.arrays import numbers
from jaxik.checks.options import check_finite, check_kind, check_seed, no_such, optional, shown
from jaxik.dynamics.actuation import friction_torque, motor_current
from jaxik.dynamics.recursions import GRAVITY, inverse_dynamics, mass_matrix
from jaxik.kinematics.drive import numbers_of
from jaxik.kinematics.motion import Motion
from jaxik.kinematics.robot import Robot, need_drives, need_serial
from jaxik.options import Options, anything, count, number
from jaxik.planning import Trajectory
from jaxik.planning.trajectory import check_joints
from jaxik.pytree import Pytree
from jaxik.spatial.rotations import to_wxyz
from jaxik.spmd import HostKernel

TOLD = 1024  # samples between two calls of `progress`
# of PlayOptions, one number or one a joint
SENSED = "current_noise", "current_step", "torsion_noise", "torsion_step", "torsion_play", "position_step"
CREEP = 1e-5  # [rad/s, m/s]: slower is at rest, where friction is what the law tends to


class Push(NamedTuple):
    """A force on a link, at a `point` (3,) [m] of its frame, from `start` to `end` [s]: (3,) [N] in base axes, or a function of
    the time and of where the point is (3,) [m] in the base frame, which gives it."""

    link: str
    point: Any
    force: Any
    start: float = 0.0
    end: float = np.inf


class PlayOptions(Options, who="play"):
    """How an arm is played. Noise is white, told by its standard deviation; noise, steps and play are one number, or one a
    joint. Controllers of drives have their own sensors, perfect ones."""

    dt: float = number(default=1e-3, unit="s", least=1e-6, words="between samples")
    rest: tuple[float, float] = anything(default=(0.0, 0.0), unit="s", words="standing still before and after each motion")
    frequency: float = number(
        default=60.0,
        unit="rad/s",
        least=1e-9,
        words="of each joint's error under its controller, with the inertia that the model has where the motion begins",
    )
    damping: float = number(default=0.7, least=0.0, words="of that error")
    current_noise: Any = anything(default=0.0, unit="A", words="of the currents that are shown")
    current_step: Any = anything(default=0.0, unit="A", words="to which these are rounded")
    torsion_noise: Any = anything(default=0.0, unit="rad", words="of the gears' torsions that are shown")
    torsion_step: Any = anything(default=0.0, unit="rad", words="to which these are rounded")
    torsion_play: Any = anything(default=0.0, unit="rad", words="half the width of the gears' hysteresis")
    position_step: Any = anything(default=0.0, unit="rad, m", words="to which joint values are rounded")
    window: int = count(default=1, words="samples over which rates are differences")

    def check(self) -> None:
        rest = numbers("play: rest", self.rest, (2,))
        check_finite("play", 0.0, **{"rest before": rest[0], "rest after": rest[1]})
        for name in SENSED:
            values = numbers(f"play: {name}", getattr(self, name))
            if not np.all(values >= 0.0) or not np.isfinite(values).all():
                raise ValueError(f"play: {name} is {shown(getattr(self, name))}; allowed: finite numbers of at least 0")

    def check_instruments(self, count: int) -> None:
        """Raises `ValueError` for instruments of another number of joints."""
        for name in SENSED:
            if (shape := np.shape(getattr(self, name))) not in ((), (count,)):
                raise ValueError(f"play: {name} has the shape {shape}; allowed: (), ({count},)")


class Played(Pytree):
    """A log twice: with the motion that was `asked` for, its q, velocity and acceleration, as the thesis has it for
    `TorqueEstimator`; and with the q and velocity that were `measured`, the acceleration still the asked one, since nothing
    measures it. Both have time (k,) [s], and (k, n): the measured `current` [A] and `torsion` [rad], and the truth,
    `external`, what pushes do to the joints, J'f, and `torque`, what the drives do behind their friction [Nm, N]."""

    asked: Motion
    measured: Motion


def mujoco_model(robot: Robot, dt: float = 1e-3, gravity: Any = GRAVITY) -> Any:
    """Compiles the robot as a `mujoco.MjModel`, a body a joint, without shapes, limits and friction. Host.

    Raises `ValueError` for a robot without bodies, and one that names the extra where MuJoCo is not installed.
    """
    mujoco = optional("plant: a simulation", "mujoco", "mjcf")
    need_serial("plant", robot)
    if len(robot.bodies) != robot.num_joints:
        raise ValueError(f"plant: {robot.name} has masses for {len(robot.bodies)} of {robot.num_joints} joints; give all")
    spec = mujoco.MjSpec()
    spec.option.timestep, spec.option.gravity = dt, gravity
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    kinds = mujoco.mjtJoint
    at = lambda frame: {"pos": frame[:3, 3], "quat": to_wxyz(frame[:3, :3])}
    parent = spec.worldbody.add_body(name="base", **at(np.asarray(robot.world_T_base)))
    armature = np.broadcast_to(robot.armature, robot.num_joints)
    for i, (name, slides, body) in enumerate(zip(robot.joint_names, robot.is_prismatic, robot.bodies, strict=True)):
        tensor = np.asarray(body.inertia)
        inertial = {"mass": float(body.mass), "ipos": body.com, "fullinertia": tensor[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]}
        parent = parent.add_body(name=f"body{i}", explicitinertial=True, **at(np.asarray(robot.parent_T_joint[i])), **inertial)
        kind = kinds.mjJNT_SLIDE if slides else kinds.mjJNT_HINGE
        # friction is stiff, or what sticks would creep
        stiff = {"solref_friction": [2.0 * dt, 1.0], "solimp_friction": [0.99, 0.999, 0.001, 0.5, 2.0]}
        parent.add_joint(name=f"{i}/{name}", type=kind, axis=robot.axis[i], armature=float(armature[i]), **stiff)
    try:
        return spec.compile()
    except ValueError as error:
        raise ValueError(f"plant: MuJoCo refuses {robot.name} ({' '.join(str(error).split())})") from None


def play(
    robot: Robot,
    motions: Trajectory | Sequence[Trajectory],
    *,
    pushes: Sequence[Push] = (),
    model: Robot | None = None,
    seed: int = 0,
    options: PlayOptions | None = None,
    progress: Callable[[int, int], None] | None = None,
    **changes: Any,
) -> Played:
    """Plays a motion, or several in a row, on a simulated arm, `robot` with its drives, and logs it. Host driver.

    The controllers know the arm as `model`, by default as it is. `changes` are fields of the options; `progress` is told how
    many samples are done, of how many. Raises `ValueError` for a robot without bodies, for a push on a link that it does not
    have, for numbers out of range, for an arm that flies apart, and one that names the extra where MuJoCo is not installed.
    """
    mujoco = optional("play: a simulation", "mujoco", "mjcf")
    model = robot if model is None else model
    options = PlayOptions.chosen(options, changes)
    check_seed("play", seed)
    for name, arm in (("robot", robot), ("model", model)):
        check_kind("play", name, arm, Robot)
    arm, on_bodies = mujoco_model(robot, options.dt), [_on_body(robot, push) for push in pushes]
    for each in (robot, model):
        need_drives("play", each)
    motions = [motions] if isinstance(motions, Trajectory) else list(motions)
    if not motions:
        raise ValueError("play: no motion; give a Trajectory, or several in a row")
    options.check_instruments(robot.num_joints)
    for motion in motions:
        check_kind("play", "motion", motion, Trajectory)
        check_joints("play", motion, robot.joint_names)
    asked = _with_rests(motions, options)
    controller = _controller(model, asked, options)
    q, velocity, current, external, torque, gear = _simulated(mujoco, arm, robot, controller, on_bodies, asked, progress)
    torsion = gear / numbers_of(robot.drives, lambda d: d.stiffness)
    q, velocity, current, torsion = _measured(options, seed, q, current, torsion)
    both = {"time": asked.time, "current": current, "torsion": torsion, "torque": torque, "external": external}
    return Played(Motion(*asked.state, **both), Motion(q, velocity, asked.acceleration, **both))


def _simulated(
    mujoco: Any,
    arm: Any,
    robot: Robot,
    controller: tuple[np.ndarray, np.ndarray, np.ndarray],
    pushes: Sequence[tuple[int, np.ndarray, Push]],
    desired: Motion,
    progress: Callable[[int, int], None] | None,
) -> np.ndarray:
    """q, rates, currents, what pushes do to the joints, what the drives do, and what the gears carry of it, (6, k, n)."""
    t = desired.time
    forward, per_error, per_rate = controller
    gain, spring = (numbers_of(robot.drives, of) for of in (lambda d: d.torque_per_current, lambda d: d.spring_force))
    friction = HostKernel(lambda qdot, torque: friction_torque(robot, qdot, torque), 2)
    found, data = np.empty((6, len(t), robot.num_joints)), mujoco.MjData(arm)
    q, qdot, current, external, torque, gear = found
    wild = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)
    data.qpos[:], data.qvel[:], given = desired.q[0], desired.velocity[0], gain * forward[0] + spring
    for k in range(len(t)):
        q[k], qdot[k] = data.qpos, data.qvel
        current[k] = forward[k] + per_error * (desired.q[k] - q[k]) + per_rate * (desired.velocity[k] - qdot[k])
        external[k] = _pushed(mujoco, arm, data, pushes, t[k])
        speed = np.copysign(np.maximum(np.abs(qdot[k]), CREEP), qdot[k])
        (rubs,) = friction(speed[None], given[None], double=True)
        arm.dof_frictionloss[:] = np.maximum(-np.sign(speed) * rubs[0], 0.0)
        driven = gain * current[k] + spring
        data.qfrc_applied[:] = driven + external[k]
        mujoco.mj_step(arm, data)
        if any(data.warning[kind].number for kind in wild):  # and it has put the arm back to where all joints are 0
            raise ValueError(f"play: {robot.name} flies apart after {t[k]:g} s; lower frequency or dt")
        torque[k] = given = driven + data.qfrc_constraint
        gear[k] = given - arm.dof_armature * data.qacc
        if progress is not None and (k % TOLD == TOLD - 1 or k == len(t) - 1):
            progress(k + 1, len(t))
    return found


def _with_rests(motions: Sequence[Trajectory], options: PlayOptions) -> Motion:
    """Samples of the motions in a row, the arm at rest before and after each."""
    before, after = (round(x / options.dt) for x in options.rest)
    states = []
    for motion in motions:
        moved, stays = motion.sample(options.dt), ((before, after), (0, 0))
        states.append((np.pad(moved.q, stays, "edge"), np.pad(moved.velocity, stays), np.pad(moved.acceleration, stays)))
    q, velocity, acceleration = map(np.concatenate, zip(*states, strict=True))
    return Motion(q, velocity, acceleration, options.dt * np.arange(len(q)))


def _controller(model: Robot, desired: Motion, options: PlayOptions) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Controllers of joints that are to move as `desired`, by what the model says of them: currents (k, n) [A] at each moment,
    and those for an error of the joint values [A/rad, A/m] and of the rates [A s/rad, A s/m], each (n,)."""
    gain = numbers_of(model.drives, lambda d: d.torque_per_current)

    def asked(q: Any, qdot: Any, qddot: Any) -> Any:
        return motor_current(model, inverse_dynamics(model, q, qdot, qddot), qdot)

    (forward,) = HostKernel(asked, 3)(*desired.state, double=True)
    (inertia,) = HostKernel(lambda q: jnp.diagonal(mass_matrix(model, q)), 1)(desired.q[:1], double=True)
    stiff = options.frequency**2 * inertia[0] / gain
    return forward, stiff, 2.0 * options.damping / options.frequency * stiff


def _on_body(robot: Robot, push: Push) -> tuple[int, np.ndarray, Push]:
    """The body of MuJoCo that a push acts on, and the point (3,) [m] in its frame."""
    if push.link not in robot.link_names:
        raise ValueError(no_such("push", "link", push.link, robot.link_names))
    link, point = robot.link_names.index(push.link), numbers("push: point", push.point, (3,), finite=True)
    if not callable(push.force):
        push = push._replace(force=numbers("push: force", push.force, (3,), finite=True))
    # the world, the base and then a body a joint
    return 1 + robot.link_joint[link], (np.asarray(robot.link_offset[link]) @ [*point, 1.0])[:3], push


def _pushed(mujoco: Any, model: Any, data: Any, pushes: Sequence[tuple[int, np.ndarray, Push]], t: float) -> np.ndarray:
    """Returns what the pushes do to the joints (n,) now, by MuJoCo's own Jacobian."""
    total = np.zeros(model.nv)
    active = [each for each in pushes if each[2].start <= t < each[2].end]
    if active:
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
    turn, origin = data.xmat[1].reshape(3, 3), data.xpos[1]  # the base's
    for body, point, push in active:
        at = data.xpos[body] + data.xmat[body].reshape(3, 3) @ point
        force = push.force(t, turn.T @ (at - origin)) if callable(push.force) else push.force
        if not np.isfinite(force).all():
            raise ValueError(f"push: the force on {push.link} after {t:g} s is {shown(force)}; write finite numbers [N]")
        mujoco.mj_applyFT(model, data, turn @ force, np.zeros(3), at, body, total)
    return total


def _measured(options: PlayOptions, seed: int, q: Any, current: Any, torsion: Any) -> tuple[np.ndarray, ...]:
    """q, rates, currents and torsions as the sensors show them."""
    rng = np.random.default_rng(seed)
    noisy = lambda x, by: x + by * rng.standard_normal(x.shape)
    q, window = _stepped(q, options.position_step), options.window
    slack = np.broadcast_to(options.torsion_play, q.shape[1:])
    anywhere = torsion[0] + slack * rng.uniform(-1.0, 1.0, slack.shape)
    before = np.concatenate([np.repeat(q[:1], window, axis=0), q[:-window]])
    current = _stepped(noisy(current, options.current_noise), options.current_step)
    drag = itertools.accumulate(torsion, lambda y, x: np.clip(y, x - slack, x + slack), initial=anywhere)
    torsion = np.array([*drag])[1:]
    torsion = _stepped(noisy(torsion, options.torsion_noise), options.torsion_step)
    return q, (q - before) / (window * options.dt), current, torsion


def _stepped(x: np.ndarray, step: Any) -> np.ndarray:
    step = np.broadcast_to(np.asarray(step, float), x.shape)
    return np.where(step > 0.0, np.round(x / np.where(step > 0.0, step, 1.0)) * step, x)
