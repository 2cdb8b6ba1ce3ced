"""The corners of meshes, boxes around them, and which mesh files a model may name, those of ROS packages, too."""

from __future__ import annotations

import dataclasses
import io
import itertools
import os
from collections.abc import Iterable, Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from jaxik.checks.arrays import numbers, rigid_frame
from jaxik.checks.options import shown
from jaxik.collision.obstacle_kinds import LIMIT
from jaxik.files.documents import MAX_BYTES
from jaxik.files.polygon_files import READERS, read_polygons
from jaxik.files.robot_builder import Link
from jaxik.fitting.link_distance_tables import SECTIONS
from jaxik.fitting.links import Shape
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.shapes import ROUND, prism
from jaxik.reasons import LoadError

PACKAGE = "package://"
MEND = "give the robot's folder that name, pass packages= (--packages), or set ROS_PACKAGE_PATH or AMENT_PREFIX_PATH"
_INNER_FOLDERS = ("urdf", "urdfs", "xacro", "robots", "mjcf", "xml")
FORMATS = (".stl", ".obj", ".ply", ".dae", ".off", ".glb")  # and no archive, whose size says nothing of its content's


def as_packages(who: str, given: Any) -> tuple[Path, ...]:
    """A folder, or a list of them. Raises `ValueError` for what is no folder."""
    many = isinstance(given, Iterable) and not isinstance(given, str | Path)
    folders = [*given] if many else [given]
    for folder in folders:
        if not (isinstance(folder, str | Path) and os.path.isdir(folder)):
            raise ValueError(f"{who}: packages: {shown(folder)} is no folder; give packages, or the folders that hold them")
    return tuple(Path(folder).absolute() for folder in folders)


def package_of(name: str) -> tuple[str, str]:
    """The package of `package://name/rest` (or with a third slash), and the rest."""
    package, _, rest = name.removeprefix(PACKAGE).removeprefix("/").partition("/")
    return package, rest


def in_package(path: Path, where: str, name: str, packages: Iterable[Path]) -> Path | None:
    """The file that such a name means: in the first package of the name that has it, else in the first at all; None without
    any. Packages above the model's file come first, then those of `packages`, then those of ROS's environment."""
    package, rest = package_of(name)
    if ".." in PurePosixPath(rest).parts or package in ("", ".", ".."):
        raise LoadError(path, where, f"file '{name}' leaves its package", "name a file inside it")
    above = [p for p in path.resolve().parents if p.name == package]
    found = [folder / rest for folder in (*above, *_below(package, (*packages, *_environment())))]
    return next((file for file in found if os.path.isfile(file)), found[0] if found else None)


def _below(package: str, folders: Iterable[Path]) -> Iterator[Path]:
    """Folders that are the package, that hold it, or that hold a repository of packages with it."""
    for folder in folders:
        places = (folder, *sorted(folder.iterdir())) if os.access(folder, os.R_OK) and folder.is_dir() else ()
        yield from (p for p in (folder,) if p.name == package)
        yield from (p / package for p in places if os.path.isdir(p / package))


def _environment() -> Iterator[Path]:
    """The folders that ROS 1 and ROS 2 search."""
    for variable, inside in (("ROS_PACKAGE_PATH", ""), ("AMENT_PREFIX_PATH", "share")):
        yield from (Path(folder, inside) for folder in os.environ.get(variable, "").split(os.pathsep) if folder)


# A ROS package keeps its model in urdf/ and its meshes beside that folder, so the model's folder is then the package's.


