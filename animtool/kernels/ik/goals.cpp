// What goals miss, and its slopes.
#include "ik/goals.h"

namespace animtool::ik {

void measure(const Task& task, const double* targets, State& state,
             const double* shift) {
  std::fill(state.residuals.begin(), state.residuals.end(), 0.0);
  std::fill(state.misses.begin(), state.misses.end(), 0.0);
  for (std::size_t e = 0; e < task.goals.size(); ++e) {
    const Goal& goal = task.goals[e];
    const double* target = targets + TARGET_WIDTH * e;
    const double* rotation = &state.frames.rotations[9 * goal.node];
    double* point = &state.points[3 * e];
    double* miss = &state.misses[PARTS * e];
    double* weights = &state.weights[PARTS * e];
    double* r = state.residuals.data() + goal.row;
    for (int part = 0; part < PARTS; ++part) weights[part] = weight_of(goal, target, part);
    rotate(rotation, goal.offset, point);
    for (int i = 0; i < 3; ++i) point[i] += state.frames.origins[3 * goal.node + i];
    const View view = view_of(goal, state, point);
    each_kind([&]<class Kind>(int part) {
      if (weights[part] > 0)
        miss[part] = Kind::measure(weights[part], view, target + COLUMNS[part], r);
      r += Kind::ROWS * (goal.weights[part] > 0);
    });
  }
  if (shift)
    for (int i = 0; i < task.rows; ++i) state.residuals[i] += shift[i];
  state.cost = 0;
  for (const double x : state.residuals) state.cost += x * x;
  state.cost /= 2;
}

void differentiate(const Task& task, const double* targets, const State& state,
                   std::vector<double>& columns) {
  std::fill(columns.begin(), columns.end(), 0.0);
  for (std::size_t e = 0; e < task.goals.size(); ++e) {
    const Goal& goal = task.goals[e];
    const double* target = targets + TARGET_WIDTH * e;
    const double* point = &state.points[3 * e];
    const double* weights = &state.weights[PARTS * e];
    if (std::all_of(weights, weights + PARTS, [](double w) { return !(w > 0); })) continue;
    const View view = view_of(goal, state, point);
    Slopes slopes;
    double shares[PARTS];
    int rows[PARTS], next = 0;
    each_kind([&]<class Kind>(int part) {
      shares[part] = weights[part];
      rows[part] = next;
      next += Kind::ROWS * (goal.weights[part] > 0);
      if (weights[part] > 0)
        std::get<typename Kind::Slopes>(slopes).look(view, target + COLUMNS[part]);
    });
    for (const int n : goal.path) {
      const Node& node = task.chain.nodes[n];
      const double* origin = &state.frames.origins[3 * n];
      each_slope(task.chain, node, state.frames, [&](int k, int dof, double gain) {
        double* column = columns.data() + static_cast<std::size_t>(dof) * task.rows + goal.row;
        Motion motion{node, n, &state.frames.axes[9 * n + 3 * k], origin, {}, {}};
        velocity(node, motion.axis, origin, point, motion.linear, motion.angular);
        each_kind([&]<class Kind>(int part) {
          if (shares[part] > 0)
            std::get<typename Kind::Slopes>(slopes).add(motion, gain * shares[part],
                                                        column + rows[part]);
        });
      });
    }
  }
}

Reach reach_of(const Task& task, const Goal& goal) {
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

double nearest_cost(const Task& task, const double* targets, const Frames& frames) {
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

void stretch(const Chain& plain, const double* stretches, Task& task) {
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
