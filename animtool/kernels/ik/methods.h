// Textbook methods, for comparison: each repeats one kind of step from the start, until the goals
// are reached or progress ends. `Levels` is the solver to use.
#pragma once

#include "ik/attempt.h"
#include "ik/chain.h"

namespace animtool::ik {

class Method : public Solver, public Attempt {
 public:
  Method(const Task& task, const Settings& settings) : Attempt(task, settings) {}

  Outcome run(const double* start, const double* targets, const double* rest, bool) override {
    random_ = Random(settings_.seed);
    if (!open(start, targets, rest)) {
      outcome_.status = Status::BROKEN;
      return outcome_;
    }
    outcome_.descents = 1;
    begin(best_);
    prepare();
    outcome_.status = walk();
    return outcome_;
  }

  void review(const double* targets) override {
    targets_ = targets;
    evaluate(best_);
  }

  const State& best() const override { return best_; }

 protected:
  virtual void prepare() {}
  // Advances now_ by a step; returns false if there is none.
  virtual bool advance() = 0;

 private:
  // In this many steps the cost has to fall to this fraction.
  static constexpr int MAX_STALLED = 50;
  static constexpr double PROGRESS = 0.999;

  Status walk() {
    double marked = best_.cost;
    bool shaken = false;
    for (int since = 1;; ++since) {
      note();
      if (!(task_.rest_weight > 0) && reached(best_)) return Status::REACHED;
      if (spent()) return Status::BUDGET;
      ++outcome_.iterations;
      bool onward = advance();
      if (since % MAX_STALLED == 0) {
        onward = onward && std::min(now_.cost, best_.cost) <= PROGRESS * marked;
        marked = std::min(now_.cost, best_.cost);
      }
      if (onward) continue;
      note();
      if (reached(best_)) return Status::REACHED;
      if (shaken) return Status::STALLED;
      // Fully extended limbs are singular: perturbs the pose once.
      shaken = true;
      begin(best_);
      shake();
      prepare();
      since = 0, marked = now_.cost;
    }
  }

  // Some methods pass better poses than their last.
  void note() {
    if (now_.cost < best_.cost || (reached(now_) && !reached(best_))) best_ = now_;
  }
};

// Methods that use derivatives of the cost: steepest descent and Newton's method.

// Steepest descent. Steps are shortened until the cost falls by a fraction of the decrease that
// the gradient predicts (L. Armijo, Minimization of functions having Lipschitz continuous first
// partial derivatives, 1966), and clamped to the limits.
class Gradient : public Method {
 public:
  using Method::Method;

 protected:
  void prepare() override { length_ = 1; }

  bool advance() override {
    linearize(task_, targets_, rest_, now_, linear_);
    const std::vector<double>& slope = linear_.downhill;
    double steepest = 0;
    for (const double d : slope) steepest = std::max(steepest, std::fabs(d));
    if (!(steepest > 0)) return false;
    length_ = std::min(length_ / BACK / BACK, MAX_ROTATION / steepest);
    for (; length_ * steepest > MIN_ROTATION; length_ *= BACK) {
      for (std::size_t d = 0; d < slope.size(); ++d) delta_[d] = length_ * slope[d];
      stepper_.move(now_.q.data(), delta_.data(), next_.q.data());
      evaluate(next_);
      const double promised = promise();
      if (!(promised > 0) || !(now_.cost - next_.cost >= DECREASE * promised)) continue;
      std::swap(now_, next_);
      return true;
    }
    return false;
  }

 private:
  static constexpr double BACK = 0.5, DECREASE = 1e-4, MIN_ROTATION = 1e-14;

  // Decrease that the gradient predicts from now_ to next_, after clamping.
  double promise() {
    rest_pull(task_, now_.q.data(), next_.q.data(), 1, pull_.data());
    double sum = 0;
    for (std::size_t d = 0; d < pull_.size(); ++d) sum += pull_[d] * linear_.downhill[d];
    return sum;
  }

  double length_ = 1;
};

// Newton's method: the full Hessian, with second derivatives of positions and orientations, in a
// trust region so that the cost falls where it is not convex.
class Newton : public Method {
 public:
  using Method::Method;

 protected:
  void prepare() override { trusted_ = MAX_ROTATION; }

