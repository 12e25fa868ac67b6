// Descents from the start and from other starts, and goals with priorities.
#pragma once

#include "ik/attempt.h"
#include "ik/goals.h"

namespace animtool::ik {

// Searches for the best pose: descends from the start and, if that does not reach the goals, from
// other starts.
class Search : public Descent {
 public:
  Search(const Task& task, const Settings& settings)
      : Descent(task, settings), start_(task), previous_state_(task) {}

  // Finds the best pose; `is_next_frame` if the problem is the frame after the last one.
  Status run(const double* start, const double* targets, const double* rest, bool is_next_frame);

  // Continues from the best pose with other targets; the result is the best pose.
  void refine(const double* targets, const double* residual_offsets, double min_gain);

  // Searches from the start with other targets; keeps the result if it is better for them.
  void search(const double* targets);

  // Whether other targets are reached from the best pose; does not change it.
  bool can_reach(const double* targets) {
    set_targets(targets, nullptr);
    set_current(best_);
    descend(NEW_START_DAMPING, true);
    return is_reached(current_);
  }

  // Evaluates the best pose with other targets.
  void reevaluate(const double* targets) {
    set_targets(targets, nullptr);
    evaluate(best_);
  }

 private:
  // Damping of the first step from a new start, and from a start near the goals.
  static constexpr double NEW_START_DAMPING = 1e-3, NEAR_GOAL_DAMPING = 1e-6;
  // Number of random poses, the best of which becomes a new start.
  static constexpr int START_SAMPLES = 4;
  // Relative precision of a descent: if more levels follow, and if a rest preference keeps the cost
  // above 0.
  static constexpr double LEVEL_MIN_GAIN = 1e-6, REST_MIN_GAIN = 1e-12;
  // Relative precision with which new starts are compared.
  static constexpr double COMPARISON_MIN_GAIN = 1e-6;
  // After this many starts the best pose is descended to its minimum.
  static constexpr int POLISH_START = 8;
  // Number of other starts that must end at the best pose before it is accepted as the global
  // minimum.
  static constexpr int MAX_AGREEING_STARTS = 16;
  // The same if the chain has redundant degrees of freedom.
  static constexpr int MAX_REDUNDANT_AGREEING_STARTS = 2;
  // A start that ends below this fraction of the best cost is better.
  static constexpr double IMPROVEMENT_RATIO = 1 - 1e-3;
  // Number of starts in a frame whose cost is within a factor of that of the previous frame; the
  // frame changes to another branch only if that has less than a fraction of the cost.
  static constexpr int MAX_CONTINUED_STARTS = 2;
  static constexpr double BRANCH_COST_RATIO = 0.98;
  static constexpr double SAME_COST_RATIO = 1.25;
  // With this many times more degrees of freedom than rows, slow descents are continued: there are
  // hardly any local minima.
  static constexpr int REDUNDANCY_RATIO = 4;

  void set_targets(const double* targets, const double* residual_offsets) {
    targets_ = targets;
    residual_offsets_ = residual_offsets;
  }

  Status search_all();

  // Descends from the previous frame's pose, if that is nearer to the goals than the result from
  // the start of the frame; returns whether the goals are reached.
  bool continue_previous(bool is_thorough) {
    set_current(previous_state_);
    descend(NEAR_GOAL_DAMPING, is_thorough);
    return (current_.cost < best_.cost * IMPROVEMENT_RATIO || is_reached(current_)) &&
           keep_better();
  }

  // Descends from new starts; returns whether the goals are reached.
  bool search_restarts(bool is_stuck, bool is_thorough);

  // Whether the frame is as far from the goals as the previous one, whose search failed, so that a
  // new search is not needed.
  bool is_same_minimum(DescentEnd end) const {
    return was_unreached_ && end == DescentEnd::STUCK &&
           best_.cost < SAME_COST_RATIO * previous_cost_ &&
           previous_cost_ < SAME_COST_RATIO * best_.cost;
  }

  // Sets the start with an index.
  void begin_restart(int i, bool is_stuck);

  // Descends from the best pose to its minimum.
  Status descend_to_minimum();

  // Whether no pose can be nearer, or only the rest preference keeps the goals from being reached.
  bool is_known_minimum() const {
    if (min_cost_ > 0 && best_.cost <= min_cost_ * (1 + 1e-9)) return true;
    return best_.rest_cost > 0 && best_.cost <= 2 * best_.rest_cost;
  }

  // Starts from the zero pose, clamped to the limits.
  void start_from_zero();

  // Starts from the best of several random poses.
  void sample_start(const State& reference_pose);

