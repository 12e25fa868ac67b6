// Random poses inside the limits, the same ones everywhere.
#pragma once

#include <cstdint>

#include "ik/goals.h"
#include "ik/limits.h"

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
    double* own = q + node.coordinate;
    const double* l = node.limit;
    const double middle = home[node.coordinate];
    if (node.kind == Kind::BALL) {
      SwingTwist parts;
      const double reach = std::sqrt(random.between(0, 1));
      const double angle = random.between(0, TURN);
      parts.swing[0] = reach * std::min(l[0], TURN / 2) * std::cos(angle);
      parts.swing[1] = reach * std::min(l[1], TURN / 2) * std::sin(angle);
      parts.twist = random.between(std::max(l[2], -TURN / 2), std::min(l[3], TURN / 2));
      join(parts, own);
      clamp_ball(own, l);
    } else if (l[1] - l[0] < TURN) {
      own[0] = random.between(l[0], l[1]);
    } else {
      const double half = node.kind == Kind::PIN ? TURN / 2 : 1;
      own[0] = std::clamp(middle + random.between(-half, half), l[0], l[1]);
    }
  }
}

}  // namespace animtool::ik
