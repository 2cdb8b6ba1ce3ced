"""Docstrings are sentences with a subject, and begin with it."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
HEADLESS = {"As", "At", "By", "From", "In", "It", "Its", "Likewise", "Not", "Of", "So", "That", "Those", "What", "Which"}
FILES = [path for folder in ("jaxik", "batch_eval", "tests", "docs") for path in sorted((ROOT / folder).rglob("*.py"))]


def faults(path):
    """Docstrings of a file whose first word has no subject after it, and sentences of them that begin with "Of"."""
    tree = ast.parse(path.read_text())
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and (text := ast.get_docstring(node)):
            place = f"{path.relative_to(ROOT)}:{getattr(node, 'lineno', 1)} {getattr(node, 'name', 'module')}"
            first = re.match(r"\w+", text)
            if first and first[0] in HEADLESS:
                yield f"{place}: begins with '{first[0]}'"
            if re.search(r"[.;:]\s+Of\b|\n\s*\nOf\b", text):
                yield f"{place}: a sentence begins with 'Of'"


@pytest.mark.parametrize("folder", ["jaxik", "batch_eval", "tests", "docs"])
def test_docstrings_begin_with_their_subject(folder):
    assert not [fault for path in FILES if path.relative_to(ROOT).parts[0] == folder for fault in faults(path)]
