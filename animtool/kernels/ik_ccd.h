// Cyclic coordinate descent: joint by joint, from the tips to the root, each to where it
// serves the goals best by itself (L.-C. T. Wang, C. C. Chen, A combined optimization
// method for solving the inverse kinematics problem of mechanical manipulators, 1991).
#pragma once

#include "ik_method.h"
#include "ik_turns.h"

namespace animtool::ik {

class Cyclic : public Method {
 public:
  using Method::Method;

 protected:
  bool advance() override {
    const double before = now_.cost;
    const std::vector<Node>& nodes = task_.chain.nodes;
    for (std::size_t n = nodes.size(); n-- > 0;)
      if (!nodes[n].follows) turn(static_cast<int>(n));
    return now_.cost < before;
  }

 private:
  void turn(int n) {
    const Node& node = task_.chain.nodes[n];
    if (node.gain == 0) return;
    std::fill(delta_.begin(), delta_.end(), 0.0);
    if (node.kind == Kind::SLIDE)
      slide(n);
    else
      follow(node, &now_.frames.axes[9 * n], pull(n), delta_.data());
    stepper_.move(now_.q.data(), delta_.data(), next_.q.data());
    evaluate(next_);
    // Aims and joints that follow this one may have a say against it.
    if (next_.cost < now_.cost) std::swap(now_, next_);
  }

  bool moves(int n, const Goal& goal) const {
    return std::binary_search(goal.path.begin(), goal.path.end(), n);
  }

  Pull pull(int n) const {
    Pull sum;
    const double* origin = &now_.frames.origins[3 * n];
    for (std::size_t e = 0; e < task_.goals.size(); ++e) {
      const Goal& goal = task_.goals[e];
      if (!moves(n, goal)) continue;
      const double* target = targets_ + TARGET_WIDTH * e;
      const double* point = &now_.points[3 * e];
      const double* weights = &now_.weights[PARTS * e];
      if (weights[0] > 0) {
        double from[3], to[3];
        for (int i = 0; i < 3; ++i) from[i] = point[i] - origin[i], to[i] = target[i] - origin[i];
        sum.add(weights[0] * weights[0], from, to);
      }
      if (weights[1] > 0) {
        double wanted[9], transposed[9], left[9];
        const double* rotation = &now_.frames.rotations[9 * goal.node];
        to_matrix(target + 3, wanted);
        for (int i = 0; i < 9; ++i) transposed[i] = rotation[3 * (i % 3) + i / 3];
        multiply(wanted, transposed, left);
        sum.add(weights[1] * weights[1], left);
      }
      if (weights[2] > 0) {
        const Aim aim = look_at(goal, now_, point, target);
        sum.add(weights[2] * weights[2], aim.direction, aim.wanted);
      }
    }
    return sum;
  }

  void slide(int n) {
    const Node& node = task_.chain.nodes[n];
    const double* axis = &now_.frames.axes[9 * n];
    double sum = 0, weight = 0;
    for (std::size_t e = 0; e < task_.goals.size(); ++e) {
      if (!moves(n, task_.goals[e])) continue;
      const double own = now_.weights[PARTS * e] * now_.weights[PARTS * e];
      const double* target = targets_ + TARGET_WIDTH * e;
      double away[3];
      for (int i = 0; i < 3; ++i) away[i] = target[i] - now_.points[3 * e + i];
      sum += own * dot(axis, away), weight += own;
    }
    if (weight > 0) delta_[node.dof] = sum / weight / node.gain;
  }
};

}  // namespace animtool::ik
