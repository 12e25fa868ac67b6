// Distances between points of joints in two motions.
#include <algorithm>
#include <cmath>

#include "base/checks.h"
#include "kinematics/kinematics.h"

namespace animtool {

Out<double, 2> point_errors(In<double, 3> points, In<double, 3> true_positions,
                            In<double, 4> true_linear, In<double, 3> positions,
                            In<double, 4> linear) {
  const std::size_t joints = points.shape(0), count = points.shape(1);
  const std::size_t frames = positions.shape(0);
  check::shape("points", points, {check::ANY, check::ANY, 3});
  check::shape("true_positions", true_positions, {frames, joints, 3});
  check::shape("true_linear", true_linear, {frames, joints, 3, 3});
  check::shape("positions", positions, {frames, joints, 3});
  check::shape("linear", linear, {frames, joints, 3, 3});
  Out<double, 2> result(frames, joints);
  const double *p = positions.data(), *q = true_positions.data();
  const double *a = linear.data(), *b = true_linear.data();
  double* out = result.get();
  for (std::size_t i = 0; i < frames * joints; ++i, p += 3, q += 3, a += 9, b += 9) {
    const double* point = points.data() + (i % joints) * count * 3;
    double turned[9], worst = 0;
    for (int k = 0; k < 9; ++k) turned[k] = a[k] - b[k];
    for (std::size_t n = 0; n < count; ++n, point += 3) {
      double sum = 0;
      for (int r = 0; r < 3; ++r) {
        const double off = (p[r] - q[r]) + turned[3 * r] * point[0] + turned[3 * r + 1] * point[1] +
                           turned[3 * r + 2] * point[2];
        sum += off * off;
      }
      worst = std::max(worst, sum);
    }
    out[i] = std::sqrt(worst);
  }
  return result;
}

}  // namespace animtool
