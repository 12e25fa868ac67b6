// Quadratic model of the cost around a pose, and its linear systems.
#pragma once

#include <vector>

#include "ik/goals.h"

namespace animtool::ik {

// Factors a symmetric positive definite A (m, m) in place, see base/cholesky.h; `column` is a
// buffer for m numbers. Returns false if A is not positive definite.
bool factor_cholesky(double* a, double* column, int m);

// Solves A x = b in place with the factor of A.
void solve_factored(const double* a, double* b, int m);

// The dot product of a range, in four partial sums that are added in parallel.
inline double inner(const double* a, const double* b, int first, int last) {
  double sums[4] = {0, 0, 0, 0};
  int i = first;
  for (; i + 4 <= last; i += 4)
    for (int n = 0; n < 4; ++n) sums[n] += a[i + n] * b[i + n];
  for (; i < last; ++i) sums[0] += a[i] * b[i];
  return (sums[0] + sums[1]) + (sums[2] + sums[3]);
}

// The cost around a pose: columns of the Jacobian, the smaller of its two Gram matrices, and the
// gradient.
struct Linearized {
  // If there are more residuals than degrees of freedom, systems have the size of the chain.
  const bool is_primal;
  std::vector<double> columns;                 // (D, M)
  std::vector<double> gram_matrix;             // (M, M), lower triangle: J J^T; unless is_primal
  std::vector<double> normal_matrix;           // (D, D), lower triangle: J^T J; if is_primal
  std::vector<double> negative_gradient;       // (D,): negative gradient, with the rest preference
  std::vector<double> negative_rest_gradient;  // (D,): negative gradient of the rest preference
  std::vector<int> first_rows, last_rows;      // (D,): range of rows that a degree of freedom moves

  explicit Linearized(const Task& task)
      : is_primal(task.row_count > task.chain.dof_count),
        columns(static_cast<std::size_t>(task.chain.dof_count) * task.row_count),
        gram_matrix(is_primal ? 0 : static_cast<std::size_t>(task.row_count) * task.row_count),
        normal_matrix(
            is_primal ? static_cast<std::size_t>(task.chain.dof_count) * task.chain.dof_count : 0),
        negative_gradient(task.chain.dof_count),
        negative_rest_gradient(task.chain.dof_count),
        first_rows(task.chain.dof_count, task.row_count),
        last_rows(task.chain.dof_count, 0) {
    for (const Goal& goal : task.goals)
      for (const int n : goal.path) {
        for_each_dof(task.chain, task.chain.nodes[n], [&](int d) {
          first_rows[d] = std::min(first_rows[d], goal.row);
          last_rows[d] = std::max(last_rows[d], goal.row + count_rows(goal));
        });
      }
  }
};

// Computes the negative gradient of the rest preference (D,); returns its cost.
double evaluate_rest(const Task& task, const double* q, const double* rest, double weight,
                     double* negative_rest_gradient);

// Computes the lower triangle of J^T J (D, D).
void compute_normal_matrix(const Task& task, const Linearized& linear, double* normal_matrix);

// Linearises the residuals at a pose.
void linearize(const Task& task, const double* targets, const double* rest, const State& state,
               Linearized& out);

}  // namespace animtool::ik
