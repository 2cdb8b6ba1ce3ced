"""A function's description is what is made of it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import jaxik
from jaxik.spmd import describe

pytestmark = pytest.mark.kernels(reason="what LLVM made of a function")

Q = np.linspace(-1.0, 1.0, 7)


def test_operations_loops_and_branches():
    def roll(x):
        half = lax.while_loop(lambda c: c > 1.0, lambda c: 0.5 * c, x)
        return lax.cond(x > 0.0, lambda c: lax.fori_loop(0, 300, lambda _, v: v * v + c, c), lambda c: c, half)

    found = describe(roll, np.float32(3.0))
    assert found.loops == (0, 300) and found.branches == 1
    assert found.operations == {"load": 1, "gt": 2, "mul": 2, "add": 1}
    assert "2 loops (until all lanes are done, 300 turns); 1 branch;" in str(found)


def test_width_and_what_has_no_register():
    matrix = lambda x: jnp.linalg.matrix_power(x, 3).ravel() @ x.ravel()
    single, double = (describe(matrix, np.eye(6, dtype=dtype)) for dtype in (np.float32, np.float64))
    assert single.width == 2 * double.width
    assert single.spills > 0 and single.stack > 0  # 36 entries and as many sums are more than there are registers
    assert describe(lambda x: x + 1, np.float32(1)).spills == 0


def test_the_numbers_of_a_model_are_folded_as_in_its_kernel():
    robot = jaxik.load("p6r")
    closed_over = describe(lambda q: jaxik.forward_kinematics(robot, q), Q)
    given = describe(jaxik.forward_kinematics, robot, Q)
    assert given.name == "forward_kinematics" and given.operations == closed_over.operations


def test_why_it_goes_to_xla(monkeypatch):
    random = lambda q: q + jax.random.normal(jax.random.key(0), (7,))
    assert str(describe(random, Q)) == "<lambda>: by XLA, since a kernel cannot do the primitive 'random_seed'"
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert describe(jnp.sum, Q).refused == "other platforms than a CPU"


def test_what_the_function_itself_refuses():
    with pytest.raises(TypeError, match="dot_general"):
        describe(jnp.dot, Q, Q[:3])
