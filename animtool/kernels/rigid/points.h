// Contact points during a step, and their response to impulses.
#pragma once

#include <vector>

#include "rigid/world.h"

namespace animtool::rigid {

struct Point {
  Vec on_a, on_b;                   // in the frames of both bodies
  Vec arm_a, arm_b;                 // in the world, at the start of the step
  double gap = 0, current_gap = 0;  // gap of the manifold, and the current one
  double bias_speed = 0;            // speed of a collider along the normal
  Vec slide;                        // its full velocity
  bool will_bounce = false;         // approaching so fast that it will bounce
  double mass = 0, force = 0, across[2] = {0, 0}, masses[2] = {0, 0};
  double half[3] = {0, 0, 0};          // impulses of half a substep
  Vec arms_a[3], arms_b[3];            // r x n, r x t1, r x t2
  Vec responses_a[3], responses_b[3];  // angular responses to these
};

struct Patch {
  std::size_t a, b;
  Vec normal, tangents[2];
  double friction, restitution, push;
  double skin = 0;                   // of both [m]
  double squared_arm_tolerance = 0;  // squared tolerance of arms [m²]
  std::size_t begin, end;            // points
  const Contact* contact;
};

// Relative velocity of the second, along the normal and the tangents.
inline double speed_along(const std::vector<Speed>& speeds, const Patch& patch, const Point& p,
                          int line) {
  const Speed &a = speeds[patch.a], &b = speeds[patch.b];
  const Vec direction = line ? patch.tangents[line - 1] : patch.normal;
  return dot(direction, b.v - a.v) + dot(p.arms_b[line], b.w) - dot(p.arms_a[line], a.w) +
         (line ? dot(direction, p.slide) : p.bias_speed);
}

inline void apply(std::vector<Speed>& speeds, std::size_t a, std::size_t b, Vec line,
                  Vec response_a, Vec response_b, double impulse) {
  Speed &sa = speeds[a], &sb = speeds[b];
  sa.v = sa.v - line * (impulse * sa.inverse_mass), sa.w = sa.w - response_a * impulse;
  sb.v = sb.v + line * (impulse * sb.inverse_mass), sb.w = sb.w + response_b * impulse;
}

inline void apply(std::vector<Speed>& speeds, const Patch& patch, const Point& p, int line,
                  double impulse) {
  apply(speeds, patch.a, patch.b, line ? patch.tangents[line - 1] : patch.normal,
        p.responses_a[line], p.responses_b[line], impulse);
}

}  // namespace animtool::rigid
