"""A kernel again and again: the same results, in several threads at once, and no memory taken."""

import gc
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from jaxik import spmd
from jaxik.spmd.handle import Handle

RNG = np.random.default_rng(5)
A, B, C = RNG.normal(size=(3, 1, 7))
SUMS = spmd.HostKernel(lambda a, b, c: (a + b, b * c, jnp.sum(c)), 3)
CALLS = 100_000


@pytest.mark.kernels(reason="`run` and `repeated` never go to XLA")
def test_calls_with_memory_of_the_caller_take_none():
    """A hundred thousand of them: as many blocks of memory as before, and nothing for Python's search for garbage."""
    again, searches = SUMS.repeated(A, B, C, double=True), []
    out = again(A, B, C)
    for _ in range(10):
        again(A, B, C, out=out)
    gc.callbacks.append(lambda phase, _: searches.append(phase))
    try:
        counts, before = gc.get_count(), sys.getallocatedblocks()
        for _ in range(CALLS):
            again(A, B, C, out=out)
        taken, after = sys.getallocatedblocks() - before, gc.get_count()
    finally:
        gc.callbacks.pop()
    assert not searches and abs(taken) < 20 and abs(after[0] - counts[0]) < 20
    np.testing.assert_array_equal(out[0], A + B)


@pytest.mark.kernels(reason="`run` and `repeated` never go to XLA")
def test_results_that_are_let_go_of_leave_nothing():
    again, searches = SUMS.repeated(A, B, C, double=True), []
    again(A, B, C)
    gc.callbacks.append(lambda phase, _: searches.append(phase))
    try:
        before = sys.getallocatedblocks()
        for _ in range(CALLS):
            again(A, B, C)
        taken = sys.getallocatedblocks() - before
    finally:
        gc.callbacks.pop()
    assert not searches and abs(taken) < 20


@pytest.mark.kernels(reason="`run` and `repeated` never go to XLA")
def test_threads_share_one():
    """Each has its own numbers, and gets its own results, new or in its own memory; switched as often as Python can."""
    again, together = SUMS.repeated(A, B, C, double=True), threading.Barrier(4)

    def calls(number):
        a, out = np.full((1, 7), float(number)), again(A, B, C)
        together.wait()
        for k in range(3000):
            b = np.full((1, 7), float(k))
            found = again(a, b, b) if k % 2 else again(a, b, b, out=out)
            assert (found[0] == number + k).all() and (found[1] == k * k).all() and found[2][0] == 7.0 * k
        return True

    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(4) as pool:
            assert all(pool.map(calls, range(4)))
    finally:
        sys.setswitchinterval(before)


@pytest.mark.kernels(reason="`run` and `repeated` never go to XLA")
def test_a_call_that_fails_leaves_the_next_ones_sound():
    again = SUMS.repeated(A, B, C, double=True)
    for wrong in ((A, B), (A, B, C, C), (A, B, np.ones((3, 7))), (A, "x", C)):
        with pytest.raises((TypeError, ValueError)):
            again(*wrong)
    np.testing.assert_array_equal(again(A, B, C)[1], B * C)


@pytest.mark.kernels(reason="`run` and `repeated` never go to XLA")
def test_another_thread_goes_on_beside_a_long_call():
    """A short one keeps the interpreter's lock, as getting it back may take longer than the call; a long one may not."""
    turns = lambda x: lax.fori_loop(0, 1_000_000, lambda _, x: x + jnp.sin(x), x)
    again, begun, ended, count = spmd.HostKernel(turns, 1).repeated(A, double=True), threading.Event(), [], 0

    def call():
        begun.set()
        again(A)
        ended.append(time.perf_counter())

    thread = threading.Thread(target=call)
    thread.start()
    begun.wait()
    while not ended:
        count += 1
    thread.join()
    assert count > 1000


@pytest.mark.kernels(reason="`run` and `repeated` never go to XLA")
def test_rows_of_a_batch_are_those_of_run():
    rows = RNG.normal(size=(3, 37, 7))
    again = SUMS.repeated(*rows, double=True)
    for _ in range(3):
        for found, expected in zip(again(*rows), SUMS.run(*rows, double=True), strict=True):
            np.testing.assert_array_equal(found, expected)
        rows = rows[::-1] * 0.5


@pytest.mark.parametrize("double", [True, False])
def test_numbers_and_truths_come_as_python_has_them(double):
    handle = Handle("chosen", lambda x, n, yes: jnp.where(yes, x * n, -x), double)
    for args in ((0.5, 3, True), (0.25, 7, False), (np.float32(0.5), np.int8(3), np.bool_(True)), (2, 3, True)):
        x, n, yes = args
        assert handle(*args) == (x * n if yes else -x)
    with pytest.raises(ValueError, match="float64 where int32 is taken"):
        handle(0.5, 2.5, True)
    assert handle(np.array(0.5), 3, True) == 1.5
