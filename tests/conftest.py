"""jaxtyping shapes are checked by beartype in every test; float64 is on, and float32 is asked for where it is judged."""

from jaxtyping import install_import_hook

with install_import_hook("jaxik", "beartype.beartype"):
    import jaxik  # noqa: F401

import jax

jax.config.update("jax_enable_x64", True)
