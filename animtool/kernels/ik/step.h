// One damped step within the limits.
//
// min |r - J d|^2 / 2 + damping |d|^2 / 2 over steps inside the limits: degrees of freedom that
// would exceed a limit are fixed at it, and the others are solved again.
#pragma once

#include <vector>

#include "ik/limits.h"
#include "ik/linear.h"

namespace animtool::ik {

// Largest rotation of a joint in one step [rad].
constexpr double MAX_ROTATION = 1.0;

class Stepper {
 public:
  explicit Stepper(const Task& task)
      : task_(task), curvature_(task), side_(std::min(task.rows, task.chain.dofs)),
        matrix_(static_cast<std::size_t>(side_) * side_), right_(side_),
        image_(std::max(task.rows, side_)), felt_(task.chain.dofs), free_(task.chain.dofs),
        search_(task.chain.dofs), rest_(task.chain.dofs), product_(task.chain.dofs) {
    fixed_.reserve(2 * task.chain.nodes.size() + 8);
    pinned_.resize(task.chain.nodes.size());
    turned_.resize(3 * task.chain.nodes.size());
  }

  // Which limits of a node a step is fixed at.
  struct Pinned {
    bool swing = false, twist = false, box = false;
  };

  // For callers that keep their own list of fixed directions: directions blocked by locked limits,
  // and those that the caller's step violates.
  void shut(const State& state, std::vector<Fixed>& fixed, std::vector<Pinned>& pinned) {
    shut(state);
    fixed = fixed_, pinned = pinned_;
  }

  bool fix_violations(const State& state, const double* step, std::vector<Fixed>& fixed,
                      std::vector<Pinned>& pinned);

  // Computes the step; `curved` uses the full Hessian instead of J^T J. Returns false if the
  // damping is too small for it.
  bool step(const State& state, const Linearized& linear, double damping, bool curved,
            double longest, double* out);

  // How far the last step turns a joint or, curved, anything in the world [rad].
  double rotation() const { return rotation_; }

  // Gain of the step that the model predicts, without the damping.
  double predicted(const State& state, const Linearized& linear, bool curved,
                   const double* step);

  void hessian(const State& state, const Linearized& linear, bool curved, double damping,
               const double* v, double* out);

  // Applies a step; limits are kept exactly.
  void move(const double* q, const double* step, double* out) const {
    for (const Node& node : task_.chain.nodes)
      if (!node.follows) move(node, q + node.coordinate, step + node.dof, out + node.coordinate);
  }

  static void move(const Node& node, const double* now, const double* by, double* next);

 private:
  static constexpr int MAX_PASSES = 12;
  static constexpr int MAX_ROUNDS = 300;
  static constexpr double LOOSE = 1e-2;
  static constexpr double LEAST_FLOOR = 1e-9;

  // image_ = J v
  void map(const Linearized& linear, const double* v);

  // Directions that are blocked by locked limits.
  void shut(const State& state);

  // Fixes the component of a ball's step along a direction, minus those fixed already.
  void fix(int n, const double* normal, double value);

  bool fix_violations(const State& state, const double* step);

  bool fix_ball(int n, const double* q, const double* step);

  // Limits the rotation of each joint; with second derivatives, also all rotations in the world,
  // beyond which these are inaccurate.
  void shorten(const State& state, bool curved, double most, double* step) {
    const double longest = curved ? turning(state, step) : turning(step);
    rotation_ = std::min(longest, most);
    if (longest <= most) return;
    for (int d = 0; d < task_.chain.dofs; ++d) step[d] *= most / longest;
  }

  double turning(const double* step) const;

  double turning(const State& state, const double* step);

  static double along(const Fixed& fixed, const double* v) {
    double sum = 0;
    for (int k = 0; k < fixed.width; ++k) sum += fixed.direction[k] * v[fixed.dof + k];
    return sum;
  }

  static void add(const Fixed& fixed, double amount, double* v) {
    for (int k = 0; k < fixed.width; ++k) v[fixed.dof + k] += amount * fixed.direction[k];
  }

  void project(double* v) const {
    for (const Fixed& fixed : fixed_) add(fixed, -along(fixed, v), v);
  }

  // (J^T J + D) d = J^T r + c: has the size of the chain, not of the residual.
  bool solve_primal(const Linearized& linear, double damping, double* out);

  void prepare_normal(const Linearized& linear, double diagonal) {
    std::copy(linear.normal.begin(), linear.normal.end(), matrix_.begin());
    for (int d = 0; d < side_; ++d) matrix_[static_cast<std::size_t>(d) * side_ + d] += diagonal;
  }

  double& entry(int i, int j) {
    return matrix_[static_cast<std::size_t>(std::max(i, j)) * side_ + std::min(i, j)];
  }

  // out = A v of the symmetric matrix.
  void times_matrix(const double* v, double* out) {
    for (int i = 0; i < side_; ++i) {
      out[i] = 0;
      for (int j = 0; j < side_; ++j) out[i] += entry(i, j) * v[j];
    }
  }

  // A <- P A P + c c^T, P = 1 - c c^T: removes the direction c from the system.
  void shut(const Fixed& fixed);

  // (J J^T + D) z = r - J c / D, d = J^T z + c / D: has the size of the residual, not of the chain.
  bool solve_dual(const State& state, const Linearized& linear, double damping, double* out);

  void take_out(const Fixed& fixed, const Linearized& linear);

  // Conjugate gradients, stopped where the cost bends downwards (T. Steihaug, The
  // conjugate gradient method and trust regions in large scale optimization, 1983), in the
  // measure of J^T J and about what second derivatives add to it.
  bool solve_curved(const State& state, const Linearized& linear, double damping, double most,
                    double* out);

  // A bound of the second-order terms: forces and torques on the goals.
  double bending(const State& state) const;

  // The factor of J J^T + floor or J^T J + floor, without fixed directions.
  bool prepare_measure(const Linearized& linear, double floor);

  // free_ = (J^T J + floor)^-1 rest_
  void measure_rest(const Linearized& linear, double floor);

  const Task& task_;
  Curvature curvature_;
  const int side_;  // of the matrix
  std::vector<double> matrix_, right_, image_, felt_, free_, search_, rest_, product_, turned_;
  double rotation_ = 0;
  std::vector<Fixed> fixed_;
  std::vector<Pinned> pinned_;
};

}  // namespace animtool::ik
