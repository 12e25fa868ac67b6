// The inverse of a path's time band for joints on a limit, over the steps the limit allows.
//
// Where limits fix directions of a joint in some frames, its degrees of freedom are coupled over
// time: blocks (W, W) two frames off the diagonal, factored L D L^T. A pivot has an inverse over
// the directions that are free in its frame alone.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <vector>

#include "ik/limits.h"
#include "ik/path_cost.h"

namespace animtool::ik {

template <int W>
class LimitBand {
 public:
  // The joints, by their first degree of freedom, that a limit fixes in a frame from `first` to
  // `end`; `fixed_of(t)` are the fixed directions of a frame.
  template <class FixedOf>
  void factor(const TimeBand& band, int first, int end, FixedOf&& fixed_of) {
    first_ = first, count_ = std::max(end - first, 0);
    dofs_.clear();
    for (int t = first; t < end; ++t)
      for (const Fixed& one : fixed_of(t))
        if (one.width == W) dofs_.push_back(one.dof);
    std::sort(dofs_.begin(), dofs_.end());
    dofs_.erase(std::unique(dofs_.begin(), dofs_.end()), dofs_.end());
    recent_.resize(dofs_.size());
    factors_.resize(dofs_.size() * static_cast<std::size_t>(count_));
    kept_.resize(dofs_.size());
    for (int i = 0; i < count_; ++i) {
      for (Recent& joint : recent_) joint.free[i % 3] = identity();
      for (const Fixed& one : fixed_of(first + i)) {
        if (one.width != W) continue;
        Square& free = recent_[index_of(one.dof)].free[i % 3];
        for (int r = 0; r < W; ++r)
          for (int c = 0; c < W; ++c) free[r * W + c] -= one.direction[r] * one.direction[c];
      }
      for (std::size_t j = 0; j < dofs_.size(); ++j) factor(band, i, recent_[j], factors(i, j));
    }
  }

  // As of TimeBand: `forward` for each frame, with the right-hand side, then `backward` from the
  // last to the first; `keep` before that of TimeBand.
  void forward(const double* right, double* x, int i, int width) const {
    const std::size_t row = static_cast<std::size_t>(first_ + i) * width;
    for (std::size_t j = 0; j < dofs_.size(); ++j) {
      const Factors& own = factors(i, j);
      const std::size_t at = row + dofs_[j];
      std::copy(right + at, right + at + W, x + at);
      if (i > 0) subtract(own.near, x + at - width, x + at);
      if (i > 1) subtract(own.far, x + at - 2 * static_cast<std::size_t>(width), x + at);
    }
  }
  void keep(const double* x, int i, int width) {
    const std::size_t row = static_cast<std::size_t>(first_ + i) * width;
    for (std::size_t j = 0; j < dofs_.size(); ++j)
      std::copy_n(x + row + dofs_[j], W, kept_[j].begin());
  }
  void backward(double* x, int i, int width) const {
    const std::size_t row = static_cast<std::size_t>(first_ + i) * width;
    for (std::size_t j = 0; j < dofs_.size(); ++j) {
      double* out = x + row + dofs_[j];
      std::fill(out, out + W, 0.0);
      const Rounded& inverse = factors(i, j).inverse;
      for (int r = 0; r < W; ++r)
        for (int c = 0; c < W; ++c) out[r] += inverse[r * W + c] * kept_[j][c];
      if (i + 1 < count_) subtract_transposed(factors(i + 1, j).near, out + width, out);
      if (i + 2 < count_)
        subtract_transposed(factors(i + 2, j).far, out + 2 * static_cast<std::size_t>(width), out);
    }
  }

 private:
  using Square = std::array<double, W * W>;

  // L(t, t-1), L(t, t-2) and the inverse of D(t), rounded: the memory that they take counts.
  using Rounded = std::array<float, W * W>;
  struct Factors {
    Rounded near, far, inverse;
  };
  // Of a joint, by frame modulo 3: projections onto the free directions, L(t, t-1), inverses.
  struct Recent {
    std::array<Square, 3> free, near, inverse;
  };

  static Square identity() {
    Square out{};
    for (int k = 0; k < W; ++k) out[k * W + k] = 1;
    return out;
  }

  static Square scaled(double scale, Square a) {
    for (double& x : a) x *= scale;
    return a;
  }

