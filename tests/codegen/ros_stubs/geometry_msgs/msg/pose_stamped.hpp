#pragma once
#include <std_msgs/msg/int32.hpp>

namespace geometry_msgs::msg {
struct PoseStamped {
  std_msgs::msg::Header header;
  struct {
    struct {
      double x, y, z;
    } position;
    struct {
      double x, y, z, w;
    } orientation;
  } pose;
};
}  // namespace geometry_msgs::msg
