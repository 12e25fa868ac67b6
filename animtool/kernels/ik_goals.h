// What is asked of the chain: residuals, their Jacobian, and their curvature.
//
// A residual r is what is missing, so that r(q + d) = r(q) - J d to first order, and
// the gradient of the cost |r|^2 / 2 is -J^T r, exactly: rotations are compared by
// their rotation vector in the world, apart from positions.
#pragma once

#include <cstdint>
#include <vector>

#include "ik_chain.h"

namespace animtool::ik {

struct Goal {
  int node;
  double offset[3];  // of its point, in the node's frame: what stretches with the limb,
  double bone[3], tool[3];  // and what does not
  double aim_axis[3];
  double weights[4];  // position, orientation, aim, pole; 0 is not asked for
  double stretched = 1;
  int level = 0;      // 0 is hard; higher ones give way to those below
  int root = -1, middle = -1;  // of the limb that has a pole
  int row = 0;
  std::vector<int> path;  // nodes that move it, from the root
};

// Of one goal: position, quaternion, point to aim at, pole, and what its weights are
// multiplied by: where that is 0, the rows are there but ask for nothing.
constexpr int TARGET_WIDTH = 17;
constexpr int PARTS = 4;

inline double weight_of(const Goal& goal, const double* target, int part) {
  return goal.weights[part] * target[13 + part];
}

struct Task {
  Chain chain;
  std::vector<Goal> goals;
  int rows = 0;
  int levels = 1;
  double rest_weight = 0;
};

inline int rows_of(const Goal& goal) {
  return 3 * (goal.weights[0] > 0) + 3 * (goal.weights[1] > 0) + 2 * (goal.weights[2] > 0) +
         (goal.weights[3] > 0);
}

inline int rows_asked(const Task& task, const double* targets) {
  constexpr int rows[PARTS] = {3, 3, 2, 1};
  int count = 0;
  for (std::size_t e = 0; e < task.goals.size(); ++e)
    for (int part = 0; part < PARTS; ++part)
      count += rows[part] * (weight_of(task.goals[e], targets + TARGET_WIDTH * e, part) > 0);
  return count;
}

// A pose of the chain and how far it is from the goals.
struct State {
  std::vector<double> q;
  Frames frames;
  std::vector<double> residuals;  // (M,), weighted
  std::vector<double> points;     // (E, 3)
  std::vector<double> misses;     // (E, 4), not weighted: lengths and angles
  std::vector<double> weights;    // (E, 4), with those of the targets
  double cost = 0;                // of the goals, and of the rest preference:
  double drawn = 0;               // its part

