// Limbs whose bones stretch.
#pragma once

#include "ik/goals.h"

namespace animtool::ik {

// Scales the bones on the way to the goals, from their first joint.
inline void stretch(const Chain& plain, const double* stretches, Task& task) {
  for (std::size_t e = 0; e < task.goals.size(); ++e) {
    Goal& goal = task.goals[e];
    if (stretches[e] == goal.stretched) continue;
    goal.stretched = stretches[e];
    for (std::size_t at = 1; at < goal.path.size(); ++at)
      for (int i = 0; i < 3; ++i)
        task.chain.nodes[goal.path[at]].offset[i] =
            goal.stretched * plain.nodes[goal.path[at]].offset[i];
    for (int i = 0; i < 3; ++i) goal.offset[i] = goal.stretched * goal.bone[i] + goal.tool[i];
  }
}

}  // namespace animtool::ik
