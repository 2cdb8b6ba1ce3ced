"""Tool paths by Tesseract (`pip install tesseract-robotics==0.5.1`): Descartes' ladder graph, and TrajOpt begun from its way.

KDL's Levenberg-Marquardt, all that it has for seven joints, gives one answer a pose; OPW and UR are for other arms. So the
first joint is taken for a positioner that the others stand on (ROPInvKin): it is sampled, and KDL solves for the other six.
Descartes begins KDL at zero, outside a Panda's limits; the URDF that it is given has its zeros at the SRDF's state `ready`.
Both planners keep the pairs of links apart that coal judges, Descartes at the poses alone: with its check of edges a graph of a
quarter of the samples took more than twice the time. The times are of `solve`, without what Python makes of the question.
"""

from __future__ import annotations

import tempfile
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
import tesseract_robotics
from peers.collision_peers import bare, frames, ignored
from race import clocked
from tesseract_robotics import tesseract_command_language as language
from tesseract_robotics import tesseract_common as common
from tesseract_robotics import tesseract_motion_planners_descartes as descartes
from tesseract_robotics import tesseract_motion_planners_trajopt as trajopt
from tesseract_robotics.tesseract_environment import AddLinkCommand, Environment
from tesseract_robotics.tesseract_geometry import Box
from tesseract_robotics.tesseract_motion_planners import PlannerRequest
from tesseract_robotics.tesseract_scene_graph import Collision, Joint, JointType_FIXED, Link

import jaxik

NAME = "path"  # of the group and the profiles
APART = 0.05  # [rad] from sample to sample of the first joint
NEAR = 0.01  # [m] from where TrajOpt sees what is near
KINEMATICS = """
kinematic_plugins:
  search_paths: [{folder}]
  search_libraries: [{kdl}, {core}]
  fwd_kin_plugins:
    path: {{default: KDL, plugins: {{KDL: {{class: KDLFwdKinChainFactory, config: {{base_link: {base}, tip_link: {tip}}}}}}}}}
  inv_kin_plugins:
    path:
      default: Sampled
      plugins:
        Sampled:
          class: ROPInvKinFactory
          config:
            manipulator_reach: 2.0
            positioner_sample_resolution: [{{name: {joint}, value: {apart}}}]
            positioner: {{class: KDLFwdKinChainFactory, config: {{base_link: {base}, tip_link: {first}}}}}
            manipulator: {{class: KDLInvKinChainLMAFactory, config: {{base_link: {first}, tip_link: {tip}}}}}
"""
CONTACTS = """
contact_manager_plugins:
  search_paths: [{folder}]
  search_libraries: [{bullet}]
  discrete_plugins:
    default: Bullet
    plugins: {{Bullet: {{class: BulletDiscreteBVHManagerFactory}}}}
  continuous_plugins:
    default: Bullet
    plugins: {{Bullet: {{class: BulletCastBVHManagerFactory}}}}
"""


class Joined(NamedTuple):
    """Configurations (N, n), one a moment, and straight lines between them: what the judge asks of a motion."""

    q: np.ndarray

    @property
    def at(self) -> np.ndarray:
        return np.arange(len(self.q))

    @property
    def trajectory(self) -> Joined:
        return self

    def at_times(self, times: np.ndarray) -> Joined:
        return Joined(np.stack([np.interp(times, self.at, column) for column in self.q.T], axis=1))


