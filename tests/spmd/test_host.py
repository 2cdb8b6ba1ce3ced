"""A kernel on NumPy arrays, without XLA: whatever arrays a driver has."""

import gc
import threading
import weakref
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from jaxik import spmd
from jaxik.garbage import uncollected
from jaxik.spmd import batch, host

pytestmark = pytest.mark.kernels(reason="kernels on NumPy arrays")

RNG = np.random.default_rng(0)
X, Y = RNG.normal(size=(2, 37, 3)).astype(np.float32)
N = RNG.integers(-9, 9, (37, 1))


def mixed(x, n, table):
    return x[0] * table[n[0] % 2] + n[0]


KERNEL = spmd.HostKernel(mixed, 2)
TABLE = np.array([3.0, 5.0], np.float32)
EXPECTED = X[:, 0] * TABLE[N[:, 0] % 2] + N[:, 0].astype(np.float32)


def unaligned(x):
    return np.frombuffer(b"x" + x.tobytes(), np.uint8)[1:].view(x.dtype).reshape(x.shape)


ARRAYS = {
    "as they are": lambda a: a,
    "by columns": np.asfortranarray,
    "every other": lambda a: np.repeat(a, 2, 0)[::2],
    "backwards": lambda a: a[::-1].copy()[::-1],
    "big-endian": lambda a: a.astype(a.dtype.newbyteorder(">")),
    "unaligned": unaligned,
    "read-only": lambda a: np.frombuffer(a.tobytes(), a.dtype).reshape(a.shape),
    "lists": np.ndarray.tolist,
}


@pytest.mark.parametrize("integer", [np.int8, np.int32, np.int64])
@pytest.mark.parametrize("name", ARRAYS)
def test_arrays_of_any_layout(name, integer):
    lay = ARRAYS[name]
    table = TABLE if name == "lists" else lay(TABLE)
    (found,) = KERNEL.run(lay(X), lay(N.astype(integer)), table, double=False)
    np.testing.assert_array_equal(found, EXPECTED)


def test_unsigned_integers_of_64_bits():
    (found,) = spmd.HostKernel(lambda n: n[::-1] + 1, 1).run(np.arange(74, dtype=np.uint64).reshape(37, 2), double=False)
    np.testing.assert_array_equal(found, np.arange(74).reshape(37, 2)[:, ::-1] + 1)


@pytest.mark.parametrize("rows", [0, 1, 15, 16, 17, 31, 33])
def test_any_number_of_rows(rows):
    np.testing.assert_array_equal(KERNEL.run(X[:rows], N[:rows], TABLE)[0], EXPECTED[:rows])


@pytest.mark.parametrize(("x", "n"), [(X, N[:5]), (X[:5], N), (X[0, 0], N), (X, N[0, 0])])
def test_rows_that_do_not_go_together_are_refused(x, n):
    """Instead of reading what lies behind them."""
    with pytest.raises(ValueError, match=r"the first 2 arguments have a row a lane, as many each; here shapes \(") as told:
        KERNEL.run(x, n, TABLE)
    assert "\n" not in str(told.value)


def test_arrays_outlive_an_interrupt():
    """Ctrl-C while another thread writes: the arrays go when that thread is done, not before."""

    class Interrupted:
        def __init__(self):
            self.tasks = []

        def submit(self, *task):
            self.tasks.append(task)
            return self

        def cancel(self):
            raise KeyboardInterrupt

    pool, kernel, x = Interrupted(), spmd.HostKernel(lambda x: x + x, 1), np.ones((2_000_000, 1), np.float32)
    seen = weakref.ref(x)
    try:
        kernel.run(x, threads=pool, team=2)
    except KeyboardInterrupt:
        del x
    assert len(pool.tasks) == 1 and seen() is not None
    for task, *args in pool.tasks:
        task(*args)
    pool.tasks.clear()
    del task, args
    assert seen() is None


def test_many_tables_need_no_large_stack():
    """Each of sixteen would do by itself; a thread of half a megabyte holds them all."""

    def roll(x):
        return lax.scan(lambda c, k: (0.9 * c + k, tuple(c + n for n in range(16))), x, jnp.arange(900.0, dtype=np.float32))[1]

    kernel, x, found = spmd.HostKernel(roll, 1), np.ones(20, np.float32), []
    kernel.run(x)  # compiled where there is room
    before = threading.stack_size(512 * 1024)
    try:
        thread = threading.Thread(target=lambda: found.extend(kernel.run(x)))
        thread.start()
        thread.join()
    finally:
        threading.stack_size(before)
    expected = np.asarray(jax.vmap(roll)(x)[0])
    for n, table in enumerate(found):
        np.testing.assert_allclose(table, expected + n, rtol=1e-5)
    assert len(found) == 16


