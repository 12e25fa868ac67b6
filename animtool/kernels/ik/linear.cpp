// The cost around a pose, and its systems.
#include "ik/linear.h"

namespace animtool::ik {

bool factor_cholesky(double* a, double* column, int m) {
  for (int j = 0; j < m; ++j) {
    const double pivot = a[j * m + j];
    if (!(pivot > 0)) return false;
    const double inverse = 1 / std::sqrt(pivot);
    a[j * m + j] = inverse;
    for (int i = j + 1; i < m; ++i) column[i] = a[i * m + j] *= inverse;
    for (int i = j + 1; i < m; ++i) {
      const double at = column[i];
      double* row = a + i * m;
      for (int k = j + 1; k <= i; ++k) row[k] -= at * column[k];
    }
  }
  return true;
}

void solve_factored(const double* a, double* b, int m) {
  for (int i = 0; i < m; ++i) {
    const double* row = a + i * m;
    double sum = b[i];
    for (int j = 0; j < i; ++j) sum -= row[j] * b[j];
    b[i] = sum * row[i];
  }
  for (int j = m; j-- > 0;) {
    b[j] *= a[j * m + j];
    for (int i = 0; i < j; ++i) b[i] -= a[j * m + i] * b[j];
  }
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
      double turn[4];
      product(home, back, turn);
      logarithm(turn, away);
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
    const double* own = linear.columns.data() + static_cast<std::size_t>(d) * task.rows;
    for (int k = 0; k <= d; ++k) {
      const double* other = linear.columns.data() + static_cast<std::size_t>(k) * task.rows;
      const int first = std::max(linear.first[d], linear.first[k]);
      const int last = std::min(linear.last[d], linear.last[k]);
      // In four sums, that the processor adds side by side.
      double sums[4] = {0, 0, 0, 0};
      int i = first;
      for (; i + 4 <= last; i += 4)
        for (int n = 0; n < 4; ++n) sums[n] += own[i + n] * other[i + n];
      for (; i < last; ++i) sums[0] += own[i] * other[i];
      normal[static_cast<std::size_t>(d) * dofs + k] = (sums[0] + sums[1]) + (sums[2] + sums[3]);
    }
  }
}

void linearize(const Task& task, const double* targets, const double* rest,
               const State& state, Linearized& out) {
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
