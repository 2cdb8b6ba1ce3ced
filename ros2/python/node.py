#!/usr/bin/env python3
"""The ROS 2 node around the follower in Python: messages in, messages out, and nothing else. README.md has the conventions."""

from __future__ import annotations

import dataclasses
import time

import rclpy
from follower import Follower, Holding, Options, pose_of, posture_of
from geometry_msgs.msg import PoseStamped
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Int32
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

import jaxik

NEWEST = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


class FollowerNode(Node):
    """Follows `target` from `joint_states`, and tells `joint_trajectory` and `reason`."""

    def __init__(self) -> None:
        super().__init__("jaxik_follower")
        told = {f.name: self.declare_parameter(f.name, f.default).value for f in dataclasses.fields(Options)}
        self.robot = jaxik.load(self.declare_parameter("robot", "panda").value)
        scene = self.declare_parameter("scene", "").value
        options = Options(**told)
        self.base_frame = self.declare_parameter("base_frame", self.robot.link_names[0]).value
        self.follower = Follower(self.robot, jaxik.load_scene(scene) if scene else None, options)
        self.last: int = Holding.NO_POSTURE
        self.after = Duration(seconds=options.period).to_msg()
        self.commands = self.create_publisher(JointTrajectory, "joint_trajectory", 1)
        self.reasons = self.create_publisher(Int32, "reason", 1)
        self.create_subscription(PoseStamped, "target", self.take_target, NEWEST)
        self.create_subscription(JointState, "joint_states", self.take_state, NEWEST)
        self.create_timer(options.period, self.step)

    def take_target(self, message: PoseStamped) -> None:
        if message.header.frame_id != self.base_frame:
            told = f"target in frame '{message.header.frame_id}'; give it in '{self.base_frame}'"
            self.get_logger().warning(told, throttle_duration_sec=1.0)
            return
        at, turn = message.pose.position, message.pose.orientation
        self.follower.target(pose_of((at.x, at.y, at.z), (turn.x, turn.y, turn.z, turn.w)), time.monotonic())

    def take_state(self, message: JointState) -> None:
        posture = posture_of(self.robot, message.name, message.position)
        if posture is not None:
            self.follower.measured(posture, time.monotonic())

    def step(self) -> None:
        sample = self.follower.step(time.monotonic())
        if sample.reason != self.last:
            self.get_logger().info(sample.reason.name.lower().replace("_", " "))
        self.last = sample.reason
        self.reasons.publish(Int32(data=int(sample.reason)))
        if sample.reason != Holding.NO_POSTURE:
            point = JointTrajectoryPoint(positions=sample.posture.tolist(), time_from_start=self.after)
            self.commands.publish(JointTrajectory(joint_names=list(self.robot.joint_names), points=[point]))


def main() -> None:
    rclpy.init()
    rclpy.spin(FollowerNode())
    rclpy.shutdown()


if __name__ == "__main__":
    main()
