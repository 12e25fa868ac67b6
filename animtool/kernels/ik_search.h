// Descents from the start and, where they end short of the goals, from elsewhere.
#pragma once

#include <chrono>
#include <cstdint>

#include "ik_reach.h"
#include "ik_step.h"

namespace animtool::ik {

struct Settings {
  double length_tolerance;  // of the chain's length
  double angle_tolerance;   // [rad]
  double damping;           // of the first step
  int iterations;           // of all descents of one problem
  int restarts;
  std::uint64_t seed;
  double seconds;  // 0 is no bound
};

enum class Status { REACHED = 0, NEAREST = 1, BUDGET = 2, BROKEN = 3 };

struct Outcome {
  Status status = Status::BUDGET;
  int iterations = 0;
  int descents = 0;
};

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

class Search {
 public:
  Search(const Task& task, const Settings& settings)
      : task_(task), settings_(settings), linear_(task), stepper_(task), now_(task), next_(task),
        best_(task), first_(task), delta_(task.chain.dofs), pull_(task.chain.dofs) {}

  // Fills in `q` (Q,), whatever comes of it. `next` is the frame after the last run,
  // from whose end it starts.
  Outcome run(const double* start, const double* targets, const double* rest, bool next,
              double* q) {
    short_ = next && outcome_.status == Status::NEAREST;
    last_cost_ = best_.cost;
    targets_ = targets;
    rest_ = rest;
    outcome_ = {};
    // Frames that go on searching look elsewhere each time.
    if (!short_) random_ = Random(settings_.seed);
    began_ = std::chrono::steady_clock::now();
    std::fill(delta_.begin(), delta_.end(), 0.0);
    stepper_.move(start, delta_.data(), best_.q.data());
    evaluate(best_);
    if (!std::isfinite(best_.cost)) {
      std::copy(start, start + task_.chain.coordinates, q);
      outcome_.status = Status::BROKEN;
      return outcome_;
    }
    outcome_.status = look();
    std::copy(best_.q.begin(), best_.q.end(), q);
    return outcome_;
  }

  const State& best() const { return best_; }

 private:
  enum class End { REACHED, STILL, SLOW, BUDGET };

  // Damping of a descent from a new start, and the bounds of all.
  static constexpr double COLD = 1e-3, LEAST_DAMPING = 1e-12, MOST_DAMPING = 1e8;
  // How far a pose is moved where the slope is zero, but maybe not the least [rad].
  static constexpr double SHAKE = 0.05;
  // Random poses, of which the best is a new start.
  static constexpr int SAMPLES = 4;
  // Over so many steps a descent has to bring the cost down to this share.
  static constexpr int PATIENCE = 6;
  static constexpr double PROGRESS = 0.3;
  // Above this cost the whole Hessian is worth its price: goals are a length away.
  static constexpr double FAR = 0.5;
  // A step is taken that brings this share of what it promised, and none is left that
  // promises this share of the cost, or turns by less [rad].
  static constexpr double LEAST_RATIO = 1e-4, STILL_GAIN = 1e-15, LEAST_TURN = 1e-10;
  // After so many starts the best is followed to its end.
  static constexpr int POLISHED = 8;
  // How many other starts must end where the best did before it is taken for the
  // nearest that can be reached.
  static constexpr int AGREEING = 16;
  // A start that ends below this share of the cost is a better one.
  static constexpr double BETTER = 1 - 1e-3;
  // So many in a frame whose cost is within a factor of that of the frame before it.
  static constexpr int RESTARTS_NEXT = 2;
  static constexpr double SAME = 1.25;
  // With so many times more degrees of freedom than rows, a descent that is slow is
  // worth its end: there are hardly any minima that it could be stuck in.
  static constexpr int REDUNDANT = 4;

