// The cheapest sequence of poses along several paths, with changes from one to another (A. Viterbi,
// Error bounds for convolutional codes and an asymptotically optimum decoding algorithm, 1967).
#include "ik/solve.h"

#include <cstdint>
#include <limits>

#include "ik/chain.h"
#include "ik/limits.h"
#include "ik/read.h"

namespace animtool {

namespace ik {

namespace {

// Factor of the cost of motion beyond an easy step.
constexpr double EXCESS_COST = 100;

// Cost of a step (D,): its squared distance from a drift, with unlimited pins the short way round,
// and more if a joint moves farther than is easy.
double step_cost(const Chain& chain, const double* step, const double* drift, double free_step) {
  double sum = 0;
  for (const Node& node : chain.nodes) {
    if (node.follows) continue;
    for (int d = node.dof; d < node.dof + node.width(); ++d) {
      double by = step[d] - drift[d];
      if (node.kind == Kind::PIN && !limited(node)) by -= REVOLUTION * std::round(by / REVOLUTION);
      const double excess = std::max(std::fabs(by) - free_step, 0.0);
      sum += by * by + EXCESS_COST * excess * excess;
    }
  }
  return sum;
}

// Chooses one of `count` paths (K, L, C) for each of L frames, starting on the first, or, if
// `open`, on any.
void find_cheapest(const Chain& chain, const double* paths, const double* costs,
                   const double* drifts, const double* free_step, std::size_t count,
                   std::size_t length, bool open, bool closed, std::int64_t* chosen) {
  const std::size_t width = chain.coordinates;
  std::vector<double> total(count, std::numeric_limits<double>::infinity()), next(count);
  std::vector<double> step(chain.dofs);
  std::vector<std::int64_t> origins(count * length);
  const auto pose = [&](std::size_t k, std::size_t t) { return paths + (k * length + t) * width; };
  if (count > 0) total[0] = 0;
  for (std::size_t k = 0; open && length > 0 && k < count; ++k) total[k] = costs[k * length];
  for (std::size_t t = 1; t < length; ++t) {
    for (std::size_t to = 0; to < count; ++to) {
      double least = std::numeric_limits<double>::infinity();
      std::int64_t origin = 0;
      for (std::size_t from = 0; from < count; ++from) {
        if (!(total[from] < least)) continue;
        difference(chain, pose(from, t - 1), pose(to, t), step.data());
        const double cost =
            total[from] +
            step_cost(chain, step.data(), drifts + (t - 1) * chain.dofs, free_step[t - 1]);
        if (cost < least) least = cost, origin = static_cast<std::int64_t>(from);
      }
      next[to] = least + costs[to * length + t];
      origins[t * count + to] = origin;
    }
    total.swap(next);
  }
  std::size_t last = 0;
  for (std::size_t k = 1; k < count && !closed; ++k)
    if (total[k] < total[last]) last = k;
  for (std::size_t t = length; t-- > 0;) {
    chosen[t] = static_cast<std::int64_t>(last);
    last = static_cast<std::size_t>(origins[t * count + last]);
  }
}

}  // namespace

}  // namespace ik

using namespace ik;

Out<std::int64_t, 1> cheapest_ik_path(In<std::int64_t, 2> nodes, In<double, 2> numbers,
                                      In<double, 3> paths, In<double, 2> costs,
                                      In<double, 2> drifts, In<double, 1> free_step, bool open,
                                      bool closed) {
  const Chain chain = read_chain(nodes, numbers);
  const std::size_t count = paths.shape(0), length = paths.shape(1);
  const auto width = static_cast<std::size_t>(chain.coordinates);
  check::shape("paths", paths, {check::ANY, check::ANY, width});
  if (!count) check::refuse("paths", "the array is empty");
  check::shape("costs", costs, {count, length});
  check_steps("drifts", drifts, length, chain.dofs);
  check::shape("easy", free_step,
               {std::max<std::size_t>(free_step.shape(0), length ? length - 1 : 0)});
  Out<std::int64_t, 1> chosen(length);
  find_cheapest(chain, paths.data(), costs.data(), drifts.data(), free_step.data(), count, length,
                open, closed, chosen.get());
  return chosen;
}

}  // namespace animtool
