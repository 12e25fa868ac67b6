// Textbook methods, for comparison: each repeats one kind of step from the start until the goals
// are reached or progress ends. `PrioritySolver` is the solver to use.
#pragma once

#include "ik/attempt.h"
#include "ik/chain.h"

namespace animtool::ik {

// Base of the textbook methods: iterates, and perturbs the pose once if progress ends.
class Method : public Solver, public SolverState {
 public:
  Method(const Task& task, const Settings& settings) : SolverState(task, settings) {}

  Outcome run(const double* start, const double* targets, const double* rest, bool) override {
    random_ = Random(settings_.seed);
    if (!begin_problem(start, targets, rest)) {
      outcome_.status = Status::NOT_FINITE;
      return outcome_;
    }
    outcome_.descent_count = 1;
    set_current(best_);
    prepare();
    outcome_.status = iterate();
    return outcome_;
  }

  void reevaluate(const double* targets) override {
    targets_ = targets;
    evaluate(best_);
  }

  const State& best() const override { return best_; }

 protected:
  // Called before the first step, and after a perturbation.
  virtual void prepare() {}
  // Advances the current pose by a step; returns false if there is none.
  virtual bool advance() = 0;

 private:
  // In this many steps the cost has to fall to this fraction.
  static constexpr int PROGRESS_STEPS = 50;
  static constexpr double PROGRESS_RATIO = 0.999;

  Status iterate() {
    double checkpoint_cost = best_.cost;
    bool is_perturbed = false;
    for (int steps = 1;; ++steps) {
      update_best();
      if (!(task_.rest_weight > 0) && is_reached(best_)) return Status::REACHED;
      if (is_budget_spent()) return Status::BUDGET;
      ++outcome_.iterations;
      bool is_progressing = advance();
      if (steps % PROGRESS_STEPS == 0) {
        is_progressing = is_progressing &&
                         std::min(current_.cost, best_.cost) <= PROGRESS_RATIO * checkpoint_cost;
        checkpoint_cost = std::min(current_.cost, best_.cost);
      }
      if (is_progressing) continue;
      update_best();
      if (is_reached(best_)) return Status::REACHED;
      if (is_perturbed) return Status::STALLED;
      // Fully extended limbs are singular: perturb the pose once.
      is_perturbed = true;
      set_current(best_);
      perturb();
      prepare();
      steps = 0, checkpoint_cost = current_.cost;
    }
  }

  // Some methods pass through better poses than their last one.
  void update_best() {
    if (current_.cost < best_.cost || (is_reached(current_) && !is_reached(best_)))
      best_ = current_;
  }
};

// Steepest descent. Steps are clamped to the limits, and shortened until the cost falls by a
// fraction of the decrease that the gradient predicts (L. Armijo, Minimization of functions having
// Lipschitz continuous first partial derivatives, 1966).
class Gradient : public Method {
 public:
  using Method::Method;

 protected:
  void prepare() override { step_length_ = 1; }

  bool advance() override {
    linearize(task_, targets_, rest_, current_, linear_);
    const std::vector<double>& negative_gradient = linear_.negative_gradient;
    double largest = 0;
    for (const double d : negative_gradient) largest = std::max(largest, std::fabs(d));
    if (!(largest > 0)) return false;
    step_length_ =
        std::min(step_length_ / STEP_SHORTENING / STEP_SHORTENING, MAX_ROTATION / largest);
    for (; step_length_ * largest > MIN_ROTATION; step_length_ *= STEP_SHORTENING) {
      for (std::size_t d = 0; d < negative_gradient.size(); ++d)
        delta_[d] = step_length_ * negative_gradient[d];
      stepper_.move(current_.q.data(), delta_.data(), next_.q.data());
      evaluate(next_);
      const double predicted = predicted_decrease();
      if (!(predicted > 0) || !(current_.cost - next_.cost >= MIN_DECREASE_RATIO * predicted))
        continue;
      std::swap(current_, next_);
      return true;
    }
    return false;
  }

 private:
  static constexpr double STEP_SHORTENING = 0.5, MIN_DECREASE_RATIO = 1e-4, MIN_ROTATION = 1e-14;

  // Decrease that the gradient predicts for the step to next_, after clamping.
  double predicted_decrease() {
    evaluate_rest(task_, current_.q.data(), next_.q.data(), 1, negative_rest_gradient_.data());
    double sum = 0;
    for (std::size_t d = 0; d < negative_rest_gradient_.size(); ++d)
      sum += negative_rest_gradient_[d] * linear_.negative_gradient[d];
    return sum;
  }

  double step_length_ = 1;
};

// Newton's method with the full Hessian, with second derivatives of positions and orientations. A
// trust region makes the cost fall where it is not convex.
class Newton : public Method {
 public:
  using Method::Method;

