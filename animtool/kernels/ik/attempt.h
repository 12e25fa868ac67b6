// Random poses inside the limits, the same ones everywhere.
#pragma once

#include <chrono>
#include <cstdint>

#include "ik/goals.h"
#include "ik/limits.h"
#include "ik/step.h"

namespace animtool::ik {

// splitmix64 (S. Vigna): small, and the same numbers everywhere.
class Random {
 public:
  explicit Random(std::uint64_t seed) : state_(seed) {}

  // In [low, high).
  double between(double low, double high) {
    std::uint64_t z = (state_ += 0x9e3779b97f4a7c15ull);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ull;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebull;
    z ^= z >> 31;
    return low + (high - low) * (static_cast<double>(z >> 11) * 0x1.0p-53);
  }

 private:
  std::uint64_t state_;
};

// A random pose; where a joint has no limits near by, about `home`.
inline void sample(const Chain& chain, const double* home, Random& random, double* q) {
  for (const Node& node : chain.nodes) {
    if (node.follows) continue;
    double* values = q + node.coordinate;
    const double* l = node.limit;
    const double middle = home[node.coordinate];
    if (node.kind == Kind::BALL) {
      SwingTwist parts;
      const double reach = std::sqrt(random.between(0, 1));
      const double angle = random.between(0, REVOLUTION);
      parts.swing[0] = reach * std::min(l[0], REVOLUTION / 2) * std::cos(angle);
      parts.swing[1] = reach * std::min(l[1], REVOLUTION / 2) * std::sin(angle);
      parts.twist = random.between(std::max(l[2], -REVOLUTION / 2), std::min(l[3], REVOLUTION / 2));
      join(parts, values);
      clamp_ball(values, l);
    } else if (l[1] - l[0] < REVOLUTION) {
      values[0] = random.between(l[0], l[1]);
    } else {
      const double half = node.kind == Kind::PIN ? REVOLUTION / 2 : 1;
      values[0] = std::clamp(middle + random.between(-half, half), l[0], l[1]);
    }
  }
}

// The state of one solve: poses, costs and stopping tests.

struct Settings {
  double length_tolerance;  // of the chain's length
  double angle_tolerance;   // [rad]
  double damping;           // of the first step
  int iterations;           // of all descents of one problem
  int restarts;
  std::uint64_t seed;
  double seconds;   // 0 is no bound
  bool separate_starts;  // frames of a clip begin at poses of their own

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

// A solver of consecutive problems.
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

// Base of the solvers.
class Attempt {
 public:
  const State& best() const { return best_; }
  const Outcome& outcome() const { return outcome_; }

  // The share of the budget that may be spent from here on.
  void allow(double fraction) { allowance_ = fraction; }

  bool spent() const {
    if (outcome_.iterations >= allowance_ * settings_.iterations) return true;
    if (!(settings_.seconds > 0)) return false;
    const std::chrono::duration<double> taken = std::chrono::steady_clock::now() - began_;
    return taken.count() > allowance_ * settings_.seconds;
  }

  // Whether a goal's misses are within a share of the tolerances.
  bool within(const double* misses, double fraction = 1) const {
    for (int part = 0; part < PARTS; ++part)
      if (misses[part] > fraction * settings_.tolerance(part)) return false;
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
  bool open(const double* start, const double* targets, const double* rest);

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

// Descent from a pose.

class Descent : public Attempt {
 protected:
  using Attempt::Attempt;

  enum class End { REACHED, STUCK, SLOW, BUDGET };

  // Bounds of the damping of all descents.
  static constexpr double LEAST_DAMPING = 1e-12, MOST_DAMPING = 1e8;
  // Over so many steps a descent has to bring the cost down to this share.
  static constexpr int MAX_STALLED = 6;
  static constexpr double PROGRESS = 0.3;
  // Above this cost the whole Hessian is worth its price: goals are a length away.
  static constexpr double FAR = 0.5;
  // A step is taken that brings this share of what it promised, and none is left that
  // turns by less [rad].
  static constexpr double LEAST_RATIO = 1e-4, MIN_ROTATION = 1e-10;
  // Nor one that promises this share of the cost: what rounding leaves, unless less will
  // do.
  static constexpr double ROUNDED = 1e-15;
  double least_gain_ = ROUNDED;

  // Moves now_ downhill: Levenberg-Marquardt, and with the whole Hessian in a region of
  // trust where the goals are far or progress is slow. Not `thorough`, it gives up
  // there, for another start is then the better use of time.
  End descend(double damping, bool thorough);

  // What the model promises of the step to next_; less than 0 where there is none.
  double try_step(double damping, bool curved, double trusted);
};

}  // namespace animtool::ik
