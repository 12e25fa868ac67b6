// The cheapest sequence of poses along several paths, with changes between paths (A. Viterbi, Error
// bounds for convolutional codes and an asymptotically optimum decoding algorithm, 1967).
#include "ik/solve.h"

#include <cstdint>
#include <limits>

#include "ik/chain.h"
#include "ik/limits.h"
#include "ik/read.h"

namespace animtool {

namespace ik {

namespace {

// Factor of the cost of motion beyond a free step.
constexpr double EXCESS_COST_FACTOR = 100;

// Cost of a step (D,): its squared distance from a drift, for unlimited pins in the shorter
// direction. A joint that moves farther than the free step costs more.
double step_cost(const Chain& chain, const double* step, const double* drift, double free_step) {
  double sum = 0;
  for (const Node& node : chain.nodes) {
    if (node.is_driven) continue;
    for (int d = node.dof; d < node.dof + node.dof_count(); ++d) {
      double difference = step[d] - drift[d];
      if (node.kind == Kind::PIN && !has_limit(node))
        difference -= REVOLUTION * std::round(difference / REVOLUTION);
      const double excess = std::max(std::fabs(difference) - free_step, 0.0);
      sum += difference * difference + EXCESS_COST_FACTOR * excess * excess;
    }
  }
  return sum;
}

// Chooses one of `count` paths (K, L, C) for each of L frames. The first frame is on the first
// path, or on any if `allows_any_start`; with `must_end_on_first`, the last frame is on the first
// path.
void find_cheapest(const Chain& chain, const double* paths, const double* costs,
                   const double* drifts, const double* free_step, std::size_t path_count,
                   std::size_t frame_count, bool allows_any_start, bool must_end_on_first,
                   std::int64_t* chosen_paths) {
  const std::size_t width = chain.coordinate_count;
  std::vector<double> total_costs(path_count, std::numeric_limits<double>::infinity()),
      next_costs(path_count);
  std::vector<double> step(chain.dof_count);
  std::vector<std::int64_t> predecessors(path_count * frame_count);
  const auto pose = [&](std::size_t k, std::size_t t) {
    return paths + (k * frame_count + t) * width;
  };
  if (path_count > 0) total_costs[0] = 0;
  for (std::size_t k = 0; allows_any_start && frame_count > 0 && k < path_count; ++k)
    total_costs[k] = costs[k * frame_count];
  for (std::size_t t = 1; t < frame_count; ++t) {
    for (std::size_t to = 0; to < path_count; ++to) {
      double min_cost = std::numeric_limits<double>::infinity();
      std::int64_t predecessor = 0;
      for (std::size_t from = 0; from < path_count; ++from) {
        if (!(total_costs[from] < min_cost)) continue;
        difference(chain, pose(from, t - 1), pose(to, t), step.data());
        const double cost =
            total_costs[from] +
            step_cost(chain, step.data(), drifts + (t - 1) * chain.dof_count, free_step[t - 1]);
        if (cost < min_cost) min_cost = cost, predecessor = static_cast<std::int64_t>(from);
      }
      next_costs[to] = min_cost + costs[to * frame_count + t];
      predecessors[t * path_count + to] = predecessor;
    }
    total_costs.swap(next_costs);
  }
  std::size_t path_index = 0;
  for (std::size_t k = 1; k < path_count && !must_end_on_first; ++k)
    if (total_costs[k] < total_costs[path_index]) path_index = k;
  for (std::size_t t = frame_count; t-- > 0;) {
    chosen_paths[t] = static_cast<std::int64_t>(path_index);
    path_index = static_cast<std::size_t>(predecessors[t * path_count + path_index]);
  }
}

}  // namespace

}  // namespace ik

using namespace ik;

Out<std::int64_t, 1> cheapest_ik_path(In<std::int64_t, 2> nodes, In<double, 2> numbers,
                                      In<double, 3> paths, In<double, 2> costs,
                                      In<double, 2> drifts, In<double, 1> free_step,
                                      bool allows_any_start, bool must_end_on_first) {
  const Chain chain = read_chain(nodes, numbers);
  const std::size_t path_count = paths.shape(0), frame_count = paths.shape(1);
  const auto width = static_cast<std::size_t>(chain.coordinate_count);
  check::shape("paths", paths, {check::ANY, check::ANY, width});
  if (!path_count) check::refuse("paths", "the array is empty");
  check::shape("costs", costs, {path_count, frame_count});
  check_steps("drifts", drifts, frame_count, chain.dof_count);
  check::shape("free_step", free_step,
               {std::max<std::size_t>(free_step.shape(0), frame_count ? frame_count - 1 : 0)});
  Out<std::int64_t, 1> chosen_paths(frame_count);
  find_cheapest(chain, paths.data(), costs.data(), drifts.data(), free_step.data(), path_count,
                frame_count, allows_any_start, must_end_on_first, chosen_paths.get());
  return chosen_paths;
}

}  // namespace animtool
