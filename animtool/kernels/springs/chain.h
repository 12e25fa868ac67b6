// Banded direct solver for chains, such as ropes and strands: symmetric positive 3 by 3
// blocks in a narrow band.
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

namespace animtool {

// Largest index distance of the ends of a spring: two for ropes that resist bending.
constexpr std::size_t MAX_CHAIN_WIDTH = 4;

// L D Lᵀ factor of a band matrix, row by row: `width_` entries left of the diagonal, then the
// diagonal.
class ChainFactor {
 public:
  // Clears the matrix; `max_distance` is the largest index distance of spring ends.
  void reset(std::size_t particles, std::size_t max_distance) {
    row_count_ = 3 * particles;
    width_ = 3 * max_distance + 2;
    band_.assign(row_count_ * (width_ + 1), 0.0);
  }

  // Adds to an entry; those above the diagonal are ignored.
  void add(std::size_t row, std::size_t column, double value) {
    if (column <= row) band_[row * (width_ + 1) + (column + width_ - row)] += value;
  }

  // Factors the matrix in place.
  void factor() {
    for (std::size_t i = 0; i < row_count_; ++i) {
      double* row = row_at(i);
      const std::size_t first = i > width_ ? i - width_ : 0;
      // Entries hold L D until they are divided.
      for (std::size_t j = first; j < i; ++j) {
        const double* other_row = row_at(j);
        const std::size_t first_shared_column = std::max(first, j > width_ ? j - width_ : 0);
        double sum = row[j + width_ - i];
        for (std::size_t k = first_shared_column; k < j; ++k)
          sum -= row[k + width_ - i] * other_row[k + width_ - j];
        row[j + width_ - i] = sum;
      }
      double pivot = row[width_];
      for (std::size_t j = first; j < i; ++j) {
        double& entry = row[j + width_ - i];
        const double quotient = entry * row_at(j)[width_];
        pivot -= entry * quotient;
        entry = quotient;
      }
      row[width_] = 1 / pivot;
    }
  }

  // Solves for a right-hand side in rows of particles with a stride.
  void solve(const std::vector<double>& in, std::vector<double>& out, std::size_t stride) {
    solution_.resize(row_count_);
    for (std::size_t i = 0; i < row_count_; ++i) {
      const double* row = row_at(i);
      double sum = in[i / 3 * stride + i % 3];
      for (std::size_t j = i > width_ ? i - width_ : 0; j < i; ++j)
        sum -= row[j + width_ - i] * solution_[j];
      solution_[i] = sum;
    }
    for (std::size_t i = 0; i < row_count_; ++i) solution_[i] *= row_at(i)[width_];
    for (std::size_t i = row_count_; i-- > 0;) {
      const double value = solution_[i];
      const double* row = row_at(i);
      for (std::size_t j = i > width_ ? i - width_ : 0; j < i; ++j)
        solution_[j] -= row[j + width_ - i] * value;
      out[i / 3 * stride + i % 3] = value;
    }
  }

 private:
  double* row_at(std::size_t i) { return band_.data() + i * (width_ + 1); }

  std::size_t row_count_ = 0, width_ = 0;
  std::vector<double> band_, solution_;
};

}  // namespace animtool
