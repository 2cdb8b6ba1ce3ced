"""The handler that XLA calls, called by hand: offsets, refusals, threads that are there or not, and what is left as it was."""

import ctypes
import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxik import spmd
from jaxik.spmd import call, handler, machine
from jaxik.spmd.trace import trace

pytestmark = pytest.mark.kernels(reason="what XLA calls is LLVM's code")

SIZES = {"int64_t": 8, "size_t": 8, "int": 4, "uint32_t": 4}


def structures(text):
    """Name -> (its size, offset of each member), as a C compiler on a 64-bit machine lays them out."""
    found = {}
    text = re.sub(r"//[^\n]*|/\*.*?\*/", "", text, flags=re.S)
    text = re.sub(r"_XLA_FFI_API_STRUCT_FIELD\((\w+)\)", r"void* \1", text)
    for name, body in re.findall(r"struct (\w+) \{(.*?)\n\}", text, re.S):
        offsets, end, most = {}, 0, 1
        for member in filter(None, map(str.strip, body.split(";"))):
            kind, field = re.fullmatch(
                r"(?:const )?(?:struct )?(\w+\s*\**|void \(\*\w+\)\(.*\))\s*(\w*)", member, re.S
            ).groups()
            size = (
                8 if "*" in kind else SIZES.get(kind.strip()) or found.get(kind.strip(), (4,))[0]
            )  # the rest are enumerations
            align = min(size, 8)
            end = -(-end // align) * align
            offsets[field], end, most = end, end + size, max(most, align)
        found[name] = -(-end // most) * most, offsets
    return found


def test_offsets_are_those_of_the_header():
    header = Path(jax.ffi.include_dir()) / "xla/ffi/api/c_api.h"
    c = {name.removeprefix("XLA_FFI_"): offsets for name, (_, offsets) in structures(header.read_text()).items()}
    frame, api, version = c["CallFrame"], c["Api"], c["Metadata"]["api_version"]
    assert {
        "extension": frame["extension_start"],
        "api": frame["api"],
        "context": frame["ctx"],
        "stage": frame["stage"],
        "operands": frame["args"] + c["Args"]["size"],
        "args": frame["args"] + c["Args"]["args"],
        "results": frame["rets"] + c["Rets"]["size"],
        "rets": frame["rets"] + c["Rets"]["rets"],
    } == handler.FRAME
    assert {name: c["Buffer"][{"type": "dtype"}.get(name, name)] for name in ("type", "data", "rank", "dims")} == handler.BUFFER
    assert {
        "kind": c["Metadata_Extension"]["extension_base"] + c["Extension_Base"]["type"],
        "metadata": c["Metadata_Extension"]["metadata"],
        "major": version + c["Api_Version"]["major_version"],
        "minor": version + c["Api_Version"]["minor_version"],
    } == handler.METADATA
    names = {"error_create": "Error_Create", "error_destroy": "Error_Destroy"}
    names |= {"schedule": "ThreadPool_Schedule", "threads": "ThreadPool_NumThreads"}
    assert {name: api[f"XLA_FFI_{there}"] for name, there in names.items()} == handler.API
    for name, args, size in (("task", "ThreadPool_Schedule", 40), ("num_threads", "ThreadPool_NumThreads", 32)):
        assert c[f"{args}_Args"][name] == 24 and list(c[f"{args}_Args"].values())[-1] + 8 == size
    assert c["Error_Create_Args"] == {"struct_size": 0, "extension_start": 8, "message": 16, "errc": 24}
    assert c["Error_Destroy_Args"]["error"] == 16
    codes = dict(re.findall(r"XLA_FFI_(\w+) = (\d+)", header.read_text()))
    types = {"i1": "PRED", "float": "F32", "double": "F64"}
    types |= {f"{c}{n}": f"{'S' if c == 'i' else 'U'}{n}" for c in "iu" for n in (8, 16, 32, 64)}
    assert {kind: int(codes[f"DataType_{name}"]) for kind, name in types.items()} == handler.DATA_TYPES
    assert int(codes["Error_Code_INVALID_ARGUMENT"]) == handler.INVALID_ARGUMENT
    assert int(codes["ExecutionStage_EXECUTE"]) == handler.EXECUTE


def polynomial(x, table):
    return jnp.stack([x[0] * table[1] + x[1], x[2] - table[0] * table[2]]), x[0] > table[1]


SHAPES = [jax.ShapeDtypeStruct((3,), np.float32)] * 2
RNG = np.random.default_rng(0)


@pytest.fixture(scope="module")
def made():
    traced, _, _ = trace(polynomial, SHAPES)
    return call.made(traced, (False, True))


def called(made, *operands, results=None):
    rows = operands[0].shape[:2]
    results = results or [jax.ShapeDtypeStruct((*rows, 2), np.float32), jax.ShapeDtypeStruct((*rows, 1), np.bool_)]
    return jax.ffi.ffi_call(made.name, results)(*operands)


def good(rows=5, outer=2):
    return RNG.normal(size=(outer, rows, 3)).astype(np.float32), RNG.normal(size=(outer, 1, 3)).astype(np.float32)


def test_buffers_that_fit(made):
    x, table = good()
    for tables in (table, table[:1]):
        found, above = called(made, x, tables)
        expected = np.stack([x[..., 0] * tables[..., 1] + x[..., 1], x[..., 2] - tables[..., 0] * tables[..., 2]], -1)
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6)
        np.testing.assert_array_equal(above[..., 0], x[..., 0] > tables[..., 1])


def result(*shape, dtype=np.float32):
    return jax.ShapeDtypeStruct(shape, dtype)


MISFITS = {
    "another type": lambda x, t: ((x.astype(np.float64), t), None),
    "a row too short": lambda x, t: ((x[..., :2], t), None),
    "a table of every row": lambda x, t: ((x, np.repeat(t, 5, 1)), None),
    "other tables than rows": lambda x, t: ((x, np.repeat(t, 2, 0)), None),
    "another rank": lambda x, t: ((x, t[0]), None),
    "an operand too few": lambda x, t: ((x,), None),
    "a result too few": lambda x, t: ((x, t), [result(2, 5, 2)]),
    "results of other rows": lambda x, t: ((x, t), [result(2, 5, 2), result(2, 6, 1, dtype=np.bool_)]),
    "more rows than there are": lambda x, t: ((x, t), [result(2, 6, 2), result(2, 6, 1, dtype=np.bool_)]),
}


@pytest.mark.parametrize("name", MISFITS)
def test_buffers_that_do_not_fit_are_refused(made, name):
    operands, results = MISFITS[name](*good())
    with pytest.raises(jax.errors.JaxRuntimeError, match="INVALID_ARGUMENT: jaxik: a kernel's operands or results") as told:
        called(made, *operands, results=results)
    assert "\n" not in str(told.value)


# --------------------------------------------------------------------------------------------------------------------
# A call frame of one's own

NUMBER, ADDRESS = ctypes.c_int64, ctypes.addressof
CALLBACK = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.POINTER(NUMBER))


