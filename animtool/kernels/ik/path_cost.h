// The quadratic cost of a path over time, and its matrix, which is the same for each degree of
// freedom.
#pragma once

#include <algorithm>
#include <cstddef>
#include <initializer_list>
#include <vector>

#include "ik/chain.h"

namespace animtool::ik {

// Weights of the distance from an anchor path, of the speed, and of the acceleration.
struct PathWeights {
  double anchor, speed, acceleration;
};

// The matrix of the cost over time, factored as L D L^T with two diagonals below the main one.
class TimeBand {
 public:
  TimeBand(int frame_count, int first, int end, const PathWeights& weights)
      : first_(first),
        frame_count_(std::max(end - first, 0)),
        band_rows_(5 * std::max(frame_count, 1)),
        inverse_pivots_(frame_count_),
        lower_diagonals_(2 * frame_count_) {
    for (int t = 0; t < frame_count; ++t) row(t)[2] += weights.anchor;
    for (int t = 0; t + 1 < frame_count; ++t) add_stencil(t, {-1, 1}, weights.speed);
    for (int t = 0; t + 2 < frame_count; ++t) add_stencil(t, {1, -2, 1}, weights.acceleration);
    set_damping(0);
  }

  // Adds a multiple of the identity; replaces an earlier one.
  void set_damping(double damping) {
    for (int t = 0; t < static_cast<int>(band_rows_.size()) / 5; ++t)
      row(t)[2] += damping - damping_;
    damping_ = damping;
    for (int i = 0; i < frame_count_; ++i) {
      const double* row_i = row(first_ + i);
      double second_lower = i > 1 ? row_i[0] : 0, first_lower = i > 0 ? row_i[1] : 0,
             pivot = row_i[2];
      if (i > 1) {
        first_lower -= second_lower * lower_diagonals_[2 * (i - 1)];
        pivot -= second_lower * second_lower * inverse_pivots_[i - 2];
        second_lower *= inverse_pivots_[i - 2];
      }
      if (i > 0) {
        pivot -= first_lower * first_lower * inverse_pivots_[i - 1];
        first_lower *= inverse_pivots_[i - 1];
      }
      lower_diagonals_[2 * i] = first_lower, lower_diagonals_[2 * i + 1] = second_lower;
      inverse_pivots_[i] = 1 / pivot;
    }
  }

  // Entry of the matrix in row t, in the column `offset` frames from t, at most two.
  double entry(int t, int offset) const { return band_rows_[5 * t + 2 + offset]; }

  // out = P x, for frames of `width` numbers; x has all frames.
  void multiply(const std::vector<double>& x, int width, std::vector<double>& out) const {
    const int frame_count = static_cast<int>(x.size()) / std::max(width, 1);
    for (int i = 0; i < frame_count_; ++i) {
      const int t = first_ + i;
      double* product = out.data() + static_cast<std::size_t>(t) * width;
      const double* row_t = x.data() + static_cast<std::size_t>(t) * width;
      const double* entries = &band_rows_[5 * t];
      if (t > 1 && t + 2 < frame_count) {
        const double *second_previous = row_t - 2 * width, *previous = row_t - width,
                     *next = row_t + width;
        const double* second_next = row_t + 2 * width;
        for (int d = 0; d < width; ++d)
          product[d] = entries[0] * second_previous[d] + entries[1] * previous[d] +
                       entries[2] * row_t[d] + entries[3] * next[d] + entries[4] * second_next[d];
        continue;
      }
      std::fill(product, product + width, 0.0);
      for (int k = std::max(t - 2, 0); k <= std::min(t + 2, frame_count - 1); ++k)
        add_scaled(entries[2 + k - t], x.data() + static_cast<std::size_t>(k) * width, width,
                   product);
    }
  }

  // Row of the i-th frame that may change, in an array of all frames.
  template <class Number>
  Number* row_of(Number* x, int i, int width) const {
    return x + static_cast<std::size_t>(first_ + i) * width;
  }

  // Solves P x = b in place over the frames that may change: `forward` for each frame, then
  // `backward` from the last to the first.
  void forward(double* x, int i, int width) const {
    double* row_i = row_of(x, i, width);
    const double first_lower = lower_diagonals_[2 * i], second_lower = lower_diagonals_[2 * i + 1];
    if (i < 2) {
      if (i > 0) add_scaled(-first_lower, row_of(x, 0, width), width, row_i);
      return;
    }
    const double *previous = row_i - width, *second_previous = previous - width;
    for (int d = 0; d < width; ++d)
      row_i[d] = row_i[d] - first_lower * previous[d] - second_lower * second_previous[d];
  }
  void backward(double* x, int i, int width) const {
    double* row_i = row_of(x, i, width);
    const double inverse = inverse_pivots_[i];
    if (i + 2 >= frame_count_) {
      for (int d = 0; d < width; ++d) row_i[d] *= inverse;
      if (i + 1 < frame_count_)
        add_scaled(-lower_diagonals_[2 * i + 2], row_of(x, i + 1, width), width, row_i);
      return;
    }
    const double first_lower = lower_diagonals_[2 * i + 2],
                 second_lower = lower_diagonals_[2 * i + 5];
    const double *next = row_i + width, *second_next = next + width;
    for (int d = 0; d < width; ++d)
      row_i[d] = row_i[d] * inverse - first_lower * next[d] - second_lower * second_next[d];
  }

 private:
  static void add_scaled(double factor, const double* from, int width, double* to) {
    for (int d = 0; d < width; ++d) to[d] += factor * from[d];
  }