@dataclasses.dataclass
class Meshes:
    """Collects collision shapes: `fitted` ones are collected here while a file is read, in the frames of their links; otherwise
    a mesh becomes the smallest box around it, if it is `read` at all. Spheres and capsules stay what they are. `packages` are
    where meshes of ROS packages may lie."""

    read: bool
    fitted: bool
    packages: tuple[Path, ...] = ()
    found: list[tuple[str, Shape]] = dataclasses.field(default_factory=list)

    def mesh(self, owner: str, link: Link, origin: np.ndarray, shape: Shape) -> None:
        """A shape in the frame `origin`, of a link whose number is not yet known."""
        if self.fitted:
            if shape.faces is not None:  # of STL each triangle has its own corners: those that are the same stay so when moved
                corners, number = np.unique(shape.corners, axis=0, return_inverse=True)
                shape = shape._replace(corners=corners, faces=number.reshape(-1)[shape.faces])
            self.found.append((owner, shape.moved(origin)))
        else:
            import trimesh  # half a second to import, and only meshes need it

            to_origin, extents = trimesh.bounds.oriented_bounds(shape.corners)  # of the smallest box around
            link.boxes.append((origin @ np.linalg.inv(to_origin), np.asarray(extents) / 2.0))

    def shapes(self, robot: Robot) -> list[Shape]:
        """The collected shapes, in the frames of the robot's joints."""
        found = []
        for owner, shape in self.found:
            if owner in robot.link_names:
                link = robot.link_names.index(owner)
                found.append(shape.moved(np.asarray(robot.link_offset[link]))._replace(link=link))
        return found


def add_box(meshes: Meshes, owner: str, link: Link, origin: np.ndarray, half: np.ndarray) -> None:
    """A box, to be fitted like a mesh where meshes are."""
    if meshes.fitted:
        meshes.mesh(owner, link, origin, Shape(0, "box", half * [*itertools.product((-1.0, 1.0), repeat=3)]))
    else:
        link.boxes.append((origin, half))


def add_capsule(link: Link, origin: np.ndarray, radius: float, half: float) -> None:
    """A capsule about its frame's z."""
    link.volumes.append((origin[:3, 3] + np.outer([-half, half], origin[:3, 2]), radius))


def add_cylinder(meshes: Meshes, owner: str, link: Link, origin: np.ndarray, radius: float, half: float) -> None:
    """A cylinder about its frame's z, as a prism around it where meshes are fitted; a box otherwise."""
    if meshes.fitted:
        coarse = prism(radius + ROUND, half, SECTIONS)[: 2 * SECTIONS, 0]  # which holds the fine one
        meshes.mesh(owner, link, origin, Shape(0, "cylinder", coarse, fine=prism(radius, half)))
    else:
        link.boxes.append((origin, np.array([radius, radius, half])))


def home(path: Path) -> Path:
    """The folder that a model's files lie below."""
    folder = path.resolve().parent
    return folder.parent if folder.name in _INNER_FOLDERS else folder


def resolve(path: Path, where: str, name: str, below: Path | None = None, packages: Sequence[Path] = ()) -> Path | None:
    """The file that a mesh name means: one of a package for `package://name/...`, None where there is no such package; else a
    path below the model's own folder (or `below`). What lies outside of that folder is refused, also by way of a link; a name
    that leads out of its package, too, but a package's links are followed: workspaces (colcon's `--symlink-install`) are made
    of them."""
    folder, root = path.resolve().parent, below or home(path)
    if name.startswith(PACKAGE):
        return in_package(path, where, name, packages)
    if "://" in name and not name.startswith("file://"):
        raise LoadError(path, where, f"file '{name}' is no file", "give a path or package://")
    try:
        target = (folder / name.removeprefix("file://")).resolve()
    except (OSError, ValueError, RuntimeError):
        raise LoadError(path, where, f"file '{name}' is no path", "give a path below the model's folder") from None
    if not target.is_relative_to(root):
        raise LoadError(path, where, f"file '{name}' lies outside the model's folder", f"move it below {root.name}/")
    return target


