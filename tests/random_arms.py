"""Arms of every family, otherwise at random: axes, offsets, zeros, signs, frames."""

from pathlib import Path

import numpy as np
from peers.arm import eaik_robot

from jaxik.files.robot_builder import Joint, assemble

FAMILIES = {  # which axes (from 0) meet in a point, which are parallel; and how many joints there are
    "wrist, 2 and 3 parallel": ([(3, 4, 5)], [(1, 2)], 6),
    "wrist, 1 and 2 meet": ([(0, 1), (3, 4, 5)], [], 6),
    "wrist, 2 and 3 meet": ([(1, 2), (3, 4, 5)], [], 6),
    "wrist, 1 and 2 parallel": ([(3, 4, 5)], [(0, 1)], 6),
    "wrist, any": ([(3, 4, 5)], [], 6),
    "shoulder, any": ([(0, 1, 2)], [], 6),
    "shoulder, 5 and 6 meet": ([(0, 1, 2), (4, 5)], [], 6),
    "2 to 4 parallel, 5 and 6 meet": ([(4, 5)], [(1, 2, 3)], 6),
    "2 to 4 parallel, any": ([], [(1, 2, 3)], 6),
    "2 to 4 parallel, 5 and 6 too": ([], [(1, 2, 3), (4, 5)], 6),
    "1 to 3 parallel, 4 and 5 meet": ([(3, 4)], [(0, 1, 2)], 6),
    "1 to 3 parallel, any": ([], [(0, 1, 2)], 6),
    "3 to 5 parallel, any": ([], [(2, 3, 4)], 6),
    "4 to 6 parallel, 2 and 3 meet": ([(1, 2)], [(3, 4, 5)], 6),
    "arm angle": ([(0, 1, 2), (4, 5, 6)], [], 7),
    "shoulder, last joint given": ([(0, 1, 2), (4, 5)], [], 7),
    "wrist, first joint given": ([(4, 5, 6), (1, 2)], [], 7),
    "no family": ([], [], 7),
}


def rotation(rng):
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def frame(turn, place):
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = turn, place
    return found


def apart(a, b):
    """The largest angle between postures (..., n)."""
    return np.abs((a - b + np.pi) % (2 * np.pi) - np.pi).max(axis=-1)


def exact_branches_of_eaik(robot, poses):
    """Yields for each pose the postures (6,) that EAIK calls exact, without its least-squares ones."""
    peer, tip_rotation = eaik_robot(robot)
    assert peer.hasKnownDecomposition()
    for pose in poses:
        found = peer.IK(frame(pose[:3, :3] @ tip_rotation.T, pose[:3, 3]))
        yield [q for q, least_squares in zip(found.Q, found.is_LS, strict=True) if not least_squares]


def random_arm(seed, family, slide=False):
    """Tilted and offset wherever the family leaves it open; on a slide of any direction, if that is wanted."""
    meet, parallel, count = FAMILIES[family]
    rng = np.random.default_rng(seed)
    h, p = rng.normal(size=(count, 3)), rng.normal(size=(count, 3)) * 0.4
    for group in meet:
        p[list(group)] = p[group[0]]
    for group in parallel:
        h[list(group)] = h[group[0]] * rng.choice([-1.0, 1.0], (len(group), 1))
    return assembled(rng, h, p, f"arm{seed}", slide)


def assembled(rng, h, p, name, slide=False):
    """The arm of these axes, with its joints' frames, its tip's and its slide's direction at random."""
    h = h / np.linalg.norm(h, axis=1, keepdims=True)
    joints, before = [], np.eye(4)
    if slide:
        axis = rng.normal(size=3)
        joints.append(Joint("slide", "prismatic", np.eye(4), "cart", axis / np.linalg.norm(axis), -1.0, 1.0))
    for i in range(len(h)):
        here = frame(rotation(rng), p[i])
        joints.append(Joint(f"j{i}", "revolute", np.linalg.inv(before) @ here, f"l{i}", here[:3, :3].T @ h[i], -7.0, 7.0))
        before = here
    return assemble(Path("random"), name, "base", joints, {}, frame(rotation(rng), rng.normal(size=3) * 0.2))
