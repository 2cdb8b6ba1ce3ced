// The follower on a circle, and where it has to hold. Poses are judged by the exported forward kinematics.
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <new>

#include "arm.h"
#include "jaxik_follower/follower.hpp"

using namespace jaxik_follower;

static int failed = 0;
static long allocations = 0;

void *operator new(std::size_t size) {
  allocations++;
  if (void *found = std::malloc(size)) return found;
  throw std::bad_alloc();
}
void operator delete(void *place) noexcept { std::free(place); }
void operator delete(void *place, std::size_t) noexcept { std::free(place); }

static void expect(bool holds, const char *what) {
  if (holds) return;
  failed++;
  std::printf("FAILED: %s\n", what);
}

static Pose pose_at(const Posture &q) {
  Pose pose;
  arm_pose(q.data(), pose.data());
  return pose;
}

static double apart(const Pose &a, const Pose &b) {
  double most = 0.0;
  for (std::size_t i = 0; i < a.size(); i++) most = std::fmax(most, std::fabs(a[i] - b[i]));
  return most;
}

static double moved(const Posture &a, const Posture &b) {
  double most = 0.0;
  for (std::size_t j = 0; j < kJoints; j++) most = std::fmax(most, std::fabs(a[j] - b[j]));
  return most;
}

// The middle of the joints' ranges, 0 where they have none.
static Posture middle() {
  Posture q;
  for (std::size_t j = 0; j < kJoints; j++) {
    const double between = (arm_lower[j] + arm_upper[j]) / 2;
    q[j] = std::isfinite(between) ? between : 0.0;
  }
  return q;
}

static Pose moved_by(Pose pose, double x, double y, double z) {
  pose[3] += x, pose[7] += y, pose[11] += z;
  return pose;
}

// An arm that goes where it is sent, and the time.
struct Run {
  Options options;
  Follower follower{options};
  Posture q = middle();
  double now = 1000.0;

  Sample step(const Pose *target) {
    now += options.period;
    follower.measured(q, now);
    if (target != nullptr) follower.target(*target, now);
    const Sample sample = follower.step(now);
    bool within = true;
    for (std::size_t j = 0; j < kJoints; j++) {
      const double most = std::fmin(options.velocity, arm_velocity[j]) * options.period;
      within = within && std::fabs(sample.posture[j] - q[j]) <= most * (1 + 1e-9);
      within = within && sample.posture[j] >= arm_lower[j] && sample.posture[j] <= arm_upper[j];
    }
    expect(within, "steps keep to the limits of velocity and position");
    q = sample.posture;
    return sample;
  }
};

static void holds(Run &run, const Pose *target, Reason reason, const char *what) {
  const Posture before = run.q;
  const Sample sample = run.step(target);
  if (sample.reason != reason) std::printf("told: %s\n", text(sample.reason));
  expect(sample.reason == reason, what);
  expect(moved(before, sample.posture) == 0.0, "the arm holds");
}

static void follows_a_circle() {
  Run run;
  const Pose centre = pose_at(run.q);
  double worst = 0.0;
  int there = 0;
  const long before = allocations;
  for (int i = 0; i < 1000; i++) {
    const double angle = 6.283185307179586 * i / 1000;
    const Pose target = moved_by(centre, 0.05 * std::sin(angle), 0.05 * (1 - std::cos(angle)), 0.0);
    const Sample sample = run.step(&target);
    expect(sample.reason == Reason::solved, "each pose of the circle has an answer");
    if (i == 0) expect(sample.remaining < 1.0, "the first answer is near");
    if (sample.remaining == 0.0) there++, worst = std::fmax(worst, apart(pose_at(sample.posture), target));
  }
  expect(allocations == before, "a step allocates nothing");
  expect(there > 900, "most samples are on the target");
  expect(worst < 1e-6, "samples on the target have its pose");
  std::printf("circle: %d of 1000 samples on the target, at most %.1e apart\n", there, worst);
}

