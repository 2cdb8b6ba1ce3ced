"""Rows in blocks on the threads of the process, and of a process that was forked from it."""

import os
import subprocess
import sys

import numpy as np
import pytest
from jax import lax

from jaxik.spmd import TEAM, HostKernel, batch, team
from jaxik.spmd.program import Unsupported

WHILE_MADE = """
import gc, os, signal, threading
import jax.numpy as jnp
import numpy as np
from jaxik.spmd import HostKernel, host

x, trace, begun, go_on = np.ones((3, 2)), host.trace, threading.Event(), threading.Event()

def slowly(*args):
    begun.set()
    go_on.wait()
    return trace(*args)

host.trace = slowly
kernel = HostKernel(lambda x: x * 5.0, 1)
maker = threading.Thread(target=lambda: kernel.run(x))
maker.start()
begun.wait()
child = os.fork()
go_on.set()
if child == 0:
    signal.alarm(20)
    os._exit(0 if gc.isenabled() and (kernel.run(x)[0] == 5.0).all() else 1)
status = os.waitpid(child, 0)[1]
maker.join()
assert (kernel.run(x)[0] == 5.0).all()
print("child", os.waitstatus_to_exitcode(status))
"""


FORKED = """
import os, signal, threading
import numpy as np
from jaxik.spmd.batch import in_blocks
from jaxik.ik.refinement import compile_finisher

rows, opened = np.arange(100.0), threading.Event()
twice = lambda: np.array_equal(in_blocks(lambda x: 2.0 * x, rows, size=10)[0], 2.0 * rows)

def program(q, *others):
    opened.wait()
    return q

assert twice()
waits = compile_finisher(program, 7)
child = os.fork()
if child == 0:
    signal.alarm(20)
    opened.set()
    os._exit(0 if twice() and len(compile_finisher(program, 7).result()) == 1 else 1)
status = os.waitpid(child, 0)[1]
opened.set()
assert twice() and waits.result()
print("child", os.waitstatus_to_exitcode(status))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
@pytest.mark.parametrize("code", [FORKED, pytest.param(WHILE_MADE, marks=pytest.mark.kernels(reason="one is being made"))])
def test_threads_live_in_a_fork(code):
    """The fork of a process whose threads have run, with work under way, begins its own anew. JAX's do not, and it warns."""
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert found.stdout == "child 0\n", (found.stdout, found.stderr)


def halved(x, share):
    return lax.while_loop(lambda state: state > 2.0, lambda state: share * state, x[0])


def refused(*args, **options):
    raise Unsupported("no kernel, for once")


@pytest.mark.parametrize("double", [False, True])
def test_floats_of_both_widths_come_in_the_one_that_is_asked(monkeypatch, double):
    """A loop by XLA that carries one width cannot end in another."""
    monkeypatch.setattr(HostKernel, "run", refused)
    rows = np.full((3, 1), 5.0, np.float32)
    (found,) = batch.in_blocks(HostKernel(halved, 1), rows, fixed=(np.float64(0.5),), double=double)
    assert found.dtype == (np.float64 if double else np.float32)
    np.testing.assert_array_equal(found, 1.25)


def test_a_team_goes_by_xla_too(monkeypatch):
    monkeypatch.setattr(HostKernel, "run", refused)
    summed = team(lambda x: lax.psum(x[lax.axis_index(TEAM)], TEAM))
    (found,) = batch.in_blocks(HostKernel(summed, 1), np.arange(48.0).reshape(3, 16), double=True)
    np.testing.assert_array_equal(found, np.arange(48.0).reshape(3, 16).sum(axis=1))