FACTORS = spmd.HostKernel(lambda x: jnp.linalg.svd(jnp.outer(x, x))[1], 1)


def test_what_a_kernel_cannot_do_comes_in_the_same_form_from_xla():
    (found,) = FACTORS(X)
    assert type(found) is np.ndarray
    np.testing.assert_allclose(found[:, 0], np.sum(X**2, 1), rtol=1e-5)
    with pytest.raises(spmd.Unsupported, match="svd"):
        FACTORS.run(X)


@pytest.mark.parametrize("dtype", [np.int64, np.uint64, np.int32, np.uint32, np.int8, np.uint8, np.bool_])
@pytest.mark.parametrize("double", [False, True])
def test_whole_numbers_of_all_widths(dtype, double):
    x = np.arange(40).astype(dtype)
    (found,) = spmd.HostKernel(lambda x: x.astype(jnp.float32) + 1, 1).run(x, double=double)
    np.testing.assert_array_equal(found, x.astype(np.float32) + 1)


@pytest.mark.parametrize("double", [False, True])
def test_a_large_array_that_is_closed_over_is_an_operand(double):
    tables = np.random.default_rng(8).normal(size=(2, 200, 7))
    x = np.random.default_rng(9).normal(size=(37, 7))
    for table in tables:
        (found,) = spmd.HostKernel(lambda q, table=table: jnp.sum((table @ q) ** 2), 1).run(x, double=double)
        np.testing.assert_allclose(found, np.sum((x @ table.T) ** 2, axis=1), rtol=1e-12 if double else 1e-4)


def test_repeated_calls_are_what_run_gives():
    again = KERNEL.repeated(X, N, TABLE)
    first = again(X, N, TABLE)[0]
    np.testing.assert_array_equal(first, KERNEL.run(X, N, TABLE)[0])
    np.testing.assert_array_equal(again(-X, N, 2.0 * TABLE)[0], KERNEL.run(-X, N, 2.0 * TABLE)[0])
    np.testing.assert_array_equal(first, KERNEL.run(X, N, TABLE)[0])  # and is nobody else's memory


def test_threads_that_ask_at_once_make_a_kernel_once(monkeypatch):
    trace, traces, together = host.trace, [], threading.Barrier(4)
    monkeypatch.setattr(host, "trace", lambda *args: (traces.append(args), trace(*args))[1])
    kernel = spmd.HostKernel(lambda x: jnp.tanh(x) * 3.0, 1)

    def ask():
        together.wait()
        return kernel.run(X)[0]

    with ThreadPoolExecutor(4) as pool:
        found = [task.result() for task in [pool.submit(ask) for _ in range(4)]]
    assert len(traces) == 1
    for each in found:
        np.testing.assert_allclose(each, 3.0 * np.tanh(X), rtol=1e-5)


@pytest.mark.parametrize("cores", [1, 2])
def test_another_thread_asks_ahead_once_where_there_is_a_core(cores, monkeypatch):
    monkeypatch.setattr(batch, "cores", lambda: cores)
    kernel, asked = spmd.HostKernel(lambda x: jnp.exp(x) * 7.0, 1), threading.Event()
    batch.ahead(kernel, lambda: (kernel.run(X), asked.set()))
    assert asked.wait(20.0 if cores > 1 else 0.1) == (cores > 1)
    kernel.run(X)
    asked.clear()
    batch.ahead(kernel, asked.set)  # it is known
    assert not asked.wait(0.1)


def test_a_kernel_that_fails_ahead_fails_where_it_is_needed():
    kernel = spmd.HostKernel(lambda x: jnp.linalg.svd(x[None])[1], 1)
    batch.ahead(kernel, lambda: kernel.run(X))
    with pytest.raises(spmd.Unsupported, match="svd"):
        kernel.run(X)


def test_the_search_for_garbage_goes_on_as_it_was():
    assert gc.isenabled()
    with pytest.raises(KeyError), uncollected():
        with uncollected():
            assert not gc.isenabled()
        assert not gc.isenabled()
        raise KeyError
    assert gc.isenabled()
    gc.disable()
    try:
        with uncollected():
            pass
        assert not gc.isenabled()
    finally:
        gc.enable()
