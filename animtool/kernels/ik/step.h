// One damped step within the limits.
//
// Minimises |r - J d|^2 / 2 + damping |d|^2 / 2 over the steps d within the limits: degrees of
// freedom that would exceed a limit are fixed at it, and the others are solved again.
#pragma once

#include <vector>

#include "ik/limits.h"
#include "ik/linear.h"

namespace animtool::ik {

// Largest rotation of a joint in one step [rad].
constexpr double MAX_ROTATION = 1.0;

// Computes steps of a task.
class Stepper {
 public:
  explicit Stepper(const Task& task)
      : task_(task),
        curvature_(task),
        is_redundant_(task.chain.dof_count >= REDUNDANCY_RATIO * task.row_count),
        matrix_size_(std::min(task.row_count, task.chain.dof_count)),
        matrix_(static_cast<std::size_t>(matrix_size_) * matrix_size_),
        right_hand_side_(matrix_size_),
        jacobian_product_(std::max(task.row_count, matrix_size_)),
        buffer_(task.chain.dof_count),
        solution_(task.chain.dof_count),
        search_direction_(task.chain.dof_count),
        residual_(task.chain.dof_count),
        product_(task.chain.dof_count) {
    fixed_directions_.reserve(2 * task.chain.nodes.size() + 8);
    at_limit_.resize(task.chain.nodes.size());
    world_rotations_.resize(3 * task.chain.nodes.size());
  }

  // The limits of a node at which a step is fixed.
  struct LimitFlags {
    bool is_swing_fixed = false, is_twist_fixed = false, is_range_fixed = false;
  };

  // For callers that store the fixed directions: the directions that locked limits block, and those
  // of limits that the caller's step violates.
  void fix_locked(const State& state, std::vector<FixedDirection>& fixed,
                  std::vector<LimitFlags>& at_limit) {
    fix_locked(state);
    fixed = fixed_directions_, at_limit = at_limit_;
  }

  bool fix_violations(const State& state, const double* step, std::vector<FixedDirection>& fixed,
                      std::vector<LimitFlags>& at_limit);

  // Computes the step; with `uses_hessian`, uses the full Hessian instead of J^T J. Returns false
  // if the damping is too small.
  bool step(const State& state, const Linearized& linear, double damping, bool uses_hessian,
            double max_rotation, double* out);

  // Whether there are many more degrees of freedom than rows, so that limits block a step in many
  // joints: then cones add their curvature, and joints that are pulled off limits are released.
  bool is_redundant() const { return is_redundant_; }

  // Largest rotation of a joint in the last step [rad]; with the full Hessian, that of any
  // node in the world.
  double step_rotation() const { return step_rotation_; }

  // Decrease of the cost that the model predicts for a step, without the damping.
  double predicted_gain(const State& state, const Linearized& linear, bool uses_hessian,
                        const double* step);

  // Multiplies the damped Hessian by a vector.
  void multiply_hessian(const State& state, const Linearized& linear, bool uses_hessian,
                        double damping, const double* v, double* out);

  // Applies a step; the result is exactly within the limits.
  void move(const double* q, const double* step, double* out) const {
    for (const Node& node : task_.chain.nodes)
      if (!node.is_driven) move(node, q + node.coordinate, step + node.dof, out + node.coordinate);
  }

  static void move(const Node& node, const double* current, const double* step, double* next);

 private:
  static constexpr int REDUNDANCY_RATIO = 50;
  static constexpr int MAX_LIMIT_PASSES = 12;
  static constexpr int MAX_CG_ITERATIONS = 300;
  static constexpr double CG_TOLERANCE = 1e-2, ROUGH_CG_TOLERANCE = 3e-1;
  static constexpr double MIN_CURVATURE_SHIFT = 1e-9;

  // jacobian_product_ = J v
  void apply_jacobian(const Linearized& linear, const double* v);

  // Fixes directions that locked limits block.
  void fix_locked(const State& state);

  // Fixes the component of a ball's step along a direction, orthogonal to those that are fixed
  // already.
  void fix_direction(int n, const double* normal, double value, int outward_sign = 0,
                     const double* bend = nullptr);

  // Fixes limits that a step violates; returns whether there are any.
  bool fix_violations(const State& state, const double* step);

  bool fix_ball(int n, const double* q, const double* step);

  // Shortens a step so that no joint rotates too far; with the full Hessian, so that nothing
  // rotates too far in the world, where second derivatives would be inaccurate. Returns whether it
  // was too long.
  bool shorten(const State& state, bool uses_hessian, double max_rotation, double* step) {
    const double largest =
        uses_hessian ? max_world_rotation(state, step) : max_joint_rotation(step);
    step_rotation_ = std::min(largest, max_rotation);
    if (largest <= max_rotation) return false;
    for (int d = 0; d < task_.chain.dof_count; ++d) step[d] *= max_rotation / largest;
    return true;
  }

