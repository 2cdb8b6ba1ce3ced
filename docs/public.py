"""Public names of the library, and whether the reference has them."""

from __future__ import annotations

import importlib
import inspect
import types
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]


def packages() -> list[str]:
    """The library's packages, and the module that is one: what the reference has a page for."""
    inside = {path.parent.name for path in (ROOT / "jaxik").glob("*/__init__.py")} | {"costs"}
    return sorted(inside - {"checks", "cli"})  # what a caller gives, and the commands, which have a page: nobody calls them


def names(package: str) -> dict[str, Any]:
    """The names that the face of a package shows, without modules."""
    face = importlib.import_module(f"jaxik.{package}")
    public = {name: getattr(face, name) for name in getattr(face, "__all__", ())}
    return {name: what for name, what in public.items() if not isinstance(what, types.ModuleType)}


def faults() -> list[str]:
    """Packages without a page, and names without a docstring."""
    found = []
    for package in packages():
        page = ROOT / "docs" / "api" / f"{package}.md"
        if not page.exists() or f"::: jaxik.{package}" not in page.read_text():
            found.append(f"jaxik.{package} has no page docs/api/{package}.md")
        found += [f"jaxik.{package}.{name} has no docstring" for name, what in names(package).items() if not _documented(what)]
    return found


def _documented(what: Any) -> bool:
    """Whether it has words of its own: a `NamedTuple` or a dataclass without any is given its signature."""
    if not callable(what):
        return True  # a constant stands on the page of its package
    own = (what.__doc__ or "").strip()
    return bool(own) and not own.startswith(f"{what.__name__}(")


def main() -> None:
    """Prints every public name, a callable with its signature, and what the reference lacks."""
    count = 0
    for package in packages():
        print(f"\njaxik.{package}")
        for name, what in names(package).items():
            count += 1
            plain = not callable(what) or (inspect.isclass(what) and issubclass(what, Exception))
            print(f"  {name}{'' if plain else inspect.signature(inspect.unwrap(what))}")
    print(f"\n{count} names; {'; '.join(faults()) or 'all documented'}")


if __name__ == "__main__":
    main()
