// Follows the targets on standard input from a posture, which is the command's arguments [rad, m]; for pipes, files and tests.
//
//     follow 0 0 0 -1.57 0 1.87 0 < targets.txt
//
// A line of input is a time [s] and a pose, "t x y z qx qy qz qw", or a time alone, at which no target comes. A line of output
// is that time, the number of the reason, and the joint positions.
#include <cstdio>
#include <cstdlib>
#include <iostream>
#include <sstream>
#include <string>

#include "jaxik_follower/follower.hpp"

using namespace jaxik_follower;

int main(int count, char **words) {
  if (count != static_cast<int>(kJoints) + 1) {
    std::fprintf(stderr, "follow: %d joint positions; write %zu [rad, m]:", count - 1, kJoints);
    for (const char *name : arm_joint_names) std::fprintf(stderr, " %s", name);
    std::fprintf(stderr, "\n");
    return 2;
  }
  Posture posture;
  for (std::size_t j = 0; j < kJoints; j++) posture[j] = std::atof(words[j + 1]);
  Follower follower{Options{}};
  for (std::string line; std::getline(std::cin, line);) {
    std::istringstream numbers(line);
    double now;
    std::array<double, 3> position;
    std::array<double, 4> xyzw;
    if (!(numbers >> now)) continue;
    follower.measured(posture, now);  // an arm that goes where it is sent
    if (numbers >> position[0] >> position[1] >> position[2] >> xyzw[0] >> xyzw[1] >> xyzw[2] >> xyzw[3]) {
      follower.target(pose_of(position, xyzw), now);
    }
    const Sample sample = follower.step(now);
    posture = sample.posture;
    std::printf("%.17g %d", now, static_cast<int>(sample.reason));
    for (double q : sample.posture) std::printf(" %.17g", q);
    std::printf("\n");
  }
  return 0;
}