  double* row(int t) { return &band_rows_[5 * t]; }

  // Adds the square of a finite difference, with a weight.
  void add_stencil(int t, std::initializer_list<double> stencil, double weight) {
    int i = 0;
    for (const double a : stencil) {
      int j = 0;
      for (const double b : stencil) row(t + i)[2 + j - i] += weight * a * b, ++j;
      ++i;
    }
  }

  int first_, frame_count_;
  double damping_ = 0;
  std::vector<double> band_rows_;
  std::vector<double> inverse_pivots_,
      lower_diagonals_;  // reciprocal pivots, and the two diagonals below
};

// Half the sum over the frames of anchor |q - anchor|^2 + speed |v|^2 + acceleration |a|^2.
// Differences of balls are rotation vectors.
class PathCost {
 public:
  // Cost of the acceleration at each frame.
  std::vector<double> frame_costs;

  // `drifts` (F - 1, D) is the motion between frames that costs nothing; null for none.
  PathCost(const Chain& chain, int frame_count, const PathWeights& weights, const double* drifts)
      : chain_(chain),
        frame_count_(frame_count),
        dof_count_(chain.dof_count),
        weights_(weights),
        drifts_(drifts),
        difference_(chain.dof_count),
        zero_drift_(chain.dof_count, 0.0) {}

  // Returns the cost of a path (F, Q), and computes its gradient (F, D) if requested.
  double evaluate(const double* anchors, const double* q, std::vector<double>* gradient = nullptr) {
    return evaluate(anchors, q, gradient, 0, frame_count_);
  }

  // The same, for the terms that depend on the frames from `first` to `end`, and the gradient by
  // these frames.
  double evaluate(const double* anchors, const double* q, std::vector<double>* gradient, int first,
                  int end) {
    const std::size_t size = static_cast<std::size_t>(frame_count_) * dof_count_;
    velocities_.resize(size), forces_.resize(size), frame_costs.resize(frame_count_);
    const int first_affected = std::max(first - 1, 0),
              last_affected = std::min(end, frame_count_ - 2);
    if (gradient) {
      gradient->resize(size);
      std::fill(gradient->begin() + row(first_affected),
                gradient->begin() + row(std::min(end + 1, frame_count_)), 0.0);
    }
    double cost = 0;
    for (int t = first; t < end && weights_.anchor > 0; ++t) {
      difference(chain_, anchors + pose_offset(t), q + pose_offset(t), difference_.data());
      for (int d = 0; d < dof_count_; ++d) {
        cost += weights_.anchor * difference_[d] * difference_[d] / 2;
        if (gradient) (*gradient)[row(t) + d] += weights_.anchor * difference_[d];
      }
    }
    std::fill(frame_costs.begin() + first_affected,
              frame_costs.begin() + std::min(end + 1, frame_count_), 0.0);
    for (int t = std::max(first - 2, 0); t <= last_affected; ++t) {
      double *velocity = velocities_.data() + row(t), *force = forces_.data() + row(t);
      difference(chain_, q + pose_offset(t), q + pose_offset(t + 1), velocity);
      std::fill(force, force + dof_count_, 0.0);
      if (t < first - 1) continue;
      const double* drift = drift_of(t);
      const double* drift_before = t > 0 ? drift_of(t - 1) : nullptr;
      const double speed_weight = t < end ? weights_.speed : 0;
      for (int d = 0; d < dof_count_; ++d) {
        const double excess = velocity[d] - drift[d];
        cost += speed_weight * excess * excess / 2;
        force[d] += speed_weight * excess;
        if (t == 0) continue;
        const double acceleration = excess - (velocity[d - dof_count_] - drift_before[d]);
        frame_costs[t] += weights_.acceleration * acceleration * acceleration / 2;
        force[d] += weights_.acceleration * acceleration;
        force[d - dof_count_] -= weights_.acceleration * acceleration;
      }
    }
    for (int t = first_affected; t <= last_affected; ++t) cost += frame_costs[t];
    if (gradient)
      for (int t = first_affected; t < std::min(end, frame_count_ - 1); ++t)
        add_gradient(t, *gradient);
    return cost;
  }

 private:
  std::size_t pose_offset(int t) const {
    return static_cast<std::size_t>(t) * chain_.coordinate_count;
  }
  std::size_t row(int t) const { return static_cast<std::size_t>(t) * dof_count_; }
  const double* drift_of(int t) const { return drifts_ ? drifts_ + row(t) : zero_drift_.data(); }

  // Adds the gradient by a motion between two frames to the gradients of both poses.
  void add_gradient(int t, std::vector<double>& gradient) const {
    const double *velocity = velocities_.data() + row(t), *force = forces_.data() + row(t);
    double *start_gradient = gradient.data() + row(t), *end_gradient = gradient.data() + row(t + 1);
    for (const Node& node : chain_.nodes) {
      if (node.is_driven) continue;
      const int d = node.dof;
      double start_force[3] = {-force[d]}, end_force[3] = {force[d]};
      if (node.kind == Kind::BALL) {
        pull_back(velocity + d, force + d, 1, end_force);
        pull_back(velocity + d, force + d, -1, start_force);
        for (double& x : start_force) x = -x;
      }
      for (int k = 0; k < node.dof_count(); ++k)
        start_gradient[d + k] += start_force[k], end_gradient[d + k] += end_force[k];
    }
  }

  const Chain& chain_;
  const int frame_count_, dof_count_;
  const PathWeights weights_;
  const double* drifts_;
  std::vector<double> velocities_, forces_, difference_, zero_drift_;
};

}  // namespace animtool::ik