  static Square product(const Square& a, const Square& b) {
    Square out{};
    for (int r = 0; r < W; ++r)
      for (int k = 0; k < W; ++k)
        for (int c = 0; c < W; ++c) out[r * W + c] += a[r * W + k] * b[k * W + c];
    return out;
  }

  // out -= a b^T
  static void subtract_product(const Square& a, const Square& b, Square& out) {
    for (int r = 0; r < W; ++r)
      for (int c = 0; c < W; ++c)
        for (int k = 0; k < W; ++k) out[r * W + c] -= a[r * W + k] * b[c * W + k];
  }

  static Rounded rounded(const Square& a) {
    Rounded out;
    for (int k = 0; k < W * W; ++k) out[k] = static_cast<float>(a[k]);
    return out;
  }

  static void subtract(const Rounded& a, const double* v, double* out) {
    for (int r = 0; r < W; ++r)
      for (int c = 0; c < W; ++c) out[r] -= a[r * W + c] * v[c];
  }

  static void subtract_transposed(const Rounded& a, const double* v, double* out) {
    for (int r = 0; r < W; ++r)
      for (int c = 0; c < W; ++c) out[r] -= a[c * W + r] * v[c];
  }

  // The inverse of a symmetric matrix over the free directions: those that are fixed count with a
  // pivot of their own, which is taken out again.
  static Square inverse_of(Square a, const Square& free, double pivot) {
    for (int r = 0; r < W; ++r)
      for (int c = 0; c < W; ++c) a[r * W + c] += pivot * ((r == c) - free[r * W + c]);
    Square out;
    if constexpr (W == 1) {
      out[0] = 1 / a[0];
    } else {
      static_assert(W == 3);
      for (int r = 0; r < 3; ++r)
        for (int c = 0; c < 3; ++c) {
          const int i = (c + 1) % 3, j = (c + 2) % 3, k = (r + 1) % 3, l = (r + 2) % 3;
          out[r * 3 + c] = a[i * 3 + k] * a[j * 3 + l] - a[i * 3 + l] * a[j * 3 + k];
        }
      const double det = a[0] * out[0] + a[1] * out[3] + a[2] * out[6];
      for (double& x : out) x /= det;
    }
    for (int r = 0; r < W; ++r)
      for (int c = 0; c < W; ++c) out[r * W + c] -= ((r == c) - free[r * W + c]) / pivot;
    return out;
  }

  std::size_t index_of(int dof) const {
    return std::lower_bound(dofs_.begin(), dofs_.end(), dof) - dofs_.begin();
  }

  Factors& factors(int i, std::size_t j) { return factors_[i * dofs_.size() + j]; }
  const Factors& factors(int i, std::size_t j) const { return factors_[i * dofs_.size() + j]; }

  void factor(const TimeBand& band, int i, Recent& joint, Factors& out) const {
    const int t = first_ + i;
    const std::array<Square, 3>& free = joint.free;
    const int now = i % 3, before = (i + 2) % 3, earlier = (i + 1) % 3;
    Square pivot = scaled(band.entry(t, 0), free[now]);
    Square far{}, near{};
    if (i > 1) {
      far = scaled(band.entry(t, -2), product(free[now], free[earlier]));
      const Square factor = product(far, joint.inverse[earlier]);
      subtract_product(factor, far, pivot);
      out.far = rounded(factor);
    }
    if (i > 0) {
      near = scaled(band.entry(t, -1), product(free[now], free[before]));
      if (i > 1) subtract_product(far, joint.near[before], near);
      joint.near[now] = product(near, joint.inverse[before]);
      subtract_product(joint.near[now], near, pivot);
      out.near = rounded(joint.near[now]);
    }
    // What rounding leaves unsymmetric would grow from frame to frame.
    for (int r = 0; r < W; ++r)
      for (int c = 0; c < r; ++c)
        pivot[r * W + c] = pivot[c * W + r] = (pivot[r * W + c] + pivot[c * W + r]) / 2;
    joint.inverse[now] = inverse_of(pivot, free[now], band.entry(t, 0));
    out.inverse = rounded(joint.inverse[now]);
  }

  int first_ = 0, count_ = 0;
  std::vector<int> dofs_;
  std::vector<Recent> recent_;
  std::vector<Factors> factors_;  // (frames, joints)
  std::vector<std::array<double, W>> kept_;
};

}  // namespace animtool::ik
