// Linearised cost around a pose, and its normal equations.
#include "ik/linear.h"

#include "base/cholesky.h"

namespace animtool::ik {

bool factor_cholesky(double* a, double* column, int m) {
  using namespace cholesky;
  return factor<Inverses, SmallPivot::FAIL>(a, m, m, column, [](std::size_t) { return 0.0; });
}

void solve_factored(const double* a, double* b, int m) {
  const cholesky::Rows rows{a, static_cast<std::size_t>(m)};
  cholesky::solve_forward<cholesky::Inverses>(rows, m, b);
  cholesky::solve_backward<cholesky::Inverses>(rows, m, b);
}

double evaluate_rest(const Task& task, const double* q, const double* rest, double weight,
                     double* negative_rest_gradient) {
  double cost = 0;
  std::fill(negative_rest_gradient, negative_rest_gradient + task.chain.dof_count, 0.0);
  if (!(weight > 0)) return 0;
  for (const Node& node : task.chain.nodes) {
    if (node.is_driven) continue;
    const double *values = q + node.coordinate, *rest_values = rest + node.coordinate;
    double offset[3];
    if (node.kind == Kind::BALL) {
      const double inverse[4] = {-values[0], -values[1], -values[2], values[3]};
      double rotation[4];
      product(rest_values, inverse, rotation);
      logarithm(rotation, offset);
    } else {
      offset[0] = rest_values[0] - values[0];
    }
    for (int k = 0; k < node.dof_count(); ++k) {
      cost += weight * offset[k] * offset[k] / 2;
      negative_rest_gradient[node.dof + k] = weight * offset[k];
    }
  }
  return cost;
}

void compute_normal_matrix(const Task& task, const Linearized& linear, double* normal_matrix) {
  const int dofs = task.chain.dof_count;
  for (int d = 0; d < dofs; ++d) {
    const double* column = linear.columns.data() + static_cast<std::size_t>(d) * task.row_count;
    for (int k = 0; k <= d; ++k) {
      const double* other_column =
          linear.columns.data() + static_cast<std::size_t>(k) * task.row_count;
      const int first = std::max(linear.first_rows[d], linear.first_rows[k]);
      const int last = std::min(linear.last_rows[d], linear.last_rows[k]);
      normal_matrix[static_cast<std::size_t>(d) * dofs + k] =
          inner(column, other_column, first, last);
    }
  }
}

void linearize(const Task& task, const double* targets, const double* rest, const State& state,
               Linearized& out) {
  const int m = task.row_count;
  differentiate(task, targets, state, out.columns);
  evaluate_rest(task, state.q.data(), rest, task.rest_weight, out.negative_rest_gradient.data());
  std::fill(out.gram_matrix.begin(), out.gram_matrix.end(), 0.0);
  for (int d = 0; d < task.chain.dof_count; ++d) {
    const double* column = out.columns.data() + static_cast<std::size_t>(d) * m;
    double sum = out.negative_rest_gradient[d];
    for (int i = out.first_rows[d]; i < out.last_rows[d]; ++i) {
      const double entry = column[i];
      sum += entry * state.residuals[i];
      if (entry == 0 || out.is_primal) continue;
      double* row = &out.gram_matrix[static_cast<std::size_t>(i) * m];
      for (int j = out.first_rows[d]; j <= i; ++j) row[j] += entry * column[j];
    }
    out.negative_gradient[d] = sum;
  }
  if (out.is_primal) compute_normal_matrix(task, out, out.normal_matrix.data());
}

}  // namespace animtool::ik
