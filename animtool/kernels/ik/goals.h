// Goals of a chain: residuals, Jacobian and second derivatives.
#pragma once

#include <cstdint>
#include <vector>

#include "ik/goal_kinds.h"

namespace animtool::ik {

// A goal of one node, with a weight for each kind.
struct Goal {
  int node;
  double offset[3];  // of its point, in the node's frame: stretch_factor * bone + tool
  double stretching_offset[3],
      fixed_offset[3];  // the part that stretches with the limb, and the rest
  double aim_axis[3];
  double weights[COMPONENT_COUNT];  // 0 for kinds that are not used
  double stretch_factor = 1;
  int level = 0;               // priority: 0 is hard; higher levels yield to lower ones
  int root = -1, middle = -1;  // nodes of the limb with a pole
  int row = 0;                 // first row of its residuals
  std::vector<int> path;       // nodes that move it, from the root
};

inline double weight_of(const Goal& goal, const double* target, int component) {
  return goal.weights[component] * target[WEIGHTS_OFFSET + component];
}

// A chain with its goals.
struct Task {
  Chain chain;
  std::vector<Goal> goals;
  int row_count = 0;
  int level_count = 1;
  double rest_weight = 0;
};

// Number of residuals of a goal.
inline int count_rows(const Goal& goal) {
  int count = 0;
  for_each_kind([&]<class Kind>(int component) {
    count += Kind::RESIDUAL_COUNT * (goal.weights[component] > 0);
  });
  return count;
}

// Number of residuals with a weight in a row of targets.
inline int count_active_rows(const Task& task, const double* targets) {
  int count = 0;
  for (std::size_t e = 0; e < task.goals.size(); ++e)
    for_each_kind([&]<class Kind>(int component) {
      count += Kind::RESIDUAL_COUNT *
               (weight_of(task.goals[e], targets + TARGET_WIDTH * e, component) > 0);
    });
  return count;
}

// A pose of the chain with its residuals and errors.
struct State {
  std::vector<double> q;
  Frames frames;
  std::vector<double> residuals;  // (M,), weighted
  std::vector<double> points;     // (E, 3)
  std::vector<double> errors;     // errors (E, K), not weighted: lengths and angles
  std::vector<double> weights;    // (E, K), times the factors of the targets
  double cost = 0;                // cost of the goals and of the rest preference
  double rest_cost = 0;           // cost of the rest preference

  explicit State(const Task& task)
      : q(task.chain.coordinate_count),
        frames(task.chain),
        residuals(task.row_count),
        points(3 * task.goals.size()),
        errors(COMPONENT_COUNT * task.goals.size()),
        weights(COMPONENT_COUNT * task.goals.size()) {}
};

// The view of a goal; its point must be known.
inline GoalView view_of(const Goal& goal, const State& state, const double* point) {
  GoalView view{&state.frames.rotations[9 * goal.node],
                point,
                goal.aim_axis,
                goal.root,
                goal.middle,
                nullptr,
                nullptr};
  if (goal.middle < 0) return view;
  view.root_position = &state.frames.origins[3 * goal.root];
  view.middle_position = &state.frames.origins[3 * goal.middle];
  return view;
}

// Computes the residuals, errors and cost of the goals. `residual_offsets` (M,) are added to the
// residuals, unless null.
void measure(const Task& task, const double* targets, State& state,
             const double* residual_offsets = nullptr);

// The `JacobianTerms` of each kind.
template <class... Kind>
std::tuple<typename Kind::JacobianTerms...> jacobian_terms_of(const std::tuple<Kind...>&);
using AllJacobianTerms = decltype(jacobian_terms_of(GoalKinds{}));

// Computes the columns of the Jacobian (D, M), each contiguous in memory.
void differentiate(const Task& task, const double* targets, const State& state,
                   std::vector<double>& columns);

// Multiplies the second-order part of the Hessian, (Hessian of the cost - J^T J), by a direction,
// for positions and rotations only; adds the product to `out` (D,).
//
// Along a path, with joint i before joint j: d2p/didj = a_i x (a_j x (p - p_j)), and rotation
// vectors obey exp(x) exp(y) = exp(x + y + x cross y / 2 + ...). Sums over earlier and later joints
// make the time linear in their number.
class Curvature {
 public:
  explicit Curvature(const Task& task) : later_sums_(6 * task.chain.nodes.size()) {}

  void add(const Task& task, const State& state, const double* direction, double* out) {
    for (std::size_t e = 0; e < task.goals.size(); ++e) add(task, state, e, direction, out);
  }

 private:
  void add(const Task& task, const State& state, std::size_t e, const double* direction,
           double* out);

  // Adds the velocities of a point and its frame by the motion of one node.
  static void accumulate(const Task& task, const State& state, int n, const double* point,
                         const double* direction, double* linear, double* angular);

  std::vector<double> later_sums_;
};

// Smallest and largest distance of a goal's point from the first joint of its path, from bone
// lengths.
struct DistanceRange {
  double inner = 0, outer = 0;
};

DistanceRange distance_range(const Task& task, const Goal& goal);

// A lower bound of the cost of all poses, from bone lengths.
double cost_lower_bound(const Task& task, const double* targets, const Frames& frames);

// Scales the bones of limbs, starting at their first joint.
void stretch_limbs(const Chain& unstretched, const double* factors, Task& task);

}  // namespace animtool::ik
