"""An arm of five meshes, two of them hollow, and what coal says of it."""

import functools

import coal
import jax
import jax.numpy as jnp
import numpy as np
import trimesh
from peers.triangle_truth import in_coal
from robot_files import write

import jaxik
from jaxik.kinematics import link_frames

JOINTS = {
    "pan": ("base", "lower", "0 0 0.25", "0 0 1"),
    "lift": ("lower", "upper", "0 0 0.1", "0 1 0"),
    "elbow": ("upper", "fork", "0.3 0 0", "0 1 0"),
    "twist": ("fork", "tip", "0.2 0 0", "1 0 0"),
}


def fork():
    """Two prongs on a bar: a hollow that other links may enter."""
    bars = [trimesh.creation.box((0.04, 0.22, 0.04)), *(trimesh.creation.box((0.16, 0.03, 0.04)) for _ in range(2))]
    for bar, side in zip(bars[1:], (-1, 1), strict=True):
        bar.apply_translation((0.08, 0.09 * side, 0.0))
    whole = trimesh.boolean.union(bars, engine="manifold")
    whole.apply_translation((0.03, 0.0, 0.0))
    return whole


def bar(size, at):
    found = trimesh.creation.box(size)
    found.apply_translation(at)
    return found


SHAPES = {
    "base": trimesh.creation.annulus(0.12, 0.18, 0.3),
    "lower": bar((0.08, 0.08, 0.12), (0.0, 0.0, 0.03)),
    "upper": bar((0.3, 0.05, 0.05), (0.15, 0.0, 0.0)),
    "fork": fork(),
    "tip": bar((0.05, 0.02, 0.02), (0.02, 0.0, 0.0)),
}


def arm_file(folder):
    """The arm as a URDF."""
    for name, mesh in SHAPES.items():
        mesh.export(folder / f"{name}.stl")
    links = "".join(
        f'<link name="{n}"><collision><geometry><mesh filename="{n}.stl"/></geometry></collision></link>' for n in SHAPES
    )
    joint = '<joint name="{}" type="revolute"><parent link="{}"/><child link="{}"/><origin xyz="{}"/><axis xyz="{}"/>'
    joint += '<limit lower="-2.6" upper="2.6" velocity="1" effort="1"/></joint>'
    joints = "".join(joint.format(name, *what) for name, what in JOINTS.items())
    return write(folder, "arm.urdf", f'<robot name="arm">{links}{joints}</robot>')


SCENE = jaxik.make_scene(
    boxes=[[0.45, 0.1, 0.3, 0.1, 0.2, 0.3]],
    spheres=[[-0.3, 0.3, 0.5, 0.1]],
    capsules=[[-0.4, -0.3, 0.2, -0.2, -0.4, 0.6, 0.05]],
)


def drawn(robot, count, seed=0):
    return np.random.default_rng(seed).uniform(robot.lower, robot.upper, (count, robot.num_joints))


class Truth:
    """The arm's meshes at configurations, as coal sees them."""

    def __init__(self, robot, q):
        self.robot, self.meshes = (
            robot,
            {n: in_coal(np.asarray(m.vertices, np.float32).astype(float)[m.faces]) for n, m in SHAPES.items()},
        )
        with jax.enable_x64(True):
            self.frames = np.asarray(jax.vmap(lambda q: link_frames(robot, q))(jnp.asarray(q)))

    def link(self, i, name):
        frame = self.frames[i, self.robot.link_names.index(name)]
        return self.meshes[name], coal.Transform3s(frame[:3, :3], frame[:3, 3])

    def itself(self, i):
        names = self.robot.link_names
        return min(apart(*self.link(i, names[a]), *self.link(i, names[b])) for a, b in self.robot.self_pairs)

    def scene(self, i):
        return min(apart(*self.link(i, name), *thing) for name in SHAPES for thing in THINGS)


def apart(one, first, other, second):
    return max(coal.distance(one, first, other, second, coal.DistanceRequest(), coal.DistanceResult()), 0.0)


def standing(turn, place):
    return coal.Transform3s(np.asarray(turn, float), np.asarray(place, float))


ALONG = np.array([[0.2, -0.1, 0.4]]) / np.linalg.norm([0.2, -0.1, 0.4])
TURN = trimesh.geometry.align_vectors([0, 0, 1], ALONG[0])[:3, :3]
THINGS = [
    (coal.Box(0.1, 0.2, 0.3), standing(np.eye(3), (0.45, 0.1, 0.3))),
    (coal.Sphere(0.1), standing(np.eye(3), (-0.3, 0.3, 0.5))),
    (coal.Capsule(0.05, float(np.linalg.norm([0.2, -0.1, 0.4]))), standing(TURN, (-0.3, -0.35, 0.4))),
]


batched = functools.lru_cache(maxsize=64)(lambda function: jax.jit(jax.vmap(function)))  # one program a function and a size


def measured(function, q):
    with jax.enable_x64(True):
        return np.asarray(batched(function)(jnp.asarray(q)))