  Status look() {
    floor_ = nearest_cost(task_, targets_, best_.frames);
    const bool drawn = task_.rest_weight > 0;
    const bool sure = floor_ > 0 || drawn || task_.chain.dofs >= REDUNDANT * rows_asked(task_, targets_);
    first_.q = best_.q;
    begin(best_);
    const End end = descend(settings_.damping, sure || short_);
    if (keep()) return Status::REACHED;
    if (same(end)) {
      const double before = best_.cost;
      for (int i = 0; i < std::min(RESTARTS_NEXT, settings_.restarts) && !settled() && !spent(); ++i) {
        scatter(i % 2 ? best_ : first_);
        descend(COLD, sure);
        if (keep()) return Status::REACHED;
      }
      if (best_.cost >= before * BETTER) return Status::NEAREST;
    }
    int agreeing = 0;
    for (int i = 0; i < settings_.restarts && !spent() && !settled(); ++i) {
      restart(i, end == End::STILL);
      descend(COLD, sure || i == POLISHED);
      const double before = best_.cost;
      if (now_.cost < before * BETTER)
        agreeing = 0;
      else if (now_.cost < before * (1 + 1e-2))
        ++agreeing;
      if (keep()) return Status::REACHED;
      if (agreeing >= AGREEING) break;
    }
    return polish();
  }

  // Whether the frame is as far from the goals as the one before it, whose search was
  // in vain: it need not be made again.
  bool same(End end) const {
    return short_ && end == End::STILL && best_.cost < SAME * last_cost_ &&
           last_cost_ < SAME * best_.cost;
  }

  void restart(int i, bool still) {
    if (i == 0 && still) {
      begin(best_);
      shake();
    } else if (i == POLISHED) {
      begin(best_);
    } else if (i == 1) {
      straighten();
    } else {
      scatter(i % 2 ? best_ : first_);
    }
  }

  // Follows the best to its end.
  Status polish() {
    if (spent()) return Status::BUDGET;
    begin(best_);
    const End end = descend(COLD, true);
    if (keep()) return Status::REACHED;
    return end == End::BUDGET ? Status::BUDGET : Status::NEAREST;
  }

  void begin(const State& state) {
    now_.q = state.q;
    evaluate(now_);
  }

  // Nothing can be nearer, or the goals miss only what the rest preference takes.
  bool settled() const {
    if (floor_ > 0 && best_.cost <= floor_ * (1 + 1e-9)) return true;
    return best_.drawn > 0 && best_.cost <= 2 * best_.drawn;
  }

  bool spent() const {
    if (outcome_.iterations >= settings_.iterations) return true;
    if (!(settings_.seconds > 0)) return false;
    const std::chrono::duration<double> taken = std::chrono::steady_clock::now() - began_;
    return taken.count() > settings_.seconds;
  }

  void evaluate(State& state) {
    forward(task_.chain, state.q.data(), state.frames);
    measure(task_, targets_, state);
    state.drawn = rest_pull(task_, state.q.data(), rest_, pull_.data());
    state.cost += state.drawn;
  }

  bool reached(const State& state) const {
    for (std::size_t i = 0; i < state.misses.size(); ++i) {
      const double tolerance =
          i % PARTS == 0 ? settings_.length_tolerance : settings_.angle_tolerance;
      if (state.misses[i] > tolerance) return false;
    }
    return true;
  }

  // Keeps the better of the two; whether it reaches the goals.
  bool keep() {
    if (now_.cost < best_.cost || (reached(now_) && !reached(best_))) std::swap(now_, best_);
    return reached(best_);
  }

  void shake() {
    for (double& d : delta_) d = random_.between(-SHAKE, SHAKE);
    stepper_.move(now_.q.data(), delta_.data(), next_.q.data());
    std::swap(now_, next_);
    evaluate(now_);
  }

  // The pose without motion, or what the limits leave of it.
  void straighten() {
    for (const Node& node : task_.chain.nodes) {
      double* own = &now_.q[node.coordinate];
      std::fill(own, own + (node.kind == Kind::BALL ? 4 : 1), 0.0);
      if (node.kind == Kind::BALL) own[3] = 1;
    }
    shake();
  }

  // The best of some random poses. Where a joint has no limits near by, about `home`.
  void scatter(const State& home) {
    double least = std::numeric_limits<double>::infinity();
    for (int i = 0; i < SAMPLES; ++i) {
      sample(home, next_.q.data());
      evaluate(next_);
      if (!(next_.cost < least)) continue;
      least = next_.cost;
      std::swap(now_, next_);
    }
  }

