// Contact points during a step, and their response to impulses.
#pragma once

#include <vector>

#include "rigid/world.h"

namespace animtool::rigid {

// One contact point.
struct Point {
  Vec local_a, local_b;             // in the frames of both bodies
  Vec arm_a, arm_b;                 // in the world, at the start of the step
  double gap = 0, current_gap = 0;  // of the manifold, and currently
  double bias_speed = 0;            // speed of a collider along the normal
  Vec slide_velocity;               // velocity of a collider
  bool will_bounce = false;         // approaches so fast that it will bounce
  double mass = 0, force = 0, friction_forces[2] = {0, 0}, tangent_masses[2] = {0, 0};
  double half_impulses[3] = {0, 0, 0};  // normal and tangential, for half a substep
  Vec arms_a[3], arms_b[3];             // r x n, r x t1, r x t2
  Vec responses_a[3], responses_b[3];   // angular velocities by unit impulses along these
};

// The contact points of two bodies with a common normal.
struct Patch {
  std::size_t a, b;
  Vec normal, tangents[2];
  double friction, restitution, max_push_speed;
  double radius_sum = 0;             // sum of the radii of both bodies [m]
  double squared_arm_tolerance = 0;  // squared tolerance of arms [m²]
  std::size_t begin, end;            // range of points
  const Contact* contact;
};

// Relative velocity of the second body at a point, along the normal (0) or a tangent (1, 2).
inline double speed_along(const std::vector<Speed>& speeds, const Patch& patch, const Point& p,
                          int direction_index) {
  const Speed &a = speeds[patch.a], &b = speeds[patch.b];
  const Vec direction = direction_index ? patch.tangents[direction_index - 1] : patch.normal;
  return dot(direction, b.v - a.v) + dot(p.arms_b[direction_index], b.w) -
         dot(p.arms_a[direction_index], a.w) +
         (direction_index ? dot(direction, p.slide_velocity) : p.bias_speed);
}

// Applies an impulse along a line to two bodies.
inline void apply(std::vector<Speed>& speeds, std::size_t a, std::size_t b, Vec line,
                  Vec response_a, Vec response_b, double impulse) {
  Speed &speed_a = speeds[a], &speed_b = speeds[b];
  speed_a.v = speed_a.v - line * (impulse * speed_a.inverse_mass),
  speed_a.w = speed_a.w - response_a * impulse;
  speed_b.v = speed_b.v + line * (impulse * speed_b.inverse_mass),
  speed_b.w = speed_b.w + response_b * impulse;
}

inline void apply(std::vector<Speed>& speeds, const Patch& patch, const Point& p,
                  int direction_index, double impulse) {
  apply(speeds, patch.a, patch.b,
        direction_index ? patch.tangents[direction_index - 1] : patch.normal,
        p.responses_a[direction_index], p.responses_b[direction_index], impulse);
}

}  // namespace animtool::rigid
