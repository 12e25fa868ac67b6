// Descents from the start and, if they do not reach the goals, from other starts.
#pragma once

#include "ik/attempt.h"
#include "ik/goals.h"

namespace animtool::ik {

class Search : public Descent {
 public:
  Search(const Task& task, const Settings& settings)
      : Descent(task, settings), first_(task), last_(task) {}

  // Finds the best pose; `next` is the frame after the last run.
  Status run(const double* start, const double* targets, const double* rest, bool next);

  // Continues from the best pose to other targets, and keeps the result.
  void refine(const double* targets, const double* shift, double least_gain);

  // Searches from the start for other targets, and keeps the result if it is better for them.
  void search(const double* targets);

  // Whether other targets are reached from the best pose, which does not change.
  bool reaches(const double* targets) {
    set_targets(targets, nullptr);
    begin(best_);
    descend(COLD, true);
    return reached(now_);
  }

  // Evaluates the best pose with other targets.
  void review(const double* targets) {
    set_targets(targets, nullptr);
    evaluate(best_);
  }

 private:
  // Damping of the first step from a new start, and from a start near the goals.
  static constexpr double COLD = 1e-3, WARM = 1e-6;
  // Number of random poses of which the best becomes a new start.
  static constexpr int SAMPLES = 4;
  // Relative precision of a descent: if more levels follow, and if a rest preference keeps the
  // cost above 0.
  static constexpr double ROUGH = 1e-6, FINE = 1e-12;
  // Precision at which new starts are compared.
  static constexpr double COMPARED = 1e-6;
  // After this many starts the best is descended to its minimum.
  static constexpr int POLISHED = 8;
  // Number of other starts that must end at the best pose before it is accepted as the global
  // minimum.
  static constexpr int AGREEING = 16;
  // Likewise where degrees of freedom are abundant.
  static constexpr int FEW = 2;
  // A start that ends below this fraction of the best cost is better.
  static constexpr double BETTER = 1 - 1e-3;
  // Number of starts in a frame whose cost is within a factor of that of the previous frame; it
  // changes to another branch only if that has this fraction of the cost.
  static constexpr int RESTARTS_NEXT = 2;
  static constexpr double JUMP = 0.98;
  static constexpr double SAME = 1.25;
  // With this many times more degrees of freedom than rows, slow descents are continued: there are
  // hardly any local minima.
  static constexpr int REDUNDANT = 4;

  void set_targets(const double* targets, const double* shift) {
    targets_ = targets;
    shift_ = shift;
  }

  Status search_all();

  // Descends from the previous frame's pose, if that is nearer to the goals than the result from
  // the frame's own start; returns whether the goals are reached.
  bool continue_last(bool is_thorough) {
    begin(last_);
    descend(WARM, is_thorough);
    return (now_.cost < best_.cost * BETTER || reached(now_)) && accept();
  }

  // Descends from new starts; returns whether the goals are reached.
  bool search_restarts(bool stalled, bool is_thorough);

  // Whether the frame is as far from the goals as the previous one, whose search failed, so that
  // no new search is needed.
  bool is_same_miss(End end) const {
    return last_unreached_ && end == End::STUCK && best_.cost < SAME * last_cost_ &&
           last_cost_ < SAME * best_.cost;
  }

  void restart(int i, bool stalled);

  // Descends from the best pose to its minimum.
  Status polish();

  // Whether no pose can be nearer, or only the rest preference keeps the goals from being reached.
  bool is_minimal() const {
    if (floor_ > 0 && best_.cost <= floor_ * (1 + 1e-9)) return true;
    return best_.rest_cost > 0 && best_.cost <= 2 * best_.rest_cost;
  }

  // The zero pose, clamped to the limits.
  void straighten();

  // The best of some random poses.
  void sample_start(const State& home);

