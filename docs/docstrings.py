"""How docstrings become pages (a Griffe extension): lists of fields as lists, and names as links."""

from __future__ import annotations

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
        if obj.docstring is not None:
            obj.docstring.value = "\n\n".join(map(self._block, obj.docstring.value.split("\n\n")))

    def _block(self, text: str) -> str:
        """A paragraph; one of fields, `name: what it is`, with the rest of each indented, is a list."""
        lines = text.split("\n")
        if text.startswith("    "):
            return text  # a formula, shown as it stands
        if all(FIELD.match(line) or line.startswith("    ") for line in lines):
            lines = [FIELD.sub(r"- **\1**: ", line) for line in lines]
        return QUOTED.sub(self._link, "\n".join(lines))

    def _link(self, quoted: re.Match[str]) -> str:
        name = quoted[1].removesuffix("()")
        return f"[{quoted[0]}][{self.links[name]}]" if name in self.links else quoted[0]