static void goes_far_at_its_own_pace() {
  Run run;
  const Pose target = moved_by(pose_at(run.q), 0.0, 0.2, -0.1);
  int samples = 1;
  while (run.step(&target).remaining > 0.0 && samples < 1000) samples++;
  expect(samples > 10 && samples < 1000, "a far target takes many samples, and is reached");
  expect(apart(pose_at(run.q), target) < 1e-6, "a far target is reached");
}

static void stops_without_input() {
  Run run;
  const Pose start = pose_at(run.q), target = moved_by(start, 0.0, 0.2, 0.0);
  holds(run, nullptr, Reason::no_target, "nothing moves before the first target");
  run.step(&target);
  const int fresh = static_cast<int>(run.options.timeout / run.options.period);
  for (int i = 0; i < fresh + 2; i++) run.step(nullptr);
  holds(run, nullptr, Reason::no_target, "a stale target stops the arm");
  expect(run.step(&target).reason == Reason::solved, "a fresh one lets it go on");

  Follower blind{run.options};
  blind.target(target, 0.0);
  expect(blind.step(0.0).reason == Reason::no_posture, "nothing is commanded before the arm is seen");
  Posture bad = run.q;
  bad[0] = std::nan("");
  blind.measured(bad, 0.0);
  expect(blind.step(0.0).reason == Reason::no_posture, "a posture of NaN counts as none");
  blind.measured(run.q, 0.0);
  expect(blind.step(0.05).reason == Reason::solved, "a fresh posture is enough");
  expect(blind.step(0.2).reason == Reason::no_posture, "a stale posture stops it");
  Posture elsewhere = run.q;
  elsewhere[0] += 0.3;
  blind.measured(elsewhere, 0.3);
  expect(moved(blind.step(0.3).posture, elsewhere) == 0.0, "it begins anew from where the arm is seen again");
}

static void says_why_it_holds() {
  Run run;
  const Pose start = pose_at(run.q);
  const Pose away = moved_by(start, 30.0, 0.0, 0.0);
  const Pose none = pose_of({0.4, 0.0, 0.5}, {0.0, 0.0, 0.0, 0.0}), shorter = pose_of({0.4, 0.0, 0.5}, {0.0, 0.0, 0.0, 0.9});
  holds(run, &away, Reason::out_of_reach, "a pose out of reach has no answer");
  holds(run, &none, Reason::invalid, "a quaternion of 0 is no rotation");
  holds(run, &shorter, Reason::invalid, "nor is one that is far from length 1");
  expect(run.step(&start).reason == Reason::solved, "a pose in reach lets it go on");

  Run narrow;
  narrow.options.jump = 1e-3;
  narrow.follower = Follower{narrow.options};
  const Pose aside = moved_by(start, 0.0, 0.2, 0.0);
  holds(narrow, &aside, Reason::far, "an answer beyond the jump is not gone to");
  Run wide;
  wide.options.margin = 10.0;
  wide.follower = Follower{wide.options};
  holds(wide, &aside, Reason::collision, "what is closer than the margin is not gone to");
}

static void reads_messages() {
  const Pose pose = pose_of({1, 2, 3}, {0, 0, std::sqrt(0.5), std::sqrt(0.5)});  // a quarter about z; w is last
  const Pose wanted = {0, -1, 0, 1, 1, 0, 0, 2, 0, 0, 1, 3, 0, 0, 0, 1};
  expect(apart(pose, wanted) < 1e-15, "quaternions are x y z w");
  std::vector<std::string> names{"finger"};
  std::vector<double> positions{9.0};
  for (std::size_t j = kJoints; j-- > 0;) names.push_back(arm_joint_names[j]), positions.push_back(double(j));
  Posture posture{};
  expect(posture_of(names, positions, posture), "joints come in any order, among others");
  for (std::size_t j = 0; j < kJoints; j++) expect(posture[j] == double(j), "joints are told apart by name");
  names.pop_back();
  expect(!posture_of(names, positions, posture), "a missing joint is noticed");
}

int main() {
  follows_a_circle();
  goes_far_at_its_own_pace();
  stops_without_input();
  says_why_it_holds();
  reads_messages();
  expect(allocations > 0, "allocations are counted");  // those of reads_messages
  std::printf(failed ? "%d failed\n" : "all hold\n", failed);
  return failed != 0;
}
