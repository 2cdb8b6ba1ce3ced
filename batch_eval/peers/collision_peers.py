"""A robot of spheres among boxes, cylinders and balls, by peers, each at its best documented setting.

A peer is built once for a robot's URDF and SRDF. `clearance(scene, q)` are the least signed distances (N,) of configurations
(N, n) to the scene and to the robot itself, `collides(scene, q)` answers yes or no where a peer has a cheaper way to it. `Coal`
is also the judge of what is free: nobody here wrote it.
"""

from __future__ import annotations

import itertools
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import coal
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pinocchio as pin

import jaxik


def frames(scene: jaxik.Scene) -> list[tuple[str, np.ndarray, tuple[float, ...]]]:
    """Each obstacle's kind, frame (4, 4) and sizes: half edges of a box, radius and half length of a cylinder, a radius."""
    if scene.counts["points"] or scene.counts["capsules"]:
        raise ValueError("points and capsules, which the peers here do not all know")
    placed = []
    for center in np.reshape(scene.spheres.center, (-1, 3)):
        placed.append(np.eye(4))
        placed[-1][:3, 3] = center
    boxes = [("box", frame, tuple(half)) for frame, half in zip(scene.boxes.world_T_box, scene.boxes.half, strict=True)]
    round_ = zip(scene.cylinders.world_T_cylinder, scene.cylinders.radius, scene.cylinders.half, strict=True)
    balls = [("sphere", frame, (radius,)) for frame, radius in zip(placed, scene.spheres.radius, strict=True)]
    return boxes + [("cylinder", frame, (radius, half)) for frame, radius, half in round_] + balls


def ignored(robot: jaxik.Robot, srdf: Path | None) -> list[tuple[str, str]]:
    """The pairs of links that nobody holds against each other: those that an SRDF leaves out, and neighbours on the tree."""
    found = [] if srdf is None else ET.parse(srdf).getroot().iter("disable_collisions")
    joint = dict(zip(robot.link_names, robot.link_joint, strict=True))
    near = [(a, b) for a, b in itertools.combinations(joint, 2) if robot.tree.distance(joint[a], joint[b]) <= 1]
    return [(str(pair.get("link1")), str(pair.get("link2"))) for pair in found] + near


def bare(urdf: Path) -> Path:
    """A copy without what is only to be looked at, whose files are not there, and without fixed joints that mimic others."""
    root = ET.parse(urdf).getroot()
    for element in root:
        for left_out in (*element.findall("visual"), *element.findall("mimic")):
            element.remove(left_out)
    path = Path(tempfile.mkdtemp()) / urdf.name
    ET.ElementTree(root).write(path)
    return path


def spheres(urdf: Path) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Each link's centres (k, 3) and radii (k,), in its own frame."""
    found = {}
    for link in ET.parse(urdf).getroot().iter("link"):
        rows = []
        for shape in link.findall("collision"):
            origin, ball = shape.find("origin"), shape.find("geometry/sphere")
            if ball is None:
                raise ValueError(f"{urdf}: {link.get('name')} has shapes that are not spheres")
            place = [0.0, 0.0, 0.0] if origin is None else [float(x) for x in origin.get("xyz", "0 0 0").split()]
            rows.append([*place, float(ball.get("radius", "nan"))])
        if rows:
            table = np.array(rows)
            found[str(link.get("name"))] = table[:, :3], table[:, 3]
    return found


class Peer:
    """Keeps what it has made of each scene, and the scene, by whose identity it is found."""

    def __init__(self) -> None:
        self.scenes: dict[int, tuple[jaxik.Scene, Any]] = {}

    def among(self, scene: jaxik.Scene) -> Any:
        if id(scene) not in self.scenes:
            self.scenes[id(scene)] = scene, self.prepared(scene)
        return self.scenes[id(scene)][1]

    def prepared(self, scene: jaxik.Scene) -> Any:
        raise NotImplementedError


