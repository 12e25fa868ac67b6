// One damped step within the limits: its equations, and the directions that limits fix.
#include "ik/step.h"

namespace animtool::ik {

bool Stepper::fix_violations(const State& state, const double* step,
                             std::vector<FixedDirection>& fixed,
                             std::vector<LimitFlags>& at_limit) {
  fixed_directions_.swap(fixed), at_limit_.swap(at_limit);
  const bool has_fixed = fix_violations(state, step);
  fixed_directions_.swap(fixed), at_limit_.swap(at_limit);
  return has_fixed;
}

bool Stepper::step(const State& state, const Linearized& linear, double damping, bool uses_hessian,
                   double max_rotation, double* out) {
  fix_locked(state);
  std::fill(out, out + task_.chain.dof_count, 0.0);
  const bool is_redundant = uses_hessian && is_redundant_;
  // Limits that a step runs into are visible in rough steps, so if a joint is at a limit, these
  // come first.
  bool uses_tight_tolerance = !is_redundant || !is_at_limit(state), has_released = !is_redundant;
  for (int pass = 0; pass < MAX_LIMIT_PASSES; ++pass) {
    uses_tight_tolerance = uses_tight_tolerance || pass + 1 == MAX_LIMIT_PASSES;
    if (!(uses_hessian
              ? solve_hessian(state, linear, damping, max_rotation,
                              uses_tight_tolerance ? CG_TOLERANCE : ROUGH_CG_TOLERANCE, out)
          : linear.is_primal ? solve_primal(linear, damping, out)
                             : solve_dual(state, linear, damping, out)))
      return false;
    const bool was_shortened = shorten(state, uses_hessian, max_rotation, out);
    if (fix_violations(state, out)) {
      uses_tight_tolerance = !is_redundant;
      continue;
    }
    if (was_shortened) return true;
    if (uses_tight_tolerance &&
        (has_released || fixed_directions_.empty() || !release_limits(state, linear, damping, out)))
      return true;
    has_released = uses_tight_tolerance;
    uses_tight_tolerance = true;
  }
  return true;
}

double Stepper::predicted_gain(const State& state, const Linearized& linear, bool uses_hessian,
                               const double* step) {
  apply_jacobian(linear, step);
  double gain = 0, squared_sum = 0;
  for (const double x : jacobian_product_) squared_sum += x * x;
  for (int d = 0; d < task_.chain.dof_count; ++d)
    gain += step[d] * (linear.negative_gradient[d] - task_.rest_weight * step[d] / 2);
  gain -= squared_sum / 2;
  if (!uses_hessian) return gain;
  std::fill(product_.begin(), product_.end(), 0.0);
  curvature_.add(task_, state, step, product_.data());
  add_cone_curvature(step, product_.data());
  for (int d = 0; d < task_.chain.dof_count; ++d) gain -= step[d] * product_[d] / 2;
  return gain;
}

void Stepper::multiply_hessian(const State& state, const Linearized& linear, bool uses_hessian,
                               double damping, const double* v, double* out) {
  const int m = task_.row_count;
  apply_jacobian(linear, v);
  for (int d = 0; d < task_.chain.dof_count; ++d) {
    const double* column = linear.columns.data() + static_cast<std::size_t>(d) * m;
    double sum = (damping + task_.rest_weight) * v[d];
    for (int i = linear.first_rows[d]; i < linear.last_rows[d]; ++i)
      sum += column[i] * jacobian_product_[i];
    out[d] = sum;
  }
  if (uses_hessian) curvature_.add(task_, state, v, out);
}

void Stepper::move(const Node& node, const double* current, const double* step, double* next) {
  if (node.kind == Kind::BALL) {
    double rotation[4], rotated_quaternion[4];
    exponential(step, rotation);
    product(rotation, current, rotated_quaternion);
    normalize(rotated_quaternion);
    if (has_limit(node) && !is_well_inside(node, rotated_quaternion))
      clamp_ball(rotated_quaternion, node.limit);
    std::copy(rotated_quaternion, rotated_quaternion + 4, next);
  } else {
    next[0] = std::clamp(current[0] + step[0], node.limit[0], node.limit[1]);
  }
}

void Stepper::apply_jacobian(const Linearized& linear, const double* v) {
  std::fill(jacobian_product_.begin(), jacobian_product_.end(), 0.0);
  for (int d = 0; d < task_.chain.dof_count; ++d) {
    const double* column = linear.columns.data() + static_cast<std::size_t>(d) * task_.row_count;
    for (int i = linear.first_rows[d]; i < linear.last_rows[d]; ++i)
      jacobian_product_[i] += column[i] * v[d];
  }
}

void Stepper::fix_locked(const State& state) {
  fixed_directions_.clear();
  std::fill(at_limit_.begin(), at_limit_.end(), LimitFlags{});
  for (std::size_t n = 0; n < task_.chain.nodes.size(); ++n) {
    const Node& node = task_.chain.nodes[n];
    if (node.kind != Kind::BALL || !has_limit(node)) continue;
    const double* limit = node.limit;
    const bool is_swing_locked[2] = {limit[0] < LOCKED_RANGE, limit[1] < LOCKED_RANGE};
    const bool is_twist_locked = limit[3] - limit[2] < LOCKED_RANGE;
    if (!is_swing_locked[0] && !is_swing_locked[1] && !is_twist_locked) continue;
    const double* q = &state.q[node.coordinate];
    const SwingTwist swing_twist = decompose(q, limit);
    const SwingTwistGradients limit_gradients = swing_twist_gradients(q, swing_twist);
    for (int k = 0; k < 2; ++k)
      if (is_swing_locked[k]) fix_direction(static_cast<int>(n), limit_gradients.swing[k], 0.0);
    if (is_swing_locked[0] && is_swing_locked[1]) at_limit_[n].is_swing_fixed = true;
    if (is_twist_locked)
      fix_direction(static_cast<int>(n), limit_gradients.twist, 0.0),
          at_limit_[n].is_twist_fixed = true;
  }
}

void Stepper::fix_direction(int n, const double* normal, double value, int outward_sign,
                            const double* curvature) {
  const Node& node = task_.chain.nodes[n];
  double direction[3] = {normal[0], normal[1], normal[2]};
  double norm = length(direction);
  if (!(norm > 0)) return;
  const double curvature_scale = 1 / std::sqrt(norm);
  value /= norm;
  for (double& x : direction) x /= norm;
  for (const FixedDirection& fixed : fixed_directions_) {
    if (fixed.node != n) continue;
    const double component = dot(direction, fixed.direction);
    for (int i = 0; i < 3; ++i) direction[i] -= component * fixed.direction[i];
    value -= component * fixed.value;
  }
  norm = length(direction);
  if (norm < 1e-3) return;
  for (double& x : direction) x /= norm;
  fixed_directions_.push_back(
      {node.dof, 3, {direction[0], direction[1], direction[2]}, value / norm, n});
  fixed_directions_.back().outward_sign = outward_sign;
  if (curvature)
    for (int i = 0; i < 3; ++i) fixed_directions_.back().bend[i] = curvature_scale * curvature[i];
}

bool Stepper::fix_violations(const State& state, const double* step) {
  bool has_fixed = false;
  for (std::size_t n = 0; n < task_.chain.nodes.size(); ++n) {
    const Node& node = task_.chain.nodes[n];
    if (!has_limit(node)) continue;
    const double* q = &state.q[node.coordinate];
    if (node.kind == Kind::BALL) {
      has_fixed = fix_ball(static_cast<int>(n), q, step + node.dof) || has_fixed;
      continue;
    }
    if (at_limit_[n].is_range_fixed) continue;
    const double next = q[0] + step[node.dof];
    if (next >= node.limit[0] - ROUNDING_TOLERANCE && next <= node.limit[1] + ROUNDING_TOLERANCE)
      continue;
    const double bound = next < node.limit[0] ? node.limit[0] : node.limit[1];
    fixed_directions_.push_back({node.dof, 1, {1, 0, 0}, bound - q[0], static_cast<int>(n)});
    fixed_directions_.back().outward_sign = next < node.limit[0] ? -1 : 1;
    at_limit_[n].is_range_fixed = true;
    has_fixed = true;
  }
  return has_fixed;
}

bool Stepper::fix_ball(int n, const double* q, const double* step) {
  const Node& node = task_.chain.nodes[n];
  LimitFlags& at_limit = at_limit_[n];
  if (at_limit.is_swing_fixed && at_limit.is_twist_fixed) return false;
  double rotation[4], next[4];
  exponential(step, rotation);
  product(rotation, q, next);
  if (is_well_inside(node, next)) return false;
  const ExceededLimits exceeded = exceeded_limits(decompose(next, node.limit), node.limit);
  const bool must_fix_swing = exceeded.swing && !at_limit.is_swing_fixed,
             must_fix_twist = exceeded.twist && !at_limit.is_twist_fixed;
  if (!must_fix_swing && !must_fix_twist) return false;
  // The tangent of the limit at the point to which the step would be clamped.
  clamp_ball(next, node.limit);
  const double inverse[4] = {-q[0], -q[1], -q[2], q[3]};
  double relative_rotation[4], displacement[3];
  product(next, inverse, relative_rotation);
  logarithm(relative_rotation, displacement);
  const SwingTwist swing_twist = decompose(next, node.limit);
  const SwingTwistGradients limit_gradients = swing_twist_gradients(next, swing_twist);
  if (must_fix_swing) {
    const double a = std::max(node.limit[0], LOCKED_RANGE),
                 b = std::max(node.limit[1], LOCKED_RANGE);
    const double outward[2] = {swing_twist.swing[0] / (a * a), swing_twist.swing[1] / (b * b)};
    // The tangent of the ellipse, and the root of its second derivative along it.
    const double outward_length = std::hypot(outward[0], outward[1]);
    const double tangent[2] = {-outward[1] / outward_length, outward[0] / outward_length};
    const double curvature_root = std::hypot(tangent[0] / a, tangent[1] / b);
    double normal[3], curvature[3];
    for (int i = 0; i < 3; ++i) {
      normal[i] =
          outward[0] * limit_gradients.swing[0][i] + outward[1] * limit_gradients.swing[1][i];
      curvature[i] = curvature_root * (tangent[0] * limit_gradients.swing[0][i] +
                                       tangent[1] * limit_gradients.swing[1][i]);
    }
    fix_direction(n, normal, dot(normal, displacement), 1, curvature);
    at_limit.is_swing_fixed = true;
  }
  if (must_fix_twist) {
    const double middle = (node.limit[2] + node.limit[3]) / 2;
    fix_direction(n, limit_gradients.twist, dot(limit_gradients.twist, displacement),
                  swing_twist.twist < middle ? -1 : 1);
    at_limit.is_twist_fixed = true;
  }
  return true;
}

double Stepper::max_joint_rotation(const double* step) const {
  double largest = 0;
  for (const Node& node : task_.chain.nodes) {
    if (node.kind == Kind::SLIDE || node.program >= 0) continue;
    const double* rotation = step + node.dof;
    largest =
        std::max(largest, node.kind == Kind::BALL ? length(rotation) : std::fabs(rotation[0]));
  }
  return largest;
}

double Stepper::max_world_rotation(const State& state, const double* step) {
  double largest = max_joint_rotation(step);
  for (std::size_t n = 0; n < task_.chain.nodes.size(); ++n) {
    const Node& node = task_.chain.nodes[n];
    double* world_rotation = &world_rotations_[3 * n];
    for (int i = 0; i < 3; ++i)
      world_rotation[i] = node.parent < 0 ? 0 : world_rotations_[3 * node.parent + i];
    if (node.kind == Kind::SLIDE) continue;
    for_each_slope(task_.chain, node, state.frames, [&](int k, int dof, double gain) {
      for (int i = 0; i < 3; ++i)
        world_rotation[i] += gain * step[dof] * state.frames.axes[9 * n + 3 * k + i];
    });
    largest = std::max(largest, length(world_rotation));
  }
  return largest;
}

bool Stepper::solve_primal(const Linearized& linear, double damping, double* out) {
  const int dofs = task_.chain.dof_count;
  prepare_normal(linear, damping + task_.rest_weight);
  std::fill(out, out + dofs, 0.0);
  for (const FixedDirection& fixed : fixed_directions_) add_fixed(fixed, fixed.value, out);
  std::copy(linear.negative_gradient.begin(), linear.negative_gradient.end(),
            right_hand_side_.begin());
  if (!fixed_directions_.empty()) {
    multiply_matrix(out, buffer_.data());
    for (int d = 0; d < dofs; ++d) right_hand_side_[d] -= buffer_[d];
    project(right_hand_side_.data());
    for (const FixedDirection& fixed : fixed_directions_) remove_direction(fixed);
  }
  if (!factor_cholesky(matrix_.data(), jacobian_product_.data(), dofs)) return false;
  solve_factored(matrix_.data(), right_hand_side_.data(), dofs);
  for (int d = 0; d < dofs; ++d) out[d] += right_hand_side_[d];
  return true;
}

void Stepper::remove_direction(const FixedDirection& fixed) {
  const double* direction = fixed.direction;
  double quadratic = 0;
  for (int i = 0; i < matrix_size_; ++i) {
    buffer_[i] = 0;
    for (int k = 0; k < fixed.width; ++k) buffer_[i] += entry(i, fixed.dof + k) * direction[k];
  }
  for (int k = 0; k < fixed.width; ++k) quadratic += direction[k] * buffer_[fixed.dof + k];
  for (int k = 0; k < fixed.width; ++k) {
    const int row = fixed.dof + k;
    for (int i = 0; i < matrix_size_; ++i)
      if (i < fixed.dof || i >= fixed.dof + fixed.width) entry(i, row) -= buffer_[i] * direction[k];
    for (int n = 0; n <= k; ++n) {
      const int column = fixed.dof + n;
      entry(row, column) += (quadratic + 1) * direction[k] * direction[n] -
                            buffer_[row] * direction[n] - direction[k] * buffer_[column];
    }
  }
}

bool Stepper::solve_dual(const State& state, const Linearized& linear, double damping,
                         double* out) {
  const int m = task_.row_count, dofs = task_.chain.dof_count;
  const double diagonal = damping + task_.rest_weight;
  std::copy(linear.gram_matrix.begin(), linear.gram_matrix.end(), matrix_.begin());
  std::copy(state.residuals.begin(), state.residuals.end(), right_hand_side_.begin());
  for (int i = 0; i < m; ++i) matrix_[i * m + i] += diagonal;
  const bool has_rest = task_.rest_weight > 0;
  if (has_rest) {
    for (int d = 0; d < dofs; ++d) solution_[d] = linear.negative_rest_gradient[d] / diagonal;
    project(solution_.data());
    for (int d = 0; d < dofs; ++d) {
      const double* column = linear.columns.data() + static_cast<std::size_t>(d) * m;
      for (int i = linear.first_rows[d]; i < linear.last_rows[d]; ++i)
        right_hand_side_[i] -= column[i] * solution_[d];
    }
  }
  for (const FixedDirection& fixed : fixed_directions_) remove_fixed(fixed, linear);
  if (!factor_cholesky(matrix_.data(), jacobian_product_.data(), m)) return false;
  solve_factored(matrix_.data(), right_hand_side_.data(), m);
  for (int d = 0; d < dofs; ++d) {
    const double* column = linear.columns.data() + static_cast<std::size_t>(d) * m;
    double sum = has_rest ? solution_[d] : 0;
    for (int i = linear.first_rows[d]; i < linear.last_rows[d]; ++i)
      sum += column[i] * right_hand_side_[i];
    out[d] = sum;
  }
  project(out);
  for (const FixedDirection& fixed : fixed_directions_) add_fixed(fixed, fixed.value, out);
  return true;
}

void Stepper::remove_fixed(const FixedDirection& fixed, const Linearized& linear) {
  const int m = task_.row_count;
  const int first_row = linear.first_rows[fixed.dof], last_row = linear.last_rows[fixed.dof];
  for (int i = first_row; i < last_row; ++i) {
    jacobian_product_[i] = 0;
    for (int k = 0; k < fixed.width; ++k)
      jacobian_product_[i] +=
          linear.columns[static_cast<std::size_t>(fixed.dof + k) * m + i] * fixed.direction[k];
  }
  for (int i = first_row; i < last_row; ++i) {
    right_hand_side_[i] -= jacobian_product_[i] * fixed.value;
    double* row = &matrix_[static_cast<std::size_t>(i) * m];
    for (int j = first_row; j <= i; ++j) row[j] -= jacobian_product_[i] * jacobian_product_[j];
  }
}

bool Stepper::solve_hessian(const State& state, const Linearized& linear, double damping,
                            double max_rotation, double relative_tolerance, double* out) {
  const int dofs = task_.chain.dof_count;
  const double shift = damping + task_.rest_weight + curvature_bound(state);
  bool is_first = !is_redundant_;
  if (is_redundant_) {
    is_first = std::all_of(out, out + dofs, [](double component) { return component == 0; });
    project(out);
  } else {
    std::fill(out, out + dofs, 0.0);
  }
  for (const FixedDirection& fixed : fixed_directions_) add_fixed(fixed, fixed.value, out);
  multiply_hessian(state, linear, true, damping, out, product_.data());
  for (int d = 0; d < dofs; ++d) residual_[d] = linear.negative_gradient[d] - product_[d];
  if (is_redundant_) collect_cones(shift);
  if (!prepare_preconditioner(linear, shift)) return false;
  std::fill(product_.begin(), product_.end(), 0.0);
  add_cone_curvature(out, product_.data());
  for (int d = 0; d < dofs; ++d) residual_[d] -= product_[d];
  project(residual_.data());
  precondition(linear, shift);
  double squared_residual = 0, dot_product = 0;
  for (int d = 0; d < dofs; ++d) {
    search_direction_[d] = solution_[d];
    squared_residual += residual_[d] * residual_[d], dot_product += residual_[d] * solution_[d];
  }
  if (is_first) initial_residual_ = squared_residual;
  const double tolerance = initial_residual_ * relative_tolerance * relative_tolerance *
                           std::min(1.0, initial_residual_);
  const int max_iterations = std::min(2 * dofs + 10, MAX_CG_ITERATIONS);
  for (int iteration = 0;
       iteration < max_iterations && squared_residual > tolerance && squared_residual > 1e-300;
       ++iteration) {
    multiply_hessian(state, linear, true, damping, search_direction_.data(), product_.data());
    add_cone_curvature(search_direction_.data(), product_.data());
    project(product_.data());
    double curvature = 0, squared_length = 0;
    for (int d = 0; d < dofs; ++d)
      curvature += search_direction_[d] * product_[d],
          squared_length += search_direction_[d] * search_direction_[d];
    if (curvature <= 1e-14 * squared_length) {
      if (iteration > 0) break;
      const double step_length = MAX_ROTATION / std::sqrt(squared_length);
      for (int d = 0; d < dofs; ++d) out[d] += step_length * search_direction_[d];
      break;
    }
    const double step_length = dot_product / curvature;
    for (int d = 0; d < dofs; ++d) {
      out[d] += step_length * search_direction_[d];
      residual_[d] -= step_length * product_[d];
    }
    if (max_world_rotation(state, out) > max_rotation) break;
    precondition(linear, shift);
    double next_dot_product = 0;
    squared_residual = 0;
    for (int d = 0; d < dofs; ++d)
      next_dot_product += residual_[d] * solution_[d],
          squared_residual += residual_[d] * residual_[d];
    for (int d = 0; d < dofs; ++d)
      search_direction_[d] = solution_[d] + next_dot_product / dot_product * search_direction_[d];
    dot_product = next_dot_product;
  }
  return true;
}

bool Stepper::is_at_limit(const State& state) const {
  for (const Node& node : task_.chain.nodes) {
    if (!has_limit(node)) continue;
    const double* q = &state.q[node.coordinate];
    const bool is_inside = node.kind == Kind::BALL ? is_well_inside(node, q)
                                                   : q[0] > node.limit[0] && q[0] < node.limit[1];
    if (!is_inside) return true;
  }
  return false;
}

bool Stepper::release_limits(const State& state, const Linearized& linear, double damping,
                             const double* step) {
  multiply_hessian(state, linear, true, damping, step, product_.data());
  add_cone_curvature(step, product_.data());
  for (int d = 0; d < task_.chain.dof_count; ++d)
    residual_[d] = linear.negative_gradient[d] - product_[d];
  const auto is_inward = [&](const FixedDirection& fixed) {
    return fixed.outward_sign * component(fixed, residual_.data()) < 0;
  };
  bool has_released = false;
  for (const FixedDirection& fixed : fixed_directions_) {
    if (!is_inward(fixed)) continue;
    at_limit_[fixed.node] = {};
    has_released = true;
  }
  const auto is_released = [&](const FixedDirection& fixed) {
    const LimitFlags& at_limit = at_limit_[fixed.node];
    return fixed.outward_sign != 0 && !at_limit.is_range_fixed && !at_limit.is_swing_fixed &&
           !at_limit.is_twist_fixed;
  };
  std::erase_if(fixed_directions_, is_released);
  return has_released;
}

void Stepper::collect_cones(double shift) {
  cones_.clear();
  for (const FixedDirection& fixed : fixed_directions_) {
    const double bend_length = length(fixed.bend), force = component(fixed, residual_.data());
    if (!(force > 0) || !(bend_length > 0)) continue;
    const double stiffness = force * bend_length * bend_length;
    ConeCurvature cone{fixed.dof, {}, stiffness, stiffness / (shift + stiffness)};
    for (int k = 0; k < 3; ++k) cone.direction[k] = fixed.bend[k] / bend_length;
    cones_.push_back(cone);
  }
}

double Stepper::curvature_bound(const State& state) const {
  double sum = 0;
  for (std::size_t e = 0; e < task_.goals.size(); ++e) {
    const double* weights = &state.weights[COMPONENT_COUNT * e];
    const double* errors = &state.errors[COMPONENT_COUNT * e];
    for (int component = 0; component < COMPONENT_COUNT; ++component)
      sum += weights[component] * weights[component] * errors[component];
  }
  return std::max(sum, MIN_CURVATURE_SHIFT);
}

bool Stepper::prepare_preconditioner(const Linearized& linear, double shift) {
  const int m = task_.row_count;
  if (linear.is_primal) {
    prepare_normal(linear, shift);
    for (const FixedDirection& fixed : fixed_directions_) remove_direction(fixed);
    return factor_cholesky(matrix_.data(), jacobian_product_.data(), matrix_size_);
  }
  std::copy(linear.gram_matrix.begin(), linear.gram_matrix.end(), matrix_.begin());
  for (int i = 0; i < m; ++i) matrix_[i * m + i] += shift;
  for (const FixedDirection& fixed : fixed_directions_) remove_fixed(fixed, linear);
  for (const ConeCurvature& cone : cones_) {
    const double root = std::sqrt(cone.fraction);
    FixedDirection scaled{cone.dof, 3, {}, 0, 0};
    for (int k = 0; k < 3; ++k) scaled.direction[k] = root * cone.direction[k];
    remove_fixed(scaled, linear);
  }
  return factor_cholesky(matrix_.data(), jacobian_product_.data(), m);
}

void Stepper::precondition(const Linearized& linear, double shift) {
  const int m = task_.row_count;
  if (linear.is_primal) {
    solution_ = residual_;
    solve_factored(matrix_.data(), solution_.data(), matrix_size_);
    project(solution_.data());
    return;
  }
  std::copy(residual_.begin(), residual_.end(), solution_.begin());
  apply_cones(solution_.data());
  apply_jacobian(linear, solution_.data());
  solve_factored(matrix_.data(), jacobian_product_.data(), m);
  for (int d = 0; d < task_.chain.dof_count; ++d) {
    const double* column = linear.columns.data() + static_cast<std::size_t>(d) * m;
    double sum = residual_[d];
    for (int i = linear.first_rows[d]; i < linear.last_rows[d]; ++i)
      sum -= column[i] * jacobian_product_[i];
    solution_[d] = sum / shift;
  }
  apply_cones(solution_.data());
  project(solution_.data());
}

}  // namespace animtool::ik