  State start_, previous_state_;
  double min_cost_ = 0;         // lower bound of the cost
  bool was_unreached_ = false;  // the previous frame did not reach its goals
  double previous_cost_ = 0;    // of the previous frame
};

// Goals with priorities: among the poses that are best for the hard goals, finds those that are
// best for the next level, and so on.
//
// At first all levels are solved at once, each with a small fraction of the weight of the previous
// level. Then they are solved one by one. A level that is reached becomes a constraint for later
// levels, enforced by the method of multipliers (M. R. Hestenes, Multiplier and gradient methods,
// 1969; M. J. D. Powell, 1969), which offsets its residuals; a level that cannot be reached is
// enforced by its weight.

class PrioritySolver : public Solver {
 public:
  // Changes the task's rest weight while it runs.
  PrioritySolver(Task& task, const Settings& settings)
      : task_(task),
        rest_weight_(task.rest_weight),
        search_(task_, settings),
        scaled_targets_(TARGET_WIDTH * task.goals.size()),
        residual_offsets_(task.row_count),
        is_constrained_(task.level_count),
        weight_ratio_(std::max(
            MIN_LEVEL_RATIO, std::pow(MIN_LEVEL_WEIGHT, 1.0 / std::max(1, task.level_count - 1)))) {
  }

  Outcome run(const double* start, const double* targets, const double* rest,
              bool is_next_frame) override;

  void reevaluate(const double* targets) override { search_.reevaluate(targets); }
  const State& best() const override { return search_.best(); }

 private:
  // Ratio of weights from level to level while all levels are solved at once.
  static constexpr double SEARCH_RATIO = 0.1;
  // Fraction of the budget for solving all levels at once.
  static constexpr double SEARCH_BUDGET = 0.5;
  // Smallest ratio of weights when levels are separated, and smallest weight of the last level.
  static constexpr double MIN_LEVEL_RATIO = 1e-3, MIN_LEVEL_WEIGHT = 1e-6;
  // Largest number of offset updates of a level, and the fraction of the tolerance at which they
  // stop.
  static constexpr int MAX_OFFSET_UPDATES = 8;
  static constexpr double LEVEL_TOLERANCE = 0.1;
  // Approximate relative excess of a level over its smallest cost.
  static constexpr double LEVEL_PRECISION = 1e-5;

  // Sets the weights of goals up to a level, each level with a fraction of the weight of the
  // previous level; the rest preference gets the smallest weight.
  void set_weights(int last_level, double ratio);

  double largest_weight(int level) const;

  // Scales the weights of a level.
  void scale_level(int level, double weight) {
    for (std::size_t e = 0; e < task_.goals.size(); ++e)
      if (task_.goals[e].level == level)
        for (int component = 0; component < COMPONENT_COUNT; ++component)
          scaled_targets_[TARGET_WIDTH * e + WEIGHTS_OFFSET + component] *= weight;
  }

  // Sets the weights of all goals but one to 0.
  void isolate_goal(std::size_t goal) {
    task_.rest_weight = 0;
    std::copy(targets_, targets_ + scaled_targets_.size(), scaled_targets_.begin());
    for (std::size_t e = 0; e < task_.goals.size(); ++e)
      if (e != goal)
        std::fill_n(&scaled_targets_[TARGET_WIDTH * e + WEIGHTS_OFFSET], COMPONENT_COUNT, 0.0);
  }

  bool is_level_reached(int level) const {
    for (std::size_t e = 0; e < task_.goals.size(); ++e)
      if (task_.goals[e].level == level &&
          !search_.is_within_tolerance(&best().errors[COMPONENT_COUNT * e]))
        return false;
    return true;
  }

  // Solves the levels one by one. `was_unreached`: the hard goals were not reached in the previous
  // frame either.
  Status separate_levels(bool was_unreached);

  // Offsets the residuals of constrained levels that drifted; returns false if none did.
  bool update_offsets();

  // Restores levels that drifted from the tolerance, by smallest steps.
  void restore_levels();

  // Determines why goals are missed: they cannot be reached, or yield to other goals of their
  // level, to harder ones, or to the rest preference.
  Status diagnose();

  int count_active_goals() const;

  // The goals that are not reached, the farthest first, so that a goal that cannot be reached is
  // tested early.
  std::vector<std::size_t> find_missed_goals() const;

  Task& task_;
  const double rest_weight_;
  Search search_;
  std::vector<double> scaled_targets_, residual_offsets_;
  std::vector<char> is_constrained_;
  const double weight_ratio_;
  bool was_hard_unreached_ = false;  // the hard goals were not reached in the last run
  const double* targets_ = nullptr;
};

}  // namespace animtool::ik
