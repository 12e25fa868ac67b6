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
    std::vector<double> gram, missing, felt;
  };

  // Directions that limits fix, and the least step that serves these.
  std::vector<Fixed> fixed;
  std::vector<Stepper::Pinned> pinned;
  std::vector<double> step;

  // From the goals' Jacobian by columns (D, M), which is changed.
  void span(int rows_asked, int width, std::vector<double>& jacobian, Work& work) {
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
      for (int k = 0; k < one.width; ++k)
        step[one.dof + k] += one.value * one.direction[k];
    }
    keep(jacobian, width);
    for (const Block& block : blocks_)
      for (int i = 0; i < block.rows; ++i)
        for (int j = 0; j <= i; ++j)
          work.gram[static_cast<std::size_t>(block.row + i) * m + block.row + j] +=
              inner(row_of(block, i), row_of(block, j), 0, block.columns);
    for (int i = 0; i < m; ++i) work.gram[i * m + i] += DAMPING;
    work.felt.resize(m);
    cholesky::factor<cholesky::Inverses, cholesky::Small::IGNORE>(
        work.gram.data(), m, m, work.felt.data(), [](std::size_t) { return DAMPING / 2; });
    factor_.clear();
    for (int i = 0; i < m; ++i)
      factor_.insert(factor_.end(), &work.gram[i * m], &work.gram[i * m] + i + 1);
    solve(work.missing);
    spread(work.missing, 1, step.data());
  }

  // Projects x (D,) onto the null space of goals and limits.
  void project(double* x, Work& work) const {
    for (const Fixed& one : fixed) {
      double along = 0;
      for (int k = 0; k < one.width; ++k) along += x[one.dof + k] * one.direction[k];
      for (int k = 0; k < one.width; ++k) x[one.dof + k] -= along * one.direction[k];
    }
    work.felt.assign(rows_, 0.0);
    for (const Block& block : blocks_)
      for (int i = 0; i < block.rows; ++i)
        work.felt[block.row + i] += inner(row_of(block, i), x + block.dof, 0, block.columns);
    solve(work.felt);
    spread(work.felt, -1, x);
  }

 private:
  // Damping of the Gram matrix of the goals, relative to rows of length 1.
  static constexpr double DAMPING = 1e-10;

  // Columns of the Jacobian, from `dof` on, that are 0 outside the same rows.
  struct Block {
    int dof, columns, row, rows;
    std::size_t begin;  // of their values, a row after another
  };

  const double* row_of(const Block& block, int i) const {
    return values_.data() + block.begin + static_cast<std::size_t>(i) * block.columns;
  }

  // blocks_ and their values_ <- the Jacobian.
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
    double* value = values_.data();
    for (const Block& block : blocks_)
      for (int i = block.row; i < block.row + block.rows; ++i)
        for (int d = block.dof; d < block.dof + block.columns; ++d)
          *value++ = jacobian[static_cast<std::size_t>(d) * rows_ + i];
  }

  // y (M,) <- (L L^T)^-1 y.
  void solve(std::vector<double>& y) const {
    const auto row = [&](std::size_t i) { return factor_.data() + i * (i + 1) / 2; };
    cholesky::solve_forward<cholesky::Inverses>(row, rows_, y.data());
    cholesky::solve_backward<cholesky::Inverses>(row, rows_, y.data());
  }

  // x (D,) gains `times` J^T y.
  void spread(const std::vector<double>& y, double times, double* x) const {
    for (const Block& block : blocks_)
      for (int i = 0; i < block.rows; ++i) {
        const double* row = row_of(block, i);
        const double factor = times * y[block.row + i];
        double* to = x + block.dof;
        for (int d = 0; d < block.columns; ++d) to[d] += factor * row[d];
      }
  }

  int rows_ = 0;
  std::vector<Block> blocks_;
  std::vector<double> values_;  // of the blocks
  std::vector<double> factor_;  // L of J J^T, damped, its rows one after another
};

}  // namespace animtool::ik
