// The matrix of the quadratic cost of a path over time, the same for each degree of freedom.
#pragma once

#include <algorithm>
#include <cstddef>
#include <initializer_list>
#include <vector>

#include "ik/chain.h"

namespace animtool::ik {

struct PathWeights {
  double anchor, speed, acceleration;
};

// The matrix of the weights over time, factored: L D L^T with two diagonals below.
class TimeBand {
 public:
  TimeBand(int frames, int first, int end, const PathWeights& weights)
      : first_(first),
        count_(std::max(end - first, 0)),
        rows_(5 * std::max(frames, 1)),
        inverses_(count_),
        below_(2 * count_) {
    for (int t = 0; t < frames; ++t) row(t)[2] += weights.anchor;
    for (int t = 0; t + 1 < frames; ++t) add(t, {-1, 1}, weights.speed);
    for (int t = 0; t + 2 < frames; ++t) add(t, {1, -2, 1}, weights.acceleration);
    damp(0);
  }

  // Adds a multiple of the identity, replacing an earlier one.
  void damp(double damping) {
    for (int t = 0; t < static_cast<int>(rows_.size()) / 5; ++t) row(t)[2] += damping - damping_;
    damping_ = damping;
    for (int i = 0; i < count_; ++i) {
      const double* row_i = row(first_ + i);
      double far = i > 1 ? row_i[0] : 0, near = i > 0 ? row_i[1] : 0, pivot = row_i[2];
      if (i > 1) {
        near -= far * below_[2 * (i - 1)];
        pivot -= far * far * inverses_[i - 2];
        far *= inverses_[i - 2];
      }
      if (i > 0) {
        pivot -= near * near * inverses_[i - 1];
        near *= inverses_[i - 1];
      }
      below_[2 * i] = near, below_[2 * i + 1] = far;
      inverses_[i] = 1 / pivot;
    }
  }

  // Entry of the matrix: row t, and a column at most two frames off.
  double entry(int t, int off) const { return rows_[5 * t + 2 + off]; }

  // out = P x for frames of `width` numbers, all of them.
  void multiply(const std::vector<double>& x, int width, std::vector<double>& out) const {
    const int frames = static_cast<int>(x.size()) / std::max(width, 1);
    for (int i = 0; i < count_; ++i) {
      const int t = first_ + i;
      double* o = out.data() + static_cast<std::size_t>(t) * width;
      const double* near = x.data() + static_cast<std::size_t>(t) * width;
      const double* factors = &rows_[5 * t];
      if (t > 1 && t + 2 < frames) {
        const double *a = near - 2 * width, *b = near - width, *c = near + width;
        const double* e = near + 2 * width;
        for (int d = 0; d < width; ++d)
          o[d] = factors[0] * a[d] + factors[1] * b[d] + factors[2] * near[d] + factors[3] * c[d] +
                 factors[4] * e[d];
        continue;
      }
      std::fill(o, o + width, 0.0);
      for (int k = std::max(t - 2, 0); k <= std::min(t + 2, frames - 1); ++k)
        add(factors[2 + k - t], x.data() + static_cast<std::size_t>(k) * width, width, o);
    }
  }

  // The i-th of the frames that may move, of a vector of all.
  template <class Number>
  Number* of(Number* x, int i, int width) const {
    return x + static_cast<std::size_t>(first_ + i) * width;
  }

  // Solves P x = b in place over the frames that may move: `forward` for each of these, then
  // `backward` from the last to the first.
  void forward(double* x, int i, int width) const {
    double* row_i = of(x, i, width);
    const double near = below_[2 * i], far = below_[2 * i + 1];
    if (i < 2) {
      if (i > 0) add(-near, of(x, 0, width), width, row_i);
      return;
    }
    const double *a = row_i - width, *b = a - width;
    for (int d = 0; d < width; ++d) row_i[d] = row_i[d] - near * a[d] - far * b[d];
  }
  void backward(double* x, int i, int width) const {
    double* row_i = of(x, i, width);
    const double inverse = inverses_[i];
    if (i + 2 >= count_) {
      for (int d = 0; d < width; ++d) row_i[d] *= inverse;
      if (i + 1 < count_) add(-below_[2 * i + 2], of(x, i + 1, width), width, row_i);
      return;
    }
    const double near = below_[2 * i + 2], far = below_[2 * i + 5];
    const double *a = row_i + width, *b = a + width;
    for (int d = 0; d < width; ++d) row_i[d] = row_i[d] * inverse - near * a[d] - far * b[d];
  }

 private:
  static void add(double factor, const double* from, int width, double* to) {
    for (int d = 0; d < width; ++d) to[d] += factor * from[d];
  }

  double* row(int t) { return &rows_[5 * t]; }

