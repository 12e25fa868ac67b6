// One damped step within the limits: its equations, and fixed directions.
#include "ik/step.h"

namespace animtool::ik {

bool Stepper::fix_violations(const State& state, const double* step, std::vector<Fixed>& fixed,
                             std::vector<AtLimit>& at_limit) {
  fixed_.swap(fixed), at_limit_.swap(at_limit);
  const bool solved = fix_violations(state, step);
  fixed_.swap(fixed), at_limit_.swap(at_limit);
  return solved;
}

bool Stepper::step(const State& state, const Linearized& linear, double damping, bool curved,
                   double longest, double* out) {
  fix_locked(state);
  std::fill(out, out + task_.chain.dofs, 0.0);
  const bool many = curved && abundant_;
  // Limits that are run into show up in rough steps, so where some are reached these come first.
  bool tight = !many || !on_limits(state), released = !many;
  for (int pass = 0; pass < MAX_PASSES; ++pass) {
    tight = tight || pass + 1 == MAX_PASSES;
    if (!(curved ? solve_curved(state, linear, damping, longest, tight ? CG_TOLERANCE : ROUGH, out)
          : linear.primal ? solve_primal(linear, damping, out)
                          : solve_dual(state, linear, damping, out)))
      return false;
    const bool shortened = shorten(state, curved, longest, out);
    if (fix_violations(state, out)) {
      tight = !many;
      continue;
    }
    if (shortened) return true;
    if (tight && (released || fixed_.empty() || !release(state, linear, damping, out))) return true;
    released = tight;
    tight = true;
  }
  return true;
}

double Stepper::predicted(const State& state, const Linearized& linear, bool curved,
                          const double* step) {
  apply_jacobian(linear, step);
  double gain = 0, squares = 0;
  for (const double x : image_) squares += x * x;
  for (int d = 0; d < task_.chain.dofs; ++d)
    gain += step[d] * (linear.downhill[d] - task_.rest_weight * step[d] / 2);
  gain -= squares / 2;
  if (!curved) return gain;
  std::fill(product_.begin(), product_.end(), 0.0);
  curvature_.add(task_, state, step, product_.data());
  add_bends(step, product_.data());
  for (int d = 0; d < task_.chain.dofs; ++d) gain -= step[d] * product_[d] / 2;
  return gain;
}

void Stepper::hessian(const State& state, const Linearized& linear, bool curved, double damping,
                      const double* v, double* out) {
  const int m = task_.rows;
  apply_jacobian(linear, v);
  for (int d = 0; d < task_.chain.dofs; ++d) {
    const double* column = linear.columns.data() + static_cast<std::size_t>(d) * m;
    double sum = (damping + task_.rest_weight) * v[d];
    for (int i = linear.first[d]; i < linear.last[d]; ++i) sum += column[i] * image_[i];
    out[d] = sum;
  }
  if (curved) curvature_.add(task_, state, v, out);
}

void Stepper::move(const Node& node, const double* now, const double* by, double* next) {
  if (node.kind == Kind::BALL) {
    double rotation[4], turned[4];
    exponential(by, rotation);
    product(rotation, now, turned);
    normalize(turned);
    if (limited(node) && !well_inside(node, turned)) clamp_ball(turned, node.limit);
    std::copy(turned, turned + 4, next);
  } else {
    next[0] = std::clamp(now[0] + by[0], node.limit[0], node.limit[1]);
  }
}

void Stepper::apply_jacobian(const Linearized& linear, const double* v) {
  std::fill(image_.begin(), image_.end(), 0.0);
  for (int d = 0; d < task_.chain.dofs; ++d) {
    const double* column = linear.columns.data() + static_cast<std::size_t>(d) * task_.rows;
    for (int i = linear.first[d]; i < linear.last[d]; ++i) image_[i] += column[i] * v[d];
  }
}

void Stepper::fix_locked(const State& state) {
  fixed_.clear();
  std::fill(at_limit_.begin(), at_limit_.end(), AtLimit{});
  for (std::size_t n = 0; n < task_.chain.nodes.size(); ++n) {
    const Node& node = task_.chain.nodes[n];
    if (node.kind != Kind::BALL || !limited(node)) continue;
    const double* limit = node.limit;
    const bool narrow[2] = {limit[0] < LOCKED, limit[1] < LOCKED};
    const bool straight = limit[3] - limit[2] < LOCKED;
    if (!narrow[0] && !narrow[1] && !straight) continue;
    const double* q = &state.q[node.coordinate];
    const SwingTwist parts = decompose(q, limit);
    const SwingTwistGradients slopes = gradients(q, parts);
    for (int k = 0; k < 2; ++k)
      if (narrow[k]) fix(static_cast<int>(n), slopes.swing[k], 0.0);
    if (narrow[0] && narrow[1]) at_limit_[n].swing = true;
    if (straight) fix(static_cast<int>(n), slopes.twist, 0.0), at_limit_[n].twist = true;
  }
}

void Stepper::fix(int n, const double* normal, double value, int outwards,
                  const double* curvature) {
  const Node& node = task_.chain.nodes[n];
  double direction[3] = {normal[0], normal[1], normal[2]};
  double size = length(direction);
  if (!(size > 0)) return;
  const double curving = 1 / std::sqrt(size);
  value /= size;
  for (double& x : direction) x /= size;
  for (const Fixed& other : fixed_) {
    if (other.node != n) continue;
    const double shared = dot(direction, other.direction);
    for (int i = 0; i < 3; ++i) direction[i] -= shared * other.direction[i];
    value -= shared * other.value;
  }
  size = length(direction);
  if (size < 1e-3) return;
  for (double& x : direction) x /= size;
  fixed_.push_back({node.dof, 3, {direction[0], direction[1], direction[2]}, value / size, n});
  fixed_.back().outwards = outwards;
  if (curvature)
    for (int i = 0; i < 3; ++i) fixed_.back().bend[i] = curving * curvature[i];
}

bool Stepper::fix_violations(const State& state, const double* step) {
  bool solved = false;
  for (std::size_t n = 0; n < task_.chain.nodes.size(); ++n) {
    const Node& node = task_.chain.nodes[n];
    if (!limited(node)) continue;
    const double* q = &state.q[node.coordinate];
    if (node.kind == Kind::BALL) {
      solved = fix_ball(static_cast<int>(n), q, step + node.dof) || solved;
      continue;
    }
    if (at_limit_[n].box) continue;
    const double next = q[0] + step[node.dof];
    if (next >= node.limit[0] - ROUNDING && next <= node.limit[1] + ROUNDING) continue;
    const double bound = next < node.limit[0] ? node.limit[0] : node.limit[1];
    fixed_.push_back({node.dof, 1, {1, 0, 0}, bound - q[0], static_cast<int>(n)});
    fixed_.back().outwards = next < node.limit[0] ? -1 : 1;
    at_limit_[n].box = true;
    solved = true;
  }
  return solved;
}

bool Stepper::fix_ball(int n, const double* q, const double* step) {
  const Node& node = task_.chain.nodes[n];
  AtLimit& at_limit = at_limit_[n];
  if (at_limit.swing && at_limit.twist) return false;
  double rotation[4], next[4];
  exponential(step, rotation);
  product(rotation, q, next);
  if (well_inside(node, next)) return false;
  const Exceeded out = exceeded(decompose(next, node.limit), node.limit);
  const bool swing = out.swing && !at_limit.swing, twist = out.twist && !at_limit.twist;
  if (!swing && !twist) return false;
  // The tangent of the limit at the point to which the step would be clamped.
  clamp_ball(next, node.limit);
  const double back[4] = {-q[0], -q[1], -q[2], q[3]};
  double between[4], towards[3];
  product(next, back, between);
  logarithm(between, towards);
  const SwingTwist parts = decompose(next, node.limit);
  const SwingTwistGradients slopes = gradients(next, parts);
  if (swing) {
    const double a = std::max(node.limit[0], LOCKED), b = std::max(node.limit[1], LOCKED);
    const double outwards[2] = {parts.swing[0] / (a * a), parts.swing[1] / (b * b)};
    // Along the ellipse, and the root of its second derivative there.
    const double size = std::hypot(outwards[0], outwards[1]);
    const double around[2] = {-outwards[1] / size, outwards[0] / size};
    const double root = std::hypot(around[0] / a, around[1] / b);
    double normal[3], curvature[3];
    for (int i = 0; i < 3; ++i) {
      normal[i] = outwards[0] * slopes.swing[0][i] + outwards[1] * slopes.swing[1][i];
      curvature[i] = root * (around[0] * slopes.swing[0][i] + around[1] * slopes.swing[1][i]);
    }
    fix(n, normal, dot(normal, towards), 1, curvature);
    at_limit.swing = true;
  }
  if (twist) {
    const double middle = (node.limit[2] + node.limit[3]) / 2;
    fix(n, slopes.twist, dot(slopes.twist, towards), parts.twist < middle ? -1 : 1);
    at_limit.twist = true;
  }
  return true;
}

double Stepper::largest_rotation(const double* step) const {
  double longest = 0;
  for (const Node& node : task_.chain.nodes) {
    if (node.kind == Kind::SLIDE || node.program >= 0) continue;
    const double* by = step + node.dof;
    longest = std::max(longest, node.kind == Kind::BALL ? length(by) : std::fabs(by[0]));
  }
  return longest;
}

double Stepper::largest_rotation(const State& state, const double* step) {
  double longest = largest_rotation(step);
  for (std::size_t n = 0; n < task_.chain.nodes.size(); ++n) {
    const Node& node = task_.chain.nodes[n];
    double* turned = &world_rotations_[3 * n];
    for (int i = 0; i < 3; ++i)
      turned[i] = node.parent < 0 ? 0 : world_rotations_[3 * node.parent + i];
    if (node.kind == Kind::SLIDE) continue;
    each_slope(task_.chain, node, state.frames, [&](int k, int dof, double gain) {
      for (int i = 0; i < 3; ++i)
        turned[i] += gain * step[dof] * state.frames.axes[9 * n + 3 * k + i];
    });
    longest = std::max(longest, length(turned));
  }
  return longest;
}

bool Stepper::solve_primal(const Linearized& linear, double damping, double* out) {
  const int dofs = task_.chain.dofs;
  prepare_normal(linear, damping + task_.rest_weight);
  std::fill(out, out + dofs, 0.0);
  for (const Fixed& fixed : fixed_) add(fixed, fixed.value, out);
  std::copy(linear.downhill.begin(), linear.downhill.end(), right_.begin());
  if (!fixed_.empty()) {
    times_matrix(out, coupled_.data());
    for (int d = 0; d < dofs; ++d) right_[d] -= coupled_[d];
    project(right_.data());
    for (const Fixed& fixed : fixed_) remove_direction(fixed);
  }
  if (!factor_cholesky(matrix_.data(), image_.data(), dofs)) return false;
  solve_factored(matrix_.data(), right_.data(), dofs);
  for (int d = 0; d < dofs; ++d) out[d] += right_[d];
  return true;
}

void Stepper::remove_direction(const Fixed& fixed) {
  const double* c = fixed.direction;
  double quadratic = 0;
  for (int i = 0; i < side_; ++i) {
    coupled_[i] = 0;
    for (int k = 0; k < fixed.width; ++k) coupled_[i] += entry(i, fixed.dof + k) * c[k];
  }
  for (int k = 0; k < fixed.width; ++k) quadratic += c[k] * coupled_[fixed.dof + k];
  for (int k = 0; k < fixed.width; ++k) {
    const int at = fixed.dof + k;
    for (int i = 0; i < side_; ++i)
      if (i < fixed.dof || i >= fixed.dof + fixed.width) entry(i, at) -= coupled_[i] * c[k];
    for (int n = 0; n <= k; ++n) {
      const int other = fixed.dof + n;
      entry(at, other) +=
          (quadratic + 1) * c[k] * c[n] - coupled_[at] * c[n] - c[k] * coupled_[other];
    }
  }
}

bool Stepper::solve_dual(const State& state, const Linearized& linear, double damping,
                         double* out) {
  const int m = task_.rows, dofs = task_.chain.dofs;
  const double diagonal = damping + task_.rest_weight;
  std::copy(linear.gram.begin(), linear.gram.end(), matrix_.begin());
  std::copy(state.residuals.begin(), state.residuals.end(), right_.begin());
  for (int i = 0; i < m; ++i) matrix_[i * m + i] += diagonal;
  const bool has_rest_pull = task_.rest_weight > 0;
  if (has_rest_pull) {
    for (int d = 0; d < dofs; ++d) free_[d] = linear.pull[d] / diagonal;
    project(free_.data());
    for (int d = 0; d < dofs; ++d) {
      const double* column = linear.columns.data() + static_cast<std::size_t>(d) * m;
      for (int i = linear.first[d]; i < linear.last[d]; ++i) right_[i] -= column[i] * free_[d];
    }
  }
  for (const Fixed& fixed : fixed_) remove_fixed(fixed, linear);
  if (!factor_cholesky(matrix_.data(), image_.data(), m)) return false;
  solve_factored(matrix_.data(), right_.data(), m);
  for (int d = 0; d < dofs; ++d) {
    const double* column = linear.columns.data() + static_cast<std::size_t>(d) * m;
    double sum = has_rest_pull ? free_[d] : 0;
    for (int i = linear.first[d]; i < linear.last[d]; ++i) sum += column[i] * right_[i];
    out[d] = sum;
  }
  project(out);
  for (const Fixed& fixed : fixed_) add(fixed, fixed.value, out);
  return true;
}

void Stepper::remove_fixed(const Fixed& fixed, const Linearized& linear) {
  const int m = task_.rows;
  const int first = linear.first[fixed.dof], last = linear.last[fixed.dof];
  for (int i = first; i < last; ++i) {
    image_[i] = 0;
    for (int k = 0; k < fixed.width; ++k)
      image_[i] +=
          linear.columns[static_cast<std::size_t>(fixed.dof + k) * m + i] * fixed.direction[k];
  }
  for (int i = first; i < last; ++i) {
    right_[i] -= image_[i] * fixed.value;
    double* row = &matrix_[static_cast<std::size_t>(i) * m];
    for (int j = first; j <= i; ++j) row[j] -= image_[i] * image_[j];
  }
}

bool Stepper::solve_curved(const State& state, const Linearized& linear, double damping,
                           double most, double near, double* out) {
  const int dofs = task_.chain.dofs;
  const double floor = damping + task_.rest_weight + curvature_bound(state);
  bool first = !abundant_;
  if (abundant_) {
    first = std::all_of(out, out + dofs, [](double by) { return by == 0; });
    project(out);
  } else {
    std::fill(out, out + dofs, 0.0);
  }
  for (const Fixed& fixed : fixed_) add(fixed, fixed.value, out);
  hessian(state, linear, true, damping, out, product_.data());
  for (int d = 0; d < dofs; ++d) residual_[d] = linear.downhill[d] - product_[d];
  if (abundant_) press(floor);
  if (!prepare_preconditioner(linear, floor)) return false;
  std::fill(product_.begin(), product_.end(), 0.0);
  add_bends(out, product_.data());
  for (int d = 0; d < dofs; ++d) residual_[d] -= product_[d];
  project(residual_.data());
  precondition(linear, floor);
  double size = 0, along = 0;
  for (int d = 0; d < dofs; ++d) {
    search_[d] = free_[d];
    size += residual_[d] * residual_[d], along += residual_[d] * free_[d];
  }
  if (first) initial_ = size;
  const double tolerance = initial_ * near * near * std::min(1.0, initial_);
  const int max_iterations = std::min(2 * dofs + 10, MAX_ROUNDS);
  for (int iteration = 0; iteration < max_iterations && size > tolerance && size > 1e-300;
       ++iteration) {
    hessian(state, linear, true, damping, search_.data(), product_.data());
    add_bends(search_.data(), product_.data());
    project(product_.data());
    double curvature = 0, norm = 0;
    for (int d = 0; d < dofs; ++d)
      curvature += search_[d] * product_[d], norm += search_[d] * search_[d];
    if (curvature <= 1e-14 * norm) {
      if (iteration > 0) break;
      const double far = MAX_ROTATION / std::sqrt(norm);
      for (int d = 0; d < dofs; ++d) out[d] += far * search_[d];
      break;
    }
    const double amount = along / curvature;
    for (int d = 0; d < dofs; ++d) {
      out[d] += amount * search_[d];
      residual_[d] -= amount * product_[d];
    }
    if (largest_rotation(state, out) > most) break;
    precondition(linear, floor);
    double next = 0;
    size = 0;
    for (int d = 0; d < dofs; ++d)
      next += residual_[d] * free_[d], size += residual_[d] * residual_[d];
    for (int d = 0; d < dofs; ++d) search_[d] = free_[d] + next / along * search_[d];
    along = next;
  }
  return true;
}

bool Stepper::on_limits(const State& state) const {
  for (const Node& node : task_.chain.nodes) {
    if (!limited(node)) continue;
    const double* q = &state.q[node.coordinate];
    const bool inside = node.kind == Kind::BALL ? well_inside(node, q)
                                                : q[0] > node.limit[0] && q[0] < node.limit[1];
    if (!inside) return true;
  }
  return false;
}

bool Stepper::release(const State& state, const Linearized& linear, double damping,
                      const double* step) {
  hessian(state, linear, true, damping, step, product_.data());
  add_bends(step, product_.data());
  for (int d = 0; d < task_.chain.dofs; ++d) residual_[d] = linear.downhill[d] - product_[d];
  const auto inwards = [&](const Fixed& fixed) {
    return fixed.outwards * along(fixed, residual_.data()) < 0;
  };
  bool any = false;
  for (const Fixed& fixed : fixed_) {
    if (!inwards(fixed)) continue;
    at_limit_[fixed.node] = {};
    any = true;
  }
  const auto free = [&](const Fixed& fixed) {
    const AtLimit& at_limit = at_limit_[fixed.node];
    return fixed.outwards != 0 && !at_limit.box && !at_limit.swing && !at_limit.twist;
  };
  std::erase_if(fixed_, free);
  return any;
}

void Stepper::press(double floor) {
  bends_.clear();
  for (const Fixed& fixed : fixed_) {
    const double size = length(fixed.bend), force = along(fixed, residual_.data());
    if (!(force > 0) || !(size > 0)) continue;
    const double stiffness = force * size * size;
    Bend cone{fixed.dof, {}, stiffness, stiffness / (floor + stiffness)};
    for (int k = 0; k < 3; ++k) cone.direction[k] = fixed.bend[k] / size;
    bends_.push_back(cone);
  }
}

double Stepper::curvature_bound(const State& state) const {
  double sum = 0;
  for (std::size_t e = 0; e < task_.goals.size(); ++e) {
    const double* weights = &state.weights[PARTS * e];
    const double* errors = &state.errors[PARTS * e];
    for (int part = 0; part < PARTS; ++part) sum += weights[part] * weights[part] * errors[part];
  }
  return std::max(sum, MIN_FLOOR);
}

bool Stepper::prepare_preconditioner(const Linearized& linear, double floor) {
  const int m = task_.rows;
  if (linear.primal) {
    prepare_normal(linear, floor);
    for (const Fixed& fixed : fixed_) remove_direction(fixed);
    return factor_cholesky(matrix_.data(), image_.data(), side_);
  }
  std::copy(linear.gram.begin(), linear.gram.end(), matrix_.begin());
  for (int i = 0; i < m; ++i) matrix_[i * m + i] += floor;
  for (const Fixed& fixed : fixed_) remove_fixed(fixed, linear);
  for (const Bend& curvature : bends_) {
    const double root = std::sqrt(curvature.share);
    Fixed part{curvature.dof, 3, {}, 0, 0};
    for (int k = 0; k < 3; ++k) part.direction[k] = root * curvature.direction[k];
    remove_fixed(part, linear);
  }
  return factor_cholesky(matrix_.data(), image_.data(), m);
}

void Stepper::precondition(const Linearized& linear, double floor) {
  const int m = task_.rows;
  if (linear.primal) {
    free_ = residual_;
    solve_factored(matrix_.data(), free_.data(), side_);
    project(free_.data());
    return;
  }
  std::copy(residual_.begin(), residual_.end(), free_.begin());
  soften(free_.data());
  apply_jacobian(linear, free_.data());
  solve_factored(matrix_.data(), image_.data(), m);
  for (int d = 0; d < task_.chain.dofs; ++d) {
    const double* column = linear.columns.data() + static_cast<std::size_t>(d) * m;
    double sum = residual_[d];
    for (int i = linear.first[d]; i < linear.last[d]; ++i) sum -= column[i] * image_[i];
    free_[d] = sum / floor;
  }
  soften(free_.data());
  project(free_.data());
}

}  // namespace animtool::ik
