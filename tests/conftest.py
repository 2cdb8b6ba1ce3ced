"""jaxtyping shapes are checked by beartype in every test; float64 is on, and float32 is asked for where it is judged."""

from jaxtyping import install_import_hook

with install_import_hook("jaxik", "beartype.beartype"):
    import jaxik  # noqa: F401

import os
import tempfile
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)
# the processes of one run share what they compile; nothing is left over from another run
run = os.environ.get("PYTEST_XDIST_TESTRUNUID", str(os.getpid()))
jax.config.update("jax_compilation_cache_dir", str(Path(tempfile.gettempdir()) / f"jaxik-tests-{run}"))
