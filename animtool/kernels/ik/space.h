// Null space of the goals and fixed limits of one frame of a path.
//
// A goal depends only on the joints above it. So its Jacobian J is stored as blocks of nonzero
// entries, and x is projected by subtracting J^T (J J^T)^-1 J x; orthonormal rows would be dense.
#pragma once

#include <cmath>
#include <vector>

#include "base/cholesky.h"
#include "ik/linear.h"
#include "ik/step.h"

namespace animtool::ik {

// Projects steps of one frame onto the null space of its goals and fixed limits.
class GoalSpace {
 public:
  // Buffers for the computation, one frame at a time.
  struct Buffers {
    std::vector<double> gram_matrix, residual, product, solution;
  };

  // Directions that limits fix, and the smallest step that satisfies these.
  std::vector<FixedDirection> fixed_directions;
  std::vector<Stepper::LimitFlags> limit_flags;
  std::vector<double> step;

  // Computes the null space from the goals' Jacobian by columns (D, M), which is modified.
  void update_null_space(int row_count, int width, std::vector<double>& jacobian,
                         Buffers& buffers) {
    const int m = row_count_ = row_count;
    buffers.gram_matrix.assign(static_cast<std::size_t>(m) * m, 0.0);
    buffers.residual.assign(m, 0.0);
    step.assign(width, 0.0);
    for (const FixedDirection& fixed_direction : fixed_directions) {
      double* columns = jacobian.data() + static_cast<std::size_t>(fixed_direction.dof) * m;
      for (int i = 0; i < m; ++i) {
        double component = 0;
        for (int k = 0; k < fixed_direction.width; ++k)
          component += columns[k * m + i] * fixed_direction.direction[k];
        for (int k = 0; k < fixed_direction.width; ++k)
          columns[k * m + i] -= component * fixed_direction.direction[k];
        buffers.residual[i] -= component * fixed_direction.value;
      }
      for (int k = 0; k < fixed_direction.width; ++k)
        step[fixed_direction.dof + k] += fixed_direction.value * fixed_direction.direction[k];
    }
    store_blocks(jacobian, width);
    for (const Block& block : blocks_) {
      const float* block_row = values_.data() + block.begin;
      const auto gram_entry = [&](int i, int j) -> double& {
        return buffers.gram_matrix[static_cast<std::size_t>(block.row + i) * m + block.row + j];
      };
      if (block.is_tall())
        for (int d = 0; d < block.columns; ++d, block_row += block.rows)
          for (int i = 0; i < block.rows; ++i)
            for (int j = 0; j <= i; ++j) gram_entry(i, j) += double{block_row[i]} * block_row[j];
      else
        for (int i = 0; i < block.rows; ++i)
          for (int j = 0; j <= i; ++j)
            gram_entry(i, j) +=
                inner(block_row + i * block.columns, block_row + j * block.columns, block.columns);
    }
    for (int i = 0; i < m; ++i) buffers.gram_matrix[i * m + i] += DAMPING;
    buffers.product.resize(m);
    cholesky::factor<cholesky::Inverses, cholesky::SmallPivot::IGNORE>(
        buffers.gram_matrix.data(), m, m, buffers.product.data(),
        [](std::size_t) { return DAMPING / 2; });
    invert(buffers);
    solve(buffers.residual, buffers);
    add_transposed(buffers.residual, 1, step.data());
  }

  // Projects x (D,) onto the null space of goals and limits.
  void project(double* x, Buffers& buffers) const {
    for (const FixedDirection& fixed_direction : fixed_directions) {
      double component = 0;
      for (int k = 0; k < fixed_direction.width; ++k)
        component += x[fixed_direction.dof + k] * fixed_direction.direction[k];
      for (int k = 0; k < fixed_direction.width; ++k)
        x[fixed_direction.dof + k] -= component * fixed_direction.direction[k];
    }
    buffers.product.assign(row_count_, 0.0);
    for (const Block& block : blocks_) {
      double* block_product = buffers.product.data() + block.row;
      const double* block_x = x + block.dof;
      const float* block_row = values_.data() + block.begin;
      if (block.is_tall())
        for (int d = 0; d < block.columns; ++d, block_row += block.rows)
          for (int i = 0; i < block.rows; ++i) block_product[i] += block_row[i] * block_x[d];
      else
        for (int i = 0; i < block.rows; ++i, block_row += block.columns)
          block_product[i] += inner(block_row, block_x, block.columns);
    }
    solve(buffers.product, buffers);
    add_transposed(buffers.product, -1, x);
  }

