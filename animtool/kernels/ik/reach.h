// How near the goals can come at the very best, from the lengths of the bones alone.
#pragma once

#include "ik/goals.h"

namespace animtool::ik {

// Least and largest distance of a goal's point from the first joint of its path.
struct Reach {
  double inner = 0, outer = 0;
};

inline Reach reach_of(const Task& task, const Goal& goal) {
  Reach reach;
  double longest = 0;
  const auto add = [&](double bone) {
    reach.outer += bone;
    longest = std::max(longest, bone);
  };
  for (std::size_t at = 1; at < goal.path.size(); ++at)
    add(length(task.chain.nodes[goal.path[at]].offset));
  add(length(goal.offset));
  reach.inner = std::max(0.0, 2 * longest - reach.outer);
  return reach;
}

// A bound from below on the cost of every pose; 0 where there is none.
inline double nearest_cost(const Task& task, const double* targets, const Frames& frames) {
  double cost = 0;
  for (std::size_t e = 0; e < task.goals.size(); ++e) {
    const Goal& goal = task.goals[e];
    bool slides = false;
    for (const int n : goal.path) slides = slides || task.chain.nodes[n].kind == Kind::SLIDE;
    const double* row = targets + TARGET_WIDTH * e;
    const double* target = row + COLUMNS[part_of<Position>()];
    const double weight = weight_of(goal, row, part_of<Position>());
    if (slides || !(weight > 0)) continue;
    const double* base = &frames.origins[3 * goal.path[0]];
    const double away[3] = {target[0] - base[0], target[1] - base[1], target[2] - base[2]};
    const Reach reach = reach_of(task, goal);
    const double distance = length(away);
    const double gap = std::max({0.0, distance - reach.outer, reach.inner - distance});
    cost += weight * weight * gap * gap / 2;
  }
  // What rounding alone makes of a target on the edge of the reach.
  return cost > 1e-16 ? cost : 0;
}

}  // namespace animtool::ik
