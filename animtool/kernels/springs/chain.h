// Banded direct solver for chains, such as ropes and strands: symmetric positive 3 by 3
// blocks in a narrow band.
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

namespace animtool {

// Largest index distance of spring ends: two for ropes that resist bending.
constexpr std::size_t WIDEST_CHAIN = 4;

// L D Lᵀ of a band, row by row: `width_` entries left of the diagonal, then the diagonal.
class ChainFactor {
 public:
  // `reach` is the largest index distance of spring ends.
  void begin(std::size_t particles, std::size_t reach) {
    rows_ = 3 * particles;
    width_ = 3 * reach + 2;
    band_.assign(rows_ * (width_ + 1), 0.0);
  }

  // Adds to an entry; those above the diagonal are ignored.
  void add(std::size_t row, std::size_t column, double value) {
    if (column <= row) band_[row * (width_ + 1) + (column + width_ - row)] += value;
  }

  void factor() {
    for (std::size_t i = 0; i < rows_; ++i) {
      double* row = at(i);
      const std::size_t first = i > width_ ? i - width_ : 0;
      // Entries are L D until they are divided.
      for (std::size_t j = first; j < i; ++j) {
        const double* other = at(j);
        const std::size_t from = std::max(first, j > width_ ? j - width_ : 0);
        double sum = row[j + width_ - i];
        for (std::size_t k = from; k < j; ++k) sum -= row[k + width_ - i] * other[k + width_ - j];
        row[j + width_ - i] = sum;
      }
      double pivot = row[width_];
      for (std::size_t j = first; j < i; ++j) {
        double& entry = row[j + width_ - i];
        const double over = entry * at(j)[width_];
        pivot -= entry * over;
        entry = over;
      }
      row[width_] = 1 / pivot;
    }
  }

  // Solves for rows of particles with a stride.
  void solve(const std::vector<double>& in, std::vector<double>& out, std::size_t stride) {
    right_.resize(rows_);
    for (std::size_t i = 0; i < rows_; ++i) {
      const double* row = at(i);
      double sum = in[i / 3 * stride + i % 3];
      for (std::size_t j = i > width_ ? i - width_ : 0; j < i; ++j)
        sum -= row[j + width_ - i] * right_[j];
      right_[i] = sum;
    }
    for (std::size_t i = 0; i < rows_; ++i) right_[i] *= at(i)[width_];
    for (std::size_t i = rows_; i-- > 0;) {
      const double value = right_[i];
      const double* row = at(i);
      for (std::size_t j = i > width_ ? i - width_ : 0; j < i; ++j)
        right_[j] -= row[j + width_ - i] * value;
      out[i / 3 * stride + i % 3] = value;
    }
  }

 private:
  double* at(std::size_t i) { return band_.data() + i * (width_ + 1); }

  std::size_t rows_ = 0, width_ = 0;
  std::vector<double> band_, right_;
};

}  // namespace animtool