class Coal(Peer):
    """Pinocchio's kinematics and coal's distances, C++ called from a Python loop, one configuration after the other; of a URDF,
    or of MJCF by its name.

    `broad` puts coal's dynamic tree of boxes before the pairs (Pinocchio's BroadPhaseManager), which `collides` may use.
    `posture` is where joints beside the chain stand [rad, m], the others at their neutral positions. `as_robot` leaves out what
    the robot does, as pairs of links whose meshes touch in most postures; `packages` are the folders below which meshes lie.
    """

    def __init__(
        self,
        robot: jaxik.Robot,
        urdf: Path,
        srdf: Path | None,
        broad: bool = False,
        posture: Mapping[str, float] | None = None,
        as_robot: bool = False,
        packages: tuple[Path, ...] = (),
    ):
        super().__init__()
        self.broad = broad
        if urdf.suffix == ".xml":
            self.model = pin.buildModelFromMJCF(str(urdf))
            self.robot = pin.buildGeomFromMJCF(self.model, str(urdf), pin.GeometryType.COLLISION)
        else:
            self.model = pin.buildModelFromUrdf(str(urdf))
            where = {"package_dirs": [str(folder) for folder in packages]} if packages else {}
            self.robot = pin.buildGeomFromUrdf(self.model, str(bare(urdf)), pin.GeometryType.COLLISION, **where)
        self.robot.addAllCollisionPairs()
        name = [self.model.frames[body.parentFrame].name for body in self.robot.geometryObjects]
        left_out = {frozenset(pair) for pair in ignored(robot, srdf)}
        left_out |= {frozenset(pair.links) for pair in robot.unchecked if as_robot}
        pairs = [(pair.first, pair.second) for pair in self.robot.collisionPairs]
        self.robot.removeAllCollisionPairs()
        for a, b in pairs:
            if frozenset((name[a], name[b])) not in left_out:
                self.robot.addCollisionPair(pin.CollisionPair(a, b))
        self.data = self.model.createData()
        self.names, self.posture = robot.joint_names, posture or {}

    def hold(self, frame: str, shape: Any, placed: np.ndarray) -> None:
        """Gives the robot a thing that is placed (4, 4) in a frame, and may hit the scene."""
        held = self.model.frames[self.model.getFrameId(frame)]
        where = held.placement * pin.SE3(placed)
        self.robot.addGeometryObject(pin.GeometryObject("held", held.parentJoint, where, shape))

    def prepared(self, scene: jaxik.Scene) -> Any:
        """The geometry of the robot and the scene, and the tree over it."""
        shapes = {
            "box": lambda *half: coal.Box(*(2.0 * x for x in half)),
            "cylinder": lambda radius, half: coal.Cylinder(radius, 2.0 * half),
            "sphere": coal.Sphere,
        }
        geometry = self.robot.copy()
        for i, (kind, frame, size) in enumerate(frames(scene)):
            placed = pin.SE3(np.asarray(frame[:3, :3]), np.asarray(frame[:3, 3]))
            new = geometry.addGeometryObject(pin.GeometryObject(f"obstacle_{i}", 0, placed, shapes[kind](*map(float, size))))
            for body in range(self.robot.ngeoms):
                geometry.addCollisionPair(pin.CollisionPair(body, new))
        data = geometry.createData()
        if not self.broad:
            return geometry, data, None
        return geometry, data, pin.BroadPhaseManager_DynamicAABBTreeCollisionManager(self.model, geometry, data)

    def whole(self, q: np.ndarray) -> np.ndarray:
        """All joints of the URDF, an endless one as cosine and sine."""
        full = np.tile(pin.neutral(self.model), (len(q), 1))
        for name, value in [*self.posture.items(), *zip(self.names, np.transpose(q), strict=True)]:
            joint = self.model.joints[self.model.getJointId(name)]
            entries = [value] if joint.nq == 1 else [np.cos(value), np.sin(value)]
            for i, entry in enumerate(entries):
                full[:, joint.idx_q + i] = entry
        return full

    def clearance(self, scene: jaxik.Scene, q: np.ndarray) -> np.ndarray:
        geometry, data, _ = self.among(scene)
        least = np.empty(len(q))
        for i, row in enumerate(self.whole(q)):
            nearest = pin.computeDistances(self.model, self.data, geometry, data, row)
            least[i] = data.distanceResults[nearest].min_distance
        return least

    def collides(self, scene: jaxik.Scene, q: np.ndarray) -> np.ndarray:
        geometry, data, manager = self.among(scene)
        if manager is None:
            ask = lambda row: pin.computeCollisions(self.model, self.data, geometry, data, row, True)
        else:
            ask = lambda row: pin.computeCollisions(self.model, self.data, manager, row, True)
        return np.array([ask(row) for row in self.whole(q)])


