"""Files: where one that is named lies, its bytes, its XML, which nobody vouches for, and text that is written to one; or the
one line that says why not."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import BinaryIO
from xml.etree.ElementTree import Element, ParseError

import numpy as np
from defusedxml import DefusedXmlException
from defusedxml.ElementTree import fromstring

from jaxik.checks.options import among, optional, shown
from jaxik.reasons import LoadError

MAX_BYTES = 16 * 2**20  # of a robot or scene file; a mesh may have four times that
XACRO = "expand it: xacro {0.name} > {0.stem}_expanded.urdf"


def models_folder() -> Path:
    """Where the shipped robots and scenes lie: inside the wheel, or beside the package in a checkout. Host."""
    inside = Path(__file__).parents[1] / "models"
    return inside if inside.is_dir() else Path(__file__).parents[2] / "models"


def locate(source: str | Path, what: str = "robot") -> Path:
    """The file of a shipped robot or scene, by its name; a path with an ending is the file itself."""
    path = Path(source)
    if path.suffix:
        return path
    folder = models_folder() / "scenes" if what == "scene" else models_folder()
    shipped = {p.stem: p for p in sorted(folder.glob("*.toml"))}
    if str(source) in shipped:
        return shipped[str(source)]
    if os.path.exists(path):  # of a name that no file can have, too
        return path  # to be told that a file needs an ending
    mend = among(str(source).lower(), list(shipped), "shipped", len(shipped))
    raise LoadError(shown(source), what, f"no such shipped {what}", f"{mend}; or give a file")


@contextlib.contextmanager
def opened(path: Path, most: int = MAX_BYTES) -> Iterator[BinaryIO]:
    """The file, to read its bytes; or the one line that says why not."""
    if "\0" in str(path):
        raise LoadError(repr(str(path)), "file", "cannot be read (its name holds a null character)", "check the path")
    try:
        size = path.stat().st_size
        if size > most:
            raise LoadError(path, "file", f"{size} bytes", f"at most {most} are read")
        with path.open("rb") as file:
            yield file
    except OSError as error:
        raise LoadError(path, "file", f"cannot be read ({error.strerror or error})", "check the path") from None


def content_of(
    who: str, path: Path, readers: Collection[str], needs: dict[str, tuple[str, str]], most: int
) -> tuple[str, bytes]:
    """The ending of a file, one of those of which there are `readers`, and its bytes; `needs` are the module and the extra that
    some endings need. Raises `LoadError` for another ending, and as `opened`; `ValueError` for a module that is missing."""
    if (kind := path.suffix.lower()) not in readers:
        raise LoadError(path, "file", f"ending '{kind}'", f"allowed: {', '.join(readers)}")
    if kind in needs:
        optional(f"{who}: {kind}", *needs[kind])
    with opened(path, most) as file:
        return kind, file.read()


def read_bytes(path: Path) -> bytes:
    """The file's content, or the one line that says why not."""
    with opened(path) as file:
        return file.read()


def write_text(who: str, path: Path, text: str) -> None:
    """Raises `ValueError`, one line, where the file cannot be written."""
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        mend = "name a file in a folder that is there"
        raise ValueError(f"{who}: {path}: cannot be written ({error.strerror}); {mend}") from None


def parse(path: Path, root_tag: str | None) -> Element:
    """The root element; entities, external references and a root of another tag (None: any will do) are refused."""
    content = read_bytes(path)
    try:
        root = fromstring(content, forbid_dtd=True)
    except DefusedXmlException as error:
        problem = f"a document type or entity ({type(error).__name__})"
        raise LoadError(path, "document", problem, "robot files need none: remove the declaration") from None
    except (ParseError, ValueError, LookupError) as error:  # LookupError: an encoding that Python does not know
        mend = XACRO.format(path) if b"<xacro:" in content else "mend the syntax"
        raise LoadError(path, "document", f"malformed XML ({error})", mend) from None
    namespace = root.tag.rpartition("}")[0] + "}"  # a default one, as old files of Drake have it, means nothing here
    for element in root.iter() if len(namespace) > 1 else ():
        element.tag = element.tag.removeprefix(namespace)
    if root_tag is not None and root.tag != root_tag:
        raise LoadError(path, f"element <{root.tag}>", f"the root is not <{root_tag}>", f"give a file with <{root_tag}>")
    return root


def numbers(path: Path, where: str, element: Element | None, key: str, default: str | None, count: int) -> np.ndarray:
    """Attribute `key` as `count` finite numbers."""
    text = default if element is None else element.get(key, default)
    if text is None:
        raise LoadError(path, where, f"attribute '{key}' is missing", f"write {count} number(s)")
    with contextlib.suppress(ValueError):
        values = np.array([float(word) for word in text.split()])
        if values.shape == (count,) and np.all(np.isfinite(values)):
            return values
    raise LoadError(path, where, f"attribute '{key}' = '{text[:40]}'", f"write {count} finite number(s)")


def number(path: Path, where: str, element: Element | None, key: str, default: str | None) -> float:
    """Attribute `key` as one finite number, or the default."""
    return float(numbers(path, where, element, key, default, 1)[0])


def attribute(path: Path, where: str, element: Element | None, key: str) -> str:
    """Attribute `key` as a word that is there."""
    value = None if element is None else element.get(key)
    if not value:
        raise LoadError(path, where, f"attribute '{key}' is missing", "write it")
    return value