  void add(int t, std::initializer_list<double> stencil, double weight) {
    int i = 0;
    for (const double a : stencil) {
      int j = 0;
      for (const double b : stencil) row(t + i)[2 + j - i] += weight * a * b, ++j;
      ++i;
    }
  }

  int first_, count_;
  double damping_ = 0;
  std::vector<double> rows_;
  std::vector<double> inverses_, below_;  // one over the pivots, and what is below them
};

// The cost of a path: its distance from another path, its speed and its acceleration.

// Sums anchor |q - anchor|^2 + speed |v|^2 + acceleration |a|^2, halved, over the frames. Of
// balls, differences are rotation vectors.
class PathCost {
 public:
  // Weight of the acceleration at each frame.
  std::vector<double> frame_costs;

  // `drifts` (F - 1, D) is the motion from frame to frame without cost; null for none.
  PathCost(const Chain& chain, int frames, const PathWeights& weights, const double* drifts)
      : chain_(chain),
        frames_(frames),
        width_(chain.dofs),
        weights_(weights),
        drifts_(drifts),
        away_(chain.dofs),
        zero_(chain.dofs, 0.0) {}

  // Returns the cost of a path (F, Q), and writes its gradient (F, D) if requested.
  double evaluate(const double* anchors, const double* q, std::vector<double>* slope = nullptr) {
    return evaluate(anchors, q, slope, 0, frames_);
  }

  // Likewise of what changes with the frames from `first` to `end`, and the gradient by these.
  double evaluate(const double* anchors, const double* q, std::vector<double>* slope, int first,
                  int end) {
    const std::size_t size = static_cast<std::size_t>(frames_) * width_;
    speeds_.resize(size), forces_.resize(size), frame_costs.resize(frames_);
    const int before = std::max(first - 1, 0), last = std::min(end, frames_ - 2);
    if (slope) {
      slope->resize(size);
      std::fill(slope->begin() + row(before), slope->begin() + row(std::min(end + 1, frames_)),
                0.0);
    }
    double cost = 0;
    for (int t = first; t < end && weights_.anchor > 0; ++t) {
      difference(chain_, anchors + at(t), q + at(t), away_.data());
      for (int d = 0; d < width_; ++d) {
        cost += weights_.anchor * away_[d] * away_[d] / 2;
        if (slope) (*slope)[row(t) + d] += weights_.anchor * away_[d];
      }
    }
    std::fill(frame_costs.begin() + before, frame_costs.begin() + std::min(end + 1, frames_), 0.0);
    for (int t = std::max(first - 2, 0); t <= last; ++t) {
      double *speed = speeds_.data() + row(t), *force = forces_.data() + row(t);
      difference(chain_, q + at(t), q + at(t + 1), speed);
      std::fill(force, force + width_, 0.0);
      if (t < first - 1) continue;
      const double* drift = drift_of(t);
      const double* drift_before = t > 0 ? drift_of(t - 1) : nullptr;
      const double speed_weight = t < end ? weights_.speed : 0;
      for (int d = 0; d < width_; ++d) {
        const double u = speed[d] - drift[d];
        cost += speed_weight * u * u / 2;
        force[d] += speed_weight * u;
        if (t == 0) continue;
        const double a = u - (speed[d - width_] - drift_before[d]);
        frame_costs[t] += weights_.acceleration * a * a / 2;
        force[d] += weights_.acceleration * a;
        force[d - width_] -= weights_.acceleration * a;
      }
    }
    for (int t = before; t <= last; ++t) cost += frame_costs[t];
    if (slope)
      for (int t = before; t < std::min(end, frames_ - 1); ++t) spread(t, *slope);
    return cost;
  }

 private:
  std::size_t at(int t) const { return static_cast<std::size_t>(t) * chain_.coordinates; }
  std::size_t row(int t) const { return static_cast<std::size_t>(t) * width_; }
  const double* drift_of(int t) const { return drifts_ ? drifts_ + row(t) : zero_.data(); }

  // The gradient by a motion between two frames contributes to both poses.
  void spread(int t, std::vector<double>& slope) const {
    const double *speed = speeds_.data() + row(t), *force = forces_.data() + row(t);
    double *now = slope.data() + row(t), *next = slope.data() + row(t + 1);
    for (const Node& node : chain_.nodes) {
      if (node.follows) continue;
      const int d = node.dof;
      double back[3] = {-force[d]}, on[3] = {force[d]};
      if (node.kind == Kind::BALL) {
        pull_back(speed + d, force + d, 1, on);
        pull_back(speed + d, force + d, -1, back);
        for (double& x : back) x = -x;
      }
      for (int k = 0; k < node.width(); ++k) now[d + k] += back[k], next[d + k] += on[k];
    }
  }

  const Chain& chain_;
  const int frames_, width_;
  const PathWeights weights_;
  const double* drifts_;
  std::vector<double> speeds_, forces_, away_, zero_;
};

}  // namespace animtool::ik
