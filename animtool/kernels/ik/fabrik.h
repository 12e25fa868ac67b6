// FABRIK: points are drawn to the targets bone by bone, inwards to the root and out again,
// then the joints turn after them as far as their axes and limits let them (A. Aristidou,
// J. Lasenby, FABRIK: a fast, iterative solver for the inverse kinematics problem, 2011).
// Where branches meet, the point is drawn to the centroid of what they ask.
#pragma once

#include "ik/method.h"
#include "ik/turns.h"

namespace animtool::ik {

class Fabrik : public Method {
 public:
  Fabrik(const Task& task, const Settings& settings)
      : Method(task, settings), wanted_(3 * task.chain.nodes.size()), tips_(3 * task.goals.size()),
        asking_(task.chain.nodes.size()), bones_(task.chain.nodes.size()),
        next_(task.chain.nodes.size()), grips_(task.chain.nodes.size()) {}

 protected:
  // Which points each joint turns: of a ball the next on every branch that are not in
  // its own place, which it can point at; of a pin some behind them as well, for the next
  // may be on its axis. So for the twist of a ball that carries a pin.
  void prepare() override {
    const std::vector<Node>& nodes = task_.chain.nodes;
    for (std::vector<Grip>& next : next_) next.clear();
    for (std::size_t e = 0; e < task_.goals.size(); ++e)
      next_[task_.goals[e].node].push_back({static_cast<int>(e), true});
    for (std::size_t n = nodes.size(); n-- > 0;) {
      bones_[n] = nodes[n].parent < 0 ? 0 : length(nodes[n].offset);
      if (nodes[n].parent < 0) continue;
      std::vector<Grip>& held = next_[nodes[n].parent];
      if (bones_[n] > NO_LENGTH)
        held.push_back({static_cast<int>(n), false});
      else
        held.insert(held.end(), next_[n].begin(), next_[n].end());
    }
    for (std::size_t n = 0; n < nodes.size(); ++n) {
      grips_[n].clear();
      hold(n, AHEAD, grips_[n]);
    }
  }

  bool advance() override {
    reach_in();
    reach_out();
    const std::size_t count = task_.chain.nodes.size();
    for (std::size_t n = 0; n < count; ++n) turn(static_cast<int>(n));
    evaluate(now_);
    return true;
  }

 private:
  static constexpr double NO_LENGTH = 1e-9;
  // How many points along each branch a pin looks at.
  static constexpr int AHEAD = 8;

  struct Grip {
    int index;
    bool tip;  // of a goal, or else the origin of a node
  };

  void hold(std::size_t n, int ahead, std::vector<Grip>& held) const {
    for (const Grip& grip : next_[n]) {
      held.push_back(grip);
      if (!grip.tip && ahead > 1) hold(grip.index, ahead - 1, held);
    }
  }

  // `from` as far from `to` as the bone is long.
  static void draw(const double* from, const double* to, double bone, double* out) {
    double way[3] = {from[0] - to[0], from[1] - to[1], from[2] - to[2]};
    const double distance = length(way);
    const double share = distance > NO_LENGTH ? bone / distance : 0;
    for (int i = 0; i < 3; ++i) out[i] = to[i] + share * way[i];
  }

  void ask(int node, const double* point, double bone) {
    double drawn[3];
    draw(&now_.frames.origins[3 * node], point, bone, drawn);
    for (int i = 0; i < 3; ++i) wanted_[3 * node + i] += drawn[i];
    ++asking_[node];
  }

  void reach_in() {
    std::fill(wanted_.begin(), wanted_.end(), 0.0);
    std::fill(asking_.begin(), asking_.end(), 0);
    for (std::size_t e = 0; e < task_.goals.size(); ++e)
      if (now_.weights[PARTS * e + part_of<Position>()] > 0)
        ask(task_.goals[e].node, targets_ + TARGET_WIDTH * e + COLUMNS[part_of<Position>()], length(task_.goals[e].offset));
    for (std::size_t n = task_.chain.nodes.size(); n-- > 0;) {
      if (!asking_[n]) continue;
      for (int i = 0; i < 3; ++i) wanted_[3 * n + i] /= asking_[n];
      const int parent = task_.chain.nodes[n].parent;
      if (parent >= 0) ask(parent, &wanted_[3 * n], bones_[n]);
    }
  }

