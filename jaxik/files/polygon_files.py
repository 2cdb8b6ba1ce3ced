"""Meshes from files whose faces may have any number of corners: OBJ, OFF, PLY and DAE.

trimesh cuts such a face into a fan from its first corner, which is another face where it is not convex; it reads no binary PLY
whose faces differ in their number of corners, takes an OBJ's negative indices for those from the end of the file, and leaves
a DAE's unit out.
"""

from __future__ import annotations

import io
import itertools
import math
import re
from collections.abc import Callable, Iterable, Iterator
from typing import Any
from xml.etree import ElementTree

import numpy as np
from defusedxml.ElementTree import fromstring

from jaxik.collision.surfaces import ears

Faces = tuple[np.ndarray, np.ndarray]  # which corner of a mesh each corner of a face is (m,), face after face; of how many (f,)
PLY_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
PLY_FACES = ("vertex_indices", "vertex_index")
DAE_PARTS = ("asset", "library_geometries", "library_nodes", "library_visual_scenes", "scene")
DAE_PAINT = ("bind_material", "instance_camera", "instance_light", "extra")
REFLEX = 1e-9  # of its area, that a corner of a face may be turned inwards: rounding
CORNERS = 10_000  # of one face that is not convex


def read_polygons(kind: str, content: bytes) -> tuple[np.ndarray, np.ndarray]:
    """The corners (p, 3) of a mesh file of the ending `kind`, those that a face has, and its triangles (f, 3).

    Raises what comes for a file that is none.
    """
    points, (indices, counts) = READERS[kind](content)
    if not len(counts):
        raise ValueError("no faces")
    if np.any((indices < 0) | (indices >= len(points))):
        raise ValueError("faces of corners that it has not")
    with np.errstate(all="ignore"):  # corners that are not finite, or too far, are refused by who reads
        faces = _triangles(points, indices, counts)
    used, faces = np.unique(faces, return_inverse=True)
    return points[used], faces.reshape(-1, 3)


