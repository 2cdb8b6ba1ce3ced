"""Rows in blocks on the threads of the process, and of a process that was forked from it."""

import os
import subprocess
import sys

import pytest

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
def test_threads_live_in_a_fork():
    """The fork of a process whose threads have run, with work under way, begins its own anew. JAX's do not, and it warns."""
    found = subprocess.run([sys.executable, "-c", FORKED], capture_output=True, text=True, timeout=120)
    assert found.stdout == "child 0\n", (found.stdout, found.stderr)
