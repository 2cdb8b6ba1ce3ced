"""Problems of MotionBenchMaker [Chamzas et al. 2022] for any of its robots, read from a folder given on the command line.

A folder is laid out as VAMP ships them, with nothing renamed:

- the robot: `*_spherized.urdf`, spheres for its links, or else the one `*.urdf` there, whose meshes are then read; `*.srdf`
  says which links are not checked against each other and, by its one `<end_effector>`, where the tip is (or `tip=`);
- the problems: `requestNNNN.yaml` beside `sceneNNNN.yaml`, in any folder below or in a `*.tar.*`, as robowflex writes MoveIt's
  messages. The full data set has `scene_sensedNNNN`, `scene_pcdNNNN`, `pathNNNN` and `config` beside them, which are not read.

A goal is the pose that a goal configuration has, which a request states by `joint_constraints`, in any order; each of several
`goal_constraints` is a goal of its own. Joints beside the chain (another arm, fingers, a head) stand where the first problem
has them; a goal that has them elsewhere says so. An object's shapes stand at the pose of its frame (`fixed_frame_transforms`),
times its own `pose` (which newer files have), times theirs; a pose that is left out, or a quaternion of zeros, is that of the
frame above it, as in MoveIt. What is not known here (meshes, planes, cones, octomaps, attached objects) is refused in one line.
"""

from __future__ import annotations

import re
import tarfile
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

import jaxik

PRIMITIVES = {1: "box", 2: "sphere", 3: "cylinder", 4: "cone", 5: "prism"}  # shape_msgs/SolidPrimitive
SIZES = {"box": "3: the edges", "cylinder": "2: height and radius", "sphere": "1: the radius"}


class Goal(NamedTuple):
    """One goal: its name, the robot's joints there and at the start (n,), NaN where not told, the scene, and joints beside the
    robot that stand elsewhere in this problem than in the first, at which the robot holds them."""

    name: str
    q: np.ndarray
    start: np.ndarray
    scene: jaxik.Scene
    elsewhere: tuple[str, ...] = ()


def load_robot(folder: Path, tip: str | list[str] | None = None) -> jaxik.Robot:
    """The folder's robot with its collision geometry, up to the link `tip`, or the tree of several."""
    urdf, srdf = files(folder)
    read = not urdf.stem.endswith("_spherized")
    load = lambda **how: jaxik.load(urdf, tip=tip or end_effector(srdf), srdf=srdf, **how)
    return load(meshes=read, posture=posture(folder, load(posture={})))


def posture(folder: Path, robot: jaxik.Robot) -> dict[str, float]:
    """Where the first problem has the joints beside the chain [rad, m], inside their limits."""
    texts, held = _texts(folder), {}
    told = _beside(_load(texts[min(_requests(texts))]), robot) if _requests(texts) else {}
    for joint in ET.parse(files(folder)[0]).getroot().iter("joint"):
        name, kind = joint.get("name"), joint.get("type")
        if name in told and kind in ("revolute", "prismatic", "continuous") and joint.find("mimic") is None:
            limit = joint.find("limit") if kind != "continuous" else None
            bounds = (-np.inf, np.inf) if limit is None else (float(limit.get("lower", 0)), float(limit.get("upper", 0)))
            held[name] = float(np.clip(told[name], *bounds))
    return held


def files(folder: Path) -> tuple[Path, Path | None]:
    """The robot's URDF and SRDF; None where there is no SRDF."""
    urdf = _only(folder, "*_spherized.urdf") or _only(folder, "*.urdf")
    if urdf is None:
        raise ValueError(f"{folder}: holds no *_spherized.urdf and no *.urdf; give the folder of one robot")
    return urdf, _only(folder, "*.srdf")


def end_effector(srdf: Path | None) -> str | None:
    """The link that the SRDF's one end effector stands on; None where it names none."""
    found = [] if srdf is None else [str(e.get("parent_link")) for e in ET.parse(srdf).getroot().iter("end_effector")]
    if len(found) > 1:
        raise ValueError(f"{srdf}: end effectors on {', '.join(found)}; say which arm by tip=, for instance {found[0]}")
    return found[0] if found else None


