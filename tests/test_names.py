"""What is public is there after `import jaxik`; names of the release before work, and say where they are now."""

import importlib

import pytest

import jaxik


@pytest.mark.parametrize("name", [name for names in jaxik._MOVED.values() for name in names.split()])
def test_names_of_before(name):
    with pytest.warns(DeprecationWarning, match=rf"jaxik\.{name} is jaxik\.(\w+)\.{name} now"):
        moved = getattr(jaxik, name)
    package = next(package for package, names in jaxik._MOVED.items() if name in names.split())
    assert moved is getattr(getattr(jaxik, package), name)
    assert name not in jaxik.__all__ and name in getattr(jaxik, package).__all__


def test_a_module_of_before():
    with pytest.warns(DeprecationWarning, match=r"jaxik\.crop is jaxik\.harvesting\.crop now"):
        from jaxik.crop import cucumber_row
    assert cucumber_row is jaxik.harvesting.crop.cucumber_row


@pytest.mark.parametrize("package", ["", *(n for n in jaxik.__all__ if hasattr(getattr(jaxik, n), "__path__"))])
def test_a_face_shows_what_it_names(package):
    face = importlib.import_module(f"jaxik.{package}".rstrip("."))
    assert face.__all__ == sorted(set(face.__all__), key=lambda n: (not n.isupper(), not n[0].isupper(), n))
    assert all(hasattr(face, name) for name in face.__all__) and face.__doc__