  bool advance() override {
    linearize(task_, targets_, rest_, now_, linear_);
    for (; trusted_ > MIN_ROTATION; trusted_ = SHRINK * stepper_.rotation()) {
      stepper_.step(now_, linear_, DAMPING, true, trusted_, delta_.data());
      const double gain = stepper_.predicted(now_, linear_, true, delta_.data());
      if (!(gain > MIN_GAIN * now_.cost)) return false;
      stepper_.move(now_.q.data(), delta_.data(), next_.q.data());
      evaluate(next_);
      const double ratio = (now_.cost - next_.cost) / gain;
      if (!(ratio > LEAST_RATIO)) continue;
      if (ratio > 0.5) trusted_ = std::min(GROW * trusted_, MAX_ROTATION);
      std::swap(now_, next_);
      return true;
    }
    return false;
  }

 private:
  static constexpr double DAMPING = 1e-12, MIN_ROTATION = 1e-10, MIN_GAIN = 1e-15;
  static constexpr double LEAST_RATIO = 1e-4, SHRINK = 0.3, GROW = 2.5;

  double trusted_ = MAX_ROTATION;
};

// Cyclic coordinate descent: each joint in turn, from the tips to the root, is set to the value
// that serves the goals best (L.-C. T. Wang, C. C. Chen, A combined optimization method for
// solving the inverse kinematics problem of mechanical manipulators, 1991).

class Cyclic : public Method {
 public:
  using Method::Method;

 protected:
  bool advance() override {
    const double before = now_.cost;
    const std::vector<Node>& nodes = task_.chain.nodes;
    for (std::size_t n = nodes.size(); n-- > 0;)
      if (!nodes[n].follows) rotate_joint(static_cast<int>(n));
    return now_.cost < before;
  }

 private:
  void rotate_joint(int n) {
    const Node& node = task_.chain.nodes[n];
    if (node.gain == 0) return;
    std::fill(delta_.begin(), delta_.end(), 0.0);
    if (node.kind == Kind::SLIDE)
      slide(n);
    else
      follow(node, &now_.frames.axes[9 * n], pull(n), delta_.data());
    stepper_.move(now_.q.data(), delta_.data(), next_.q.data());
    evaluate(next_);
    // Aim goals, and joints that follow this one, may be worse afterwards.
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
      const double squared_weight = weight_here * weight_here;
      const double* target = targets_ + TARGET_WIDTH * e + COLUMNS[part_of<Position>()];
      double away[3];
      for (int i = 0; i < 3; ++i) away[i] = target[i] - now_.points[3 * e + i];
      sum += squared_weight * dot(axis, away), weight += squared_weight;
    }
    if (weight > 0) delta_[node.dof] = sum / weight / node.gain;
  }
};

// FABRIK: points are moved to the targets bone by bone, inwards to the root and outwards again;
// then joints rotate towards the points as far as their axes and limits allow (A. Aristidou, J.
// Lasenby, FABRIK: a fast, iterative solver for the inverse kinematics problem, 2011). A point
// where branches join moves to the centroid of the positions they need.

class Fabrik : public Method {
 public:
  Fabrik(const Task& task, const Settings& settings)
      : Method(task, settings), desired_(3 * task.chain.nodes.size()), tips_(3 * task.goals.size()),
        asking_(task.chain.nodes.size()), bones_(task.chain.nodes.size()),
        next_(task.chain.nodes.size()), grips_(task.chain.nodes.size()) {}

 protected:
  // Collects the points that each joint rotates. A ball points at the next point on each
  // branch that does not coincide with it. A pin uses several points of each branch, because
  // the next one may be on its axis; so does the twist of a ball that carries a pin.
  void prepare() override {
    const std::vector<Node>& nodes = task_.chain.nodes;
    for (std::vector<Grip>& next : next_) next.clear();
    for (std::size_t e = 0; e < task_.goals.size(); ++e)
      next_[task_.goals[e].node].push_back({static_cast<int>(e), true});
    for (std::size_t n = nodes.size(); n-- > 0;) {
      bones_[n] = nodes[n].parent < 0 ? 0 : length(nodes[n].offset);
      if (nodes[n].parent < 0) continue;
      std::vector<Grip>& kept_grips = next_[nodes[n].parent];
      if (bones_[n] > NO_LENGTH)
        kept_grips.push_back({static_cast<int>(n), false});
      else
        kept_grips.insert(kept_grips.end(), next_[n].begin(), next_[n].end());
    }
    for (std::size_t n = 0; n < nodes.size(); ++n) {
      grips_[n].clear();
      hold(n, FORWARD, grips_[n]);
    }
  }

