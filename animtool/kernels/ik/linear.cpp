// Linearised cost around a pose, and its normal equations.
#include "ik/linear.h"

#include "base/cholesky.h"

namespace animtool::ik {

bool factor_cholesky(double* a, double* column, int m) {
  using namespace cholesky;
  return factor<Inverses, Small::FAIL>(a, m, m, column, [](std::size_t) { return 0.0; });
}

void solve_factored(const double* a, double* b, int m) {
  const cholesky::Rows rows{a, static_cast<std::size_t>(m)};
  cholesky::solve_forward<cholesky::Inverses>(rows, m, b);
  cholesky::solve_backward<cholesky::Inverses>(rows, m, b);
}

double rest_pull(const Task& task, const double* q, const double* rest, double weight,
                 double* pull) {
  double cost = 0;
  std::fill(pull, pull + task.chain.dofs, 0.0);
  if (!(weight > 0)) return 0;
  for (const Node& node : task.chain.nodes) {
    if (node.follows) continue;
    const double *now = q + node.coordinate, *home = rest + node.coordinate;
    double away[3];
    if (node.kind == Kind::BALL) {
      const double back[4] = {-now[0], -now[1], -now[2], now[3]};
      double rotation[4];
      product(home, back, rotation);
      logarithm(rotation, away);
    } else {
      away[0] = home[0] - now[0];
    }
    for (int k = 0; k < node.width(); ++k) {
      cost += weight * away[k] * away[k] / 2;
      pull[node.dof + k] = weight * away[k];
    }
  }
  return cost;
}

void multiply_columns(const Task& task, const Linearized& linear, double* normal) {
  const int dofs = task.chain.dofs;
  for (int d = 0; d < dofs; ++d) {
    const double* first_column = linear.columns.data() + static_cast<std::size_t>(d) * task.rows;
    for (int k = 0; k <= d; ++k) {
      const double* other = linear.columns.data() + static_cast<std::size_t>(k) * task.rows;
      const int first = std::max(linear.first[d], linear.first[k]);
      const int last = std::min(linear.last[d], linear.last[k]);
      normal[static_cast<std::size_t>(d) * dofs + k] = inner(first_column, other, first, last);
    }
  }
}

void linearize(const Task& task, const double* targets, const double* rest, const State& state,
               Linearized& out) {
  const int m = task.rows;
  differentiate(task, targets, state, out.columns);
  rest_pull(task, state.q.data(), rest, task.rest_weight, out.pull.data());
  std::fill(out.gram.begin(), out.gram.end(), 0.0);
  for (int d = 0; d < task.chain.dofs; ++d) {
    const double* column = out.columns.data() + static_cast<std::size_t>(d) * m;
    double sum = out.pull[d];
    for (int i = out.first[d]; i < out.last[d]; ++i) {
      const double at = column[i];
      sum += at * state.residuals[i];
      if (at == 0 || out.primal) continue;
      double* row = &out.gram[static_cast<std::size_t>(i) * m];
      for (int j = out.first[d]; j <= i; ++j) row[j] += at * column[j];
    }
    out.downhill[d] = sum;
  }
  if (out.primal) multiply_columns(task, out, out.normal.data());
}

}  // namespace animtool::ik
