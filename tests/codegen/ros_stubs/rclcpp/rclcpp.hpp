// As much of rclcpp as ros2/src/node.cpp uses, by the signatures of ROS 2 Humble, to check the node's types without ROS.
#pragma once
#include <chrono>
#include <memory>
#include <string>

namespace builtin_interfaces::msg {
struct Time {};
struct Duration {};
}  // namespace builtin_interfaces::msg

namespace rclcpp {
struct Logger {};
struct Clock {};
struct Duration {
  static Duration from_seconds(double seconds);
  operator builtin_interfaces::msg::Duration() const;
};
struct QoS {
  explicit QoS(std::size_t depth);
  QoS &keep_last(std::size_t depth);
};
struct SensorDataQoS : QoS {
  SensorDataQoS();
};
template <typename Message>
struct Publisher {
  using SharedPtr = std::shared_ptr<Publisher>;
  void publish(const Message &message);
};
template <typename Message>
struct Subscription {
  using SharedPtr = std::shared_ptr<Subscription>;
};
struct TimerBase {
  using SharedPtr = std::shared_ptr<TimerBase>;
};
class Node {
 public:
  explicit Node(const std::string &name);
  template <typename T>
  T declare_parameter(const std::string &name, const T &value);
  template <typename Message>
  typename Publisher<Message>::SharedPtr create_publisher(const std::string &topic, const QoS &qos);
  template <typename Message, typename Callback>
  typename Subscription<Message>::SharedPtr create_subscription(const std::string &topic, const QoS &qos, Callback callback) {
    callback(Message{});  // so that what it takes is checked
    (void)topic, (void)qos;
    return nullptr;
  }
  template <typename Rep, typename Period, typename Callback>
  TimerBase::SharedPtr create_wall_timer(std::chrono::duration<Rep, Period> period, Callback callback) {
    callback();
    (void)period;
    return nullptr;
  }
  Logger get_logger() const;
  std::shared_ptr<Clock> get_clock();
};
void init(int count, char **words);
void spin(std::shared_ptr<Node> node);
void shutdown();
void told(Logger logger, const char *format, ...);
}  // namespace rclcpp

#define RCLCPP_INFO(logger, ...) rclcpp::told(logger, __VA_ARGS__)
#define RCLCPP_WARN_THROTTLE(logger, clock, milliseconds, ...) \
  ((void)(clock), (void)(milliseconds), rclcpp::told(logger, __VA_ARGS__))
