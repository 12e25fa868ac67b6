// Block-pentadiagonal systems over time: a full block (D, D) per frame, and multiples of the
// identity in the blocks one and two frames off the diagonal.
#pragma once

#include <cstddef>
#include <vector>

#include "ik/linear.h"

namespace animtool::ik {

// The Cholesky factor of such a matrix. L are its blocks; U = L(t, t)^-T and N = L(t, t-1) are
// stored; L(t, t-2) is a multiple of U(t-2).
class BlockBand {
 public:
  explicit BlockBand(int width)
      : width_(width),
        block_size_(static_cast<std::size_t>(width) * width),
        factor_(block_size_),
        cross_(block_size_),
        lower_(block_size_),
        column_(width),
        buffer_(width) {}

  // Allocates the blocks of a number of frames; `factor` reads the lower triangle of each diagonal
  // block.
  void resize(int count) {
    frame_count_ = count;
    diagonal_.resize(count * block_size_), inverse_.resize(count * block_size_),
        lower_blocks_.resize(count * block_size_);
    couplings_.assign(2 * static_cast<std::size_t>(count), 0.0);
  }
  double* block(int t) { return diagonal_.data() + t * block_size_; }
  // Sets the couplings of a frame with the previous frame, and with the one before that.
  void set_couplings(int t, double previous, double second_previous) {
    couplings_[2 * t] = previous, couplings_[2 * t + 1] = second_previous;
  }

  // Factors the matrix; returns false if it is not positive definite.
  bool factor() {
    for (int t = 0; t < frame_count_; ++t) {
      std::copy(block(t), block(t) + block_size_, factor_.begin());
      if (t > 1) subtract_square(inverse(t - 2), couplings_[2 * t + 1]);
      if (t > 0) {
        compute_lower_block(t);
        subtract_products(lower_block(t));
      }
      if (!factor_cholesky(factor_.data(), column_.data(), width_)) return false;
      invert(inverse(t));
    }
    return true;
  }

  // Solves in place for right-hand sides (count, D).
  void solve(double* x) {
    for (int t = 0; t < frame_count_; ++t) {
      double* row_t = x + static_cast<std::size_t>(t) * width_;
      if (t > 0) subtract(lower_block(t), row_t - width_, row_t);
      if (t > 1) subtract_upper(inverse(t - 2), couplings_[2 * t + 1], row_t - 2 * width_, row_t);
      std::copy(row_t, row_t + width_, buffer_.begin());
      multiply_upper_transposed(inverse(t), 1, buffer_.data(), row_t, true);
    }
    for (int t = frame_count_; t-- > 0;) {
      double* row_t = x + static_cast<std::size_t>(t) * width_;
      if (t + 1 < frame_count_) subtract_transposed(lower_block(t + 1), row_t + width_, row_t);
      if (t + 2 < frame_count_)
        multiply_upper_transposed(inverse(t), -couplings_[2 * (t + 2) + 1], row_t + 2 * width_,
                                  row_t, false);
      std::copy(row_t, row_t + width_, buffer_.begin());
      std::fill(row_t, row_t + width_, 0.0);
      subtract_upper(inverse(t), -1, buffer_.data(), row_t);
    }
  }

 private:
  double* inverse(int t) { return inverse_.data() + t * block_size_; }
  double* lower_block(int t) { return lower_blocks_.data() + t * block_size_; }

  // factor_ -= scale^2 U U^T
  void subtract_square(const double* u, double scale) {
    for (int i = 0; i < width_; ++i)
      for (int j = 0; j <= i; ++j)
        factor_[i * width_ + j] -= scale * scale * inner(u + i * width_, u + j * width_, i, width_);
  }

  // factor_ -= N N^T
  void subtract_products(const double* n) {
    for (int i = 0; i < width_; ++i)
      for (int j = 0; j <= i; ++j)
        factor_[i * width_ + j] -= inner(n + i * width_, n + j * width_, 0, width_);
  }

  // N(t) = (previous - second_previous U(t-2) N(t-1)^T) U(t-1)
  void compute_lower_block(int t) {
    std::fill(cross_.begin(), cross_.end(), 0.0);
    for (int i = 0; i < width_; ++i) cross_[i * width_ + i] = couplings_[2 * t];
    if (t > 1) {
      const double *u = inverse(t - 2), *n = lower_block(t - 1);
      const double second_previous = couplings_[2 * t + 1];
      for (int i = 0; i < width_; ++i)
        for (int j = 0; j < width_; ++j)
          cross_[i * width_ + j] -=
              second_previous * inner(u + i * width_, n + j * width_, i, width_);
    }
    const double* u = inverse(t - 1);
    double* out = lower_block(t);
    std::fill(out, out + block_size_, 0.0);
    for (int i = 0; i < width_; ++i) {
      double* row = out + i * width_;
      for (int k = 0; k < width_; ++k) {
        const double scale = cross_[i * width_ + k];
        if (scale == 0) continue;
        const double* u_row = u + k * width_;
        for (int j = k; j < width_; ++j) row[j] += scale * u_row[j];
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
        const double scale = factor_[i * width_ + k];
        const double* other_row = lower_.data() + k * width_;
        for (int j = 0; j <= k; ++j) row[j] -= scale * other_row[j];
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

  // out += scale U^T v, or out = scale U^T v with `overwrites`.
  void multiply_upper_transposed(const double* u, double scale, const double* v, double* out,
                                 bool overwrites) const {
    if (overwrites) std::fill(out, out + width_, 0.0);
    for (int k = 0; k < width_; ++k)
      for (int j = k; j < width_; ++j) out[j] += scale * v[k] * u[k * width_ + j];
  }

  const int width_;
  const std::size_t block_size_;
  int frame_count_ = 0;
  std::vector<double> diagonal_, inverse_, lower_blocks_, couplings_;
  std::vector<double> factor_, cross_, lower_, column_, buffer_;
};

}  // namespace animtool::ik
