// The matrix of what a path costs over time, the same for each degree of freedom.
#pragma once

#include <algorithm>
#include <initializer_list>
#include <vector>

namespace animtool::ik {

struct PathWeights {
  double anchor, speed, acceleration;
};

// The matrix of the weights over time, factored: L D L^T with two diagonals below.
class TimeBand {
 public:
  TimeBand(int frames, int first, int end, const PathWeights& weights)
      : first_(first), count_(std::max(end - first, 0)), rows_(5 * std::max(frames, 1)),
        pivots_(count_), below_(2 * count_) {
    for (int t = 0; t < frames; ++t) row(t)[2] += weights.anchor;
    for (int t = 0; t + 1 < frames; ++t) add(t, {-1, 1}, weights.speed);
    for (int t = 0; t + 2 < frames; ++t) add(t, {1, -2, 1}, weights.acceleration);
    damp(0);
  }

  // Adds a multiple of the identity, in place of that before.
  void damp(double damping) {
    for (int t = 0; t < static_cast<int>(rows_.size()) / 5; ++t) row(t)[2] += damping - damping_;
    damping_ = damping;
    for (int i = 0; i < count_; ++i) {
      const double* own = row(first_ + i);
      double far = i > 1 ? own[0] : 0, near = i > 0 ? own[1] : 0, pivot = own[2];
      if (i > 1) {
        near -= far * below_[2 * (i - 1)];
        pivot -= far * far / pivots_[i - 2];
        far /= pivots_[i - 2];
      }
      if (i > 0) {
        pivot -= near * near / pivots_[i - 1];
        near /= pivots_[i - 1];
      }
      below_[2 * i] = near, below_[2 * i + 1] = far;
      pivots_[i] = pivot;
    }
  }

  // Of the matrix: row t, and the column that is so many frames off, at most two.
  double entry(int t, int off) const { return rows_[5 * t + 2 + off]; }

  // out = P x for frames of `width` numbers, all of them.
  void multiply(const std::vector<double>& x, int width, std::vector<double>& out) const {
    const int frames = static_cast<int>(x.size()) / std::max(width, 1);
    for (int i = 0; i < count_; ++i) {
      const int t = first_ + i;
      double* o = out.data() + static_cast<std::size_t>(t) * width;
      std::fill(o, o + width, 0.0);
      for (int k = std::max(t - 2, 0); k <= std::min(t + 2, frames - 1); ++k) {
        const double factor = rows_[5 * t + 2 + k - t];
        const double* from = x.data() + static_cast<std::size_t>(k) * width;
        for (int d = 0; d < width; ++d) o[d] += factor * from[d];
      }
    }
  }

  // Solves P x = b in place over the frames that may move.
  void solve(std::vector<double>& x, int width) const {
    const auto at = [&](int i) { return x.data() + static_cast<std::size_t>(first_ + i) * width; };
    for (int i = 1; i < count_; ++i)
      for (int k = 1; k <= std::min(i, 2); ++k) {
        const double factor = below_[2 * i + k - 1];
        double *own = at(i), *other = at(i - k);
        for (int d = 0; d < width; ++d) own[d] -= factor * other[d];
      }
    for (int i = count_; i-- > 0;) {
      double* own = at(i);
      for (int d = 0; d < width; ++d) own[d] /= pivots_[i];
      for (int k = 1; k <= std::min(count_ - 1 - i, 2); ++k) {
        const double factor = below_[2 * (i + k) + k - 1];
        const double* other = at(i + k);
        for (int d = 0; d < width; ++d) own[d] -= factor * other[d];
      }
    }
  }

 private:
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
  std::vector<double> rows_, pivots_, below_;
};

}  // namespace animtool::ik
