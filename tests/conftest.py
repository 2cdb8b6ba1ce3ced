"""jaxtyping shapes are checked by beartype in every test; float64 is on, and float32 is asked for where it is judged."""

import atexit
import gc
import itertools
import os
import shutil
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

import pytest
from jaxtyping import install_import_hook

CACHE = "JAX_COMPILATION_CACHE_DIR"  # the processes of one run share what they compile; another run starts anew
if CACHE not in os.environ:  # a worker's is that of the run, and that of the run may be what `.ci/run` gave to all it does
    home = tempfile.mkdtemp(prefix="jaxik-tests-")
    # that of the commands is the same folder
    os.environ |= {CACHE: f"{home}/jaxik", "XDG_CACHE_HOME": home}
    atexit.register(shutil.rmtree, home, ignore_errors=True)

# not the arithmetic on scalars, nor the compiler, nor what fits, nor what a loop calls: their types are plain (mypy's), and a
# trace, or a fit, calls them a hundred thousand times
CLOSED = ("turns", "positioning", "spherical_wrist", "three_parallel", "arm_angle")
UNTYPED = ("__init__", "algebra", "bodies", "distance", "capsules", "linear", "sqp", "model", "prepared", *CLOSED)
HOME = Path(find_spec("jaxik").origin).parent
BASES = (HOME / "options.py", HOME / "results.py")  # beartype knows `Self` only in classes that it decorates whole
FILES = [p for p in HOME.rglob("*.py") if p.stem not in UNTYPED and "spmd" not in p.parts and p not in BASES]
TYPED = [".".join(("jaxik", *p.relative_to(HOME).with_suffix("").parts)) for p in FILES]


def pytest_sessionstart(session):
    """Imports the library, but where a process only hands the tests to others: that would take many seconds."""
    if session.config.pluginmanager.has_plugin("dsession"):
        return
    assert "jaxik" not in sys.modules, "imported before its types are checked: by a conftest.py, at its top?"
    with install_import_hook(TYPED, "beartype.beartype"):
        import jaxik  # noqa: F401

    import jax

    from jaxik.spmd import call, primitive

    jax.config.update("jax_enable_x64", True)
    # most of a run is compiling, and its results are read once: XLA's and LLVM's quick code, which of kernels has the same bits
    jax.config.update("jax_disable_most_optimizations", True)
    call.QUICK = 0
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)
    gc.set_threshold(100_000, 50, 100)  # traces make many objects and little garbage
    if not has_kernels():  # the one warning that everything runs by XLA is as it should be, whichever test would be the first
        primitive._told.add(("everything", call.NO_LLVM))


_TESTS = itertools.count()


def has_kernels():
    """Whether llvmlite is there: neither missing nor hidden (`tests/without_llvmlite.sh`)."""
    try:
        import llvmlite.binding  # noqa: F401
    except ImportError:
        return False
    return True


def pytest_configure(config):
    if not has_kernels():
        os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] = "1"  # for processes that tests start, too: the same bits


def pytest_collection_modifyitems(config, items):
    """Leaves out the tests of kernels themselves, those marked `kernels`, where there are none."""
    if not has_kernels():
        own = [x for x in items if x.get_closest_marker("kernels")]
        config.hook.pytest_deselected(items=own)
        items[:] = [x for x in items if x not in own]


@pytest.fixture(autouse=True)
def forgotten():
    """XLA's programs are forgotten after some tests where all runs by XLA: those of a module take up to eleven gigabytes."""
    yield
    if not has_kernels() and next(_TESTS) % 10 == 9:
        import jax

        jax.clear_caches()


@pytest.fixture
def assert_same_bits():
    """A check that arrays have the same bits; by XLA, which rounds each program in its own way, that they differ by at most
    `by_xla`."""
    import numpy as np

    exact = has_kernels()
    return lambda found, wanted, by_xla: np.testing.assert_allclose(found, wanted, rtol=0.0, atol=0.0 if exact else by_xla)


@pytest.fixture
def seconds():
    """How long something may take that is worth so many seconds with kernels: by XLA ten times as long."""
    return lambda count: count if has_kernels() else 10.0 * count


@pytest.fixture
def optimised():
    """XLA's good code, for what runs long by XLA alone."""
    import jax

    jax.config.update("jax_disable_most_optimizations", False)
    yield
    jax.config.update("jax_disable_most_optimizations", True)


@pytest.fixture
def untyped():
    """The library as a user has it: the tests' own types would be the first to refuse mistakes."""
    import jaxtyping

    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@pytest.fixture
def only_kernels(monkeypatch):
    """Refuses what goes to XLA after all: it would be compared with itself. Where there are no kernels, everything does, by a
    program that has numbers of its own."""
    if not has_kernels():
        return
    from jaxik.spmd import handle, host, primitive

    def refused(traced, why):
        raise AssertionError(f"{traced.name}: a kernel cannot do {why}")

    def unused(self, *args, **options):
        raise AssertionError(f"by XLA after all: {self}")

    monkeypatch.setattr(primitive, "warn", refused)
    monkeypatch.setattr(handle.Handle, "_by_xla", unused)
    monkeypatch.setattr(host.HostKernel, "by_xla", unused)
