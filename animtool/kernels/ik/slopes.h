// The methods that go by derivatives of the cost: steepest descent, and Newton's.
#pragma once

#include "ik/method.h"

namespace animtool::ik {

// Steepest descent; each step as long as the cost then falls by a share of what the slope
// promises (L. Armijo, Minimization of functions having Lipschitz continuous first partial
// derivatives, 1966), brought back inside the limits.
class Gradient : public Method {
 public:
  using Method::Method;

 protected:
  void prepare() override { length_ = 1; }

  bool advance() override {
    linearize(task_, targets_, rest_, now_, linear_);
    const std::vector<double>& slope = linear_.downhill;
    double steepest = 0;
    for (const double d : slope) steepest = std::max(steepest, std::fabs(d));
    if (!(steepest > 0)) return false;
    length_ = std::min(length_ / BACK / BACK, LONGEST_TURN / steepest);
    for (; length_ * steepest > LEAST_TURN; length_ *= BACK) {
      for (std::size_t d = 0; d < slope.size(); ++d) delta_[d] = length_ * slope[d];
      stepper_.move(now_.q.data(), delta_.data(), next_.q.data());
      evaluate(next_);
      const double promised = promise();
      if (!(promised > 0) || !(now_.cost - next_.cost >= SHARE * promised)) continue;
      std::swap(now_, next_);
      return true;
    }
    return false;
  }

 private:
  static constexpr double BACK = 0.5, SHARE = 1e-4, LEAST_TURN = 1e-14;

  // What the slope promises of the way from now_ to next_, limits kept.
  double promise() {
    rest_pull(task_, now_.q.data(), next_.q.data(), 1, pull_.data());
    double sum = 0;
    for (std::size_t d = 0; d < pull_.size(); ++d) sum += pull_[d] * linear_.downhill[d];
    return sum;
  }

  double length_ = 1;
};

// Newton's method: the whole Hessian, second derivatives of positions and orientations
// included, in a region of trust so that the cost falls where it is not convex.
class Newton : public Method {
 public:
  using Method::Method;

 protected:
  void prepare() override { trusted_ = LONGEST_TURN; }

  bool advance() override {
    linearize(task_, targets_, rest_, now_, linear_);
    for (; trusted_ > LEAST_TURN; trusted_ = SHRINK * stepper_.turn()) {
      stepper_.step(now_, linear_, DAMPING, true, trusted_, delta_.data());
      const double gain = stepper_.predicted(now_, linear_, true, delta_.data());
      if (!(gain > STILL_GAIN * now_.cost)) return false;
      stepper_.move(now_.q.data(), delta_.data(), next_.q.data());
      evaluate(next_);
      const double ratio = (now_.cost - next_.cost) / gain;
      if (!(ratio > LEAST_RATIO)) continue;
      if (ratio > 0.5) trusted_ = std::min(GROW * trusted_, LONGEST_TURN);
      std::swap(now_, next_);
      return true;
    }
    return false;
  }

 private:
  static constexpr double DAMPING = 1e-12, LEAST_TURN = 1e-10, STILL_GAIN = 1e-15;
  static constexpr double LEAST_RATIO = 1e-4, SHRINK = 0.3, GROW = 2.5;

  double trusted_ = LONGEST_TURN;
};

}  // namespace animtool::ik
