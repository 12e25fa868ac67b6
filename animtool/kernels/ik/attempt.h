// Random poses inside the limits, the same on all platforms.
#pragma once

#include <chrono>
#include <cstdint>

#include "ik/goals.h"
#include "ik/limits.h"
#include "ik/step.h"

namespace animtool::ik {

// splitmix64 (S. Vigna): small, and gives the same numbers on all platforms.
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

// A random pose; joints without narrow limits are varied around `home`.
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
      compose(parts, values);
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
  double length_tolerance;  // as a fraction of the chain's length
  double angle_tolerance;   // [rad]
  double damping;           // in the first step
  int iterations;           // largest number in all descents of one problem
  int restarts;
  std::uint64_t seed;
  double seconds;        // time limit; 0 is none
  bool separate_starts;  // frames of a clip each have their own start

  double tolerance(int part) const { return METRIC[part] ? length_tolerance : angle_tolerance; }
};

enum class Status {
  REACHED = 0,
  NEAREST = 1,
  BUDGET = 2,
  BROKEN = 3,
  SOFTENED = 4,
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
  // Evaluates it with other targets.
  virtual void review(const double* targets) = 0;
  virtual const State& best() const = 0;
};

// Base of the solvers.
class Attempt {
 public:
  const State& best() const { return best_; }
  const Outcome& outcome() const { return outcome_; }

  // The fraction of the budget that may be spent from now on.
  void allow(double fraction) { allowance_ = fraction; }

  bool spent() const {
    if (outcome_.iterations >= allowance_ * settings_.iterations) return true;
    if (!(settings_.seconds > 0)) return false;
    const std::chrono::duration<double> taken = std::chrono::steady_clock::now() - began_;
    return taken.count() > allowance_ * settings_.seconds;
  }

  // Whether the errors of a goal are within a fraction of the tolerances.
  bool within(const double* errors, double fraction = 1) const {
    for (int part = 0; part < PARTS; ++part)
      if (errors[part] > fraction * settings_.tolerance(part)) return false;
    return true;
  }

  bool reached(const State& state) const {
    for (std::size_t e = 0; e < task_.goals.size(); ++e)
      if (!within(&state.errors[PARTS * e])) return false;
    return true;
  }

 protected:
  Attempt(const Task& task, const Settings& settings)
      : task_(task),
        settings_(settings),
        linear_(task),
        stepper_(task),
        now_(task),
        next_(task),
        best_(task),
        delta_(task.chain.dofs),
        pull_(task.chain.dofs) {}

  // Clamps the start to the limits; returns false if its cost is not finite.
  bool open(const double* start, const double* targets, const double* rest);

  void evaluate(State& state) {
    forward(task_.chain, state.q.data(), state.frames);
    measure(task_, targets_, state, shift_);
    state.rest_cost = rest_pull(task_, state.q.data(), rest_, task_.rest_weight, pull_.data());
    state.cost += state.rest_cost;
  }

  void begin(const State& state) {
    now_.q = state.q;
    evaluate(now_);
  }

  // Perturbs now_: a pose with zero gradient need not be a minimum.
  void perturb() {
    for (double& d : delta_) d = random_.between(-PERTURBATION, PERTURBATION);
    stepper_.move(now_.q.data(), delta_.data(), next_.q.data());
    std::swap(now_, next_);
    evaluate(now_);
  }

  // Keeps the better pose; returns whether it reaches the goals.
  bool accept() {
    if (now_.cost < best_.cost || (reached(now_) && !reached(best_))) std::swap(now_, best_);
    return reached(best_);
  }

  static constexpr double PERTURBATION = 0.05;  // [rad]

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
  static constexpr double MIN_DAMPING = 1e-12, MAX_DAMPING = 1e8;
  // In this many steps a descent has to reduce the cost to this fraction.
  static constexpr int MAX_STALLED = 6;
  static constexpr double PROGRESS = 0.3;
  // Above this cost the full Hessian pays off: goals are about one chain length away.
  static constexpr double FAR = 0.5;
  // A step is accepted if it gains this fraction of the predicted decrease; a descent ends when
  // steps rotate joints by less than this [rad].
  static constexpr double MIN_RATIO = 1e-4, MIN_ROTATION = 1e-10;
  // It also ends when the predicted gain is below this fraction of the cost: rounding error,
  // unless the caller asks for less precision.
  static constexpr double ROUNDED = 1e-15;
  double least_gain_ = ROUNDED;

  // Moves now_ downhill by Levenberg-Marquardt; where goals are far or progress is slow, by a
  // trust-region method with the full Hessian. If not `thorough`, it gives up there, because
  // another start is a better use of the time.
  End descend(double damping, bool thorough);

  // Decrease of the cost that the model predicts for the step to next_; negative without a step.
  double try_step(double damping, bool curved, double trust_radius);
};

}  // namespace animtool::ik
