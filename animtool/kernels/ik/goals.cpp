// Residuals of goals, and their Jacobian.
#include "ik/goals.h"

namespace animtool::ik {

void measure(const Task& task, const double* targets, State& state,
             const double* residual_offsets) {
  std::fill(state.residuals.begin(), state.residuals.end(), 0.0);
  std::fill(state.errors.begin(), state.errors.end(), 0.0);
  for (std::size_t e = 0; e < task.goals.size(); ++e) {
    const Goal& goal = task.goals[e];
    const double* target = targets + TARGET_WIDTH * e;
    const double* rotation = &state.frames.rotations[9 * goal.node];
    double* point = &state.points[3 * e];
    double* error = &state.errors[COMPONENT_COUNT * e];
    double* weights = &state.weights[COMPONENT_COUNT * e];
    double* r = state.residuals.data() + goal.row;
    for (int component = 0; component < COMPONENT_COUNT; ++component)
      weights[component] = weight_of(goal, target, component);
    rotate(rotation, goal.offset, point);
    for (int i = 0; i < 3; ++i) point[i] += state.frames.origins[3 * goal.node + i];
    const GoalView view = view_of(goal, state, point);
    for_each_kind([&]<class Kind>(int component) {
      if (weights[component] > 0)
        error[component] =
            Kind::measure(weights[component], view, target + TARGET_OFFSETS[component], r);
      r += Kind::RESIDUAL_COUNT * (goal.weights[component] > 0);
    });
  }
  if (residual_offsets)
    for (int i = 0; i < task.row_count; ++i) state.residuals[i] += residual_offsets[i];
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
    const double* weights = &state.weights[COMPONENT_COUNT * e];
    if (std::all_of(weights, weights + COMPONENT_COUNT, [](double w) { return !(w > 0); }))
      continue;
    const GoalView view = view_of(goal, state, point);
    AllJacobianTerms jacobian_terms;
    double component_weights[COMPONENT_COUNT];
    int rows[COMPONENT_COUNT], next = 0;
    for_each_kind([&]<class Kind>(int component) {
      component_weights[component] = weights[component];
      rows[component] = next;
      next += Kind::RESIDUAL_COUNT * (goal.weights[component] > 0);
      if (weights[component] > 0)
        std::get<typename Kind::JacobianTerms>(jacobian_terms)
            .prepare(view, target + TARGET_OFFSETS[component]);
    });
    for (const int n : goal.path) {
      const Node& node = task.chain.nodes[n];
      const double* origin = &state.frames.origins[3 * n];
      for_each_slope(task.chain, node, state.frames, [&](int k, int dof, double gain) {
        double* column = columns.data() + static_cast<std::size_t>(dof) * task.row_count + goal.row;
        AxisMotion motion{node, n, &state.frames.axes[9 * n + 3 * k], origin, {}, {}};
        velocity(node, motion.axis, origin, point, motion.linear, motion.angular);
        for_each_kind([&]<class Kind>(int component) {
          if (component_weights[component] > 0)
            std::get<typename Kind::JacobianTerms>(jacobian_terms)
                .add(motion, gain * component_weights[component], column + rows[component]);
        });
      });
    }
  }
}

DistanceRange distance_range(const Task& task, const Goal& goal) {
  DistanceRange range;
  double longest_bone = 0;
  const auto add_bone = [&](double bone) {
    range.outer += bone;
    longest_bone = std::max(longest_bone, bone);
  };
  for (std::size_t k = 1; k < goal.path.size(); ++k)
    add_bone(length(task.chain.nodes[goal.path[k]].offset));
  add_bone(length(goal.offset));
  range.inner = std::max(0.0, 2 * longest_bone - range.outer);
  return range;
}

double cost_lower_bound(const Task& task, const double* targets, const Frames& frames) {
  double cost = 0;
  for (std::size_t e = 0; e < task.goals.size(); ++e) {
    const Goal& goal = task.goals[e];
    bool has_slide = false;
    for (const int n : goal.path) has_slide = has_slide || task.chain.nodes[n].kind == Kind::SLIDE;
    const double* row = targets + TARGET_WIDTH * e;
    const double* target = row + TARGET_OFFSETS[component_of<Position>()];
    const double weight = weight_of(goal, row, component_of<Position>());
    if (has_slide || !(weight > 0)) continue;
    const double* root_position = &frames.origins[3 * goal.path[0]];
    const double offset[3] = {target[0] - root_position[0], target[1] - root_position[1],
                              target[2] - root_position[2]};
    const DistanceRange range = distance_range(task, goal);
    const double distance = length(offset);
    const double gap = std::max({0.0, distance - range.outer, range.inner - distance});
    cost += weight * weight * gap * gap / 2;
  }
  // Ignores rounding errors of a target on the boundary of the range.
  return cost > 1e-16 ? cost : 0;
}

