// Free rotation of a rigid body: Euler's equations, and the attitude.
//
// Splitting: the kinetic energy is three terms, one per principal axis, each of which rotates the
// body about that axis by an exact angle (Dullweber, Leimkuhler and McLachlan 1997, "Symplectic
// splitting methods for rigid body molecular dynamics"). Of order 2, composed to order 4 (Suzuki
// 1990), 6 and 8 (Kahan and Li 1997, "Composition constants for raising the orders of
// unconventional schemes") for large rotations in a step.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "base/poses.h"
#include "base/rotations.h"

namespace animtool::rigid {

using animtool::Quaternion;
using collide::length;
using collide::Vec;

// Integration methods of free rotation.
enum class Method : std::int64_t { SPLITTING, RK4, SYMPLECTIC_EULER, EULER };

// Rotates a vector by a unit quaternion.
inline Vec rotate(const Quaternion& q, Vec a) {
  const Vec u{q.x, q.y, q.z}, t = cross(u, a) * 2;
  return a + t * q.w + cross(u, t);
}

inline Vec inverse_rotate(const Quaternion& q, Vec a) { return rotate(conjugate(q), a); }

// The quaternion of a rotation vector.
inline Quaternion quaternion_from_vector(Vec v) {
  const double angle = length(v);
  const double factor = angle > 1e-8 ? std::sin(angle / 2) / angle : 0.5 - angle * angle / 48;
  return {v.x * factor, v.y * factor, v.z * factor, std::cos(angle / 2)};
}

// Attitude, and angular momentum in the frame of the principal axes.
struct Spin {
  Quaternion q;
  double p[3];
};

// Inverse moments of inertia about the principal axes; 0 where there is none, as about a rod.
struct InverseInertia {
  double entries[3];

