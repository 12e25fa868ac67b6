// Goals of a chain: residuals, Jacobian and second derivatives.
#pragma once

#include <cstdint>
#include <vector>

#include "ik/goal_kinds.h"

namespace animtool::ik {

struct Goal {
  int node;
  double offset[3];  // of its point, in the node's frame: the part that stretches with the limb,
  double bone[3], tool[3];  // and the rest
  double aim_axis[3];
  double weights[PARTS];  // 0: not used
  double stretched = 1;
  int level = 0;               // priority: 0 is hard; higher levels yield to lower ones
  int root = -1, middle = -1;  // nodes of the limb with a pole
  int row = 0;
  std::vector<int> path;  // nodes that move it, from the root
};

inline double weight_of(const Goal& goal, const double* target, int part) {
  return goal.weights[part] * target[WEIGHTS + part];
}

struct Task {
  Chain chain;
  std::vector<Goal> goals;
  int rows = 0;
  int levels = 1;
  double rest_weight = 0;
};

inline int rows_of(const Goal& goal) {
  int count = 0;
  each_kind([&]<class Kind>(int part) { count += Kind::ROWS * (goal.weights[part] > 0); });
  return count;
}

inline int rows_asked(const Task& task, const double* targets) {
  int count = 0;
  for (std::size_t e = 0; e < task.goals.size(); ++e)
    each_kind([&]<class Kind>(int part) {
      count += Kind::ROWS * (weight_of(task.goals[e], targets + TARGET_WIDTH * e, part) > 0);
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
  double cost = 0;                // of the goals and of the rest preference
  double rest_cost = 0;           // the part of the rest preference

  explicit State(const Task& task)
      : q(task.chain.coordinates),
        frames(task.chain),
        residuals(task.rows),
        points(3 * task.goals.size()),
        errors(PARTS * task.goals.size()),
        weights(PARTS * task.goals.size()) {}
};

// Once its point is known.
inline View view_of(const Goal& goal, const State& state, const double* point) {
  View view{&state.frames.rotations[9 * goal.node],
            point,
            goal.aim_axis,
            goal.root,
            goal.middle,
            nullptr,
            nullptr};
  if (goal.middle < 0) return view;
  view.origin = &state.frames.origins[3 * goal.root];
  view.joint = &state.frames.origins[3 * goal.middle];
  return view;
}

// `shift` (M,) is added to the residuals, or null.
void measure(const Task& task, const double* targets, State& state, const double* shift = nullptr);

// Everything from which the Jacobian rows of all kinds are computed.
template <class... Kind>
std::tuple<typename Kind::Slopes...> slopes_of(const std::tuple<Kind...>&);
using Slopes = decltype(slopes_of(Kinds{}));

// Columns of the Jacobian (D, M), each contiguous in memory.
void differentiate(const Task& task, const double* targets, const State& state,
                   std::vector<double>& columns);

// Adds the second-order part of the Hessian times a direction to `out` (D,): (Hessian of the
// cost - J^T J) times `along`, for positions and rotations only.
//
// Along a path, joint i before joint j: d2p/didj = a_i x (a_j x (p - p_j)), and rotation
// vectors obey exp(x) exp(y) = exp(x + y + x cross y / 2 + ...). Sums over the joints before
// and behind make it linear in their number.
class Curvature {
 public:
  explicit Curvature(const Task& task) : behind_(6 * task.chain.nodes.size()) {}

  void add(const Task& task, const State& state, const double* along, double* out) {
    for (std::size_t e = 0; e < task.goals.size(); ++e) add(task, state, e, along, out);
  }

 private:
  void add(const Task& task, const State& state, std::size_t e, const double* along, double* out);

  static void accumulate(const Task& task, const State& state, int n, const double* point,
                         const double* along, double* linear, double* angular);

  std::vector<double> behind_;
};

// Lower bounds of errors from bone lengths.

// Smallest and largest distance of a goal's point from the first joint of its path.
struct Reach {
  double inner = 0, outer = 0;
};

Reach reach_of(const Task& task, const Goal& goal);

// A lower bound of the cost of all poses.
double nearest_cost(const Task& task, const double* targets, const Frames& frames);

// Stretching limbs.

// Scales the bones of limbs, starting at their first joint.
void stretch(const Chain& plain, const double* stretches, Task& task);

}  // namespace animtool::ik
