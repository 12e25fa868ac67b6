// The state of a solver during one problem, and its descents.
#include "ik/attempt.h"

namespace animtool::ik {

bool SolverState::begin_problem(const double* start, const double* targets, const double* rest) {
  targets_ = targets;
  rest_ = rest;
  residual_offsets_ = nullptr;
  outcome_ = {};
  start_time_ = std::chrono::steady_clock::now();
  std::fill(delta_.begin(), delta_.end(), 0.0);
  stepper_.move(start, delta_.data(), best_.q.data());
  evaluate(best_);
  return std::isfinite(best_.cost);
}

Descent::DescentEnd Descent::descend(double damping, bool is_thorough) {
  ++outcome_.descent_count;
  bool is_accepted = true;
  double damping_growth = 2, checkpoint_cost = current_.cost, trust_radius = MAX_ROTATION;
  int slow_steps = 0;
  for (int steps = 0;; ++steps) {
    if (!(task_.rest_weight > 0) && is_reached(current_)) return DescentEnd::REACHED;
    if (is_budget_spent()) return DescentEnd::BUDGET;
    if (is_accepted) linearize(task_, targets_, rest_, current_, linear_);
    ++outcome_.iterations;
    const bool uses_hessian = is_thorough && (current_.cost > FULL_HESSIAN_COST || slow_steps > 1);
    const double gain = try_step(uses_hessian ? MIN_DAMPING : damping, uses_hessian, trust_radius);
    if (std::fabs(gain) <= min_gain_ * current_.cost) return DescentEnd::STUCK;
    const double ratio = gain > 0 ? (current_.cost - next_.cost) / gain : 0;
    is_accepted = ratio > MIN_GAIN_RATIO && next_.cost < current_.cost;
    if (uses_hessian)
      trust_radius = ratio < 0.25  ? 0.3 * stepper_.step_rotation()
                     : ratio > 0.5 ? std::min(2.5 * trust_radius, MAX_ROTATION)
                                   : trust_radius;
    else if (is_accepted)
      damping = ratio > 0.75   ? std::max(damping * 0.1, MIN_DAMPING)
                : ratio < 0.25 ? damping * 3
                               : damping;
    else
      damping = std::max(damping, 1e-9) * damping_growth;
    damping_growth = is_accepted ? 2 : damping_growth * 2;
    if (damping > MAX_DAMPING || trust_radius < MIN_STEP_ROTATION) return DescentEnd::STUCK;
    if (is_accepted) {
      slow_steps = next_.cost > 0.5 * current_.cost ? slow_steps + 1 : 0;
      std::swap(current_, next_);
    }
    if (steps % PROGRESS_STEPS == PROGRESS_STEPS - 1) {
      if (!is_thorough && current_.cost > PROGRESS_RATIO * checkpoint_cost) return DescentEnd::SLOW;
      checkpoint_cost = current_.cost;
    }
  }
}

double Descent::try_step(double damping, bool uses_hessian, double trust_radius) {
  if (!stepper_.step(current_, linear_, damping, uses_hessian, trust_radius, delta_.data()))
    return -1;
  const double gain = stepper_.predicted_gain(current_, linear_, uses_hessian, delta_.data());
  if (!(gain > 0)) return gain;
  stepper_.move(current_.q.data(), delta_.data(), next_.q.data());
  evaluate(next_);
  return gain;
}

}  // namespace animtool::ik