 private:
  // Damping of the Gram matrix of the goals, relative to rows of length 1.
  static constexpr double DAMPING = 1e-10;

  // Columns of the Jacobian, from `dof` on, that are 0 outside the same rows.
  struct Block {
    int dof, columns, row, rows;
    std::size_t begin;  // index of its values, which are contiguous along the longer side

    bool is_tall() const { return rows > columns; }
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

  // Stores the blocks of the Jacobian and their values, as floats: memory bandwidth counts, and
  // points are restored to their goals anyway.
  void store_blocks(const std::vector<double>& jacobian, int width) {
    blocks_.clear();
    std::size_t count = 0;
    for (int d = 0; d < width; ++d) {
      const double* column = jacobian.data() + static_cast<std::size_t>(d) * row_count_;
      int row = 0, end = row_count_;
      while (row < end && column[row] == 0) ++row;
      while (end > row && column[end - 1] == 0) --end;
      if (row == end) continue;
      const bool is_continued = !blocks_.empty() && blocks_.back().row == row &&
                                blocks_.back().rows == end - row &&
                                blocks_.back().dof + blocks_.back().columns == d;
      if (!is_continued) blocks_.push_back({d, 0, row, end - row, count});
      ++blocks_.back().columns;
      count += end - row;
    }
    values_.resize(count);
    float* value = values_.data();
    for (const Block& block : blocks_) {
      const auto entry = [&](int i, int d) {
        return jacobian[static_cast<std::size_t>(block.dof + d) * row_count_ + block.row + i];
      };
      if (block.is_tall())
        for (int d = 0; d < block.columns; ++d)
          for (int i = 0; i < block.rows; ++i) *value++ = static_cast<float>(entry(i, d));
      else
        for (int i = 0; i < block.rows; ++i)
          for (int d = 0; d < block.columns; ++d) *value++ = static_cast<float>(entry(i, d));
    }
  }

  // Computes inverse_, L^-1 of the factor in work.gram, row by row; 0 for rows that are ignored.
  void invert(Buffers& buffers) {
    const int m = row_count_;
    inverse_.resize(static_cast<std::size_t>(m) * (m + 1) / 2);
    double* row = inverse_.data();
    for (int i = 0; i < m; row += ++i) {
      const double* factor = &buffers.gram_matrix[static_cast<std::size_t>(i) * m];
      std::fill(row, row + i, 0.0);
      row[i] = 1;
      const double* other_row = inverse_.data();
      for (int k = 0; k < i; other_row += ++k)
        for (int j = 0; j <= k; ++j) row[j] -= factor[k] * other_row[j];
      for (int j = 0; j <= i; ++j) row[j] *= factor[i];
    }
  }

  // y (M,) <- (L L^T)^-1 y.
  void solve(std::vector<double>& y, Buffers& buffers) const {
    buffers.solution.assign(row_count_, 0.0);
    const double* row = inverse_.data();
    for (int i = 0; i < row_count_; row += ++i) {
      const double value = ik::inner(row, y.data(), 0, i + 1);
      for (int j = 0; j <= i; ++j) buffers.solution[j] += value * row[j];
    }
    y.swap(buffers.solution);
  }

  // Adds `scale` J^T y to x (D,).
  void add_transposed(const std::vector<double>& y, double scale, double* x) const {
    for (const Block& block : blocks_) {
      const double* block_y = y.data() + block.row;
      const float* block_row = values_.data() + block.begin;
      double* block_x = x + block.dof;
      if (block.is_tall()) {
        for (int d = 0; d < block.columns; ++d, block_row += block.rows)
          block_x[d] += scale * inner(block_row, block_y, block.rows);
        continue;
      }
      for (int i = 0; i < block.rows; ++i, block_row += block.columns) {
        const double factor = scale * block_y[i];
        for (int d = 0; d < block.columns; ++d) block_x[d] += factor * block_row[d];
      }
    }
  }

  int row_count_ = 0;
  std::vector<Block> blocks_;
  std::vector<float> values_;    // of the blocks
  std::vector<double> inverse_;  // L^-1 of the damped J J^T = L L^T, row by row
};

}  // namespace animtool::ik
