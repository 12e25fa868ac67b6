// Goals that give way to others: among the poses that are best for the hard ones, those
// that are best for the next, and so on.
//
// All are sought at once first, each level with a small share of the weight of the one
// before it. Then level by level: one that is reached is a constraint for those after
// it, held by the method of multipliers (M. R. Hestenes, Multiplier and gradient methods,
// 1969; M. J. D. Powell, 1969), which shifts its residuals; one that cannot be reached
// is held by its weight.
#pragma once

#include "ik/search.h"

namespace animtool::ik {

class Levels : public Solver {
 public:
  // Changes the task's rest weight as it goes.
  Levels(Task& task, const Settings& settings)
      : task_(task), rest_weight_(task.rest_weight), search_(task_, settings),
        scaled_(TARGET_WIDTH * task.goals.size()), shift_(task.rows), held_(task.levels),
        ratio_(std::max(STEP, std::pow(LEAST_SCALE, 1.0 / std::max(1, task.levels - 1)))) {}

  Outcome run(const double* start, const double* targets, const double* rest,
              bool next) override {
    targets_ = targets;
    const int last = task_.levels - 1;
    weigh(last, SOUGHT);
    search_.allow(last > 0 ? SEARCHED : 1);
    Status status = search_.run(start, scaled_.data(), rest, next);
    search_.allow(1);
    if ((status == Status::NEAREST || status == Status::BUDGET) && last > 0) {
      const bool cut = status == Status::BUDGET;
      status = settle(next && short_);
      if (cut && status == Status::NEAREST) status = Status::BUDGET;
    }
    short_ = last > 0 && !within(0);
    if (status == Status::NEAREST) status = explain();
    Outcome outcome = search_.outcome();
    outcome.status = status;
    return outcome;
  }

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
  static constexpr double HELD = 0.1;
  // What a level may miss its least cost by, about.
  static constexpr double EXACT = 1e-5;

  // The goals up to a level, each level with a share of the weight of the one before it;
  // the rest preference is as soft as the softest.
  void weigh(int last, double ratio) {
    std::copy(targets_, targets_ + scaled_.size(), scaled_.begin());
    double share = 1;
    for (int level = 1; level < task_.levels; ++level) {
      share *= ratio;
      const double own = heaviest(level), hard = heaviest(0);
      scale(level, level > last ? 0 : share * (own > 0 && hard > 0 ? hard / own : 1));
    }
    task_.rest_weight = last == task_.levels - 1 ? rest_weight_ * share * share : 0;
  }

  double heaviest(int level) const {
    double most = 0;
    for (std::size_t e = 0; e < task_.goals.size(); ++e)
      if (task_.goals[e].level == level)
        for (int part = 0; part < PARTS; ++part)
          most = std::max(most, weight_of(task_.goals[e], targets_ + TARGET_WIDTH * e, part));
    return most;
  }

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
  Status settle(bool known) {
    std::fill(shift_.begin(), shift_.end(), 0.0);
    std::fill(held_.begin(), held_.end(), false);
    for (int level = 0; level < task_.levels && !search_.spent(); ++level) {
      weigh(level, ratio_);
      for (int i = 0; i < SHIFTS; ++i) {
        search_.refine(scaled_.data(), shift_.data(), EXACT * std::pow(ratio_, 2 * level));
        if (search_.spent() || !shift()) break;
      }
      if (level == 0 && !known && !within(0)) search_.search(scaled_.data());
      held_[level] = within(level);
    }
    const bool spent = search_.spent();
    if (!spent) restore();
    search_.review(targets_);
    if (spent) return Status::BUDGET;
    return search_.reached(best()) ? Status::REACHED : Status::NEAREST;
  }

  // Asks more of what is held, where it gave way; false where all is well.
  bool shift() {
    bool slack = false;
    for (std::size_t e = 0; e < task_.goals.size(); ++e)
      slack = slack || (held_[task_.goals[e].level] &&
                        !search_.within(&best().misses[PARTS * e], HELD));
    if (!slack) return false;
    for (const Goal& goal : task_.goals)
      if (held_[goal.level])
        for (int i = goal.row; i < goal.row + rows_of(goal); ++i) shift_[i] = best().residuals[i];
    return true;
  }

  // What shifts did not hold to the tolerance is brought back by the least of steps.
  void restore() {
    bool slack = false;
    weigh(task_.levels - 1, ratio_);
    task_.rest_weight = 0;
    for (int level = 0; level < task_.levels; ++level) {
      slack = slack || (held_[level] && !within(level));
      if (!held_[level]) scale(level, 0);
    }
    if (slack) search_.refine(scaled_.data(), nullptr, 0);
  }

  // Why goals are missed: they are out of reach, or give way to others, to harder ones or
  // to the pose preferred.
  Status explain() {
    const bool hard = within(0);
    if (!hard && rest_weight_ > 0) {
      weigh(0, 1);
      task_.rest_weight = 0;
      if (search_.reaches(scaled_.data())) return Status::YIELDED;
    }
    if (asked() < 2) return Status::NEAREST;
    for (const std::size_t e : missed()) {
      single(e);
      if (!search_.reaches(scaled_.data())) return Status::NEAREST;
    }
    return hard ? Status::YIELDED : Status::CONFLICT;
  }

  int asked() const {
    int count = 0;
    for (std::size_t e = 0; e < task_.goals.size(); ++e) {
      bool any = false;
      for (int part = 0; part < PARTS; ++part)
        any = any || weight_of(task_.goals[e], targets_ + TARGET_WIDTH * e, part) > 0;
      count += any;
    }
    return count;
  }

  // The goals that are, the farthest first: one out of reach is soon found.
  std::vector<std::size_t> missed() const {
    std::vector<std::size_t> found;
    const std::vector<double>& misses = best().misses;
    const auto most = [&](std::size_t e) {
      return *std::max_element(&misses[PARTS * e], &misses[PARTS * e] + PARTS);
    };
    for (std::size_t e = 0; e < task_.goals.size(); ++e)
      if (!search_.within(&misses[PARTS * e])) found.push_back(e);
    std::sort(found.begin(), found.end(),
              [&](std::size_t a, std::size_t b) { return most(a) > most(b); });
    return found;
  }

  Task& task_;
  const double rest_weight_;
  Search search_;
  std::vector<double> scaled_, shift_;
  std::vector<char> held_;
  const double ratio_;
  bool short_ = false;  // the hard goals were not reached in the last run
  const double* targets_ = nullptr;
};

}  // namespace animtool::ik
