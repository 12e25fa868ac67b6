// Cholesky factor of a symmetric matrix, and solves with it.
//
// All factors subtract products in the same order, so that results differ only by how pivots are
// stored. Factors of band matrices take no square root of a pivot, which rounds differently, and
// so do not use this header: springs/chain.h multiplies by reciprocal pivots, and ik/path_cost.h
// divides by pivots.
#pragma once

#include <cmath>
#include <cstddef>

namespace animtool::cholesky {

// What is stored on the diagonal of a factor: the square root of a pivot, or its reciprocal, which
// makes solves faster; and the value stored for a pivot that is ignored.
struct Roots {
  static constexpr double IGNORED = HUGE_VAL;
  static double of(double pivot) { return std::sqrt(pivot); }
  static double divide(double value, double stored) { return value / stored; }
};
struct Inverses {
  static constexpr double IGNORED = 0;
  static double of(double pivot) { return 1 / std::sqrt(pivot); }
  static double divide(double value, double stored) { return value * stored; }
};

enum class Small { FAIL, IGNORE };

// Factors a matrix (n, n) in place, reading and overwriting the lower triangle. Returns false if
// pivot k is not above `least(k)`. Works by columns, so that the inner loops run over contiguous
// memory; `column` is a buffer for n numbers.
template <class Form, Small SMALL, class MinPivot>
bool factor(double* a, std::size_t n, std::size_t stride, double* column, MinPivot min_pivot) {
  for (std::size_t j = 0; j < n; ++j) {
    double stored = Form::IGNORED;
    const double pivot = a[j * stride + j];
    if (pivot > min_pivot(j))
      stored = Form::of(pivot);
    else if (SMALL == Small::FAIL)
      return false;
    a[j * stride + j] = stored;
    for (std::size_t i = j + 1; i < n; ++i)
      column[i] = a[i * stride + j] = Form::divide(a[i * stride + j], stored);
    for (std::size_t i = j + 1; i < n; ++i) {
      const double at = column[i];
      double* row = a + i * stride;
      for (std::size_t k = j + 1; k <= i; ++k) row[k] -= at * column[k];
    }
  }
  return true;
}

// Row pointers of a matrix.
struct Rows {
  const double* a;
  std::size_t stride;

  const double* operator()(std::size_t i) const { return a + i * stride; }
};

// Replaces x, which is 0 before `first`, by L^-1 x.
template <class Form, class RowOf>
void solve_forward(RowOf row_of, std::size_t n, double* x, std::size_t first = 0) {
  for (std::size_t i = first; i < n; ++i) {
    const double* row = row_of(i);
    double sum = x[i];
    for (std::size_t k = first; k < i; ++k) sum -= row[k] * x[k];
    x[i] = Form::divide(sum, row[i]);
  }
}

// Replaces x by L^-T x.
template <class Form, class RowOf>
void solve_backward(RowOf row_of, std::size_t n, double* x) {
  for (std::size_t i = n; i-- > 0;) {
    const double* row = row_of(i);
    x[i] = Form::divide(x[i], row[i]);
    for (std::size_t k = 0; k < i; ++k) x[k] -= row[k] * x[i];
  }
}

}  // namespace animtool::cholesky