def goals(folder: Path, robot: jaxik.Robot, every: int = 1) -> Iterator[Goal]:
    """All goals, by name, or those of each so many-th problem; a start or goal that the robot's shapes make collide is kept."""
    texts = _texts(folder)
    if not (requests := _requests(texts)):
        raise ValueError(f"{folder}: no requestNNNN.yaml, neither below it nor in a *.tar.* there")
    first: dict[str, float] | None = None
    for name in requests[::every]:
        place = name.rpartition("request")
        scene = f"{place[0]}scene{place[2]}"
        if scene not in texts:
            raise ValueError(f"{name}: no {Path(scene).name} beside it")
        short = "/".join(Path(name).parts[-2:])
        try:
            request = _load(texts[name])
            beside = _beside(request, robot)
            first = beside if first is None else first
            elsewhere = tuple(joint for joint, at in beside.items() if not np.isclose(at, first.get(joint, at)))
            for goal in _goals(short, robot, request, scene_of(_load(texts[scene]))):
                yield goal._replace(elsewhere=elsewhere)
        except (ValueError, KeyError, TypeError, yaml.YAMLError) as error:
            missing = f"'{error.args[0]}' is missing" if isinstance(error, KeyError) else " ".join(str(error).split())
            raise ValueError(f"{folder}: {short} or its scene: {missing}") from None


def _goals(name: str, robot: jaxik.Robot, request: dict[str, Any], scene: jaxik.Scene) -> Iterator[Goal]:
    start = _start(request)
    for i, wanted in enumerate(request["goal_constraints"]):
        others = [key for key, value in wanted.items() if key.endswith("_constraints") and key != "joint_constraints" and value]
        if others or not wanted.get("joint_constraints"):
            raise ValueError(f"a goal by {', '.join(others) or 'nothing'}; known: joint_constraints")
        joints = {c["joint_name"]: c["position"] for c in wanted["joint_constraints"]}
        if lacking := [joint for joint in robot.joint_names if joint not in joints]:
            raise ValueError(f"the goal says nothing of {', '.join(lacking)}; it moves {', '.join(joints)}")
        ours = lambda told: np.array([told.get(joint, np.nan) for joint in robot.joint_names], np.float64)
        yield Goal(name if i == 0 else f"{name}#{i + 1}", ours(joints), ours(start), scene)


def _start(request: dict[str, Any]) -> dict[str, float]:
    """Where each joint is at the start."""
    begin = request.get("start_state", {}).get("joint_state", {})
    return dict(zip(begin.get("name", ()), begin.get("position", ()), strict=True))


def _beside(request: dict[str, Any], robot: jaxik.Robot) -> dict[str, float]:
    """Where a problem has joints that are not the robot's: at its start, or else at its goal."""
    wanted = (c for goal in request.get("goal_constraints", ()) for c in goal.get("joint_constraints") or ())
    told = {c["joint_name"]: c["position"] for c in wanted if "position" in c} | _start(request)
    return {joint: at for joint, at in told.items() if joint not in robot.joint_names}


def scene_of(message: dict[str, Any]) -> jaxik.Scene:
    """The collision objects of a MoveIt planning scene."""
    world = message.get("world") or {}
    if (message.get("robot_state") or {}).get("attached_collision_objects"):
        raise ValueError("attached_collision_objects, which this reader does not know")
    if ((world.get("octomap") or {}).get("octomap") or {}).get("data"):
        raise ValueError("an octomap, which this reader does not know; take the scene without 'sensed'")
    moved = {t["child_frame_id"]: _placed(t["transform"]) for t in message.get("fixed_frame_transforms") or ()}
    builder = jaxik.collision.SceneBuilder()
    for item in world.get("collision_objects") or ():
        shapes = _shapes(item, moved)
        if any(shapes.values()):  # an object may be a name alone
            builder.add(item["id"], **shapes)
    return builder.scene()