 protected:
  void prepare() override { trust_radius_ = MAX_ROTATION; }

  bool advance() override {
    linearize(task_, targets_, rest_, current_, linear_);
    for (; trust_radius_ > MIN_ROTATION; trust_radius_ = RADIUS_SHRINK * stepper_.step_rotation()) {
      stepper_.step(current_, linear_, DAMPING, true, trust_radius_, delta_.data());
      const double gain = stepper_.predicted_gain(current_, linear_, true, delta_.data());
      if (!(gain > MIN_GAIN * current_.cost)) return false;
      stepper_.move(current_.q.data(), delta_.data(), next_.q.data());
      evaluate(next_);
      const double ratio = (current_.cost - next_.cost) / gain;
      if (!(ratio > MIN_RATIO)) continue;
      if (ratio > 0.5) trust_radius_ = std::min(RADIUS_GROWTH * trust_radius_, MAX_ROTATION);
      std::swap(current_, next_);
      return true;
    }
    return false;
  }

 private:
  static constexpr double DAMPING = 1e-12, MIN_ROTATION = 1e-10, MIN_GAIN = 1e-15;
  static constexpr double MIN_RATIO = 1e-4, RADIUS_SHRINK = 0.3, RADIUS_GROWTH = 2.5;

  double trust_radius_ = MAX_ROTATION;
};

// Cyclic coordinate descent: one joint after the other, from the tips to the root, is set to the
// value that serves the goals best (L.-C. T. Wang, C. C. Chen, A combined optimization method for
// solving the inverse kinematics problem of mechanical manipulators, 1991).

class CyclicDescent : public Method {
 public:
  using Method::Method;

 protected:
  bool advance() override {
    const double previous_cost = current_.cost;
    const std::vector<Node>& nodes = task_.chain.nodes;
    for (std::size_t n = nodes.size(); n-- > 0;)
      if (!nodes[n].is_driven) rotate_joint(static_cast<int>(n));
    return current_.cost < previous_cost;
  }

 private:
  void rotate_joint(int n) {
    const Node& node = task_.chain.nodes[n];
    if (node.gain == 0) return;
    std::fill(delta_.begin(), delta_.end(), 0.0);
    if (node.kind == Kind::SLIDE)
      translate_joint(n);
    else
      apply_alignment(node, &current_.frames.axes[9 * n], sum_alignment(n), delta_.data());
    stepper_.move(current_.q.data(), delta_.data(), next_.q.data());
    evaluate(next_);
    // Aim goals, and goals of joints that follow this one, may be worse afterwards.
    if (next_.cost < current_.cost) std::swap(current_, next_);
  }

  // Whether a node moves a goal.
  bool is_moved_by(int n, const Goal& goal) const {
    return std::binary_search(goal.path.begin(), goal.path.end(), n);
  }

  // Sums over the goals that a joint rotates.
  AlignmentSums sum_alignment(int n) const {
    AlignmentSums sums;
    const double* origin = &current_.frames.origins[3 * n];
    for (std::size_t e = 0; e < task_.goals.size(); ++e) {
      const Goal& goal = task_.goals[e];
      if (!is_moved_by(n, goal)) continue;
      const double* target = targets_ + TARGET_WIDTH * e;
      const double* point = &current_.points[3 * e];
      const double* weights = &current_.weights[COMPONENT_COUNT * e];
      const GoalView view = view_of(goal, current_, point);
      for_each_kind([&]<class Kind>(int component) {
        if constexpr (Alignable<Kind>)
          if (weights[component] > 0)
            Kind::add_alignment(weights[component] * weights[component], view,
                                target + TARGET_OFFSETS[component], origin, sums);
      });
    }
    return sums;
  }

  // Computes the best step of a slide.
  void translate_joint(int n) {
    const Node& node = task_.chain.nodes[n];
    const double* axis = &current_.frames.axes[9 * n];
    double sum = 0, weight_sum = 0;
    for (std::size_t e = 0; e < task_.goals.size(); ++e) {
      if (!is_moved_by(n, task_.goals[e])) continue;
      const double goal_weight = current_.weights[COMPONENT_COUNT * e + component_of<Position>()];
      const double squared_weight = goal_weight * goal_weight;
      const double* target = targets_ + TARGET_WIDTH * e + TARGET_OFFSETS[component_of<Position>()];
      double offset[3];
      for (int i = 0; i < 3; ++i) offset[i] = target[i] - current_.points[3 * e + i];
      sum += squared_weight * dot(axis, offset), weight_sum += squared_weight;
    }
    if (weight_sum > 0) delta_[node.dof] = sum / weight_sum / node.gain;
  }
};

// FABRIK: points are moved to the targets bone by bone, inwards to the root and outwards again.
// Then joints rotate towards the points as far as their axes and limits allow (A. Aristidou, J.
// Lasenby, FABRIK: a fast, iterative solver for the inverse kinematics problem, 2011). A point
// where branches join moves to the centroid of the positions that they need.

class Fabrik : public Method {
 public:
  Fabrik(const Task& task, const Settings& settings)
      : Method(task, settings),
        desired_points_(3 * task.chain.nodes.size()),
        goal_points_(3 * task.goals.size()),
        request_counts_(task.chain.nodes.size()),
        bone_lengths_(task.chain.nodes.size()),
        next_points_(task.chain.nodes.size()),
        rotated_points_(task.chain.nodes.size()) {}