def load_mesh(path: str | Path, *, frame: Any = None, scale: Any = 1.0) -> np.ndarray:
    """The triangles (k, 3, 3) [m] of a mesh file, for a scene: `SceneBuilder.add(name, triangles=load_mesh("pot.stl"))`. Host.

    `scale` is a metre's part that the file's unit is (0.001: millimetres), or one along each axis; `frame` (4, 4) is where the
    mesh's own frame is in the world. Raises `LoadError`, one line, for what cannot be read as a surface, and
    `ValueError` for another frame or scale.
    """
    frame = np.eye(4) if frame is None else np.asarray(rigid_frame("load_mesh: frame", frame))
    factor = numbers("load_mesh: scale", scale)
    if factor.shape not in ((), (3,)) or not (np.isfinite(factor) & (factor > 0.0)).all():
        raise ValueError(f"load_mesh: scale is {shown(scale)}; allowed: one number above zero, or three")
    path = Path(path)
    if not os.path.isfile(path):
        raise LoadError(path, "mesh", "is not found", "check the path")
    points, faces = _parsed(path, "mesh", path.name, path, np.broadcast_to(factor, 3))
    return (points @ frame[:3, :3].T + frame[:3, 3])[faces]


def read_mesh(
    path: Path, where: str, name: str, scale: np.ndarray, packages: Sequence[Path] = ()
) -> tuple[np.ndarray, np.ndarray]:
    """The corners of a mesh (p, 3) [m], in its frame, and its triangles (f, 3)."""
    target = resolve(path, where, name, packages=packages)
    if target is None or not os.path.isfile(target):
        package = f"no folder above the file is called '{package_of(name)[0]}': {MEND}"
        mend = (
            f"{f'put it at {target}' if target else package}, or load with meshes=False (--no-meshes) for the kinematics alone"
        )
        raise LoadError(path, where, f"mesh '{name}' is not found", mend)
    if not np.all(scale):
        given = " ".join(f"{each:g}" for each in scale)
        raise LoadError(path, where, f"mesh '{name}': scale '{given}' makes it flat", "write three numbers other than 0")
    return _parsed(path, where, name, target, scale)


def _parsed(path: Path, where: str, name: str, target: Path, scale: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if target.stat().st_size > 4 * MAX_BYTES:
        raise LoadError(path, where, f"mesh '{name}' is larger than {4 * MAX_BYTES} bytes", "simplify it")
    if target.suffix.lower() not in FORMATS:
        raise LoadError(path, where, f"mesh '{name}': ending '{target.suffix}'", f"allowed: {', '.join(FORMATS)}")
    if target.suffix.lower() == ".dae" and find_spec("collada") is None:
        raise LoadError(path, where, f"mesh '{name}': reading DAE needs pycollada", 'pip install "jaxik[dae]"')
    try:
        points, faces = _read(target.suffix.lower(), target.read_bytes())
        points = points * scale
        faces = faces[:, ::-1] if np.prod(np.sign(scale)) < 0.0 else faces  # mirrored, they would be inside out
        if not len(points) or not np.all(np.isfinite(points)):
            raise ValueError("no corners, or such that are not finite")
        if np.any((faces < 0) | (faces >= len(points))):
            raise ValueError("triangles of corners that it has not")
    except Exception as error:  # a parser for every format: whatever it raises is the file's fault
        problem = f"mesh '{name}' cannot be read ({type(error).__name__})"
        raise LoadError(path, where, problem, "give STL, OBJ, PLY or DAE") from None
    if (far := float(np.abs(points).max())) > LIMIT:
        raise LoadError(path, where, f"mesh '{name}' reaches {far:g} m; allowed: {LIMIT:g} m", "give its scale, 0.001 for mm")
    if not np.ptp(points, axis=0).any():
        raise LoadError(path, where, f"mesh '{name}' is a single point", "give a scale other than 0")
    return points, faces


def _read(kind: str, content: bytes) -> tuple[np.ndarray, np.ndarray]:
    """The corners (p, 3) and the triangles (f, 3) of a mesh file; by its bytes, for it may name other files, anywhere."""
    if kind in READERS:
        return read_polygons(kind, content)
    import trimesh

    mesh: Any = trimesh.load(io.BytesIO(content), file_type=kind[1:], force="mesh", process=False)
    return np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces).reshape(-1, 3)
