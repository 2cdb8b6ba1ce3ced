"""The seven joints of the Panda, up to `panda_link8`, for jaxik and for each peer at its best documented setting."""

from __future__ import annotations

import functools
import tempfile
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pinocchio as pin
from race import PLAIN, Entry, compiled, single

import jaxik

TIP = "panda_link8"
ROBOTS = Path(pin.__file__).parents[4] / "share" / "example-robot-data" / "robots"


def bare_urdf(file: Path, tip: str) -> Path:
    """A copy of a URDF with nothing but the links and joints from its root to `tip`, and no shapes: the same for everyone."""
    root = ET.parse(file).getroot()
    above = {j.find("child").get("link"): j for j in root.findall("joint")}  # type: ignore[union-attr]
    kept, link = {tip}, tip
    while link in above:
        link = above[link].find("parent").get("link")  # type: ignore[union-attr,assignment]
        kept.add(link)
    for element in list(root):
        child = element.find("child")
        name = element.get("name") if child is None else child.get("link")
        if element.tag not in ("joint", "link") or name not in kept:
            root.remove(element)
        for shape in (*element.findall("visual"), *element.findall("collision")):
            element.remove(shape)
    path = Path(tempfile.mkdtemp()) / file.name
    ET.ElementTree(root).write(path)
    return path


def urdf_file() -> Path:
    """The Panda's, bare."""
    return bare_urdf(ROBOTS / "panda_description/urdf/panda.urdf", TIP)


def pose_of(robot: jaxik.Robot) -> Callable[[np.ndarray], np.ndarray]:
    """q -> tip pose (4, 4) by Pinocchio's kinematics, from the robot's numbers, whatever file they came from."""
    model, joint = pin.Model(), 0
    for i, prismatic in enumerate(robot.is_prismatic):
        kind = pin.JointModelPrismaticUnaligned if prismatic else pin.JointModelRevoluteUnaligned
        placed = pin.SE3(robot.parent_T_joint[i][:3, :3], robot.parent_T_joint[i][:3, 3])
        joint = model.addJoint(joint, kind(np.array(robot.axis[i])), placed, robot.joint_names[i])
    data = model.createData()

    def pose(q: np.ndarray) -> np.ndarray:
        pin.forwardKinematics(model, data, np.asarray(q, np.float64))
        return data.oMi[joint].homogeneous @ robot.joint_T_tip

    return pose


class Truth:
    """Pinocchio in float64: what every contender's numbers are held against, and a contender itself."""

    def __init__(self, urdf: Path):
        self.model = pin.buildModelFromUrdf(str(urdf))
        self.data, self.tip = self.model.createData(), self.model.getFrameId(TIP)

    def pose(self, q: np.ndarray) -> np.ndarray:
        pin.framesForwardKinematics(self.model, self.data, q.astype(np.float64))
        return self.data.oMf[self.tip].homogeneous.copy()

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        return pin.computeFrameJacobian(self.model, self.data, q.astype(np.float64), self.tip, pin.LOCAL_WORLD_ALIGNED)

    def loops(self, rows: list[np.ndarray]) -> tuple[Callable[[], None], Callable[[], None]]:
        """FK, and FK with Jacobian, one configuration after the other: C++ called from Python."""
        model, data, tip = self.model, self.data, self.tip

        def poses() -> None:
            forward, update = pin.forwardKinematics, pin.updateFramePlacement
            for row in rows:
                forward(model, data, row)
                update(model, data, tip)

        def jacobians() -> None:
            each, frame = pin.computeFrameJacobian, pin.LOCAL_WORLD_ALIGNED
            for row in rows:
                each(model, data, row, tip, frame)

        return poses, jacobians


def contenders(count: int = 65_536) -> tuple[list[Entry], list[Entry]]:
    """Entries for the pose and for the Jacobian of `count` random configurations."""
    urdf = urdf_file()
    robot, truth = jaxik.load(urdf, tip=TIP), Truth(urdf)
    q = np.random.default_rng(0).uniform(robot.lower, robot.upper, (count, 7)).astype(np.float32)
    few = q[:50]
    poses = np.stack([truth.pose(row) for row in few])
    jacobians = np.stack([truth.jacobian(row) for row in few])

    def off(values: Any, true: np.ndarray) -> float:
        return float(np.max(np.abs(np.asarray(values, np.float64) - true)))

    def jaxs(who: str, function: Callable[..., Any], check: Callable[..., Any], true: Any, batch: Any = q) -> Entry:
        run, seconds = compiled(function, jnp.asarray(batch))
        return Entry(who, len(batch), run, seconds, off(check(few), true))

    def ours(function: Callable[..., Any], true: np.ndarray) -> list[Entry]:
        batches = {"jaxik": function, PLAIN: function.__wrapped__}  # type: ignore[attr-defined]
        each = {who: jax.vmap(functools.partial(f, robot)) for who, f in batches.items()}
        return [jaxs(who, f, f, true) for who, f in each.items()]

    forward, columns = ours(jaxik.forward_kinematics, poses), ours(jaxik.jacobian, jacobians)
    rows = [row.astype(np.float64) for row in q]
    loops = truth.loops(rows)
    for entries, loop in zip((forward, columns), loops, strict=True):
        entries.append(Entry("Pinocchio, Python loop", count, loop))
    for entries, torch_entry in zip((forward, columns), _torch(urdf, q, few, poses, jacobians, off), strict=True):
        entries.append(torch_entry)
    for name, function in pyroki_poses(urdf).items():
        forward.append(jaxs(name, function, lambda q, f=function: _matrices(f(jnp.asarray(q))), poses))
    frax_pose, frax_jacobian = frax_functions(urdf, robot)
    forward.append(jaxs("frax, vmap", frax_pose, frax_pose, poses))
    columns.append(jaxs("frax, vmap", frax_jacobian, frax_jacobian, jacobians))
    mjx_pose = mjx_poses(urdf, robot)
    forward.append(jaxs("MJX, vmap", mjx_pose, lambda q: _homogeneous(*mjx_pose(q)), poses, q[:4096]))
    return forward, columns


