// The methods of the textbooks: from the start, by one way of stepping, to the goals or
// until it makes no headway. They are for comparison; `Levels` is the solver to use.
#pragma once

#include "ik/attempt.h"

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
  // Moves now_ on; false where it sees no way.
  virtual bool advance() = 0;

 private:
  // Over so many steps the cost has to come down to this share.
  static constexpr int PATIENCE = 50;
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
      if (since % PATIENCE == 0) {
        onward = onward && std::min(now_.cost, best_.cost) <= PROGRESS * marked;
        marked = std::min(now_.cost, best_.cost);
      }
      if (onward) continue;
      note();
      if (reached(best_)) return Status::REACHED;
      if (shaken) return Status::STALLED;
      // Straight limbs pull along themselves: out of that, once.
      shaken = true;
      begin(best_);
      shake();
      prepare();
      since = 0, marked = now_.cost;
    }
  }

  // Some methods pass by better poses than they end in.
  void note() {
    if (now_.cost < best_.cost || (reached(now_) && !reached(best_))) best_ = now_;
  }
};

}  // namespace animtool::ik
