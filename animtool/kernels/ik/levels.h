// Descents from the start and, where they end short of the goals, from elsewhere.
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

  // Goes on from the best pose to other targets, and stays with what comes of it.
  void refine(const double* targets, const double* shift, double least_gain);

  // Searches from the start for other targets, and keeps what is better for them.
  void search(const double* targets);

  // Whether other targets are reached from the best pose, which is kept.
  bool reaches(const double* targets) {
    aim(targets, nullptr);
    begin(best_);
    descend(COLD, true);
    return reached(now_);
  }

  // Measures the best pose by other targets.
  void review(const double* targets) {
    aim(targets, nullptr);
    evaluate(best_);
  }

 private:
  // Damping of the first step from a new start, and of one beside the goals.
  static constexpr double COLD = 1e-3, WARM = 1e-6;
  // Random poses, of which the best is a new start.
  static constexpr int SAMPLES = 4;
  // What a descent may leave, in shares of the cost: where levels follow, and where a
  // preference for a pose keeps the cost from 0.
  static constexpr double ROUGH = 1e-6, FINE = 1e-12;
  // New starts are compared when they have come so near to where they go.
  static constexpr double COMPARED = 1e-6;
  // After so many starts the best is followed to its end.
  static constexpr int POLISHED = 8;
  // How many other starts must end where the best did before it is taken for the
  // nearest that can be reached.
  static constexpr int AGREEING = 16;
  // A start that ends below this share of the cost is a better one.
  static constexpr double BETTER = 1 - 1e-3;
  // So many in a frame whose cost is within a factor of that of the frame before it; it
  // leaves its branch for one of this share of the cost.
  static constexpr int RESTARTS_NEXT = 2;
  static constexpr double JUMP = 0.98;
  static constexpr double SAME = 1.25;
  // With so many times more degrees of freedom than rows, a descent that is slow is
  // worth its end: there are hardly any minima that it could be stuck in.
  static constexpr int REDUNDANT = 4;

  void aim(const double* targets, const double* shift) {
    targets_ = targets;
    shift_ = shift;
  }

  Status look();

  // From where the frame before it ended, if that is nearer to the goals than the end of
  // the way from the frame's own start; whether they are reached.
  bool go_on(bool sure) {
    begin(last_);
    descend(WARM, sure);
    return (now_.cost < best_.cost * BETTER || reached(now_)) && keep();
  }

  // Descents from new starts; whether the goals are reached.
  bool elsewhere(bool stalled, bool sure);

  // Whether the frame is as far from the goals as the one before it, whose search was
  // in vain: it need not be made again.
  bool same(End end) const {
    return short_ && end == End::STUCK && best_.cost < SAME * last_cost_ &&
           last_cost_ < SAME * best_.cost;
  }

  void restart(int i, bool stalled);

  // Follows the best to its end.
  Status polish();

  // Nothing can be nearer, or the goals miss only what the rest preference takes.
  bool settled() const {
    if (floor_ > 0 && best_.cost <= floor_ * (1 + 1e-9)) return true;
    return best_.drawn > 0 && best_.cost <= 2 * best_.drawn;
  }

  // The pose without motion, or what the limits leave of it.
  void straighten();

  // The best of some random poses.
  void scatter(const State& home);

  State first_, last_;
  double floor_ = 0;  // no pose costs less
  bool short_ = false;  // the frame before ended short of the goals, at this cost:
  double last_cost_ = 0;
};

// Goals that give way to others: among the poses that are best for the hard ones, those
// that are best for the next, and so on.
//
// All are sought at once first, each level with a small share of the weight of the one
// before it. Then level by level: one that is reached is a constraint for those after
// it, held by the method of multipliers (M. R. Hestenes, Multiplier and gradient methods,
// 1969; M. J. D. Powell, 1969), which shifts its residuals; one that cannot be reached
// is held by its weight.

class Levels : public Solver {
 public:
  // Changes the task's rest weight as it goes.
  Levels(Task& task, const Settings& settings)
      : task_(task), rest_weight_(task.rest_weight), search_(task_, settings),
        scaled_(TARGET_WIDTH * task.goals.size()), shift_(task.rows), constrained_(task.levels),
        ratio_(std::max(STEP, std::pow(LEAST_SCALE, 1.0 / std::max(1, task.levels - 1)))) {}

  Outcome run(const double* start, const double* targets, const double* rest,
              bool next) override;

  void review(const double* targets) override { search_.review(targets); }
  const State& best() const override { return search_.best(); }

 private:
  // Share of the weight from level to level where all are sought at once.
  static constexpr double SOUGHT = 0.1;
  // Share of the budget for that.
  static constexpr double SEARCHED = 0.5;
  // Share of the weight where they are told apart, and the share of the last at least.
  static constexpr double STEP = 1e-3, LEAST_SCALE = 1e-6;
  // Shifts of one level at most, and the share of the tolerance that ends them.
  static constexpr int SHIFTS = 8;
  static constexpr double CONSTRAINED = 0.1;
  // What a level may miss its least cost by, about.
  static constexpr double EXACT = 1e-5;

  // The goals up to a level, each level with a share of the weight of the one before it;
  // the rest preference is as soft as the softest.
  void weigh(int last, double ratio);

  double heaviest(int level) const;

  void scale(int level, double weight) {
    for (std::size_t e = 0; e < task_.goals.size(); ++e)
      if (task_.goals[e].level == level)
        for (int part = 0; part < PARTS; ++part) scaled_[TARGET_WIDTH * e + WEIGHTS + part] *= weight;
  }

  // The one goal, by itself.
  void single(std::size_t goal) {
    task_.rest_weight = 0;
    std::copy(targets_, targets_ + scaled_.size(), scaled_.begin());
    for (std::size_t e = 0; e < task_.goals.size(); ++e)
      if (e != goal) std::fill_n(&scaled_[TARGET_WIDTH * e + WEIGHTS], PARTS, 0.0);
  }

  bool within(int level) const {
    for (std::size_t e = 0; e < task_.goals.size(); ++e)
      if (task_.goals[e].level == level && !search_.within(&best().misses[PARTS * e])) return false;
    return true;
  }

  // `known`: in the frame before, the hard goals were not reached by themselves either.
  Status settle(bool known);

  // Asks more of what is held, where it gave way; false where all is well.
  bool shift();

  // What shifts did not hold to the tolerance is brought back by the least of steps.
  void restore();

  // Why goals are missed: they are out of reach, or give way to others, to harder ones or
  // to the pose preferred.
  Status explain();

  int asked() const;

  // The goals that are, the farthest first: one out of reach is soon found.
  std::vector<std::size_t> missed() const;

  Task& task_;
  const double rest_weight_;
  Search search_;
  std::vector<double> scaled_, shift_;
  std::vector<char> constrained_;
  const double ratio_;
  bool short_ = false;  // the hard goals were not reached in the last run
  const double* targets_ = nullptr;
};

}  // namespace animtool::ik