def single_calls() -> dict[str, dict[str, Callable[[], Any]]]:
    """One configuration: the pose and the Jacobian, each by calls that wait for their results."""
    urdf = urdf_file()
    robot, truth = jaxik.load(urdf, tip=TIP), Truth(urdf)
    row = np.random.default_rng(0).uniform(robot.lower, robot.upper)
    q = jnp.asarray(row, jnp.float32)
    works = {}
    for name, function, loop in zip(
        ("forward kinematics, Panda", "Jacobian, Panda"),
        (jaxik.forward_kinematics, jaxik.jacobian),
        truth.loops([row]),
        strict=True,
    ):
        works[name] = single(functools.partial(function, robot), functools.partial(function.__wrapped__, robot), q)
        works[name]["Pinocchio, from Python"] = loop
    return works


def _torch(urdf: Path, q: np.ndarray, few: np.ndarray, poses: np.ndarray, jacobians: np.ndarray, off: Any) -> list[Entry]:
    import pytorch_kinematics as pk
    import torch

    model = pk.build_serial_chain_from_urdf(urdf.read_bytes(), TIP).to(dtype=torch.float32)
    batch, sample = torch.tensor(q), torch.tensor(few)
    with torch.no_grad():
        matrices = model.forward_kinematics(sample).get_matrix().numpy()
        columns = model.jacobian(sample).numpy()

    def without_gradient(function: Callable[[Any], Any]) -> Callable[[], None]:
        def run() -> None:
            with torch.no_grad():
                function(batch)

        return run

    who = f"pytorch-kinematics, {torch.get_num_threads()} threads"
    return [
        Entry(who, len(q), without_gradient(lambda b: model.forward_kinematics(b).get_matrix()), error=off(matrices, poses)),
        Entry(who, len(q), without_gradient(model.jacobian), error=off(columns, jacobians)),
    ]


def pyroki_poses(urdf: Path) -> dict[str, Callable[..., Any]]:
    """(N, 7) -> (N, 7), quaternions first, each way that it has."""
    import pyroki
    import yourdfpy

    peer = pyroki.Robot.from_urdf(yourdfpy.URDF.load(str(urdf), load_meshes=False, load_collision_meshes=False))
    tip = peer.links.names.index(TIP)
    return {
        "PyRoki": lambda q: peer.forward_kinematics(q)[..., tip, :],
        "PyRoki, unroll_fk": lambda q: peer.forward_kinematics(q, unroll_fk=True)[..., tip, :],
    }


def _matrices(wxyz_xyz: Any) -> np.ndarray:
    poses = []
    for row in np.asarray(wxyz_xyz, np.float64):
        rotation = pin.Quaternion(*row[:4] / np.linalg.norm(row[:4])).toRotationMatrix()
        poses.append(pin.SE3(rotation, row[4:]).homogeneous)
    return np.stack(poses)


def _homogeneous(rotations: Any, positions: Any) -> np.ndarray:
    poses = np.tile(np.eye(4), (len(positions), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = rotations, positions
    return poses


def frax_functions(urdf: Path, robot: jaxik.Robot) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Pose and Jacobian of a batch."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it advises single-threaded settings, which would slow everyone else
        import frax

        peer = frax.Manipulator(str(urdf), ee_offset=np.asarray(robot.joint_T_tip))
    return jax.vmap(peer.ee_transform), jax.vmap(peer.ee_jacobian)


def mjx_poses(urdf: Path, robot: jaxik.Robot) -> Callable[..., Any]:
    """(N, 7) -> rotations and positions."""
    from mujoco import mjx

    # fixed bodies fused, as MuJoCo does by default: it is faster by 1.7; the tip is put back on the last body
    fused = mujoco.MjModel.from_xml_path(str(urdf))
    model = mjx.put_model(fused)
    blank, last, tip = mjx.make_data(model), fused.nbody - 1, jnp.asarray(robot.joint_T_tip)

    def pose(q: Any) -> Any:
        moved = mjx.kinematics(model, blank.replace(qpos=q))
        return moved.xmat[last] @ tip[:3, :3], moved.xpos[last] + moved.xmat[last] @ tip[:3, 3]

    return jax.vmap(pose)
