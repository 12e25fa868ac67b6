// Inverse kinematics, from the arrays of a problem.
#pragma once

#include <cstdint>
#include <tuple>
#include <vector>

#include "base/arrays.h"

namespace animtool {

// For each kind: name, number of residuals, width of a target, whether its error is a length, and
// whether cyclic coordinate descent supports it.
using IkGoalKind = std::tuple<const char*, int, int, bool, bool>;
std::vector<IkGoalKind> ik_goal_kinds();

// Converts targets of a rig to those of a chain, in place.
void to_chain_targets(Filled<double, 3> targets, In<double, 2> frames, double length);

// coordinates, errors, reports, seconds
using IkSolveResult =
    std::tuple<Out<double, 2>, Out<double, 3>, Out<std::int64_t, 2>, Out<double, 1>>;
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
IkSolveResult solve_ik(const IkProblems& problems);

// reachable targets, scales, softened
using IkExtension = std::tuple<Out<double, 3>, Out<double, 2>, Out<bool, 2>>;
IkExtension extend_ik_limbs(In<std::int64_t, 1> limbs, In<double, 2> limb_numbers,
                            In<double, 3> targets);

// coordinates, residuals, Jacobians, curvatures
using IkLinearization = std::tuple<Out<double, 2>, Out<double, 2>, Out<double, 3>, Out<double, 2>>;
IkLinearization linearize_ik(In<std::int64_t, 2> nodes, In<double, 2> numbers,
                             In<std::int64_t, 2> goals, In<double, 2> goal_numbers,
                             In<double, 2> starts, In<double, 3> targets, In<double, 2> steps);

// coordinates, errors, iterations, cost before and after
using IkSmoothResult = std::tuple<Out<double, 2>, Out<double, 3>, int, double, double>;
struct IkSmoothArguments {
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
IkSmoothResult smooth_ik(const IkSmoothArguments& problems);

// coordinates, errors, searched, target sources, iterations, cost before and after
using IkFitResult = std::tuple<Out<double, 2>, Out<double, 3>, Out<std::int64_t, 1>,
                               Out<std::int64_t, 2>, int, double, double>;
struct IkFitArguments {
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
IkFitResult fit_ik(const IkFitArguments& problems);

// Index of the cheapest path in each frame.
Out<std::int64_t, 1> cheapest_ik_path(In<std::int64_t, 2> nodes, In<double, 2> numbers,
                                      In<double, 3> paths, In<double, 2> costs,
                                      In<double, 2> drifts, In<double, 1> free_step,
                                      bool allows_any_start, bool must_end_on_first);

}  // namespace animtool