  Vec angular_velocity(const double* p) const {
    return {p[0] * entries[0], p[1] * entries[1], p[2] * entries[2]};
  }
};

// Rotates a body about one of its principal axes.
template <int AXIS>
inline void rotate_about(Spin& s, const InverseInertia& inverse_inertia, double h) {
  constexpr int J = (AXIS + 1) % 3, K = (AXIS + 2) % 3;
  const double angle = h * s.p[AXIS] * inverse_inertia.entries[AXIS];
  if (angle == 0) return;
  const double half = angle / 2, sine = std::sin(half), cosine = std::cos(half);
  const double sine_full = 2 * sine * cosine, cosine_full = 1 - 2 * sine * sine;
  const double j = s.p[J], k = s.p[K];
  s.p[J] = cosine_full * j + sine_full * k;
  s.p[K] = cosine_full * k - sine_full * j;
  Quaternion rotation;
  (AXIS == 0 ? rotation.x : AXIS == 1 ? rotation.y : rotation.z) = sine;
  rotation.w = cosine;
  s.q = s.q * rotation;
}

// One symmetric splitting step of order 2.
inline void split_step(Spin& s, const InverseInertia& inverse_inertia, double h) {
  rotate_about<0>(s, inverse_inertia, h / 2);
  rotate_about<1>(s, inverse_inertia, h / 2);
  rotate_about<2>(s, inverse_inertia, h);
  rotate_about<1>(s, inverse_inertia, h / 2);
  rotate_about<0>(s, inverse_inertia, h / 2);
}

// A symmetric composition of splitting steps, given the first half of their fractions.
template <std::size_t HALF>
inline void compose_steps(Spin& s, const InverseInertia& inverse_inertia, double h,
                          const double (&fractions)[HALF]) {
  for (std::size_t i = 0; i < HALF; ++i) split_step(s, inverse_inertia, h * fractions[i]);
  for (std::size_t i = HALF - 1; i-- > 0;) split_step(s, inverse_inertia, h * fractions[i]);
}

// Largest rotations for steps of order 2, 4 and 6, in radians by which axes differ: each keeps
// energy within 1e-12 and attitude within 1e-9.
constexpr double MAX_ORDER_2_ANGLE = 2e-4, MAX_ORDER_4_ANGLE = 4e-3, MAX_ORDER_6_ANGLE = 2e-2;
// Largest rotation for order 8; longer steps are divided, into at most this many: nothing spins
// faster in practice.
constexpr double MAX_ORDER_8_ANGLE = 0.2, MAX_DIVISIONS = 64;

// Rotates by splitting, at the order that the step needs.
inline void rotate_by_splitting(Spin& s, const InverseInertia& inverse_inertia, double h) {
  static constexpr double order_4_fractions[] = {0.41449077179437573714, 0.41449077179437573714,
                                                 -0.65796308717750294857};
  static constexpr double order_6_fractions[] = {0.39216144400731413928, 0.33259913678935943860,
                                                 -0.70624617255763935981, 0.08221359629355080023,
                                                 0.79854399093482996340};
  static constexpr double order_8_fractions[] = {
      0.13020248308889008088, 0.56116298177510838456,  -0.38947496264484728641,
      0.15884190655515560090, -0.39590389413323757734, 0.18453964097831570709,
      0.25837438768632204729, 0.29501172360931029887,  -0.60550853383003451170};
  const auto [smallest, largest] = std::minmax(
      {inverse_inertia.entries[0], inverse_inertia.entries[1], inverse_inertia.entries[2]});
  const double momentum = std::sqrt(s.p[0] * s.p[0] + s.p[1] * s.p[1] + s.p[2] * s.p[2]);
  const double angle_bound = h * momentum * (largest - smallest);
  if (angle_bound == 0) {
    const Vec w = inverse_inertia.angular_velocity(s.p);
    const Quaternion rotation = quaternion_from_vector(w * h);
    s.q = s.q * rotation;
    return;
  }
  if (angle_bound <= MAX_ORDER_2_ANGLE) return split_step(s, inverse_inertia, h);
  if (angle_bound <= MAX_ORDER_4_ANGLE)
    return compose_steps(s, inverse_inertia, h, order_4_fractions);
  if (angle_bound <= MAX_ORDER_6_ANGLE)
    return compose_steps(s, inverse_inertia, h, order_6_fractions);
  const double count = std::min(std::ceil(angle_bound / MAX_ORDER_8_ANGLE), MAX_DIVISIONS);
  for (int i = 0; i < count; ++i) compose_steps(s, inverse_inertia, h / count, order_8_fractions);
}

// Rates of attitude and momentum, for classical methods.
struct Rate {
  Quaternion q;
  double p[3];
};

inline Rate compute_rate(const Spin& s, const InverseInertia& inverse_inertia) {
  const Vec w = inverse_inertia.angular_velocity(s.p), p{s.p[0], s.p[1], s.p[2]}, d = cross(p, w);
  const Quaternion attitude_rate = s.q * Quaternion{w.x / 2, w.y / 2, w.z / 2, 0};
  return {attitude_rate, {d.x, d.y, d.z}};
}

// An explicit Euler step.
inline Spin advance(const Spin& s, const Rate& r, double h) {
  Spin result{{s.q.x + h * r.q.x, s.q.y + h * r.q.y, s.q.z + h * r.q.z, s.q.w + h * r.q.w}, {}};
  for (int i = 0; i < 3; ++i) result.p[i] = s.p[i] + h * r.p[i];
  return result;
}

// Rotates a body for a time h without torque.
inline void spin_freely(Spin& s, const InverseInertia& inverse_inertia, double h, Method method) {
  switch (method) {
    case Method::SPLITTING:
      rotate_by_splitting(s, inverse_inertia, h);
      break;
    case Method::EULER:
      s = advance(s, compute_rate(s, inverse_inertia), h);
      break;
    case Method::SYMPLECTIC_EULER: {
      const Spin end = advance(s, compute_rate(s, inverse_inertia), h);
      std::copy_n(end.p, 3, s.p);
      s.q = advance(s, compute_rate(s, inverse_inertia), h).q;
      break;
    }
    case Method::RK4: {
      const Rate a = compute_rate(s, inverse_inertia),
                 b = compute_rate(advance(s, a, h / 2), inverse_inertia);
      const Rate c = compute_rate(advance(s, b, h / 2), inverse_inertia),
                 d = compute_rate(advance(s, c, h), inverse_inertia);
      s = advance(advance(advance(advance(s, a, h / 6), b, h / 3), c, h / 3), d, h / 6);
      break;
    }
  }
  s.q = unit(s.q);
}

}  // namespace animtool::rigid