def _triangles(points: np.ndarray, indices: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """The triangles (f, 3) of faces, in their order. What crosses itself, or has no area, is cut into a fan."""
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    found, order = [np.zeros((0, 3), np.int64)], [np.zeros(0, np.int64)]
    for n in np.unique(counts[counts >= 3]):
        which = np.flatnonzero(counts == n)
        faces = indices[starts[which][:, None] + np.arange(n)]
        fan = np.stack([np.zeros(n - 2, int), np.arange(1, n - 1), np.arange(2, n)], axis=1)
        cut = np.tile(fan, (len(faces), 1, 1))
        inwards = _inwards(points[faces])
        if n == 4:  # from the one corner that is turned inwards both triangles are inside
            start = np.where(inwards.sum(axis=1) == 1, inwards.argmax(axis=1), 0)
            cut = (cut + start[:, None, None]) % 4
        for i in np.flatnonzero(inwards.any(axis=1)) if n > 4 else ():
            cut[i] = _cut(points[faces[i]], fan)
        found.append(np.take_along_axis(faces, cut.reshape(len(faces), -1), axis=1).reshape(-1, 3))
        order.append(np.repeat(which, n - 2))
    return np.concatenate(found)[np.argsort(np.concatenate(order), kind="stable")]


def _inwards(corners: np.ndarray) -> np.ndarray:
    """Whether the corners (k, n) of faces (k, n, 3) are turned inwards."""
    normal, along = _normals(corners), np.roll(corners, -1, axis=1) - corners
    turns = np.einsum("kni,ki->kn", np.cross(np.roll(along, 1, axis=1), along), normal)
    return np.asarray(turns < -REFLEX * np.sum(normal**2, axis=1)[:, None])


def _normals(corners: np.ndarray) -> np.ndarray:
    """The normals (k, 3) of faces, twice as long as their areas [Newell]."""
    centred = corners - corners.mean(axis=1, keepdims=True)
    return np.cross(centred, np.roll(centred, -1, axis=1)).sum(axis=1)


def _cut(corners: np.ndarray, fan: np.ndarray) -> np.ndarray:
    """The triangles of one face, as seen along its normal: files round, and faces are warped."""
    if len(corners) > CORNERS:
        raise ValueError(f"a face of {len(corners)} corners that is not convex")
    found = ears(corners - corners.mean(axis=0), _normals(corners[None])[0])
    return fan if found is None else np.asarray(found)


def _flat(faces: Iterable[Any]) -> Faces:
    """Faces of a sequence of sequences."""
    each = [*faces]
    counts = np.fromiter(map(len, each), np.int64, len(each))
    return np.fromiter(itertools.chain.from_iterable(each), np.int64, int(counts.sum())), counts


def _obj(content: bytes) -> tuple[np.ndarray, Faces]:
    """An index counts from 1, a negative one back from the last corner so far; behind a / are those of textures and normals."""
    points: list[list[str]] = []
    faces: list[list[int]] = []
    for line in content.decode("utf-8", "replace").replace("\\\r\n", " ").replace("\\\n", " ").splitlines():
        key, *words = line.partition("#")[0].split() or [""]
        if key == "v":
            points.append(words[:3])
        elif key == "f":
            each = [int(word.partition("/")[0]) for word in words]
            faces.append([i - 1 if i > 0 else len(points) + i if i < 0 else -1 for i in each])
    return np.array(points, np.float64).reshape(-1, 3), _flat(faces)


def _off(content: bytes) -> tuple[np.ndarray, Faces]:
    """Header, counts, a line for each corner and each face; colours and normals behind the numbers are not read."""
    lines = [words for line in content.decode("utf-8", "replace").splitlines() if (words := line.partition("#")[0].split())]
    if not lines or not re.fullmatch("(ST)?C?N?OFF", lines[0][0]):
        raise ValueError("no OFF")
    rows = [lines[0][1:], *lines[1:]] if lines[0][1:] else lines[1:]
    corners, faces = (int(word) for word in rows[0][:2])
    rows = rows[1:]
    if min(corners, faces) < 0 or len(rows) < corners + faces:
        raise ValueError("fewer lines than it says")
    points = np.array([row[:3] for row in rows[:corners]], np.float64).reshape(-1, 3)
    rows = rows[corners : corners + faces]
    if any(not 0 <= int(row[0]) < len(row) for row in rows):
        raise ValueError("fewer corners than it says")
    return points, _flat([int(i) for i in row[1 : 1 + int(row[0])]] for row in rows)


def _ply(content: bytes) -> tuple[np.ndarray, Faces]:
    header = re.match(rb"ply\s.*?\nend_header[^\n]*\n", content, re.DOTALL)
    if header is None:
        raise ValueError("no PLY")
    body, order = content[header.end() :], ""
    elements: list[tuple[str, int, dict[str, tuple[str, ...]]]] = []
    for key, *words in (line.split() for line in header[0].decode("ascii", "replace").splitlines() if line.strip()):
        if key == "format":
            order = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "="}[words[0]]
        elif key == "element":
            elements.append((words[0], int(words[1]), {}))
        elif key == "property":
            elements[-1][2][words[-1]] = tuple(order + PLY_TYPES[word] for word in words[words[0] == "list" : -1])
    if order == "=":  # each number is one of a binary file
        body = np.array(body.split(), np.float64).tobytes()
    columns: dict[str, dict[str, Any]] = {}
    at = 0
    for name, count, properties in elements:
        if order == "=":
            properties = {key: ("f8",) * len(types) for key, types in properties.items()}
        if properties and {"vertex", "face"} - {*columns}:
            columns[name], at = _element(body, at, count, properties)
    vertex, face = columns["vertex"], columns["face"]
    lists = {key: value for key, value in face.items() if isinstance(value, tuple)}
    key = next((key for key in PLY_FACES if key in lists), None) or next(iter(lists))
    return np.stack([np.asarray(vertex[axis], np.float64) for axis in "xyz"], axis=1), lists[key]


