#pragma once
#include <rclcpp/rclcpp.hpp>
#include <string>
#include <vector>

namespace trajectory_msgs::msg {
struct JointTrajectoryPoint {
  std::vector<double> positions;
  builtin_interfaces::msg::Duration time_from_start;
};
struct JointTrajectory {
  std::vector<std::string> joint_names;
  std::vector<JointTrajectoryPoint> points;
};
}  // namespace trajectory_msgs::msg
