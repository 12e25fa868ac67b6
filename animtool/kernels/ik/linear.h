// Quadratic model of the cost around a pose, and its linear systems.
#pragma once

#include <vector>

#include "ik/goals.h"

namespace animtool::ik {

// Factors a symmetric positive definite A (m, m), see base/cholesky.h; `column` is a buffer for m
// numbers. Returns false if A is not positive definite.
bool factor_cholesky(double* a, double* column, int m);

// Solves A x = b in place with the factor of A.
void solve_factored(const double* a, double* b, int m);

// In four partial sums, which are added in parallel.
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
  // More residuals than degrees of freedom: systems have the size of the chain.
  const bool primal;
  std::vector<double> columns;   // (D, M)
  std::vector<double> gram;      // (M, M), lower triangle: J J^T; unless primal
  std::vector<double> normal;    // (D, D), lower triangle: J^T J; if primal
  std::vector<double> downhill;  // (D,): minus the gradient, rest preference included
  std::vector<double> pull;      // (D,): the part of the rest preference
  std::vector<int> first, last;  // (D,): rows that a degree of freedom moves

  explicit Linearized(const Task& task)
      : primal(task.rows > task.chain.dofs),
        columns(static_cast<std::size_t>(task.chain.dofs) * task.rows),
        gram(primal ? 0 : static_cast<std::size_t>(task.rows) * task.rows),
        normal(primal ? static_cast<std::size_t>(task.chain.dofs) * task.chain.dofs : 0),
        downhill(task.chain.dofs),
        pull(task.chain.dofs),
        first(task.chain.dofs, task.rows),
        last(task.chain.dofs, 0) {
    for (const Goal& goal : task.goals)
      for (const int n : goal.path) {
        each_dof(task.chain, task.chain.nodes[n], [&](int d) {
          first[d] = std::min(first[d], goal.row);
          last[d] = std::max(last[d], goal.row + rows_of(goal));
        });
      }
  }
};

// Pull of the rest preference on each degree of freedom, and its cost.
double rest_pull(const Task& task, const double* q, const double* rest, double weight,
                 double* pull);

// The lower triangle of J^T J (D, D).
void multiply_columns(const Task& task, const Linearized& linear, double* normal);

void linearize(const Task& task, const double* targets, const double* rest, const State& state,
               Linearized& out);

}  // namespace animtool::ik
