// Residuals of goals, and their Jacobian.
#include "ik/goals.h"

namespace animtool::ik {

void measure(const Task& task, const double* targets, State& state, const double* shift) {
  std::fill(state.residuals.begin(), state.residuals.end(), 0.0);
  std::fill(state.errors.begin(), state.errors.end(), 0.0);
  for (std::size_t e = 0; e < task.goals.size(); ++e) {
    const Goal& goal = task.goals[e];
    const double* target = targets + TARGET_WIDTH * e;
    const double* rotation = &state.frames.rotations[9 * goal.node];
    double* point = &state.points[3 * e];
    double* error = &state.errors[PARTS * e];
    double* weights = &state.weights[PARTS * e];
    double* r = state.residuals.data() + goal.row;
    for (int part = 0; part < PARTS; ++part) weights[part] = weight_of(goal, target, part);
    rotate(rotation, goal.offset, point);
    for (int i = 0; i < 3; ++i) point[i] += state.frames.origins[3 * goal.node + i];
    const View view = view_of(goal, state, point);
    each_kind([&]<class Kind>(int part) {
      if (weights[part] > 0)
        error[part] = Kind::measure(weights[part], view, target + COLUMNS[part], r);
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
        std::get<typename Kind::Slopes>(slopes).prepare(view, target + COLUMNS[part]);
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
  // Rounding error of a target on the boundary of the reach.
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

void Curvature::add(const Task& task, const State& state, std::size_t e, const double* along,
                    double* out) {
  const Goal& goal = task.goals[e];
  const double* point = &state.points[3 * e];
  const double* residual = state.residuals.data() + goal.row;
  const double* weights = &state.weights[PARTS * e];
  double force[3] = {0, 0, 0}, torque[3] = {0, 0, 0}, shrink = 0, axis[3] = {0, 0, 0};
  constexpr int position = part_of<Position>(), orientation = part_of<Orientation>();
  static_assert(position == 0 && orientation == 1);
  if (goal.weights[position] > 0) {
    for (int i = 0; i < 3; ++i) force[i] = weights[position] * residual[i];
    residual += Position::ROWS;
  }
  if (weights[orientation] > 0) {
    const double w = weights[orientation], angle = length(residual) / w;
    for (int i = 0; i < 3; ++i) {
      torque[i] = w * residual[i];
      axis[i] = angle > 1e-9 ? residual[i] / (w * angle) : 0;
    }
    // Across the residual, turning changes its length by angle/2 cot(angle/2) only.
    if (angle > 1e-9) shrink = w * w * (angle / 2 / std::tan(angle / 2) - 1);
  }
  // Sums of the velocities of point and frame over the joints after each one.
  double linear[3] = {0, 0, 0}, angular[3] = {0, 0, 0};
  for (std::size_t at = goal.path.size(); at-- > 0;) {
    double* behind = &behind_[6 * at];
    std::copy(linear, linear + 3, behind);
    std::copy(angular, angular + 3, behind + 3);
    accumulate(task, state, goal.path[at], point, along, linear, angular);
  }
  double across_axis[3];
  for (int i = 0; i < 3; ++i) across_axis[i] = shrink * (angular[i] - dot(axis, angular) * axis[i]);
  double before[3] = {0, 0, 0};
  for (std::size_t at = 0; at < goal.path.size(); ++at) {
    const int n = goal.path[at];
    const Node& node = task.chain.nodes[n];
    const double* behind = &behind_[6 * at];
    const double* origin = &state.frames.origins[3 * n];
    double node_linear[3] = {0, 0, 0}, node_angular[3] = {0, 0, 0};
    accumulate(task, state, n, point, along, node_linear, node_angular);
    each_slope(task.chain, node, state.frames, [&](int k, int dof, double gain) {
      double lin[3], ang[3];
      velocity(node, &state.frames.axes[9 * n + 3 * k], origin, point, lin, ang);
      double sum = -triple(force, ang, behind) - triple(force, before, lin);
      // The joint with itself: half of either order.
      sum -= (triple(force, ang, node_linear) + triple(force, node_angular, lin)) / 2;
      sum -= (triple(torque, ang, behind + 3) + triple(torque, before, ang)) / 2;
      sum += dot(ang, across_axis);
      out[dof] += gain * sum;
    });
    for (int i = 0; i < 3; ++i) before[i] += node_angular[i];
  }
}

void Curvature::accumulate(const Task& task, const State& state, int n, const double* point,
                           const double* along, double* linear, double* angular) {
  const Node& node = task.chain.nodes[n];
  each_slope(task.chain, node, state.frames, [&](int k, int dof, double gain) {
    double lin[3], ang[3];
    velocity(node, &state.frames.axes[9 * n + 3 * k], &state.frames.origins[3 * n], point, lin,
             ang);
    const double amount = gain * along[dof];
    for (int i = 0; i < 3; ++i) linear[i] += amount * lin[i], angular[i] += amount * ang[i];
  });
}

}  // namespace animtool::ik
