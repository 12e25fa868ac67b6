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
      : task_(task),
        curvature_(task),
        abundant_(task.chain.dofs >= ABUNDANT * task.rows),
        side_(std::min(task.rows, task.chain.dofs)),
        matrix_(static_cast<std::size_t>(side_) * side_),
        right_(side_),
        image_(std::max(task.rows, side_)),
        coupled_(task.chain.dofs),
        free_(task.chain.dofs),
        search_(task.chain.dofs),
        residual_(task.chain.dofs),
        product_(task.chain.dofs) {
    fixed_.reserve(2 * task.chain.nodes.size() + 8);
    at_limit_.resize(task.chain.nodes.size());
    world_rotations_.resize(3 * task.chain.nodes.size());
  }

  // Which limits of a node a step is fixed at.
  struct AtLimit {
    bool swing = false, twist = false, box = false;
  };

  // For callers that keep their own list of fixed directions: directions blocked by locked limits,
  // and those that the caller's step violates.
  void fix_locked(const State& state, std::vector<Fixed>& fixed, std::vector<AtLimit>& at_limit) {
    fix_locked(state);
    fixed = fixed_, at_limit = at_limit_;
  }

  bool fix_violations(const State& state, const double* step, std::vector<Fixed>& fixed,
                      std::vector<AtLimit>& at_limit);

  // Computes the step; `curved` uses the full Hessian instead of J^T J. Returns false if the
  // damping is too small for it.
  bool step(const State& state, const Linearized& linear, double damping, bool curved,
            double longest, double* out);

  // Whether there are so many more degrees of freedom than rows that limits hold a step in many
  // places: cones then add their curvature, and joints that are pulled off limits are freed.
  bool abundant() const { return abundant_; }

  // How far the last step turns a joint or, curved, anything in the world [rad].
  double rotation() const { return rotation_; }

  // Gain of the step that the model predicts, without the damping.
  double predicted(const State& state, const Linearized& linear, bool curved, const double* step);

  void hessian(const State& state, const Linearized& linear, bool curved, double damping,
               const double* v, double* out);

  // Applies a step; limits are kept exactly.
  void move(const double* q, const double* step, double* out) const {
    for (const Node& node : task_.chain.nodes)
      if (!node.follows) move(node, q + node.coordinate, step + node.dof, out + node.coordinate);
  }

  static void move(const Node& node, const double* now, const double* by, double* next);

 private:
  static constexpr int ABUNDANT = 50;
  static constexpr int MAX_PASSES = 12;
  static constexpr int MAX_ROUNDS = 300;
  static constexpr double CG_TOLERANCE = 1e-2, ROUGH = 3e-1;
  static constexpr double MIN_FLOOR = 1e-9;

  // image_ = J v
  void apply_jacobian(const Linearized& linear, const double* v);

  // Directions that are blocked by locked limits.
  void fix_locked(const State& state);

  // Fixes the component of a ball's step along a direction, minus those fixed already.
  void fix(int n, const double* normal, double value, int outwards = 0,
           const double* bend = nullptr);

  bool fix_violations(const State& state, const double* step);

  bool fix_ball(int n, const double* q, const double* step);

  // Limits the rotation of each joint; with second derivatives, also all rotations in the world,
  // beyond which these are inaccurate.
  // Returns whether it does.
  bool shorten(const State& state, bool curved, double most, double* step) {
    const double longest = curved ? largest_rotation(state, step) : largest_rotation(step);
    rotation_ = std::min(longest, most);
    if (longest <= most) return false;
    for (int d = 0; d < task_.chain.dofs; ++d) step[d] *= most / longest;
    return true;
  }

  double largest_rotation(const double* step) const;

  double largest_rotation(const State& state, const double* step);

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
  void remove_direction(const Fixed& fixed);

  // (J J^T + D) z = r - J c / D, d = J^T z + c / D: has the size of the residual, not of the chain.
  bool solve_dual(const State& state, const Linearized& linear, double damping, double* out);

  void remove_fixed(const Fixed& fixed, const Linearized& linear);

  // Conjugate gradients, stopped where the cost bends downwards (T. Steihaug, The
  // conjugate gradient method and trust regions in large scale optimization, 1983), in the
  // measure of J^T J and about what second derivatives add to it.
  bool solve_curved(const State& state, const Linearized& linear, double damping, double most,
                    double near, double* out);

  // A bound of the second-order terms: forces and torques on the goals.
  double curvature_bound(const State& state) const;

  // Whether a joint is on a limit.
  bool on_limits(const State& state) const;

  // Frees joints that a step pulls away from the limits they are fixed at; returns whether any is.
  bool release(const State& state, const Linearized& linear, double damping, const double* step);

  // bends_ <- the curvature of the cones that the rest of the forces presses against.
  void press(double floor);

  // v loses what cones take of it, see `Bend`.
  void soften(double* v) const {
    for (const Bend& bend : bends_) {
      double along = 0;
      for (int k = 0; k < 3; ++k) along += bend.direction[k] * v[bend.dof + k];
      for (int k = 0; k < 3; ++k) v[bend.dof + k] -= bend.share * along * bend.direction[k];
    }
  }

  // out += the second derivatives of pressed cones, times v.
  void add_bends(const double* v, double* out) const {
    for (const Bend& bend : bends_) {
      double along = 0;
      for (int k = 0; k < 3; ++k) along += bend.direction[k] * v[bend.dof + k];
      for (int k = 0; k < 3; ++k) out[bend.dof + k] += bend.stiffness * along * bend.direction[k];
    }
  }

  // The factor of J J^T + floor or J^T J + floor, without fixed directions.
  bool prepare_preconditioner(const Linearized& linear, double floor);

  // free_ = (J^T J + floor)^-1 rest_
  void precondition(const Linearized& linear, double floor);

  const Task& task_;
  Curvature curvature_;
  const bool abundant_;
  const int side_;  // of the matrix
  std::vector<double> matrix_, right_, image_, coupled_, free_, search_, residual_, product_,
      world_rotations_;
  double rotation_ = 0, initial_ = 0;
  std::vector<Fixed> fixed_;
  std::vector<AtLimit> at_limit_;
  // Second derivatives of cones along unit vectors, and their share s in their sum with the floor:
  // (floor + stiffness d d^T)^-1 = (1 - s d d^T) / floor.
  struct Bend {
    int dof;
    double direction[3], stiffness, share;
  };
  std::vector<Bend> bends_;
};

}  // namespace animtool::ik
