// Free rotation of a rigid body: Euler's equations, and its attitude.
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

enum class Method : std::int64_t { SPLITTING, RK4, SYMPLECTIC_EULER, EULER };

inline Vec rotate(const Quaternion& q, Vec a) {
  const Vec u{q.x, q.y, q.z}, t = cross(u, a) * 2;
  return a + t * q.w + cross(u, t);
}

inline Vec unrotate(const Quaternion& q, Vec a) { return rotate(conjugate(q), a); }

// The rotation of a rotation vector.
inline Quaternion rotation_of(Vec v) {
  const double angle = length(v);
  const double s = angle > 1e-8 ? std::sin(angle / 2) / angle : 0.5 - angle * angle / 48;
  return {v.x * s, v.y * s, v.z * s, std::cos(angle / 2)};
}

// Attitude, and angular momentum in the frame of the principal axes.
struct Spin {
  Quaternion q;
  double p[3];
};

// Over the moments of inertia; 0 without one, as about a rod.
struct InverseInertia {
  double of[3];

  Vec spin(const double* p) const { return {p[0] * of[0], p[1] * of[1], p[2] * of[2]}; }
};

// Rotates a body about one of its principal axes.
template <int AXIS>
inline void rotate_about(Spin& s, const InverseInertia& inverse_mass, double h) {
  constexpr int J = (AXIS + 1) % 3, K = (AXIS + 2) % 3;
  const double angle = h * s.p[AXIS] * inverse_mass.of[AXIS];
  if (angle == 0) return;
  const double half = angle / 2, sine = std::sin(half), cosine = std::cos(half);
  const double sn = 2 * sine * cosine, cs = 1 - 2 * sine * sine;
  const double j = s.p[J], k = s.p[K];
  s.p[J] = cs * j + sn * k;
  s.p[K] = cs * k - sn * j;
  Quaternion by;
  (AXIS == 0 ? by.x : AXIS == 1 ? by.y : by.z) = sine;
  by.w = cosine;
  s.q = s.q * by;
}

inline void split_step(Spin& s, const InverseInertia& inverse_mass, double h) {
  rotate_about<0>(s, inverse_mass, h / 2);
  rotate_about<1>(s, inverse_mass, h / 2);
  rotate_about<2>(s, inverse_mass, h);
  rotate_about<1>(s, inverse_mass, h / 2);
  rotate_about<0>(s, inverse_mass, h / 2);
}

template <std::size_t HALF>
inline void composed(Spin& s, const InverseInertia& inverse_mass, double h,
                     const double (&fractions)[HALF]) {
  for (std::size_t i = 0; i < HALF; ++i) split_step(s, inverse_mass, h * fractions[i]);
  for (std::size_t i = HALF - 1; i-- > 0;) split_step(s, inverse_mass, h * fractions[i]);
}

// Largest rotations, in radians that differ between axes, of steps of order 2, 4 and 6: each keeps
// energy within 1e-12 and attitude within 1e-9.
constexpr double ANGLE_2 = 2e-4, ANGLE_4 = 4e-3, ANGLE_6 = 2e-2;
// Largest rotation at order 8; longer steps are divided, up to this count: no shot spins faster.
constexpr double ANGLE_8 = 0.2, MAX_PARTS = 64;

inline void split(Spin& s, const InverseInertia& inverse_mass, double h) {
  static constexpr double fourth[] = {0.41449077179437573714, 0.41449077179437573714,
                                      -0.65796308717750294857};
  static constexpr double sixth[] = {0.39216144400731413928, 0.33259913678935943860,
                                     -0.70624617255763935981, 0.08221359629355080023,
                                     0.79854399093482996340};
  static constexpr double eighth[] = {
      0.13020248308889008088, 0.56116298177510838456,  -0.38947496264484728641,
      0.15884190655515560090, -0.39590389413323757734, 0.18453964097831570709,
      0.25837438768632204729, 0.29501172360931029887,  -0.60550853383003451170};
  const auto [least, most] =
      std::minmax({inverse_mass.of[0], inverse_mass.of[1], inverse_mass.of[2]});
  const double momentum = std::sqrt(s.p[0] * s.p[0] + s.p[1] * s.p[1] + s.p[2] * s.p[2]);
  const double angle_bound = h * momentum * (most - least);
  if (angle_bound == 0) {
    const Vec w = inverse_mass.spin(s.p);
    const Quaternion by = rotation_of(w * h);
    s.q = s.q * by;
    return;
  }
  if (angle_bound <= ANGLE_2) return split_step(s, inverse_mass, h);
  if (angle_bound <= ANGLE_4) return composed(s, inverse_mass, h, fourth);
  if (angle_bound <= ANGLE_6) return composed(s, inverse_mass, h, sixth);
  const double parts = std::min(std::ceil(angle_bound / ANGLE_8), MAX_PARTS);
  for (int i = 0; i < parts; ++i) composed(s, inverse_mass, h / parts, eighth);
}

// Rates of attitude and momentum, for classical methods.
struct Rate {
  Quaternion q;
  double p[3];
};

inline Rate rate_of(const Spin& s, const InverseInertia& inverse_mass) {
  const Vec w = inverse_mass.spin(s.p), p{s.p[0], s.p[1], s.p[2]}, d = cross(p, w);
  const Quaternion by = s.q * Quaternion{w.x / 2, w.y / 2, w.z / 2, 0};
  return {by, {d.x, d.y, d.z}};
}

inline Spin advanced(const Spin& s, const Rate& r, double h) {
  Spin to{{s.q.x + h * r.q.x, s.q.y + h * r.q.y, s.q.z + h * r.q.z, s.q.w + h * r.q.w}, {}};
  for (int i = 0; i < 3; ++i) to.p[i] = s.p[i] + h * r.p[i];
  return to;
}

inline void spin_freely(Spin& s, const InverseInertia& inverse_mass, double h, Method method) {
  switch (method) {
    case Method::SPLITTING:
      split(s, inverse_mass, h);
      break;
    case Method::EULER:
      s = advanced(s, rate_of(s, inverse_mass), h);
      break;
    case Method::SYMPLECTIC_EULER: {
      const Spin after = advanced(s, rate_of(s, inverse_mass), h);
      std::copy_n(after.p, 3, s.p);
      s.q = advanced(s, rate_of(s, inverse_mass), h).q;
      break;
    }
    case Method::RK4: {
      const Rate a = rate_of(s, inverse_mass), b = rate_of(advanced(s, a, h / 2), inverse_mass);
      const Rate c = rate_of(advanced(s, b, h / 2), inverse_mass),
                 d = rate_of(advanced(s, c, h), inverse_mass);
      s = advanced(advanced(advanced(advanced(s, a, h / 6), b, h / 3), c, h / 3), d, h / 6);
      break;
    }
  }
  s.q = unit(s.q);
}

}  // namespace animtool::rigid
