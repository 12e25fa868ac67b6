// Block-pentadiagonal systems over time: a full block (D, D) per frame, multiples of the
// identity in the blocks one and two frames off the diagonal.
#pragma once

#include <cstddef>
#include <vector>

#include "ik/linear.h"

namespace animtool::ik {

// The Cholesky factor of such a matrix. With L its blocks: U = L(t, t)^-T is kept, and
// N = L(t, t-1); L(t, t-2) is a multiple of U(t-2).
class BlockBand {
 public:
  explicit BlockBand(int width)
      : width_(width),
        square_(static_cast<std::size_t>(width) * width),
        factor_(square_),
        cross_(square_),
        lower_(square_),
        column_(width),
        part_(width) {}

  // Allocates the blocks of a number of frames; `factor` reads the lower triangle of each.
  void resize(int count) {
    count_ = count;
    diagonal_.resize(count * square_), inverse_.resize(count * square_),
        near_.resize(count * square_);
    off_.assign(2 * static_cast<std::size_t>(count), 0.0);
  }
  double* block(int t) { return diagonal_.data() + t * square_; }
  // Couplings of a frame with the previous frame, and with the one before that.
  void couple(int t, double one, double two) { off_[2 * t] = one, off_[2 * t + 1] = two; }

  // Returns false if the matrix is not positive definite.
  bool factor() {
    for (int t = 0; t < count_; ++t) {
      std::copy(block(t), block(t) + square_, factor_.begin());
      if (t > 1) take_square(inverse(t - 2), off_[2 * t + 1]);
      if (t > 0) {
        link(t);
        take_products(near(t));
      }
      if (!factor_cholesky(factor_.data(), column_.data(), width_)) return false;
      invert(inverse(t));
    }
    return true;
  }

  // Solves in place for `width` right-hand sides per frame.
  void solve(double* x) {
    for (int t = 0; t < count_; ++t) {
      double* row_t = x + static_cast<std::size_t>(t) * width_;
      if (t > 0) subtract(near(t), row_t - width_, row_t);
      if (t > 1) subtract_upper(inverse(t - 2), off_[2 * t + 1], row_t - 2 * width_, row_t);
      std::copy(row_t, row_t + width_, part_.begin());
      upper_transposed(inverse(t), 1, part_.data(), row_t, true);
    }
    for (int t = count_; t-- > 0;) {
      double* row_t = x + static_cast<std::size_t>(t) * width_;
      if (t + 1 < count_) subtract_transposed(near(t + 1), row_t + width_, row_t);
      if (t + 2 < count_)
        upper_transposed(inverse(t), -off_[2 * (t + 2) + 1], row_t + 2 * width_, row_t, false);
      std::copy(row_t, row_t + width_, part_.begin());
      std::fill(row_t, row_t + width_, 0.0);
      subtract_upper(inverse(t), -1, part_.data(), row_t);
    }
  }

 private:
  double* inverse(int t) { return inverse_.data() + t * square_; }
  double* near(int t) { return near_.data() + t * square_; }

  // factor_ -= scale^2 U U^T
  void take_square(const double* u, double scale) {
    for (int i = 0; i < width_; ++i)
      for (int j = 0; j <= i; ++j)
        factor_[i * width_ + j] -= scale * scale * inner(u + i * width_, u + j * width_, i, width_);
  }

  // factor_ -= N N^T
  void take_products(const double* n) {
    for (int i = 0; i < width_; ++i)
      for (int j = 0; j <= i; ++j)
        factor_[i * width_ + j] -= inner(n + i * width_, n + j * width_, 0, width_);
  }

  // N(t) = (one - two U(t-2) N(t-1)^T) U(t-1)
  void link(int t) {
    std::fill(cross_.begin(), cross_.end(), 0.0);
    for (int i = 0; i < width_; ++i) cross_[i * width_ + i] = off_[2 * t];
    if (t > 1) {
      const double *u = inverse(t - 2), *n = near(t - 1);
      const double two = off_[2 * t + 1];
      for (int i = 0; i < width_; ++i)
        for (int j = 0; j < width_; ++j)
          cross_[i * width_ + j] -= two * inner(u + i * width_, n + j * width_, i, width_);
    }
    const double* u = inverse(t - 1);
    double* out = near(t);
    std::fill(out, out + square_, 0.0);
    for (int i = 0; i < width_; ++i) {
      double* row = out + i * width_;
      for (int k = 0; k < width_; ++k) {
        const double by = cross_[i * width_ + k];
        if (by == 0) continue;
        const double* from = u + k * width_;
        for (int j = k; j < width_; ++j) row[j] += by * from[j];
      }
    }
  }

  // u <- L^-T of the factor, whose diagonal is stored inverted.
  void invert(double* u) {
    for (int i = 0; i < width_; ++i) {
      double* row = lower_.data() + i * width_;
      std::fill(row, row + width_, 0.0);
      row[i] = 1;
      for (int k = 0; k < i; ++k) {
        const double by = factor_[i * width_ + k];
        const double* other = lower_.data() + k * width_;
        for (int j = 0; j <= k; ++j) row[j] -= by * other[j];
      }
      for (int j = 0; j <= i; ++j) row[j] *= factor_[i * width_ + i];
    }
    for (int i = 0; i < width_; ++i)
      for (int j = 0; j < width_; ++j) u[i * width_ + j] = lower_[j * width_ + i];
  }

  // out -= A v
  void subtract(const double* a, const double* v, double* out) const {
    for (int i = 0; i < width_; ++i) out[i] -= inner(a + i * width_, v, 0, width_);
  }

  // out -= A^T v
  void subtract_transposed(const double* a, const double* v, double* out) const {
    for (int k = 0; k < width_; ++k)
      for (int j = 0; j < width_; ++j) out[j] -= v[k] * a[k * width_ + j];
  }

  // out -= scale U v
  void subtract_upper(const double* u, double scale, const double* v, double* out) const {
    for (int i = 0; i < width_; ++i) out[i] -= scale * inner(u + i * width_, v, i, width_);
  }

  // out += scale U^T v, or out = scale U^T v.
  void upper_transposed(const double* u, double scale, const double* v, double* out,
                        bool alone) const {
    if (alone) std::fill(out, out + width_, 0.0);
    for (int k = 0; k < width_; ++k)
      for (int j = k; j < width_; ++j) out[j] += scale * v[k] * u[k * width_ + j];
  }

  const int width_;
  const std::size_t square_;
  int count_ = 0;
  std::vector<double> diagonal_, inverse_, near_, off_;
  std::vector<double> factor_, cross_, lower_, column_, part_;
};

}  // namespace animtool::ik
