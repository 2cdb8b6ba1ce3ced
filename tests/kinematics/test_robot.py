"""A robot never changes: nobody writes to its numbers, or to what is cached by them, however they came by it."""

import copy
import dataclasses
import pickle

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxik
from jaxik.ik import seeds
from jaxik.kinematics.reach_bound import reach_bound
from jaxik.kinematics.tasks import Tasks

ROBOT = jaxik.load("p6r")
WAYS = {
    "loaded": lambda robot: jaxik.load("p6r"),
    "replaced": lambda robot: dataclasses.replace(robot, lower=np.array(robot.lower)),
    "part": lambda robot: robot.part(1, 7),
    "tool": lambda robot: robot.with_tool(np.eye(4)),
    "copied": copy.copy,
    "deep copy": copy.deepcopy,
    "pickled": lambda robot: pickle.loads(pickle.dumps(robot)),
    "tree_at": lambda robot: eqx.tree_at(lambda c: (c.lower, c.boxes[0].half), robot, (np.zeros(7), np.ones(3))),
    "tree_map": lambda robot: jax.tree_util.tree_map(np.array, robot),
}


def arrays(tree):
    return [x for x in jax.tree_util.tree_leaves(tree) if isinstance(x, np.ndarray)]


@pytest.mark.parametrize("way", WAYS)
def test_no_array_of_a_hashed_robot_can_be_written(way):
    hash(ROBOT)
    robot = WAYS[way](ROBOT)
    before = robot.digest
    assert len(arrays(robot)) > 10
    for array in arrays(robot):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0.0
    assert robot.digest == before == robot._computed_digest()


def test_a_robot_that_was_hashed_is_the_same_pytree():
    """Or it would compile again as an argument, and what is made of it would be another robot to every cache."""
    new, used = jaxik.load("p6r"), jaxik.load("p6r")
    hash(used)
    assert jax.tree_util.tree_structure(new) == jax.tree_util.tree_structure(used)
    assert all(way(used).digest == new.digest for name, way in WAYS.items() if name not in ("part", "tree_at"))


def test_arrays_given_to_a_robot_stay_their_owner_s():
    """Whole, by a view that is read-only itself, and by `tree_at`, where the robot finds it when it is hashed."""
    lower, frames, upper = np.array(ROBOT.lower), np.array(ROBOT.parent_T_joint), np.array(ROBOT.upper)
    view = frames[:]
    view.setflags(write=False)
    robot = dataclasses.replace(ROBOT, lower=lower, parent_T_joint=view)
    robot = eqx.tree_at(lambda c: c.upper, robot, upper)
    assert robot == ROBOT
    lower[0], frames[0, 0, 3], upper[0] = -9.0, 9.0, 9.0
    assert robot == ROBOT and robot.digest == robot._computed_digest()
    assert np.array_equal(robot.lower, ROBOT.lower) and np.array_equal(robot.parent_T_joint, ROBOT.parent_T_joint)


def test_numbers_of_a_robot_may_be_jax_s_and_traced():
    q = jnp.linspace(0.1, 0.7, 7)
    with_jax = dataclasses.replace(ROBOT, joint_T_tip=jnp.asarray(ROBOT.joint_T_tip), lower=jnp.asarray(ROBOT.lower))
    assert isinstance(with_jax.joint_T_tip, jax.Array) and isinstance(with_jax.digest, str)
    height = lambda x: jaxik.forward_kinematics(ROBOT.with_tool(jnp.eye(4).at[2, 3].set(x)), q)[2, 3]
    assert np.isclose(jax.grad(height)(0.1), jaxik.forward_kinematics(ROBOT, q)[2, 2])
    one = jax.tree_util.tree_map(lambda x: x[0], jax.vmap(lambda x: ROBOT.with_tool(jnp.eye(4) * x))(jnp.ones(2)))
    assert one.joint_T_tip.shape == (4, 4) and not jax.tree_util.tree_leaves(jax.tree_util.tree_map(lambda _: None, ROBOT))


def test_what_is_cached_and_shared_cannot_be_written():
    inside = seeds.Range((0.0, -1.0), (1.0, 1.0))
    shared = [seeds.uniform(inside, 0, 3), seeds.low_discrepancy(inside, 0, 0, 8), reach_bound(ROBOT)]
    shared.append(
        seeds.set_of(
            ROBOT, Tasks.alone(jaxik.Task()), seeds.Range(tuple(ROBOT.lower.tolist()), tuple(ROBOT.upper.tolist())), 1.0, 0
        )
    )
    assert len(arrays(shared)) >= 6
    for array in arrays(shared):
        assert not array.flags.writeable


def test_equal_numbers_are_equal_values():
    """Boxes and scenes, too, which have no digest; they are shown on one line, arrays by their shape."""
    box, other = ROBOT.boxes[0], dataclasses.replace(ROBOT.boxes[0], half=np.array([1.0, 2.0, 3.0]))
    assert box == copy.deepcopy(box) != other and box != ROBOT.boxes[1] and box != box.half.tolist()
    assert jaxik.load_scene("cucumber_row") == jaxik.load_scene("cucumber_row")
    assert repr(other) == f"Box(joint_T_box=float64[4, 4], half=float64[3], link={other.link})"
    with pytest.raises(dataclasses.FrozenInstanceError):
        box.link = 3