def _shapes(item: dict[str, Any], moved: dict[str, np.ndarray]) -> dict[str, list[Any]]:
    """The arguments of `SceneBuilder.add` for one collision object."""
    who, frame = f"object '{item['id']}'", ((item.get("header") or {}).get("frame_id") or "world").lstrip("/")
    if unknown := [kind for kind in ("meshes", "planes") if item.get(kind)]:
        raise ValueError(f"{who} has {' and '.join(unknown)}, which this reader does not know; known: primitives")
    if item.get("operation", 0) not in (0, "add"):
        raise ValueError(f"{who}: operation {item['operation']}; known: add")
    if frame not in moved and frame != "world":
        raise ValueError(f"{who} stands in the frame '{frame}', which fixed_frame_transforms does not place")
    placed = moved.get(frame, np.eye(4)) @ _placed(item.get("pose") or {})
    primitives, poses = item.get("primitives") or [], list(item.get("primitive_poses") or ())
    if len(poses) > len(primitives):
        raise ValueError(f"{who}: {len(primitives)} primitives and {len(poses)} primitive_poses; allowed: one each, or fewer")
    shapes: dict[str, list[Any]] = {"boxes": [], "cylinders": [], "spheres": []}
    for shape, pose in zip(primitives, poses + [{}] * (len(primitives) - len(poses)), strict=True):
        kind, size, frame = PRIMITIVES.get(shape["type"], shape["type"]), shape["dimensions"], placed @ _placed(pose)
        if kind not in SIZES:
            raise ValueError(f"{who} is a {kind}, which this reader does not know; known: {', '.join(SIZES)}")
        if len(size) != int(SIZES[kind][0]):
            raise ValueError(f"{who}: {len(size)} dimensions of a {kind}; allowed: {SIZES[kind]}")
        if kind == "box":
            shapes["boxes"].append((frame, size))
        elif kind == "cylinder":
            shapes["cylinders"].append((frame, size[1], size[0]))
        else:
            shapes["spheres"].append([*frame[:3, 3], size[0]])
    return shapes


def _placed(pose: dict[str, Any]) -> np.ndarray:
    """A pose or transform, of lists or of x, y, z (and w), as a (4, 4) frame."""
    numbers = lambda value: np.array([value[k] for k in "xyzw" if k in value] if isinstance(value, dict) else value, np.float64)
    place = numbers(pose.get("position", pose.get("translation", (0, 0, 0))))
    turn = numbers(pose.get("orientation", pose.get("rotation", (0, 0, 0, 1))))
    if place.shape != (3,) or turn.shape != (4,):
        raise ValueError(f"a pose of {len(place)} and {len(turn)} numbers; allowed: x, y, z and a quaternion x, y, z, w")
    length = np.linalg.norm(turn)
    x, y, z, w = (0.0, 0.0, 0.0, 1.0) if length == 0.0 else turn / length
    frame = np.eye(4)
    frame[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    frame[:3, 3] = place
    return frame


def _texts(folder: Path) -> dict[str, bytes]:
    """All requests and scenes below a folder, in archives or not, by their paths."""
    wanted = lambda name: re.search(r"(^|/)(request|scene)\d+\.ya?ml$", name)
    found = {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*.y*ml") if wanted(p.as_posix())}
    for packed in sorted(folder.glob("*.tar.*")):
        with tarfile.open(packed) as archive:
            members = [m for m in archive.getmembers() if m.isfile() and wanted(m.name)]
            found |= {m.name: archive.extractfile(m).read() for m in members}  # type: ignore[union-attr]
    return found


def _requests(texts: dict[str, bytes]) -> list[str]:
    return sorted(name for name in texts if re.search(r"(^|/)request\d+\.ya?ml$", name))


def _load(text: bytes) -> dict[str, Any]:
    message = yaml.load(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    if not isinstance(message, dict):
        raise ValueError("not a YAML mapping")
    return message


def _only(folder: Path, pattern: str) -> Path | None:
    found = sorted(folder.glob(pattern))
    if len(found) > 1:
        raise ValueError(f"{folder}: {', '.join(p.name for p in found)}; keep one {pattern}")
    return found[0] if found else None
