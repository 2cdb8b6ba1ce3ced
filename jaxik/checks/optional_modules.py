"""Modules that only some need: an extra of the package installs them."""

from __future__ import annotations

import importlib
from types import ModuleType


def optional(who: str, name: str, extra: str) -> ModuleType:
    """The module `name`, for `who`. Raises a `ValueError` of one line that names the `extra` where it is not installed."""
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name != name.partition(".")[0]:  # it is there, and lacks something itself
            raise
        raise ValueError(f"{who} needs {error.name}, which is not installed; pip install 'jaxik[{extra}]'") from None
