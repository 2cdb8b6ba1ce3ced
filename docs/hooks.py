"""What mkdocs is told beside `mkdocs.yml`: where the notebooks lie, and that each public name has a docstring and a page."""

from __future__ import annotations

import importlib
import inspect
import types
from pathlib import Path
from typing import Any

from mkdocs.exceptions import PluginError
from mkdocs.plugins import event_priority
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]


@event_priority(100)  # before mkdocs-jupyter looks for them
def on_files(files: Files, config: Any) -> Files:
    """The notebooks, which lie beside this folder."""
    for path in sorted((ROOT / "notebooks").glob("*.ipynb")):
        files.append(File(f"notebooks/{path.name}", str(ROOT), config.site_dir, config.use_directory_urls))
    return files


def on_pre_build(config: Any) -> None:
    """Raises where a public name has no docstring, or a package no page."""
    faults = [fault for package in packages() for fault in _faults(package)]
    if faults:
        raise PluginError("; ".join(faults))


def packages() -> list[str]:
    """The library's packages, and modules that are one: what the reference has a page for."""
    inside = {path.parent.name for path in (ROOT / "jaxik").glob("*/__init__.py")} | {"costs"}
    return sorted(inside - {"checks"})  # of what a caller gives: no caller's own


def _faults(package: str) -> list[str]:
    face = importlib.import_module(f"jaxik.{package}")
    page = ROOT / "docs" / "api" / f"{package}.md"
    missing = [] if page.exists() and f"::: jaxik.{package}" in page.read_text() else [f"jaxik.{package} has no page {page.name}"]
    public = {name: getattr(face, name) for name in getattr(face, "__all__", ())}
    return missing + [f"jaxik.{package}.{name} has no docstring" for name, what in public.items() if not documented(what)]


def documented(what: Any) -> bool:
    """Whether it has words of its own: a `NamedTuple` or a dataclass without any gets its signature."""
    if isinstance(what, types.ModuleType) or inspect.isclass(what) or callable(what):
        own = (what.__doc__ or "").strip()
        return bool(own) and not own.startswith(f"{getattr(what, '__name__', '')}(")
    return True  # a constant stands in the page of its package