class Tesseract:
    """The planners for the chain of one robot's URDF, from the root up to the link `tip`, among the boxes of one scene."""

    def __init__(self, robot: jaxik.Robot, urdf: Path, srdf: Path, tip: str, scene: jaxik.Scene):
        self.names, root = robot.joint_names, ET.parse(bare(urdf)).getroot()
        self.zero = _ready(srdf, self.names)
        _move_zeros(root, dict(zip(self.names, self.zero.tolist(), strict=True)))
        first = next(joint for joint in root.iter("joint") if joint.get("name") == self.names[0])
        base, link = (first.find(end).get("link") for end in ("parent", "child"))  # type: ignore[union-attr]
        self.info = common.ManipulatorInfo()
        self.info.manipulator, self.info.tcp_frame, self.info.working_frame = NAME, tip, base
        self.locator, self.environment = common.GeneralResourceLocator(), Environment()  # which does not keep the locator
        written = _srdf(robot, srdf, base=base, first=link, tip=tip, joint=self.names[0], apart=APART)
        if not self.environment.init(ET.tostring(root, encoding="unicode"), written, self.locator):
            raise ValueError(f"{urdf}: Tesseract does not take it; it has printed why")
        for number, (kind, frame, half) in enumerate(frames(scene)):
            if kind != "box":
                raise ValueError(f"a {kind} in the scene, which this peer is not given; known: box")
            self.environment.applyCommand(_box(number, base, frame, half))

    def laddered(self, poses: np.ndarray) -> tuple[Joined | None, float]:
        """Descartes' way through the poses (N, 4, 4), and its seconds."""
        profiles = language.ProfileDictionary()
        profiles.addProfile(NAME, NAME, descartes.cast_DescartesPlanProfileD(descartes.DescartesDefaultPlanProfileD()))
        return self._planned(descartes.DescartesMotionPlannerD(NAME), profiles, poses)

    def smoothed(self, poses: np.ndarray, begun: Joined) -> tuple[Joined | None, float]:
        """TrajOpt's way through the poses from `begun`, and its seconds; by default, but that it may come as near as jaxik."""
        shape, terms = trajopt.TrajOptDefaultPlanProfile(), trajopt.TrajOptDefaultCompositeProfile()
        terms.collision_cost_config.enabled = False  # of what is nearer than 25 mm
        terms.collision_constraint_config.safety_margin = 0.0
        terms.collision_constraint_config.safety_margin_buffer = NEAR
        profiles = language.ProfileDictionary()
        for profile in (shape, terms):
            profiles.addProfile(NAME, NAME, profile)
        return self._planned(trajopt.TrajOptMotionPlanner(NAME), profiles, poses, begun.q)

    def _planned(self, planner: Any, profiles: Any, poses: np.ndarray, begun: Any = None) -> tuple[Joined | None, float]:
        request = PlannerRequest()
        request.instructions, request.env, request.profiles = self._program(poses, begun), self.environment, profiles
        answer, seconds = clocked(lambda: planner.solve(request))
        if not answer.successful:
            return None, seconds
        program = answer.results  # kept: what is got of it dies with it
        moves = [language.InstructionPoly_as_MoveInstructionPoly(each) for each in program.flatten()]
        states = [language.WaypointPoly_as_StateWaypointPoly(move.getWaypoint()) for move in moves]
        return Joined(np.stack([np.ravel(state.getPosition()) for state in states]) + self.zero), seconds

    def _program(self, poses: np.ndarray, begun: np.ndarray | None) -> Any:
        program = language.CompositeInstruction(NAME)
        program.setManipulatorInfo(self.info)
        for i, pose in enumerate(poses):
            point = language.CartesianWaypoint(common.Isometry3d(np.asarray(pose, float)))
            if begun is not None:
                point.setSeed(common.JointState(list(self.names), begun[i] - self.zero))
            wrapped = language.CartesianWaypointPoly_wrap_CartesianWaypoint(point)
            move = language.MoveInstruction(wrapped, language.MoveInstructionType_LINEAR, NAME)
            program.appendMoveInstruction(language.MoveInstructionPoly_wrap_MoveInstruction(move))
        return program


def _ready(srdf: Path, names: tuple[str, ...]) -> np.ndarray:
    """The SRDF's state `ready`, in the order of the joints."""
    states = {state.get("name"): state for state in ET.parse(srdf).getroot().iter("group_state")}
    told = {joint.get("name"): float(joint.get("value", "nan")) for joint in states["ready"].iter("joint")}
    return np.array([told[name] for name in names])


def _move_zeros(root: ET.Element, zeros: dict[str, float]) -> None:
    """Turns each joint's origin about its axis, and moves its limits, so that it is at 0 where it was at its value here."""
    for joint in root.iter("joint"):
        if (zero := zeros.get(str(joint.get("name")))) is not None:
            read = lambda tag, key, joint=joint: np.array(joint.find(tag).get(key, "0 0 0").split(), float)
            turned = pin.rpy.rpyToMatrix(read("origin", "rpy")) @ pin.AngleAxis(zero, read("axis", "xyz")).matrix()
            joint.find("origin").set("rpy", " ".join(map(str, pin.rpy.matrixToRpy(turned))))  # type: ignore[union-attr]
            for key in ("lower", "upper"):
                joint.find("limit").set(key, str(float(read("limit", key)[0]) - zero))  # type: ignore[union-attr]
            for held in joint.findall("safety_controller"):  # which has limits of its own
                joint.remove(held)


def _srdf(robot: jaxik.Robot, srdf: Path, **chain: Any) -> str:
    """A SRDF of the chain, with the plugins of the wheel, whose libraries have hashes in their names."""
    here, libraries = Path(tempfile.mkdtemp()), Path(tesseract_robotics.__file__).parents[1] / "tesseract_robotics.libs"
    named = lambda name: next(libraries.glob(f"libtesseract_{name}_factories-*.so")).name[3:-3]
    kdl, core, bullet = (named(name) for name in ("kinematics_kdl", "kinematics_core", "collision_bullet"))
    (here / "kinematics.yaml").write_text(KINEMATICS.format(folder=libraries, kdl=kdl, core=core, **chain))
    (here / "contacts.yaml").write_text(CONTACTS.format(folder=libraries, bullet=bullet))
    pairs = "".join(f'<disable_collisions link1="{a}" link2="{b}" reason="" />' for a, b in ignored(robot, srdf))
    return f"""<robot name="{robot.name}">
        <group name="{NAME}"><chain base_link="{chain["base"]}" tip_link="{chain["tip"]}"/></group>
        <kinematics_plugin_config filename="file://{here}/kinematics.yaml"/>
        <contact_managers_plugin_config filename="file://{here}/contacts.yaml"/>{pairs}</robot>"""


def _box(number: int, base: str, frame: np.ndarray, half: tuple[float, ...]) -> Any:
    link, joint, shape = Link(f"obstacle_{number}"), Joint(f"obstacle_{number}_joint"), Collision()
    shape.geometry = Box(*(2.0 * float(x) for x in half))
    link.collision.push_back(shape)
    joint.parent_link_name, joint.child_link_name, joint.type = base, link.getName(), JointType_FIXED
    joint.parent_to_joint_origin_transform = common.Isometry3d(np.asarray(frame, float))
    return AddLinkCommand(link, joint)
