"""A scene, and how far a robot is from it and from itself."""

from jaxik.collision.attached import Attached, attach, with_room
from jaxik.collision.clearances import clearance, collides, link_clearances, object_clearances
from jaxik.collision.contact_report import Contact, Limit, Nearby, explain
from jaxik.collision.continuous_collision import MotionClearance, motion_clearance
from jaxik.collision.moving import MovingScene, Track
from jaxik.collision.moving_clearance import clearance_at
from jaxik.collision.scene import Mark, Scene
from jaxik.collision.scene_builder import SceneBuilder, make_scene
from jaxik.collision.sphere_clouds import clearance_to_spheres
from jaxik.collision.volumes import robot_spheres

__all__ = [
    "Attached",
    "Contact",
    "Limit",
    "Mark",
    "MotionClearance",
    "MovingScene",
    "Nearby",
    "Scene",
    "SceneBuilder",
    "Track",
    "attach",
    "clearance",
    "clearance_at",
    "clearance_to_spheres",
    "collides",
    "explain",
    "link_clearances",
    "make_scene",
    "motion_clearance",
    "object_clearances",
    "robot_spheres",
    "with_room",
]
