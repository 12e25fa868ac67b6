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
    outcome_.status = iterate();
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

  Status iterate() {
    double checkpoint_cost = best_.cost;
    bool perturbed = false;
    for (int steps = 1;; ++steps) {
      update_best();
      if (!(task_.rest_weight > 0) && reached(best_)) return Status::REACHED;
      if (spent()) return Status::BUDGET;
      ++outcome_.iterations;
      bool progresses = advance();
      if (steps % MAX_STALLED == 0) {
        progresses = progresses && std::min(now_.cost, best_.cost) <= PROGRESS * checkpoint_cost;
        checkpoint_cost = std::min(now_.cost, best_.cost);
      }
      if (progresses) continue;
      update_best();
      if (reached(best_)) return Status::REACHED;
      if (perturbed) return Status::STALLED;
      // Fully extended limbs are singular: perturbs the pose once.
      perturbed = true;
      begin(best_);
      perturb();
      prepare();
      steps = 0, checkpoint_cost = now_.cost;
    }
  }

  // Some methods pass better poses than their last.
  void update_best() {
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
      const double predicted = predicted_decrease();
      if (!(predicted > 0) || !(now_.cost - next_.cost >= DECREASE * predicted)) continue;
      std::swap(now_, next_);
      return true;
    }
    return false;
  }

 private:
  static constexpr double BACK = 0.5, DECREASE = 1e-4, MIN_ROTATION = 1e-14;

  // Decrease that the gradient predicts from now_ to next_, after clamping.
  double predicted_decrease() {
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
  void prepare() override { trust_radius_ = MAX_ROTATION; }

  bool advance() override {
    linearize(task_, targets_, rest_, now_, linear_);
    for (; trust_radius_ > MIN_ROTATION; trust_radius_ = SHRINK * stepper_.rotation()) {
      stepper_.step(now_, linear_, DAMPING, true, trust_radius_, delta_.data());
      const double gain = stepper_.predicted(now_, linear_, true, delta_.data());
      if (!(gain > MIN_GAIN * now_.cost)) return false;
      stepper_.move(now_.q.data(), delta_.data(), next_.q.data());
      evaluate(next_);
      const double ratio = (now_.cost - next_.cost) / gain;
      if (!(ratio > MIN_RATIO)) continue;
      if (ratio > 0.5) trust_radius_ = std::min(GROW * trust_radius_, MAX_ROTATION);
      std::swap(now_, next_);
      return true;
    }
    return false;
  }

 private:
  static constexpr double DAMPING = 1e-12, MIN_ROTATION = 1e-10, MIN_GAIN = 1e-15;
  static constexpr double MIN_RATIO = 1e-4, SHRINK = 0.3, GROW = 2.5;

  double trust_radius_ = MAX_ROTATION;
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
      : Method(task, settings),
        desired_(3 * task.chain.nodes.size()),
        tips_(3 * task.goals.size()),
        request_counts_(task.chain.nodes.size()),
        bones_(task.chain.nodes.size()),
        next_(task.chain.nodes.size()),
        rotated_(task.chain.nodes.size()) {}

 protected:
  // Collects the points that each joint rotates. A ball points at the next point on each
  // branch that does not coincide with it. A pin uses several points of each branch, because
  // the next one may be on its axis; so does the twist of a ball that carries a pin.
  void prepare() override {
    const std::vector<Node>& nodes = task_.chain.nodes;
    for (std::vector<RotatedPoint>& next : next_) next.clear();
    for (std::size_t e = 0; e < task_.goals.size(); ++e)
      next_[task_.goals[e].node].push_back({static_cast<int>(e), true});
    for (std::size_t n = nodes.size(); n-- > 0;) {
      bones_[n] = nodes[n].parent < 0 ? 0 : length(nodes[n].offset);
      if (nodes[n].parent < 0) continue;
      std::vector<RotatedPoint>& points = next_[nodes[n].parent];
      if (bones_[n] > MIN_LENGTH)
        points.push_back({static_cast<int>(n), false});
      else
        points.insert(points.end(), next_[n].begin(), next_[n].end());
    }
    for (std::size_t n = 0; n < nodes.size(); ++n) {
      rotated_[n].clear();
      collect(n, MAX_POINTS, rotated_[n]);
    }
  }

  bool advance() override {
    inward_pass();
    outward_pass();
    const std::size_t count = task_.chain.nodes.size();
    for (std::size_t n = 0; n < count; ++n) rotate_joint(static_cast<int>(n));
    evaluate(now_);
    return true;
  }

 private:
  static constexpr double MIN_LENGTH = 1e-9;
  // Number of points along each branch that a pin considers.
  static constexpr int MAX_POINTS = 8;

  struct RotatedPoint {
    int index;
    bool tip;  // the point of a goal, else the origin of a node
  };

  void collect(std::size_t n, int levels, std::vector<RotatedPoint>& points) const {
    for (const RotatedPoint& rotated : next_[n]) {
      points.push_back(rotated);
      if (!rotated.tip && levels > 1) collect(rotated.index, levels - 1, points);
    }
  }

  // Moves `from` to the bone's length from `to`.
  static void at_bone_length(const double* from, const double* to, double bone, double* out) {
    double along[3] = {from[0] - to[0], from[1] - to[1], from[2] - to[2]};
    const double distance = length(along);
    const double bone_ratio = distance > MIN_LENGTH ? bone / distance : 0;
    for (int i = 0; i < 3; ++i) out[i] = to[i] + bone_ratio * along[i];
  }

  void add_request(int node, const double* point, double bone) {
    double moved[3];
    at_bone_length(&now_.frames.origins[3 * node], point, bone, moved);
    for (int i = 0; i < 3; ++i) desired_[3 * node + i] += moved[i];
    ++request_counts_[node];
  }

  void inward_pass() {
    std::fill(desired_.begin(), desired_.end(), 0.0);
    std::fill(request_counts_.begin(), request_counts_.end(), 0);
    for (std::size_t e = 0; e < task_.goals.size(); ++e)
      if (now_.weights[PARTS * e + part_of<Position>()] > 0)
        add_request(task_.goals[e].node, targets_ + TARGET_WIDTH * e + COLUMNS[part_of<Position>()],
                    length(task_.goals[e].offset));
    for (std::size_t n = task_.chain.nodes.size(); n-- > 0;) {
      if (!request_counts_[n]) continue;
      for (int i = 0; i < 3; ++i) desired_[3 * n + i] /= request_counts_[n];
      const int parent = task_.chain.nodes[n].parent;
      if (parent >= 0) add_request(parent, &desired_[3 * n], bones_[n]);
    }
  }

  void outward_pass() {
    for (std::size_t n = 0; n < task_.chain.nodes.size(); ++n) {
      const int parent = task_.chain.nodes[n].parent;
      double* position = &desired_[3 * n];
      if (parent < 0 || !request_counts_[n])
        std::copy_n(&now_.frames.origins[3 * n], 3, position);
      else
        at_bone_length(position, &desired_[3 * parent], bones_[n], position);
    }
    for (std::size_t e = 0; e < task_.goals.size(); ++e) {
      const Goal& goal = task_.goals[e];
      const double* target = targets_ + TARGET_WIDTH * e + COLUMNS[part_of<Position>()];
      at_bone_length(target, &desired_[3 * goal.node], length(goal.offset), &tips_[3 * e]);
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
    follow(node, axes, pull(n, ball ? next_[n] : rotated_[n]), delta_.data());
    std::copy_n(&delta_[node.dof], node.width(), step);
    apply(n, step);
    double axis[3];
    if (!ball) return;
    update(n);
    if (!find_twist_axis(n, axis)) return;
    const double angle = pull(n, rotated_[n]).angle(axis);
    for (int k = 0; k < 3; ++k) step[k] = angle * dot(axis, axes + 3 * k);
    apply(n, step);
  }

  void apply(int n, const double* step) {
    const Node& node = task_.chain.nodes[n];
    double* values = &now_.q[node.coordinate];
    Stepper::move(node, values, step, values);
    forward(task_.chain, now_.q.data(), n, n + 1, now_.frames);
  }

  // The frames of the points that a joint carries.
  void update(int n) {
    std::size_t end = n + 1;
    for (const RotatedPoint& rotated : rotated_[n])
      end = std::max<std::size_t>(
          end, (rotated.tip ? task_.goals[rotated.index].node : rotated.index) + 1);
    forward(task_.chain, now_.q.data(), n, end, now_.frames);
  }

  Pull pull(int n, const std::vector<RotatedPoint>& points) const {
    const double* origin = &now_.frames.origins[3 * n];
    Pull sum;
    for (const RotatedPoint& rotated : points) {
      double point[3], from[3], to[3];
      const double* desired =
          rotated.tip ? &tips_[3 * rotated.index] : &desired_[3 * rotated.index];
      if (!find(rotated, point)) continue;
      for (int i = 0; i < 3; ++i) from[i] = point[i] - origin[i], to[i] = desired[i] - origin[i];
      sum.add(1, from, to);
    }
    return sum;
  }

  // The bone that is the twist axis of a ball that carries a pin.
  bool find_twist_axis(int n, double* axis) const {
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
  bool find(const RotatedPoint& rotated, double* point) const {
    if (!rotated.tip) {
      std::copy_n(&now_.frames.origins[3 * rotated.index], 3, point);
      return request_counts_[rotated.index] > 0;
    }
    const Goal& goal = task_.goals[rotated.index];
    rotate(&now_.frames.rotations[9 * goal.node], goal.offset, point);
    for (int i = 0; i < 3; ++i) point[i] += now_.frames.origins[3 * goal.node + i];
    return now_.weights[PARTS * rotated.index + part_of<Position>()] > 0;
  }

  std::vector<double> desired_;      // (N, 3): desired positions of the joints' origins
  std::vector<double> tips_;         // (E, 3): and of the goals' points
  std::vector<int> request_counts_;  // (N,): number of branches that move it
  std::vector<double> bones_;        // (N,): lengths from the parent
  std::vector<std::vector<RotatedPoint>> next_, rotated_;
};

}  // namespace animtool::ik