 protected:
  // Collects the points that each joint rotates. A ball rotates the next point on each branch that
  // does not coincide with it. A pin rotates several points of each branch, because the next one
  // may be on its axis; so does the twist of a ball with a pin after it.
  void prepare() override {
    const std::vector<Node>& nodes = task_.chain.nodes;
    for (std::vector<RotatedPoint>& points : next_points_) points.clear();
    for (std::size_t e = 0; e < task_.goals.size(); ++e)
      next_points_[task_.goals[e].node].push_back({static_cast<int>(e), true});
    for (std::size_t n = nodes.size(); n-- > 0;) {
      bone_lengths_[n] = nodes[n].parent < 0 ? 0 : length(nodes[n].offset);
      if (nodes[n].parent < 0) continue;
      std::vector<RotatedPoint>& points = next_points_[nodes[n].parent];
      if (bone_lengths_[n] > MIN_LENGTH)
        points.push_back({static_cast<int>(n), false});
      else
        points.insert(points.end(), next_points_[n].begin(), next_points_[n].end());
    }
    for (std::size_t n = 0; n < nodes.size(); ++n) {
      rotated_points_[n].clear();
      collect_points(n, MAX_BRANCH_POINTS, rotated_points_[n]);
    }
  }

  bool advance() override {
    inward_pass();
    outward_pass();
    const std::size_t count = task_.chain.nodes.size();
    for (std::size_t n = 0; n < count; ++n) rotate_joint(static_cast<int>(n));
    evaluate(current_);
    return true;
  }

 private:
  static constexpr double MIN_LENGTH = 1e-9;
  // Largest number of points on each branch that a pin considers.
  static constexpr int MAX_BRANCH_POINTS = 8;

  // The point of a goal, or the origin of a node.
  struct RotatedPoint {
    int index;
    bool is_goal;  // the point of a goal, else the origin of a node
  };

  void collect_points(std::size_t n, int depth, std::vector<RotatedPoint>& points) const {
    for (const RotatedPoint& rotated_point : next_points_[n]) {
      points.push_back(rotated_point);
      if (!rotated_point.is_goal && depth > 1)
        collect_points(rotated_point.index, depth - 1, points);
    }
  }

  // Moves a point to the length of a bone from another point.
  static void point_at_length(const double* from, const double* to, double bone_length,
                              double* out) {
    double offset[3] = {from[0] - to[0], from[1] - to[1], from[2] - to[2]};
    const double distance = length(offset);
    const double ratio = distance > MIN_LENGTH ? bone_length / distance : 0;
    for (int i = 0; i < 3; ++i) out[i] = to[i] + ratio * offset[i];
  }

  // Adds the position that a branch needs for a node.
  void add_request(int node, const double* point, double bone_length) {
    double position[3];
    point_at_length(&current_.frames.origins[3 * node], point, bone_length, position);
    for (int i = 0; i < 3; ++i) desired_points_[3 * node + i] += position[i];
    ++request_counts_[node];
  }

  void inward_pass() {
    std::fill(desired_points_.begin(), desired_points_.end(), 0.0);
    std::fill(request_counts_.begin(), request_counts_.end(), 0);
    for (std::size_t e = 0; e < task_.goals.size(); ++e)
      if (current_.weights[COMPONENT_COUNT * e + component_of<Position>()] > 0)
        add_request(task_.goals[e].node,
                    targets_ + TARGET_WIDTH * e + TARGET_OFFSETS[component_of<Position>()],
                    length(task_.goals[e].offset));
    for (std::size_t n = task_.chain.nodes.size(); n-- > 0;) {
      if (!request_counts_[n]) continue;
      for (int i = 0; i < 3; ++i) desired_points_[3 * n + i] /= request_counts_[n];
      const int parent = task_.chain.nodes[n].parent;
      if (parent >= 0) add_request(parent, &desired_points_[3 * n], bone_lengths_[n]);
    }
  }