class CoalOfVolumes(Coal):
    """The same of a robot's balls, capsules and boxes, whatever file they came from, by Pinocchio's kinematics from its
    numbers."""

    def __init__(self, robot: jaxik.Robot, broad: bool = False):
        Peer.__init__(self)
        if robot.convex_parts or any(len(volume.corners) > 2 for volume in robot.volumes):
            raise ValueError(f"{robot.name}: has shapes that are neither balls nor capsules nor boxes")
        self.broad, self.names, self.posture = broad, robot.joint_names, {}
        self.model, self.robot = model_of(robot), pin.GeometryModel()
        parts = [(each.link, *_swept(np.asarray(each.corners, np.float64), float(each.radius))) for each in robot.volumes]
        for each in robot.boxes:
            parts.append((each.link, coal.Box(*map(float, 2.0 * each.half)), pin.SE3(np.asarray(each.joint_T_box, np.float64))))
        link = [part[0] for part in parts]
        for i, (at, shape, frame) in enumerate(parts):
            joint = robot.link_joint[at]
            placed = frame if joint else pin.SE3(np.asarray(robot.world_T_base, np.float64)) * frame
            self.robot.addGeometryObject(pin.GeometryObject(f"part_{i}", joint, placed, shape))
        checked = {frozenset(pair) for pair in robot.self_pairs}
        for a, b in itertools.combinations(range(len(link)), 2):
            if frozenset((link[a], link[b])) in checked:
                self.robot.addCollisionPair(pin.CollisionPair(a, b))
        self.data = self.model.createData()


def model_of(robot: jaxik.Robot) -> Any:
    """Pinocchio's model of a robot's numbers, where it stands in the world."""
    model, joint = pin.Model(), 0
    for i, prismatic in enumerate(robot.is_prismatic):
        kind = pin.JointModelPrismaticUnaligned if prismatic else pin.JointModelRevoluteUnaligned
        placed = pin.SE3(np.asarray(robot.parent_T_joint[i], np.float64))
        if i == 0:
            placed = pin.SE3(np.asarray(robot.world_T_base, np.float64)) * placed
        joint = model.addJoint(joint, kind(np.array(robot.axis[i], np.float64)), placed, robot.joint_names[i])
    return model


def _swept(corners: np.ndarray, radius: float) -> tuple[Any, Any]:
    """The ball or capsule of one or two corners (c, 3), and its frame."""
    along = corners[-1] - corners[0]
    if not (length := float(np.linalg.norm(along))):
        return coal.Sphere(radius), pin.SE3(np.eye(3), corners[0])
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), along / length).matrix()
    return coal.Capsule(radius, length), pin.SE3(turn, corners.mean(axis=0))


class MuJoCo(Peer):
    """Contacts of `mj_collision`, which has a broad phase of its own, in a Python loop. Distances are those of contacts within
    `margin` [m], so that is all that it sees; what does not move is not held against what does not move."""

    def __init__(self, robot: jaxik.Robot, urdf: Path, srdf: Path | None, margin: float = 0.0):
        super().__init__()
        self.names, self.urdf, self.pairs, self.margin = robot.joint_names, bare(urdf), ignored(robot, srdf), margin

    def prepared(self, scene: jaxik.Scene) -> Any:
        spec = mujoco.MjSpec.from_file(str(self.urdf))
        spec.compiler.fusestatic, spec.memory = False, 2**22
        names = {body.name for body in spec.bodies}
        for one, other in self.pairs:
            if one in names and other in names:
                spec.add_exclude(bodyname1=one, bodyname2=other)
        for kind, frame, size in frames(scene):
            turn = pin.Quaternion(np.asarray(frame[:3, :3])).coeffs()[[3, 0, 1, 2]]
            shape = getattr(mujoco.mjtGeom, f"mjGEOM_{kind.upper()}")
            spec.worldbody.add_geom(type=shape, size=[*size, 0.0, 0.0][:3], pos=frame[:3, 3], quat=turn)
        for geom in spec.geoms:
            geom.margin = self.margin
        model = spec.compile()
        return model, mujoco.MjData(model), [model.joint(name).qposadr[0] for name in self.names]

    def _each(self, scene: jaxik.Scene, q: np.ndarray, answer: Callable[[Any], Any]) -> np.ndarray:
        model, data, columns = self.among(scene)
        answers = []
        for row in np.asarray(q, np.float64):
            data.qpos[columns] = row
            mujoco.mj_kinematics(model, data)
            mujoco.mj_collision(model, data)
            answers.append(answer(data))
        return np.array(answers)

    def clearance(self, scene: jaxik.Scene, q: np.ndarray) -> np.ndarray:
        return self._each(scene, q, lambda data: data.contact.dist.min() if data.ncon else np.inf)

    def collides(self, scene: jaxik.Scene, q: np.ndarray) -> np.ndarray:
        return self._each(scene, q, lambda data: data.ncon > 0)


class Batched(Peer):
    """Peers on JAX: `batch(boxes, capsules, q)`, one program for each number of them. Boxes are frames, half edges; cylinders
    are capsules (frames, radii, half lengths of the axes), all that these two know of them: longer by a radius at each end."""

    batch: Callable[..., Any]

    def prepared(self, scene: jaxik.Scene) -> Any:
        boxes, round_ = scene.boxes, scene.cylinders
        kinds = (boxes.world_T_box, boxes.half), (round_.world_T_cylinder, round_.radius, round_.half)
        return jax.tree_util.tree_map(lambda leaf: jnp.asarray(leaf, jnp.float32), kinds)

    def clearance(self, scene: jaxik.Scene, q: Any) -> Any:
        return self.batch(*self.among(scene), q)


