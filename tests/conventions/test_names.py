"""Public names are there after `import jaxik`, and say where they run."""

import importlib
import inspect
import re
import subprocess
import sys

import pytest

import jaxik


def test_late_packages_are_there_when_asked_for():
    late = [f"jaxik.{package}" for package in jaxik._LATE]
    asked = f"import sys, jaxik; assert not {{*{late}}} & {{*sys.modules}}; [getattr(jaxik, name) for name in dir(jaxik)]"
    subprocess.run([sys.executable, "-c", asked], check=True)


@pytest.mark.parametrize("package", ["", *(n for n in jaxik.__all__ if hasattr(getattr(jaxik, n), "__all__"))])
def test_a_face_shows_what_it_names(package):
    face = importlib.import_module(f"jaxik.{package}".rstrip("."))
    assert face.__all__ == sorted(set(face.__all__), key=lambda n: (not n.isupper(), not n[0].isupper(), n))
    assert all(hasattr(face, name) for name in face.__all__) and face.__doc__


@pytest.mark.parametrize("package", ["", *(n for n in jaxik.__all__ if hasattr(getattr(jaxik, n), "__all__"))])
def test_docstrings_say_where_they_run(package):
    """The first paragraph says it, as a sentence of its own; `jaxik` says what the words mean."""
    face = importlib.import_module(f"jaxik.{package}".rstrip("."))
    functions = {name: inspect.unwrap(getattr(face, name)) for name in face.__all__}
    first = {name: inspect.getdoc(f).partition("\n\n")[0] for name, f in functions.items() if inspect.isfunction(f)}
    silent = [
        name
        for name, text in first.items()
        if not re.search(r"(?<!\w)(Traced|Host driver|Host)\.(\s|$)", " ".join(text.split()))
    ]
    assert not silent


def test_a_reason_is_its_words():
    reason = jaxik.Reason.OUT_OF_REACH
    assert str(reason) == f"{reason}" == reason.text == "out of reach" and reason == 1 and f"{reason:>14}" == "  out of reach"
