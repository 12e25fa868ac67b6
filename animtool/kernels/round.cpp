// Points as float32, and how far that moved them.
#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "kernels.h"

namespace animtool {

RoundedPoints round_points(In<double, 3> points, double unit) {
  const std::size_t frames = points.shape(0), vertices = points.shape(1);
  if (points.shape(2) != 3) throw std::invalid_argument("points are (F, V, 3)");
  if (!(unit > 0)) throw std::invalid_argument("the unit must be positive");
  Buffer<float> rounded(frames * vertices * 3);
  double largest = 0;
  std::size_t at_frame = 0, at_vertex = 0;
  {
    nb::gil_scoped_release release;
    constexpr double limit = std::numeric_limits<float>::max();
    const std::size_t count = vertices * 3;
    std::vector<double> exact(count), squares(count);
    const double* p = points.data();
    float* out = rounded.get();
    for (std::size_t f = 0; f < frames; ++f, p += count, out += count) {
      for (std::size_t i = 0; i < count; ++i) {
        const double value = p[i] / unit;
        const double low = value < -limit ? -limit : value;
        exact[i] = value;
        out[i] = static_cast<float>(low > limit ? limit : low);
      }
      for (std::size_t i = 0; i < count; ++i) {
        const double off = out[i] - exact[i];
        squares[i] = off * off;
      }
      // Two passes: few frames hold a new largest error, and the first is quick.
      double worst = 0;
      const double* s = squares.data();
      for (std::size_t v = 0; v < vertices; ++v, s += 3) {
        const double sum = s[0] + s[1] + s[2];
        worst = sum > worst ? sum : worst;
      }
      if (worst > largest) {
        largest = worst;
        at_frame = f;
        s = squares.data();
        for (at_vertex = 0; s[0] + s[1] + s[2] != worst; ++at_vertex) s += 3;
      }
    }
  }
  const std::size_t shape[3] = {frames, vertices, 3};
  return {rounded.release(shape), std::sqrt(largest) * unit, at_frame, at_vertex};
}

}  // namespace animtool
