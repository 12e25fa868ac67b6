// One damped step that keeps the limits.
//
// min |r - J d|^2 / 2 + damping |d|^2 / 2 over steps inside the limits, by fixing what
// would go beyond at the limit and solving again for the rest.
#pragma once

#include <vector>

#include "ik/limits.h"
#include "ik/linear.h"

namespace animtool::ik {

// Most that a joint turns in one step [rad].
constexpr double LONGEST_TURN = 1.0;

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

  // As those of a step, for a caller that keeps what is fixed: directions that limits
  // of no width leave no room for, and those that a step of its own violates.
  void shut(const State& state, std::vector<Fixed>& fixed, std::vector<Pinned>& pinned) {
    shut(state);
    fixed = fixed_, pinned = pinned_;
  }

  bool fix_violations(const State& state, const double* step, std::vector<Fixed>& fixed,
                      std::vector<Pinned>& pinned) {
    fixed_.swap(fixed), pinned_.swap(pinned);
    const bool found = fix_violations(state, step);
    fixed_.swap(fixed), pinned_.swap(pinned);
    return found;
  }

  // Fills in the step; `curved` uses the whole Hessian in place of J^T J. False where
  // the damping is too small for it.
  bool step(const State& state, const Linearized& linear, double damping, bool curved,
            double longest, double* out) {
    shut(state);
    for (int pass = 0; pass < MOST_PASSES; ++pass) {
      if (!(curved ? solve_curved(state, linear, damping, longest, out)
                   : linear.primal ? solve_primal(linear, damping, out)
                                   : solve_dual(state, linear, damping, out)))
        return false;
      shorten(state, curved, longest, out);
      if (!fix_violations(state, out)) return true;
    }
    return true;
  }

  // How far the last step turns a joint or, curved, anything in the world [rad].
  double turn() const { return turn_; }

