// Points of contact while a step is solved, and what an impulse there does.
#pragma once

#include <vector>

#include "rigid/world.h"

namespace animtool::rigid {

struct Point {
  Vec own, other;          // in the frames of both
  Vec arm_a, arm_b;        // in the world, where the step begins
  double gap = 0, now = 0; // where the manifold is, and now
  double given = 0;        // speed of a collider along the normal
  Vec slide;               // and whole
  bool flies = false;      // on its way into the other so fast that it will bounce
  double mass = 0, force = 0, across[2] = {0, 0}, masses[2] = {0, 0};
  double half[3] = {0, 0, 0};  // what is held for half a small step
  Vec arms_a[3], arms_b[3];    // r x n, r x t1, r x t2
  Vec turns_a[3], turns_b[3];  // what these turn
};

struct Patch {
  std::size_t a, b;
  Vec normal, tangents[2];
  double friction, restitution, push;
  double skin = 0;    // of both together [m]
  double turned = 0;  // square of how far arms may be off [m²]
  std::size_t begin, end;  // points
  const Contact* contact;
};

// Speed of the second away from the first, along the normal and the tangents.
inline double speed_along(const std::vector<Speed>& speeds, const Patch& patch, const Point& p,
                          int line) {
  const Speed &a = speeds[patch.a], &b = speeds[patch.b];
  const Vec way = line ? patch.tangents[line - 1] : patch.normal;
  return dot(way, b.v - a.v) + dot(p.arms_b[line], b.w) - dot(p.arms_a[line], a.w) +
         (line ? dot(way, p.slide) : p.given);
}

inline void apply(std::vector<Speed>& speeds, std::size_t a, std::size_t b, Vec line, Vec turn_a,
                  Vec turn_b, double impulse) {
  Speed &sa = speeds[a], &sb = speeds[b];
  sa.v = sa.v - line * (impulse * sa.ease), sa.w = sa.w - turn_a * impulse;
  sb.v = sb.v + line * (impulse * sb.ease), sb.w = sb.w + turn_b * impulse;
}

inline void apply(std::vector<Speed>& speeds, const Patch& patch, const Point& p, int line,
                  double impulse) {
  apply(speeds, patch.a, patch.b, line ? patch.tangents[line - 1] : patch.normal,
        p.turns_a[line], p.turns_b[line], impulse);
}

}  // namespace animtool::rigid