def _element(body: bytes, at: int, count: int, properties: dict[str, tuple[str, ...]]) -> tuple[dict[str, Any], int]:
    """The columns of `count` rows from a byte on, and where they end: numbers, or entries and how many a row has."""
    if not 0 <= count <= len(body) - at:
        raise ValueError("fewer rows than it says")
    if not count:
        return {key: (np.zeros(0, int),) * 2 if types[1:] else np.zeros(0) for key, types in properties.items()}, at
    row, end = _row(body, at, properties)
    kind = np.dtype([field for key, types in properties.items() for field in _fields(key, types, len(row[key]))])
    if at + count * kind.itemsize <= len(body):
        rows = np.frombuffer(body, kind, count, at)
        if all(np.all(rows[f"{key} count"] == len(row[key])) for key, types in properties.items() if types[1:]):
            lists = lambda key: (rows[key].reshape(-1).astype(np.int64), np.full(count, len(row[key])))
            return {k: lists(k) if types[1:] else rows[k] for k, types in properties.items()}, at + count * kind.itemsize
    every = [row]
    for _ in range(count - 1):  # rows of different lengths
        row, end = _row(body, end, properties)
        every.append(row)
    column = lambda key: [row[key] for row in every]
    return {key: _flat(column(key)) if types[1:] else np.ravel(column(key)) for key, types in properties.items()}, end


def _fields(key: str, types: tuple[str, ...], length: int) -> list[tuple[Any, ...]]:
    """The fields of a PLY element: numbers, or lists, whose length comes first."""
    return [(f"{key} count", types[0]), (key, types[1], (length,))] if types[1:] else [(key, types[0])]


def _row(body: bytes, at: int, properties: dict[str, tuple[str, ...]]) -> tuple[dict[str, np.ndarray], int]:
    """One row from a byte on, and where it ends."""
    found = {}
    for key, types in properties.items():
        count = 1
        for kind in types:  # a list has its length first
            values = np.frombuffer(body, kind, count, at)
            at += values.nbytes
            count = int(values[0]) if len(values) else 0
        found[key] = values
    return found, at


def _dae(content: bytes) -> tuple[np.ndarray, Faces]:
    """All geometry of the scene, where its nodes place it, in metres; which way is up does not count, as in RViz."""
    import collada

    scene = collada.Collada(io.BytesIO(_bare(content)), ignore=[collada.common.DaeError])
    if scene.errors:
        raise scene.errors[0]
    unit = 1.0 if scene.assetInfo.unitmeter is None else scene.assetInfo.unitmeter
    if not 0.0 < unit < math.inf:
        raise ValueError(f"unit of {unit} m")
    points, faces, counts, before = [np.zeros((0, 3))], [np.zeros(0, int)], [np.zeros(0, int)], 0
    for part, placed in _parts(scene.scene.nodes, np.eye(4)):
        index = np.asarray(part.vertex_index, np.int64).reshape(-1)
        many = np.diff(part.polyindex, axis=1).ravel() if hasattr(part, "polyindex") else np.full(len(index) // 3, 3)
        if np.any((index < 0) | (index >= len(part.vertex))):
            raise ValueError("faces of corners that it has not")
        if np.linalg.det(placed[:3, :3]) < 0.0:  # a mirror, which turns what is counter-clockwise
            index, many = index[::-1], many[::-1]
        points.append(part.vertex @ placed[:3, :3].T + placed[:3, 3])
        faces.append(index + before)
        counts.append(many)
        before += len(part.vertex)
    return unit * np.concatenate(points), (np.concatenate(faces), np.concatenate(counts))


def _parts(nodes: Iterable[Any], placed: np.ndarray) -> Iterator[tuple[Any, np.ndarray]]:
    """The geometries with faces below the nodes of a DAE, and where they are placed."""
    import collada

    for node in nodes:
        if isinstance(node, collada.scene.GeometryNode):
            for part in node.geometry.primitives:
                if isinstance(part, collada.polylist.Polylist | collada.triangleset.TriangleSet) and part.vertex is not None:
                    yield part, placed
        elif isinstance(node, collada.scene.Node):
            yield from _parts(node.children or (), placed @ node.matrix)


def _bare(content: bytes) -> bytes:
    """A DAE without what is painted, lit and filmed: pycollada leaves out the geometry whose material it does not find."""
    root = fromstring(content)
    kind = lambda element: element.tag.rpartition("}")[2]
    for element in [*root.iter()]:
        if kind(element) == "instance_controller":
            raise ValueError("a skin")
        for part in [*element]:
            if kind(part) in DAE_PAINT or (element is root and kind(part) not in DAE_PARTS):
                element.remove(part)
    return ElementTree.tostring(root)


READERS: dict[str, Callable[[bytes], tuple[np.ndarray, Faces]]] = {".obj": _obj, ".off": _off, ".ply": _ply, ".dae": _dae}
