// Joint limits: ranges, and cones and twist ranges of balls.
//
// A ball's motion is swing * twist, the twist about z. Its swing vector (x, y) is in the ellipse
// with the half-angles limit[0], limit[1]; its twist is between limit[2] and limit[3].
#pragma once

#include <limits>

#include "ik/chain.h"

namespace animtool::ik {

// A range or cone narrower than this is locked [rad].
constexpr double LOCKED_RANGE = 1e-9;
// Tolerance for rounding at limits [rad], [chain lengths].
constexpr double ROUNDING_TOLERANCE = 1e-13;
// Within this margin of a limit, the quick test is not decisive [1].
constexpr double QUICK_TEST_MARGIN = 1e-9;
constexpr double REVOLUTION = 6.283185307179586476925;

// A ball's motion: the swing vector and the twist angle [rad].
struct SwingTwist {
  double swing[2];
  double twist;
};

// Splits a ball's motion; the twist is within half a revolution of the middle of its limits.
SwingTwist decompose(const double* q, const double* limit);

inline void compose(const SwingTwist& swing_twist, double* q) {
  const double vector[3] = {swing_twist.swing[0], swing_twist.swing[1], 0};
  double swing[4];
  exponential(vector, swing);
  const double twist[4] = {0, 0, std::sin(swing_twist.twist / 2), std::cos(swing_twist.twist / 2)};
  product(swing, twist, q);
}

// Length of the swing vector over its limit in that direction; above 1 outside of the limit.
inline double swing_ratio(const SwingTwist& swing_twist, const double* limit) {
  const double a = swing_twist.swing[0] / std::max(limit[0], LOCKED_RANGE);
  const double b = swing_twist.swing[1] / std::max(limit[1], LOCKED_RANGE);
  return std::hypot(a, b);
}

inline bool has_limit(const Node& node) {
  const double* limit = node.limit;
  if (node.kind != Kind::BALL) return limit[0] > -1e300 || limit[1] < 1e300;
  return limit[0] < 1e300 || limit[1] < 1e300 || limit[2] > -1e300 || limit[3] < 1e300;
}

// Whether a ball's motion is certainly within its limits: a quick test without inverse functions,
// which usually succeeds.
inline bool is_well_inside(const Node& node, const double* q) {
  const double* inside_bounds = node.inside_bounds;
  if (q[0] * q[0] + q[1] * q[1] > inside_bounds[0]) return false;
  const double sign = q[3] < 0 ? -1 : 1;
  const double sine = sign * q[2], cosine = sign * q[3];
  // sin(half twist - half low) and sin(half high - half twist)
  return sine * inside_bounds[2] - cosine * inside_bounds[1] > QUICK_TEST_MARGIN &&
         cosine * inside_bounds[3] - sine * inside_bounds[4] > QUICK_TEST_MARGIN;
}

// Precomputes the numbers of `is_well_inside`: sines and cosines of half the limits. For limits
// that are infinite, narrow, or beyond half a revolution, that test does not succeed.
inline void set_inside_bounds(Node& node) {
  const double* limit = node.limit;
  const double min_swing = std::min(limit[0], limit[1]);
  const double sine = min_swing < REVOLUTION / 2 ? std::sin(min_swing / 2) : 1;
  const double low = std::max(limit[2], -REVOLUTION / 2), high = std::min(limit[3], REVOLUTION / 2);
  const bool is_usable = (limit[2] >= -REVOLUTION / 2 && limit[3] <= REVOLUTION / 2) ||
                         (limit[2] < -1e300 && limit[3] > 1e300);
  node.inside_bounds[0] = is_usable ? sine * sine * (1 - QUICK_TEST_MARGIN) : -1;
  node.inside_bounds[1] = std::sin(low / 2), node.inside_bounds[2] = std::cos(low / 2);
  node.inside_bounds[3] = std::sin(high / 2), node.inside_bounds[4] = std::cos(high / 2);
}

// Which limits a motion exceeds.
struct ExceededLimits {
  bool swing, twist;
};

inline ExceededLimits exceeded_limits(const SwingTwist& swing_twist, const double* limit) {
  return {swing_ratio(swing_twist, limit) > 1 + ROUNDING_TOLERANCE,
          swing_twist.twist < limit[2] - ROUNDING_TOLERANCE ||
              swing_twist.twist > limit[3] + ROUNDING_TOLERANCE};
}

// Clamps a ball's motion to its limits; the swing keeps its direction.
void clamp_ball(double* q, const double* limit);

// Gradients of the swing vector and the twist for q <- exp(d) q.
struct SwingTwistGradients {
  double swing[2][3];
  double twist[3];
};

SwingTwistGradients swing_twist_gradients(const double* q, const SwingTwist& swing_twist);

// A direction in which a step is prescribed: a unit vector over `width` degrees of freedom from
// `dof`, and the component of the step along it.
struct FixedDirection {
  int dof, width;
  double direction[3];
  double value;
  int node;
  // For a cone, which is curved: a force out of it along the direction adds force * bend bend^T to
  // the second derivatives.
  double bend[3] = {0, 0, 0};
  // Sign of the direction that leaves the limit; 0 for a locked range.
  int outward_sign = 0;
};

}  // namespace animtool::ik
