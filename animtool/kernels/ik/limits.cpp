// Clamps poses to limits, and splits the motion of balls.
#include "ik/limits.h"

namespace animtool::ik {

SwingTwist decompose(const double* q, const double* limit) {
  const double twist_norm = std::hypot(q[2], q[3]);
  const double half_twist = twist_norm < 1e-9 ? 0 : std::atan2(q[2], q[3]);
  const double twist_cosine = std::cos(half_twist), twist_sine = std::sin(half_twist);
  // swing = q * twist^-1, which has no z
  double x = twist_cosine * q[0] - twist_sine * q[1], y = twist_sine * q[0] + twist_cosine * q[1],
         w = twist_cosine * q[3] + twist_sine * q[2];
  if (w < 0) x = -x, y = -y, w = -w;
  const double sine = std::hypot(x, y);
  const double factor = sine < 1e-12 ? 2 : 2 * std::atan2(sine, w) / sine;
  SwingTwist swing_twist{{factor * x, factor * y}, 2 * half_twist};
  const bool has_range = limit[2] > -1e300 && limit[3] < 1e300;
  const double middle = has_range ? (limit[2] + limit[3]) / 2 : 0;
  swing_twist.twist -= REVOLUTION * std::round((swing_twist.twist - middle) / REVOLUTION);
  return swing_twist;
}

void clamp_ball(double* q, const double* limit) {
  SwingTwist swing_twist = decompose(q, limit);
  const ExceededLimits exceeded = exceeded_limits(swing_twist, limit);
  if (!exceeded.swing && !exceeded.twist) return;
  const double ratio = swing_ratio(swing_twist, limit);
  if (ratio > 1) {
    swing_twist.swing[0] /= ratio;
    swing_twist.swing[1] /= ratio;
  }
  swing_twist.twist = std::clamp(swing_twist.twist, limit[2], limit[3]);
  compose(swing_twist, q);
}

SwingTwistGradients swing_twist_gradients(const double* q, const SwingTwist& swing_twist) {
  SwingTwistGradients out;
  const double n = std::max(q[2] * q[2] + q[3] * q[3], 1e-18);
  // The rotation of z changes as v x z = (y, -x, 0).
  out.twist[0] = q[3] * q[1] / n + q[2] * q[0] / n;
  out.twist[1] = -q[3] * q[0] / n + q[2] * q[1] / n;
  out.twist[2] = (q[3] * q[3] + q[2] * q[2]) / n;
  const double angle = std::hypot(swing_twist.swing[0], swing_twist.swing[1]);
  const double axis_x = angle < 1e-12 ? 1 : swing_twist.swing[0] / angle;
  const double axis_y = angle < 1e-12 ? 0 : swing_twist.swing[1] / angle;
  const double axis[3] = {axis_x, axis_y, 0};
  const double rotated_z[3] = {std::sin(angle) * axis_y, -std::sin(angle) * axis_x,
                               std::cos(angle)};
  double tangent[3];
  cross(rotated_z, axis, tangent);
  const double factor = angle < 1e-6 ? 1 : angle / std::max(std::sin(angle), 1e-6);
  for (int i = 0; i < 3; ++i) {
    out.swing[0][i] = axis_x * axis[i] - factor * axis_y * tangent[i];
    out.swing[1][i] = axis_y * axis[i] + factor * axis_x * tangent[i];
  }
  return out;
}

BallParts split_ball(const double* q, double middle) {
  const double limit[4] = {0, 0, middle - REVOLUTION / 2, middle + REVOLUTION / 2};
  const SwingTwist swing_twist = decompose(q, limit);
  const SwingTwistGradients derivatives = swing_twist_gradients(q, swing_twist);
  BallParts out{swing_twist.twist, {swing_twist.swing[0], swing_twist.swing[1]}, {}};
  for (int k = 0; k < 2; ++k)
    std::copy(derivatives.swing[k], derivatives.swing[k] + 3, out.slopes[k]);
  std::copy(derivatives.twist, derivatives.twist + 3, out.slopes[2]);
  return out;
}

}  // namespace animtool::ik
