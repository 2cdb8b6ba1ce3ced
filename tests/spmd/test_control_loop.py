"""A loop of one's own: its step as a kernel, its refusals, and that it compiles once."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxik.spmd import ControlLoop, Stepped, control_loop


class Counter(Stepped):
    """Counts samples, and adds them up; a sample is numbers of any one shape."""

    who = "counter"

    def begun(self, x):
        return (x,), (x,)

    def init(self, x):
        return {"count": jnp.zeros((), jnp.int32), "total": 0.0 * x}

    def step(self, state, x):
        state = {"count": state["count"] + 1, "total": state["total"] + x}
        return state, (state["count"], state["total"])


def test_a_loop_steps_and_compiles_once(only_kernels, monkeypatch):
    compiled = []
    packed_step = control_loop.PackedStep
    monkeypatch.setattr(control_loop, "PackedStep", lambda *given: compiled.append(1) or packed_step(*given))
    loop = ControlLoop(Counter())
    for _ in range(2):
        state = loop.start(np.zeros((2, 3)))
        begun = state
        for k in range(1, 4):
            state, (count, total) = loop.step(state, np.full((2, 3), 0.5))
            assert count == k and total.shape == (2, 3) and (total == 0.5 * k).all()
        assert state.tree["count"] == 3 and begun.tree["count"] == 0 and len(compiled) == 1
    loop.start(np.zeros(4))
    assert len(compiled) == 2


def test_refusals():
    loop = ControlLoop(Counter())
    with pytest.raises(ValueError, match="counter loop: not started; call start before step"):
        loop.step(None, np.zeros(2))
    state = loop.start(np.zeros(2))
    with pytest.raises(ValueError, match=r"counter loop: arrays of shapes \(3,\); allowed: \(2,\)"):
        loop.step(state, np.zeros(3))
    with pytest.raises(ValueError, match="counter loop: state is dict; allowed: what `start` or the last `step`"):
        loop.step(state.tree, np.zeros(2))
    with pytest.raises(TypeError, match="unexpected keyword argument 'x'"):
        loop.step(state, x=np.zeros(2))
    with pytest.raises(ValueError, match=r"control loop: .*; write a Reaction, a Teleoperation, an estimator or a Stepped"):
        ControlLoop(np.sum)
