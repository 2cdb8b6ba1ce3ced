"""One SIMD kernel a function: pure functions of one configuration, compiled for a batch of them on a CPU.

    @spmd.kernel
    def f(x, y): ...            # ordinary jnp, of one configuration

    jax.jit(jax.vmap(f))        # one SIMD function over the batch on a CPU; the same function, by XLA, elsewhere

It knows no robot. In the order in which a function passes through: `trace` (to a jaxpr), `scalarise` and its `rules` (to a
`program` of scalars, with `elementary` functions by polynomials), `emit` (LLVM's language, a vector of lanes at a time: what
is needed and what varies by `liveness`, names, loads and stores by `memory`, instructions by `arithmetic`, all written as
`text`), `handler` (what XLA calls), `denormals` and `threads`, `machine` (machine code), `call` (kept in memory and on disk),
`primitive` (batches, derivatives where `tangents` are linear, lowering). A later process needs no trace where `trace_records`
know a function by its `content`. Without llvmlite a CPU gets the program `by_xla`, in `windows` over the batch.

`host` calls a kernel on NumPy arrays, `repeated` does so again and again on arrays of the same shapes, `handle` for a function
of trees of them, and `control_loop` for one with a state, sample by sample; `describe` says what was made of a function.
`docs/kernels.md` tells it from the beginning.
"""

from jaxik.spmd import constant_widths as constant_widths  # first: before anything is traced; an old JAX is refused
from jaxik.spmd import rules as rules  # which register themselves
from jaxik.spmd.control_loop import ControlLoop, Stepped
from jaxik.spmd.decorator import kernel
from jaxik.spmd.host import HostKernel
from jaxik.spmd.program import Unsupported
from jaxik.spmd.report import KernelReport, describe
from jaxik.spmd.teams import team
from jaxik.spmd.trace import TEAM

__all__ = ["TEAM", "ControlLoop", "HostKernel", "KernelReport", "Stepped", "Unsupported", "describe", "kernel", "team"]