  State first_, last_;
  double floor_ = 0;             // lower bound of the cost
  bool last_unreached_ = false;  // the previous frame did not reach its goals, at this cost:
  double last_cost_ = 0;
};

// Prioritised goals: among the poses that are best for the hard goals, those that are best for
// the next level, and so on.
//
// At first all levels are solved at once, each with a small fraction of the weight of the level
// before it. Then they are solved one by one: a level that is reached becomes a constraint for the
// later ones, enforced by the method of multipliers (M. R. Hestenes, Multiplier and gradient
// methods, 1969; M. J. D. Powell, 1969), which shifts its residuals; a level that cannot be
// reached is held by its weight.

class Levels : public Solver {
 public:
  // Changes the task's rest weight while it runs.
  Levels(Task& task, const Settings& settings)
      : task_(task),
        rest_weight_(task.rest_weight),
        search_(task_, settings),
        scaled_(TARGET_WIDTH * task.goals.size()),
        shift_(task.rows),
        constrained_(task.levels),
        ratio_(std::max(STEP, std::pow(LEAST_SCALE, 1.0 / std::max(1, task.levels - 1)))) {}

  Outcome run(const double* start, const double* targets, const double* rest, bool next) override;

  void review(const double* targets) override { search_.review(targets); }
  const State& best() const override { return search_.best(); }

 private:
  // Ratio of weights from level to level while all are solved at once.
  static constexpr double SEARCH_RATIO = 0.1;
  // Fraction of the budget for that.
  static constexpr double SEARCH_BUDGET = 0.5;
  // Ratio of weights when levels are separated, and smallest weight of the last one.
  static constexpr double STEP = 1e-3, LEAST_SCALE = 1e-6;
  // Largest number of shifts of a level, and the fraction of the tolerance at which they end.
  static constexpr int SHIFTS = 8;
  static constexpr double LEVEL_TOLERANCE = 0.1;
  // Approximate relative excess of a level over its smallest cost.
  static constexpr double EXACT = 1e-5;

  // Sets the weights of the goals up to a level, each level with a fraction of the weight of the
  // level before it; the rest preference gets the smallest weight.
  void set_weights(int last, double ratio);

  double largest_weight(int level) const;

  void scale(int level, double weight) {
    for (std::size_t e = 0; e < task_.goals.size(); ++e)
      if (task_.goals[e].level == level)
        for (int part = 0; part < PARTS; ++part)
          scaled_[TARGET_WIDTH * e + WEIGHTS + part] *= weight;
  }

  // A single goal.
  void isolate_goal(std::size_t goal) {
    task_.rest_weight = 0;
    std::copy(targets_, targets_ + scaled_.size(), scaled_.begin());
    for (std::size_t e = 0; e < task_.goals.size(); ++e)
      if (e != goal) std::fill_n(&scaled_[TARGET_WIDTH * e + WEIGHTS], PARTS, 0.0);
  }

  bool within(int level) const {
    for (std::size_t e = 0; e < task_.goals.size(); ++e)
      if (task_.goals[e].level == level && !search_.within(&best().errors[PARTS * e])) return false;
    return true;
  }

  // `was_unreached`: the hard goals alone were not reached in the previous frame either.
  Status separate_levels(bool was_unreached);

  // Shifts the residuals of held levels that drifted; returns false if none did.
  bool shift();

  // Levels that shifts did not hold within the tolerance are restored by smallest steps.
  void restore();

  // Determines why goals are missed: they are out of reach, or yield to other goals of their level,
  // to harder ones, or to the rest preference.
  Status diagnose();

  int requested_count() const;

  // The goals that are not reached, the farthest first, so that one out of reach is found soon.
  std::vector<std::size_t> missed_goals() const;

  Task& task_;
  const double rest_weight_;
  Search search_;
  std::vector<double> scaled_, shift_;
  std::vector<char> constrained_;
  const double ratio_;
  bool last_unreached_ = false;  // the hard goals were not reached in the last run
  const double* targets_ = nullptr;
};

}  // namespace animtool::ik
