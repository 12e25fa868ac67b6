// How far points that joints carry are from where they were.
#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "kernels.h"

namespace animtool {

Out<double, 2> point_errors(In<double, 3> points, In<double, 3> true_positions,
                            In<double, 4> true_linear, In<double, 3> positions,
                            In<double, 4> linear) {
  const std::size_t joints = points.shape(0), count = points.shape(1);
  const std::size_t frames = positions.shape(0);
  const auto fits = [&](const auto& origins, const auto& axes) {
    return origins.shape(0) == frames && origins.shape(1) == joints && origins.shape(2) == 3 &&
           axes.shape(0) == frames && axes.shape(1) == joints && axes.shape(2) == 3 &&
           axes.shape(3) == 3;
  };
  if (points.shape(2) != 3 || !fits(true_positions, true_linear) || !fits(positions, linear))
    throw std::invalid_argument(
        "points are (J, P, 3), positions are (F, J, 3), linear parts are (F, J, 3, 3)");
  Buffer<double> result(frames * joints);
  {
    nb::gil_scoped_release release;
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
          const double off = (p[r] - q[r]) + turned[3 * r] * point[0] +
                             turned[3 * r + 1] * point[1] + turned[3 * r + 2] * point[2];
          sum += off * off;
        }
        worst = std::max(worst, sum);
      }
      out[i] = std::sqrt(worst);
    }
  }
  const std::size_t shape[2] = {frames, joints};
  return result.release(shape);
}

}  // namespace animtool