  // What the model says the step gains, without the damping.
  double predicted(const State& state, const Linearized& linear, bool curved,
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

  void hessian(const State& state, const Linearized& linear, bool curved, double damping,
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

  // Takes a step, limits kept to the last bit.
  void move(const double* q, const double* step, double* out) const {
    for (const Node& node : task_.chain.nodes)
      if (!node.follows) move(node, q + node.coordinate, step + node.dof, out + node.coordinate);
  }

  static void move(const Node& node, const double* now, const double* by, double* next) {
    if (node.kind == Kind::BALL) {
      double turn[4], turned[4];
      exponential(by, turn);
      product(turn, now, turned);
      normalize(turned);
      if (limited(node) && !well_inside(node, turned)) clamp_ball(turned, node.limit);
      std::copy(turned, turned + 4, next);
    } else {
      next[0] = std::clamp(now[0] + by[0], node.limit[0], node.limit[1]);
    }
  }

 private:
  static constexpr int MOST_PASSES = 12;
  static constexpr int MOST_ROUNDS = 300;
  static constexpr double LOOSE = 1e-2;
  static constexpr double LEAST_FLOOR = 1e-9;

  // image_ = J v
  void map(const Linearized& linear, const double* v) {
    std::fill(image_.begin(), image_.end(), 0.0);
    for (int d = 0; d < task_.chain.dofs; ++d) {
      const double* column = linear.columns.data() + static_cast<std::size_t>(d) * task_.rows;
      for (int i = linear.first[d]; i < linear.last[d]; ++i) image_[i] += column[i] * v[d];
    }
  }

  // Directions that limits of no width leave no room for.
  void shut(const State& state) {
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

  // Fixes the part of a ball's step along a direction, less what is fixed already.
  void fix(int n, const double* normal, double value) {
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

  bool fix_violations(const State& state, const double* step) {
    bool found = false;
    for (std::size_t n = 0; n < task_.chain.nodes.size(); ++n) {
      const Node& node = task_.chain.nodes[n];
      if (!limited(node)) continue;
      const double* q = &state.q[node.coordinate];
      if (node.kind == Kind::BALL) {
        found = fix_ball(static_cast<int>(n), q, step + node.dof) || found;
        continue;
      }
      if (pinned_[n].box) continue;
      const double next = q[0] + step[node.dof];
      if (next >= node.limit[0] - ROUNDING && next <= node.limit[1] + ROUNDING) continue;
      const double bound = next < node.limit[0] ? node.limit[0] : node.limit[1];
      fixed_.push_back({node.dof, 1, {1, 0, 0}, bound - q[0], static_cast<int>(n)});
      pinned_[n].box = true;
      found = true;
    }
    return found;
  }

  bool fix_ball(int n, const double* q, const double* step) {
    const Node& node = task_.chain.nodes[n];
    Pinned& pinned = pinned_[n];
    if (pinned.swing && pinned.twist) return false;
    double turn[4], next[4];
    exponential(step, turn);
    product(turn, q, next);
    if (well_inside(node, next)) return false;
    const Beyond out = beyond(split(next, node.limit), node.limit);
    const bool swing = out.swing && !pinned.swing, twist = out.twist && !pinned.twist;
    if (!swing && !twist) return false;
    // The tangent of the limit where the step would be brought back to it.
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

  // Joints turn by no more than a bound; where second derivatives are trusted, what
  // turns in the world does not either, for these are far off once it has.
  void shorten(const State& state, bool curved, double most, double* step) {
    const double longest = curved ? turning(state, step) : turning(step);
    turn_ = std::min(longest, most);
    if (longest <= most) return;
    for (int d = 0; d < task_.chain.dofs; ++d) step[d] *= most / longest;
  }

  double turning(const double* step) const {
    double longest = 0;
    for (const Node& node : task_.chain.nodes) {
      if (node.kind == Kind::SLIDE || node.program >= 0) continue;
      const double* by = step + node.dof;
      longest = std::max(longest, node.kind == Kind::BALL ? length(by) : std::fabs(by[0]));
    }
    return longest;
  }

  double turning(const State& state, const double* step) {
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

  // (J^T J + D) d = J^T r + c: as large as the chain, not as the residual.
  bool solve_primal(const Linearized& linear, double damping, double* out) {
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

  // A <- P A P + c c^T, P = 1 - c c^T: nothing moves along c, and nothing feels it.
  void shut(const Fixed& fixed) {
    const double* c = fixed.direction;
    double own = 0;
    for (int i = 0; i < side_; ++i) {
      felt_[i] = 0;
      for (int k = 0; k < fixed.width; ++k) felt_[i] += entry(i, fixed.dof + k) * c[k];
    }
    for (int k = 0; k < fixed.width; ++k) own += c[k] * felt_[fixed.dof + k];
    for (int k = 0; k < fixed.width; ++k) {
      const int at = fixed.dof + k;
      for (int i = 0; i < side_; ++i)
        if (i < fixed.dof || i >= fixed.dof + fixed.width) entry(i, at) -= felt_[i] * c[k];
      for (int n = 0; n <= k; ++n) {
        const int other = fixed.dof + n;
        entry(at, other) += (own + 1) * c[k] * c[n] - felt_[at] * c[n] - c[k] * felt_[other];
      }
    }
  }

  // (J J^T + D) z = r - J c / D, d = J^T z + c / D: as large as the residual, not as
  // the chain.
  bool solve_dual(const State& state, const Linearized& linear, double damping, double* out) {
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

  void take_out(const Fixed& fixed, const Linearized& linear) {
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

  // Conjugate gradients, stopped where the cost bends downwards (T. Steihaug, The
  // conjugate gradient method and trust regions in large scale optimization, 1983), in the
  // measure of J^T J and about what second derivatives add to it.
  bool solve_curved(const State& state, const Linearized& linear, double damping, double most,
                    double* out) {
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
    const int rounds = std::min(2 * dofs + 10, MOST_ROUNDS);
    for (int round = 0; round < rounds && size > enough && size > 1e-300; ++round) {
      hessian(state, linear, true, damping, search_.data(), product_.data());
      project(product_.data());
      double bend = 0, norm = 0;
      for (int d = 0; d < dofs; ++d)
        bend += search_[d] * product_[d], norm += search_[d] * search_[d];
      if (bend <= 1e-14 * norm) {
        if (round > 0) break;
        const double far = LONGEST_TURN / std::sqrt(norm);
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

  // How much second derivatives may bend the cost: forces and torques on the goals.
  double bending(const State& state) const {
    double sum = 0;
    for (std::size_t e = 0; e < task_.goals.size(); ++e) {
      const double* weights = &state.weights[PARTS * e];
      const double* misses = &state.misses[PARTS * e];
      for (int part = 0; part < PARTS; ++part)
        sum += weights[part] * weights[part] * misses[part];
    }
    return std::max(sum, LEAST_FLOOR);
  }

  // The factor of J J^T + floor or J^T J + floor, what is fixed taken out.
  bool prepare_measure(const Linearized& linear, double floor) {
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

  // free_ = (J^T J + floor)^-1 rest_
  void measure_rest(const Linearized& linear, double floor) {
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

  const Task& task_;
  Curvature curvature_;
  const int side_;  // of the matrix
  std::vector<double> matrix_, right_, image_, felt_, free_, search_, rest_, product_, turned_;
  double turn_ = 0;
  std::vector<Fixed> fixed_;
  std::vector<Pinned> pinned_;
};

}  // namespace animtool::ik