  double max_joint_rotation(const double* step) const;

  double max_world_rotation(const State& state, const double* step);

  // Component of a vector along a fixed direction.
  static double component(const FixedDirection& fixed, const double* v) {
    double sum = 0;
    for (int k = 0; k < fixed.width; ++k) sum += fixed.direction[k] * v[fixed.dof + k];
    return sum;
  }

  static void add_fixed(const FixedDirection& fixed, double amount, double* v) {
    for (int k = 0; k < fixed.width; ++k) v[fixed.dof + k] += amount * fixed.direction[k];
  }

  // Removes the components along fixed directions.
  void project(double* v) const {
    for (const FixedDirection& fixed : fixed_directions_) add_fixed(fixed, -component(fixed, v), v);
  }

  // Solves (J^T J + D) d = J^T r + c, which has the size of the chain, not of the residual.
  bool solve_primal(const Linearized& linear, double damping, double* out);

  void prepare_normal(const Linearized& linear, double diagonal) {
    std::copy(linear.normal_matrix.begin(), linear.normal_matrix.end(), matrix_.begin());
    for (int d = 0; d < matrix_size_; ++d)
      matrix_[static_cast<std::size_t>(d) * matrix_size_ + d] += diagonal;
  }

  double& entry(int i, int j) {
    return matrix_[static_cast<std::size_t>(std::max(i, j)) * matrix_size_ + std::min(i, j)];
  }

  // out = A v, for the symmetric matrix.
  void multiply_matrix(const double* v, double* out) {
    for (int i = 0; i < matrix_size_; ++i) {
      out[i] = 0;
      for (int j = 0; j < matrix_size_; ++j) out[i] += entry(i, j) * v[j];
    }
  }

  // A <- P A P + c c^T with P = 1 - c c^T: removes the direction c from the system.
  void remove_direction(const FixedDirection& fixed);

  // Solves (J J^T + D) z = r - J c / D, which has the size of the residual, not of the chain; d =
  // J^T z + c / D.
  bool solve_dual(const State& state, const Linearized& linear, double damping, double* out);

  // Removes a fixed direction from the dual system.
  void remove_fixed(const FixedDirection& fixed, const Linearized& linear);

  // Conjugate gradients, stopped where the cost curves downwards (T. Steihaug, The conjugate
  // gradient method and trust regions in large scale optimization, 1983). The preconditioner is J^T
  // J plus a bound of the second derivatives.
  bool solve_hessian(const State& state, const Linearized& linear, double damping,
                     double max_rotation, double relative_tolerance, double* out);

  // A bound of the second-order terms, from the forces and torques of the goals.
  double curvature_bound(const State& state) const;

  // Whether any joint is at a limit.
  bool is_at_limit(const State& state) const;

  // Releases joints that a step pulls away from the limits at which they are fixed; returns whether
  // there are any.
  bool release_limits(const State& state, const Linearized& linear, double damping,
                      const double* step);

  // Collects the curvature of cones that the remaining forces press against.
  void collect_cones(double shift);

  // Multiplies v by the effect of cones, see `ConeCurvature`.
  void apply_cones(double* v) const {
    for (const ConeCurvature& cone : cones_) {
      double component = 0;
      for (int k = 0; k < 3; ++k) component += cone.direction[k] * v[cone.dof + k];
      for (int k = 0; k < 3; ++k) v[cone.dof + k] -= cone.fraction * component * cone.direction[k];
    }
  }

  // Adds the second derivatives of the cones times v to `out`.
  void add_cone_curvature(const double* v, double* out) const {
    for (const ConeCurvature& cone : cones_) {
      double component = 0;
      for (int k = 0; k < 3; ++k) component += cone.direction[k] * v[cone.dof + k];
      for (int k = 0; k < 3; ++k)
        out[cone.dof + k] += cone.stiffness * component * cone.direction[k];
    }
  }

  // Factors J J^T + shift or J^T J + shift, without fixed directions.
  bool prepare_preconditioner(const Linearized& linear, double shift);

  // solution_ = (J^T J + shift)^-1 residual_
  void precondition(const Linearized& linear, double shift);

  const Task& task_;
  Curvature curvature_;
  const bool is_redundant_;
  const int matrix_size_;  // of the matrix
  std::vector<double> matrix_, right_hand_side_, jacobian_product_, buffer_, solution_,
      search_direction_, residual_, product_, world_rotations_;
  double step_rotation_ = 0, initial_residual_ = 0;
  std::vector<FixedDirection> fixed_directions_;
  std::vector<LimitFlags> at_limit_;
  // Second derivatives of a cone along a unit vector d, and the fraction s that solves (shift +
  // stiffness d d^T)^-1 = (1 - s d d^T) / shift.
  struct ConeCurvature {
    int dof;
    double direction[3], stiffness, fraction;
  };
  std::vector<ConeCurvature> cones_;
};

}  // namespace animtool::ik