def words(*numbers):
    return (NUMBER * len(numbers))(*numbers)


class Pool:
    """XLA's threads, as the C API gives them: `threads` of them or an error (None), of which some may refuse to take a task."""

    def __init__(self, threads, refuses=0):
        self.threads, self.refuses, self.tasks, self.destroyed = threads, refuses, [], []
        self.kept = CALLBACK(self.number), CALLBACK(self.schedule), CALLBACK(lambda args: self.destroyed.append(args[2]))
        number, schedule, destroy = (ctypes.cast(f, ctypes.c_void_p).value for f in self.kept)
        self.api = words(*[0] * 24)
        for name, function in (("threads", number), ("schedule", schedule), ("error_destroy", destroy)):
            self.api[handler.API[name] // 8] = function

    def number(self, args):
        assert args[0] == 32 and args[2] == 77
        if self.threads is None:
            return 1001
        NUMBER.from_address(args[3]).value = self.threads
        return None

    def schedule(self, args):
        assert args[0] == 40 and args[2] == 77
        if self.refuses:
            self.refuses -= 1
            return 1002
        self.tasks.append((args[3], args[4]))
        return None

    def run(self):
        for task, data in self.tasks:
            ctypes.CFUNCTYPE(None, ctypes.c_void_p)(task)(data)


def buffer(array, kind):
    dims = words(*array.shape)
    return words(48, 0, handler.DATA_TYPES[kind], array.ctypes.data, array.ndim, ADDRESS(dims)), dims


@pytest.fixture(scope="module")
def entry():
    name = "jaxik_called_by_hand"
    traced, _, _ = trace(lambda x: (x * 2.0 + 1.0)[::-1], SHAPES[:1])
    text = call.plan(traced, (False,), name).text
    address, _ = machine.linked(machine.compiled(text), name, f"{name}_work")
    return ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)(address)


@pytest.mark.parametrize(
    ("pool", "destroyed", "tasks"),
    [(Pool(1), [], 0), (Pool(None), [1001], 0), (Pool(3, refuses=2), [1002] * 2, 0), (Pool(3, refuses=1), [1002], 1)],
    ids=["one thread", "no pool", "no task taken", "one task taken"],
)
def test_threads_that_are_not_there(entry, pool, destroyed, tasks):
    """The calling thread does all of it then, errors are given back, and who comes too late finds nothing left."""
    rows = 400_003
    x = RNG.normal(size=(1, rows, 3)).astype(np.float32)
    y = np.full_like(x, np.nan)
    (operand, d1), (result, d2) = buffer(x, "float"), buffer(y, "float")
    args, rets, frame = words(ADDRESS(operand)), words(ADDRESS(result)), words(*[0] * 24)
    content = {"api": ADDRESS(pool.api), "context": 77, "stage": handler.EXECUTE}
    content |= {"operands": 1, "args": ADDRESS(args), "results": 1, "rets": ADDRESS(rets)}
    for field, value in content.items():
        frame[handler.FRAME[field] // 8] = value
    assert entry(ADDRESS(frame)) is None
    np.testing.assert_array_equal(y, (x * 2 + 1)[..., ::-1])
    assert pool.destroyed == destroyed and len(pool.tasks) == tasks
    del frame, args, rets, operand, result, d1, d2
    pool.run()


# --------------------------------------------------------------------------------------------------------------------
# State that a kernel leaves as it was


def test_denormals_are_flushed_inside_only():
    """Denormals are flushed as on XLA's threads; what NumPy computes on this thread afterwards is not touched."""
    tiny, half = np.full((40, 1), 1e-39, np.float32), np.float32(0.5)
    kernel = spmd.HostKernel(lambda x: x * 3.0, 1)
    before = tiny * half
    (found,) = kernel.run(tiny)
    assert (found == 0).all() and (before > 0).all()
    np.testing.assert_array_equal(tiny * half, before)
    np.testing.assert_array_equal(jax.jit(jax.vmap(spmd.kernel(lambda x: x * 3.0)))(tiny), found)


def test_a_result_of_many_pages():
    """Large pages are asked for it."""
    x = np.random.default_rng(0).normal(size=(140_000, 1)).astype(np.float32)
    found = jax.jit(jax.vmap(spmd.kernel(lambda x: x[0] * jnp.arange(1.0, 17.0, dtype=np.float32))))(x)
    assert found.nbytes > 2 * handler.LARGE
    np.testing.assert_array_equal(found, x * np.arange(1.0, 17.0, dtype=np.float32))
