"""A scene, and how far a robot is from it and from itself."""

from jaxik.collision.attached import Attached, attach
from jaxik.collision.clearances import clearance, collides, object_clearances, self_clearance
from jaxik.collision.contact_report import explain
from jaxik.collision.continuous_collision import MotionClearance, motion_clearance, motion_collides
from jaxik.collision.scene import Fruit, Scene
from jaxik.collision.scene_builder import SceneBuilder, make_scene
from jaxik.collision.surfaces import polygon_triangles
from jaxik.collision.volumes import link_circles, link_spheres

__all__ = [
    "Attached",
    "Fruit",
    "MotionClearance",
    "Scene",
    "SceneBuilder",
    "attach",
    "clearance",
    "collides",
    "explain",
    "link_circles",
    "link_spheres",
    "make_scene",
    "motion_clearance",
    "motion_collides",
    "object_clearances",
    "polygon_triangles",
    "self_clearance",
]
