// The ROS 2 node around the follower: messages in, messages out, and nothing else. See README.md for the conventions.
#include <algorithm>
#include <chrono>
#include <memory>
#include <string>

#include <geometry_msgs/msg/pose_stamped.hpp>
#include <rclcpp/rclcpp.hpp>
#include <sensor_msgs/msg/joint_state.hpp>
#include <std_msgs/msg/int32.hpp>
#include <trajectory_msgs/msg/joint_trajectory.hpp>

#include "jaxik_follower/follower.hpp"

namespace jaxik_follower {

class FollowerNode : public rclcpp::Node {
 public:
  FollowerNode() : Node("jaxik_follower") {
    options_.period = declare_parameter("period", options_.period);
    options_.timeout = declare_parameter("timeout", options_.timeout);
    options_.velocity = declare_parameter("velocity", options_.velocity);
    options_.jump = declare_parameter("jump", options_.jump);
    options_.margin = declare_parameter("margin", options_.margin);
    base_frame_ = declare_parameter("base_frame", std::string(arm_base));
    follower_ = std::make_unique<Follower>(options_);

    command_.joint_names.assign(arm_joint_names, arm_joint_names + kJoints);
    command_.points.resize(1);
    command_.points[0].positions.resize(kJoints);
    command_.points[0].time_from_start = rclcpp::Duration::from_seconds(options_.period);

    const auto newest = rclcpp::SensorDataQoS().keep_last(1);
    commands_ = create_publisher<trajectory_msgs::msg::JointTrajectory>("joint_trajectory", rclcpp::QoS(1));
    reasons_ = create_publisher<std_msgs::msg::Int32>("reason", rclcpp::QoS(1));
    targets_ = create_subscription<geometry_msgs::msg::PoseStamped>(
        "target", newest, [this](const geometry_msgs::msg::PoseStamped &message) { take(message); });
    states_ = create_subscription<sensor_msgs::msg::JointState>(
        "joint_states", newest, [this](const sensor_msgs::msg::JointState &message) { take(message); });
    timer_ = create_wall_timer(std::chrono::duration<double>(options_.period), [this] { step(); });
  }

 private:
  static double now_seconds() {
    return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
  }

  void take(const geometry_msgs::msg::PoseStamped &message) {
    if (message.header.frame_id != base_frame_) {
      RCLCPP_WARN_THROTTLE(get_logger(), *get_clock(), 1000, "target in frame '%s'; give it in '%s'",
                           message.header.frame_id.c_str(), base_frame_.c_str());
      return;
    }
    const auto &at = message.pose.position;
    const auto &turn = message.pose.orientation;
    follower_->target(pose_of({at.x, at.y, at.z}, {turn.x, turn.y, turn.z, turn.w}), now_seconds());
  }

  void take(const sensor_msgs::msg::JointState &message) {
    Posture posture;
    if (posture_of(message.name, message.position, posture)) follower_->measured(posture, now_seconds());
  }

  void step() {
    const Sample sample = follower_->step(now_seconds());
    if (sample.reason != told_) RCLCPP_INFO(get_logger(), "%s", text(sample.reason));
    told_ = sample.reason;
    reason_.data = static_cast<std::int32_t>(sample.reason);
    reasons_->publish(reason_);
    if (sample.reason == Reason::no_posture) return;
    std::copy(sample.posture.begin(), sample.posture.end(), command_.points[0].positions.begin());
    commands_->publish(command_);
  }

  Options options_;
  std::string base_frame_;
  std::unique_ptr<Follower> follower_;
  Reason told_ = Reason::no_posture;
  trajectory_msgs::msg::JointTrajectory command_;
  std_msgs::msg::Int32 reason_;
  rclcpp::Publisher<trajectory_msgs::msg::JointTrajectory>::SharedPtr commands_;
  rclcpp::Publisher<std_msgs::msg::Int32>::SharedPtr reasons_;
  rclcpp::Subscription<geometry_msgs::msg::PoseStamped>::SharedPtr targets_;
  rclcpp::Subscription<sensor_msgs::msg::JointState>::SharedPtr states_;
  rclcpp::TimerBase::SharedPtr timer_;
};

}  // namespace jaxik_follower

int main(int count, char **words) {
  rclcpp::init(count, words);
  rclcpp::spin(std::make_shared<jaxik_follower::FollowerNode>());
  rclcpp::shutdown();
  return 0;
}
