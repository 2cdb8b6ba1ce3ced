"""Every URDF of example-robot-data: poses, limits and friction as Pinocchio reads them, and no warning but two kinds."""

import re
import warnings

import numpy as np
import pinocchio as pin
import pytest
from defusedxml import ElementTree
from robots import FOLDER

import jaxik

TOLD = r"joints beside the chain are held|has no lower and no upper in its <limit>, which locks it at 0"
REFUSED = r"\(mimic\)|has no movable joint"
FILES = [file for file in sorted(FOLDER.rglob("*.urdf")) if "<link" in file.read_text()]  # one is empty


def leaf(file):
    """The link of a file that most joints lead to."""
    root = ElementTree.parse(file).getroot()
    above = {joint.find("child").get("link"): joint.find("parent").get("link") for joint in root.findall("joint")}
    depth = lambda link: 1 + depth(above[link]) if link in above else 0
    return max((link.get("name") for link in root.findall("link")), key=depth)


def followed(robot, q):
    """The values of all joints, those that mimic others last."""
    return [*q, *(m.value(q[m.joint]) for m in robot.mimics)]


def moved(robot, q):
    """The tip in the base, of a robot's numbers."""
    pose = np.eye(4)
    rows = [*zip(robot.parent_T_joint, robot.axis, robot.tree.slides, followed(robot, q), strict=True)]
    for fixed, axis, slides, value in (rows[i] for i in robot.tree.way(*robot.tips)):
        turn = np.eye(3) if slides else pin.AngleAxis(value, axis).toRotationMatrix()
        pose = pose @ fixed @ pin.SE3(turn, value * axis if slides else np.zeros(3)).homogeneous
    return pose @ robot.joint_T_tip


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_is_read_as_pinocchio_reads_it(file):
    tip = leaf(file)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            robot = jaxik.load(file, tip=tip)
        except jaxik.LoadError as error:
            assert re.search(REFUSED, str(error)), error
            return
    assert all(re.search(TOLD, str(warning.message)) for warning in told)
    model = pin.buildModelFromUrdf(str(file))
    data, full = model.createData(), pin.neutral(model)
    low, high = robot.finite_limits
    q = np.random.default_rng(0).uniform(np.maximum(low, -3.0), np.minimum(high, 3.0))
    joints = [model.joints[model.getJointId(name)] for name in robot.row_names]
    for joint, value in zip(joints, followed(robot, q), strict=True):
        full[joint.idx_q : joint.idx_q + joint.nq] = [value] if joint.nq == 1 else [np.cos(value), np.sin(value)]
    pin.framesForwardKinematics(model, data, full)
    place = lambda link: data.oMf[model.getFrameId(link)].homogeneous
    np.testing.assert_allclose(place(robot.link_names[0]) @ moved(robot, q), place(tip), atol=1e-12)
    if robot.mimics:  # whose friction the joints feel that they follow
        return
    rubs = [(float(d.friction.coulomb), float(d.friction.viscous)) for d in robot.drives] or [(0.0, 0.0)] * len(joints)
    assert rubs == [(model.friction[joint.idx_v], model.damping[joint.idx_v]) for joint in joints]
    ours = [(low, high) for low, high, joint in zip(robot.lower, robot.upper, joints, strict=True) if joint.nq == 1]
    assert ours == [(model.lowerPositionLimit[j.idx_q], model.upperPositionLimit[j.idx_q]) for j in joints if j.nq == 1]
