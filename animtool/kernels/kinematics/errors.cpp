// Distances between points of joints in two motions.
#include <algorithm>
#include <cmath>

#include "base/checks.h"
#include "kinematics/kinematics.h"

namespace animtool {

Out<double, 2> point_errors(In<double, 3> points, In<double, 3> true_positions,
                            In<double, 4> true_linear, In<double, 3> positions,
                            In<double, 4> linear) {
  const std::size_t joints = points.shape(0), point_count = points.shape(1);
  const std::size_t frames = positions.shape(0);
  check::shape("points", points, {check::ANY, check::ANY, 3});
  check::shape("true_positions", true_positions, {frames, joints, 3});
  check::shape("true_linear", true_linear, {frames, joints, 3, 3});
  check::shape("positions", positions, {frames, joints, 3});
  check::shape("linear", linear, {frames, joints, 3, 3});
  Out<double, 2> result(frames, joints);
  const double *position = positions.data(), *true_position = true_positions.data();
  const double *linear_part = linear.data(), *true_linear_part = true_linear.data();
  double* out = result.get();
  for (std::size_t i = 0; i < frames * joints;
       ++i, position += 3, true_position += 3, linear_part += 9, true_linear_part += 9) {
    const double* point = points.data() + (i % joints) * point_count * 3;
    double linear_difference[9], max_squared_error = 0;
    for (int k = 0; k < 9; ++k) linear_difference[k] = linear_part[k] - true_linear_part[k];
    for (std::size_t n = 0; n < point_count; ++n, point += 3) {
      double squared_error = 0;
      for (int r = 0; r < 3; ++r) {
        const double difference =
            (position[r] - true_position[r]) + linear_difference[3 * r] * point[0] +
            linear_difference[3 * r + 1] * point[1] + linear_difference[3 * r + 2] * point[2];
        squared_error += difference * difference;
      }
      max_squared_error = std::max(max_squared_error, squared_error);
    }
    out[i] = std::sqrt(max_squared_error);
  }
  return result;
}

}  // namespace animtool
