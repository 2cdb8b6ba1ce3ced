#pragma once
#include <cstdint>
#include <string>

namespace std_msgs::msg {
struct Int32 {
  std::int32_t data = 0;
};
struct Header {
  std::string frame_id;
};
}  // namespace std_msgs::msg