void stretch_limbs(const Chain& unstretched, const double* factors, Task& task) {
  for (std::size_t e = 0; e < task.goals.size(); ++e) {
    Goal& goal = task.goals[e];
    if (factors[e] == goal.stretch_factor) continue;
    goal.stretch_factor = factors[e];
    for (std::size_t k = 1; k < goal.path.size(); ++k)
      for (int i = 0; i < 3; ++i)
        task.chain.nodes[goal.path[k]].offset[i] =
            goal.stretch_factor * unstretched.nodes[goal.path[k]].offset[i];
    for (int i = 0; i < 3; ++i)
      goal.offset[i] = goal.stretch_factor * goal.stretching_offset[i] + goal.fixed_offset[i];
  }
}

void Curvature::add(const Task& task, const State& state, std::size_t e, const double* direction,
                    double* out) {
  const Goal& goal = task.goals[e];
  const double* point = &state.points[3 * e];
  const double* residual = state.residuals.data() + goal.row;
  const double* weights = &state.weights[COMPONENT_COUNT * e];
  double force[3] = {0, 0, 0}, torque[3] = {0, 0, 0}, angular_stiffness = 0, axis[3] = {0, 0, 0};
  constexpr int position = component_of<Position>(), orientation = component_of<Orientation>();
  static_assert(position == 0 && orientation == 1);
  if (goal.weights[position] > 0) {
    for (int i = 0; i < 3; ++i) force[i] = weights[position] * residual[i];
    residual += Position::RESIDUAL_COUNT;
  }
  if (weights[orientation] > 0) {
    const double w = weights[orientation], angle = length(residual) / w;
    for (int i = 0; i < 3; ++i) {
      torque[i] = w * residual[i];
      axis[i] = angle > 1e-9 ? residual[i] / (w * angle) : 0;
    }
    // Perpendicular to the residual, a rotation changes its length by a factor of angle/2
    // cot(angle/2) only.
    if (angle > 1e-9) angular_stiffness = w * w * (angle / 2 / std::tan(angle / 2) - 1);
  }
  // Sums of the velocities of point and frame over the joints after each joint.
  double linear[3] = {0, 0, 0}, angular[3] = {0, 0, 0};
  for (std::size_t k = goal.path.size(); k-- > 0;) {
    double* later_sums = &later_sums_[6 * k];
    std::copy(linear, linear + 3, later_sums);
    std::copy(angular, angular + 3, later_sums + 3);
    accumulate(task, state, goal.path[k], point, direction, linear, angular);
  }
  double perpendicular[3];
  for (int i = 0; i < 3; ++i)
    perpendicular[i] = angular_stiffness * (angular[i] - dot(axis, angular) * axis[i]);
  double earlier_angular[3] = {0, 0, 0};
  for (std::size_t k = 0; k < goal.path.size(); ++k) {
    const int n = goal.path[k];
    const Node& node = task.chain.nodes[n];
    const double* later_sums = &later_sums_[6 * k];
    const double* origin = &state.frames.origins[3 * n];
    double node_linear[3] = {0, 0, 0}, node_angular[3] = {0, 0, 0};
    accumulate(task, state, n, point, direction, node_linear, node_angular);
    for_each_slope(task.chain, node, state.frames, [&](int k, int dof, double gain) {
      double axis_linear[3], axis_angular[3];
      velocity(node, &state.frames.axes[9 * n + 3 * k], origin, point, axis_linear, axis_angular);
      double sum = -triple_product(force, axis_angular, later_sums) -
                   triple_product(force, earlier_angular, axis_linear);
      // The joint with itself: half of each order.
      sum -= (triple_product(force, axis_angular, node_linear) +
              triple_product(force, node_angular, axis_linear)) /
             2;
      sum -= (triple_product(torque, axis_angular, later_sums + 3) +
              triple_product(torque, earlier_angular, axis_angular)) /
             2;
      sum += dot(axis_angular, perpendicular);
      out[dof] += gain * sum;
    });
    for (int i = 0; i < 3; ++i) earlier_angular[i] += node_angular[i];
  }
}

void Curvature::accumulate(const Task& task, const State& state, int n, const double* point,
                           const double* direction, double* linear, double* angular) {
  const Node& node = task.chain.nodes[n];
  for_each_slope(task.chain, node, state.frames, [&](int k, int dof, double gain) {
    double axis_linear[3], axis_angular[3];
    velocity(node, &state.frames.axes[9 * n + 3 * k], &state.frames.origins[3 * n], point,
             axis_linear, axis_angular);
    const double amount = gain * direction[dof];
    for (int i = 0; i < 3; ++i)
      linear[i] += amount * axis_linear[i], angular[i] += amount * axis_angular[i];
  });
}

}  // namespace animtool::ik
