// Null space of the goals and fixed limits of one frame of a path.
//
// A goal feels the joints above it alone. So its Jacobian J is kept as blocks that are not
// zero, and x loses J^T (J J^T)^-1 J x: orthonormal rows would be full.
#pragma once

#include <cmath>
#include <vector>

#include "base/cholesky.h"
#include "ik/linear.h"
#include "ik/step.h"

namespace animtool::ik {

class GoalSpace {
 public:
  // Buffers for the computation, one frame at a time.
  struct Work {
    std::vector<double> gram, missing, coupled, served;
  };

  // Directions that limits fix, and the least step that serves these.
  std::vector<Fixed> fixed;
  std::vector<Stepper::AtLimit> at_limit;
  std::vector<double> step;

  // From the goals' Jacobian by columns (D, M), which is changed.
  void update_null_space(int rows_asked, int width, std::vector<double>& jacobian, Work& work) {
    const int m = rows_ = rows_asked;
    work.gram.assign(static_cast<std::size_t>(m) * m, 0.0);
    work.missing.assign(m, 0.0);
    step.assign(width, 0.0);
    for (const Fixed& one : fixed) {
      double* columns = jacobian.data() + static_cast<std::size_t>(one.dof) * m;
      for (int i = 0; i < m; ++i) {
        double along = 0;
        for (int k = 0; k < one.width; ++k) along += columns[k * m + i] * one.direction[k];
        for (int k = 0; k < one.width; ++k) columns[k * m + i] -= along * one.direction[k];
        work.missing[i] -= along * one.value;
      }
      for (int k = 0; k < one.width; ++k) step[one.dof + k] += one.value * one.direction[k];
    }
    keep(jacobian, width);
    for (const Block& block : blocks_) {
      const float* line = values_.data() + block.begin;
      const auto entry = [&](int i, int j) -> double& {
        return work.gram[static_cast<std::size_t>(block.row + i) * m + block.row + j];
      };
      if (block.tall())
        for (int d = 0; d < block.columns; ++d, line += block.rows)
          for (int i = 0; i < block.rows; ++i)
            for (int j = 0; j <= i; ++j) entry(i, j) += double{line[i]} * line[j];
      else
        for (int i = 0; i < block.rows; ++i)
          for (int j = 0; j <= i; ++j)
            entry(i, j) += inner(line + i * block.columns, line + j * block.columns, block.columns);
    }
    for (int i = 0; i < m; ++i) work.gram[i * m + i] += DAMPING;
    work.coupled.resize(m);
    cholesky::factor<cholesky::Inverses, cholesky::Small::IGNORE>(
        work.gram.data(), m, m, work.coupled.data(), [](std::size_t) { return DAMPING / 2; });
    invert(work);
    solve(work.missing, work);
    spread(work.missing, 1, step.data());
  }

  // Projects x (D,) onto the null space of goals and limits.
  void project(double* x, Work& work) const {
    for (const Fixed& one : fixed) {
      double along = 0;
      for (int k = 0; k < one.width; ++k) along += x[one.dof + k] * one.direction[k];
      for (int k = 0; k < one.width; ++k) x[one.dof + k] -= along * one.direction[k];
    }
    work.coupled.assign(rows_, 0.0);
    for (const Block& block : blocks_) {
      double* coupled = work.coupled.data() + block.row;
      const double* from = x + block.dof;
      const float* line = values_.data() + block.begin;
      if (block.tall())
        for (int d = 0; d < block.columns; ++d, line += block.rows)
          for (int i = 0; i < block.rows; ++i) coupled[i] += line[i] * from[d];
      else
        for (int i = 0; i < block.rows; ++i, line += block.columns)
          coupled[i] += inner(line, from, block.columns);
    }
    solve(work.coupled, work);
    spread(work.coupled, -1, x);
  }

 private:
  // Damping of the Gram matrix of the goals, relative to rows of length 1.
  static constexpr double DAMPING = 1e-10;

  // Columns of the Jacobian, from `dof` on, that are 0 outside the same rows.
  struct Block {
    int dof, columns, row, rows;
    std::size_t begin;  // of their values, along the longer side

