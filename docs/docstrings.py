"""How docstrings become pages (a Griffe extension): fields as lists, names as links, and how a result or a pytree is made."""

from __future__ import annotations

import importlib
import inspect
import re
import sys
from pathlib import Path
from typing import Any

import griffe

sys.path.insert(0, str(Path(__file__).parent))
from public import names, packages

FIELD = re.compile(r"^([a-z_]+(?: \[[\w, /]+\])?(?:, [a-z_]+(?: \[[\w, /]+\])?)*): ")
QUOTED = re.compile(r"(?<![\[`])`(?:jaxik\.)?([\w.]+)`(?![\]`])")


def links() -> dict[str, str]:
    """Where public names stand in the reference, by the name alone and with their package's."""
    found: dict[str, str] = {}
    for package in packages():
        for name in names(package):
            found[name] = found[f"{package}.{name}"] = f"jaxik.{package}.{name}"
    return found


class Docstrings(griffe.Extension):
    """Rewrites what is in docstrings before it is rendered."""

    def __init__(self) -> None:
        self.links = links()

    def on_object(self, *, obj: griffe.Object, **kwargs: Any) -> None:
        if obj.is_alias or obj.docstring is None:
            return
        own = {p.name for p in obj.parameters} if obj.is_function else set(obj.members)
        if _bases(obj) & {"Options"}:  # the fields say what they are themselves
            made = getattr(importlib.import_module(obj.module.path), obj.name)
            obj.docstring.value = inspect.cleandoc(made.__doc__)
        blocks = [self._block(text, own) for text in obj.docstring.value.split("\n\n")]
        obj.docstring.value = "\n\n".join([*_made(obj), *blocks])

    def _block(self, text: str, own: set[str]) -> str:
        """A paragraph, its public names linked but for those of the object's `own` fields or arguments. One of fields, `name:
        what it is`, with the rest of each indented, is a list."""
        lines = text.split("\n")
        if text.startswith("    "):
            return text  # a formula, shown as it stands
        if all(FIELD.match(line) or line.startswith("    ") for line in lines):
            lines = [FIELD.sub(r"- **\1**: ", line) for line in lines]
        return QUOTED.sub(lambda quoted: quoted[0] if quoted[1] in own else self._link(quoted), "\n".join(lines))

    def _link(self, quoted: re.Match[str]) -> str:
        name = quoted[1].removesuffix("()")
        return f"[{quoted[0]}][{self.links[name]}]" if name in self.links else quoted[0]


def _made(obj: griffe.Object) -> list[str]:
    """How a class is made whose fields make its constructor, where Griffe does not see that; the members of an enumeration."""
    if not obj.is_class:
        return []
    bases = _bases(obj)
    fields = [m for m in obj.members.values() if not m.is_alias and m.is_attribute and not m.name.startswith("_")]
    fields = [m for m in fields if "property" not in m.labels]
    if bases & {"NamedTuple", "Module", "Constant", "Pytree", "Result"}:
        each = [
            f"{f.name}: {f.annotation}" + ("" if f.value is None or "field(" in str(f.value) else f" = {f.value}")
            for f in fields
        ]
        return ["```python\n" + f"{obj.name}(\n    " + ",\n    ".join(each) + "\n)\n```"]
    if bases & {"IntEnum", "Enum"}:
        return ["```python\n" + "\n".join(f"{obj.name}.{f.name}" for f in fields) + "\n```"]
    return []


def _bases(obj: griffe.Object) -> set[str]:
    return {str(base).split(".")[-1].split("(")[0] for base in obj.bases} if obj.is_class else set()
