// Joint limits: ranges, and cones and twist ranges of balls.
//
// A ball's motion is swing * twist about z. Its swing vector (x, y) lies in the
// ellipse of the half-angles limit[0], limit[1]; its twist in limit[2], limit[3].
#pragma once

#include <limits>

#include "ik/chain.h"

namespace animtool::ik {

// A range or cone narrower than this is locked [rad].
constexpr double LOCKED = 1e-9;
// Tolerance of rounding at limits [rad], [chain lengths].
constexpr double ROUNDING = 1e-13;
// Closer to a limit than this, the full test is made [1].
constexpr double CERTAINTY = 1e-9;
constexpr double REVOLUTION = 6.283185307179586476925;

struct SwingTwist {
  double swing[2];
  double twist;
};

SwingTwist decompose(const double* q, const double* limit);

inline void compose(const SwingTwist& parts, double* q) {
  const double vector[3] = {parts.swing[0], parts.swing[1], 0};
  double swing[4];
  exponential(vector, swing);
  const double twist[4] = {0, 0, std::sin(parts.twist / 2), std::cos(parts.twist / 2)};
  product(swing, twist, q);
}

inline double reach(const SwingTwist& parts, const double* limit) {
  const double a = parts.swing[0] / std::max(limit[0], LOCKED);
  const double b = parts.swing[1] / std::max(limit[1], LOCKED);
  return std::hypot(a, b);
}

inline bool limited(const Node& node) {
  const double* l = node.limit;
  if (node.kind != Kind::BALL) return l[0] > -1e300 || l[1] < 1e300;
  return l[0] < 1e300 || l[1] < 1e300 || l[2] > -1e300 || l[3] < 1e300;
}

// Whether a ball's motion is certainly inside: a cheap test without inverse functions, which
// usually succeeds.
inline bool well_inside(const Node& node, const double* q) {
  const double* inside_bounds = node.inside_bounds;
  if (q[0] * q[0] + q[1] * q[1] > inside_bounds[0]) return false;
  const double sign = q[3] < 0 ? -1 : 1;
  const double sine = sign * q[2], cosine = sign * q[3];
  // sin(half twist - half low) and sin(half high - half twist)
  return sine * inside_bounds[2] - cosine * inside_bounds[1] > CERTAINTY &&
         cosine * inside_bounds[3] - sine * inside_bounds[4] > CERTAINTY;
}

// The numbers that `well_inside` compares with: sines and cosines of half the limits. For limits
// that are infinite, narrow, or beyond half a turn, it never succeeds.
inline void prepare(Node& node) {
  const double* l = node.limit;
  const double least = std::min(l[0], l[1]);
  const double sine = least < REVOLUTION / 2 ? std::sin(least / 2) : 1;
  const double low = std::max(l[2], -REVOLUTION / 2), high = std::min(l[3], REVOLUTION / 2);
  const bool known =
      (l[2] >= -REVOLUTION / 2 && l[3] <= REVOLUTION / 2) || (l[2] < -1e300 && l[3] > 1e300);
  node.inside_bounds[0] = known ? sine * sine * (1 - CERTAINTY) : -1;
  node.inside_bounds[1] = std::sin(low / 2), node.inside_bounds[2] = std::cos(low / 2);
  node.inside_bounds[3] = std::sin(high / 2), node.inside_bounds[4] = std::cos(high / 2);
}

// Flags of the limits that a motion exceeds.
struct Exceeded {
  bool swing, twist;
};

inline Exceeded exceeded(const SwingTwist& parts, const double* limit) {
  return {reach(parts, limit) > 1 + ROUNDING,
          parts.twist < limit[2] - ROUNDING || parts.twist > limit[3] + ROUNDING};
}

// Clamps a ball's motion; the swing keeps its direction.
void clamp_ball(double* q, const double* limit);

// Gradients of the swing vector and the twist for q <- exp(d) q.
struct SwingTwistGradients {
  double swing[2][3];
  double twist[3];
};

SwingTwistGradients gradients(const double* q, const SwingTwist& parts);

// A direction in which a step is prescribed: its unit vector over `width` degrees of freedom
// from `dof`, and the component of the step along it.
struct Fixed {
  int dof, width;
  double direction[3];
  double value;
  int node;
  // Of a cone, which curves: a force out of it along the direction adds force * bend bend^T to the
  // second derivatives.
  double bend[3] = {0, 0, 0};
  // Sign of the direction that leaves the limit; 0 for a locked one.
  int outwards = 0;
};

}  // namespace animtool::ik
