// Null space of the goals and fixed limits of one frame of a path.
#pragma once

#include <cmath>
#include <vector>

#include "base/cholesky.h"
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
    width_ = width;
    work.gram.assign(static_cast<std::size_t>(m) * m, 0.0);
    work.missing.assign(m, 0.0);
    step.assign(width_, 0.0);
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
    basis_.resize(static_cast<std::size_t>(m) * width_);
    for (int d = 0; d < width_; ++d) {
      const double* column = jacobian.data() + static_cast<std::size_t>(d) * m;
      for (int i = 0; i < m; ++i) {
        basis_[static_cast<std::size_t>(i) * width_ + d] = column[i];
        if (column[i] == 0) continue;
        double* row = &work.gram[static_cast<std::size_t>(i) * m];
        for (int j = 0; j <= i; ++j) row[j] += column[i] * column[j];
      }
    }
    orthonormalize(work);
  }

  // Projects x (D,) onto the null space of goals and limits.
  void project(double* x, Work& work) const {
    for (const Fixed& one : fixed) {
      double along = 0;
      for (int k = 0; k < one.width; ++k) along += x[one.dof + k] * one.direction[k];
      for (int k = 0; k < one.width; ++k) x[one.dof + k] -= along * one.direction[k];
    }
    const double* rows = basis_.data();
    work.felt.resize(rows_);
    for (int i = 0; i < rows_; ++i) work.felt[i] = inner(rows + i * width_, x, 0, width_);
    for (int i = 0; i < rows_; ++i) {
      const double* row = rows + i * width_;
      const double along = work.felt[i];
      for (int d = 0; d < width_; ++d) x[d] -= along * row[d];
    }
  }

 private:
  // Damping of the Gram matrix of the goals, relative to rows of length 1.
  static constexpr double DAMPING = 1e-10;

  // basis_ <- L^-1 basis_, where L L^T is the damped Gram matrix.
  void orthonormalize(Work& work) {
    using namespace cholesky;
    const int m = rows_;
    double* gram = work.gram.data();
    for (int i = 0; i < m; ++i) gram[i * m + i] += DAMPING;
    work.felt.resize(m);
    factor<Inverses, Small::COUNTS_FOR_NOTHING>(gram, m, m, work.felt.data(),
                                                [](std::size_t) { return DAMPING / 2; });
    solve_forward<Inverses>(Rows{gram, static_cast<std::size_t>(m)}, m, work.missing.data());
    for (int i = 0; i < m; ++i) {
      const double* row_i = gram + static_cast<std::size_t>(i) * m;
      double* row = basis_.data() + static_cast<std::size_t>(i) * width_;
      for (int j = 0; j < i; ++j) {
        const double* done = basis_.data() + static_cast<std::size_t>(j) * width_;
        for (int d = 0; d < width_; ++d) row[d] -= row_i[j] * done[d];
      }
      for (int d = 0; d < width_; ++d) row[d] *= row_i[i];
      for (int d = 0; d < width_; ++d) step[d] += work.missing[i] * row[d];
    }
  }

  int rows_ = 0, width_ = 0;
  // Orthonormal basis (M, D) of the goals' rows in the directions that are not fixed.
  std::vector<double> basis_;
};

}  // namespace animtool::ik
