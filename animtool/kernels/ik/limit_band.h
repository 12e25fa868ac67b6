// The inverse of a path's time band for joints at a limit, over the steps that the limit allows.
//
// Where limits fix directions of a joint in some frames, its degrees of freedom are coupled over
// time: blocks (W, W), up to two frames off the diagonal, factored as L D L^T. A pivot is inverted
// only over the directions that are free in its frame.
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
  // Factors the blocks of joints, by their first degree of freedom, that a limit fixes in a frame
  // from `first` to `end`; `fixed_of(t)` are the fixed directions of a frame.
  template <class FixedOf>
  void factor(const TimeBand& band, int first, int end, FixedOf&& fixed_of) {
    first_ = first, frame_count_ = std::max(end - first, 0);
    dofs_.clear();
    for (int t = first; t < end; ++t)
      for (const FixedDirection& fixed : fixed_of(t))
        if (fixed.width == W) dofs_.push_back(fixed.dof);
    std::sort(dofs_.begin(), dofs_.end());
    dofs_.erase(std::unique(dofs_.begin(), dofs_.end()), dofs_.end());
    recent_frames_.resize(dofs_.size());
    factors_.resize(dofs_.size() * static_cast<std::size_t>(frame_count_));
    right_hand_sides_.resize(dofs_.size());
    for (int i = 0; i < frame_count_; ++i) {
      for (RecentFrames& joint : recent_frames_) joint.free_projections[i % 3] = identity();
      for (const FixedDirection& fixed : fixed_of(first + i)) {
        if (fixed.width != W) continue;
        Square& free_projection = recent_frames_[index_of(fixed.dof)].free_projections[i % 3];
        for (int r = 0; r < W; ++r)
          for (int c = 0; c < W; ++c)
            free_projection[r * W + c] -= fixed.direction[r] * fixed.direction[c];
      }
      for (std::size_t j = 0; j < dofs_.size(); ++j)
        factor(band, i, recent_frames_[j], factors(i, j));
    }
  }

  // Solves as TimeBand does: `forward` for each frame with the right-hand side, then `backward`
  // from the last to the first frame; `store_row` before the `backward` of TimeBand.
  void forward(const double* right, double* x, int i, int width) const {
    const std::size_t row = static_cast<std::size_t>(first_ + i) * width;
    for (std::size_t j = 0; j < dofs_.size(); ++j) {
      const Factors& frame_factors = factors(i, j);
      const std::size_t index = row + dofs_[j];
      std::copy(right + index, right + index + W, x + index);
      if (i > 0) subtract(frame_factors.previous, x + index - width, x + index);
      if (i > 1)
        subtract(frame_factors.second_previous, x + index - 2 * static_cast<std::size_t>(width),
                 x + index);
    }
  }
  void store_row(const double* x, int i, int width) {
    const std::size_t row = static_cast<std::size_t>(first_ + i) * width;
    for (std::size_t j = 0; j < dofs_.size(); ++j)
      std::copy_n(x + row + dofs_[j], W, right_hand_sides_[j].begin());
  }
  void backward(double* x, int i, int width) const {
    const std::size_t row = static_cast<std::size_t>(first_ + i) * width;
    for (std::size_t j = 0; j < dofs_.size(); ++j) {
      double* out = x + row + dofs_[j];
      std::fill(out, out + W, 0.0);
      const FloatSquare& inverse = factors(i, j).inverse;
      for (int r = 0; r < W; ++r)
        for (int c = 0; c < W; ++c) out[r] += inverse[r * W + c] * right_hand_sides_[j][c];
      if (i + 1 < frame_count_) subtract_transposed(factors(i + 1, j).previous, out + width, out);
      if (i + 2 < frame_count_)
        subtract_transposed(factors(i + 2, j).second_previous,
                            out + 2 * static_cast<std::size_t>(width), out);
    }
  }

 private:
  using Square = std::array<double, W * W>;

  // L(t, t-1), L(t, t-2) and the inverse of D(t), as floats to save memory.
  using FloatSquare = std::array<float, W * W>;
  struct Factors {
    FloatSquare previous, second_previous, inverse;
  };
  // Matrices of a joint, by frame modulo 3: projections onto the free directions, L(t, t-1), and
  // inverses of D(t).
  struct RecentFrames {
    std::array<Square, 3> free_projections, previous, inverses;
  };

  static Square identity() {
    Square out{};
    for (int k = 0; k < W; ++k) out[k * W + k] = 1;
    return out;
  }

  static Square scale_square(double scale, Square a) {
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

  static FloatSquare to_float(const Square& a) {
    FloatSquare out;
    for (int k = 0; k < W * W; ++k) out[k] = static_cast<float>(a[k]);
    return out;
  }

  static void subtract(const FloatSquare& a, const double* v, double* out) {
    for (int r = 0; r < W; ++r)
      for (int c = 0; c < W; ++c) out[r] -= a[r * W + c] * v[c];
  }

  static void subtract_transposed(const FloatSquare& a, const double* v, double* out) {
    for (int r = 0; r < W; ++r)
      for (int c = 0; c < W; ++c) out[r] -= a[c * W + r] * v[c];
  }

  // The inverse of a symmetric matrix over the free directions. Fixed directions get a pivot, which
  // is subtracted again from the result.
  static Square inverse_of(Square a, const Square& free_projection, double pivot) {
    for (int r = 0; r < W; ++r)
      for (int c = 0; c < W; ++c) a[r * W + c] += pivot * ((r == c) - free_projection[r * W + c]);
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
      for (int c = 0; c < W; ++c) out[r * W + c] -= ((r == c) - free_projection[r * W + c]) / pivot;
    return out;
  }

  std::size_t index_of(int dof) const {
    return std::lower_bound(dofs_.begin(), dofs_.end(), dof) - dofs_.begin();
  }

  Factors& factors(int i, std::size_t j) { return factors_[i * dofs_.size() + j]; }
  const Factors& factors(int i, std::size_t j) const { return factors_[i * dofs_.size() + j]; }

  void factor(const TimeBand& band, int i, RecentFrames& recent_frames, Factors& out) const {
    const int t = first_ + i;
    const std::array<Square, 3>& free_projections = recent_frames.free_projections;
    const int current = i % 3, previous = (i + 2) % 3, second_previous = (i + 1) % 3;
    Square pivot = scale_square(band.entry(t, 0), free_projections[current]);
    Square far_block{}, near_block{};
    if (i > 1) {
      far_block = scale_square(
          band.entry(t, -2), product(free_projections[current], free_projections[second_previous]));
      const Square factor = product(far_block, recent_frames.inverses[second_previous]);
      subtract_product(factor, far_block, pivot);
      out.second_previous = to_float(factor);
    }
    if (i > 0) {
      near_block = scale_square(band.entry(t, -1),
                                product(free_projections[current], free_projections[previous]));
      if (i > 1) subtract_product(far_block, recent_frames.previous[previous], near_block);
      recent_frames.previous[current] = product(near_block, recent_frames.inverses[previous]);
      subtract_product(recent_frames.previous[current], near_block, pivot);
      out.previous = to_float(recent_frames.previous[current]);
    }
    // Symmetrises the pivot: rounding errors would grow from frame to frame.
    for (int r = 0; r < W; ++r)
      for (int c = 0; c < r; ++c)
        pivot[r * W + c] = pivot[c * W + r] = (pivot[r * W + c] + pivot[c * W + r]) / 2;
    recent_frames.inverses[current] =
        inverse_of(pivot, free_projections[current], band.entry(t, 0));
    out.inverse = to_float(recent_frames.inverses[current]);
  }

  int first_ = 0, frame_count_ = 0;
  std::vector<int> dofs_;
  std::vector<RecentFrames> recent_frames_;
  std::vector<Factors> factors_;  // (frames, joints)
  std::vector<std::array<double, W>> right_hand_sides_;
};

}  // namespace animtool::ik
