"""A user's program, against the installed package: it runs, and `mypy --strict` accepts it (`.ci/run`)."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

import jaxik


def height(robot: jaxik.Robot, q: jax.Array) -> jax.Array:
    """The height of the tip [m]; traced."""
    tip: jax.Array = jaxik.forward_kinematics(robot, q)
    return jnp.sum(tip[2, 3])


def answers(robot: jaxik.Robot, targets: np.ndarray, scene: jaxik.Scene | None = None) -> dict[str, int]:
    options = jaxik.IKOptions(max_seeds=32, margin=0.01)
    result = jaxik.solve_ik(robot, targets, scene=scene, options=options)
    q: np.ndarray = result.q
    print(q.shape, [jaxik.Reason(int(r)).text for r in result.reason])
    solved: np.ndarray = q[result.success]
    every: np.ndarray = result.solutions[:, 0]
    print(solved.shape == every[result.success].shape, result.seed[0], result.iterations.max(), result.num_solutions.sum())
    off = max(float(one.position_error) + float(one.rotation_error) for one in result)
    print(f"off by {off:.1e}, free by {float(result[0].clearance):.2f} m", result.why, result.fault.any(), result.offenders)
    return result.counts()


def motions(robot: jaxik.Robot, q: np.ndarray) -> jaxik.Reason:
    """Along a line of 1 mm: moment by moment, ahead of time, and under a moving horizon."""
    start = np.asarray(jaxik.forward_kinematics(robot, q))
    path = jaxik.motions.Line(start, start + 0.001 * np.eye(4, k=3))
    followed = jaxik.follow(robot, path, 0.1, q, dt=0.05)
    moved: np.ndarray = followed.q
    rates: np.ndarray = followed.velocity
    print(moved.shape == rates.shape, followed.time[-1], np.abs(followed.error).max(), followed.damping.max())
    cost = jaxik.costs.quadratic_cost()
    ahead = jaxik.predict(robot, path, 0.1, q, cost, dt=0.05, count=2)
    planned: np.ndarray = np.asarray(ahead.q)
    print(planned.shape, float(ahead.total), ahead.w.shape, ahead.costs.shape, int(ahead.iterations), int(ahead.sample))
    control = jaxik.motions.PredictiveController(robot, cost, dt=0.05, count=2)
    state, now = control.step(control.init(q), path, 0.1)
    print(state.time.shape, now.velocity.shape, now.planned.shape, float(now.total))
    return jaxik.Reason(int(followed.reason))


def solutions(robot: jaxik.Robot, q: jax.Array) -> float:
    """One lane of the search, and its answer as a differentiable function of its target."""
    target = jaxik.forward_kinematics(robot, q)
    landed = jaxik.ik.descend_ik(robot, target, q + 0.01)
    moved = jaxik.implicit_ik(robot, target, landed.q)
    print(landed.q.shape, bool(moved.defined), moved.q.shape)
    return float(landed.position_error) + float(landed.rotation_error)


def main() -> None:
    robot = jaxik.load("p6r", ignore=[("base", "forearm")])
    scene = jaxik.load_scene("cucumber_row")
    middle = jnp.asarray((robot.lower + robot.upper) / 2)
    print(robot.num_joints, robot.joint_names, scene.counts)
    print(height(robot, middle), jax.grad(lambda q: height(robot, q))(middle))
    print(jaxik.clearance(robot, scene, q=middle), jaxik.motions.Line(np.eye(4), np.eye(4)).pose(0.5))
    print(answers(robot, np.asarray(jaxik.forward_kinematics(robot, middle))[None], scene))
    print(motions(robot, np.asarray(middle)), solutions(robot, middle))


if __name__ == "__main__":
    try:
        main()
    except jaxik.LoadError as error:
        raise SystemExit(str(error)) from None