class PyRoki(Batched):
    """PyRoki's RobotCollision of these spheres, `vmap`-ed and jitted."""

    def __init__(self, robot: jaxik.Robot, urdf: Path, srdf: Path | None):
        super().__init__()
        import jaxlie
        import pyroki
        import yourdfpy
        from pyroki.collision import Box, Capsule, RobotCollision

        file = yourdfpy.URDF.load(str(bare(urdf)), load_meshes=False, load_collision_meshes=False)
        peer = pyroki.Robot.from_urdf(file)
        links = {name: {"centers": c.tolist(), "radii": r.tolist()} for name, (c, r) in spheres(urdf).items()}
        body = RobotCollision.from_sphere_decomposition(links, file, tuple(ignored(robot, srdf)))
        order = np.array([robot.joint_names.index(name) for name in peer.joints.actuated_names])

        def pose(frame: Any) -> Any:
            return jaxlie.SE3.from_matrix(frame)

        def clearance(boxes: Any, capsules: Any, q: Any) -> Any:
            at = body.compute_self_collision_distance(peer, q[order]).min()
            (box_T, half), (capsule_T, radius, length) = boxes, capsules
            if len(half):
                world = Box(pose=pose(box_T), size=half)
                at = jnp.minimum(at, body.compute_world_collision_distance(peer, q[order], world).min())
            if len(radius):
                world = Capsule(pose=pose(capsule_T), size=jnp.stack([radius, 2.0 * length], axis=-1))
                at = jnp.minimum(at, body.compute_world_collision_distance(peer, q[order], world).min())
            return at

        self.batch = jax.jit(jax.vmap(clearance, in_axes=(None, None, 0)))


class ScikitRobot(Batched):
    """The distances of its trajectory optimisation on JAX, `vmap`-ed and jitted, for these spheres and pairs."""

    def __init__(self, robot: jaxik.Robot, urdf: Path, srdf: Path | None):
        super().__init__()
        from skrobot.collision.distance import sphere_capsule_distance
        from skrobot.collision.geometry import Capsule, Sphere
        from skrobot.models.urdf import RobotModelFromURDF
        from skrobot.planner.trajectory_optimization import fk_utils
        from skrobot.planner.trajectory_optimization.problem import TrajectoryProblem

        peer, given = RobotModelFromURDF(urdf_file=str(bare(urdf))), spheres(urdf)
        moving = [joint.child_link for joint in peer.joint_list if joint.name in robot.joint_names]
        problem = TrajectoryProblem(peer, moving, 1)
        problem.add_collision_cost([peer.__dict__[name] for name in given], [])
        owner = np.repeat(np.arange(len(given)), [len(radius) for _, radius in given.values()])
        problem.collision_spheres = {
            "sphere_centers_local": np.concatenate([center for center, _ in given.values()]),
            "sphere_radii": np.concatenate([radius for _, radius in given.values()]),
            "link_indices": owner,
        }
        data = fk_utils.prepare_fk_data(problem, jnp)
        places = fk_utils.build_fk_functions(data, jnp)[1]
        name, left_out = list(given), {frozenset(pair) for pair in ignored(robot, srdf)}
        apart = lambda a, b: owner[a] != owner[b] and frozenset((name[owner[a]], name[owner[b]])) not in left_out
        first, second = np.array([(a, b) for b in range(len(owner)) for a in range(b) if apart(a, b)]).T
        radii = jnp.asarray(data["sphere_radii"])

        def clearance(boxes: Any, capsules: Any, q: Any) -> Any:
            at = places(q)
            (box_T, half), (capsule_T, radius, length) = boxes, capsules
            least = fk_utils.compute_self_collision_distances(at, radii, first, second, jnp).min()
            if len(half):
                away = fk_utils.compute_box_obstacle_distances(at, radii, box_T[:, :3, 3], half, box_T[:, :3, :3], jnp)
                least = jnp.minimum(least, away.min())
            if len(radius):
                along = capsule_T[:, :3, 2] * length[:, None]
                rods = Capsule(capsule_T[:, :3, 3] - along, capsule_T[:, :3, 3] + along, radius)
                least = jnp.minimum(least, sphere_capsule_distance(Sphere(at[:, None], radii[:, None]), rods, jnp).min())
            return least

        self.batch = jax.jit(jax.vmap(clearance, in_axes=(None, None, 0)))
