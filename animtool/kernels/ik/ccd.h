// Cyclic coordinate descent: joint by joint, from the tips to the root, each to where it
// serves the goals best by itself (L.-C. T. Wang, C. C. Chen, A combined optimization
// method for solving the inverse kinematics problem of mechanical manipulators, 1991).
#pragma once

#include "ik/method.h"
#include "ik/turns.h"

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
      const View view = view_of(goal, now_, point);
      each_kind([&]<class Kind>(int part) {
        if constexpr (Pulling<Kind>)
          if (weights[part] > 0)
            Kind::pull(weights[part] * weights[part], view, target + COLUMNS[part], origin, sum);
      });
    }
    return sum;
  }

  void slide(int n) {
    const Node& node = task_.chain.nodes[n];
    const double* axis = &now_.frames.axes[9 * n];
    double sum = 0, weight = 0;
    for (std::size_t e = 0; e < task_.goals.size(); ++e) {
      if (!moves(n, task_.goals[e])) continue;
      const double weight_here = now_.weights[PARTS * e + part_of<Position>()];
      const double own = weight_here * weight_here;
      const double* target = targets_ + TARGET_WIDTH * e + COLUMNS[part_of<Position>()];
      double away[3];
      for (int i = 0; i < 3; ++i) away[i] = target[i] - now_.points[3 * e + i];
      sum += own * dot(axis, away), weight += own;
    }
    if (weight > 0) delta_[node.dof] = sum / weight / node.gain;
  }
};

}  // namespace animtool::ik
