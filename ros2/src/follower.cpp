#include "jaxik_follower/follower.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "arm.h"

namespace jaxik_follower {

namespace {

constexpr double kNever = -std::numeric_limits<double>::infinity();
constexpr double kUnit = 1e-3;      // that the length of a quaternion may be away from 1
constexpr double kRounding = 1e-9;  // [m] that an answer on the margin may be inside it

bool is_finite(const Posture &posture) {
  return std::all_of(posture.begin(), posture.end(), [](double x) { return std::isfinite(x); });
}

}  // namespace

const char *text(Reason reason) {
  switch (reason) {
    case Reason::solved: return "solved";
    case Reason::out_of_reach: return "out of reach";
    case Reason::limits: return "limits";
    case Reason::collision: return "collision";
    case Reason::not_converged: return "not converged";
    case Reason::invalid: return "invalid";
    case Reason::no_posture: return "no posture";
    case Reason::no_target: return "no target";
    case Reason::far: return "far";
  }
  return "unknown";
}

Pose pose_of(const std::array<double, 3> &position, const std::array<double, 4> &xyzw) {
  const double square = xyzw[3] * xyzw[3] + xyzw[0] * xyzw[0] + xyzw[1] * xyzw[1] + xyzw[2] * xyzw[2];
  const double length = std::sqrt(square);
  if (!(std::abs(length - 1.0) <= kUnit)) {
    Pose none;
    none.fill(std::numeric_limits<double>::quiet_NaN());
    return none;
  }
  const double x = xyzw[0] / length, y = xyzw[1] / length, z = xyzw[2] / length, w = xyzw[3] / length;
  return {1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), position[0],
          2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x), position[1],
          2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y), position[2],
          0, 0, 0, 1};
}

bool posture_of(const std::vector<std::string> &names, const std::vector<double> &positions, Posture &posture) {
  Posture found;
  for (std::size_t j = 0; j < kJoints; j++) {
    const auto at = static_cast<std::size_t>(std::find(names.begin(), names.end(), arm_joint_names[j]) - names.begin());
    if (at >= names.size() || at >= positions.size()) return false;
    found[j] = positions[at];
  }
  posture = found;
  return true;
}

Follower::Follower(const Options &options)
    : options_(options), measured_at_(kNever), target_at_(kNever), stepped_at_(kNever) {
  for (std::size_t j = 0; j < kJoints; j++) limits_[j] = std::min(options.velocity, arm_velocity[j]);
}

void Follower::measured(const Posture &posture, double now) {
  if (!is_finite(posture)) return;  // as if nothing had come
  measured_ = posture;
  measured_at_ = now;
}

void Follower::target(const Pose &pose, double now) {
  target_ = pose;
  target_at_ = now;
}

bool Follower::is_fresh(double then, double now) const { return now - then <= options_.timeout; }

Sample Follower::hold(Reason reason) const { return {commanded_, reason, 0.0}; }

Sample Follower::step(double now) {
  const double seconds = std::min(std::max(now - stepped_at_, 0.0), options_.period);
  stepped_at_ = now;
  if (!is_fresh(measured_at_, now)) {
    begun_ = false;  // the arm may be anywhere until it is seen again
    return hold(Reason::no_posture);
  }
  if (!begun_) commanded_ = measured_, begun_ = true;
  if (!is_fresh(target_at_, now)) return hold(Reason::no_target);

  Posture answer;
  std::int32_t reason, seed;
  double position_error, rotation_error, clearance;
  arm_ik_near(target_.data(), commanded_.data(), answer.data(), &reason, &position_error, &rotation_error, &clearance, &seed);
  if (reason != 0) return hold(static_cast<Reason>(reason));
  return towards(answer, seconds);
}

// Goes along a straight line of joint positions, all joints together, as fast as the slowest may.
Sample Follower::towards(const Posture &answer, double seconds) {
  double needed = 0.0, away = 0.0;
  for (std::size_t j = 0; j < kJoints; j++) {
    const double distance = std::abs(answer[j] - commanded_[j]);
    needed = std::max(needed, distance / limits_[j]);
    away = std::max(away, distance);
  }
  if (away > options_.jump) return hold(Reason::far);
  Posture next = answer;
  if (needed > seconds) {
    const double part = seconds / needed;
    for (std::size_t j = 0; j < kJoints; j++) next[j] = commanded_[j] + part * (answer[j] - commanded_[j]);
  }
  double clearance;
  arm_clearance(next.data(), &clearance);
  if (clearance < options_.margin - kRounding) return hold(Reason::collision);
  commanded_ = next;
  double remaining = 0.0;
  for (std::size_t j = 0; j < kJoints; j++) remaining = std::max(remaining, std::abs(answer[j] - next[j]));
  return {next, Reason::solved, remaining};
}

}  // namespace jaxik_follower
