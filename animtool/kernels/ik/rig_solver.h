// IK problems of one rig: from its coordinates and targets in the world to its poses.
#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <tuple>
#include <vector>

#include "base/arrays.h"

namespace animtool {

// Arguments of the solver: the arrays of a problem, and its settings.
struct RigSolverArrays {
  // The chain and its goals, as for `solve_ik`.
  In<std::int64_t, 2> nodes;
  In<double, 2> numbers;
  In<std::int64_t, 2> goals;
  In<double, 2> goal_numbers;
  double rest_weight;
  // node_from_joint of each goal, and the length of the chain, which scales targets.
  In<double, 2> goal_frames;
  double length;
  // See `RigMapArrays`.
  In<std::int64_t, 1> columns;
  In<double, 1> scales;
  In<double, 2> periods;
  In<std::int64_t, 1> balls;
  In<double, 2> ball_frames;
  In<std::int64_t, 2> mimics;
  In<double, 2> mimic_numbers;
  // Limbs that extend softly or stretch: goals and numbers; joints of their bones, with the goal of
  // each.
  In<std::int64_t, 1> limbs;
  In<double, 2> limb_numbers;
  In<std::int64_t, 2> limb_joints;
  // The joints of the rig.
  In<std::int64_t, 1> parents, types, joint_columns;
  In<double, 2> axes, rest_translations, rest_rotations;
  int closed;
  double length_tolerance, angle_tolerance, damping;
  int iterations, restarts;
  std::uint64_t seed;
  double seconds;
  bool ordered, warm;
  int method;
};

// coordinates, errors, reports, seconds, reached, scales, positions, linear
using RigSolveResult =
    std::tuple<Out<double, 2>, Out<double, 3>, Out<std::int64_t, 2>, Out<double, 1>, Out<bool, 2>,
               Out<double, 2>, Out<double, 3>, Out<double, 4>>;

// Solves IK problems in the coordinates of a rig.
class RigSolver {
 public:
  explicit RigSolver(const RigSolverArrays& arrays);
  ~RigSolver();

  RigSolveResult solve(In<double, 2> starts, In<double, 3> targets,
                       std::optional<In<double, 2>> preferred, bool returns_joint_poses);

  // All poses of an arm of six pins that reach targets.
  Out<double, 2> branches(In<double, 1> start, In<double, 2> targets);

 private:
  struct Problem;

  std::unique_ptr<Problem> problem_;
  std::mutex mutex_;
};

// Kind of closed form of a six-pin arm: 0 none, 1 spherical wrist, 2 parallel axes.
int arm_kind(In<std::int64_t, 2> nodes, In<double, 2> numbers, In<std::int64_t, 2> goals,
             In<double, 2> goal_numbers, double rest_weight);

}  // namespace animtool
