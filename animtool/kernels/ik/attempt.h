// Random poses within the limits, and the base of solvers: their state, costs and stopping tests.
#pragma once

#include <chrono>
#include <cstdint>

#include "ik/goals.h"
#include "ik/limits.h"
#include "ik/step.h"

namespace animtool::ik {

// splitmix64 (S. Vigna): small, and with the same numbers on all platforms.
class Random {
 public:
  explicit Random(std::uint64_t seed) : state_(seed) {}

  // A uniformly distributed number in [low, high).
  double uniform(double low, double high) {
    std::uint64_t z = (state_ += 0x9e3779b97f4a7c15ull);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ull;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebull;
    z ^= z >> 31;
    return low + (high - low) * (static_cast<double>(z >> 11) * 0x1.0p-53);
  }

 private:
  std::uint64_t state_;
};

// Samples a random pose; joints without narrow limits are varied around `reference_pose`.
inline void sample_pose(const Chain& chain, const double* reference_pose, Random& random,
                        double* q) {
  for (const Node& node : chain.nodes) {
    if (node.is_driven) continue;
    double* values = q + node.coordinate;
    const double* limit = node.limit;
    const double reference = reference_pose[node.coordinate];
    if (node.kind == Kind::BALL) {
      SwingTwist swing_twist;
      const double radius = std::sqrt(random.uniform(0, 1));
      const double angle = random.uniform(0, REVOLUTION);
      swing_twist.swing[0] = radius * std::min(limit[0], REVOLUTION / 2) * std::cos(angle);
      swing_twist.swing[1] = radius * std::min(limit[1], REVOLUTION / 2) * std::sin(angle);
      swing_twist.twist =
          random.uniform(std::max(limit[2], -REVOLUTION / 2), std::min(limit[3], REVOLUTION / 2));
      compose(swing_twist, values);
      clamp_ball(values, limit);
    } else if (limit[1] - limit[0] < REVOLUTION) {
      values[0] = random.uniform(limit[0], limit[1]);
    } else {
      const double half_range = node.kind == Kind::PIN ? REVOLUTION / 2 : 1;
      values[0] =
          std::clamp(reference + random.uniform(-half_range, half_range), limit[0], limit[1]);
    }
  }
}

// Settings of a solver.
struct Settings {
  double length_tolerance;  // fraction of the chain's length
  double angle_tolerance;   // [rad]
  double damping;           // of the first step
  int iterations;           // largest number in all descents of a problem
  int restarts;             // largest number of other starts
  std::uint64_t seed;
  double seconds;            // time limit; 0 for none
  bool has_separate_starts;  // each frame of a clip has its start

  double tolerance(int component) const {
    return IS_LENGTH[component] ? length_tolerance : angle_tolerance;
  }
};

// Result of a problem: goals reached, not reachable, budget spent, cost not finite, yielded to the
// rest preference or to other goals, conflicting goals, or stalled.
enum class Status {
  REACHED = 0,
  NEAREST = 1,
  BUDGET = 2,
  NOT_FINITE = 3,
  SOFTENED = 4,
  CONFLICT = 5,
  STALLED = 6
};

// Result of a problem, and the numbers of iterations and descents.
struct Outcome {
  Status status = Status::BUDGET;
  int iterations = 0;
  int descent_count = 0;
};

// A solver of consecutive problems.
class Solver {
 public:
  virtual ~Solver() = default;

  // Finds the best pose; `is_next_frame` if the problem is the frame after the last one.
  virtual Outcome run(const double* start, const double* targets, const double* rest,
                      bool is_next_frame) = 0;
  // Evaluates the best pose with other targets.
  virtual void reevaluate(const double* targets) = 0;
  virtual const State& best() const = 0;
};

// Base of iterative solvers.
class SolverState {
 public:
  const State& best() const { return best_; }
  const Outcome& outcome() const { return outcome_; }

  // Sets the fraction of the budget that may be spent.
  void set_budget_fraction(double fraction) { budget_fraction_ = fraction; }

  bool is_budget_spent() const {
    if (outcome_.iterations >= budget_fraction_ * settings_.iterations) return true;
    if (!(settings_.seconds > 0)) return false;
    const std::chrono::duration<double> elapsed = std::chrono::steady_clock::now() - start_time_;
    return elapsed.count() > budget_fraction_ * settings_.seconds;
  }

