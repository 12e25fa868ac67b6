// Clamps poses to limits.
#include "ik/limits.h"

namespace animtool::ik {

SwingTwist decompose(const double* q, const double* limit) {
  const double n = std::hypot(q[2], q[3]);
  const double half = n < 1e-9 ? 0 : std::atan2(q[2], q[3]);
  const double c = std::cos(half), s = std::sin(half);
  // swing = q * twist^-1, which has no z
  double x = c * q[0] - s * q[1], y = s * q[0] + c * q[1], w = c * q[3] + s * q[2];
  if (w < 0) x = -x, y = -y, w = -w;
  const double sine = std::hypot(x, y);
  const double factor = sine < 1e-12 ? 2 : 2 * std::atan2(sine, w) / sine;
  SwingTwist parts{{factor * x, factor * y}, 2 * half};
  const bool ranged = limit[2] > -1e300 && limit[3] < 1e300;
  const double middle = ranged ? (limit[2] + limit[3]) / 2 : 0;
  parts.twist -= REVOLUTION * std::round((parts.twist - middle) / REVOLUTION);
  return parts;
}

void clamp_ball(double* q, const double* limit) {
  SwingTwist parts = decompose(q, limit);
  const Exceeded out = exceeded(parts, limit);
  if (!out.swing && !out.twist) return;
  const double outside = reach(parts, limit);
  if (outside > 1) {
    parts.swing[0] /= outside;
    parts.swing[1] /= outside;
  }
  parts.twist = std::clamp(parts.twist, limit[2], limit[3]);
  compose(parts, q);
}

SwingTwistGradients gradients(const double* q, const SwingTwist& parts) {
  SwingTwistGradients out;
  const double n = std::max(q[2] * q[2] + q[3] * q[3], 1e-18);
  // v x z = (y, -x, 0)
  out.twist[0] = q[3] * q[1] / n + q[2] * q[0] / n;
  out.twist[1] = -q[3] * q[0] / n + q[2] * q[1] / n;
  out.twist[2] = (q[3] * q[3] + q[2] * q[2]) / n;
  const double angle = std::hypot(parts.swing[0], parts.swing[1]);
  const double c = angle < 1e-12 ? 1 : parts.swing[0] / angle;
  const double s = angle < 1e-12 ? 0 : parts.swing[1] / angle;
  const double axis[3] = {c, s, 0};
  const double swung[3] = {std::sin(angle) * s, -std::sin(angle) * c, std::cos(angle)};
  double around[3];
  cross(swung, axis, around);
  const double factor = angle < 1e-6 ? 1 : angle / std::max(std::sin(angle), 1e-6);
  for (int i = 0; i < 3; ++i) {
    out.swing[0][i] = c * axis[i] - factor * s * around[i];
    out.swing[1][i] = s * axis[i] + factor * c * around[i];
  }
  return out;
}

BallParts ball_parts(const double* q, double middle) {
  const double around[4] = {0, 0, middle - REVOLUTION / 2, middle + REVOLUTION / 2};
  const SwingTwist parts = decompose(q, around);
  const SwingTwistGradients slopes = gradients(q, parts);
  BallParts out{parts.twist, {parts.swing[0], parts.swing[1]}, {}};
  for (int k = 0; k < 2; ++k) std::copy(slopes.swing[k], slopes.swing[k] + 3, out.slopes[k]);
  std::copy(slopes.twist, slopes.twist + 3, out.slopes[2]);
  return out;
}

}  // namespace animtool::ik
