// The state of one problem while it is being solved.
#include "ik/attempt.h"

namespace animtool::ik {

bool Attempt::open(const double* start, const double* targets, const double* rest) {
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

Descent::End Descent::descend(double damping, bool thorough) {
  ++outcome_.descents;
  bool fresh = true;
  double grow = 2, checkpoint_cost = now_.cost, trust_radius = MAX_ROTATION;
  int slow = 0;
  for (int steps = 0;; ++steps) {
    if (!(task_.rest_weight > 0) && reached(now_)) return End::REACHED;
    if (spent()) return End::BUDGET;
    if (fresh) linearize(task_, targets_, rest_, now_, linear_);
    ++outcome_.iterations;
    const bool curved = thorough && (now_.cost > FAR || slow > 1);
    const double gain = try_step(curved ? MIN_DAMPING : damping, curved, trust_radius);
    if (std::fabs(gain) <= least_gain_ * now_.cost) return End::STUCK;
    const double ratio = gain > 0 ? (now_.cost - next_.cost) / gain : 0;
    fresh = ratio > MIN_RATIO && next_.cost < now_.cost;
    if (curved)
      trust_radius = ratio < 0.25  ? 0.3 * stepper_.rotation()
                     : ratio > 0.5 ? std::min(2.5 * trust_radius, MAX_ROTATION)
                                   : trust_radius;
    else if (fresh)
      damping = ratio > 0.75   ? std::max(damping * 0.1, MIN_DAMPING)
                : ratio < 0.25 ? damping * 3
                               : damping;
    else
      damping = std::max(damping, 1e-9) * grow;
    grow = fresh ? 2 : grow * 2;
    if (damping > MAX_DAMPING || trust_radius < MIN_ROTATION) return End::STUCK;
    if (fresh) {
      slow = next_.cost > 0.5 * now_.cost ? slow + 1 : 0;
      std::swap(now_, next_);
    }
    if (steps % MAX_STALLED == MAX_STALLED - 1) {
      if (!thorough && now_.cost > PROGRESS * checkpoint_cost) return End::SLOW;
      checkpoint_cost = now_.cost;
    }
  }
}

double Descent::try_step(double damping, bool curved, double trust_radius) {
  if (!stepper_.step(now_, linear_, damping, curved, trust_radius, delta_.data())) return -1;
  const double gain = stepper_.predicted(now_, linear_, curved, delta_.data());
  if (!(gain > 0)) return gain;
  stepper_.move(now_.q.data(), delta_.data(), next_.q.data());
  evaluate(next_);
  return gain;
}

}  // namespace animtool::ik
