"""XML that nobody vouches for: parsed by defusedxml, numbers read with the element's name at hand."""

from __future__ import annotations

import contextlib
from pathlib import Path
from xml.etree.ElementTree import Element, ParseError

import numpy as np
from defusedxml import DefusedXmlException
from defusedxml.ElementTree import fromstring

from jaxik.files.robot_builder import read_bytes
from jaxik.reasons import LoadError

XACRO = "expand it: xacro {0.name} > {0.stem}_expanded.urdf"


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