    bool tall() const { return rows > columns; }
  };

  template <class Number>
  static double inner(const float* a, const Number* b, int count) {
    double sums[4] = {0, 0, 0, 0};
    int i = 0;
    for (; i + 4 <= count; i += 4)
      for (int n = 0; n < 4; ++n) sums[n] += double{a[i + n]} * b[i + n];
    for (; i < count; ++i) sums[0] += double{a[i]} * b[i];
    return (sums[0] + sums[1]) + (sums[2] + sums[3]);
  }

  // blocks_ and their values_ <- the Jacobian, rounded: the memory that is read counts, and points
  // are brought back to their goals anyway.
  void keep(const std::vector<double>& jacobian, int width) {
    blocks_.clear();
    std::size_t count = 0;
    for (int d = 0; d < width; ++d) {
      const double* column = jacobian.data() + static_cast<std::size_t>(d) * rows_;
      int row = 0, end = rows_;
      while (row < end && column[row] == 0) ++row;
      while (end > row && column[end - 1] == 0) --end;
      if (row == end) continue;
      const bool goes_on = !blocks_.empty() && blocks_.back().row == row &&
                           blocks_.back().rows == end - row &&
                           blocks_.back().dof + blocks_.back().columns == d;
      if (!goes_on) blocks_.push_back({d, 0, row, end - row, count});
      ++blocks_.back().columns;
      count += end - row;
    }
    values_.resize(count);
    float* value = values_.data();
    for (const Block& block : blocks_) {
      const auto at = [&](int i, int d) {
        return jacobian[static_cast<std::size_t>(block.dof + d) * rows_ + block.row + i];
      };
      if (block.tall())
        for (int d = 0; d < block.columns; ++d)
          for (int i = 0; i < block.rows; ++i) *value++ = static_cast<float>(at(i, d));
      else
        for (int i = 0; i < block.rows; ++i)
          for (int d = 0; d < block.columns; ++d) *value++ = static_cast<float>(at(i, d));
    }
  }

  // inverse_ <- L^-1 of the factor in work.gram, row by row: 0 for rows that count for nothing.
  void invert(Work& work) {
    const int m = rows_;
    inverse_.resize(static_cast<std::size_t>(m) * (m + 1) / 2);
    double* row = inverse_.data();
    for (int i = 0; i < m; row += ++i) {
      const double* factor = &work.gram[static_cast<std::size_t>(i) * m];
      std::fill(row, row + i, 0.0);
      row[i] = 1;
      const double* other = inverse_.data();
      for (int k = 0; k < i; other += ++k)
        for (int j = 0; j <= k; ++j) row[j] -= factor[k] * other[j];
      for (int j = 0; j <= i; ++j) row[j] *= factor[i];
    }
  }

  // y (M,) <- (L L^T)^-1 y.
  void solve(std::vector<double>& y, Work& work) const {
    work.served.assign(rows_, 0.0);
    const double* row = inverse_.data();
    for (int i = 0; i < rows_; row += ++i) {
      const double value = ik::inner(row, y.data(), 0, i + 1);
      for (int j = 0; j <= i; ++j) work.served[j] += value * row[j];
    }
    y.swap(work.served);
  }

  // x (D,) gains `times` J^T y.
  void spread(const std::vector<double>& y, double times, double* x) const {
    for (const Block& block : blocks_) {
      const double* from = y.data() + block.row;
      const float* line = values_.data() + block.begin;
      double* to = x + block.dof;
      if (block.tall()) {
        for (int d = 0; d < block.columns; ++d, line += block.rows)
          to[d] += times * inner(line, from, block.rows);
        continue;
      }
      for (int i = 0; i < block.rows; ++i, line += block.columns) {
        const double factor = times * from[i];
        for (int d = 0; d < block.columns; ++d) to[d] += factor * line[d];
      }
    }
  }

  int rows_ = 0;
  std::vector<Block> blocks_;
  std::vector<float> values_;    // of the blocks
  std::vector<double> inverse_;  // L^-1 of J J^T = L L^T, damped, its rows one after another
};

}  // namespace animtool::ik