  void sample(const State& home, double* q) {
    for (const Node& node : task_.chain.nodes) {
      if (node.follows) continue;
      double* own = q + node.coordinate;
      const double* l = node.limit;
      const double middle = home.q[node.coordinate];
      if (node.kind == Kind::BALL) {
        SwingTwist parts;
        const double reach = std::sqrt(random_.between(0, 1));
        const double angle = random_.between(0, TURN);
        parts.swing[0] = reach * std::min(l[0], TURN / 2) * std::cos(angle);
        parts.swing[1] = reach * std::min(l[1], TURN / 2) * std::sin(angle);
        parts.twist = random_.between(std::max(l[2], -TURN / 2), std::min(l[3], TURN / 2));
        join(parts, own);
        clamp_ball(own, l);
      } else if (l[1] - l[0] < TURN) {
        own[0] = random_.between(l[0], l[1]);
      } else {
        const double half = node.kind == Kind::PIN ? TURN / 2 : 1;
        own[0] = std::clamp(middle + random_.between(-half, half), l[0], l[1]);
      }
    }
  }

  // Moves now_ downhill: Levenberg-Marquardt, and with the whole Hessian in a region of
  // trust where the goals are far or progress is slow. Not `thorough`, it gives up
  // there, for another start is then the better use of time.
  End descend(double damping, bool thorough) {
    ++outcome_.descents;
    bool fresh = true;
    double grow = 2, marked = now_.cost, trusted = LONGEST_TURN;
    int slow = 0;
    for (int since = 0;; ++since) {
      if (!(task_.rest_weight > 0) && reached(now_)) return End::REACHED;
      if (spent()) return End::BUDGET;
      if (fresh) linearize(task_, targets_, rest_, now_, linear_);
      ++outcome_.iterations;
      const bool curved = thorough && (now_.cost > FAR || slow > 1);
      const double gain = try_step(curved ? LEAST_DAMPING : damping, curved, trusted);
      if (std::fabs(gain) <= STILL_GAIN * now_.cost) return End::STILL;
      const double ratio = gain > 0 ? (now_.cost - next_.cost) / gain : 0;
      fresh = ratio > LEAST_RATIO && next_.cost < now_.cost;
      if (curved)
        trusted = ratio < 0.25  ? 0.3 * stepper_.turn()
                  : ratio > 0.5 ? std::min(2.5 * trusted, LONGEST_TURN)
                                : trusted;
      else if (fresh)
        damping = ratio > 0.75   ? std::max(damping * 0.1, LEAST_DAMPING)
                  : ratio < 0.25 ? damping * 3
                                 : damping;
      else
        damping = std::max(damping, 1e-9) * grow;
      grow = fresh ? 2 : grow * 2;
      if (damping > MOST_DAMPING || trusted < LEAST_TURN) return End::STILL;
      if (fresh) {
        slow = next_.cost > 0.5 * now_.cost ? slow + 1 : 0;
        std::swap(now_, next_);
      }
      if (since % PATIENCE == PATIENCE - 1) {
        if (!thorough && now_.cost > PROGRESS * marked) return End::SLOW;
        marked = now_.cost;
      }
    }
  }

  // What the model promises of the step to next_; less than 0 where there is none.
  double try_step(double damping, bool curved, double trusted) {
    if (!stepper_.step(now_, linear_, damping, curved, trusted, delta_.data())) return -1;
    const double gain = stepper_.predicted(now_, linear_, curved, delta_.data());
    if (!(gain > 0)) return gain;
    stepper_.move(now_.q.data(), delta_.data(), next_.q.data());
    evaluate(next_);
    return gain;
  }

  const Task& task_;
  const Settings& settings_;
  Linearized linear_;
  Stepper stepper_;
  State now_, next_, best_, first_;
  std::vector<double> delta_, pull_;
  Random random_{0};
  Outcome outcome_;
  double floor_ = 0;  // no pose costs less
  bool short_ = false;  // the frame before ended short of the goals, at this cost:
  double last_cost_ = 0;
  const double* targets_ = nullptr;
  const double* rest_ = nullptr;
  std::chrono::steady_clock::time_point began_;
};

}  // namespace animtool::ik