  // Whether the errors of a goal are within a fraction of the tolerances.
  bool is_within_tolerance(const double* errors, double fraction = 1) const {
    for (int component = 0; component < COMPONENT_COUNT; ++component)
      if (errors[component] > fraction * settings_.tolerance(component)) return false;
    return true;
  }

  // Whether all goals are within the tolerances.
  bool is_reached(const State& state) const {
    for (std::size_t e = 0; e < task_.goals.size(); ++e)
      if (!is_within_tolerance(&state.errors[COMPONENT_COUNT * e])) return false;
    return true;
  }

 protected:
  SolverState(const Task& task, const Settings& settings)
      : task_(task),
        settings_(settings),
        linear_(task),
        stepper_(task),
        current_(task),
        next_(task),
        best_(task),
        delta_(task.chain.dof_count),
        negative_rest_gradient_(task.chain.dof_count) {}

  // Begins a problem: clamps the start to the limits; returns false if its cost is not finite.
  bool begin_problem(const double* start, const double* targets, const double* rest);

  // Computes the residuals, errors and cost of a pose.
  void evaluate(State& state) {
    compute_frames(task_.chain, state.q.data(), state.frames);
    measure(task_, targets_, state, residual_offsets_);
    state.rest_cost = evaluate_rest(task_, state.q.data(), rest_, task_.rest_weight,
                                    negative_rest_gradient_.data());
    state.cost += state.rest_cost;
  }

  // Makes a pose the current one.
  void set_current(const State& state) {
    current_.q = state.q;
    evaluate(current_);
  }

  // Perturbs the current pose: a pose with zero gradient need not be a minimum.
  void perturb() {
    for (double& d : delta_) d = random_.uniform(-MAX_PERTURBATION, MAX_PERTURBATION);
    stepper_.move(current_.q.data(), delta_.data(), next_.q.data());
    std::swap(current_, next_);
    evaluate(current_);
  }

  // Keeps the better of the current and the best pose; returns whether that reaches the goals.
  bool keep_better() {
    if (current_.cost < best_.cost || (is_reached(current_) && !is_reached(best_)))
      std::swap(current_, best_);
    return is_reached(best_);
  }

  static constexpr double MAX_PERTURBATION = 0.05;  // [rad]

  const Task& task_;
  const Settings& settings_;
  Random random_{0};
  Linearized linear_;
  Stepper stepper_;
  State current_, next_, best_;
  std::vector<double> delta_, negative_rest_gradient_;
  Outcome outcome_;
  double budget_fraction_ = 1;
  const double* targets_ = nullptr;
  const double* rest_ = nullptr;
  const double* residual_offsets_ = nullptr;  // (M,), added to the residuals
  std::chrono::steady_clock::time_point start_time_;
};

// A solver that descends from a pose.

class Descent : public SolverState {
 protected:
  using SolverState::SolverState;

  enum class DescentEnd { REACHED, STUCK, SLOW, BUDGET };  // the reason why a descent ended

  // Bounds of the damping of all descents.
  static constexpr double MIN_DAMPING = 1e-12, MAX_DAMPING = 1e8;
  // In this many steps a descent has to reduce the cost to this fraction, or it counts as slow.
  static constexpr int PROGRESS_STEPS = 6;
  static constexpr double PROGRESS_RATIO = 0.3;
  // Above this cost the full Hessian is worth its time: goals are about one chain length away.
  static constexpr double FULL_HESSIAN_COST = 0.5;
  // A step is accepted if its gain is at least this fraction of the predicted one; a descent ends
  // when steps rotate joints by less than this [rad].
  static constexpr double MIN_GAIN_RATIO = 1e-4, MIN_STEP_ROTATION = 1e-10;
  // A descent also ends when the predicted gain is below this fraction of the cost: rounding error,
  // unless the caller asks for less precision.
  static constexpr double ROUNDING_MIN_GAIN = 1e-15;
  double min_gain_ = ROUNDING_MIN_GAIN;

  // Moves the current pose downhill by Levenberg-Marquardt; where goals are far or progress is
  // slow, by a trust-region method with the full Hessian. If not `is_thorough`, it stops there,
  // because another start is a better use of the time.
  DescentEnd descend(double damping, bool is_thorough);

  // Computes the step to next_; returns the decrease of the cost that the model predicts, negative
  // without a step.
  double try_step(double damping, bool uses_hessian, double trust_radius);
};

}  // namespace animtool::ik