  void outward_pass() {
    for (std::size_t n = 0; n < task_.chain.nodes.size(); ++n) {
      const int parent = task_.chain.nodes[n].parent;
      double* position = &desired_points_[3 * n];
      if (parent < 0 || !request_counts_[n])
        std::copy_n(&current_.frames.origins[3 * n], 3, position);
      else
        point_at_length(position, &desired_points_[3 * parent], bone_lengths_[n], position);
    }
    for (std::size_t e = 0; e < task_.goals.size(); ++e) {
      const Goal& goal = task_.goals[e];
      const double* target = targets_ + TARGET_WIDTH * e + TARGET_OFFSETS[component_of<Position>()];
      point_at_length(target, &desired_points_[3 * goal.node], length(goal.offset),
                      &goal_points_[3 * e]);
    }
  }

  // Rotates a joint so that the points after it come closer to their desired positions.
  void rotate_joint(int n) {
    const Node& node = task_.chain.nodes[n];
    update_frames(n);
    if (node.is_driven || node.gain == 0) return;
    const double* axes = &current_.frames.axes[9 * n];
    double step[3] = {0, 0, 0};
    const bool is_ball = node.kind == Kind::BALL;
    std::fill_n(&delta_[node.dof], node.dof_count(), 0.0);
    apply_alignment(node, axes, sum_alignment(n, is_ball ? next_points_[n] : rotated_points_[n]),
                    delta_.data());
    std::copy_n(&delta_[node.dof], node.dof_count(), step);
    apply_step(n, step);
    double axis[3];
    if (!is_ball) return;
    update_frames(n);
    if (!find_twist_axis(n, axis)) return;
    const double angle = sum_alignment(n, rotated_points_[n]).angle(axis);
    for (int k = 0; k < 3; ++k) step[k] = angle * dot(axis, axes + 3 * k);
    apply_step(n, step);
  }

  void apply_step(int n, const double* step) {
    const Node& node = task_.chain.nodes[n];
    double* values = &current_.q[node.coordinate];
    Stepper::move(node, values, step, values);
    compute_frames(task_.chain, current_.q.data(), n, n + 1, current_.frames);
  }

  // Updates the frames of the points that a joint rotates.
  void update_frames(int n) {
    std::size_t end = n + 1;
    for (const RotatedPoint& rotated_point : rotated_points_[n])
      end = std::max<std::size_t>(
          end,
          (rotated_point.is_goal ? task_.goals[rotated_point.index].node : rotated_point.index) +
              1);
    compute_frames(task_.chain, current_.q.data(), n, end, current_.frames);
  }

  AlignmentSums sum_alignment(int n, const std::vector<RotatedPoint>& points) const {
    const double* origin = &current_.frames.origins[3 * n];
    AlignmentSums sums;
    for (const RotatedPoint& rotated_point : points) {
      double point[3], from[3], to[3];
      const double* desired_point = rotated_point.is_goal
                                        ? &goal_points_[3 * rotated_point.index]
                                        : &desired_points_[3 * rotated_point.index];
      if (!find_point(rotated_point, point)) continue;
      for (int i = 0; i < 3; ++i)
        from[i] = point[i] - origin[i], to[i] = desired_point[i] - origin[i];
      sums.add(1, from, to);
    }
    return sums;
  }

  // Computes the bone that is the twist axis of a ball with a pin after it; returns false if there
  // is none.
  bool find_twist_axis(int n, double* axis) const {
    if (next_points_[n].size() != 1 || next_points_[n][0].is_goal) return false;
    const int next_node = next_points_[n][0].index;
    if (task_.chain.nodes[next_node].kind != Kind::PIN) return false;
    for (int i = 0; i < 3; ++i)
      axis[i] = current_.frames.origins[3 * next_node + i] - current_.frames.origins[3 * n + i];
    const double bone_length = length(axis);
    for (int i = 0; i < 3; ++i) axis[i] /= bone_length;
    return true;
  }

  // Computes the current position of a point; returns false if it has no desired position.
  bool find_point(const RotatedPoint& rotated_point, double* point) const {
    if (!rotated_point.is_goal) {
      std::copy_n(&current_.frames.origins[3 * rotated_point.index], 3, point);
      return request_counts_[rotated_point.index] > 0;
    }
    const Goal& goal = task_.goals[rotated_point.index];
    rotate(&current_.frames.rotations[9 * goal.node], goal.offset, point);
    for (int i = 0; i < 3; ++i) point[i] += current_.frames.origins[3 * goal.node + i];
    return current_.weights[COMPONENT_COUNT * rotated_point.index + component_of<Position>()] > 0;
  }

  std::vector<double> desired_points_;  // (N, 3): desired positions of the nodes' origins
  std::vector<double> goal_points_;     // (E, 3): desired positions of the goals' points
  std::vector<int> request_counts_;     // (N,): number of branches that request a position
  std::vector<double> bone_lengths_;    // (N,): from the parent
  std::vector<std::vector<RotatedPoint>> next_points_, rotated_points_;
};

}  // namespace animtool::ik
