"""A tray that two hands of Baxter carry through a door: the robot with the tray, the door, and configurations before and behind
it, with the hands as they hold the tray. Those before it were found by random walks from the one behind."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

import jaxik

HANDS = ["left_gripper", "right_gripper"]
TRAY = 0.16, 0.44, 0.02  # [m]
ASIDE, BEHIND = 0.14, 0.02  # of each hand, from the tray's middle and from its edge [m]
DOOR, WIDTH, THICK = 0.9, 0.56, 0.04  # before the robot [m]
FORWARDS = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])  # of a hand, in the tray
# fmt: off
GOAL = (-0.46643101, -0.59413250, -0.69414782, 2.05607034, -0.10069296, -1.39812663, 0.57917031,
    0.00296719, 0.36160671, 1.35948813, 2.02704854, 2.71970431, 1.28771378, 1.59187561)
STARTS = (
    (-0.25585801, -0.81423536, -1.73801863, 1.88935608, 0.52128008, -1.22397624, 1.76814233,
        -0.11712804, 0.25599245, 1.89406111, 2.13826110, 1.95749676, 1.46353952, 2.20545483),
    (-0.79035187, -1.37045672, -0.65098336, 1.58302108, 0.25533694, -1.47843325, 0.76304217,
        -0.09028826, 0.04230518, 2.05364468, 1.86102270, 1.93427986, 1.26810767, 2.13294452),
    (0.08448747, -1.13045873, -1.68618965, 1.71107295, 0.32658452, -1.44097905, 0.91147946,
        0.26848876, 0.15495610, 2.37131581, 1.94186758, 2.04198485, 0.84988129, 1.54370879),
)
# fmt: on


class Carrying(NamedTuple):
    """The robot with the tray in its hands, the door, starts (b, n), and the goal (n,)."""

    robot: jaxik.Robot
    door: jaxik.Scene
    starts: np.ndarray
    goal: np.ndarray


def carrying(robot: jaxik.Robot) -> Carrying:
    """Baxter, whose hands hold the tray, before the door."""
    hand = np.eye(4)
    hand[:3, :3], hand[:3, 3] = FORWARDS, (-0.5 * TRAY[0] - BEHIND, ASIDE, 0.0)
    left = robot.with_tips(HANDS[0])
    place = np.asarray(jaxik.forward_kinematics(left, np.array(GOAL)), np.float64) @ np.linalg.inv(hand)
    builder = jaxik.collision.SceneBuilder()
    builder.add("tray", boxes=[(place, TRAY)])
    sides = ("r_gripper", "right_gripper", "right_hand", "l_gripper", "left_gripper", "left_hand")
    hands = [name for name in robot.link_names if name.startswith(sides)]
    held = jaxik.collision.attach(left, builder.scene(), "tray", np.array(GOAL), touches=hands)
    posts = [[DOOR, side * 0.5 * (1.0 + WIDTH), 0.25, THICK, 1.0, 3.0] for side in (-1.0, 1.0)]
    return Carrying(held.robot.with_tips(HANDS), jaxik.make_scene(boxes=posts), np.array(STARTS), np.array(GOAL))
