// One damped step within the limits: its equations, and fixed directions.
#include "ik/step.h"

namespace animtool::ik {

bool Stepper::fix_violations(const State& state, const double* step, std::vector<Fixed>& fixed,
                             std::vector<Pinned>& pinned) {
  fixed_.swap(fixed), pinned_.swap(pinned);
  const bool solved = fix_violations(state, step);
  fixed_.swap(fixed), pinned_.swap(pinned);
  return solved;
}

bool Stepper::step(const State& state, const Linearized& linear, double damping, bool curved,
                   double longest, double* out) {
  shut(state);
  for (int pass = 0; pass < MAX_PASSES; ++pass) {
    if (!(curved ? solve_curved(state, linear, damping, longest, out)
                 : linear.primal ? solve_primal(linear, damping, out)
                                 : solve_dual(state, linear, damping, out)))
      return false;
    shorten(state, curved, longest, out);
    if (!fix_violations(state, out)) return true;
  }
  return true;
}

double Stepper::predicted(const State& state, const Linearized& linear, bool curved,
                          const double* step) {
  map(linear, step);
  double gain = 0, squares = 0;
  for (const double x : image_) squares += x * x;
  for (int d = 0; d < task_.chain.dofs; ++d)
    gain += step[d] * (linear.downhill[d] - task_.rest_weight * step[d] / 2);
  gain -= squares / 2;
  if (!curved) return gain;
  std::fill(product_.begin(), product_.end(), 0.0);
  curvature_.add(task_, state, step, product_.data());
  for (int d = 0; d < task_.chain.dofs; ++d) gain -= step[d] * product_[d] / 2;
  return gain;
}

void Stepper::hessian(const State& state, const Linearized& linear, bool curved, double damping,
                      const double* v, double* out) {
  const int m = task_.rows;
  map(linear, v);
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

void Stepper::map(const Linearized& linear, const double* v) {
  std::fill(image_.begin(), image_.end(), 0.0);
  for (int d = 0; d < task_.chain.dofs; ++d) {
    const double* column = linear.columns.data() + static_cast<std::size_t>(d) * task_.rows;
    for (int i = linear.first[d]; i < linear.last[d]; ++i) image_[i] += column[i] * v[d];
  }
}

void Stepper::shut(const State& state) {
  fixed_.clear();
  std::fill(pinned_.begin(), pinned_.end(), Pinned{});
  for (std::size_t n = 0; n < task_.chain.nodes.size(); ++n) {
    const Node& node = task_.chain.nodes[n];
    if (node.kind != Kind::BALL || !limited(node)) continue;
    const double* limit = node.limit;
    const bool narrow[2] = {limit[0] < SHUT, limit[1] < SHUT};
    const bool straight = limit[3] - limit[2] < SHUT;
    if (!narrow[0] && !narrow[1] && !straight) continue;
    const double* q = &state.q[node.coordinate];
    const SwingTwist parts = split(q, limit);
    const SwingTwistGradients slopes = gradients(q, parts);
    for (int k = 0; k < 2; ++k)
      if (narrow[k]) fix(static_cast<int>(n), slopes.swing[k], 0.0);
    if (narrow[0] && narrow[1]) pinned_[n].swing = true;
    if (straight) fix(static_cast<int>(n), slopes.twist, 0.0), pinned_[n].twist = true;
  }
}

void Stepper::fix(int n, const double* normal, double value) {
  const Node& node = task_.chain.nodes[n];
  double direction[3] = {normal[0], normal[1], normal[2]};
  double size = length(direction);
  if (!(size > 0)) return;
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
    if (pinned_[n].box) continue;
    const double next = q[0] + step[node.dof];
    if (next >= node.limit[0] - ROUNDING && next <= node.limit[1] + ROUNDING) continue;
    const double bound = next < node.limit[0] ? node.limit[0] : node.limit[1];
    fixed_.push_back({node.dof, 1, {1, 0, 0}, bound - q[0], static_cast<int>(n)});
    pinned_[n].box = true;
    solved = true;
  }
  return solved;
}

bool Stepper::fix_ball(int n, const double* q, const double* step) {
  const Node& node = task_.chain.nodes[n];
  Pinned& pinned = pinned_[n];
  if (pinned.swing && pinned.twist) return false;
  double rotation[4], next[4];
  exponential(step, rotation);
  product(rotation, q, next);
  if (well_inside(node, next)) return false;
  const Beyond out = beyond(split(next, node.limit), node.limit);
  const bool swing = out.swing && !pinned.swing, twist = out.twist && !pinned.twist;
  if (!swing && !twist) return false;
  // The tangent of the limit at the point to which the step would be clamped.
  clamp_ball(next, node.limit);
  const double back[4] = {-q[0], -q[1], -q[2], q[3]};
  double between[4], towards[3];
  product(next, back, between);
  logarithm(between, towards);
  const SwingTwist parts = split(next, node.limit);
  const SwingTwistGradients slopes = gradients(next, parts);
  if (swing) {
    const double a = std::max(node.limit[0], SHUT), b = std::max(node.limit[1], SHUT);
    double normal[3];
    for (int i = 0; i < 3; ++i)
      normal[i] = parts.swing[0] / (a * a) * slopes.swing[0][i] +
                  parts.swing[1] / (b * b) * slopes.swing[1][i];
    fix(n, normal, dot(normal, towards));
    pinned.swing = true;
  }
  if (twist) {
    fix(n, slopes.twist, dot(slopes.twist, towards));
    pinned.twist = true;
  }
  return true;
}

double Stepper::turning(const double* step) const {
  double longest = 0;
  for (const Node& node : task_.chain.nodes) {
    if (node.kind == Kind::SLIDE || node.program >= 0) continue;
    const double* by = step + node.dof;
    longest = std::max(longest, node.kind == Kind::BALL ? length(by) : std::fabs(by[0]));
  }
  return longest;
}

double Stepper::turning(const State& state, const double* step) {
  double longest = turning(step);
  for (std::size_t n = 0; n < task_.chain.nodes.size(); ++n) {
    const Node& node = task_.chain.nodes[n];
    double* turned = &turned_[3 * n];
    for (int i = 0; i < 3; ++i) turned[i] = node.parent < 0 ? 0 : turned_[3 * node.parent + i];
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
    times_matrix(out, felt_.data());
    for (int d = 0; d < dofs; ++d) right_[d] -= felt_[d];
    project(right_.data());
    for (const Fixed& fixed : fixed_) shut(fixed);
  }
  if (!factor_cholesky(matrix_.data(), image_.data(), dofs)) return false;
  solve_factored(matrix_.data(), right_.data(), dofs);
  for (int d = 0; d < dofs; ++d) out[d] += right_[d];
  return true;
}

void Stepper::shut(const Fixed& fixed) {
  const double* c = fixed.direction;
  double felt = 0;
  for (int i = 0; i < side_; ++i) {
    felt_[i] = 0;
    for (int k = 0; k < fixed.width; ++k) felt_[i] += entry(i, fixed.dof + k) * c[k];
  }
  for (int k = 0; k < fixed.width; ++k) felt += c[k] * felt_[fixed.dof + k];
  for (int k = 0; k < fixed.width; ++k) {
    const int at = fixed.dof + k;
    for (int i = 0; i < side_; ++i)
      if (i < fixed.dof || i >= fixed.dof + fixed.width) entry(i, at) -= felt_[i] * c[k];
    for (int n = 0; n <= k; ++n) {
      const int other = fixed.dof + n;
      entry(at, other) += (felt + 1) * c[k] * c[n] - felt_[at] * c[n] - c[k] * felt_[other];
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
  const bool drawn = task_.rest_weight > 0;
  if (drawn) {
    for (int d = 0; d < dofs; ++d) free_[d] = linear.pull[d] / diagonal;
    project(free_.data());
    for (int d = 0; d < dofs; ++d) {
      const double* column = linear.columns.data() + static_cast<std::size_t>(d) * m;
      for (int i = linear.first[d]; i < linear.last[d]; ++i) right_[i] -= column[i] * free_[d];
    }
  }
  for (const Fixed& fixed : fixed_) take_out(fixed, linear);
  if (!factor_cholesky(matrix_.data(), image_.data(), m)) return false;
  solve_factored(matrix_.data(), right_.data(), m);
  for (int d = 0; d < dofs; ++d) {
    const double* column = linear.columns.data() + static_cast<std::size_t>(d) * m;
    double sum = drawn ? free_[d] : 0;
    for (int i = linear.first[d]; i < linear.last[d]; ++i) sum += column[i] * right_[i];
    out[d] = sum;
  }
  project(out);
  for (const Fixed& fixed : fixed_) add(fixed, fixed.value, out);
  return true;
}

void Stepper::take_out(const Fixed& fixed, const Linearized& linear) {
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
                           double most, double* out) {
  const int dofs = task_.chain.dofs;
  const double floor = damping + task_.rest_weight + bending(state);
  if (!prepare_measure(linear, floor)) return false;
  std::fill(out, out + dofs, 0.0);
  for (const Fixed& fixed : fixed_) add(fixed, fixed.value, out);
  hessian(state, linear, true, damping, out, product_.data());
  for (int d = 0; d < dofs; ++d) rest_[d] = linear.downhill[d] - product_[d];
  project(rest_.data());
  measure_rest(linear, floor);
  double size = 0, along = 0;
  for (int d = 0; d < dofs; ++d) {
    search_[d] = free_[d];
    size += rest_[d] * rest_[d], along += rest_[d] * free_[d];
  }
  const double enough = size * LOOSE * LOOSE * std::min(1.0, size);
  const int rounds = std::min(2 * dofs + 10, MAX_ROUNDS);
  for (int round = 0; round < rounds && size > enough && size > 1e-300; ++round) {
    hessian(state, linear, true, damping, search_.data(), product_.data());
    project(product_.data());
    double bend = 0, norm = 0;
    for (int d = 0; d < dofs; ++d)
      bend += search_[d] * product_[d], norm += search_[d] * search_[d];
    if (bend <= 1e-14 * norm) {
      if (round > 0) break;
      const double far = MAX_ROTATION / std::sqrt(norm);
      for (int d = 0; d < dofs; ++d) out[d] += far * search_[d];
      break;
    }
    const double amount = along / bend;
    for (int d = 0; d < dofs; ++d) {
      out[d] += amount * search_[d];
      rest_[d] -= amount * product_[d];
    }
    if (turning(state, out) > most) break;
    measure_rest(linear, floor);
    double next = 0;
    size = 0;
    for (int d = 0; d < dofs; ++d)
      next += rest_[d] * free_[d], size += rest_[d] * rest_[d];
    for (int d = 0; d < dofs; ++d) search_[d] = free_[d] + next / along * search_[d];
    along = next;
  }
  return true;
}

double Stepper::bending(const State& state) const {
  double sum = 0;
  for (std::size_t e = 0; e < task_.goals.size(); ++e) {
    const double* weights = &state.weights[PARTS * e];
    const double* misses = &state.misses[PARTS * e];
    for (int part = 0; part < PARTS; ++part)
      sum += weights[part] * weights[part] * misses[part];
  }
  return std::max(sum, LEAST_FLOOR);
}

bool Stepper::prepare_measure(const Linearized& linear, double floor) {
  const int m = task_.rows;
  if (linear.primal) {
    prepare_normal(linear, floor);
    for (const Fixed& fixed : fixed_) shut(fixed);
    return factor_cholesky(matrix_.data(), image_.data(), side_);
  }
  std::copy(linear.gram.begin(), linear.gram.end(), matrix_.begin());
  for (int i = 0; i < m; ++i) matrix_[i * m + i] += floor;
  for (const Fixed& fixed : fixed_) take_out(fixed, linear);
  return factor_cholesky(matrix_.data(), image_.data(), m);
}

void Stepper::measure_rest(const Linearized& linear, double floor) {
  const int m = task_.rows;
  if (linear.primal) {
    free_ = rest_;
    solve_factored(matrix_.data(), free_.data(), side_);
    project(free_.data());
    return;
  }
  map(linear, rest_.data());
  solve_factored(matrix_.data(), image_.data(), m);
  for (int d = 0; d < task_.chain.dofs; ++d) {
    const double* column = linear.columns.data() + static_cast<std::size_t>(d) * m;
    double sum = rest_[d];
    for (int i = linear.first[d]; i < linear.last[d]; ++i) sum -= column[i] * image_[i];
    free_[d] = sum / floor;
  }
  project(free_.data());
}

}  // namespace animtool::ik
