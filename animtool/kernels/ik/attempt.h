// One problem on its way: poses, what they cost, and when to stop.
#pragma once

#include <chrono>
#include <cstdint>

#include "ik/sample.h"
#include "ik/step.h"

namespace animtool::ik {

struct Settings {
  double length_tolerance;  // of the chain's length
  double angle_tolerance;   // [rad]
  double damping;           // of the first step
  int iterations;           // of all descents of one problem
  int restarts;
  std::uint64_t seed;
  double seconds;   // 0 is no bound
  bool own_starts;  // frames of a clip begin at poses of their own

  double tolerance(int part) const { return METRIC[part] ? length_tolerance : angle_tolerance; }
};

enum class Status {
  REACHED = 0,
  NEAREST = 1,
  BUDGET = 2,
  BROKEN = 3,
  YIELDED = 4,
  CONFLICT = 5,
  STALLED = 6
};

struct Outcome {
  Status status = Status::BUDGET;
  int iterations = 0;
  int descents = 0;
};

// A way of solving, from problem to problem.
class Solver {
 public:
  virtual ~Solver() = default;

  // Finds the best pose; `next` is the frame after the last run.
  virtual Outcome run(const double* start, const double* targets, const double* rest,
                      bool next) = 0;
  // Measures it by other targets.
  virtual void review(const double* targets) = 0;
  virtual const State& best() const = 0;
};

// What the ways of solving share.
class Attempt {
 public:
  const State& best() const { return best_; }
  const Outcome& outcome() const { return outcome_; }

  // The share of the budget that may be spent from here on.
  void allow(double share) { allowance_ = share; }

  bool spent() const {
    if (outcome_.iterations >= allowance_ * settings_.iterations) return true;
    if (!(settings_.seconds > 0)) return false;
    const std::chrono::duration<double> taken = std::chrono::steady_clock::now() - began_;
    return taken.count() > allowance_ * settings_.seconds;
  }

  // Whether a goal's misses are within a share of the tolerances.
  bool within(const double* misses, double share = 1) const {
    for (int part = 0; part < PARTS; ++part)
      if (misses[part] > share * settings_.tolerance(part)) return false;
    return true;
  }

  bool reached(const State& state) const {
    for (std::size_t e = 0; e < task_.goals.size(); ++e)
      if (!within(&state.misses[PARTS * e])) return false;
    return true;
  }

 protected:
  Attempt(const Task& task, const Settings& settings)
      : task_(task), settings_(settings), linear_(task), stepper_(task), now_(task), next_(task),
        best_(task), delta_(task.chain.dofs), pull_(task.chain.dofs) {}

  // Brings the start inside the limits; false where its cost is beyond numbers.
  bool open(const double* start, const double* targets, const double* rest) {
    targets_ = targets;
    rest_ = rest;
    shift_ = nullptr;
    outcome_ = {};
    began_ = std::chrono::steady_clock::now();
    std::fill(delta_.begin(), delta_.end(), 0.0);
    stepper_.move(start, delta_.data(), best_.q.data());
    evaluate(best_);
    return std::isfinite(best_.cost);
  }

  void evaluate(State& state) {
    forward(task_.chain, state.q.data(), state.frames);
    measure(task_, targets_, state, shift_);
    state.drawn = rest_pull(task_, state.q.data(), rest_, task_.rest_weight, pull_.data());
    state.cost += state.drawn;
  }

  void begin(const State& state) {
    now_.q = state.q;
    evaluate(now_);
  }

  // Moves now_ a little: where the slope is zero, it may not be at its least.
  void shake() {
    for (double& d : delta_) d = random_.between(-SHAKE, SHAKE);
    stepper_.move(now_.q.data(), delta_.data(), next_.q.data());
    std::swap(now_, next_);
    evaluate(now_);
  }

  // Keeps the better of the two; whether it reaches the goals.
  bool keep() {
    if (now_.cost < best_.cost || (reached(now_) && !reached(best_))) std::swap(now_, best_);
    return reached(best_);
  }

  static constexpr double SHAKE = 0.05;  // [rad]

  const Task& task_;
  const Settings& settings_;
  Random random_{0};
  Linearized linear_;
  Stepper stepper_;
  State now_, next_, best_;
  std::vector<double> delta_, pull_;
  Outcome outcome_;
  double allowance_ = 1;
  const double* targets_ = nullptr;
  const double* rest_ = nullptr;
  const double* shift_ = nullptr;  // (M,), added to the residuals
  std::chrono::steady_clock::time_point began_;
};

}  // namespace animtool::ik
