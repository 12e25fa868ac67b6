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

// How a factor stores its diagonal: the square root of a pivot, or its reciprocal, which makes
// solves faster. IGNORED_PIVOT is stored for a pivot that is ignored.
struct Roots {
  static constexpr double IGNORED_PIVOT = HUGE_VAL;
  static double from_pivot(double pivot) { return std::sqrt(pivot); }
  static double divide(double value, double stored_pivot) { return value / stored_pivot; }
};
struct Inverses {
  static constexpr double IGNORED_PIVOT = 0;
  static double from_pivot(double pivot) { return 1 / std::sqrt(pivot); }
  static double divide(double value, double stored_pivot) { return value * stored_pivot; }
};

// What happens at a pivot that is too small: the factorisation fails, or ignores it.
enum class SmallPivot { FAIL, IGNORE };

// Factors a matrix (n, n) in place, reading and overwriting the lower triangle. Returns false if
// pivot k is not above `min_pivot(k)`. Works by columns, so that the inner loops run over
// contiguous memory; `column` is a buffer for n numbers.
template <class Diagonal, SmallPivot SMALL_PIVOT, class MinPivot>
bool factor(double* a, std::size_t n, std::size_t stride, double* column, MinPivot min_pivot) {
  for (std::size_t j = 0; j < n; ++j) {
    double stored_pivot = Diagonal::IGNORED_PIVOT;
    const double pivot = a[j * stride + j];
    if (pivot > min_pivot(j))
      stored_pivot = Diagonal::from_pivot(pivot);
    else if (SMALL_PIVOT == SmallPivot::FAIL)
      return false;
    a[j * stride + j] = stored_pivot;
    for (std::size_t i = j + 1; i < n; ++i)
      column[i] = a[i * stride + j] = Diagonal::divide(a[i * stride + j], stored_pivot);
    for (std::size_t i = j + 1; i < n; ++i) {
      const double multiplier = column[i];
      double* row = a + i * stride;
      for (std::size_t k = j + 1; k <= i; ++k) row[k] -= multiplier * column[k];
    }
  }
  return true;
}

// Returns a pointer to each row of a dense matrix.
struct Rows {
  const double* a;
  std::size_t stride;

  const double* operator()(std::size_t i) const { return a + i * stride; }
};

// Replaces x by L^-1 x; x is 0 before `first`.
template <class Diagonal, class RowOf>
void solve_forward(RowOf row_of, std::size_t n, double* x, std::size_t first = 0) {
  for (std::size_t i = first; i < n; ++i) {
    const double* row = row_of(i);
    double sum = x[i];
    for (std::size_t k = first; k < i; ++k) sum -= row[k] * x[k];
    x[i] = Diagonal::divide(sum, row[i]);
  }
}

// Replaces x by L^-T x.
template <class Diagonal, class RowOf>
void solve_backward(RowOf row_of, std::size_t n, double* x) {
  for (std::size_t i = n; i-- > 0;) {
    const double* row = row_of(i);
    x[i] = Diagonal::divide(x[i], row[i]);
    for (std::size_t k = 0; k < i; ++k) x[k] -= row[k] * x[i];
  }
}

}  // namespace animtool::cholesky
