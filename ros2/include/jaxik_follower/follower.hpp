// The follower: poses of the tip in, joint positions out, a sample at a time. It knows nothing of ROS.
//
// Each sample asks the exported search for the posture near the last one, and goes towards it as far as the velocities allow.
// Where there is no fresh input, or no answer, it holds the arm where it is and says why. A step allocates nothing.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "arm_robot.h"

namespace jaxik_follower {

constexpr std::size_t kJoints = ARM_JOINTS;
using Posture = std::array<double, kJoints>;  // [rad, m], in the order of arm_joint_names
using Pose = std::array<double, 16>;          // base_T_tip, row by row; translation [m]

// Why the arm goes on or holds. Numbers below 100 are those of jaxik.Reason.
enum class Reason : std::int32_t {
  solved = 0,
  out_of_reach = 1,   // the target is proven to be
  limits = 2,         // the Python follower alone tells this; here it is `not_converged`
  collision = 3,      // what was found, or the next sample, comes closer than the margin to something
  not_converged = 4,  // no posture was found that has the pose
  invalid = 5,        // the target is no pose: NaN, or a quaternion whose length is not 1
  no_posture = 100,   // no fresh joint positions have come
  no_target = 101,    // no fresh target has come
  far = 102,          // the answer is another way to hold the tip, too far from the posture now
};

const char *text(Reason reason);

// The pose of a position [m] and a quaternion in the order of geometry_msgs, x y z w; NaN, hence `invalid`, where its length is
// not 1 to a thousandth.
Pose pose_of(const std::array<double, 3> &position, const std::array<double, 4> &xyzw);

// Joint positions by name, in any order, among others; false, and nothing is changed, where one is missing.
bool posture_of(const std::vector<std::string> &names, const std::vector<double> &positions, Posture &posture);

struct Options {
  double period = 0.004;  // [s] between samples; a step that comes late does not go further
  double timeout = 0.1;   // [s] after which a target or a posture is stale
  double velocity = 0.5;  // [rad/s, m/s] of any joint at most; the robot's own limits hold, too
  double jump = 1.0;      // [rad, m] that an answer may be away from the posture now
  double margin = 0.0;    // [m] to the scene and of the robot to itself
};

struct Sample {
  Posture posture;   // to command now; nothing is to be commanded with `no_posture`
  Reason reason;     // `solved`, or why the arm holds
  double remaining;  // [rad, m] of that joint that has the longest way to the answer; 0 on the target
};

// Times are seconds of a clock that never goes back, on which all are told. One thread calls.
class Follower {
 public:
  explicit Follower(const Options &options);

  void measured(const Posture &posture, double now);
  void target(const Pose &pose, double now);
  Sample step(double now);

 private:
  Sample hold(Reason reason) const;
  bool is_fresh(double then, double now) const;
  Sample towards(const Posture &answer, double seconds);

  Options options_;
  Posture measured_{}, commanded_{}, limits_{};
  Pose target_{};
  double measured_at_, target_at_, stepped_at_;
  bool begun_ = false;
};

}  // namespace jaxik_follower