  void reach_out() {
    for (std::size_t n = 0; n < task_.chain.nodes.size(); ++n) {
      const int parent = task_.chain.nodes[n].parent;
      double* own = &wanted_[3 * n];
      if (parent < 0 || !asking_[n])
        std::copy_n(&now_.frames.origins[3 * n], 3, own);
      else
        draw(own, &wanted_[3 * parent], bones_[n], own);
    }
    for (std::size_t e = 0; e < task_.goals.size(); ++e) {
      const Goal& goal = task_.goals[e];
      const double* target = targets_ + TARGET_WIDTH * e + COLUMNS[part_of<Position>()];
      draw(target, &wanted_[3 * goal.node], length(goal.offset), &tips_[3 * e]);
    }
  }

  // Turns a joint so that the points it holds lie towards where they were drawn.
  void turn(int n) {
    const Node& node = task_.chain.nodes[n];
    update(n);
    if (node.follows || node.gain == 0) return;
    const double* axes = &now_.frames.axes[9 * n];
    double step[3] = {0, 0, 0};
    const bool ball = node.kind == Kind::BALL;
    std::fill_n(&delta_[node.dof], node.width(), 0.0);
    follow(node, axes, pull(n, ball ? next_[n] : grips_[n]), delta_.data());
    std::copy_n(&delta_[node.dof], node.width(), step);
    apply(n, step);
    double axis[3];
    if (!ball) return;
    update(n);
    if (!twists(n, axis)) return;
    const double angle = pull(n, grips_[n]).angle(axis);
    for (int k = 0; k < 3; ++k) step[k] = angle * dot(axis, axes + 3 * k);
    apply(n, step);
  }

  void apply(int n, const double* step) {
    const Node& node = task_.chain.nodes[n];
    double* own = &now_.q[node.coordinate];
    Stepper::move(node, own, step, own);
    forward(task_.chain, now_.q.data(), n, n + 1, now_.frames);
  }

  // The frames of the points that a joint holds.
  void update(int n) {
    std::size_t end = n + 1;
    for (const Grip& grip : grips_[n])
      end = std::max<std::size_t>(end, (grip.tip ? task_.goals[grip.index].node : grip.index) + 1);
    forward(task_.chain, now_.q.data(), n, end, now_.frames);
  }

  Pull pull(int n, const std::vector<Grip>& grips) const {
    const double* origin = &now_.frames.origins[3 * n];
    Pull sum;
    for (const Grip& grip : grips) {
      double point[3], from[3], to[3];
      const double* wanted = grip.tip ? &tips_[3 * grip.index] : &wanted_[3 * grip.index];
      if (!find(grip, point)) continue;
      for (int i = 0; i < 3; ++i) from[i] = point[i] - origin[i], to[i] = wanted[i] - origin[i];
      sum.add(1, from, to);
    }
    return sum;
  }

  // The bone about which a ball that carries a pin twists.
  bool twists(int n, double* axis) const {
    if (next_[n].size() != 1 || next_[n][0].tip) return false;
    const int next = next_[n][0].index;
    if (task_.chain.nodes[next].kind != Kind::PIN) return false;
    for (int i = 0; i < 3; ++i)
      axis[i] = now_.frames.origins[3 * next + i] - now_.frames.origins[3 * n + i];
    const double size = length(axis);
    for (int i = 0; i < 3; ++i) axis[i] /= size;
    return true;
  }

  // Where a point is now; false where nothing is asked of it.
  bool find(const Grip& grip, double* point) const {
    if (!grip.tip) {
      std::copy_n(&now_.frames.origins[3 * grip.index], 3, point);
      return asking_[grip.index] > 0;
    }
    const Goal& goal = task_.goals[grip.index];
    rotate(&now_.frames.rotations[9 * goal.node], goal.offset, point);
    for (int i = 0; i < 3; ++i) point[i] += now_.frames.origins[3 * goal.node + i];
    return now_.weights[PARTS * grip.index + part_of<Position>()] > 0;
  }

  std::vector<double> wanted_;  // (N, 3): where the joints' origins are drawn to
  std::vector<double> tips_;    // (E, 3): and the goals' points
  std::vector<int> asking_;     // (N,): how many ask something of it
  std::vector<double> bones_;   // (N,): lengths from the parent
  std::vector<std::vector<Grip>> next_, grips_;
};

}  // namespace animtool::ik