  explicit State(const Task& task)
      : q(task.chain.coordinates), frames(task.chain.nodes.size()), residuals(task.rows),
        points(3 * task.goals.size()), misses(PARTS * task.goals.size()),
        weights(PARTS * task.goals.size()) {}
};

// The half plane of a limb and that of its pole, seen along the limb.
struct Limb {
  double axis[3], middle[3], pole[3];  // the last two at right angles to the axis
  double span, middle_along, pole_along, angle;
  bool known;
};

inline Limb look_along(const double* root, const double* middle, const double* tip,
                       const double* pole) {
  Limb limb;
  for (int i = 0; i < 3; ++i) {
    limb.axis[i] = tip[i] - root[i];
    limb.middle[i] = middle[i] - root[i];
    limb.pole[i] = pole[i] - root[i];
  }
  limb.span = length(limb.axis);
  limb.known = limb.span > 1e-9;
  if (!limb.known) return limb;
  for (double& x : limb.axis) x /= limb.span;
  limb.middle_along = dot(limb.axis, limb.middle);
  limb.pole_along = dot(limb.axis, limb.pole);
  for (int i = 0; i < 3; ++i) {
    limb.middle[i] -= limb.middle_along * limb.axis[i];
    limb.pole[i] -= limb.pole_along * limb.axis[i];
  }
  limb.known = length(limb.middle) > 1e-9 && length(limb.pole) > 1e-9;
  limb.angle = std::atan2(triple(limb.axis, limb.middle, limb.pole),
                          dot(limb.middle, limb.pole));
  return limb;
}

inline Limb limb_of(const Goal& goal, const State& state, const double* point,
                    const double* target) {
  return look_along(&state.frames.origins[3 * goal.root],
                    &state.frames.origins[3 * goal.middle], point, target + 10);
}

// The turn that takes the aim axis to its target: angle about a unit axis.
struct Aim {
  double direction[3], wanted[3], axis[3];
  double distance, angle;
};

inline Aim look_at(const Goal& goal, const State& state, const double* point,
                   const double* target) {
  Aim aim;
  rotate(&state.frames.rotations[9 * goal.node], goal.aim_axis, aim.direction);
  for (int i = 0; i < 3; ++i) aim.wanted[i] = target[7 + i] - point[i];
  aim.distance = length(aim.wanted);
  if (aim.distance < 1e-12) {
    std::copy(aim.direction, aim.direction + 3, aim.wanted);
    aim.distance = 1;
  } else {
    for (double& x : aim.wanted) x /= aim.distance;
  }
  cross(aim.direction, aim.wanted, aim.axis);
  const double sine = length(aim.axis);
  aim.angle = std::atan2(sine, dot(aim.direction, aim.wanted));
  double other[3];
  if (sine < 1e-12)
    across(aim.direction, aim.axis, other);
  else
    for (double& x : aim.axis) x /= sine;
  return aim;
}

inline void measure_position(double weight, const double* point, const double* target, double* r,
                             double* miss) {
  for (int i = 0; i < 3; ++i) r[i] = target[i] - point[i];
  *miss = length(r);
  for (int i = 0; i < 3; ++i) r[i] *= weight;
}

inline void measure_orientation(double weight, const double* rotation, const double* target,
                                double* r, double* miss) {
  double wanted[9], transposed[9], turn[9];
  to_matrix(target + 3, wanted);
  for (int i = 0; i < 9; ++i) transposed[i] = rotation[3 * (i % 3) + i / 3];
  multiply(wanted, transposed, turn);
  logarithm_of_matrix(turn, r);
  *miss = length(r);
  for (int i = 0; i < 3; ++i) r[i] *= weight;
}

inline void measure_aim(double weight, const Aim& aim, double* r, double* miss) {
  double u[3], v[3];
  across(aim.direction, u, v);
  *miss = aim.angle;
  r[0] = weight * aim.angle * dot(aim.axis, u);
  r[1] = weight * aim.angle * dot(aim.axis, v);
}

// `shift` (M,) is added to the residuals, or null.
inline void measure(const Task& task, const double* targets, State& state,
                    const double* shift = nullptr) {
  std::fill(state.residuals.begin(), state.residuals.end(), 0.0);
  std::fill(state.misses.begin(), state.misses.end(), 0.0);
  for (std::size_t e = 0; e < task.goals.size(); ++e) {
    const Goal& goal = task.goals[e];
    const double* target = targets + TARGET_WIDTH * e;
    const double* rotation = &state.frames.rotations[9 * goal.node];
    double* point = &state.points[3 * e];
    double* miss = &state.misses[PARTS * e];
    double* weights = &state.weights[PARTS * e];
    double* r = state.residuals.data() + goal.row;
    for (int part = 0; part < PARTS; ++part) weights[part] = weight_of(goal, target, part);
    rotate(rotation, goal.offset, point);
    for (int i = 0; i < 3; ++i) point[i] += state.frames.origins[3 * goal.node + i];
    if (weights[0] > 0) measure_position(weights[0], point, target, r, miss);
    r += 3 * (goal.weights[0] > 0);
    if (weights[1] > 0) measure_orientation(weights[1], rotation, target, r, miss + 1);
    r += 3 * (goal.weights[1] > 0);
    if (weights[2] > 0) measure_aim(weights[2], look_at(goal, state, point, target), r, miss + 2);
    r += 2 * (goal.weights[2] > 0);
    if (weights[3] > 0) {
      const Limb limb = limb_of(goal, state, point, target);
      miss[3] = limb.known ? std::fabs(limb.angle) : 0;
      r[0] = limb.known ? weights[3] * limb.angle : 0;
    }
  }
  if (shift)
    for (int i = 0; i < task.rows; ++i) state.residuals[i] += shift[i];
  state.cost = 0;
  for (const double x : state.residuals) state.cost += x * x;
  state.cost /= 2;
}

// How the points of a limb turn its half plane: derivatives of Limb::angle.
struct LimbGradients {
  double root[3], middle[3], tip[3];
};

inline LimbGradients gradients(const Limb& limb) {
  LimbGradients g;
  double by_middle[3], by_pole[3];
  cross(limb.axis, limb.middle, by_middle);
  cross(limb.axis, limb.pole, by_pole);
  const double m = dot(limb.middle, limb.middle), p = dot(limb.pole, limb.pole);
  const double at_middle = limb.middle_along / limb.span, at_pole = limb.pole_along / limb.span;
  for (int i = 0; i < 3; ++i) {
    const double a = by_middle[i] / m, b = by_pole[i] / p;
    g.middle[i] = -a;
    g.tip[i] = at_middle * a - at_pole * b;
    g.root[i] = (1 - at_middle) * a - (1 - at_pole) * b;
  }
  return g;
}

// Columns of the Jacobian (D, M), a row of memory for each degree of freedom.
inline void differentiate(const Task& task, const double* targets, const State& state,
                          std::vector<double>& columns) {
  std::fill(columns.begin(), columns.end(), 0.0);
  for (std::size_t e = 0; e < task.goals.size(); ++e) {
    const Goal& goal = task.goals[e];
    const double* target = targets + TARGET_WIDTH * e;
    const double* point = &state.points[3 * e];
    const double* weights = &state.weights[PARTS * e];
    if (std::all_of(weights, weights + PARTS, [](double w) { return !(w > 0); })) continue;
    Aim aim{};
    Limb limb{};
    LimbGradients turning{};
    double u[3] = {}, v[3] = {};
    if (weights[2] > 0) {
      aim = look_at(goal, state, point, target);
      across(aim.direction, u, v);
    }
    if (weights[3] > 0) {
      limb = limb_of(goal, state, point, target);
      if (limb.known) turning = gradients(limb);
    }
    for (const int n : goal.path) {
      const Node& node = task.chain.nodes[n];
      const double* origin = &state.frames.origins[3 * n];
      for (int k = 0; k < node.width(); ++k) {
        const double* axis = &state.frames.axes[9 * n + 3 * k];
        double* column =
            columns.data() + static_cast<std::size_t>(node.dof + k) * task.rows + goal.row;
        double linear[3], angular[3];
        velocity(node, axis, origin, point, linear, angular);
        const double gain = node.gain;
        if (goal.weights[0] > 0) {
          for (int i = 0; i < 3; ++i) column[i] += gain * weights[0] * linear[i];
          column += 3;
        }
        if (goal.weights[1] > 0) {
          for (int i = 0; i < 3; ++i) column[i] += gain * weights[1] * angular[i];
          column += 3;
        }
        if (weights[2] > 0) {
          double turned[3];
          cross(aim.wanted, linear, turned);
          for (int i = 0; i < 3; ++i) turned[i] = angular[i] + turned[i] / aim.distance;
          column[0] += gain * weights[2] * dot(turned, u);
          column[1] += gain * weights[2] * dot(turned, v);
        }
        column += 2 * (goal.weights[2] > 0);
        if (limb.known) {
          double rate = dot(turning.tip, linear);
          if (n <= goal.middle) {
            velocity(node, axis, origin, &state.frames.origins[3 * goal.middle], linear, angular);
            rate += dot(turning.middle, linear);
          }
          if (n <= goal.root) {
            velocity(node, axis, origin, &state.frames.origins[3 * goal.root], linear, angular);
            rate += dot(turning.root, linear);
          }
          column[0] -= gain * weights[3] * rate;
        }
      }
    }
  }
}

// Adds to `out` (D,) what the second derivatives of positions and rotations make of a
// direction: (Hessian of the cost - J^T J) times `along`. Aims and poles are left out.
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
  void add(const Task& task, const State& state, std::size_t e, const double* along,
           double* out) {
    const Goal& goal = task.goals[e];
    const double* point = &state.points[3 * e];
    const double* residual = state.residuals.data() + goal.row;
    const double* weights = &state.weights[PARTS * e];
    double force[3] = {0, 0, 0}, torque[3] = {0, 0, 0}, shrink = 0, axis[3] = {0, 0, 0};
    if (goal.weights[0] > 0) {
      for (int i = 0; i < 3; ++i) force[i] = weights[0] * residual[i];
      residual += 3;
    }
    if (weights[1] > 0) {
      const double w = weights[1], angle = length(residual) / w;
      for (int i = 0; i < 3; ++i) {
        torque[i] = w * residual[i];
        axis[i] = angle > 1e-9 ? residual[i] / (w * angle) : 0;
      }
      // Across the residual, turning changes its length by angle/2 cot(angle/2) only.
      if (angle > 1e-9) shrink = w * w * (angle / 2 / std::tan(angle / 2) - 1);
    }
    // What the joints behind each one do to the point and to the frame.
    double linear[3] = {0, 0, 0}, angular[3] = {0, 0, 0};
    for (std::size_t at = goal.path.size(); at-- > 0;) {
      double* behind = &behind_[6 * at];
      std::copy(linear, linear + 3, behind);
      std::copy(angular, angular + 3, behind + 3);
      accumulate(task, state, goal.path[at], point, along, linear, angular);
    }
    double across_axis[3];
    for (int i = 0; i < 3; ++i)
      across_axis[i] = shrink * (angular[i] - dot(axis, angular) * axis[i]);
    double before[3] = {0, 0, 0};
    for (std::size_t at = 0; at < goal.path.size(); ++at) {
      const int n = goal.path[at];
      const Node& node = task.chain.nodes[n];
      const double* behind = &behind_[6 * at];
      const double* origin = &state.frames.origins[3 * n];
      double own_linear[3] = {0, 0, 0}, own_angular[3] = {0, 0, 0};
      accumulate(task, state, n, point, along, own_linear, own_angular);
      for (int k = 0; k < node.width(); ++k) {
        double lin[3], ang[3];
        velocity(node, &state.frames.axes[9 * n + 3 * k], origin, point, lin, ang);
        double sum = -triple(force, ang, behind) - triple(force, before, lin);
        // The joint with itself: half of either order.
        sum -= (triple(force, ang, own_linear) + triple(force, own_angular, lin)) / 2;
        sum -= (triple(torque, ang, behind + 3) + triple(torque, before, ang)) / 2;
        sum += dot(ang, across_axis);
        out[node.dof + k] += node.gain * sum;
      }
      for (int i = 0; i < 3; ++i) before[i] += own_angular[i];
    }
  }

  static void accumulate(const Task& task, const State& state, int n, const double* point,
                         const double* along, double* linear, double* angular) {
    const Node& node = task.chain.nodes[n];
    for (int k = 0; k < node.width(); ++k) {
      double lin[3], ang[3];
      velocity(node, &state.frames.axes[9 * n + 3 * k], &state.frames.origins[3 * n], point,
               lin, ang);
      const double amount = node.gain * along[node.dof + k];
      for (int i = 0; i < 3; ++i) linear[i] += amount * lin[i], angular[i] += amount * ang[i];
    }
  }

  std::vector<double> behind_;
};

}  // namespace animtool::ik
