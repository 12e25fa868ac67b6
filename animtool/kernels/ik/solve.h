// Inverse kinematics, from the arrays of a problem.
#pragma once

#include <cstdint>
#include <tuple>
#include <vector>

#include "base/arrays.h"

namespace animtool {

// Name, rows, width of a target, whether it misses lengths, whether CCD heeds it, of each.
using IkGoalKind = std::tuple<const char*, int, int, bool, bool>;
std::vector<IkGoalKind> ik_goal_kinds();

void to_chain_targets(Filled<double, 3> targets, In<double, 2> frames, double length);

// coordinates, misses, reports, seconds
using IkSolved = std::tuple<Out<double, 2>, Out<double, 3>, Out<std::int64_t, 2>, Out<double, 1>>;
struct IkProblems {
  In<std::int64_t, 2> nodes;
  In<double, 2> numbers;
  In<std::int64_t, 2> goals;
  In<double, 2> goal_numbers, starts;
  In<double, 3> targets, reachable;
  In<double, 2> stretches, rests;
  double rest_weight, length_tolerance, angle_tolerance, damping;
  int iterations, restarts;
  std::uint64_t seed;
  double seconds;
  bool ordered, warm;
  int method;
};
IkSolved solve_ik(const IkProblems& problems);

// sought, scales, eased
using IkExtended = std::tuple<Out<double, 3>, Out<double, 2>, Out<bool, 2>>;
IkExtended extend_ik_limbs(In<std::int64_t, 1> limbs, In<double, 2> limb_numbers,
                           In<double, 3> targets);

// coordinates, residuals, Jacobians, curvatures
using IkLinearized = std::tuple<Out<double, 2>, Out<double, 2>, Out<double, 3>, Out<double, 2>>;
IkLinearized linearize_ik(In<std::int64_t, 2> nodes, In<double, 2> numbers,
                          In<std::int64_t, 2> goals, In<double, 2> goal_numbers,
                          In<double, 2> starts, In<double, 3> targets, In<double, 2> steps);

// coordinates, misses, rounds, cost before and after
using IkSmoothed = std::tuple<Out<double, 2>, Out<double, 3>, int, double, double>;
struct IkSmoothing {
  In<std::int64_t, 2> nodes;
  In<double, 2> numbers;
  In<std::int64_t, 2> goals;
  In<double, 2> goal_numbers, path;
  In<double, 3> targets, reachable;
  In<double, 2> stretches, drifts;
  double anchor, speed, acceleration;
  std::size_t first, end;
  double length_tolerance, angle_tolerance, damping;
  int rounds;
};
IkSmoothed smooth_ik(const IkSmoothing& problems);

// coordinates, misses, searched, taken, rounds, cost before and after
using IkFitted = std::tuple<Out<double, 2>, Out<double, 3>, Out<std::int64_t, 1>,
                            Out<std::int64_t, 2>, int, double, double>;
struct IkFitting {
  In<std::int64_t, 2> nodes;
  In<double, 2> numbers;
  In<std::int64_t, 2> goals;
  In<double, 2> goal_numbers, path;
  In<double, 3> targets;
  In<double, 2> starts;
  double anchor, speed, acceleration, robust, rest_weight, homing;
  std::size_t first, end;
  int iterations, rounds;
  bool tracked;
};
IkFitted fit_ik(const IkFitting& problems);

Out<std::int64_t, 1> cheapest_ik_path(In<std::int64_t, 2> nodes, In<double, 2> numbers,
                                      In<double, 3> paths, In<double, 2> costs,
                                      In<double, 2> drifts, In<double, 1> easy, bool open,
                                      bool closed);

}  // namespace animtool