  bool advance() override {
    reach_in();
    reach_out();
    const std::size_t count = task_.chain.nodes.size();
    for (std::size_t n = 0; n < count; ++n) rotate_joint(static_cast<int>(n));
    evaluate(now_);
    return true;
  }

 private:
  static constexpr double NO_LENGTH = 1e-9;
  // Number of points along each branch that a pin considers.
  static constexpr int FORWARD = 8;

  struct Grip {
    int index;
    bool tip;  // the point of a goal, else the origin of a node
  };

  void hold(std::size_t n, int levels, std::vector<Grip>& kept_grips) const {
    for (const Grip& grip : next_[n]) {
      kept_grips.push_back(grip);
      if (!grip.tip && levels > 1) hold(grip.index, levels - 1, kept_grips);
    }
  }

  // Moves `from` to the bone's length from `to`.
  static void draw(const double* from, const double* to, double bone, double* out) {
    double along[3] = {from[0] - to[0], from[1] - to[1], from[2] - to[2]};
    const double distance = length(along);
    const double bone_ratio = distance > NO_LENGTH ? bone / distance : 0;
    for (int i = 0; i < 3; ++i) out[i] = to[i] + bone_ratio * along[i];
  }

  void ask(int node, const double* point, double bone) {
    double drawn[3];
    draw(&now_.frames.origins[3 * node], point, bone, drawn);
    for (int i = 0; i < 3; ++i) desired_[3 * node + i] += drawn[i];
    ++asking_[node];
  }

  void reach_in() {
    std::fill(desired_.begin(), desired_.end(), 0.0);
    std::fill(asking_.begin(), asking_.end(), 0);
    for (std::size_t e = 0; e < task_.goals.size(); ++e)
      if (now_.weights[PARTS * e + part_of<Position>()] > 0)
        ask(task_.goals[e].node, targets_ + TARGET_WIDTH * e + COLUMNS[part_of<Position>()], length(task_.goals[e].offset));
    for (std::size_t n = task_.chain.nodes.size(); n-- > 0;) {
      if (!asking_[n]) continue;
      for (int i = 0; i < 3; ++i) desired_[3 * n + i] /= asking_[n];
      const int parent = task_.chain.nodes[n].parent;
      if (parent >= 0) ask(parent, &desired_[3 * n], bones_[n]);
    }
  }

  void reach_out() {
    for (std::size_t n = 0; n < task_.chain.nodes.size(); ++n) {
      const int parent = task_.chain.nodes[n].parent;
      double* squared_weight = &desired_[3 * n];
      if (parent < 0 || !asking_[n])
        std::copy_n(&now_.frames.origins[3 * n], 3, squared_weight);
      else
        draw(squared_weight, &desired_[3 * parent], bones_[n], squared_weight);
    }
    for (std::size_t e = 0; e < task_.goals.size(); ++e) {
      const Goal& goal = task_.goals[e];
      const double* target = targets_ + TARGET_WIDTH * e + COLUMNS[part_of<Position>()];
      draw(target, &desired_[3 * goal.node], length(goal.offset), &tips_[3 * e]);
    }
  }

  // Rotates a joint so that the points it carries lie towards their desired positions.
  void rotate_joint(int n) {
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
    double* squared_weight = &now_.q[node.coordinate];
    Stepper::move(node, squared_weight, step, squared_weight);
    forward(task_.chain, now_.q.data(), n, n + 1, now_.frames);
  }

  // The frames of the points that a joint carries.
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
      const double* desired = grip.tip ? &tips_[3 * grip.index] : &desired_[3 * grip.index];
      if (!find(grip, point)) continue;
      for (int i = 0; i < 3; ++i) from[i] = point[i] - origin[i], to[i] = desired[i] - origin[i];
      sum.add(1, from, to);
    }
    return sum;
  }

  // The bone that is the twist axis of a ball that carries a pin.
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

  // Current position of a point; returns false if it has no desired position.
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

  std::vector<double> desired_;  // (N, 3): desired positions of the joints' origins
  std::vector<double> tips_;    // (E, 3): and of the goals' points
  std::vector<int> asking_;     // (N,): number of branches that move it
  std::vector<double> bones_;   // (N,): lengths from the parent
  std::vector<std::vector<Grip>> next_, grips_;
};

}  // namespace animtool::ik
